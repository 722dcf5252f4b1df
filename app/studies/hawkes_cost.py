"""`extremal study hawkes-cost`: what (3.5) and simulation cost on one core, beside what others take.

At 1,600 slots (table 3.2's 9 agents, 200 incomplete events): ours to a proven relative gap of 1e-8, with five sweeps
before TAO as by default, and with so many that TAO has nothing left to do; scipy's L-BFGS-B in TAO's variables until
its energy is within 1e-8 of the maximum, by the matrices A_i of (3.20) in NumPy, and by our recursions; Clarabel on the
cone program. Then ours alone with hundreds of thousands and millions of slots, each in a process of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..arguments import whole
from ..errors import EXIT_FINISHED, InputError
from ._process import report_of
from ._table import aligned, machine, make_folder, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

    from extremal.hawkes.slots import Slots

PEERS = Path("build/peers")
GAP = 1e-8
SWEEPS = (5, 20)
# events, gap, most seconds, most bytes
SCALES = ((98_000, 1e-8, 4.0, None), (202_000, 1e-6, 2.5, None), (1_010_000, 1e-6, None, 4e9))
TIMELINES = (6, 36)  # of the simulations
EVENTS = 100_000
COLUMNS = ("quantity", "unit", "ours", "theirs", "ratio", "target", "met", "note")
Row = dict[str, str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare where the neighbours are."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/hawkes-cost"))
    parser.add_argument("--seed", metavar="N", type=whole(0), default=1, help="of all random numbers (1)")
    parser.add_argument(
        "--peers", metavar="DIR", type=Path, default=PEERS, help=f"folder of the neighbours' venvs ({PEERS})"
    )
    parser.add_argument("--quick", action="store_true", help="a few hundred slots, 10,000 at most")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Measure, write hawkes_cost.csv and print the table."""
    if comm.size > 1:
        raise InputError("study hawkes-cost: measures one core; run it without mpirun")
    make_folder(args.output)
    rows = [*solvers(args.seed, args.peers, args.quick), *simulation(args.peers, args.quick)]
    rows += scales(args.seed, args.quick)
    table = args.output / "hawkes_cost.csv"
    write_rows(table, COLUMNS, rows)
    print(machine())
    print(aligned(COLUMNS[:-1], [[row[name] for name in COLUMNS[:-1]] for row in rows]))
    print(*(f"\n{row['quantity']}: {row['note']}" for row in rows if row["note"]), sep="")
    print(table, flush=True)
    return EXIT_FINISHED


def _row(quantity: str, unit: str, ours: float, theirs: float | None, target: str, met: bool | None, note: str) -> Row:
    return {
        "quantity": quantity,
        "unit": unit,
        "ours": f"{ours:.3g}",
        "theirs": "" if theirs is None else f"{theirs:.3g}",
        "ratio": "" if theirs is None else f"{theirs / ours:.3g}",
        "target": target,
        "met": "" if met is None else ("yes" if met else "no"),
        "note": note,
    }


def _against(quantity: str, unit: str, ours: float, theirs: float | None, least: float | None, note: str) -> Row:
    target = "" if least is None else f"ratio >= {least:g}"
    met = None if theirs is None or least is None else theirs / ours >= least
    return _row(quantity, unit, ours, theirs, target, met, note)


def _best(action: Callable[[], Any], repetitions: int) -> float:
    """Least seconds of the processor."""
    times = []
    for _ in range(repetitions):
        began = time.process_time()
        action()
        times.append(time.process_time() - began)
    return min(times)


# ---------------------------------------------------------------------- one problem, three solvers


def solvers(seed: int, peers: Path, quick: bool) -> list[Row]:
    """Ours beside L-BFGS-B and Clarabel on the same problem."""
    from extremal.hawkes.energy import Energy
    from extremal.hawkes.reconstruct import reconstruct

    from ._network_runs import Data, complete_network, seed_of

    data = Data(complete_network(5), 100, 50) if quick else Data(complete_network(9), 400, 200)
    slots, _ = data.slots(seed_of(seed))
    best = reconstruct(slots, gap=1e-12).energy
    theirs: list[tuple[str, float | None, float | None, str]] = []
    for name, couple, least in (("", matrices(slots), 20), (", our gradient", Energy(slots).couple, None)):
        taken, missing = bounded(slots, couple, best)
        note = f"energy {missing:.1e} (relative) below the maximum when stopped."
        theirs.append((f"L-BFGS-B{name}", taken, least, note))
    seconds, note = _clarabel(peers, slots, best)
    theirs.append(("Clarabel", seconds, 1000, note))
    rows = []
    for sweeps in SWEEPS:
        ours = _best(partial(reconstruct, slots, gap=GAP, sweeps=sweeps), 10)
        what = f"(3.5), {len(slots):,} slots, {sweeps} sweeps"
        for peer, seconds, wanted, note in theirs:
            rows.append(_against(f"{what}, beside {peer}", "s", ours, seconds, wanted, note))
    return rows


def matrices(slots: Slots) -> Callable[[NDArray], NDArray]:
    """x -> 2 A x by the symmetric matrices A_i of (3.20), shape (K, n, n)."""
    import numpy as np

    time = slots.events.time[slots.event]
    ω = slots.network.decay[:, None, None]
    A = 0.5 * slots.coupling[:, None, None] * np.exp(-ω * np.abs(time[:, None] - time))
    A[:, np.arange(len(time)), np.arange(len(time))] = 0.0
    place = slots.pair, slots.column
    X = np.zeros((len(A), len(time), 1))  # (3.19)

    def couple(x: NDArray) -> NDArray:
        X[(*place, 0)] = x
        return 2 * (A @ X)[(*place, 0)]

    return couple


