"""The page with its scene in a real browser: Chromium without a display, which draws by software."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from page_browser import CommandLine, served_page
from panels_tab import CHROMIUM, LIMIT_MS, PanelsTab, chromium, eventually
from playwright.sync_api import Browser

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium(draws=True) as one:
        yield one


class DrawnTab(PanelsTab):
    """A tab whose scene is looked at."""

    def pixels(self) -> np.ndarray:
        """What is to be seen: height x width x 3."""
        picture = self.page.screenshot(timeout=LIMIT_MS)
        with av.open(io.BytesIO(picture)) as file:
            return next(file.decode(video=0)).to_ndarray(format="rgb24")

    def height_of_the_block(self) -> float | None:
        """How far above the lower edge the lowest of what is black in the middle is; None: nothing is."""
        pixels = self.pixels()[60:, 600:680]  # below the toolbar
        rows, _ = np.nonzero(pixels.max(axis=2) < 60)
        return float(pixels.shape[0] - np.percentile(rows, 98)) if len(rows) > 50 else None


@pytest.fixture
def tab(browser: Browser, page: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[DrawnTab]:
    one = DrawnTab(browser, page, size=(1280, 720))
    for side in ("robot", "data"):  # the scene has the whole window then
        one.button(f"Hide the {side} panels").click()
    yield one
    folder = Path(os.environ.get("SLIDECTL_SCREENSHOTS", tmp_path))
    one.page.screenshot(path=folder / f"{request.node.name}.png", timeout=LIMIT_MS)
    one.close()


def test_the_block_is_seen_and_slides_up(world: CommandLine, tab: DrawnTab) -> None:
    eventually(lambda: tab.height_of_the_block() is not None)
    before = tab.height_of_the_block()
    assert before is not None
    with world.client() as client:
        client.publish("/slider/joint1_position_controller/command", {"data": 1.0})
        client.step(seconds=10)
    eventually(lambda: (tab.height_of_the_block() or 0.0) > before + 20)


def test_without_its_token_the_page_is_not_shown(world: CommandLine, browser: Browser) -> None:
    with served_page(world, "--token", "open-sesame") as url:
        page = browser.new_page()
        page.goto(url.partition("?")[0])
        assert "a token is needed" in page.content()
        page.goto(url)
        page.get_by_text("joint1_position_controller").first.wait_for(timeout=LIMIT_MS)
        assert "open-sesame" not in page.url
        page.close()
