"""The panel of trajectories: targets that are sent, reached, held and cancelled."""

from __future__ import annotations

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page


def test_targets_are_sent_reached_held_and_cancelled() -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        command.ok("spawn", "wrist", "--controllers", "config/wrist_control.yaml")
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:
            browser.element("no JointTrajectoryController runs", "Markdown")
            command.ok("controller", "spawn", "wrist_controller")

            def at(pitch: float, roll: float) -> None:
                answer = client.call("/slidectl/joint_states")
                where = dict(zip(answer["joints"], answer["position"], strict=True))
                assert where["wrist::pitch"] == pytest.approx(pitch, abs=0.05)
                assert where["wrist::roll"] == pytest.approx(roll, abs=0.05)

            def goal(what: str, told: str) -> None:
                browser.set("goal", what, "ButtonGroup")
                browser.element(told, "Html")

            slider = browser.element("pitch", "Slider")
            assert slider["min"] < 0.0 < slider["max"]
            browser.set("pitch", 0.4, "Slider")
            browser.set("roll", -0.3, "Slider")
            browser.set("duration (s)", 1.5)
            goal("send", "goal: active")
            client.step(seconds=1.4)
            browser.element("goal: active", "Html")
            client.step(seconds=1.5)
            browser.element("goal: succeeded", "Html")
            at(0.4, -0.3)
            browser.wait_for(lambda: browser.find("0.4000", "Html"))  # what is desired

            browser.set("pitch", -0.4, "Slider")
            goal("send", "goal: active")
            client.step(seconds=0.75)
            goal("cancel", "goal: preempted")
            client.step(seconds=2)
            at(0.0, -0.3)

            browser.click("Take present positions")
            browser.wait_for(lambda: abs(browser.element("pitch", "Slider")["value"]) < 0.1)
            browser.set("roll", 0.3, "Slider")
            goal("send", "goal: active")
            client.step(seconds=0.75)
            goal("hold", "goal: preempted")
            client.step(seconds=2)
            at(0.0, 0.0)
            command.ok("controller", "stop", "wrist_controller")
            browser.element("no JointTrajectoryController runs", "Markdown")
