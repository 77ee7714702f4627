"""The panel of joints: sliders that command, and a table that follows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page

GROUP = """
rrbot:
  group:
    type: effort_controllers/JointGroupEffortController
    joints: [joint2, joint1]
"""


def test_sliders_command_within_the_limits_and_the_table_follows(tmp_path: Path) -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        command.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start",
                   "joint1_position_controller")  # fmt: skip
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:
            [joint] = [one for one in client.robots()[0]["joints"] if one["name"] == "joint1"]
            slider = browser.element("joint1_position_controller", "Slider")
            assert (slider["min"], slider["max"], slider["value"]) == (joint["lower"], joint["upper"], 0.0)
            with client.subscribe("/slider/joint1_position_controller/state", queue_length=1) as states:
                client.publish("/slider/joint1_position_controller/command", {"data": 0.5})  # somebody else
                browser.wait_for(
                    lambda: client.step(10) and browser.element("joint1_position_controller", "Slider")["value"] == 0.5
                )
                for value in (0.2, 0.4, 0.6, 0.75):  # dragged
                    browser.set("joint1_position_controller", value, "Slider")
                browser.wait_for(lambda: client.step(10) and states.get()["set_point"] == 0.75)
            client.step(seconds=20)
            shown = f"{client.robots()[0]['joints'][-1]['position']:.4f}"
            browser.wait_for(lambda: browser.find(shown, "Html"))

            (tmp_path / "group.yaml").write_text(GROUP, "utf-8")
            command.ok("spawn", "rrbot", "--controllers", str(tmp_path / "group.yaml"), "--start", "group")
            assert browser.element("group: joint2", "Slider")["max"] == 10.0  # without limits: a span
            browser.set("group: joint2", 2.0, "Slider")
            browser.set("group: joint1", -3.0, "Slider")
            wait_for_efforts(browser, client, {"joint1": -3.0, "joint2": 2.0})
            assert browser.element("joint1_position_controller", "Slider")["value"] == 0.75  # kept when built anew

            command.ok("controller", "stop", "joint1_position_controller")
            browser.wait_for(lambda: browser.find("joint1_position_controller", "Slider") is None)
            browser.wait_for(lambda: browser.find(shown, "Html"))


def wait_for_efforts(browser: PageBrowser, client: Any, expected: dict[str, float]) -> None:
    def act() -> bool:
        client.step(1)
        answer = client.call("/slidectl/joint_states")
        efforts = dict(zip(answer["joints"], answer["effort"], strict=True))
        return all(efforts[f"rrbot::{joint}"] == pytest.approx(effort) for joint, effort in expected.items())

    browser.wait_for(act, "the efforts did not act")
