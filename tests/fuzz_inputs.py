"""Malformed inputs: valid scenes, tables, meshes and command lines, spoilt; the same for the same number."""

from __future__ import annotations

import copy
import math
import random
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuzz_bases import ELASTIC, EVENTS, FLAT_SNOW, HAWKES, MESHES, NETWORK, SNOW, STATIC, TABLES

from extremal.app.scene_errors import literal

SEED = 20260801
SCENES = Path(__file__).resolve().parent.parent / "app" / "scenes"

NUMBERS: tuple[Any, ...] = (
    0, -0.0, -1, 1, 2, 3, 7, 1e-12, 1e-300, 5e-324, 1e12, 1e300, 1.7976931348623157e308, -1e300, 0.5, 0.999999999,
    64, 2**31,
    2**63, -(2**63), 10**25, math.nan, math.inf, -math.inf,
)  # fmt: skip
TEXTS = (
    "", " ", "\t", "x", "nothing", "left", "../../etc/passwd", "/dev/zero", "/dev/null", ".", "..", "/",
    "scene.toml", "a" * 100_000,
    "é", "日本語", "\u202e", "🧊", "\x00", "\x1b[31m", "\n", "%s%n", "{0}", "nan", "inf", "-1", "1/0", "t/0",
    "x**x**x**x", "9**9**9**9",
    "__import__('os').system('true')", "(" * 500, "sin(", "lambda: 0", "x if x else y", "1e999", "log(-1)",
    "sqrt(x - 2)", "tan(1.5707963)",
    "t" + "+t" * 5000, "x.real", "[1, 2]", "x == 1", "x < 0.1 and y", "not x", "J", "i1", "true", "١٢", "a\u0301",
    "$(touch owned)", "; touch owned",
)  # fmt: skip
OTHERS: tuple[Any, ...] = (
    True,
    False,
    [],
    {},
    [[]],
    [{}],
    {"": 1},
    {"a": {"b": {}}},
    [1],
    [1, 2],
    [1, 2, 3],
    [1, 2, 3, 4],
    ["x"],
    [1] * 5000,
)
WORDS = (
    "elastic", "snow", "hawkes", "check", "mesh", "render", "study", "--help", "-h", "--version", "--restart",
    "--overwrite", "--steps",
    "--quiet", "-o", "--output", "--scale", "--", "-", "---", "--=", "=", "", " ", "*", "scene.toml",
    "nothing.toml", "out", ".", "full",
    "/dev/null", "/dev/full", "box", "ball", "--cell-size", "--cell-size=1e-9", "--size", "1,2,3", "nan", "inf",
    "-1", "0", "1e999", "-1e-3",
    "-log_view", "-options_file", "-options_left", "-elastic_ksp_type", "-elastic_snes_max_it", "-hawkes_tao_type",
    "--size", "960x720", "--every",
    "\udcff", "é", "🧊", "x" * 5000, "%s", "-elastic_snes_monitor", "--dimension", "--order", "--cost",
    "full/notes.txt", "full/new/deep",
)  # fmt: skip


@dataclass
class Input:
    """One input: files, and the command line that gets to see them.

    Attributes
    ----------
    kind : str
        "scene", "table", "mesh" or "words".
    runnable : bool
        Small enough to be run where it turns out to be valid.
    """

    kind: str
    words: list[str]
    files: dict[str, bytes] = field(default_factory=dict)
    runnable: bool = False


def make(number: int) -> Input:
    """The input of a number."""
    pick = random.Random(f"{SEED} {number}")
    kind = pick.choices(("scene", "table", "mesh", "words"), (5, 2, 1.5, 1.5))[0]
    return {"scene": _scene, "table": _table, "mesh": _mesh, "words": _words}[kind](pick)


# ------------------------------------------------------------------ scenes


def _scene(pick: random.Random) -> Input:
    own = pick.random() < 0.7
    files: dict[str, bytes] = {}
    if own:
        text = pick.choice((ELASTIC, ELASTIC, STATIC, SNOW, SNOW, FLAT_SNOW, HAWKES, HAWKES, TABLES))
        files = {"network.csv": NETWORK.encode(), "events.csv": EVENTS.encode()}
    else:
        text = pick.choice(sorted(SCENES.glob("*.toml"))).read_text()
    if pick.random() < 0.25:
        data = _damaged(pick, text.encode())
    else:
        tree = tomllib.loads(text)
        for _ in range(pick.choice((1, 1, 1, 2, 3))):
            _change(pick, tree)
        data = _written(tree).encode("utf-8", "surrogatepass")
        if pick.random() < 0.1:
            data = _damaged(pick, data)
    return Input("scene", ["check", "scene.toml"], {**files, "scene.toml": data}, runnable=own)


