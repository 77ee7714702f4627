"""Builds the site of docs/ into build/site, and checks it: `make docs`.

Zensical does not look at anchors, at pages that the navigation leaves out, and at what a page loads from elsewhere.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parent.parent
SITE = ROOT / "build" / "site"
LOADED = {"script": "src", "img": "src", "source": "src", "video": "src", "iframe": "src", "link": "href"}
"""Tags whose address a browser loads without being asked to; `video` has `poster` beside it."""


class Page(HTMLParser):
    """What a page leads to, what it loads, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.anchors |= {named[key] or "" for key in ("id", "name") if key in named}
        if tag == "a" and (target := named.get("href")):
            self.links.append(target)
        for key in (LOADED.get(tag, ""), "poster"):
            if target := named.get(key):
                self.loaded.append(target)


def faults(site: Path) -> Iterator[str]:
    """One line for each link that leads nowhere, each file that is loaded from elsewhere, each page nobody finds."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    start = pages.get(site / "index.html")
    if start is None:
        yield "index.html: is not there"
        return
    found = {target_of(site / "index.html", link)[0] for link in start.links}
    for path, page in pages.items():
        name = path.relative_to(site)
        if path not in found and name.name != "404.html":
            yield f"{name}: is not in the navigation of mkdocs.yml"
        for target in page.loaded:
            if urlsplit(target).netloc:
                yield f"{name}: loads {target}, which is not in the site"
        for target in page.links + page.loaded:
            if urlsplit(target).scheme or urlsplit(target).netloc or name.name == "404.html":
                continue
            file, anchor = target_of(path, target)
            if not file.exists():
                yield f"{name}: leads to {target}, which is not there"
            elif anchor and file in pages and anchor not in pages[file].anchors:
                yield f"{name}: leads to {target}, and the page has no such heading"


def target_of(page: Path, target: str) -> tuple[Path, str]:
    """The file and the anchor that a relative address on a page means."""
    address = urlsplit(target)
    if not address.path:
        return page, unquote(address.fragment)
    file = (page.parent / unquote(address.path)).resolve()
    return (file / "index.html" if file.is_dir() else file), unquote(address.fragment)


def main() -> int:
    """Build and check. The exit code: 1 when anything is wrong."""
    zensical = [sys.executable, "-m", "zensical", "build", "--clean", "--strict"]
    done = subprocess.run(zensical, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout + done.stderr, file=sys.stderr)
        return 1
    wrong = list(faults(SITE))
    print("\n".join(wrong), file=sys.stderr, end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
