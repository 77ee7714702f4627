"""The example's web page in a real browser: roslibjs moves the block and draws where it is; foreign pages do not."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import node_scripts
import pytest
from daemon_fixture import ROOT, Runtime, running_daemon
from playwright.sync_api import sync_playwright
from rosbridge_client import RosbridgeClient  # its module finds those beside tests/gateways
from running_gateway import running_gateway
from waiting import eventually

CHROMIUM = shutil.which("chromium")
LIMIT_S = 300.0
"""A browser beside other tests takes its time."""
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    """The page with roslib beside it, as a user serves it; gives its port."""
    shutil.copy(ROOT / "examples" / "roslib_page.html", tmp_path)
    shutil.copy(node_scripts.modules() / "roslib-1" / "build" / "roslib.min.js", tmp_path)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=tmp_path))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield str(server.server_port)
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def world() -> Iterator[Runtime]:
    with running_daemon() as runtime, runtime.client() as client:
        started = ["joint_state_controller", "joint1_position_controller"]
        client.spawn("slider", controllers="config/slider_control.yaml", start=started)
        yield runtime


def test_the_page_moves_the_block_and_draws_it(world: Runtime, site: str) -> None:
    with running_gateway(world, "websocket") as url, sync_playwright() as playwright:
        with RosbridgeClient(url) as browser:
            assert browser.call("/rosapi/get_time")["result"]
        arguments = ["--no-sandbox", "--host-resolver-rules=MAP evil.example 127.0.0.1"]
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments, timeout=1000 * LIMIT_S)
        page = chromium.new_page()
        page.set_default_timeout(1000 * LIMIT_S)
        page.goto(f"http://localhost:{site}/roslib_page.html?url={url}")
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
