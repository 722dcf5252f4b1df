"""Pictures of events on a network: timelines as in figure 2.3, and the network itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection

from .csv_columns import Columns

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROWS = 28  # timelines shown at most
SHOWN = 70  # events shown at most: more could not be told apart
NAMED = 45  # agents whose names can be read
LAID_OUT = 150  # agents; more stand on a circle
PLACED, TRUE = "#3182bd", "#e6550d"
SEEN = 0.02  # probability from which on a circle can be seen
DRAWN = 1000  # pairs drawn in the network
LARGEST = 150.0  # area of a circle of probability 1 [points²]


def draw_timelines(
    axes: Any, events: Columns, predictions: Columns | None, parameters: Columns, unit: str = ""
) -> None:
    """A row for each of the busiest pairs: complete events as dots, incomplete ones placed where they may belong.

    Where there are many events, those in the middle of the observation are shown.
    """
    number = {_key(a, b): k for k, (a, b) in enumerate(zip(parameters["first"], parameters["second"]))}
    row, labels = _rows(parameters)
    time = events.numbers("time", "")
    complete = row[[number.get(_key(a, b), -1) for a, b in zip(events["first"], events["second"])]]
    place, placed, size, true = _circles(events, predictions, number, row)
    there = complete >= 0
    there[place[size >= SEEN]] = True
    begin = max(0, (int(there.sum()) - SHOWN) // 2)
    shown = np.flatnonzero(there)[begin : begin + SHOWN]
    if not len(shown):
        shown = np.arange(min(1, len(time)))
    low, high = _limits(time[shown])

    dots = shown[complete[shown] >= 0]
    within = (time[place] >= low) & (time[place] <= high)
    place, placed, size, true = (values[within] for values in (place, placed, size, true))
    axes.vlines(np.unique(time[place[size >= SEEN]]), -0.7, len(labels) - 0.3, color="0.88", lw=0.8, zorder=0)
    axes.hlines(range(len(labels)), low, high, color="0.8", lw=0.6, zorder=0)
    axes.scatter(time[dots], complete[dots], s=15, color="black", zorder=3, label="complete event")
    circle = {"facecolor": PLACED, "edgecolor": "none", "alpha": 0.75, "zorder": 2}
    axes.scatter(time[place], placed, s=LARGEST * size, **circle)
    axes.scatter([], [], s=0.5 * LARGEST, **circle, label="incomplete event: area by probability")
    if true.any():
        mark = {"s": 42, "marker": "s", "facecolor": "none", "edgecolor": TRUE, "lw": 1.1, "zorder": 4}
        axes.scatter(time[place[true]], placed[true], **mark, label="where it was")
    axes.set_yticks(range(len(labels)), labels, fontsize=8 if len(labels) > 15 else 9)
    axes.set_ylim(len(labels) - 0.3, -0.7)
    axes.set_xlim(low, high)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.tick_params(axis="x", labelsize=8)
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.set_xlabel(f"time{unit}", fontsize=9, labelpad=2)
    pairs = f"the {len(labels)} busiest pairs" if len(labels) < len(parameters) else "all pairs"
    part = f": {len(shown)} events in the middle" if len(shown) < there.sum() else ""
    axes.set_title(f"timelines of {pairs}{part}", fontsize=10, loc="left", pad=19)
    axes.legend(
        fontsize=8, frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2,
        handletextpad=0.2, columnspacing=1.2,
    )  # fmt: skip


def _key(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)


def _limits(time: NDArray[Any]) -> tuple[float, float]:
    margin = 0.015 * float(np.ptp(time)) or 1.0
    return float(time[0]) - margin, float(time[-1]) + margin


def _circles(
    events: Columns, predictions: Columns | None, number: dict[tuple[str, str], int], row: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Event, row, probability and truth of the candidates on the rows shown."""
    if predictions is None:
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0, bool)
    at = {name: k for k, name in enumerate(events["event"])}
    event = np.array([at[name] for name in predictions["event"]])
    placed = row[[number[_key(a, b)] for a, b in zip(predictions["first"], predictions["second"])]]
    if "probability" in predictions:
        size = predictions.numbers("probability", "")
    else:
        size = predictions.numbers("weight", "") ** 2
    true = np.array(predictions["true"]) == "1" if "true" in predictions else np.zeros(len(predictions), bool)
    there = placed >= 0
    return event[there], placed[there], size[there], true[there]


