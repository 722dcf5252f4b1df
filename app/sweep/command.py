"""`extremal study NAME_OR_FILE.toml` and `extremal study recommend SCENE`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ..arguments import positive, whole
from ..errors import EXIT_FINISHED, EXIT_SOLVER, InputError
from ..parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of a sweep."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, help="default results/studies/NAME, or NAME-quick")
    parser.add_argument("-j", "--jobs", metavar="N", type=whole(1, 1024), default=1, help="points at once (1)")
    parser.add_argument("--ranks", metavar="R", type=whole(1, 1024), help="run each point under mpirun with R ranks")
    parser.add_argument("--quick", action="store_true", help="the short form")


def run(path: Path, args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run what has not been run of a sweep, write its results and say what it found (collective)."""
    return on_root(comm, lambda: _run(path, args, comm.size))


def _run(path: Path, args: argparse.Namespace, size: int) -> int:
    from ..studies._table import machine, make_folder
    from .model import load_sweep
    from .points import points_of
    from .recommend import OWN
    from .report import assemble, slopes, table, write
    from .running import How, run_points

    if size > 1:
        raise InputError(f"study {path.stem}: a sweep starts its own processes: leave mpirun out, give -j or --ranks")
    sweep = load_sweep(path)
    folder = args.output or OWN / (sweep.name + ("-quick" if args.quick else ""))
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; -o names a folder for the results")
    points = points_of(sweep, args.quick, args.ranks or 0)
    # sweeps of the same runs that look at different errors share them
    kept = args.output or OWN
    make_folder(folder)
    how = How(kept / "points", args.jobs, args.ranks or 0, sweep.timeout, sweep.repeats(args.quick))
    facts = run_points(points, how, lambda line: print(line, flush=True))
    try:
        study = assemble(sweep, facts, how.folder, args.quick)
    except ArithmeticError as error:
        print(f"{sweep.path}: {error}", file=sys.stderr)
        return EXIT_SOLVER
    write(study, folder)
    print("", machine(), table(study), slopes(study), *study["sentences"], str(folder / "study.png"), sep="\n\n")
    return EXIT_FINISHED if any("error" in row for row in study["points"]) else EXIT_SOLVER


def add_recommend_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `recommend`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file, or the name of a scene or case that has sweeps")
    wanted = parser.add_mutually_exclusive_group(required=True)
    wanted.add_argument("--error", metavar="E", type=positive(), help="relative error that is good enough, as 1e-2")
    wanted.add_argument("--seconds", metavar="S", type=positive(), help="processor seconds that may be spent")


def run_recommend(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Print what to set, and why (collective)."""
    from .recommend import recommend

    on_root(comm, lambda: print(recommend(args.scene, args.error, args.seconds), flush=True))
    return EXIT_FINISHED
