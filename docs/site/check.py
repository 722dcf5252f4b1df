"""Read the built site in headless Chromium, at the width of a phone and of a screen: `make docs-check`.

Every page is opened from the disk. Told are: errors on the console, requests that fail or leave the site, pictures that
do not load, links and anchors to nowhere, pages wider than the window, formulas that were not set. Exit status 1 if
there is any.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from playwright.sync_api import Page, sync_playwright

WIDTHS = {"phone": 390, "screen": 1280}  # [pixels]
# what a page says of itself, once all of it has been scrolled into view
FACTS = """() => ({
    width: document.documentElement.scrollWidth,
    pictures: [...document.images].filter(i => !(i.complete && i.naturalWidth)).map(i => i.getAttribute("src")),
    links: [...document.querySelectorAll("a[href]")].map(a => a.href),
    anchors: [...document.querySelectorAll("[id], a[name]")].map(e => e.id || e.name),
    formulas: document.querySelectorAll("pre > code.language-math").length,
})"""


def main(site: Path) -> int:
    """Check all pages of the site; prints what is wrong."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        print("docs-check: needs Chromium (apt-get install chromium)", file=sys.stderr)
        return 1
    # pdoc's pages are its own; 404.html is for a server, whose root its links begin at
    pages = sorted(path for path in site.rglob("*.html") if path.name != "404.html" and "api" not in path.parts)
    found: list[str] = []
    known: dict[Path, Any] = {}
    with sync_playwright() as play:
        arguments = ["--no-sandbox", "--allow-file-access-from-files"]
        chromium = play.chromium.launch(executable_path=browser, args=arguments)
        for name, width in WIDTHS.items():
            page = chromium.new_page(viewport={"width": width, "height": 800})
            said: list[str] = []
            page.on("console", lambda m, said=said: said.append(f"console: {m.text}") if m.type == "error" else None)
            page.on("pageerror", lambda error, said=said: said.append(f"script: {error}"))
            page.on("requestfailed", lambda r, said=said: said.append(f"request failed: {r.url}"))
            page.on("request", lambda r, said=said: None if _inside(r.url) else said.append(f"outside: {r.url}"))
            for path in pages:
                said.clear()
                facts = _read(page, path)
                known[path] = facts
                found += [f"{path.relative_to(site)} ({name}): {words}" for words in [*said, *_wrong(facts, width)]]
            page.close()
        chromium.close()
    found += [f"{path.relative_to(site)}: {words}" for path in pages for words in _broken(path, site, known)]
    print("\n".join([*found, f"docs-check: {len(pages)} pages at {len(WIDTHS)} widths, {len(found)} things wrong"]))
    return 1 if found else 0


def _inside(url: str) -> bool:
    return urlsplit(url).scheme in ("file", "data", "blob", "about")


def _read(page: Page, path: Path) -> Any:
    page.goto(path.resolve().as_uri(), wait_until="load")
    page.evaluate("() => { for (const i of document.images) i.loading = 'eager' }")
    page.wait_for_function("() => [...document.images].every(i => i.complete)", timeout=20_000)
    return page.evaluate(FACTS)


def _wrong(facts: Any, width: int) -> Iterator[str]:
    if facts["width"] > width:
        yield f"is {facts['width']} pixels wide, the window {width}"
    for picture in facts["pictures"]:
        yield f"picture does not load: {picture}"
    if facts["formulas"]:
        yield f"{facts['formulas']} formulas are not set"


def _broken(path: Path, site: Path, known: dict[Path, Any]) -> Iterator[str]:
    for link in sorted(set(known[path]["links"])):
        parts = urlsplit(link)
        if parts.scheme != "file":
            continue
        target = Path(unquote(parts.path))
        if not target.is_file():
            yield f"link to nowhere: {link}"
            continue
        there = next((facts for page, facts in known.items() if page.resolve() == target), None)
        if parts.fragment and there is not None and unquote(parts.fragment) not in there["anchors"]:
            yield f"link to an anchor that is not there: {target.relative_to(site.resolve())}#{parts.fragment}"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
