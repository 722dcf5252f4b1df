"""The result of a run on a network as tables: predictions, parameters, events, scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from extremal.hawkes import scores
from extremal.hawkes.events import UNKNOWN, Network
from extremal.hawkes.problem import HawkesProblem
from extremal.hawkes.slots import Slots

from .hawkes_data import Data

Table = dict[str, Sequence[Any]]
DIGITS = 12  # decimals written of weights and probabilities
EQUAL = 9  # decimals by which candidates are put in order: beyond, they differ with the number of ranks


def predictions(problem: HawkesProblem, data: Data, candidates: int) -> Table:
    """For each incomplete event its pairs of largest weight, the largest first (collective; {} but on rank 0)."""
    slots = problem.slots
    weight, probability = slots.gather(problem.weights), None
    if problem.probabilities is not None:
        probability = slots.gather(problem.probabilities)
    if weight is None:
        return {}
    whole = slots.whole
    column = whole.column
    second = np.zeros(len(weight)) if probability is None else -np.round(probability, EQUAL)
    order = np.lexsort((whole.pair, second, -np.round(weight, EQUAL), column))
    rank = np.arange(len(order)) - np.repeat(whole.start[:-1], np.diff(whole.start))
    kept = rank < candidates
    slot, rank = order[kept], rank[kept] + 1
    event = whole.event[column[slot]]
    table: Table = {
        "event": data.number[event].tolist(),
        "time": [data.time[k] for k in event.tolist()],
        "rank": rank.tolist(),
        **_names(data.network, whole.pair[slot]),
        "weight": _rounded(weight[slot]),
    }
    if probability is not None:
        table["probability"] = _rounded(probability[slot])
    if "gap" in problem.found:
        table["certificate"] = [float(f"{problem.found['gap']:.3g}")] * len(slot)
    if data.truth is not None:
        table["true"] = (whole.pair[slot] == data.truth[event]).astype(int).tolist()
    return table


def _rounded(values: NDArray) -> list[float]:
    return np.round(values, DIGITS).tolist()


def _names(network: Network, pair: NDArray) -> Table:
    agents = np.array(network.agents, dtype=object)
    people = agents[network.pairs[pair]]
    return {"first": people[:, 0].tolist(), "second": people[:, 1].tolist()}


def parameters(problem: HawkesProblem, data: Data) -> Table:
    """Parameters of each pair, its complete events, and how many incomplete ones it is expected to have had.

    Collective; {} but on rank 0.
    """
    slots, network = problem.slots, problem.network
    errors = problem.standard_errors()
    expected = problem.probabilities
    if expected is None:
        assert problem.weights is not None
        expected = problem.weights**2
    expected = slots.gather(expected)
    if expected is None:
        return {}
    events = data.events
    number = network.number(*events.participants[~events.incomplete].T)
    table: Table = _names(network, np.arange(len(network)))
    for name in ("background", "branching", "decay"):
        table[name] = getattr(network, name).tolist()
        if errors is not None:
            table[f"{name}_error"] = errors[name].tolist()
    table["complete"] = np.bincount(number[number >= 0], minlength=len(network)).tolist()
    attributed = np.bincount(slots.whole.pair, weights=expected, minlength=len(network))
    return table | {"attributed": np.round(attributed, 6).tolist()}


def unresolvable(problem: HawkesProblem, data: Data) -> Table:
    """Events that the network cannot explain, and why not (not collective)."""
    outside, open_ = problem.outside, problem.slots.unresolvable
    event = np.concatenate([outside, open_])
    reason = ["no active pair of the network"] * len(outside) + ["no active pair could explain it"] * len(open_)
    order = np.argsort(event, kind="stable")
    return _listed(data, event[order]) | {"reason": [reason[k] for k in order]}


def events(data: Data) -> Table:
    """Events in their order; time since the beginning of the observation (not collective)."""
    table = _listed(data, np.arange(len(data.events)))
    table["time"] = data.events.time.tolist()
    if data.truth is not None:
        names = _names(data.network, data.truth)
        table |= {f"true_{name}": names[name] for name in names}
    return table


def _listed(data: Data, event: NDArray) -> Table:
    agents = np.array((*data.network.agents, ""), dtype=object)
    people = agents[np.where((p := data.events.participants[event]) == UNKNOWN, -1, p)]
    return {
        "event": data.number[event].tolist(),
        "time": [data.time[k] for k in event.tolist()],
        "first": people[:, 0].tolist(),
        "second": people[:, 1].tolist(),
    }


def answers(problem: HawkesProblem) -> dict[str, NDArray]:
    """What is scored: values of this rank's slots by the name of the answer (collective)."""
    slots = problem.slots
    found = {"weights": problem.weights, "probabilities": problem.probabilities}
    found |= {
        "guessing": scores.guessing(slots),
        "frequent": scores.most_frequent(slots),
        "linear": scores.linear(slots),
    }
    return {name: values for name, values in found.items() if values is not None}


def score_table(problem: HawkesProblem, truth: NDArray, seed: int) -> Table:
    """Share of truths among the first 1, 2, 3 with 95% intervals, and log-loss, of each answer (collective)."""
    rows = []
    for name, values in answers(problem).items():
        ranks = scores.ranks_of_truth(problem.slots, values, truth, seed=seed)
        row: dict[str, Any] = {"answer": name}
        for k in (1, 2, 3):
            share = scores.top(ranks, k)
            row |= {f"top{k}": share.share, f"top{k}_low": share.low, f"top{k}_high": share.high}
        row["log_loss"] = None if name == "weights" else scores.log_loss(problem.slots, values, truth)
        rows.append(row)
    return {name: [row[name] for row in rows] for name in rows[0]}


def diagnostics_of(table: Mapping[str, Sequence[Any]]) -> dict[str, float]:
    """The scores as diagnostics of a run."""
    found: dict[str, float] = {}
    for i, answer in enumerate(table["answer"]):
        for k in (1, 2, 3):
            names = [f"top{k}", f"top{k}_low", f"top{k}_high"]
            if answer == "weights":
                found |= {name: table[name][i] for name in names}
            else:
                found[f"top{k}_{answer}"] = table[names[0]][i]
        if table["log_loss"][i] is not None:
            found["log_loss" if answer == "probabilities" else f"log_loss_{answer}"] = table["log_loss"][i]
    return found


def calibration(slots: Slots, probabilities: NDArray, truth: NDArray) -> Table:
    """Predicted probabilities against how often they came true (collective)."""
    found = scores.calibration(slots, probabilities, truth)
    some = found.count > 0
    columns = {name: getattr(found, name)[some].tolist() for name in ("predicted", "observed", "count")}
    return dict(columns)
