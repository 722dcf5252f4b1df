"""`extremal study NAME`: a module or a sweep of `extremal.app.studies`, a sweep of one's own, or `recommend`.

NAME is the module's or the sweep's name with a dot between digits and a hyphen elsewhere for each "_": `table_3_1` is
table-3.1, `snow_cost` is snow-cost. A NAME that ends in .toml is the file of a sweep.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import InputError, suggestion
from .options import PetscOptions, check_files
from .parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI

SWEEPS = Path(__file__).parent / "studies"
RECOMMEND = "recommend"


def names() -> list[str]:
    """Return the names of the studies there are, without importing them."""
    studies = importlib.import_module(".studies", __package__)
    modules = [module.name for module in pkgutil.iter_modules(studies.__path__) if not module.ispkg]
    return sorted([*(_name(module) for module in modules if not module.startswith("_")), *sweeps()])


def sweeps() -> dict[str, Path]:
    """Return the files of the sweeps there are, by their names."""
    return {_name(path.stem): path for path in sorted(SWEEPS.glob("*.toml"))}


def _name(module: str) -> str:
    return re.sub(r"(?<=\d)_(?=\d)", ".", module).replace("_", "-")


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare NAME and, once it is known, the arguments of that study."""
    known = names()
    listed = ", ".join(known) or "(none is installed)"
    parser.add_argument("name", metavar="NAME", help=f"one of: {listed}; a sweep's file (TOML); or {RECOMMEND}")
    name = words[0] if words and not words[0].startswith("-") else None
    if name is None:
        if not {"-h", "--help"} & {*words}:
            raise InputError(f"study: NAME is missing; known: {', '.join(known) or 'none'}")
        return
    if name not in (*known, RECOMMEND) and not name.endswith(".toml"):
        raise InputError(f"study {name}: unknown study; {suggestion(name, known)}")
    parser.prog += f" {name}"
    if name == RECOMMEND:
        _sweep_command().add_recommend_arguments(parser)
    elif _sweep(name) is not None:
        _sweep_command().add_arguments(parser)
    else:
        _module(name).add_arguments(parser)


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Run the study and return the exit code (collective)."""
    sweep = _sweep(args.name)
    if petsc_arguments and (sweep is not None or args.name == RECOMMEND):
        raise InputError(f"{petsc_arguments[0]}: unknown option; the PETSc options of a sweep stand in its file")
    on_root(comm, lambda: check_files(petsc_arguments))
    options = PetscOptions(petsc_arguments)
    try:
        if args.name == RECOMMEND:
            code = _sweep_command().run_recommend(args, comm)
        elif sweep is not None:
            code = _sweep_command().run(sweep, args, comm)
        else:
            code = _module(args.name).run(args, comm)
    finally:
        options.close()
    return int(code or 0)


def _sweep(name: str) -> Path | None:
    return Path(name) if name.endswith(".toml") else sweeps().get(name)


def _sweep_command() -> Any:
    return importlib.import_module(".sweep.command", __package__)


def _module(name: str) -> Any:
    return importlib.import_module(".studies." + re.sub("[-.]", "_", name), __package__)
