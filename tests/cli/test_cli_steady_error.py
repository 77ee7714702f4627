"""A joint that a PID without an integral part holds against its weight: what fails says why it stands short."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from command_line import ROOT, CommandLine
from daemon_fixture import running_daemon

WHY = (
    "joint1 stands still: /slider/joint1_position_controller holds 0.98 N with p = 100: 0.0098 m short; "
    "raise p, or give i and i_clamp"
)


@pytest.fixture(scope="module")
def slider() -> Iterator[CommandLine]:
    """The vertical slider of 0.1 kg, at rest below its set point, in a world that runs."""
    with running_daemon(rtf=20.0) as runtime:
        line = CommandLine(runtime.folder)
        files = ROOT / "tests" / "data"
        words = ["--controllers", str(files / "slider_vertical.yaml"), "--start", "joint_state_controller"]
        line.ok("spawn", str(files / "slider_vertical.urdf"), *words, "joint1_position_controller")
        line.ok("pub", "joint1_position_controller/command", "1.0")
        line.ok("sim", "step", "10s")
        line.ok("sim", "resume")
        yield line


@pytest.mark.parametrize(
    "words",
    [
        ("wait", "joint_states/position[0]", "--near", "1.0", "--tol", "0.005", "--within", "1"),
        ("assert", "joint_states/position[0]", "--near", "1.0", "--tol", "0.005"),
        ("assert", "joint1", "--near", "1.0", "--tol", "0.005"),
        ("wait", "joint1_position_controller/state/error", "--near", "0", "--tol", "0.005", "--within", "1"),
        ("assert", "joint1_position_controller/state/process_value", "--near", "1", "--tol", "0.005"),
    ],
    ids=" ".join,
)
def test_what_fails_at_a_steady_error_says_why(slider: CommandLine, words: tuple[str, ...]) -> None:
    done = slider(*words)
    assert done.returncode == 1
    assert WHY in done.stderr


def test_a_step_response_that_ends_short_says_why(slider: CommandLine) -> None:
    done = slider("controller", "plot", "joint1_position_controller", "--step", "1.0", "--for", "2", "--json")
    assert WHY in done.stderr
    assert json.loads(done.stdout)["error"] == pytest.approx(0.0098, abs=1e-4)


def test_of_a_joint_that_still_moves_it_is_not_said(slider: CommandLine) -> None:
    slider.ok("sim", "speed", "1")
    slider.ok("pub", "joint1_position_controller/command", "-1.0")
    done = slider("assert", "joint1", "--near", "-1.0", "--tol", "0.005")
    slider.ok("sim", "speed", "20")
    assert done.returncode == 1
    assert "stands still" not in done.stderr


def test_a_failure_for_another_reason_does_not_speak_of_it(slider: CommandLine) -> None:
    done = slider("assert", "joint_states/velocity[0]", "--above", "1")
    assert done.returncode == 1
    assert "stands still" not in done.stderr
