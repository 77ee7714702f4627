"""The example's web page in a real browser: roslibjs moves the block and draws where it is; foreign pages do not."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import node_scripts
import pytest
from daemon_fixture import ROOT, Runtime, running_daemon, shown
from playwright.sync_api import sync_playwright
from rosbridge_client import RosbridgeClient  # its module finds those beside tests/gateways
from running_gateway import running_gateway
from waiting import eventually

CHROMIUM = shutil.which("chromium")
LIMIT_S = 300.0
"""A browser beside other tests takes its time."""
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    """The page with roslib beside it, by the commands of docs/websocket.md; gives its port. npm packs what is here."""
    shutil.copy(ROOT / "examples" / "roslib_page.html", tmp_path)
    get, start, (*serve, port) = shown("websocket.md", "npm pack")
    assert start[-2:] == ["--origin", f"http://localhost:{port}"]
    unpack = get[get.index("&&") + 1 :]
    assert [*get[:2], port] == ["npm", "pack", "8000"]
    pack = ["npm", "pack", "--ignore-scripts", str(node_scripts.modules() / "roslib-1")]
    for words in (pack, unpack):
        subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / f"{get[2].replace('@', '-')}.tgz").exists()
    words = [sys.executable, "-u", *serve[1:], "0", "--bind", "127.0.0.1"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        yield server.stdout.readline().split()[5]
        server.terminate()


@pytest.fixture
def world() -> Iterator[Runtime]:
    with running_daemon() as runtime, runtime.client() as client:
        started = ["joint_state_controller", "joint1_position_controller"]
        client.spawn("slider", controllers="config/slider_control.yaml", start=started)
        yield runtime


def test_the_page_moves_the_block_and_draws_it(world: Runtime, site: str) -> None:
    origin = f"http://localhost:{site}"
    with running_gateway(world, "websocket", origins=[origin]) as url, sync_playwright() as playwright:
        with RosbridgeClient(url) as browser:
            assert browser.call("/rosapi/get_time")["result"]
        arguments = ["--no-sandbox", "--host-resolver-rules=MAP evil.example 127.0.0.1"]
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments, timeout=1000 * LIMIT_S)
        page = chromium.new_page()
        page.set_default_timeout(1000 * LIMIT_S)
        page.goto(f"{origin}/roslib_page.html?url={url}")
        page.get_by_text("connected", exact=True).wait_for()
        page.locator("#command").fill("0.9")

        def position() -> float:
            return float(page.locator("#position").inner_text())

        eventually(lambda: page.locator("#position").inner_text() != "?", limit_s=LIMIT_S)
        eventually(lambda: position() > 0.8, limit_s=LIMIT_S)
        drawn = "plot.getContext('2d').getImageData(0, 0, 400, 200).data.filter(Boolean).length"
        eventually(lambda: page.evaluate(f"() => {drawn}") > 100, limit_s=LIMIT_S)

        page.goto(f"http://evil.example:{site}/roslib_page.html?url={url}")
        page.get_by_text("not connected", exact=True).wait_for()
        assert page.locator("#position").inner_text() == "?"
        chromium.close()
