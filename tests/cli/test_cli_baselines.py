"""`slidectl test --baseline`: golden traces of cases, what differs, and what is wrong with the files of a folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine

STEPS = """
world: {engine: plain}
vars: {goal: 0.2}
cases: [{name: up, goal: 0.2}, {name: "half/way", goal: 0.1}]
setup:
  - spawn: slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
steps:
  - pub: command ${goal}
  - at: 0.5
"""


@pytest.fixture
def held(slidectl: CommandLine, tmp_path: Path) -> Callable[..., dict[str, dict[str, Any]]]:
    """Runs the scenario with more keys against its folder of baselines; the results by case, or by file."""
    file = tmp_path / "slide.yaml"

    def run(*words: str, more: str = "", steps: str = STEPS) -> dict[str, dict[str, Any]]:
        file.write_text(steps + more, "utf-8")
        done = slidectl("test", str(file), "--baseline", str(tmp_path / "golden"), "-n", "2", "--json", *words)
        assert done.returncode in (0, 1), done.stderr
        found = map(json.loads, done.stdout.splitlines())
        return {str(result["id"]).removeprefix(f"{file}::"): result for result in found}

    return run


Held = Callable[..., dict[str, dict[str, Any]]]


def golden(tmp_path: Path, case: str) -> Path:
    """Where the baseline of a case is, of a scenario that is outside of the current folder."""
    return tmp_path / "golden" / "slide" / f"{case}.csv"


def test_a_run_is_held_to_its_baseline_bit_for_bit_and_its_first_difference_is_told(
    held: Held, slidectl: CommandLine, tmp_path: Path
) -> None:
    up = golden(tmp_path, "up")
    found = held()
    assert (found["up"]["verdict"], found["up"]["message"]) == ("failed", f"it has no baseline {up}")
    assert not up.exists()
    found = held("--update-baseline")
    assert found["up"]["baseline"] == f"{up}: new, 3 fields, 24 messages"
    assert golden(tmp_path, "half%2Fway").exists()
    written = up.stat().st_mtime_ns
    again = held("--update-baseline")
    assert (again["up"]["verdict"], again["up"]["baseline"], up.stat().st_mtime_ns) == ("passed", "", written)
    assert {result["verdict"] for result in held().values()} == {"passed"}

    text = up.read_text("utf-8")
    lines = text.splitlines()
    cells = lines[5].split(",")
    up.write_text("\n".join([*lines[:5], ",".join([*cells[:2], "0.5", *cells[3:]]), *lines[6:], ""]), "utf-8")
    said = f"{up}: /slider/joint_states/position[0] at {cells[0]} s: {cells[2]}, baseline: 0.5"
    found = held()
    assert (found["up"]["verdict"], found["up"]["message"]) == ("failed", f"differs from its baseline: {said}")
    assert (found["up"]["failed_at"], found["half/way"]["verdict"]) == (float(cells[0]), "passed")
    assert found["up"]["detail"]["field"] == "position[0]"
    assert held(more="baseline: {tol: 1.0}")["up"]["verdict"] == "passed"
    near = held(more="baseline: {fields: ['joint_states/position=1e0', joint_states/velocity, joint_states/effort]}")
    assert near["up"]["verdict"] == "passed"
    xml = tmp_path / "out.xml"
    slidectl("test", str(tmp_path / "slide.yaml"), "--baseline", str(tmp_path / "golden"), "--junitxml", str(xml),
             "-k", "up")  # fmt: skip
    assert 'failures="0"' in xml.read_text("utf-8")
    assert held("--update-baseline")["up"]["baseline"] == f"{up}: updated; before, {said.removeprefix(f'{up}: ')}"
    assert up.read_text("utf-8") == text


def test_other_lengths_fields_and_broken_files_have_a_message_each(held: Held, tmp_path: Path) -> None:
    held("--update-baseline")
    up = golden(tmp_path, "up")
    text = up.read_text("utf-8")
    lines = text.splitlines(keepends=True)
    last = lines[-1].partition(",")[0]
    for content, message in {
        "".join(lines[:-1]): f"/slider/joint_states at {last} s: a message, baseline: no message",
        text + lines[-1].replace(last, "9.0"): "/slider/joint_states at 9 s: no message, baseline: a message",
        text[:-1]: f"{up}:{len(lines)}: is cut off",
        text[:-30]: "is cut off",
        text.replace("position[0]", "position[1]"): "has other fields than this run: "
        "without /slider/joint_states/position[0], with /slider/joint_states/position[1]",
        "": f"{up}: is empty",
        "a,b\n": "is not a table of a run: one begins with time,topic",
        text.replace(last, "soon"): "cannot be read as a table: could not convert string to float: 'soon'",
    }.items():
        up.write_text(content, "utf-8")
        result = held("-k", "up")["up"]
        assert result["verdict"] == "failed"
        assert message in result["message"]
        assert "--update-baseline" in result["hint"]
    held("--update-baseline")
    assert up.read_text("utf-8") == text
    fields = held(more="baseline: {fields: [elbow/x]}")["up"]
    assert (fields["verdict"], fields["message"][:18]) == ("error", "no topic 'elbow/x'")


def test_a_baseline_without_a_case_is_told_and_stays(held: Held, tmp_path: Path) -> None:
    held("--update-baseline")
    stray, other = golden(tmp_path, "down"), golden(tmp_path, "x").parent.with_name("other.csv")
    for path in (stray, other):
        path.write_text("time,topic\n", "utf-8")
    found = held("--update-baseline", "-k", "up")
    assert found[str(stray)]["message"] == "no case has this baseline"
    assert found[str(stray)]["hint"] == f"rm {stray}"
    assert set(found) == {"up", str(stray), str(other)}
    (tmp_path / "other.yaml").write_text("steps: [sim status]")  # another scenario, which does not run now
    assert set(held()) == {"up", "half/way", str(stray)}
    assert stray.exists()


def test_slips_in_what_a_baseline_holds_are_told_before_anything_runs(slidectl: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "slips.yaml"
    file.write_text(
        "baseline:\n  fields: [joint_states/position=much]\n  tol: -1\n  fieds: []\nsteps: [sim status]\n", "utf-8"
    )
    done = slidectl("test", str(file))
    assert done.returncode == 2
    for line, text in {
        2: "'fields' is a list of TOPIC/FIELD or TOPIC/FIELD=TOL, not",
        3: "'tol' is a number of 0 or more, not -1",
        4: "no field 'fieds' in a baseline. Did you mean 'fields'?",
    }.items():
        assert f"{file}:{line}: {text}" in done.stderr
    assert slidectl("test", str(file), "--update-baseline").returncode == 2


def test_a_recording_is_compared_with_a_table_too(slidectl: CommandLine, tmp_path: Path) -> None:
    file, table, run = tmp_path / "slide.yaml", tmp_path / "golden.csv", tmp_path / "run.bag"
    file.write_text(
        STEPS.replace("steps:\n", f"steps:\n  - {{record: joint_states -O {run} --force, background: true}}\n")
    )
    slidectl.ok("test", f"{file}::up", "--baseline", str(tmp_path / "golden"), "--update-baseline")
    slidectl.ok("bag", "diff", str(run), str(golden(tmp_path, "up")))
    slidectl.ok("bag", "diff", str(run), str(table), "--update-baseline", "--fields", "joint_states/position")
    assert table.read_text("utf-8").splitlines()[0] == "time,topic,/slider/joint_states/position[0]"
    slidectl.ok("test", f"{file}::half/way")
    done = slidectl("bag", "diff", str(run), str(table))
    assert done.returncode == 1
    assert "/slider/joint_states/position[0] at " in done.stderr
