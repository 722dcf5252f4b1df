"""An analyst's tables: network.csv (pairs) and events.csv (when, who), read, checked and counted."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from extremal.hawkes.events import UNKNOWN, DataError, Events, Network

from .csv_columns import Columns, read_columns
from .errors import InputError, suggestion
from .times import bound, times_of

if TYPE_CHECKING:
    from .hawkes_scene import EventsTable, HawkesScene, NetworkTable

BLANK = {"", "?", "unknown"}
BOUNDS: dict[str, tuple[str, Callable[[NDArray], NDArray]]] = {
    "background": ("0 or more", lambda values: values >= 0),
    "branching": ("0 or more", lambda values: values >= 0),
    "decay": ("above 0", lambda values: values > 0),
}


@dataclass(frozen=True)
class Data:
    """What the tables say.

    Attributes
    ----------
    network : Network
    events : Events
    number : (N,) int64
        Line of each event in its file; 1, 2, ... of simulated ones.
    time : sequence of str, or (N,)
        Of each event, as the file writes it.
    truth : (N,) int32, optional
        Pair of each event, where it is known from a simulation.
    notes : list of str
        What a person should know: events sorted, columns ignored ...
    """

    network: Network
    events: Events
    number: NDArray
    time: list[str]
    truth: NDArray | None = None
    notes: list[str] = field(default_factory=list)


def read(scene: HawkesScene) -> Data:
    """Read the tables of a scene with [events] (not collective).

    Raises
    ------
    InputError
        One line: file, line, column, value and what is accepted.
    """
    notes: list[str] = []
    network = read_network(scene, notes)
    assert scene.events is not None
    return read_events(scene.beside(scene.events.file), scene.events, network, notes)


def read_network(scene: HawkesScene, notes: list[str]) -> Network:
    """The network of a scene, from its file or with any two agents a pair."""
    table = scene.network
    if table.file is not None:
        return _network(scene.beside(table.file), table, notes)
    assert table.agents is not None
    return Network.complete(table.agents, table.background, table.branching, table.decay)


def _network(path: Path, table: NetworkTable, notes: list[str]) -> Network:
    columns = read_columns(path, ("first", "second"), tuple(BOUNDS), notes)
    first, second = columns["first"], columns["second"]
    for name in ("first", "second"):
        columns.refuse(name, [agent.lower() in BLANK for agent in columns[name]], "must be the name of an agent")
    columns.refuse("second", [a == b for a, b in zip(first, second)], "must be another agent than the first")
    agents = {name: k for k, name in enumerate(dict.fromkeys(itertools.chain.from_iterable(zip(first, second))))}
    pairs = np.sort(np.column_stack([_numbers(first, agents), _numbers(second, agents)]), axis=1)
    _, earliest, which = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    repeated = earliest[which.reshape(-1)]
    twice = repeated < np.arange(len(pairs))
    columns.refuse("second", twice, lambda k: f"the pair stands in line {columns.line[repeated[k]]} already")
    parameters = (_parameter(columns, name, getattr(table, name)) for name in BOUNDS)
    return Network(tuple(agents), pairs, *parameters)


def _parameter(columns: Columns, name: str, default: float) -> NDArray:
    if name not in columns:
        return np.full(len(columns), default)
    accepted, good = BOUNDS[name]
    return columns.numbers(name, f"{accepted}, or blank for {default:g}", default, good)


def _numbers(names: Iterable[str], number: dict[str, int]) -> NDArray:
    return np.fromiter((number.get(name, -2) for name in names), dtype=np.int32)


def read_events(path: Path, table: EventsTable, network: Network, notes: list[str]) -> Data:
    """Read a table of events."""
    columns = read_columns(path, ("time", "first", "second"), (), notes)
    known = {name: k for k, name in enumerate(network.agents)}
    # names of agents win: one may be called "?"
    number = {name: UNKNOWN for name in dict.fromkeys((*columns["first"], *columns["second"])) if name.lower() in BLANK}
    number |= known
    people = np.column_stack([_numbers(columns[name], number) for name in ("first", "second")])
    for k, name in enumerate(("first", "second")):
        values = columns[name]

        def strange(row: int, values: list[str] = values) -> str:
            return f"is no agent of the network; {suggestion(values[row], known)}"

        columns.refuse(name, people[:, k] == -2, strange)
    itself = (people[:, 0] == people[:, 1]) & (people[:, 0] != UNKNOWN)
    columns.refuse("second", itself, "must be another agent than the first, or blank")
    time, first, unit = times_of(columns, table.unit)
    begin = bound(path, "begin", table.begin, first, unit)
    end = bound(path, "end", table.end, first, unit)
    if begin is not None:
        columns.refuse("time", time < begin, f"is before the beginning of the observation, {table.begin}")
    if end is not None:
        columns.refuse("time", time > end, f"is after the end of the observation, {table.end}")
    start = float(time.min()) if begin is None else begin
    duration = (float(time.max()) if end is None else end) - start
    order = np.argsort(time, kind="stable")
    moved = int((np.diff(time) < 0).sum())
    if moved:
        notes.append(f"{path}: {moved} of {len(time)} events are earlier than the one before: sorted")
    text = columns["time"]
    try:
        events = Events(time[order] - start, people[order], duration)
    except DataError as error:
        raise InputError(f"{path}: {error}") from None
    return Data(network, events, columns.line[order], [text[k] for k in order], None, notes)
