"""The picture of the graph, and the file of gains, which the page makes as the commands do."""

from __future__ import annotations

from pathlib import Path

from page_browser import CommandLine, PageBrowser


def test_the_graph_is_drawn_around_names(browser: PageBrowser) -> None:
    whole = browser.page("graph")["svg"]
    assert ">/slider/joint_states</text>" in whole
    assert ">/clock</text>" in whole
    part = browser.page("graph", of="joint_states")["svg"]
    assert ">/slider/joint_states</text>" in part
    assert ">/clock</text>" not in part
    assert "joint_states" in browser.refusal("graph", of="joint_sates <b>")
    assert "no node, topic or namespace 'nosuch'" in browser.refusal("graph", of="nosuch")


def test_gains_are_saved_as_a_file_that_a_spawn_takes(world: CommandLine, browser: PageBrowser, tmp_path: Path) -> None:
    pid = "/slider/joint1_position_controller/pid"
    with world.client() as client:
        before = client.params[f"{pid}/p"]
        client.params[f"{pid}/p"] = 77.25
        saved = browser.page("gains_file", namespace="/slider")
        client.params[f"{pid}/p"] = before
    assert saved["file"] == "slider_control.yaml"
    assert "p: 77.25" in saved["text"]
    (tmp_path / saved["file"]).write_text(saved["text"], "utf-8")
    world.ok("check", "slider", "--controllers", str(tmp_path / saved["file"]))
