"""`extremal study NAME`: run one of the modules of `extremal.app.studies`.

NAME is the module's name with a dot between digits and a hyphen elsewhere for each "_": `table_3_1` is table-3.1,
`snow_cost` is snow-cost.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .errors import InputError, suggestion
from .options import PetscOptions, check_files
from .parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI


def names() -> list[str]:
    """Return the names of the studies there are, without importing them."""
    studies = importlib.import_module(".studies", __package__)
    modules = [module.name for module in pkgutil.iter_modules(studies.__path__)]
    return sorted(_name(module) for module in modules if not module.startswith("_"))


def _name(module: str) -> str:
    return re.sub(r"(?<=\d)_(?=\d)", ".", module).replace("_", "-")


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare NAME and, once it is known, the arguments of that study."""
    known = names()
    parser.add_argument("name", metavar="NAME", help="one of: " + (", ".join(known) or "(none is installed)"))
    name = words[0] if words and not words[0].startswith("-") else None
    if name is None:
        if not {"-h", "--help"} & {*words}:
            raise InputError(f"study: NAME is missing; known: {', '.join(known) or 'none'}")
        return
    if name not in known:
        raise InputError(f"study {name}: unknown study; {suggestion(name, known)}")
    parser.prog += f" {name}"
    _module(name).add_arguments(parser)


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Run the study and return the exit code (collective)."""
    on_root(comm, lambda: check_files(petsc_arguments))
    options = PetscOptions(petsc_arguments)
    try:
        code = _module(args.name).run(args, comm)
    finally:
        options.close()
    return int(code or 0)


def _module(name: str) -> Any:
    return importlib.import_module(".studies." + re.sub("[-.]", "_", name), __package__)
