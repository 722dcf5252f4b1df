"""Running a scene of any part: `extremal elastic SCENE`, `extremal snow SCENE`, `extremal hawkes SCENE`."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from .arguments import whole
from .errors import InputError
from .options import PetscOptions, check_files
from .parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI


class TimedScene(Protocol):
    """A scene with [analysis]."""

    @property
    def analysis(self) -> Any:
        """Its times and steps."""

    def model_copy(self, *, update: dict[str, Any]) -> Any:
        """Return a copy with other values."""


S = TypeVar("S", bound=TimedScene)


def add_arguments(parser: argparse.ArgumentParser, in_time: bool = True) -> None:
    """Declare the arguments which the commands of all parts take; some only where scenes run in time."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        type=Path,
        help="results folder; default results/<scene>",
    )
    parser.add_argument(
        "--restart",
        nargs="?",
        metavar="FROM",
        const="",
        help="continue from the last checkpoint of the results folder, or of the folder or file FROM",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace earlier results in the folder")
    if in_time:
        parser.add_argument(
            "--steps",
            metavar="N",
            type=whole(1, 10_000_000, "number of steps"),
            help="do the run in N steps (instead of [analysis] time_step)",
        )
    parser.add_argument("--quiet", action="store_true", help="no progress, only notes and the end")


def run_scene(
    part: str,
    args: argparse.Namespace,
    petsc_arguments: Sequence[str],
    comm: MPI.Comm,
    changed: Callable[[Any], Any] = lambda scene: scene,
) -> int:
    """Run a scene and return the exit code (collective).

    Parameters
    ----------
    part : str
        The command, the scene's part, the prefix of its PETSc options, and the module whose `build(scene, comm)`
        makes the problem.
    changed : callable, optional
        Returns the scene with what the command's own options change in it.
    """
    on_root(comm, lambda: check_files(petsc_arguments))
    # Before anything else: dolfinx, too, would initialise PETSc, without the user's options.
    options = PetscOptions(petsc_arguments, prefix=f"{part}_")
    try:
        from .scene import load_scene

        scene = load_scene(args.scene, comm)
        if scene.part != part:
            raise InputError(f'{args.scene}: part = "{scene.part}": write extremal {scene.part} {args.scene}')
        folder = args.output or Path("results") / Path(args.scene).stem
        restart = None if args.restart is None else Path(args.restart or folder)
        on_root(comm, lambda: check_folder(folder, restart, args.overwrite))
        if getattr(args, "steps", None) is not None:
            scene = in_steps(scene, args.steps)
        options.add_scene(scene.petsc)
        return _solve(changed(scene), folder, restart, args, options, comm)
    finally:
        options.close()


def _solve(
    scene: Any,
    folder: Path,
    restart: Path | None,
    args: argparse.Namespace,
    options: PetscOptions,
    comm: MPI.Comm,
) -> int:
    # Loaded last: a part brings its libraries, which a scene with an error never needs.
    from petsc4py import PETSc

    from . import session

    build = importlib.import_module(f".{scene.part}", __package__).build
    try:
        problem = build(scene, comm)
        outcome = session.run(
            problem, scene, folder, restart=restart, scene_path=Path(args.scene), quiet=args.quiet
        )
    except PETSc.Error as error:
        raise options.refusal(error) or error from None
    line = options.unused_line()
    if line is not None and comm.rank == 0:
        print(f"extremal: {line}", file=sys.stderr, flush=True)
    return outcome.exit_code


def in_steps(scene: S, count: int) -> S:
    """Return the scene with its time divided into `count` equal steps."""
    step = scene.analysis.end_time / count
    given = {key: value for key, value in scene.analysis.given().items() if key not in ("smallest_step",)}
    analysis = type(scene.analysis)(**given | {"time_step": step, "largest_step": step})
    copy: S = scene.model_copy(update={"analysis": analysis})
    return copy


def check_folder(folder: Path, restart: Path | None, overwrite: bool) -> None:
    """Refuse a results folder in which something would be lost (rank 0, before anything is computed).

    Raises
    ------
    InputError
        Saying which options decide what happens to the earlier results.
    """
    if restart is not None and overwrite:
        raise InputError("--overwrite: contradicts --restart; leave one of them out")
    if restart is not None and not restart.exists():
        raise InputError(f"--restart: {restart}: no such results folder or checkpoint")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; -o names a folder for the results")
    if folder.is_dir() and any(folder.iterdir()) and restart is None and not overwrite:
        raise InputError(
            f"{folder}: is not empty; give --restart to continue it, --overwrite to replace it, "
            "or another folder by -o"
        )
    existing = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
    if not existing.is_dir():
        raise InputError(f"{folder}: {existing} is a file; -o names a folder for the results")
    if not os.access(existing, os.W_OK):
        raise InputError(f"{folder}: {existing} may not be written; give another folder by -o")
