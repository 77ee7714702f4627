"""`slidectl assert` and `slidectl bag diff`: on a real daemon that is stepped, on one that runs, and on recordings."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from waiting import eventually

from slidectl import traces
from slidectl.extensions.recording.codec import Codec
from slidectl.extensions.recording.comparison import compare
from slidectl.extensions.recording.recording_files import BadRecording, create, opened
from slidectl.measures import NoMeasure

STATES = "/slider/joint_states"
COMMAND = "/slider/joint1_position_controller/command"
STATE = "/slider/joint1_position_controller/state"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[CommandLine, Path]]:
    """A paused world at 15 s, in which the slider has gone from 0 to 0.8 m after 1 s, and the recording of that."""
    path = tmp_path_factory.mktemp("run") / "run.bag"
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        started = ("joint_state_controller", "joint1_position_controller")
        slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *started)
        slidectl.ok("record", STATES, STATE, COMMAND, "-O", str(path), "--duration", "14", "--detach")
        slidectl.until_subscribed(STATES)
        slidectl.ok("sim", "step", "--until", "1")
        slidectl.ok("pub", COMMAND, "0.8")
        slidectl.ok("sim", "step", "--until", "15")
        eventually(lambda: is_complete(path), "the recording is not complete")
        yield slidectl, path


def is_complete(path: Path) -> bool:
    try:
        with opened(path) as recording:
            return not recording.damage
    except BadRecording:
        return False


def verdicts(text: str) -> dict[str, Any]:
    return {(one := json.loads(line))["condition"]: one for line in text.splitlines()}


def test_a_joint_is_measured_over_the_last_seconds_of_a_world_that_stands(run: tuple[CommandLine, Path]) -> None:
    slidectl, _ = run
    words = ("assert", "joint1", "--near", "0.8", "--tol", "0.001")
    assert slidectl.ok(*words).startswith("/slider/joint1: 0.8")
    conditions = (
        "--overshoot <5% --settling <9s --rise >=3 --set-point 0.8 --error <1mm --limit-hits ==0 --saturation <1ms"
    )
    efforts = "--energy >0J --effort-peak <300N"
    words = [*conditions.split(), *efforts.split(), "--last", "14.5", "--json"]
    found = verdicts(slidectl.ok("assert", "slider/joint1", *words))
    assert all(one["holds"] and one["target"] == "/slider/joint1" for one in found.values())
    assert len(found) == 8
    settling = found["settling"]
    assert settling["time"] - settling["measured"] == pytest.approx(1.0, abs=0.02), "counted from the step, not before"
    assert settling["start"] == pytest.approx(0.5, abs=0.011)
    assert (settling["unit"], settling["end"]) == ("s", 15.0)


def test_all_that_does_not_hold_is_told_with_what_was_expected_and_when(run: tuple[CommandLine, Path]) -> None:
    slidectl, _ = run
    done = slidectl("assert", "joint1", "--overshoot", "<5%", "--settling", "<2s", "--below", "0.5", "--last", "14.5")
    assert done.returncode == 1
    assert "overshoot" in done.stdout
    lines = done.stderr.splitlines()
    assert lines[0].startswith("error: /slider/joint1: 0.8")
    assert "expected below 0.5 at all times from 0." in lines[0]
    assert "settling" in lines[1]
    assert lines[1].endswith("s, expected <2s")


def test_what_cannot_be_measured_does_not_hold(run: tuple[CommandLine, Path]) -> None:
    slidectl, _ = run
    done = slidectl("assert", "joint1", "--overshoot", "<5%", "--rms-error", "<1", "--last", "0.9", "--since", "99")
    assert done.returncode == 1
    assert "overshoot cannot be measured: the step at 99 s is after the last sample, at 15 s" in done.stderr
    assert "rms-error cannot be measured: an error needs what the value was to be: a set point" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("joint1 --last 5", 2, "no condition"),
        ("joint1 --overshoot 5", 2, "'5' is not a condition: write '<5'"),
        ("joint1 --overshoot <5furlongs", 2, "'furlongs' is not a unit"),
        ("joint1 --overshoot <5rad --last 5", 2, "--overshoot is in %"),
        ("joint1 --overshoot <5", 2, "--overshoot is measured over a time"),
        ("joint1 --near 1 --last 5 --for 5", 2, "--for measures the time to come"),
        ("joint1 --above 1 --tol 5", 2, "--tol needs --near"),
        ("elbow --near 1", 1, "joints: /slider/joint1"),
        ("joint_states/position[0] --near 1 --last 5", 2, "the past is kept of joints only"),
        ("joint_states/position[0] --near 1", 1, "publishes nothing while the simulation is paused"),
        ("joint1 --near 1 --from nothing.bag", 2, "nothing.bag: no such file"),
        ("joint1 --settling <0.5s --set-point nan --last 5", 2, "nan is not a finite number"),
        ("joint1 --settling <0.5s --band nan --last 5", 2, "nan is not a finite number"),
        ("joint1 --near 1 --tol nan", 2, "nan is not a finite number"),
    ],
)
def test_slips_are_named(run: tuple[CommandLine, Path], words: str, code: int, said: str) -> None:
    done = run[0]("assert", *words.split())
    assert said in done.stderr
    assert done.returncode == code


@pytest.mark.parametrize(
    "words",
    [
        "wait clock --near 1 --tol nan",
        "wait clock --above 1 --for inf",
        "bag diff run.bag golden.bag --tol nan",
        "play run.bag --start nan",
        "record -a --size nan",
        "hz clock --min nan",
    ],
)
def test_no_command_takes_a_bound_that_is_no_number(slidectl: CommandLine, words: str) -> None:
    done = slidectl(*words.split())
    assert (done.returncode, f"{words.split()[-1]} is not a finite number" in done.stderr) == (2, True)


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recording_gives_the_measures_of_the_world(
    run: tuple[CommandLine, Path], tmp_path: Path, suffix: str
) -> None:
    slidectl, path = run
    copy = tmp_path / f"copy{suffix}"
    slidectl.ok("bag", "filter", str(path), str(copy))
    source = ("--from", str(copy), "--json")
    measures = ("--rise", ">0", "--settling", ">0", "--effort-rms", ">0")
    recorded = verdicts(slidectl.ok("assert", "joint1", *measures, *source))
    live = verdicts(slidectl.ok("assert", "joint1", *measures, "--last", "15", "--json"))
    for name in ("rise", "settling"):
        assert recorded[name]["measured"] == pytest.approx(live[name]["measured"], abs=0.02)
    assert slidectl.ok("assert", "joint_states/position[0]", "--near", "0.8", "--tol", "1e-3", *source[:2])
    words = (
        "assert",
        "state/process_value",
        "--set-point",
        "set_point",
        "--max-error",
        "==0.8",
        "--last",
        "14",
        *source,
    )
    assert verdicts(slidectl.ok(*words))["max-error"]["time"] == pytest.approx(1.0, abs=0.05)
    assert verdicts(slidectl.ok("assert", COMMAND, "--equals", "0.8", *source))["equals"]["holds"]


def test_a_world_that_runs_is_measured_over_the_time_to_come() -> None:
    with running_daemon(rtf=20.0) as runtime:
        slidectl = CommandLine(runtime.folder)
        started = ("joint_state_controller", "joint1_position_controller")
        slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *started)
        slidectl.ok("pub", COMMAND, "0.8")
        assert slidectl.ok("assert", "joint_states/position[0]", "--above", "-0.1", "--for", "1")
        found = verdicts(
            slidectl.ok("assert", "joint1", "--above", "0", "--set-point", "0.8", "--iae", ">0", "--for", "2", "--json")
        )
        assert found["iae"]["end"] - found["iae"]["start"] == pytest.approx(2.0)
        with slidectl.client() as client:
            motion = traces.live(client, "joint1/velocity", duration=0.5)
            assert (len(motion.times), motion.unit, motion.max_effort) == (501, "m/s", 100.0)
            with pytest.raises(NoMeasure, match="bound"):
                motion.measure("limit-hits")


# --- golden traces ----------------------------------------------------------------------------------------------------


FORCE = Codec("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n", "4a842b65f413084dc2b10fb484ea7f17")


def forces(path: Path, *rows: tuple[int, float]) -> Path:
    """A recording of forces: ms and x."""
    path.unlink(missing_ok=True)
    writer = create(path)
    topic = writer.add("/bumper/force", FORCE, False)
    for time_ms, x in rows:
        writer.write(topic, time_ms * 10**6, FORCE.encode({"x": x, "y": 0.0, "z": 0.0}))
    writer.close()
    return path


def test_a_vector_counts_with_its_length_and_contact_is_measured(slidectl: CommandLine, tmp_path: Path) -> None:
    path = forces(tmp_path / "run.bag", (1000, 0.0), (2000, -30.0), (2500, 4.0), (3000, 0.0))
    found = verdicts(
        slidectl.ok("assert", "force", "--contact", "==1s", "--peak-force", "<=30N", "--from", str(path), "--json")
    )
    assert (found["contact"]["time"], found["peak-force"]["measured"], found["peak-force"]["time"]) == (2.0, 30.0, 2.0)
    for condition in ("--peak-force <5%", "--peak-force <5s", "--iae <5N"):
        done = slidectl("assert", "force", *condition.split(), "--set-point", "0", "--from", str(path))
        assert (done.returncode, "has the unit of the values" in done.stderr) == (2, True)
    with opened(path) as recording:
        force = traces.recorded(recording, "force")
    holds, worst = force.holds("near", 0.0, 5.0)
    assert (holds, worst, worst.time) == (False, 30.0, 2.0)


def test_the_first_difference_from_a_baseline_is_named(slidectl: CommandLine, tmp_path: Path) -> None:
    golden = forces(tmp_path / "golden.bag", (1, 1.0), (2, 2.0), (3, 3.0))
    cases: dict[str, tuple[tuple[int, float], ...]] = {
        "/bumper/force/x at 0.002 s: 2.5, baseline: 2.0": ((1, 1.0), (2, 2.5), (3, 9.0)),
        "/bumper/force at 0.003 s: no message, baseline: a message": ((1, 1.0), (2, 2.0)),
        "/bumper/force at 0.001 s: no message, baseline: a message": ((2, 1.0), (3, 2.0)),
        "/bumper/force at 0.004 s: a message, baseline: no message": ((1, 1.0), (2, 2.0), (3, 3.0), (4, 4.0)),
    }
    for said, rows in cases.items():
        done = slidectl("bag", "diff", str(forces(tmp_path / "run.bag", *rows)), str(golden))
        assert (done.returncode, done.stderr.splitlines()[0]) == (1, f"error: {said}")
    run = str(forces(tmp_path / "run.bag", (1, 1.0), (2, 2.5), (3, 3.1)))
    slidectl.ok("bag", "diff", run, str(golden), "--tol", "0.5")
    slidectl.ok("bag", "diff", run, str(golden), "--fields", "force/x=0.5", "force/y")
    (line,) = slidectl("bag", "diff", run, str(golden), "--tol", "0.4", "--json").stdout.splitlines()
    assert json.loads(line) == {
        "topic": "/bumper/force", "field": "x", "time": 0.002, "value": 2.5, "baseline": 2.0, "tolerance": 0.4
    }  # fmt: skip
    with opened(Path(run)) as one, opened(golden) as other:
        (difference,) = compare(one, other, {"force/x": 0.4, "force/z": 0.0})
    assert (difference.field, difference.time) == ("x", 0.002)


def test_a_baseline_is_kept_in_a_folder_by_the_name_of_the_run(run: tuple[CommandLine, Path], tmp_path: Path) -> None:
    slidectl, path = run
    folder = str(tmp_path / "baselines")
    done = slidectl("bag", "diff", str(path), folder)
    assert done.returncode == 2
    assert done.stderr.splitlines()[1] == "to make this run the baseline: --update-baseline"
    slidectl.ok("bag", "diff", str(path), folder, "--update-baseline")
    slidectl.ok("bag", "diff", str(path), folder)
    shutil.copy(path, tmp_path / "same.bag")
    slidectl.ok("bag", "diff", str(tmp_path / "same.bag"), f"{folder}/run.bag")
    for fields, said in (
        ("elbow", "no topic 'elbow'"),
        ("joint_states/position=much", "'much' is not a tolerance"),
        ("joint_states/nope", "no field 'nope' in sensor_msgs/JointState"),
        ("joint_states/position[7]", "index out of range: position[7], but the message has 1 there"),
    ):
        assert said in slidectl("bag", "diff", str(path), folder, "--fields", fields).stderr
