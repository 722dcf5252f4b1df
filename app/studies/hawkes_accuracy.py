"""`extremal study hawkes-accuracy`: what accuracy costs, method by method and solver by solver.

Two kinds of data: many small sets, whose 6^8 allocations can be summed exactly, and one large set with parameters that
differ from pair to pair. Seconds are the processor's, on one core, without the making of slots. Flips are events whose
first candidate is another than in the limit of the same method: (3.5) at a gap of 1e-12, mean field after many rounds,
the exact posterior or else the longest sampling with another seed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from . import _network_table as output
from ._table import aligned, machine, make_folder, petsc_options, write_rows

if TYPE_CHECKING:
    import numpy as np
    from mpi4py import MPI
    from numpy.typing import NDArray

    from extremal.hawkes.events import Network
    from extremal.hawkes.slots import Slots

NAME = "hawkes-accuracy"
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
SOLVERS = ("sweeps", "blmvm", "bqnls", "bncg", "tron")
ROUNDS = (1, 2, 3, 4, 5)
SAMPLES = (1, 3, 10, 30, 100, 300)
LIMIT, LIMIT_ROUNDS = 1e-12, 200
COLUMNS = (
    "data", "slots", "method", "setting", "seconds", "top_1", "low", "high", "flips", "events", "relative_gap",
)  # fmt: skip
RUNS = 500


@dataclass(frozen=True)
class Set:
    """One simulation: its incomplete events' slots, those of all events, the truth."""

    slots: Slots
    all_slots: Slots
    truth: NDArray
    seed: np.random.SeedSequence


