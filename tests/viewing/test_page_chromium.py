"""The page in a real browser: Chromium without a display, which draws by software."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import av
import numpy as np
import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, served_page
from playwright.sync_api import Browser, Page, sync_playwright
from waiting import eventually as within

CHROMIUM = shutil.which("chromium")
LIMIT_S = 300.0
"""A browser that draws by software beside other tests takes its time."""
LIMIT_MS = 1000 * LIMIT_S
eventually = partial(within, limit_s=LIMIT_S)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        yield browser
        browser.close()


class Tab:
    """A tab of the browser with the page in it. Errors of the page, and what it asks of other machines, are kept."""

    def __init__(self, chromium: Browser, url: str, more: str = "") -> None:
        self.errors: list[str] = []
        self._host = urlsplit(url).netloc
        self.page: Page = chromium.new_page(viewport={"width": 1280, "height": 720})
        self.page.set_default_timeout(LIMIT_MS)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda told: self.errors.append(told.text) if told.type == "error" else None)
        self.page.on("request", lambda request: self._check(request.url))
        self.page.goto(f"{url}?fixedDpr=0.5{more}")  # a quarter of the pixels

    def _check(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme in ("http", "https", "ws", "wss") and parts.netloc != self._host:
            self.errors.append(f"asks for {url}")

    def pixels(self) -> np.ndarray:
        """What is to be seen: height x width x 3."""
        picture = self.page.screenshot(timeout=LIMIT_MS)
        with av.open(io.BytesIO(picture)) as file:
            return next(file.decode(video=0)).to_ndarray(format="rgb24")

    def height_of_the_block(self) -> float | None:
        """How far above the lower edge the lowest of what is black in the middle is; None: nothing is."""
        pixels = self.pixels()[:, 600:680]
        rows, _ = np.nonzero(pixels.max(axis=2) < 60)
        return float(pixels.shape[0] - np.percentile(rows, 98)) if len(rows) > 50 else None


@pytest.fixture
def tab(chromium: Browser, page: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Tab]:
    one = Tab(chromium, page)
    yield one
    folder = Path(os.environ.get("SLIDECTL_SCREENSHOTS", tmp_path))
    one.page.screenshot(path=folder / f"{request.node.name}.png", timeout=LIMIT_MS)
    one.page.close()
    assert not one.errors


def test_the_block_is_seen_and_slides_up(world: CommandLine, tab: Tab) -> None:
    eventually(lambda: tab.height_of_the_block() is not None)
    before = tab.height_of_the_block()
    assert before is not None
    with world.client() as client:
        client.publish("/slider/joint1_position_controller/command", {"data": 1.0})
        client.step(seconds=10)
    eventually(lambda: (tab.height_of_the_block() or 0.0) > before + 20)


def test_keys_and_buttons_and_a_reload(world: CommandLine, tab: Tab) -> None:
    with world.client() as client:
        status = client.call("/slidectl/status")
        tab.page.get_by_role("button", name="Step").wait_for()
        tab.page.keyboard.press(".")
        eventually(lambda: client.call("/slidectl/status")["cycles"] == status["cycles"] + 1)
        tab.page.keyboard.press("Space")
        eventually(lambda: not client.call("/slidectl/status")["paused"])
        tab.page.get_by_role("button", name="Pause").click()
        eventually(lambda: client.call("/slidectl/status")["paused"])
        tab.page.reload()
        tab.page.get_by_role("button", name="Resume").wait_for()


def test_a_slider_is_dragged_a_controller_stopped_and_a_gain_turned(world: CommandLine, tab: Tab) -> None:
    with world.client() as client:

        def set_point() -> float:
            client.step(10)  # the state is published at every tenth cycle
            return float(states.get()["set_point"])

        with client.subscribe("/slider/joint1_position_controller/state", queue_length=1) as states:
            handle = tab.page.get_by_role("slider").first
            handle.wait_for()
            box = handle.bounding_box()
            assert box is not None
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            before = set_point()
            tab.page.mouse.move(x, y)
            tab.page.mouse.down()
            for step in range(1, 6):
                tab.page.mouse.move(x + (-6 if before > 0.5 else 6) * step, y)
            tab.page.mouse.up()
            eventually(lambda: abs(set_point() - before) > 0.05)

            def is_there() -> bool:
                client.step(seconds=1)
                return abs(float(client.call("/slidectl/joint_states")["position"][-1]) - set_point()) < 0.05

            eventually(is_there)

        tab.page.get_by_text("Controllers", exact=True).click()
        manager = client.controllers("/slider")
        tab.page.get_by_role("button", name="stop", exact=True).first.click()
        eventually(lambda: "stopped" in manager.states().values())
        tab.page.get_by_role("button", name="start", exact=True).first.click()
        eventually(lambda: set(manager.states().values()) == {"running"})

        tab.page.get_by_text("Gains", exact=True).click()
        gain = tab.page.get_by_label("p", exact=True)
        gain.fill("123")
        gain.press("Enter")
        eventually(lambda: client.params["/slider/joint1_position_controller/pid/p"] == 123)


def test_a_link_opens_with_its_plot(world: CommandLine, chromium: Browser, page: str) -> None:
    tab = Tab(chromium, page, "&plot=joint1_position_controller/state/{set_point,process_value}")
    with world.client() as client:
        legend = tab.page.locator(".uplot .u-label", has_text="set_point")
        eventually(lambda: client.step(100) and legend.count())
    assert tab.page.locator(".uplot canvas").count() == 1
    tab.page.close()
    assert not tab.errors


def test_the_page_says_that_the_daemon_has_gone(chromium: Browser) -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        with served_page(command, "--read-only") as url:
            tab = Tab(chromium, url)
            tab.page.get_by_text("only looking").wait_for()
            assert tab.page.get_by_role("button", name="Step").is_disabled()
            command.ok("daemon", "stop")
            tab.page.get_by_text("the daemon has gone").first.wait_for()
            command.ok("daemon", "start", "--paused")
            tab.page.get_by_text("only looking").wait_for()
            tab.page.close()
            assert not tab.errors


def test_without_its_token_the_page_is_not_shown(world: CommandLine, chromium: Browser) -> None:
    with served_page(world, "--token", "open-sesame") as url:
        page = chromium.new_page()
        page.goto(url.partition("?")[0])
        assert "a token is needed" in page.content()
        page.goto(url)
        page.get_by_role("button", name="Step").wait_for(timeout=LIMIT_MS)
        assert "open-sesame" not in page.url
        page.close()
