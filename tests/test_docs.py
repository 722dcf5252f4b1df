"""What the pages say can be followed: links lead somewhere, commands are commands, code runs."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from extremal.app.cli import COMMANDS, Parser
from extremal.app.errors import InputError
from extremal.app.options import split
from extremal.app.scene import read_scene

ROOT = Path(__file__).resolve().parent.parent
PAGES = [*sorted(ROOT.glob("*.md")), *sorted(ROOT.glob("docs/**/*.md"))]
LONGEST = 40  # lines of the code that shows how to add something


def identity(path: Path) -> str:
    return path.name


def prose(path: Path) -> str:
    """The page without blocks of code."""
    return re.sub(r"^ *```.*?^ *```", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    """Anchors of the headings, as GitHub and mkdocs make them: words joined by dashes."""
    words = (re.sub(r"[^\w\s-]", "", h).strip().lower() for h in re.findall(r"^#+ (.*)$", prose(path), re.MULTILINE))
    return {re.sub(r"[\s-]+", "-", heading) for heading in words}


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(), flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=identity)
def test_links_and_pictures_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in anchors(file), f"{page.name} links to {target}"


def test_the_site_names_no_page_that_is_missing():
    """Pages it does not name it finds by itself (docs/site/hooks.py)."""
    text = (ROOT / "mkdocs.yml").read_text()
    named = re.findall(r": ([\w-]+\.md)$", text[text.index("\nnav:") :], re.MULTILINE)
    assert named
    assert [name for name in named if not (ROOT / "docs" / name).exists()] == []


def test_every_scene_and_effect_has_a_page(monkeypatch):
    """Also one that docs/gallery.md says nothing of."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    generated = import_module("generated")
    pages = generated.scene_pages() | generated.effect_pages()
    told = generated.gallery((ROOT / "docs" / "gallery.md").read_text())
    silent = generated.gallery("# Gallery\n")
    for scene in (ROOT / "app" / "scenes").glob("*.toml"):
        link = f"](gallery/{scene.stem}.md)**"
        assert told.count(link) == silent.count(link) == 1
        assert scene.read_text() in pages[f"gallery/{scene.stem}.md"]
    for effect in generated.EFFECTS:
        assert effect.work in pages[f"effects/{effect.part}-{effect.name}.md"]


def commands(page: Path) -> Iterator[str]:
    """Quoted calls of the program that are meant to be typed: in code, up to a comment, no placeholder left out."""
    for line in page.read_text().splitlines():
        quoted = re.findall(r"`([^`]+)`", line) if "`" in line else [line.strip(" $")]
        for text in quoted:
            words = text.split("  #")[0].strip()
            call = re.match(r"(?:(?:mpirun|time) [^|]*?)?(?:\.venv/bin/)?extremal (\w.*)$", words)
            if call and call[1].split()[0] in COMMANDS and "..." not in call[1]:
                yield call[1]


@pytest.mark.parametrize("page", PAGES, ids=identity)
def test_quoted_commands_are_understood(page):
    """Their options exist, nothing is missing, scenes of ours that they name are there."""
    for line in commands(page):
        name, *words = shlex.split(line)
        module = import_module(f"extremal.app.{COMMANDS[name].module}")
        parser = Parser(prog=f"extremal {name}", allow_abbrev=False, add_help=False)
        try:
            parser.add_argument("-h", "--help", action="store_true")
            module.add_arguments(parser, words)
            ours, petsc = split(words, parser.single_dash()[0])
            parser.refuse_unknown(ours)
            if any(not word.startswith("-") for word in ours):  # else an option is spoken of, no call quoted
                parser.parse_args(ours)
        except InputError as error:
            pytest.fail(f"{page.name}: extremal {line}: {error}")
        assert COMMANDS[name].uses_petsc or not petsc, f"{page.name}: extremal {line}: no PETSc options there"
        for word in words:
            if word.startswith("app/"):
                assert (ROOT / word).exists(), f"{page.name}: extremal {line}: {word} does not exist"


@pytest.mark.parametrize("page", ["add-energy.md", "add-collider.md"])
def test_code_that_adds_something_runs_as_written(page, tmp_path):
    """Each script states its claims itself."""
    (code,) = blocks(ROOT / "docs" / page, "python")
    assert len(code.splitlines()) < LONGEST
    (tmp_path / "script.py").write_text(code)
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr


def test_the_scene_that_shows_how_runs_as_written(tmp_path: Path, launch: Callable):
    (scene,) = blocks(ROOT / "docs" / "add-scene.md", "toml")
    assert len(scene.splitlines()) < LONGEST
    file = tmp_path / "leaning_creature.toml"
    file.write_text(scene)
    assert read_scene(file).expect
    done = launch(0, "-m", "extremal.app", "elastic", file, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert os.path.getsize(tmp_path / "out" / "summary.png") > 10_000
