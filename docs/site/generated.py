"""Markdown made from the scenes of app/scenes, the gallery's own words about them, and the ledger of effects.

A scene that docs/gallery.md does not speak of has its card and its page all the same, from the comment it begins with.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from extremal.app.effects import EFFECTS, Effect

ROOT = Path(__file__).resolve().parents[2]
PARTS = {"elastic": "Elasticity", "snow": "Snow", "hawkes": "Networks"}
# values of keys that leave the effect off
OFF: Mapping[str, tuple[object, ...]] = {
    "extension": ("none",),
    "type": ("static",),
    "degree": (1,),
    "beta": (0,),
    "hardening": (0,),
    "shape": ("mattress", "triangle", "tetrahedron", "simplex"),
}
ROW = re.compile(
    r"^\| \[(?P<title>.+?)\]\(#(?P<anchor>[\w-]+)\) \| `(?P<command>[^`]+)` \| (?P<cost>.*?) \| ?(?P<knobs>.*?) ?\|$"
)


@dataclass(frozen=True)
class Scene:
    """A scene as the gallery shows it; `text` is Markdown whose links are those of a page in docs/."""

    name: str
    title: str
    part: str
    lead: str
    text: str
    command: str
    cost: str
    knobs: str
    anchor: str

    @property
    def picture(self) -> str:
        """The picture's path in docs/, "" without one."""
        path = f"images/{self.name}.png"
        return path if (ROOT / "docs" / path).is_file() else ""


@dataclass(frozen=True)
class Section:
    """A piece of docs/gallery.md: the heading (with its marks), and what stands under it up to the next."""

    heading: str
    body: str

    @property
    def anchor(self) -> str:
        """As Markdown makes it from the heading."""
        words = re.sub(r"[^\w\s-]", "", self.heading.lstrip("#").strip().lower())
        return re.sub(r"[\s-]+", "-", words)


def sections(markdown: str) -> list[Section]:
    """The pieces of a page; the first has no heading."""
    pieces = re.split(r"^(#{1,3} .*)$", markdown, flags=re.MULTILINE)
    return [Section("", pieces[0]), *(Section(a, b) for a, b in zip(pieces[1::2], pieces[2::2]))]


def rows(text: str) -> Iterator[tuple[str, Mapping[str, str]]]:
    """The gallery's rows: name of the scene, and title, anchor, command, cost and knobs."""
    for line in text.splitlines():
        row = ROW.match(line)
        scene = row and re.search(r"app/scenes/(\w+)\.toml", row["command"])
        if row and scene:
            yield scene[1], row.groupdict()


@cache
def scenes() -> Mapping[str, Scene]:
    """All scenes by name."""
    page = (ROOT / "docs" / "gallery.md").read_text()
    told, texts = dict(rows(page)), {section.anchor: section.body for section in sections(page)}
    paths = sorted((ROOT / "app" / "scenes").glob("*.toml"))
    return {path.stem: _scene(path, told.get(path.stem, {}), texts) for path in paths}


def _scene(path: Path, row: Mapping[str, str], texts: Mapping[str, str]) -> Scene:
    source = path.read_text()
    table = tomllib.loads(source)
    comment = re.match(r"(?:#.*\n)*", source)
    said = "\n".join(line.removeprefix("#").removeprefix(" ") for line in comment[0].splitlines()) if comment else ""
    lead, _, rest = said.partition("\n\n")
    command = re.search(r"^ +((?:mpirun .*)?extremal .*)$", said, re.MULTILINE)
    cost = re.search(r"[Aa]bout ([\w.]+ (?:seconds?|minutes?|s|min))\b", said)
    knobs = re.search(r"To try: (.*?)\.?$", said, re.MULTILINE | re.DOTALL)
    part = table.get("part", "elastic")
    title = row.get("title", table.get("title", path.stem))
    text = texts.get(row.get("anchor", ""), rest.split("\n    ")[0])
    return Scene(
        name=path.stem,
        title=title[:1].upper() + title[1:],
        part=part,
        lead=" ".join(lead.split()),
        text=re.sub(r"^!\[.*\]\(.*\)$", "", text, flags=re.MULTILINE).strip(),
        command=command[1] if command else row.get("command", f"extremal {part} app/scenes/{path.name}"),
        cost=row.get("cost") or (cost[1] if cost else "seconds"),
        knobs=row.get("knobs") or (" ".join(knobs[1].split()) if knobs else ""),
        anchor=row.get("anchor", path.stem.replace("_", "-")),
    )


