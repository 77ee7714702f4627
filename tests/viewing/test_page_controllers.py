"""The panel of controllers: what there is, what buttons and switches do, and why something is refused."""

from __future__ import annotations

from pathlib import Path

from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page

TWO = """
slider:
  position:
    type: effort_controllers/JointPositionController
    joint: joint1
    pid: {p: 100.0, d: 10.0}
  effort:
    type: effort_controllers/JointEffortController
    joint: joint1
"""


def test_controllers_are_loaded_started_switched_and_unloaded(tmp_path: Path) -> None:
    (tmp_path / "two.yaml").write_text(TWO, "utf-8")
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        command.ok("spawn", "slider", "--controllers", str(tmp_path / "two.yaml"))
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:
            manager = client.controllers("/slider")

            def becomes(**states: str) -> None:
                browser.wait_for(lambda: manager.states() == states, f"not {states}")

            browser.set("position", "load and start", "ButtonGroup")
            becomes(position="running")
            browser.wait_for(lambda: browser.element("position", "ButtonGroup")["options"] == ["stop"])
            browser.element("EffortJointInterface: joint1", "Html")
            browser.set("effort", "load", "ButtonGroup")
            becomes(position="running", effort="initialized")

            browser.wait_for(lambda: browser.element("effort", "ButtonGroup")["options"] == ["start", "unload"])
            browser.set("effort", "start", "ButtonGroup")  # both want the joint
            browser.wait_for(lambda: any("joint1" in told for told in browser.notifications))
            becomes(position="running", effort="initialized")

            browser.set("switch: stop", "position")
            browser.set("switch: start", "effort")
            browser.click("Switch")
            becomes(position="stopped", effort="running")
            browser.wait_for(lambda: browser.element("position", "ButtonGroup")["options"] == ["start", "unload"])
            browser.set("position", "unload", "ButtonGroup")
            browser.set("effort", "stop", "ButtonGroup")
            becomes(effort="stopped")

            command.ok("spawn", "rrbot", "--controllers", "config/rrbot_control.yaml")  # the panel is made anew
            browser.wait_for(lambda: browser.find("joint2_position_controller", "ButtonGroup"))
            browser.set("joint2_position_controller", "load and start", "ButtonGroup")
            browser.wait_for(lambda: client.controllers("/rrbot").states() == {"joint2_position_controller": "running"})
            command.ok("delete", "slider")
            browser.wait_for(lambda: browser.find("/slider", "Folder") is None)
