"""`extremal study table-3.2`: how well (3.5) names the unknown participant, one of the two being known.

N = 400 events on complete networks of 5, 7 and 9 agents and on one like that of Hollenbeck (29 agents, 69 rivalries,
a surrogate: the source's edges are only in its figure 2.2). Beside (3.5) as it is written stand (3.5) with half the
coupling between incomplete events, g = b + A r, and mean field. With `--posterior` also the first places of the exact
posterior, which no method can surpass in the mean. Ranks share the runs; any number of them gives the same table.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from . import _network_table as output

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.hawkes.events import Network

NAME = "table-3.2"
RUNS, QUICK = 4_000, 10
EVENTS = 400
TOPS = (1, 2, 3)
SURROGATE = 29  # agents of the network that is not complete
SOURCE = {
    (5, 50): (57, 80, 92),
    (5, 100): (56, 79, 91),
    (5, 200): (54, 76, 90),
    (7, 50): (47, 69, 82),
    (7, 100): (46, 68, 80),
    (7, 200): (45, 65, 77),
    (9, 50): (42, 62, 73),
    (9, 100): (41, 60, 72),
    (9, 200): (39, 57, 69),
    (29, 50): (50, 72, 83),
    (29, 100): (49, 71, 82),
    (29, 200): (48, 68, 80),
}
GUESSING = {5: (25, 50, 75), 7: (17, 33, 50), 9: (13, 25, 38), 29: (float("nan"),) * 3}
GUESS = "guessing"
DIGIT = 0.5  # the source rounds to whole per cent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare number of runs, seed and --posterior."""
    output.add_arguments(parser, NAME, RUNS)
    parser.add_argument("--posterior", action="store_true", help="also by Gibbs sampling: five times slower")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Make the runs and write the table (collective)."""
    if args.quick:
        args.runs = min(args.runs, QUICK)
    cells = table(comm, args.runs, args.seed, args.posterior)
    methods = dict.fromkeys(cell.method for cell in cells)
    note = (
        f"{args.runs:,} runs a row, seed {args.seed}; ± is half the 95% confidence interval over runs; in brackets the "
        "source's number, and `outside` where it cannot lie in that interval. Mean of squared differences, rooted: "
        + ", ".join(f"{method} {_deviation(cells, method):.2f}" for method in methods if method != GUESS)
        + " percentage points. * is the surrogate."
    )
    on_root(comm, lambda: output.publish(args, NAME.replace("-", "_").replace(".", "_"), cells, note))
    return EXIT_FINISHED


def table(comm: MPI.Comm, runs: int, seed: int, posterior: bool) -> list[output.Cell]:
    """The cells, row by row (collective)."""
    import numpy as np

    from extremal.hawkes.scores import guessing, top

    from . import _network_runs as ours
    from ._network_runs import Data, complete_network, ranks_of_methods, seed_of, spread

    methods = {"(3.5)": ours.continuous, "halved coupling": ours.halved, "mean field": ours.probable, GUESS: guessing}
    if posterior:
        methods["posterior"] = ours.sampled
    cells = []
    for row, ((size, incomplete), source) in enumerate(SOURCE.items()):
        network = surrogate() if size == SURROGATE else complete_network(size)
        data = Data(network, EVENTS, incomplete)

        def one(run: int, data: Data = data, row: int = row) -> np.ndarray:
            return ranks_of_methods(data, seed_of(seed, row, run), [*methods.values()])

        ranks = spread(comm, runs, one)
        label = np.repeat(np.arange(runs), incomplete)
        for m, method in enumerate(methods):
            if method == GUESS and incomplete != max(n for _, n in SOURCE):
                continue  # it does not depend on n
            case = f"k = {size}{'*' * (size == SURROGATE)}, n = {incomplete}"
            beside = GUESSING[size] if method == GUESS else source
            for k, percent in zip(TOPS, beside):
                cells.append(output.Cell(case, method, k, top(ranks[:, m].ravel(), k, label), percent, DIGIT))
    return cells


def surrogate() -> Network:
    """The network like that of Hollenbeck, with the parameters of section 3.4."""
    import numpy as np

    from extremal.hawkes.events import Network

    from ._network_runs import BACKGROUND, BRANCHING, DECAY

    path = Path(__file__).parent.parent / "scenes" / "hollenbeck_like_network.csv"
    with open(path, newline="", encoding="utf-8") as file:
        pairs = np.array([(int(row["first"]), int(row["second"])) for row in csv.DictReader(file)]) - 1
    agents = tuple(str(k + 1) for k in range(pairs.max() + 1))
    return Network(agents, pairs, *(np.float64(value) for value in (BACKGROUND, BRANCHING, DECAY)))


def _deviation(cells: list[output.Cell], method: str) -> float:
    squares = [(100 * c.found.share - c.source) ** 2 for c in cells if c.method == method]
    return (sum(squares) / len(squares)) ** 0.5
