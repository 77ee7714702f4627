"""Recordings that the page starts and stops."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page
from waiting import eventually


def test_topics_are_recorded_until_the_button_or_the_end_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        command.ok(
            "spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller"
        )
        with served_page(command) as url, PageBrowser(url) as browser:
            browser.set("file", "states.mcap")
            browser.set("topics to record", "joint_states")
            browser.click("Record")

            def so_far() -> int:
                found = browser.find("recording into states.mcap", "Html")
                counted = re.search(r"(\d+) messages of 1 topics", found[1]["content"]) if found else None
                return int(counted[1]) if counted else 0

            browser.wait_for(lambda: so_far() > 100)
            browser.click("Stop recording")
            browser.wait_for(lambda: any("states.mcap recorded" in told for told in browser.notifications))
            info = json.loads(command.ok("bag", "info", str(tmp_path / "states.mcap"), "--json"))
            assert info["messages"] >= 100
            assert [topic["topic"] for topic in info["topics"]] == ["/slider/joint_states"]

            for name, told in (
                ("states.mcap", "is there already"), ("../up.bag", "is no name of a file"), ("x.txt", "neither a .bag"),
                ("a" * 300 + ".bag", "is no name of a file"),
            ):  # fmt: skip
                browser.set("file", name)
                browser.click("Record")
                browser.wait_for(lambda told=told: any(told in notice for notice in browser.notifications))
            browser.set("file", "none.bag")
            browser.set("topics to record", "no_such_topic")
            browser.click("Record")
            browser.wait_for(lambda: any("no_such_topic" in told for told in browser.notifications))
            assert sorted(path.name for path in tmp_path.iterdir()) == ["states.mcap"]

            browser.set("file", "all.bag")
            browser.set("topics to record", "")
            browser.click("Record")
            browser.wait_for(lambda: re.search("recording into all.bag: [1-9]", str(browser.elements)))
        # The page has ended, and the recording with it: it is complete.
        eventually(lambda: command("bag", "info", str(tmp_path / "all.bag"), "--json").returncode == 0)
        assert "/clock" in command.ok("bag", "info", str(tmp_path / "all.bag"))
