"""`extremal render RESULTS`: a picture of every frame of a run of snow."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import EXIT_FINISHED, InputError
from .parallel import on_root
from .results import RECORD, atomic

if TYPE_CHECKING:
    from mpi4py import MPI

PICTURES = "pictures"
SMALLEST, LARGEST = 16, 8192  # pixels


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the arguments of `extremal render`."""
    parser.add_argument("results", metavar="RESULTS", type=Path, help="results folder of a run of snow")
    parser.add_argument(
        "-o", "--output", metavar="DIR", type=Path, help=f"folder for the pictures; default RESULTS/{PICTURES}"
    )
    parser.add_argument("--size", metavar="WxH", type=size, default=(960, 720), help="pixels; default 960x720")
    parser.add_argument("--every", metavar="N", type=count, default=1, help="only each Nth frame")


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Draw the pictures on rank 0."""
    on_root(comm, lambda: _render(args.results, args.output or args.results / PICTURES, args.size, args.every))
    return EXIT_FINISHED


def _render(results: Path, folder: Path, size: tuple[int, int], every: int) -> None:
    try:
        record = json.loads((results / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InputError(f"{results}: is no results folder; {RECORD} cannot be read") from None
    if record.get("part") != "snow":
        raise InputError(f"{results}: holds a run of {record.get('part')}; only runs of snow are rendered")
    from matplotlib import image as images

    from .frames import frame_list
    from .snow_summary import overall_bounds, picture, read_frame, stage

    frames = frame_list(results)
    if not frames:
        raise InputError(f"{results}: has no frame")
    folder.mkdir(parents=True, exist_ok=True)
    seen, bounds = stage(record, results), overall_bounds(results)
    for index in range(0, len(frames), every):
        path = folder / f"frame_{index:05d}.png"
        with atomic(path) as partial:
            images.imsave(partial, picture(read_frame(results, frames[index]), seen, bounds, size), format="png")
    print(f"{len(range(0, len(frames), every))} pictures in {folder}", flush=True)


def size(text: str) -> tuple[int, int]:
    """Read a size such as 960x720."""
    found = re.fullmatch(r"(\d+)x(\d+)", text)
    if found is None or not all(SMALLEST <= int(number) <= LARGEST for number in found.groups()):
        raise argparse.ArgumentTypeError(f"{text}: must be width x height from {SMALLEST} to {LARGEST}, as 960x720")
    return int(found[1]), int(found[2])


def count(text: str) -> int:
    """Read a whole number above 0."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number, 1 or more")
    return int(text)