def gallery(markdown: str) -> str:
    """docs/gallery.md with cards for its tables and for the scenes it does not name; their sections are pages."""
    out, shown = [], set[str]()
    anchors = {scene.anchor for scene in scenes().values()}
    for section in sections(markdown):
        here = [name for name, _ in rows(section.body) if name in scenes()]
        if section.anchor in anchors and section.heading.startswith("###") and not here:
            continue
        body = "\n".join(line for line in section.body.splitlines() if not ROW.match(line))
        body = re.sub(r"^\| scene \| command .*\n\|[-| ]+\n?", "", body, flags=re.MULTILINE)
        out += [section.heading, body, _cards(here, shown)]
    further = [name for name in scenes() if name not in shown]
    if further:
        out += ["## Further scenes", _cards(further, shown)]
    return "\n\n".join(out)


def _cards(names: list[str], shown: set[str]) -> str:
    if not names:
        return ""
    cards = []
    for name in names:
        scene = scenes()[name]
        first = all(scenes()[other].anchor != scene.anchor for other in shown)
        mark = f' id="{scene.anchor}"' if first else ""
        link = f"gallery/{name}.md"
        picture = f"[![{scene.title}]({scene.picture}){{ loading=lazy }}]({link})\n\n" if scene.picture else ""
        knobs = f"\n\nTo try: {scene.knobs}" if scene.knobs else ""
        cards.append(
            f'<div class="scene" markdown{mark}>\n{picture}**[{scene.title}]({link})**, {scene.cost}\n\n'
            f"{scene.lead}{knobs}\n\n`{_short(scene)}`\n</div>"
        )
        shown.add(name)
    return '<div class="scenes" markdown>\n' + "\n".join(cards) + "\n</div>"


def _short(scene: Scene) -> str:
    return f"extremal {scene.part} app/scenes/{scene.name}.toml"


def scene_pages() -> dict[str, str]:
    """A page for each scene: picture, words, command, cost, what to try, the file."""
    pages = {}
    for name, scene in scenes().items():
        picture = f"![{scene.title}](../{scene.picture})\n\n" if scene.picture else ""
        knobs = f"- to try: {scene.knobs}\n" if scene.knobs else ""
        source = (ROOT / "app" / "scenes" / f"{name}.toml").read_text()
        effects = ", ".join(f"[{_title(e)}](../effects/{_file(e)})" for e in EFFECTS if _uses(source, scene.part, e))
        pages[f"gallery/{name}.md"] = (
            f"# {scene.title}\n\n{scene.lead}\n\n{picture}{_deeper(scene.text)}\n\n"
            f"```sh\n{scene.command}\n```\n\n"
            f"- cost on one core: {scene.cost}\n{_deeper(knobs)}- effects that it names: {effects}\n\n"
            f"## The scene file\n\n`app/scenes/{name}.toml`; every key is explained in [scenes](../scenes.md).\n\n"
            f"```toml\n{source}```\n\nBack to the [gallery](../gallery.md#{scene.anchor}).\n"
        )
    return pages


def _deeper(text: str) -> str:
    """Links of a page in docs/ as a page one folder below needs them."""
    return re.sub(r"\]\((?!https?:|#|\.\./)", "](../", text)


