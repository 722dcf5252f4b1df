"""`extremal snow SCENE`: run a scene of snow."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import run_command
from .arguments import positive
from .snow_scene import LARGEST_SCALE, SnowScene

if TYPE_CHECKING:
    from mpi4py import MPI


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the arguments of `extremal snow`."""
    run_command.add_arguments(parser)
    parser.add_argument(
        "--scale",
        metavar="S",
        type=positive(LARGEST_SCALE),
        help="cells S times finer, particles as many times more in each direction (instead of the scene's scale)",
    )


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Run the scene and return the exit code (collective)."""

    def scaled(scene: SnowScene) -> SnowScene:
        return scene if args.scale is None else scene.model_copy(update={"scale": args.scale})

    return run_command.run_scene("snow", args, petsc_arguments, comm, scaled)
