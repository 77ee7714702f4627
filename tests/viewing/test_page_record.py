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

            def so_far(file: str) -> str:
                recording = browser.page("state")["recording"]
                return recording["text"] if recording and recording["file"] == file else ""

            assert "nothing is recorded" in browser.refusal("stop_recording")
            browser.page("record", file="states.mcap", topics="joint_states")
            browser.wait_for(lambda: re.match(r"\d{3,} messages of 1 topics", so_far("states.mcap")))
            assert "is being recorded" in browser.refusal("record", file="second.mcap")
            browser.page("stop_recording")
            browser.wait_for(lambda: any("states.mcap recorded" in told for told in browser.told))
            info = json.loads(command.ok("bag", "info", str(tmp_path / "states.mcap"), "--json"))
            assert info["messages"] >= 100
            assert [topic["topic"] for topic in info["topics"]] == ["/slider/joint_states"]

            for name, told in (
                ("states.mcap", "is there already"), ("../up.bag", "is no name of a file"), ("x.txt", "neither a .bag"),
                ("a" * 300 + ".bag", "is no name of a file"), ("", "is no name of a file"),
            ):  # fmt: skip
                assert told in browser.refusal("record", file=name, topics="")
            browser.page("record", file="none.bag", topics="no_such_topic")
            browser.wait_for(lambda: any("no_such_topic" in told for told in browser.told))
            assert sorted(path.name for path in tmp_path.iterdir()) == ["states.mcap"]

            browser.page("record", file="all.bag", topics="")
            browser.wait_for(lambda: re.match("[1-9]", so_far("all.bag")))
        # The page has ended, and the recording with it: it is complete.
        eventually(lambda: command("bag", "info", str(tmp_path / "all.bag"), "--json").returncode == 0)
        assert "/clock" in command.ok("bag", "info", str(tmp_path / "all.bag"))
