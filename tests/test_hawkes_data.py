"""An analyst's tables are read, checked and counted; what is wrong with them is said in one line."""

import time
from pathlib import Path

import numpy as np
import pytest

from extremal.app.errors import InputError
from extremal.app.hawkes_data import Data, read_events, read_network
from extremal.app.hawkes_scene import EventsTable, HawkesScene, NetworkTable
from extremal.hawkes.events import UNKNOWN, Network

NETWORK = "first,second\nAsh,Birch\nBirch,Cedar\nAsh,Cedar\n"


def network(folder: Path, text: str | bytes = NETWORK, notes: list[str] | None = None, **defaults: float) -> Network:
    """The network of a table."""
    path = folder / "network.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    table = NetworkTable(file=str(path), **defaults)
    scene = HawkesScene(part="hawkes", network=table)
    return read_network(scene, [] if notes is None else notes)


def events(folder: Path, text: str | bytes, **keys: object) -> Data:
    """The events of a table on a network of three."""
    path = folder / "events.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_events(path, EventsTable(file=str(path), **keys), network(folder), [])


def refusal(folder: Path, read: object, text: str | bytes, **keys: object) -> str:
    """The line with which a table is refused, without the file's name."""
    with pytest.raises(InputError) as caught:
        read(folder, text, **keys)  # type: ignore[operator]
    (line,) = caught.value.messages
    assert "\n" not in line
    name = folder / ("network.csv" if read is network else "events.csv")
    assert line.startswith(f"{name}: ")
    return line.removeprefix(f"{name}: ")


# ------------------------------------------------------------- what is read


def test_a_pair_has_its_own_parameters_or_the_common_ones(tmp_path: Path) -> None:
    text = "second,first,decay,background\nBirch,Ash,0.3,\nCedar,Birch,,0.5\n"
    found = network(tmp_path, text, background=0.2, branching=0.6)
    assert found.agents == ("Ash", "Birch", "Cedar")
    assert found.pairs.tolist() == [[0, 1], [1, 2]]
    assert found.background.tolist() == [0.2, 0.5]
    assert found.branching.tolist() == [0.6, 0.6]
    assert found.decay.tolist() == [0.3, 0.1]


@pytest.mark.parametrize("blank", ["", "?", "unknown", "UNKNOWN", "  "])
def test_unknown_participants_are_blank(blank: str, tmp_path: Path) -> None:
    data = events(tmp_path, f"time,first,second\n1,Ash,{blank}\n2,{blank},Birch\n3,{blank},{blank}\n4,Cedar,Ash\n")
    people = [[0, UNKNOWN], [UNKNOWN, 1], [UNKNOWN, UNKNOWN], [2, 0]]
    assert data.events.participants.tolist() == people
    assert data.events.incomplete.tolist() == [True, True, True, False]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_tables_of_a_spreadsheet_are_read(delimiter: str, tmp_path: Path) -> None:
    """Byte-order mark, other line ends, quotes, spaces, empty rows, columns of no interest."""
    rows = ["time,first,second,place", '1.5, Ash ,"Birch",here', ",,,", "", "2e0,,Cedar,there"]
    text = "\r\n".join(row.replace(",", delimiter) for row in rows)
    data = events(tmp_path, b"\xef\xbb\xbf" + text.encode())
    assert data.events.time.tolist() == [0, 0.5]
    assert data.events.participants.tolist() == [[0, 1], [UNKNOWN, 2]]
    assert data.number.tolist() == [2, 5]
    assert data.notes == [f'{tmp_path / "events.csv"}: columns without a meaning here: "place"']


@pytest.mark.parametrize(
    ("stamps", "unit", "expected"),
    [
        (("2024-02-28", "2024-03-01", "2024-03-02"), "days", [0, 2, 3]),
        (("2024-03-10T00:30", "2024-03-10T06:30", "2024-03-11T00:30"), "hours", [0, 6, 24]),
        (("2024-03-10 00:30:00", "2024-03-10 00:30:30", "2024-03-10 00:31"), "minutes", [0, 0.5, 1]),
        (("2024-03-10T12:00+02:00", "2024-03-10T12:00Z", "2024-03-10T12:00-01:00"), "hours", [0, 2, 3]),
        (("100", "107", "1e3"), "weeks", [0, 7, 900]),
    ],
)
def test_timestamps_become_numbers_in_the_unit_of_time(
    stamps: tuple[str, ...], unit: str, expected: list[float], tmp_path: Path
) -> None:
    text = "time,first,second\n" + "".join(f"{stamp},Ash,\n" for stamp in stamps)
    data = events(tmp_path, text, unit=unit)
    assert data.events.time == pytest.approx(expected, abs=1e-12)
    assert data.time == list(stamps)


