"""`slidectl sim` and `slidectl wait` with a real daemon of each test's own."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime, running_daemon

from slidectl.cli.sim import parse_amount, parse_speed
from slidectl.errors import UsageError
from slidectl.names import cut_from_field

STATES = "joint_state_controller"
POSITION = "joint1_position_controller"


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    with running_daemon(paused=True, rtf=math.inf) as daemon:
        yield daemon


@pytest.fixture
def slidectl(runtime: Runtime) -> CommandLine:
    return CommandLine(runtime.folder)


@pytest.fixture
def slider(slidectl: CommandLine) -> CommandLine:
    """A paused world with a slider under control."""
    slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", STATES, POSITION)
    return slidectl


def command(runtime: Runtime, position: float) -> None:
    with runtime.client() as client:
        client.publish(f"/slider/{POSITION}/command", {"data": position})


def status(slidectl: CommandLine) -> dict[str, object]:
    answer: dict[str, object] = json.loads(slidectl.ok("sim", "status", "--json"))
    return answer


def test_status_has_all_its_keys(slidectl: CommandLine) -> None:
    assert set(status(slidectl)) == {
        "version", "pid", "instance", "time", "cycles", "paused", "trouble", "speed", "speed_reached", "timestep",
        "chosen", "engine", "pictures", "cameras", "cameras_asked", "cameras_reached", "cameras_advice", "cycle_mean",
        "cycle_p99", "cycle_worst", "lateness_p50", "lateness_p99",
        "overruns", "robots", "estop", "frozen", "faults", "holders", "lockstep", "journal", "journal_trouble",
        "controllers", "controllers_running", "connections", "memory", "uptime", "log",
    }  # fmt: skip
    text = slidectl.ok("sim", "status")
    assert "state:       paused" in text
    assert "max asked" in text


def test_status_tells_of_a_pause_that_nobody_asked_for(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "restart", "--strict")
    slidectl.ok("spawn", "rrbot")
    push = '{joint_name: "rrbot::joint1", effort: 1.0e+100, duration: {secs: -1}}'
    slidectl.ok("service", "call", "/gazebo/apply_joint_effort", push)
    assert slidectl("sim", "step", "1000").returncode == 1
    trouble = "the simulation of robot 'rrbot' diverged: its state is not finite or huge"
    assert f"state:       paused: {trouble}\n" in slidectl.ok("sim", "status")
    assert status(slidectl)["trouble"] == trouble
    waiting = slidectl("echo", "/gazebo/model_states", "-n", "1", "--timeout", "1.5")
    assert waiting.returncode == 4
    assert f"the simulation is paused ({trouble}); nothing comes until it goes on: slidectl sim reset" in waiting.stderr
    for command in (("sim", "resume"), ("sim", "step")):
        done = slidectl(*command)
        assert done.returncode == 1
        assert trouble in done.stderr
        assert "slidectl sim reset" in done.stderr
    sleep = slidectl("service", "call", "/slidectl/sleep", "1.0", "--timeout", "0.2")
    assert sleep.returncode == 4
    assert f"the simulation is paused ({trouble}); first: slidectl sim reset" in sleep.stderr
    slidectl.ok("service", "call", "/gazebo/clear_joint_forces", "rrbot::joint1")
    slidectl.ok("sim", "reset")
    assert "state:       paused\n" in slidectl.ok("sim", "status")


def test_step_does_exactly_so_much(slidectl: CommandLine) -> None:
    assert slidectl.ok("sim", "step") == "time 0.001 s after 1 cycles\n"
    assert json.loads(slidectl.ok("sim", "step", "100", "--json")) == {"time": 0.101, "cycles": 101}
    slidectl.ok("sim", "step", "0.5s")
    slidectl.ok("sim", "step", "20ms")
    assert status(slidectl)["cycles"] == 621


def test_an_amount_without_end_is_none(slidectl: CommandLine) -> None:
    for amount in ("1e400s", "0", "-1", "soon"):
        done = slidectl("sim", "step", amount)
        assert (done.returncode, done.stdout) == (2, "")
    assert "'1e400s' is not a number of steps" in slidectl("sim", "step", "1e400s").stderr


def test_steps_go_up_to_a_time_that_has_not_passed(slidectl: CommandLine) -> None:
    slidectl.ok("sim", "step", "7")
    assert slidectl.ok("sim", "step", "--until", "0.25") == "time 0.25 s after 250 cycles\n"
    assert slidectl.ok("sim", "step", "--until", "0.25s") == "time 0.25 s after 250 cycles\n"
    for arguments, code, words in (
        (("--until", "0.2"), 1, "it is 0.25 s already"),
        (("--until", "0.3005"), 1, "possible: 0.3s or 0.301s"),
        (("--until", "soon"), 2, "such as 12.5, not 'soon'"),
        (("3", "--until", "1"), 2, "not both"),
    ):
        done = slidectl("sim", "step", *arguments)
        assert (done.returncode, words in done.stderr) == (code, True), done.stderr
    assert json.loads(slidectl.ok("sim", "status", "--json"))["time"] == 0.25


def test_step_pauses_a_world_that_runs(slidectl: CommandLine) -> None:
    assert slidectl.ok("sim", "resume").startswith("running at ")
    slidectl.ok("sim", "step", "10")
    assert status(slidectl)["paused"] is True


def test_a_step_that_takes_too_long_is_given_up(slidectl: CommandLine) -> None:
    done = slidectl("sim", "step", "100000000", "--timeout", "0.2")
    assert (done.returncode, done.stdout) == (4, "")
    assert "--timeout" in done.stderr
    assert status(slidectl)["paused"] is True
    assert slidectl.ok("sim", "step").endswith(" cycles\n")


def test_speed_is_a_factor_or_max(slidectl: CommandLine) -> None:
    assert slidectl.ok("sim", "speed", "2.5") == "speed 2.5\n"
    assert status(slidectl)["speed"] == 2.5
    assert json.loads(slidectl.ok("sim", "speed", "max", "--json")) == {"speed": 0.0}
    assert status(slidectl)["speed"] == 0.0


@pytest.mark.parametrize("text", ["0", "-1", "fast", "nan", "inf", ""])
def test_what_is_no_speed_is_wrong_usage(slidectl: CommandLine, text: str) -> None:
    done = slidectl("sim", "speed", text)
    assert (done.returncode, done.stdout) == (2, "")
    with pytest.raises(UsageError):
        parse_speed(text)


def test_an_amount_of_steps_is_a_number_or_a_time() -> None:
    assert parse_amount("100") == {"cycles": 100, "seconds": 0.0}
    assert parse_amount("0.5s") == {"cycles": 0, "seconds": 0.5}
    assert parse_amount("1e-1s") == {"cycles": 0, "seconds": 0.1}
    assert parse_amount("250ms") == {"cycles": 0, "seconds": 0.25}
    for text in ("0", "-1", "1.5", "0.5", "s", "a lot", ""):
        with pytest.raises(UsageError):
            parse_amount(text)


def test_reset_puts_the_robots_back_and_with_time_the_clock_too(slider: CommandLine, runtime: Runtime) -> None:
    command(runtime, 0.5)
    slider.ok("sim", "step", "1s")
    assert position(slider) > 0.01
    slider.ok("sim", "reset")
    assert position(slider) == 0.0
    assert status(slider)["time"] == 1.0
    slider.ok("sim", "reset", "--time")
    assert status(slider)["time"] == 0.0
    assert {json.loads(line)["state"] for line in slider.ok("controller", "list", "--json").splitlines()} == {"running"}


def position(slider: CommandLine) -> float:
    joints = json.loads(slider.ok("robots", "slider", "--json"))["joints"]
    return float(next(joint["position"] for joint in joints if joint["name"] == "joint1"))


def test_wait_returns_when_the_value_is_there(slider: CommandLine, runtime: Runtime) -> None:
    command(runtime, -0.2)
    slider.ok("sim", "resume")
    text = slider.ok(
        "wait", "joint_states/position[0]", "--near", "-0.2", "--tol", "0.02", "--for", "0.5", "--within", "15"
    )
    assert text.startswith("/slider/joint_states/position[0] is -0.")
    assert " s\n" in text
    record = json.loads(slider.ok("wait", f"{POSITION}/state/set_point", "--equals", "-0.2", "--json"))
    assert list(record) == ["topic", "field", "expected", "reached", "value", "closest", "time"]
    assert (record["topic"], record["field"]) == (f"/slider/{POSITION}/state", "set_point")
    assert (record["reached"], record["value"]) == (True, -0.2)


def test_wait_that_fails_prints_what_was_expected_the_last_and_the_closest_value(slider: CommandLine) -> None:
    slider.ok("sim", "resume")
    done = slider("wait", "joint_states/position[0]", "--above", "0.7", "--within", "0.2")
    assert (done.returncode, done.stdout) == (1, "")
    assert "was not above 0.7 within 0.2 s" in done.stderr
    assert "last 0.0, closest 0.0, at " in done.stderr
    done = slider("wait", "joint_states/position[0]", "--above", "0.7", "--within", "0.2", "--json")
    record = json.loads(done.stdout)
    assert (done.returncode, record["reached"], record["closest"], record["expected"]) == (1, False, 0.0, "above 0.7")


def test_wait_in_a_world_that_stands_still_times_out_and_says_why(slider: CommandLine) -> None:
    done = slider("wait", "joint_states/position[0]", "--above", "0.7", "--within", "1", "--timeout", "0.3")
    assert (done.returncode, done.stdout) == (4, "")
    assert done.stderr.startswith("the simulation is paused")
    assert "/slider/joint_states/position[0] was not above 0.7 within 0.3 s of wall time" in done.stderr
    assert "slidectl sim resume" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["joint_states/position[0]"], 2, "exactly one of"),
        (["joint_states/position[0]", "--near", "1", "--above", "1"], 2, "exactly one of"),
        (["joint_states/position[0]", "--above", "1", "--tol", "1"], 2, "--tol"),
        (["joint_states/position[0]", "--near", "1", "--tol", "-1"], 2, "--tol"),
        (["joint_states/position[0]", "--near", "1", "--within", "0"], 2, "--within"),
        (["joint_states/position[0]", "--near", "1", "--within", "1e400"], 2, "the simulated time never gets there"),
        (["joint_states/position[0]", "--near", "one"], 2, "one"),
        (["joint_stats/position[0]", "--near", "1"], 1, "Did you mean '/slider/joint_states'?"),
        (["joint_states/positon[0]", "--near", "1"], 1, "Did you mean 'position'?"),
        (["/slider/joint_stats/position[0]", "--near", "1"], 1, "Did you mean '/slider/joint_states'?"),
        (["joint_states/name[0]", "--near", "1"], 2, "name"),
    ],
)
def test_what_cannot_be_waited_for_is_an_error_at_once(
    slider: CommandLine, words: list[str], code: int, said: str
) -> None:
    done = slider("wait", *words)
    assert (done.returncode, done.stdout) == (code, "")
    assert said in done.stderr


def test_a_topic_is_cut_from_its_field_at_the_longest_place() -> None:
    assert list(cut_from_field("/a/b/c[0]")) == [("/a/b", "c[0]"), ("/a", "b/c[0]")]
    assert list(cut_from_field("a/b")) == [("a/b", ""), ("a", "b")]
    assert list(cut_from_field("a")) == [("a", "")]


def test_wait_shows_on_a_terminal_how_it_stands_and_nothing_when_quiet(slider: CommandLine) -> None:
    slider.ok("sim", "speed", "1")
    slider.ok("sim", "resume")
    words = ("wait", "joint_states/position[0]", "--above", "0.7", "--within", "1")
    shown = slider.on_a_terminal(*words).decode()
    assert re.search(r"joint_states/position\[0\] above 0\.7; last -?\d[^;]*; closest [^;]*; \d\.\d s left", shown), (
        shown
    )
    assert " s left" not in slider.on_a_terminal(*words, "-q").decode()
    assert "s left" not in slider(*words).stderr