def _places(tree: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys and positions that lead to every value."""
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in pairs:
        yield (*above, key)
        yield from _places(value, (*above, key))


def _value(pick: random.Random) -> Any:
    return copy.deepcopy(pick.choice(pick.choice((NUMBERS, NUMBERS, TEXTS, OTHERS))))


def _change(pick: random.Random, tree: dict[str, Any]) -> None:
    places = list(_places(tree))
    if not places:
        return
    where = pick.choice(places)
    owner: Any = tree
    for key in where[:-1]:
        owner = owner[key]
    key, value = where[-1], owner[where[-1]]
    what = pick.choice(("drop", "rename", "value", "value", "value", "twin", "factor", "list", "stranger", "swap"))
    if what == "drop":
        del owner[key]
    elif what == "rename" and isinstance(owner, dict):
        owner[_misspelt(pick, str(key))] = owner.pop(key)
    elif what == "twin" and isinstance(owner, list):
        owner.insert(pick.randrange(len(owner) + 1), copy.deepcopy(value))
    elif what == "factor" and isinstance(value, int | float) and not isinstance(value, bool):
        owner[key] = value * pick.choice((-1, 0, 0.1, 3, 1e-6, 1e6, 1e-100, 1e100))
    elif what == "list":
        owner[key] = [copy.deepcopy(value)] * pick.choice((1, 2, 3))
    elif what == "stranger" and isinstance(owner, dict):
        owner[pick.choice(("speed", "", "x y", "é", "file", "scale", "material"))] = _value(pick)
    elif what == "swap":
        other: Any = tree
        for step in pick.choice(places):
            other = other[step]
        owner[key] = copy.deepcopy(other)
    else:
        owner[key] = _value(pick)


def _misspelt(pick: random.Random, key: str) -> str:
    at = pick.randrange(len(key) + 1)
    return pick.choice(
        (key.upper(), key + "s", key[:at] + key[at + 1 :], key[:at] + "_" + key[at:], f"-{key}", key[::-1])
    )


def _written(tree: dict[str, Any]) -> str:
    """As TOML, each table on a line, so that numbers of lines mean something."""
    lines = [
        f"{key if key.isidentifier() and key.isascii() else literal(key)} = {literal(value)}"
        for key, value in tree.items()
    ]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------ tables


def _table(pick: random.Random) -> Input:
    name = pick.choice(("network.csv", "events.csv", "events.csv"))
    files = {"scene.toml": TABLES.encode(), "network.csv": NETWORK.encode(), "events.csv": EVENTS.encode()}
    if pick.random() < 0.4:
        numbered = [f"{k}.5,{line.partition(',')[2]}" for k, line in enumerate(EVENTS.splitlines()[1:])]
        files["events.csv"] = "\n".join([EVENTS.splitlines()[0], *numbered, ""]).encode()
    files[name] = _damaged(pick, files[name]) if pick.random() < 0.3 else _cells_changed(pick, files[name].decode())
    return Input("table", ["check", "scene.toml"], files, runnable=True)


CELLS = (
    "", " ", "?", "unknown", "nan", "inf", "-inf", "1e999", "-1", "0", "1e300", "1_0", "0x10", "١", '"', '"a', "'",
    "a,b", "ann", "bob", "ANN", "zoe",
    "2024-02-30", "2024-01-03", "2024-01-03T10:00+02:00", "0001-01-01", "9999-12-31T23:59:59", "99999-01-01",
    "2024-W01-1", "10:00", "é", "🧊",
    "\x00", "a" * 200_000, "1,5", ";", "\t", "=1+1", "1e-320", "01", "+1", "1.", "1 2",
)  # fmt: skip


def _cells_changed(pick: random.Random, text: str) -> bytes:
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(pick.choice((1, 1, 2, 4))):
        k = pick.randrange(len(rows))
        row = rows[k]
        j = pick.randrange(len(row)) if row else 0
        what = pick.choice(("cell", "cell", "cell", "cell", "less", "more", "drop", "twin", "swap", "column"))
        if what == "cell" and row:
            row[j] = pick.choice(CELLS)
        elif what == "less" and row:
            del row[j]
        elif what == "more":
            row.insert(j, pick.choice(CELLS))
        elif what == "drop" and len(rows) > 1:
            del rows[k]
        elif what == "twin":
            rows.insert(k, list(row))
        elif what == "swap":
            other = pick.randrange(len(rows))
            rows[k], rows[other] = rows[other], rows[k]
        elif what == "column":
            rows = [r[:j] + r[j + 1 :] for r in rows]
    end = pick.choice(("\n", "\n", "\n", "\r\n", "\r"))
    text = end.join(pick.choices((",", ";", "\t", "|"), (20, 1, 1, 1))[0].join(row) for row in rows) + end
    return text.encode(pick.choices(("utf-8", "utf-8-sig", "utf-16", "latin-1"), (20, 1, 1, 1))[0], "replace")


# ------------------------------------------------------------------ meshes


def _mesh(pick: random.Random) -> Input:
    name = pick.choice(tuple(MESHES))
    data = MESHES[name].encode()
    data = _damaged(pick, data) if pick.random() < 0.4 else _tokens_changed(pick, data.decode())
    if pick.random() < 0.05:
        name = "body" + pick.choice(
            (
                ".msh",
                ".vtk",
                ".obj",
                ".geo",
                ".step",
                ".ply",
                ".xdmf",
                ".inp",
                ".off",
                ".mesh",
                ".nas",
                ".h5",
                ".med",
                "",
            )
        )
    words = ["mesh", name]
    if pick.random() < 0.2:
        words += pick.choice((["--order", "2"], ["--cell-size", "0.3"], ["--order", "3"], ["--cell-size", "nan"]))
    return Input("mesh", words, {name: data})


def _tokens_changed(pick: random.Random, text: str) -> bytes:
    lines = text.splitlines()
    for _ in range(pick.choice((1, 1, 2, 3))):
        k = pick.randrange(len(lines))
        parts = lines[k].split(" ")
        what = pick.choice(("number", "number", "number", "drop line", "twin", "less", "swap"))
        if what == "number":
            parts[pick.randrange(len(parts))] = str(pick.choice((*NUMBERS, "x", "", "4", "5", "6", "99")))
            lines[k] = " ".join(parts)
        elif what == "drop line" and len(lines) > 1:
            del lines[k]
        elif what == "twin":
            lines.insert(k, lines[k])
        elif what == "less":
            lines[k] = " ".join(parts[:-1])
        else:
            other = pick.randrange(len(lines))
            lines[k], lines[other] = lines[other], lines[k]
    return ("\n".join(lines) + "\n").encode()


# ------------------------------------------------------------------ bytes and command lines


def _damaged(pick: random.Random, data: bytes) -> bytes:
    """Cut short, overwritten, grown, doubled or shuffled."""
    cut, other = sorted(pick.randrange(len(data) + 1) for _ in range(2))
    noise = bytes(pick.randrange(256) for _ in range(pick.choice((1, 1, 3, 50))))
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: data[:cut],
        lambda: data[:cut] + data[other:],
        lambda: data[:cut] + noise + data[cut:],
        lambda: data[:cut] + noise + data[cut + len(noise) :],
        lambda: data[:other] + data[cut:],
        lambda: noise,
        lambda: data[::-1],
        lambda: data + data,
        lambda: data.replace(b"\n", b"\r"),
        lambda: data.decode("utf-8", "replace").encode("utf-16"),
        lambda: data[:cut] + bytes(3000) + data[cut:],
    )
    return pick.choice(ways)()


def _words(pick: random.Random) -> Input:
    base = pick.choice(
        (
            ["elastic", "scene.toml", "-o", "out", "--steps", "2"],
            ["snow", "snow.toml", "--output", "out", "--scale", "1"],
            ["hawkes", "hawkes.toml", "-o", "out", "--quiet"],
            ["check", "scene.toml", "snow.toml"],
            ["mesh", "box", "--cell-size", "0.5", "-o", "box.msh"],
            ["render", "full", "--size", "64x48"],
            ["study", "contour", "-o", "out"],
        )
    )
    words = list(base)
    for _ in range(pick.choice((1, 1, 2, 3, 6))):
        at = pick.randrange(len(words) + 1)
        what = pick.choice(("insert", "insert", "drop", "replace", "replace", "cut", "twin"))
        if what == "insert" or at == len(words):
            words.insert(at, pick.choice(WORDS))
        elif what == "drop":
            del words[at]
        elif what == "replace":
            words[at] = pick.choice(WORDS)
        elif what == "cut":
            words[at] = words[at][: pick.randrange(len(words[at]) + 1)]
        else:
            words.insert(at, words[at])
    files = {"scene.toml": STATIC, "snow.toml": SNOW, "hawkes.toml": HAWKES, "full/notes.txt": "mine\n"}
    return Input("words", words, {name: text.encode() for name, text in files.items()})