def _rows(parameters: Columns) -> tuple[NDArray[Any], list[str]]:
    """Row of each pair, -1 where it is not shown, and the names of the rows."""
    count = parameters.numbers("complete", "") + parameters.numbers("attributed", "")
    chosen = np.sort(np.argsort(-count, kind="stable")[:ROWS])
    row = np.full(len(count) + 1, -1)  # the last one is that of pair -1
    row[chosen] = np.arange(len(chosen))
    return row, [f"{_short(parameters['first'][k])} – {_short(parameters['second'][k])}" for k in chosen]


def _short(name: str, most: int = 12) -> str:
    return name if len(name) <= most else name[: most - 1] + "…"


def draw_network(axes: Any, parameters: Columns) -> None:
    """Agents and pairs; a line is as thick as the pair's events are many, complete or attributed to it."""
    agents = {name: k for k, name in enumerate(dict.fromkeys([*parameters["first"], *parameters["second"]]))}
    pairs = np.array([[agents[a], agents[b]] for a, b in zip(parameters["first"], parameters["second"])])
    count = parameters.numbers("complete", "") + parameters.numbers("attributed", "")
    place = layout(len(agents), pairs)
    largest = max(float(count.max(initial=0)), 1.0)
    order = np.argsort(count, kind="stable")[-DRAWN:]
    width = 0.25 + (5.0 if len(pairs) < 200 else 3.0) * count[order] / largest
    shade = 0.82 - 0.67 * count[order] / largest
    faint = min(1.0, 60 / len(order) ** 0.75 + 0.05)
    lines = LineCollection(place[pairs[order]], linewidths=width, colors=[(s, s, s, faint) for s in shade], zorder=1)
    axes.add_collection(lines)
    within = max(map(len, agents)) <= 3  # names within circles, else above them
    named = len(agents) <= NAMED
    axes.scatter(*place.T, s=230 if named and within else 25, color="white", edgecolor=PLACED, lw=1.4, zorder=2)
    for name, k in agents.items() if named else ():
        above, size = ((0, 0), 9) if within else ((0, 8), 8)
        back = None if within else {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
        axes.annotate(
            _short(name), place[k], above, textcoords="offset points", fontsize=size, ha="center",
            va="center" if within else "bottom", bbox=back, zorder=3,
        )  # fmt: skip
    axes.set_xlim(-1.12, 1.12)
    axes.set_ylim(-1.12, 1.12)
    axes.set_aspect("equal")
    axes.set_axis_off()
    part = f" (drawn: the {DRAWN:,} busiest)" if len(pairs) > DRAWN else ""
    axes.set_title(
        f"{len(agents)} agents, {len(pairs):,} pairs{part}\nthickest line: {largest:,.0f} events",
        fontsize=10,
        y=0.975,
    )


def layout(count: int, pairs: NDArray[Any]) -> NDArray[Any]:
    """Places (count, 2) of agents within the unit square, near to each other where few pairs lie between them.

    On a circle where all are pairs, or where there are too many; else distances in the plane are fitted to distances
    along pairs (stress majorisation), beginning on that circle.
    """
    angle = np.pi / 2 - 2 * np.pi * np.arange(count) / count
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if count > LAID_OUT or count < 3 or len(pairs) == count * (count - 1) // 2:
        return circle
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import shortest_path

    graph = csr_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))
    wanted = shortest_path(graph, directed=False, unweighted=True)
    far = float(wanted[np.isfinite(wanted)].max()) + 1
    wanted[~np.isfinite(wanted)] = far  # parts without a connection
    np.fill_diagonal(wanted, 1.0)
    weight = wanted**-2.0
    np.fill_diagonal(weight, 0.0)
    laplacian = np.diag(weight.sum(axis=1)) - weight
    inverse = np.linalg.pinv(laplacian)
    best, least = circle, np.inf
    for start in (circle, _spectral(weight)):
        x = start * far / 2
        for _ in range(300):
            step = x[:, None] - x[None]
            length = np.maximum(np.linalg.norm(step, axis=2), 1e-9)
            pull = weight * wanted / length
            x = inverse @ ((pull[:, :, None] * step).sum(axis=1))
        length = np.linalg.norm(x[:, None] - x[None], axis=2)
        stress = float((weight * (length - wanted) ** 2).sum())
        if stress < least:
            best, least = x, stress
    best = best - (best.max(axis=0) + best.min(axis=0)) / 2
    return best / max(float(np.abs(best).max()), 1e-9)


def _spectral(weight: NDArray[Any]) -> NDArray[Any]:
    _, vectors = np.linalg.eigh(np.diag(weight.sum(axis=1)) - weight)
    return vectors[:, 1:3] / np.abs(vectors[:, 1:3]).max()
