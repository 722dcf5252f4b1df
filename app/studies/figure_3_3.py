"""`extremal study figure-3.3`: where prediction is possible, as a map over θ and τ = log10(ω/μ).

N = 400 events of 6 agents, 100 of them with one participant unknown, (3.5); the colour is the share of events whose
likeliest candidate is the true one. One in five is what guessing gives. Ranks share the runs; any number of them gives
the same map.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..arguments import whole
from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ..results import atomic
from . import _network_table as output
from ._table import make_folder, write_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mpi4py import MPI

NAME = "figure-3.3"
RUNS, QUICK = 40, 4
AGENTS, EVENTS, INCOMPLETE = 6, 400, 100
COLUMNS = ("branching", "tau", "percent", "low", "high", "runs", "seed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the map's points, number of runs and seed."""
    output.add_arguments(parser, NAME, RUNS)
    parser.add_argument("--points", metavar="N", type=whole(), default=21, help="along each side (21)")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Make the runs, write figure_3_3.csv and draw figure_3_3.png (collective)."""
    import numpy as np

    if args.quick:
        args.runs, args.points = min(args.runs, QUICK), min(args.points, 3)
    θs, τs = np.linspace(0.0, 1.0, args.points), np.linspace(-1.0, 4.0, args.points)
    rows = measure(comm, args.runs, args.seed, θs, τs)
    on_root(comm, lambda: _publish(args, rows))
    return EXIT_FINISHED


def measure(
    comm: MPI.Comm, runs: int, seed: int, θs: Sequence[float], τs: Sequence[float]
) -> list[dict[str, float]]:
    """Share of first places at each point (collective)."""
    import numpy as np

    from extremal.hawkes.events import Network
    from extremal.hawkes.scores import top

    from ._network_runs import BACKGROUND, Data, continuous, ranks_of_methods, seed_of, spread

    points = [(float(θ), float(τ)) for θ in θs for τ in τs]

    def one(number: int) -> np.ndarray:
        point, run = divmod(number, runs)
        θ, τ = points[point]
        network = Network.complete(AGENTS, BACKGROUND, θ, BACKGROUND * 10**τ)
        return ranks_of_methods(Data(network, EVENTS, INCOMPLETE), seed_of(seed, point, run), [continuous])[0]

    ranks = spread(comm, runs * len(points), one).reshape(len(points), -1)
    label = np.repeat(np.arange(runs), INCOMPLETE)
    rows = []
    for (θ, τ), of_point in zip(points, ranks):
        found = top(of_point, 1, label)
        interval = {"percent": 100 * found.share, "low": 100 * found.low, "high": 100 * found.high}
        rows.append({"branching": θ, "tau": τ, **interval, "runs": runs, "seed": seed})
    return rows


def _publish(args: argparse.Namespace, rows: list[dict[str, float]]) -> None:
    make_folder(args.output)
    table, picture = (args.output / f"figure_3_3.{kind}" for kind in ("csv", "png"))
    write_rows(table, COLUMNS, [{name: f"{value:.6g}" for name, value in row.items()} for row in rows])
    draw(picture, rows)
    shares = [row["percent"] for row in rows]
    widest = max(row["high"] - row["low"] for row in rows)
    print(
        f"{len(rows)} points, {args.runs} runs each: first place in {min(shares):.1f} to {max(shares):.1f}% of events "
        f"(guessing 20%), 95% confidence intervals at most {widest:.1f} points wide"
    )
    print(table, picture, flush=True)


def draw(path: Path, rows: list[dict[str, float]]) -> None:
    """The map, with lines of equal share.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    import numpy as np
    from matplotlib.figure import Figure

    θs, τs = (sorted({row[name] for row in rows}) for name in ("branching", "tau"))
    share = np.array([row["percent"] for row in rows]).reshape(len(θs), len(τs))
    figure = Figure(figsize=(6.2, 4.8), dpi=110, layout="constrained")
    ax = figure.subplots()
    mesh = ax.pcolormesh(τs, θs, share, shading="nearest", cmap="viridis", vmin=0, vmax=100)
    lines = ax.contour(τs, θs, share, levels=range(30, 100, 10), colors="white", linewidths=0.8)
    ax.clabel(lines, fmt="%d%%", fontsize=8)
    ax.plot(1.0, 0.5, "o", mfc="none", mec="red", label="parameters of tables 3.1 and 3.2")
    ax.set(xlabel=r"$\tau = \log_{10}(\omega/\mu)$", ylabel=r"$\theta$")
    ax.set_title(f"Likeliest pair is the true one: N = {EVENTS}, n = {INCOMPLETE}, {AGENTS} agents", fontsize=10)
    ax.legend(fontsize=8, loc="upper left")
    figure.colorbar(mesh, label="events [%]")
    with atomic(path) as partial:
        figure.savefig(partial, format="png")
