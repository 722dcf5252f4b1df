"""`extremal elastic SCENE`: run a scene of invertible elasticity."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .elastic_scene import ElasticScene
from .errors import InputError
from .options import PetscOptions, check_files
from .parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the arguments of `extremal elastic`."""
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
    parser.add_argument(
        "--steps",
        metavar="N",
        type=step_count,
        help="do the run in N steps (instead of [analysis] time_step)",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress, only notes and the end")


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Run the scene and return the exit code (collective)."""
    on_root(comm, lambda: check_files(petsc_arguments))
    # Before anything else: dolfinx, too, would initialise PETSc, without the user's options.
    options = PetscOptions(petsc_arguments)
    try:
        from .scene import load_scene

        scene = load_scene(args.scene, comm)
        folder = args.output or Path("results") / Path(args.scene).stem
        restart = None if args.restart is None else Path(args.restart or folder)
        on_root(comm, lambda: check_folder(folder, restart, args.overwrite))
        if args.steps is not None:
            scene = in_steps(scene, args.steps)
        options.add_scene(scene.petsc)
        return _solve(scene, folder, restart, args, options, comm)
    finally:
        options.close()


def _solve(
    scene: ElasticScene,
    folder: Path,
    restart: Path | None,
    args: argparse.Namespace,
    options: PetscOptions,
    comm: MPI.Comm,
) -> int:
    # Loaded last: these bring dolfinx and gmsh, which a scene with an error never needs.
    from petsc4py import PETSc

    from . import session
    from .elastic import build

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


def step_count(text: str) -> int:
    """Read a number of steps."""
    try:
        count = int(text)
    except ValueError:
        count = 0
    if not 1 <= count <= 10_000_000:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of steps, 1 or more")
    return count


def in_steps(scene: ElasticScene, count: int) -> ElasticScene:
    """Return the scene with its time divided into `count` equal steps."""
    step = scene.analysis.end_time / count
    given = {key: value for key, value in scene.analysis.given().items() if key not in ("smallest_step",)}
    analysis = type(scene.analysis)(**given | {"time_step": step, "largest_step": step})
    return scene.model_copy(update={"analysis": analysis})


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
