"""What mkdocs does not do by itself: equations, and pages made from scenes, effects and the code."""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path
from typing import Any

import ziamath
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
import generated  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
API = ROOT / "build" / "api"

ziamath.config.svg2 = False  # each drawing by itself, without names that another one could have
ziamath.config.precision = 2


def on_config(config: Any) -> Any:
    """Teach fenced blocks to show equations, and give the pages that the navigation does not name a place in it."""
    fence = {"name": "math", "class": "math", "format": _equation}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}
    named = set(_names(config.nav))
    further = sorted(path.name for path in Path(config.docs_dir).glob("*.md") if path.name not in named)
    if further:
        config.nav.append({"More": further})
    return config


def _names(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    return [name for entry in (nav.values() if isinstance(nav, dict) else nav) for name in _names(entry)]


def _equation(source: str, *_: Any, **__: Any) -> str:
    """Pictures of the lines of a `gathered` (so that each fits a phone): they need no font and no script."""
    lines = re.sub(r"\\(begin|end)\{gathered\}", "", source).split("\\\\\n")
    return "\n".join(_line(line.strip()) for line in lines)


def _line(formula: str) -> str:
    drawing = ziamath.Latex(formula, size=20).svg()
    return f'<div class="math" role="img" aria-label="{html.escape(formula)}">{drawing}</div>'


def on_files(files: Files, config: Any) -> Files:
    """Add a page for each scene and effect, and what pdoc has made."""
    for name, text in {**generated.scene_pages(), **generated.effect_pages()}.items():
        files.append(File.generated(config, name, content=text))
    for path in sorted(API.rglob("*")):
        if path.is_file():
            files.append(File.generated(config, f"api/{path.relative_to(API)}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn the gallery into cards, and complete the pages that list scenes, effects or modules."""
    name = page.file.src_path
    if name == "gallery.md":
        return generated.gallery(markdown)
    if name == "effects.md":
        return markdown + generated.effect_list()
    if name == "api.md":
        return markdown + generated.module_list(API)
    return markdown
