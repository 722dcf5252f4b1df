"""`extremal hawkes SCENE`: run a scene of networks."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import run_command

if TYPE_CHECKING:
    from mpi4py import MPI


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the arguments of `extremal hawkes`."""
    run_command.add_arguments(parser, in_time=False)


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Run the scene and return the exit code (collective)."""
    return run_command.run_scene("hawkes", args, petsc_arguments, comm)