Method = Callable[[Set], "NDArray"]  # a value for each slot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare number of small sets and seed."""
    output.add_arguments(parser, NAME, RUNS)


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Measure on rank 0, write hawkes_accuracy.csv and .png and print the table."""
    if args.quick:
        args.runs = min(args.runs, 3)
    on_root(comm, lambda: _run(args))
    return EXIT_FINISHED


def _run(args: argparse.Namespace) -> None:
    make_folder(args.output)
    rows: list[dict[str, Any]] = []
    for name, sets in data(args.runs, args.seed, args.quick).items():
        rows += measure(name, sets, SAMPLES[:3] if args.quick else SAMPLES)
    table_file, picture = (args.output / f"hawkes_accuracy.{kind}" for kind in ("csv", "png"))
    write_rows(table_file, COLUMNS, rows)
    draw(picture, rows)
    print(machine())
    print(table(rows))
    print(table_file, picture, flush=True)


def data(runs: int, seed: int, quick: bool) -> dict[str, list[Set]]:
    """The small sets and the large one."""
    return {
        f"{runs} small sets": small_sets(runs, seed),
        "one large set": [large_set(400 if quick else 20_000, seed)],
    }


def small_sets(runs: int, seed: int) -> list[Set]:
    """Four agents, 40 events, 8 of them incomplete: the 6^8 allocations can be summed."""
    from ._network_runs import complete_network, seed_of

    return [_set(complete_network(4), 40, 8, "both", seed_of(seed, 0, run)) for run in range(runs)]


def large_set(events: int, seed: int) -> Set:
    """Nine agents whose pairs have parameters of their own; half of the events have lost one participant."""
    import numpy as np

    from extremal.hawkes.events import Network

    from ._network_runs import seed_of

    network = Network.complete(9, 0.01, 0.5, 0.1)
    random = np.random.default_rng(seed)
    spread = (np.exp(random.normal(0, 0.7, len(network))) for _ in range(2))
    parameters = (0.01 * next(spread), random.uniform(0.2, 0.8, len(network)), 0.1 * next(spread))
    return _set(network.with_parameters(*parameters), events, events // 2, "one", seed_of(seed, 1))


def _set(network: Network, events: int, incomplete: int, mode: str, seed: np.random.SeedSequence) -> Set:
    from mpi4py import MPI

    from extremal.hawkes.slots import Slots

    from ._network_runs import Data

    slots, truth = Data(network, events, incomplete, mode).slots(seed)
    return Set(slots, Slots.build(MPI.COMM_SELF, network, slots.events, complete=True), truth, seed)


# ---------------------------------------------------------------------- methods


def methods(small: bool, samples: Sequence[int]) -> Iterator[tuple[str, str, Method, Method]]:
    """Method, its setting, how to solve, and how to solve in the limit."""
    for solver in SOLVERS:
        for tolerance in TOLERANCES:
            name = f"(3.5), {solver.upper() if solver != 'sweeps' else solver}"
            yield name, f"gap {tolerance:.0e}", continuous(solver, tolerance), continuous("sweeps", LIMIT)
    yield "(3.7)", "closed form", discrete, discrete
    for rounds in ROUNDS:
        yield "mean field", f"{rounds} rounds", mean_field_rounds(rounds), mean_field_rounds(LIMIT_ROUNDS)
    for count in samples:
        limit = enumerated if small else sampled(samples[-1], other=1)
        yield "Gibbs", f"{count} sweeps", sampled(count), limit
    if small:
        yield "enumeration (3.1)", "exact", enumerated, enumerated


def continuous(solver: str, tolerance: float, before: int = 5) -> Method:
    """(3.5) to a proven relative gap, by a type of TAO after sweeps `before`, or by sweeps alone."""

    def solve(one: Set) -> NDArray:
        from extremal.hawkes.energy import Energy
        from extremal.hawkes.reconstruct import reconstruct

        if solver != "sweeps":
            with petsc_options("hawkes_", {"tao_type": solver}):
                return reconstruct(one.slots, gap=tolerance, sweeps=before).weights
        energy, x = Energy(one.slots), one.slots.uniform()
        while True:
            x = energy.sweep(x)
            g = energy.gradient(x)
            if energy.gap(x, g) <= tolerance * energy.value(x, g):
                return x

    return solve


def mean_field_rounds(rounds: int) -> Method:
    """Mean field, so many rounds."""

    def solve(one: Set) -> NDArray:
        from extremal.hawkes.meanfield import mean_field, of_incomplete

        return of_incomplete(one.all_slots, one.slots, mean_field(one.all_slots, sweeps=rounds))

    return solve


def sampled(sweeps: int, other: int = 0) -> Method:
    """Gibbs sampling, so many sweeps of one chain; `other` chooses the random numbers."""

    def solve(one: Set) -> NDArray:
        from extremal.hawkes.gibbs import gibbs

        seed = int(one.seed.generate_state(2)[other])
        return gibbs(one.slots, sweeps=sweeps, burn_in=max(1, sweeps // 5), seed=seed, chains=1)

    return solve


def discrete(one: Set) -> NDArray:
    """Method (3.7)."""
    from extremal.hawkes.enumeration import energy_scores

    return energy_scores(one.slots)


def enumerated(one: Set) -> NDArray:
    """The exact posterior."""
    from extremal.hawkes.enumeration import scores_by_enumeration

    return scores_by_enumeration(one.slots, compensator=True)


# ---------------------------------------------------------------------- measuring


def measure(name: str, sets: Sequence[Set], samples: Sequence[int]) -> list[dict[str, Any]]:
    """A row for each method and setting: seconds a set, share of first places, flips."""
    import numpy as np

    from extremal.hawkes.energy import Energy
    from extremal.hawkes.reconstruct import ReconstructionError
    from extremal.hawkes.scores import ranks_of_truth, top

    small = len(sets) > 1 or sets[0].slots.count < 20
    limits: dict[str, list[NDArray]] = {}
    rows: list[dict[str, Any]] = []
    for method, setting, solve, limit in methods(small, samples):
        family = method.partition(",")[0]
        if family not in limits:
            limits[family] = [first(one.slots, limit(one)) for one in sets]
        try:
            seconds, answers = timed(solve, sets)
        except ReconstructionError as error:
            rows.append({"data": name, "method": method, "setting": f"{setting}: {error}"})
            continue
        solved = list(zip(sets, answers))
        flips = sum(int((first(one.slots, x) != there).sum()) for (one, x), there in zip(solved, limits[family]))
        ranks = [ranks_of_truth(one.slots, x, one.truth, seed=one.seed) for one, x in solved]
        found = top(np.concatenate(ranks), 1, np.repeat(np.arange(len(sets)), [len(r) for r in ranks]))
        gaps = []
        if family == "(3.5)":
            for one, x in solved:
                energy = Energy(one.slots)
                gaps.append(energy.gap(x) / energy.value(x))
        rows.append(
            {
                "data": name,
                "slots": sum(len(one.slots) for one in sets) // len(sets),
                "method": method,
                "setting": setting,
                "seconds": f"{seconds / len(sets):.3g}",
                "top_1": f"{100 * found.share:.3f}",
                "low": f"{100 * found.low:.3f}",
                "high": f"{100 * found.high:.3f}",
                "flips": flips,
                "events": found.events,
                "relative_gap": f"{max(gaps):.2g}" if gaps else "",
            }
        )
    return rows


def timed(solve: Method, sets: Sequence[Set]) -> tuple[float, list[NDArray]]:
    """Least seconds of the processor, of up to three times, and the answers."""
    best, spent = float("inf"), 0.0
    answers: list[NDArray] = []
    for _ in range(3):
        began = time.process_time()
        answers = [solve(one) for one in sets]
        seconds = time.process_time() - began
        best, spent = min(best, seconds), spent + seconds
        if spent > 3.0:
            break
    return best, answers


def first(slots: Slots, values: NDArray) -> NDArray:
    """The first candidate of each event, shape (n,)."""
    import numpy as np

    largest = np.maximum.reduceat(values, slots.start[:-1])
    hit = np.flatnonzero(values == np.repeat(largest, np.diff(slots.start)))
    at = hit[np.searchsorted(hit, slots.start[:-1])]
    return slots.pair[at]


# ---------------------------------------------------------------------- showing


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    columns = ("data", "method", "setting", "slots", "seconds", "top 1 [%]", "flips", "of", "proven gap")
    keys = ("data", "method", "setting", "slots", "seconds", "top_1", "flips", "events", "relative_gap")
    return aligned(columns, [[row.get(key, "") for key in keys] for row in rows])


def draw(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Seconds against the share of first places, and against flips; a column for each kind of data.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    from matplotlib.figure import Figure

    from ..results import atomic

    kinds = list(dict.fromkeys(row["data"] for row in rows))
    solved = [row for row in rows if "seconds" in row]
    names = list(dict.fromkeys(row["method"] for row in solved))
    figure = Figure(figsize=(5.2 * len(kinds), 7.8), dpi=110, layout="constrained")
    axes = figure.subplots(2, len(kinds), squeeze=False)
    for column, kind in enumerate(kinds):
        for k, name in enumerate(names):
            mine = [row for row in solved if (row["data"], row["method"]) == (kind, name)]
            if not mine:
                continue
            seconds = [float(row["seconds"]) for row in mine]
            share = [float(row["top_1"]) for row in mine]
            flips = [100 * row["flips"] / row["events"] for row in mine]
            style = {"marker": "os^vDP*X"[k % 8], "ms": 5, "lw": 1, "color": f"C{k}", "label": name}
            axes[0, column].plot(seconds, share, **style)
            axes[1, column].plot(seconds, flips, **style)
        size, of = next((row["slots"], row["events"]) for row in solved if row["data"] == kind)
        axes[0, column].set_title(f"{kind}: {size:,} slots each, {of:,} incomplete events", fontsize=10)
        axes[0, column].set_ylabel("true pair comes first [% of events]")
        axes[1, column].set_ylabel("flips from the method's limit [% of events]")
        axes[1, column].set_yscale("symlog", linthresh=100 / of)
        axes[1, column].set_ylim(bottom=0)
        axes[1, column].set_xlabel("seconds of the processor")
        for ax in axes[:, column]:
            ax.set_xscale("log")
            ax.grid(alpha=0.3)
    lines = {line.get_label(): line for ax in axes[0] for line in ax.get_lines()}
    figure.legend(lines.values(), lines.keys(), loc="lower center", ncol=5, fontsize=8, frameon=False)
    figure.get_layout_engine().set(rect=(0, 0.06, 1, 0.94))
    axes[1, 0].text(
        0.98, 0.97, "points of a line: gap 1e-2 ... 1e-10;\n1 ... 5 rounds; increasing sweeps of Gibbs sampling",
        transform=axes[1, 0].transAxes, ha="right", va="top", fontsize=7,
    )  # fmt: skip
    with atomic(path) as partial:
        figure.savefig(partial, format="png")
