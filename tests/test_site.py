"""The site of the documentation: it is built without a fault, and a browser reads it without the network."""

from __future__ import annotations

import runpy
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).parent.parent
SITE = ROOT / "build" / "site"
BUILD = ROOT / "scripts" / "build_site.py"
CHROMIUM = shutil.which("chromium")
LIMIT_MS = 60_000

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture(scope="module")
def site() -> Path:
    """The site, built anew."""
    done = subprocess.run([sys.executable, BUILD], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return SITE


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Nothing."""


@pytest.fixture(scope="module")
def served(site: Path) -> Iterator[str]:
    """The address of the site on a server of its own."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"], timeout=LIMIT_MS)
        yield browser
        browser.close()


@pytest.fixture
def tab(chromium: Browser) -> Iterator[Page]:
    """A window of 1024 x 700."""
    page = chromium.new_page(viewport={"width": 1024, "height": 700})
    page.set_default_timeout(LIMIT_MS)
    yield page
    page.close()


def addresses(site: Path, base: str) -> list[str]:
    return [f"{base}/{page.relative_to(site)}" for page in sorted(site.rglob("*.html"))]


def search(tab: Page, words: str) -> str:
    """What the search shows for these words."""
    tab.locator("[data-md-component=search] button").first.click()
    field = tab.get_by_placeholder("Search").last
    field.fill(words)
    results = tab.locator("li a[href]").filter(has_text=words)
    results.first.wait_for()
    return " ".join(results.all_inner_texts())


def test_the_navigation_has_its_five_groups(site: Path) -> None:
    start = (site / "index.html").read_text(encoding="utf-8")
    places = [start.index(f" {name}\n") for name in ("Start", "Tutorials", "How-to", "Reference", "Explanation")]
    assert places == sorted(places)


def test_what_is_wrong_with_a_site_is_named(tmp_path: Path) -> None:
    faults = runpy.run_path(str(BUILD))["faults"]
    (tmp_path / "index.html").write_text(
        '<a href="there.html#no">a</a><a href="gone.html">b</a><a href="#here" id="here">c</a>'
        '<script src="https://cdn.example/x.js"></script><img src="gone.png"><a href="https://example.org">d</a>'
    )
    (tmp_path / "there.html").write_text('<h1 id="yes">x</h1>')
    (tmp_path / "lost.html").write_text("x")
    assert sorted(faults(tmp_path)) == [
        "index.html: leads to gone.html, which is not there",
        "index.html: leads to gone.png, which is not there",
        "index.html: leads to there.html#no, and the page has no such heading",
        "index.html: loads https://cdn.example/x.js, which is not in the site",
        "lost.html: is not in the navigation of mkdocs.yml",
    ]


@needs_chromium
def test_no_page_loads_anything_from_elsewhere_or_complains(site: Path, served: str, tab: Page) -> None:
    asked: list[str] = []
    told: list[str] = []
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("console", lambda message: told.append(f"{tab.url}: {message.text}"))
    tab.on("pageerror", lambda error: told.append(f"{tab.url}: {error}"))
    for address in addresses(site, served):
        tab.goto(address)
    assert {url for url in asked if not url.startswith((served, "data:", "blob:"))} == set()
    assert told == []


@needs_chromium
def test_no_table_no_code_in_a_sentence_and_no_page_is_wider_than_its_column(site: Path, tab: Page) -> None:
    wide = []
    for address in addresses(site, site.as_uri()):
        tab.goto(address)
        wide += [
            f"{Path(address).name}: {text}"
            for text in tab.evaluate("""() => {
                const column = document.querySelector("article").getBoundingClientRect();
                const within = "article table, article :is(p, li) > code";
                const out = [...document.querySelectorAll(within)].filter((part) =>
                    part.getBoundingClientRect().right > column.right + 1
                    || part.scrollWidth > part.parentElement.clientWidth + 1);
                const texts = out.map((part) => part.innerText.slice(0, 60));
                if (document.documentElement.scrollWidth > innerWidth) texts.push("the page itself");
                return texts;
            }""")
        ]
    assert wide == []


@needs_chromium
@pytest.mark.parametrize("how", ["served", "file"])
def test_the_search_finds(how: str, site: Path, served: str, tab: Page) -> None:
    for words, page in (("install", "Install"), ("gains", "RRBot, live"), ("RViz", "See")):
        tab.goto(f"{served if how == 'served' else site.as_uri()}/index.html")
        assert page in search(tab, words), words


@needs_chromium
def test_the_button_copies_the_commands_without_prompts_and_output(served: str, chromium: Browser) -> None:
    context = chromium.new_context(permissions=["clipboard-read", "clipboard-write"])
    tab = context.new_page()
    tab.goto(f"{served}/first-steps.html")
    tab.locator(".language-console .md-code__button").first.click()
    copied = tab.evaluate("navigator.clipboard.readText()")
    context.close()
    lines = [line for line in copied.splitlines() if line]
    assert lines[0] == "slidectl daemon start --rtf max"
    assert not any(line.startswith(("$", "daemon default")) for line in lines)


@needs_chromium
def test_light_and_dark_follow_the_system(served: str, chromium: Browser) -> None:
    for system, scheme in (("light", "default"), ("dark", "slate")):
        context = chromium.new_context(color_scheme=system)
        tab = context.new_page()
        tab.goto(f"{served}/index.html")
        assert tab.locator("body").get_attribute("data-md-color-scheme") == scheme
        context.close()
