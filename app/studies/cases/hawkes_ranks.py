"""First candidates of incomplete events: how far a method is from its own optimum, or from the exact posterior.

The data are those of `extremal study hawkes-accuracy`: small sets, whose allocations can be summed exactly, or one
large set with parameters that differ from pair to pair, whose posterior is sampled for long. Seconds are those of the
method alone: slots are there already.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

    from extremal.hawkes.slots import Slots

KEYS: dict[str, Any] = {
    "data": "large",  # "small": `sets` of 40 events, 8 incomplete; "large": one of `events`, half of them incomplete
    "sets": 200,
    "events": 5000,
    "method": "(3.5)",  # or "(3.7)", "mean field", "Gibbs", "enumeration"
    "solver": "blmvm",  # of (3.5): a type of TAO, or "sweeps" for sweeps alone
    "sweeps": 5,  # before TAO
    "stop": 1e-8,  # (3.5): proven gap; mean field: rounds; Gibbs: sweeps
    "error": "loss",  # one of MEASURES
    "seed": 1,
}
MEASURES = {
    "loss": "first places lost, relative to the posterior's",
    "disagreement": "share of first candidates other than the posterior's",
    "flips": "share of first candidates other than in the method's limit",
}
LIMIT_SWEEPS, OTHER = 2000, 1  # of Gibbs sampling for the posterior, with another seed


def run(settings: dict[str, Any], comm: MPI.Comm) -> dict[str, Any]:
    """Error of the first candidates, by one of three measures (collective; rank 0 works).

    - "flips": share of the events whose first candidate is another than in the method's own limit.
    - "disagreement": share of the events whose first candidate is not that of the posterior.
    - "loss": share that is lost of the first places which the posterior's own choice names right in the mean,
      1 - Σ_j p(first candidate of event j)/Σ_j max p.

    No difference at all counts as half an event: more cannot be told from so many.
    """
    return dict(comm.bcast(_measured(settings) if comm.rank == 0 else None))


def _measured(settings: dict[str, Any]) -> dict[str, Any]:
    import numpy as np

    from .. import hawkes_accuracy as study

    small, measure, seed = settings["data"] == "small", settings["error"], settings["seed"]
    sets = study.small_sets(settings["sets"], seed) if small else [study.large_set(settings["events"], seed)]
    solve, own_limit = _methods(settings)
    posterior = study.enumerated if small else study.sampled(LIMIT_SWEEPS, OTHER)
    wanted = [(own_limit if measure == "flips" else posterior)(one) for one in sets]
    seconds, answers = study.timed(solve, sets)
    other = events = 0
    kept = best = 0.0
    for one, x, there in zip(sets, answers, wanted):
        other += int((study.first(one.slots, x) != study.first(one.slots, there)).sum())
        events += one.slots.count
        kept += float(_at_first(one.slots, x, there).sum())
        best += float(np.maximum.reduceat(there, one.slots.start[:-1]).sum())
    error = 1 - kept / best if measure == "loss" else other / events
    return {
        "error": max(error, 0.5 / events),
        "size": sum(len(one.slots) for one in sets),
        "seconds": seconds,
        "wall_seconds": seconds,
        "diagnostics": {"other_first_candidates": other, "incomplete_events": events},
    }


def _methods(settings: dict[str, Any]) -> tuple[Any, Any]:
    """How to solve, and how to solve in the limit."""
    from .. import hawkes_accuracy as study

    stop = settings["stop"]

    def maximum() -> tuple[Any, Any]:
        return study.continuous(settings["solver"], stop, settings["sweeps"]), study.continuous("sweeps", study.LIMIT)

    return {
        "(3.5)": maximum,
        "(3.7)": lambda: (study.discrete, study.discrete),
        "mean field": lambda: (study.mean_field_rounds(int(stop)), study.mean_field_rounds(study.LIMIT_ROUNDS)),
        "Gibbs": lambda: (study.sampled(int(stop)), study.sampled(LIMIT_SWEEPS, OTHER)),
        "enumeration": lambda: (study.enumerated, study.enumerated),
    }[settings["method"]]()


def _at_first(slots: Slots, x: NDArray, values: NDArray) -> NDArray:
    """Of `values` (S,) those at the first candidate by x (S,) of each event, shape (n,)."""
    import numpy as np

    from ..hawkes_accuracy import first

    chosen = slots.pair == np.repeat(first(slots, x), np.diff(slots.start))
    found: NDArray = slots.columns(values, chosen.astype(float))
    return found