def _uses(source: str, part: str, effect: Effect) -> bool:
    """Whether a scene says a key that switches the effect on."""
    if effect.part not in (part, "any"):
        return False
    table = tomllib.loads(source)
    keys = re.findall(r"\[+([\w.]+)\]+(?: (\w+)(?: = \"(\w+)\")?)?", effect.keys)
    # where several effects share a key, its value is the name of one
    shared = any(other.keys == effect.keys and other.part == effect.part for other in EFFECTS if other != effect)
    return any(_switched_on(table.get(name), key, wanted or effect.name * shared) for name, key, wanted in keys)


def _switched_on(value: object, key: str, wanted: str) -> bool:
    """Whether a scene has a table (or several), in it the key if one is asked for, and the value."""
    if value is None or not key:
        return value is not None
    said = [entry[key] for entry in (value if isinstance(value, list) else [value]) if key in entry]
    return any(word == wanted if wanted else word not in OFF.get(key, ()) for word in said)


def _title(effect: Effect) -> str:
    return effect.name.replace("_", " ")


def _file(effect: Effect) -> str:
    return f"{effect.part}-{effect.name}.md"


def effect_pages() -> dict[str, str]:
    """A page for each effect of the ledger."""
    return {f"effects/{_file(effect)}": _effect(effect) for effect in EFFECTS}


def _effect(effect: Effect) -> str:
    part = PARTS.get(effect.part, "All parts")
    where = ", ".join(f"[`{module}`](../api/extremal/{module.replace('.', '/')}.html)" for module in effect.where)
    table = re.search(r"\[+([\w.]+)\]+", effect.keys)
    root = {"elastic": "extremal-elastic", "snow": "extremal-snow", "hawkes": "extremal-hawkes"}.get(effect.part)
    explained = "../scenes.md" + (f"#{root}" if root else "")
    sources = {name: (ROOT / "app" / "scenes" / f"{name}.toml").read_text() for name in scenes()}
    using = [s for name, s in scenes().items() if table and _uses(sources[name], s.part, effect)]
    some = "".join(f"- [{s.title}](../gallery/{s.name}.md): {s.lead}\n" for s in using[:6])
    more = f"- and {len(using) - 6} more in the [gallery](../gallery.md)\n" if len(using) > 6 else ""
    events = ", ".join(f"`{event}`" for event in effect.events) or "none: it is a branch of a loop that runs anyway"
    brings = ", ".join(f"`{library}`" for library in effect.brings) or "nothing"
    overview = " All effects: [effects](../effects.md)." if (ROOT / "docs" / "effects.md").is_file() else ""
    return (
        f"# {_title(effect).capitalize()}\n\n{part}: {effect.work}.\n\n"
        f"- switched on by: `{effect.keys}`, see [scene files]({explained})\n- done in: {where}\n"
        f"- PETSc events: {events}\n- loads: {brings}\n\n"
        "Where the scene does not ask for it, none of these events is in `-log_view`, and nothing is loaded for it. "
        "`extremal check --cost SCENE` says what it will take, `effects` in `run.json` what it took; "
        f"[PETSc](../petsc.md#where-the-time-goes) says how to read the events.{overview}\n\n"
        + (f"## Scenes that say so\n\n{some}{more}" if using else "")
    )


def effect_list() -> str:
    """Links to the pages of all effects."""
    lines = []
    for part in ("any", *PARTS):
        links = ", ".join(f"[{_title(e)}](effects/{_file(e)})" for e in EFFECTS if e.part == part)
        lines.append(f"- {PARTS.get(part, 'All parts')}: {links}")
    return "\n\n## A page for each\n\n" + "\n".join(lines) + "\n"


def module_list(folder: Path) -> str:
    """Links to pdoc's pages, by package."""
    lines = []
    for path in sorted((folder / "extremal").glob("*.html")):
        inside = sorted(p for p in (folder / "extremal" / path.stem).glob("*.html"))
        names = ", ".join(f"[`{p.stem}`](api/extremal/{path.stem}/{p.name})" for p in inside)
        lines.append(f"- [**{path.stem}**](api/extremal/{path.name}): {names}" if names else f"- **{path.stem}**")
    return "\n\n" + "\n".join(lines) + "\n"