class Reached(Exception):
    """As good as ours."""


def bounded(slots: Slots, couple: Callable[[NDArray], NDArray], best: float) -> tuple[float, float]:
    """Seconds of L-BFGS-B on z >= 0, x_j = z_j/|z_j|, and how far its energy is below `best`, relative."""
    import numpy as np
    from scipy.optimize import minimize

    begin, length = slots.start[:-1], np.diff(slots.start)
    value = 0.0

    def negative(z: NDArray) -> tuple[float, NDArray]:
        nonlocal value
        size = np.repeat(np.sqrt(np.add.reduceat(z * z, begin)), length)
        x = z / size
        g = slots.linear + couple(x)
        value = 0.5 * float(x @ (slots.linear + g))
        if value >= best * (1 - GAP):
            raise Reached
        along = np.repeat(np.add.reduceat(x * g, begin), length)
        return -value, (along * x - g) / size

    def solve() -> None:
        options = {"maxiter": 10_000, "maxfun": 20_000, "ftol": 0.0, "gtol": 0.0}
        bounds = [(0, None)] * len(slots)
        with contextlib.suppress(Reached):
            minimize(negative, slots.uniform(), jac=True, method="L-BFGS-B", bounds=bounds, options=options)

    return _best(solve, 3), 1 - value / best


def _clarabel(peers: Path, slots: Slots, best: float) -> tuple[float | None, str]:
    """Seconds of Clarabel, or None, and a sentence about it."""
    import numpy as np

    python = peers / "clarabel" / "bin" / "python"
    if not python.exists():
        return None, f"{python} is not there; `make bench` installs it."
    given = {
        "time": slots.events.time[slots.event][slots.column],
        "pair": slots.pair,
        "event": slots.column,
        "b": slots.linear,
        "coupling": slots.coupling[slots.pair],
        "decay": slots.network.decay[slots.pair],
    }
    with tempfile.TemporaryDirectory(prefix="extremal-") as folder:
        path = Path(folder) / "problem.npz"
        np.savez(path, **given)
        report, words = report_of([str(python), str(Path(__file__).with_name("_clarabel_network.py")), str(path)])
    if report is None:
        return None, f"did not run: {words}"
    missing = 1 - report["energy"] / best
    return report["seconds"], (
        f"version {report['version']}, {report['cones']:,} cones; energy {missing:.1e} (relative) below the maximum."
    )


# ---------------------------------------------------------------------- simulation


def simulation(peers: Path, quick: bool) -> list[Row]:
    """Microseconds an event, beside tick's, whose timelines may excite each other."""
    from extremal.hawkes.events import Network
    from extremal.hawkes.simulate import simulate

    from .table_3_2 import surrogate

    python = peers / "tick" / "bin" / "python"
    rows = []
    events = EVENTS // 10 if quick else EVENTS
    whole = surrogate()
    for timelines in TIMELINES:
        parameters = (v[:timelines] for v in (whole.background, whole.branching, whole.decay))
        network = Network(whole.agents, whole.pairs[:timelines], *parameters)
        ours = _best(partial(simulate, network, count=events, seed=1), 5) / events
        theirs, note = None, f"{python} is not there; `make bench` installs it."
        if python.exists():
            script = Path(__file__).with_name("_tick_network.py")
            report, words = report_of([str(python), str(script), str(timelines), str(events)])
            if report is None:
                note = f"tick did not run: {words}"
            else:
                theirs = 1e6 * report["seconds_per_event"]
                note = f"version {report['version']}; its cost grows with the square of the timelines, ours does not."
        what = f"simulation, {timelines} timelines, beside tick"
        rows.append(_against(what, "µs/event", 1e6 * ours, theirs, None, note))
    return rows


# ---------------------------------------------------------------------- scale


def scales(seed: int, quick: bool) -> list[Row]:
    """Ours with many slots: seconds of the processor and peak memory."""
    rows = []
    for events, gap, most_seconds, most_bytes in ((2_000, 1e-8, 4.0, None),) if quick else SCALES:
        command = [sys.executable, "-m", "extremal.app.studies._network_scale", str(events), str(gap), str(seed)]
        report, words = report_of(command)
        if report is None:
            rows.append(_row(f"(3.5), {events:,} incomplete events", "", float("nan"), None, "", False, words))
            continue
        what = f"(3.5), {report['slots']:,} slots, gap {gap:.0e}"
        note = f"simulation and slots {report['before']:.2g} s before; proven gap {report['relative_gap']:.1e}."
        rows.append(_limited(f"{what}: time", "s", report["seconds"], most_seconds, note))
        rows.append(_limited(f"{what}: peak memory", "GB", report["bytes"] / 1e9, most_bytes and most_bytes / 1e9, ""))
    return rows


def _limited(quantity: str, unit: str, ours: float, most: float | None, note: str) -> Row:
    if most is None:
        return _row(quantity, unit, ours, None, "", None, note)
    return _row(quantity, unit, ours, None, f"<= {most:g} {unit}", ours <= most, note)
