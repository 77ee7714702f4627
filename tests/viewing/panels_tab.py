"""Chromium with a page of `slidectl view` in it, operated by its panels."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from urllib.parse import urlsplit

from playwright.sync_api import Browser, Locator, Page, sync_playwright
from waiting import eventually as within

CHROMIUM = shutil.which("chromium")
LIMIT_S = 300.0
"""A browser beside other tests takes its time."""
LIMIT_MS = 1000 * LIMIT_S
eventually = partial(within, limit_s=LIMIT_S)
_NO_WEBGL = ("WebGL", "WebGPU")
"""What viser says of a browser that cannot draw."""


@contextmanager
def chromium(draws: bool) -> Iterator[Browser]:
    """A browser without a display. One that `draws` the scene does so by software, which takes its time."""
    how = (
        ("--use-angle=swiftshader", "--enable-unsafe-swiftshader") if draws else ("--disable-3d-apis", "--disable-gpu")
    )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *how])
        yield browser
        browser.close()


class PanelsTab:
    """A tab of the browser with the page in it. Errors of the page, and what it asks of other machines, are kept."""

    def __init__(self, browser: Browser, url: str, more: str = "", size: tuple[int, int] = (1440, 900)) -> None:
        self.errors: list[str] = []
        self._host = urlsplit(url).netloc
        width, height = size
        self.page: Page = browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(LIMIT_MS)
        self.page.on("pageerror", lambda error: self._keep(str(error)))
        self.page.on("console", lambda told: self._keep(told.text) if told.type == "error" else None)
        self.page.on("request", lambda request: self._check(request.url))
        self.page.goto(f"{url}?fixedDpr=0.5{more}")  # a quarter of the pixels

    def _keep(self, text: str) -> None:
        if not any(word in text for word in _NO_WEBGL) and "WebSocket connection" not in text:
            self.errors.append(text)

    def _check(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme in ("http", "https", "ws", "wss") and parts.netloc != self._host:
            self.errors.append(f"asks for {url}")

    def panel(self, title: str) -> None:
        """Show a panel."""
        self.page.get_by_role("tab", name=title).click()

    def button(self, name: str) -> Locator:
        """The button of that name."""
        return self.page.get_by_role("button", name=name, exact=True).first

    def notice(self, text: str) -> Locator:
        """A notice with a text, which may still be to come."""
        found = self.page.locator("#slidectl .notice", has_text=text).last
        found.wait_for()
        return found

    def close(self) -> None:
        """Close the tab. It must not have said anything bad."""
        self.page.close()
        assert not self.errors
