"""`extremal study table-3.1`: the continuous method (3.5) beside the likelihood (3.1) and the discrete method (3.7).

N = 40 events of 4 agents, 4 of them without participants. Scores of (3.1) and (3.7) are the sums (3.26) over all ways
of filling in what is missing. Ranks share the runs; any number of them gives the same table.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from . import _network_table as output

if TYPE_CHECKING:
    from mpi4py import MPI

NAME = "table-3.1"
RUNS, QUICK = 10_000, 200
SOURCE = {
    "(3.1)": (47.3, 68.1, 79.8, 87.7, 94.0),
    "(3.5)": (47.1, 68.1, 79.7, 87.6, 94.1),
    "(3.7)": (47.0, 68.1, 79.7, 87.6, 94.0),
}
DIGIT = 0.05  # the source rounds to 0.1 per cent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare number of runs and seed."""
    output.add_arguments(parser, NAME, RUNS)


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Make the runs and write the table (collective)."""
    if args.quick:
        args.runs = min(args.runs, QUICK)
    cells = table(comm, args.runs, args.seed)
    note = (
        f"{args.runs:,} runs, seed {args.seed}; ± is half the 95% confidence interval over runs; in brackets the "
        "source's number, and `outside` where it cannot lie in that interval."
    )
    on_root(comm, lambda: output.publish(args, NAME.replace("-", "_").replace(".", "_"), cells, note))
    return EXIT_FINISHED


def table(comm: MPI.Comm, runs: int, seed: int) -> list[output.Cell]:
    """The cells, method by method (collective)."""
    import numpy as np

    from extremal.hawkes.enumeration import energy_scores, scores_by_enumeration
    from extremal.hawkes.scores import top

    from ._network_runs import Data, complete_network, continuous, ranks_of_methods, seed_of, spread

    data = Data(complete_network(4), events=40, incomplete=4, mode="both")
    methods = (scores_by_enumeration, continuous, energy_scores)
    ranks = spread(comm, runs, lambda run: ranks_of_methods(data, seed_of(seed, run), methods))
    label = np.repeat(np.arange(runs), data.incomplete)
    return [
        output.Cell("", method, k + 1, top(ranks[:, m].ravel(), k + 1, label), percent, DIGIT)
        for m, (method, row) in enumerate(SOURCE.items())
        for k, percent in enumerate(row)
    ]
