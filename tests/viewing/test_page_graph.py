"""The graph of nodes and topics on the page, and the tree of frames."""

from __future__ import annotations

from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page


def test_the_graph_is_drawn_and_the_frames_are_followed() -> None:
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        command.ok(
            "spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller"
        )
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:

            def picture() -> str:
                found = browser.find("<svg", "Html")
                return found[1]["content"] if found else ""

            browser.wait_for(lambda: ">/slider/joint_states</text>" in picture() and ">/clock</text>" in picture())
            browser.set("graph of", "joint_states")
            browser.wait_for(lambda: ">/slider/joint_states</text>" in picture() and ">/clock</text>" not in picture())
            browser.set("graph of", "joint_sates <b>")
            browser.wait_for(lambda: browser.find("joint_states", "Html") and not picture())
            browser.set("graph of", "")
            command.ok("spawn", "rrbot", "--name", "second")
            browser.wait_for(lambda: ">/second/" in picture())

            assert not client.call("/rosapi/subscribers", {"topic": "/tf"})["subscribers"]
            browser.set("tf tree", True)
            browser.wait_for(lambda: browser.find("link2 0.", "Html"))
            browser.set("tf tree", False)
            browser.wait_for(lambda: not client.call("/rosapi/subscribers", {"topic": "/tf"})["subscribers"])
