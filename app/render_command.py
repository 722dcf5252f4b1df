"""`extremal render RESULTS`: a picture of every frame, volumes, a film."""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .arguments import positive, whole
from .errors import EXIT_FINISHED, InputError
from .parallel import on_root
from .results import RECORD

if TYPE_CHECKING:
    from mpi4py import MPI

PICTURES = "pictures"
SMALLEST, LARGEST = 16, 8192  # pixels
SAMPLES = 16
MOST_SAMPLES = 100_000
# options that mean something for a run of one part only
ONLY = {"elastic": ("field",), "snow": ("preview", "samples", "extinction", "cell_size", "vdb")}

WITHOUT = {
    "preview": ("samples", "extinction", "cell_size"),
    "vdb": ("samples", "extinction", "preview", "film", "view"),
    "flat": ("samples", "extinction", "cell_size", "vdb", "view"),
}
FINEST, COARSEST = 0.1, 10.0  # cells of a grid of density over those of the run


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the arguments of `extremal render`."""
    parser.add_argument("results", metavar="RESULTS", type=Path, help="results folder of an elastic run or of snow")
    parser.add_argument(
        "-o", "--output", metavar="DIR", type=Path, help=f"folder for the pictures; default RESULTS/{PICTURES}"
    )
    parser.add_argument("--size", metavar="WxH", type=size, default=(960, 720), help="pixels; default 960x720")
    parser.add_argument("--every", metavar="N", type=whole(), default=1, help="only each Nth frame")
    parser.add_argument(
        "--view", metavar="A,E", type=direction, help="azimuth and elevation of the eye [degrees]; default: chosen"
    )
    parser.add_argument("--film", metavar="R", type=positive(1000), help="also a film, R frames a second")
    parser.add_argument("--field", metavar="NAME", help="elastic: colour by this field; default smallest_stretch")
    parser.add_argument("--preview", action="store_true", help="snow: quick pictures, seconds each, no extra library")
    parser.add_argument(
        "--samples",
        metavar="N",
        type=whole(1, MOST_SAMPLES),
        help=f"snow: paths of light for each pixel; default {SAMPLES}",
    )
    parser.add_argument(
        "--extinction", metavar="S", type=positive(), help="snow: extinction coefficient [1/m]; default 724 (7.8)"
    )
    parser.add_argument(
        "--cell-size", metavar="H", type=positive(), help="snow: of the grid of density [m]; default that of the run"
    )
    parser.add_argument("--vdb", action="store_true", help="snow: density as OpenVDB instead of pictures")


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Draw the pictures on rank 0."""
    on_root(comm, lambda: _render(args))
    return EXIT_FINISHED


def _render(args: argparse.Namespace) -> None:
    from .frames import frame_list

    record = _record(args.results)
    _refuse(args, record)
    all_frames = [(time, args.results / file) for time, file in frame_list(args.results)]
    if not all_frames:
        raise InputError(f"{args.results}: has no frame")
    folder = args.output or args.results / PICTURES
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; -o names a folder for the pictures")
    frames = {index: all_frames[index] for index in range(0, len(all_frames), args.every)}
    if args.vdb:
        from .render_snow import write_volumes

        print(f"{write_volumes(record, frames, folder, args.cell_size)} volumes in {folder}", flush=True)
        return
    from .pictures import draw_all, picture_name

    pictures = _pictures(args, record, all_frames)
    drawn, kept = draw_all(pictures.draw, frames, pictures.settings, folder)
    words = f", {kept} of them as they were" if kept else ""
    print(f"{drawn + kept} pictures in {folder}{words}", flush=True)
    if args.film is not None:
        _film([folder / picture_name(index) for index in frames], args.film)


def _record(results: Path) -> dict[str, Any]:
    try:
        record: dict[str, Any] = json.loads((results / RECORD).read_text(encoding="utf-8"))
        part = record["part"]
        record["scene"]["output"]
    except (OSError, ValueError):
        raise InputError(f"{results}: is no results folder; {RECORD} cannot be read") from None
    except (KeyError, TypeError):
        raise InputError(f"{results}: {RECORD} is not the record of a run") from None
    if part not in ONLY:
        raise InputError(f"{results}: holds a run of {part}; only elastic runs and runs of snow have pictures")
    return record


def _refuse(args: argparse.Namespace, record: Mapping[str, Any]) -> None:
    """Refuse options that would have no effect, and cells that would fill the memory."""
    part, grid = record["part"], record["scene"].get("grid")
    given = {name for name, value in vars(args).items() if value}

    def check(names: Sequence[str], why: str) -> None:
        for name in sorted(given & set(names)):
            raise InputError(f"--{name.replace('_', '-')}: {why}; leave it out")

    for other, names in ONLY.items():
        if other != part:
            check(names, "has no effect on " + ("an elastic run" if part == "elastic" else "a run of snow"))
    for quick in given & {"preview", "vdb"}:
        check(WITHOUT[quick], f"has no effect with --{quick}")
    if grid and grid["dimension"] == 2:
        check(WITHOUT["flat"], "has no effect on snow in the plane")
    if args.cell_size:
        h = grid["cell_size"] / record["scene"]["scale"]
        if not FINEST * h <= args.cell_size <= COARSEST * h:
            raise InputError(f"--cell-size: {args.cell_size:g}: must be from {FINEST * h:g} to {COARSEST * h:g} [m]")


def _pictures(args: argparse.Namespace, record: Mapping[str, Any], frames: Sequence[tuple[float, Path]]) -> Any:
    if record["part"] == "elastic":
        from .render_elastic import ElasticPictures

        return ElasticPictures(record, args.results, frames, args.size, args.field, args.view)
    from .path_tracing import EXTINCTION
    from .render_snow import SnowPictures

    quick = args.preview or record["scene"]["grid"]["dimension"] == 2
    paths = 0 if quick else args.samples or SAMPLES
    extinction = args.extinction or EXTINCTION
    return SnowPictures(record, args.results, frames, args.size, paths, extinction, args.cell_size, args.view)


def _film(pictures: Sequence[Path], frames_a_second: float) -> None:
    from .pictures import FILM, film

    path = film(pictures, frames_a_second)
    if path is not None:
        print(path, flush=True)
    else:
        here = pictures[0].parent
        source = f"-framerate {frames_a_second:g} -pattern_type glob -i '{here}/frame_*.png'"
        print("no film: ffmpeg is not installed; apt install ffmpeg, then repeat this command, or run", flush=True)
        print(f"    ffmpeg {source} -pix_fmt yuv420p '{here / FILM}'", flush=True)


def size(text: str) -> tuple[int, int]:
    """Read a size such as 960x720."""
    found = re.fullmatch(r"(\d+)x(\d+)", text)
    if found is None or not all(SMALLEST <= int(number) <= LARGEST for number in found.groups()):
        raise argparse.ArgumentTypeError(f"{text}: must be width x height from {SMALLEST} to {LARGEST}, as 960x720")
    return int(found[1]), int(found[2])


def direction(text: str) -> tuple[float, float]:
    """Read a direction such as -60,20."""
    try:
        azimuth, elevation = (float(part) for part in text.split(","))
    except ValueError:
        azimuth = elevation = math.nan
    if not (-360 <= azimuth <= 360 and -89 <= elevation <= 89):
        raise argparse.ArgumentTypeError(
            f"{text}: must be azimuth,elevation in degrees, from -360 to 360 and from -89 to 89, as -60,20"
        )
    return azimuth, elevation