def test_unsorted_events_are_sorted_with_a_note(tmp_path: Path) -> None:
    data = events(tmp_path, "time,first,second\n3,Ash,\n1,Birch,\n3,Cedar,\n2,Birch,\n")
    assert data.events.time.tolist() == [0, 1, 2, 2]
    assert data.events.participants[:, 0].tolist() == [1, 1, 0, 2]  # events at one time keep their order
    assert data.number.tolist() == [3, 5, 2, 4]
    assert data.notes == [f"{tmp_path / 'events.csv'}: 2 of 4 events are earlier than the one before: sorted"]


def test_the_observation_is_from_begin_to_end(tmp_path: Path) -> None:
    text = "time,first,second\n2024-01-05,Ash,\n2024-01-09,Ash,\n"
    assert events(tmp_path, text).events.duration == 4
    data = events(tmp_path, text, begin="2024-01-01", end="2024-02-01")
    assert (data.events.time.tolist(), data.events.duration) == ([4, 8], 31)


def test_seconds_since_1970_keep_their_digits(tmp_path: Path) -> None:
    data = events(tmp_path, "time,first,second\n1700000000.25,Ash,\n1700000000.5,Ash,\n", unit="seconds")
    assert data.events.time.tolist() == [0, 0.25]


def test_a_million_lines_are_read_in_seconds(tmp_path: Path) -> None:
    rows = 200_000
    stamps = np.datetime64("2020-01-01T00:00:00") + np.arange(rows)
    text = "time,first,second\n" + "".join(f"{stamp},Ash,\n" for stamp in stamps)
    began = time.process_time()
    assert len(events(tmp_path, text).events) == rows
    # 2.4 s a million were measured; the rest is for slow machines
    assert time.process_time() - began < 2.0


# ------------------------------------------------------------- what is refused

HEAD = "time,first,second\n"
TIME = "must be a number, or a timestamp as 2024-05-31 or 2024-05-31T22:15"
BAD_EVENTS = {
    "": "is empty; must begin with a line that names its columns",
    " \n\n": "is empty; must begin with a line that names its columns",
    HEAD: "has no row below its header time,first,second",
    HEAD + ",,\n": "has no row below its header time,first,second",
    "time,first\n1,Ash\n": 'line 1: column second is missing; must name time, first, second, found "time", "first"',
    "1,Ash,Birch\n": 'line 1: column time is missing; must name time, first, second, found "1", "Ash", "Birch"',
    "tme,first,second\n1,Ash,\n": 'line 1: column "tme": did you mean time?',
    "time,first,second,first\n1,Ash,,\n": "line 1: column first is given twice",
    HEAD + "1,Ash\n": "line 2: has 2 fields (comma between them), not 3",
    HEAD + "1,Ash,,\n": "line 2: has 4 fields (comma between them), not 3",
    HEAD + "1,Ash,Birch\n2,Yew,\n": 'line 3: first = "Yew": is no agent of the network; known: Ash, Birch, Cedar',
    HEAD + "1,Ash,Brich\n": 'line 2: second = "Brich": is no agent of the network; did you mean Birch?',
    HEAD + "1,Ash,Ash\n": 'line 2: second = "Ash": must be another agent than the first, or blank',
    HEAD + ",Ash,\n": f'line 2: time = "": {TIME}',
    HEAD + "soon,Ash,\n2024-01-01,Ash,\n": f'line 2: time = "soon": {TIME}',
    HEAD + "2024-02-30,Ash,\n": f'line 2: time = "2024-02-30": {TIME}',
    HEAD + "2024-01-01,Ash,\n13 May,Ash,\n14 May,Ash,\n": f'line 3: time = "13 May": {TIME} (1 more like it)',
    HEAD + "1,Ash,\nnoon,Ash,\n": 'line 3: time = "noon": must be a number',
    HEAD + "1,Ash,\nnan,Ash,\n": 'line 3: time = "nan": must be a finite number',
    HEAD + "1e400,Ash,\n": 'line 2: time = "1e400": must be a finite number',
    HEAD + "1,Ash,\n1_000,Ash,\n": 'line 3: time = "1_000": must be a number',
    HEAD + "1,Ash,\n2024-01-01,Ash,\n": 'line 3: time = "2024-01-01": must be a number, as the first time is',
    HEAD + "2024-01-01,Ash,\n7,Ash,\n": 'line 3: time = "7": must be a timestamp, as the first time is',
    HEAD + "2024-01-01,Ash,\n2024-01-02T00:00Z,Ash,\n": (
        'line 3: time = "2024-01-02T00:00Z": must be without a time zone, as the first is'
    ),
    HEAD + '1,"Ash,\n2,Ash,\n': "line 3: not CSV: unexpected end of data",
}


@pytest.mark.parametrize("text", BAD_EVENTS, ids=[repr(text) for text in BAD_EVENTS])
def test_bad_events_are_refused_with_their_line(text: str, tmp_path: Path) -> None:
    assert refusal(tmp_path, events, text) == BAD_EVENTS[text]


NAMES = "first,second,background,branching,decay\n"
BAD_NETWORKS = {
    "": "is empty; must begin with a line that names its columns",
    "first,second\n": "has no row below its header first,second",
    "first,second\nAsh,Ash\n": 'line 2: second = "Ash": must be another agent than the first',
    "first,second\nAsh,Birch\nBirch,Ash\n": 'line 3: second = "Ash": the pair stands in line 2 already',
    "first,second\nAsh,\n": 'line 2: second = "": must be the name of an agent',
    "first,second\n?,Ash\n": 'line 2: first = "?": must be the name of an agent',
    "first,second,backgroud\nAsh,Birch,1\n": 'line 1: column "backgroud": did you mean background?',
    NAMES + "Ash,Birch,-1,,\n": 'line 2: background = "-1": must be 0 or more, or blank for 0.01',
    NAMES + "Ash,Birch,,-0.5,\n": 'line 2: branching = "-0.5": must be 0 or more, or blank for 0.5',
    NAMES + "Ash,Birch,,,0\n": 'line 2: decay = "0": must be above 0, or blank for 0.1',
    NAMES + "Ash,Birch,nan,,\n": 'line 2: background = "nan": must be a finite number, 0 or more, or blank for 0.01',
    NAMES + "Ash,Birch,,inf,\n": 'line 2: branching = "inf": must be a finite number, 0 or more, or blank for 0.5',
    NAMES + "Ash,Birch,,,fast\n": 'line 2: decay = "fast": must be a number, above 0, or blank for 0.1',
}


@pytest.mark.parametrize("text", BAD_NETWORKS, ids=[repr(text) for text in BAD_NETWORKS])
def test_bad_networks_are_refused_with_their_line(text: str, tmp_path: Path) -> None:
    assert refusal(tmp_path, network, text) == BAD_NETWORKS[text]


def test_a_table_that_is_not_utf8_is_refused_with_the_line(tmp_path: Path) -> None:
    text = "time,first,second\n1,Ash,\n2,Bäume,\n".encode("latin-1")
    expected = "line 3: is not UTF-8 text; save the table as CSV in UTF-8"
    assert refusal(tmp_path, events, text) == expected


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"begin": 5}, "[events] begin = 5: must be a timestamp in quotes without a time zone, as in the file"),
        ({"end": "late"}, "[events] end = \"late\": must be a timestamp in quotes without a time zone, as in the file"),
        (
            {"begin": "2024-01-07"},
            'line 2: time = "2024-01-05": is before the beginning of the observation, 2024-01-07',
        ),
        ({"end": "2024-01-06"}, 'line 3: time = "2024-01-09": is after the end of the observation, 2024-01-06'),
    ],
)
def test_an_observation_that_does_not_hold_the_events_is_refused(
    keys: dict[str, object], message: str, tmp_path: Path
) -> None:
    text = "time,first,second\n2024-01-05,Ash,\n2024-01-09,Ash,\n"
    assert refusal(tmp_path, events, text, **keys) == message
