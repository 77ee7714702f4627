"""`slidectl trajectory` and `slidectl action` against a daemon with the shipped arm and gripper."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine, Done
from daemon_fixture import running_daemon
from waiting import DEADLINE_S

from slidectl.client import Client
from slidectl.client.action_client import Action
from slidectl.errors import AmbiguousName, TimedOut, UnknownName

ACTION = "/arm/arm_controller/follow_joint_trajectory"
GRIPPER = "/gripper/gripper_controller/gripper_cmd"
YAML = """
joint_names: [joint1, joint2]
points:
- {positions: [0.2, 0.1], time_from_start: 0.5}
- {positions: [0.4, -0.2], velocities: [0, 0], time_from_start: {secs: 1, nsecs: 500000000}}
"""
SLOW = "{joint_names: [joint1], points: [{positions: [1.0], time_from_start: {secs: 3000}}]}"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CommandLine]:
    """The arm and the gripper with their controllers running, ten times as fast as real time."""
    with running_daemon(rtf=10.0) as runtime:
        slidectl = CommandLine(runtime.folder)
        elsewhere = tmp_path_factory.mktemp("elsewhere")
        for robot, place in (("arm", "0"), ("gripper", "2")):
            words = ["--controllers", f"config/{robot}_control.yaml"]
            words += ["--start", "joint_state_controller", f"{robot}_controller"]
            done = slidectl("spawn", robot, "--at", place, "0", "0", *words, cwd=elsewhere)
            assert (done.returncode, done.stderr) == (0, "")
        yield slidectl


@pytest.fixture
def client(world: CommandLine) -> Iterator[Client]:
    with world.client() as client:
        yield client


def plan(world: CommandLine, *words: str) -> Done:
    return world("trajectory", "plan", "arm_controller", *words)


def positions(client: Client) -> dict[str, float]:
    state = client.subscribe("/arm/joint_states").get()
    return dict(zip(state["name"], state["position"], strict=True))


def failed(done: Done, code: int, *texts: str) -> None:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    for text in texts:
        assert text in done.stderr


def active_goal(arm: Action) -> str:
    """The id of the goal that is active, as soon as one is."""
    deadline = time.monotonic() + 30
    while True:
        for goal in arm.goals():
            if goal["status"] == 1:
                return str(goal["goal_id"]["id"])
        assert time.monotonic() < deadline, "no goal became active"


# --- what works -------------------------------------------------------------------------------------------------------


def test_plan_brings_the_named_joints_there_and_leaves_the_others(world: CommandLine, client: Client) -> None:
    done = plan(world, "--to", "joint1=1.5", "joint2=-0.4", "--duration", "2", "--wait")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{ACTION}: succeeded\n", "")
    expected = {"joint1": 1.5, "joint2": -0.4, **dict.fromkeys(("joint3", "joint4", "joint5", "joint6"), 0.0)}
    assert positions(client) == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize(
    ("target", "duration", "said"),
    [
        ("joint1=100", "1e-9", "--duration 1e-09: it takes at least one control cycle, 0.001 s"),
        ("joint1=1e308", "2", "--to 'joint1=1e308': the position is within ±1e+06 rad or m"),
    ],
)
def test_a_plan_that_no_joint_can_follow_is_refused(world: CommandLine, target: str, duration: str, said: str) -> None:
    failed(plan(world, "--to", target, "--duration", duration, "--wait"), 2, said)


CSV = "time, joint1, joint2, joint1.velocity, joint2.velocity\n0.5, 0.2, 0.1, 0.2, 0\n\n1.5, 0.4, -0.2, 0, 0\n"
JSON = json.dumps(
    {
        "trajectory": {
            "joint_names": ["joint1", "joint2"],
            "points": [{"positions": [0.4, -0.2], "time_from_start": 1.5}],
        },
        "goal_time_tolerance": 2.0,
    },
    indent=1,
)


@pytest.mark.parametrize(("name", "text"), [("a.yaml", YAML), ("a.csv", CSV), ("a.json", JSON)])
def test_send_follows_a_file_of_any_form(
    world: CommandLine, client: Client, tmp_path: Path, name: str, text: str
) -> None:
    (tmp_path / name).write_text(text)
    done = world("trajectory", "send", "arm_controller", name, "--wait", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    ended = json.loads(done.stdout)
    assert (ended["state"], ended["status"], ended["result"]["error_code"]) == ("succeeded", 3, 0)
    assert positions(client) == pytest.approx(positions(client) | {"joint1": 0.4, "joint2": -0.2}, abs=0.03)


def test_a_trajectory_comes_from_a_pipe_and_its_goal_can_be_watched_and_cancelled(world: CommandLine) -> None:
    done = world("trajectory", "send", "arm_controller", "-", stdin=SLOW)
    assert done.returncode == 0, done.stderr
    goal_id = done.stdout.strip()
    assert f"Goal {goal_id}: active" in world.ok("action", "info", "arm_controller")
    (feedback,) = world.ok("action", "echo", "arm_controller", "-n", "1", "--json").splitlines()
    assert json.loads(feedback)["status"]["goal_id"]["id"] == goal_id
    world.ok("sim", "speed", "0.2")  # a goal is listed for some simulated seconds after its end
    assert world.ok("trajectory", "cancel", "arm_controller") == f"{ACTION}: all goals cancelled\n"
    assert f"Goal {goal_id}: preempted" in world.ok("action", "info", ACTION)
    world.ok("sim", "speed", "10")


def test_hold_ends_a_goal_and_whoever_waits_for_it_is_told(world: CommandLine, client: Client) -> None:
    with client.action("arm_controller") as arm:
        waiting = world.start("action", "send", "arm_controller", f"trajectory: {SLOW}", "--wait")
        active_goal(arm)
    world.ok("trajectory", "hold", "arm_controller")
    out, err = waiting.communicate(timeout=60)
    assert (waiting.returncode, out, err) == (1, "", f"error: {ACTION}: preempted\n")


def test_state_shows_every_joint(world: CommandLine) -> None:
    rows = [json.loads(line) for line in world.ok("trajectory", "state", "arm_controller", "--json").splitlines()]
    assert [row["joint"] for row in rows] == [f"joint{number}" for number in range(1, 7)]
    assert all(abs(row["error"]) < 0.1 for row in rows)
    assert list(rows[0]) == ["joint", "desired", "actual", "error", "desired_velocity", "actual_velocity"]


def test_list_names_the_actions_with_their_types(world: CommandLine) -> None:
    rows = [json.loads(line) for line in world.ok("action", "list", "--json").splitlines()]
    assert rows == [
        {"action": ACTION, "type": "control_msgs/FollowJointTrajectory"},
        {"action": GRIPPER, "type": "control_msgs/GripperCommand"},
    ]


def test_a_gripper_opens_closes_and_stalls_at_what_is_in_the_way(world: CommandLine) -> None:
    opened = world.ok("action", "send", "gripper_cmd", "{command: {position: 0.06, max_effort: 20}}", "--wait")
    assert opened.startswith(f"{GRIPPER}: succeeded, position 0.0")
    beyond = "{command: {position: -0.05, max_effort: 20}}"
    failed(world("action", "send", "gripper_cmd", beyond, "--wait"), 1, f"{GRIPPER}: aborted", "stalled yes")


def test_feedback_comes_before_the_result(world: CommandLine) -> None:
    goal = "{trajectory: {joint_names: [joint1], points: [{positions: [0.3], time_from_start: {secs: 1}}]}}"
    lines = world.ok("action", "send", "arm_controller", goal, "--feedback", "--json").splitlines()
    *feedback, ended = map(json.loads, lines)
    assert feedback
    assert all("desired" in message for message in feedback)
    assert ended["state"] == "succeeded"


def test_a_terminal_shows_how_far_it_is(world: CommandLine) -> None:
    words = ("trajectory", "plan", "arm_controller", "--to", "joint1=0.9", "--duration", "10", "--wait")
    shown = world.on_a_terminal(*words)
    assert b"of 10 s, largest error" in shown
    assert b"succeeded" in shown


# --- what fails -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text", "code", "told"),
    [
        ("a.yaml", "points: [", 2, ["a.yaml:1: not valid YAML"]),
        ("a.yaml", "[1, 2]", 2, ["a.yaml: is not a mapping"]),
        ("a.yaml", "joint_names: [joint1]\npoints: []", 2, ["has no points", "trajectory hold"]),
        ("a.yaml", "{joint_names: [joint1], points: [{positions: [0]}]}", 2, ["point 1: time_from_start is missing"]),
        ("a.yaml", "{joint_names: [joint1], points: [{time_from_start: {s: 1}}]}", 2, ["point 1: time_from_start is"]),
        ("a.yaml", "{joint_names: [joint1], points: [{position: [0], time_from_start: 1}]}", 2, ["no field", "'goal."]),
        ("a.json", '{"joint_names": ["joint1"],\n "points": [,]}', 2, ["a.json:2: not valid JSON"]),
        ("a.csv", "", 2, ["a.csv:1: the first line", "time,joint1,joint2"]),
        ("a.csv", "time,joint1\n", 2, ["has no points"]),
        ("a.csv", "time,joint1\n1,0,0\n", 2, ["a.csv:2: has 3 values, expected 2"]),
        ("a.csv", "time,joint1\n\n1,x\n", 2, ["a.csv:3: 'x' is not a number"]),
        ("a.csv", "time,joint1\nnan,1\n", 2, ["a.csv:2: time is nan"]),
        ("a.csv", "time,joint1\n1e300,1\n", 2, ["a.csv:2: time is 1e+300, expected seconds up to 2147483647"]),
        ("a.csv", "time,joint1,joint1\n1,0,0\n", 2, ["duplicate column"]),
        ("a.csv", "time,joint1,joint2,joint1.velocity\n1,0,0,0\n", 2, ["has no velocity of joint2"]),
        ("a.csv", "time,joint1,joint1.speed\n1,0,0\n", 2, ["'speed' is not one of position, velocity, acceleration"]),
        ("a.csv", "time,joint1\n1,nan\n", 1, ["error_code -1", "nan or infinity"]),
        ("a.json", '{"joint_names": ["joint1"], "points": [{"positions": [NaN], "time_from_start": 1}]}', 1, ["nan"]),
        ("a.csv", "time,joint1\n1,0\n1,0.1\n", 1, ["error_code -1", "not strictly increasing in time"]),
        ("a.csv", "time,joint9\n1,0\n", 1, ["error_code -2", "don't match the controller joints"]),
        ("a.yaml", "{joint_names: [joint1, joint2], points: [{positions: [0], time_from_start: 1}]}", 1, ["code -1"]),
        ("a.csv", "time,joint1\n-2,0\n-1,0.1\n", 1, ["Dropping all 2 trajectory point(s)"]),
        ("a.csv", "time,joint1\n0.01,2.5\n", 1, ["aborted, error_code -4: joint1 path error"]),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_its_line_or_the_controllers_own_text(
    world: CommandLine, tmp_path: Path, name: str, text: str, code: int, told: list[str]
) -> None:
    (tmp_path / name).write_text(text)
    failed(world("trajectory", "send", "arm_controller", name, "--wait", cwd=tmp_path), code, *told)


def test_a_file_that_is_not_there_is_named(world: CommandLine) -> None:
    failed(world("trajectory", "send", "arm_controller", "none.csv"), 2, "none.csv: no such file or directory")


def test_a_goal_that_is_rejected_at_once_fails_without_wait_too(world: CommandLine) -> None:
    goal = "{trajectory: {joint_names: [joint9], points: [{positions: [0.3], time_from_start: {secs: 1}}]}}"
    done = world("action", "send", "arm_controller", goal, "--json")
    failed(done, 1, "rejected, error_code -2")
    assert json.loads(done.stdout)["state"] == "rejected"


def test_a_timeout_leaves_the_goal_under_way(world: CommandLine) -> None:
    done = world("trajectory", "send", "arm_controller", "-", "--wait", "--timeout", "3", stdin=SLOW)
    failed(done, 4, f"the goal of {ACTION} has not ended within 3 s", "slidectl action cancel")
    assert ": active" in world.ok("action", "info", "arm_controller")
    world.ok("action", "cancel", "arm_controller")


def test_ctrl_c_cancels_the_goal(world: CommandLine, client: Client) -> None:
    with client.action(ACTION) as arm:
        words = ("action", "send", "arm_controller", f"trajectory: {SLOW}", "--wait")
        process = subprocess.Popen(world.argv(*words), env=world.environment, stderr=subprocess.PIPE, text=True)
        goal_id = active_goal(arm)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert (process.returncode, err) == (130, f"{ACTION}: the goal is cancelled\n")
        ended = {goal["goal_id"]["id"]: goal["status"] for goal in arm.goals()}
        assert ended[goal_id] == 2


def test_a_stopped_controller_says_that_it_does_not_run(world: CommandLine) -> None:
    world.ok("controller", "stop", "arm_controller")
    try:
        failed(plan(world, "--to", "joint1=0", "--duration", "1"), 1, "Controller is not running")
        failed(world("trajectory", "state", "arm_controller"), 1, "Controller is not running")
        failed(world("trajectory", "hold", "arm_controller"), 1, "Controller is not running")
        failed(
            world("trajectory", "send", "arm_controller", "-", stdin=SLOW), 1, "rejected, error_code -1", "not running"
        )
    finally:
        world.ok("controller", "start", "arm_controller")


def test_whoever_waits_for_a_goal_is_told_when_its_robot_is_deleted(world: CommandLine, client: Client) -> None:
    words = ["--at", "0", "4", "0", "--controllers", "config/arm_control.yaml", "--start", "arm_controller"]
    world.ok("spawn", "arm", "--name", "other", *words)
    with client.action("/other/arm_controller/follow_joint_trajectory") as arm:
        process = world.start("action", "send", arm.name, f"trajectory: {SLOW}", "--wait")
        active_goal(arm)
        world.ok("delete", "other")
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert err.startswith("error: /other/arm_controller/follow_joint_trajectory: preempted")
    assert err.endswith(": the action has no server any more: its robot or its controller was removed\n")


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["trajectory", "state", "leg_controller"], 1, ["no trajectory controller", "/arm/arm_controller"]),
        (["trajectory", "state", "gripper_controller"], 1, ["no trajectory controller 'gripper_controller'"]),
        (["action", "info", "nothing"], 1, ["no action 'nothing'", GRIPPER]),
        (["action", "send", "gripper_cmd", "0.5"], 2, ["not a mapping of fields"]),
        (["action", "send", "gripper_cmd", "{comand: {}}"], 2, ["no field 'goal.comand'"]),
        (["trajectory", "plan", "arm_controller", "--to", "joint9=1", "--duration", "1"], 1, ["no joint 'joint9'"]),
        (["trajectory", "plan", "arm_controller", "--to", "joint1", "--duration", "1"], 2, ["JOINT=POSITION"]),
        (["trajectory", "plan", "arm_controller", "--to", "joint1=nan", "--duration", "1"], 2, ["a finite number"]),
        (["trajectory", "plan", "arm_controller", "--to", "joint1=1", "--duration", "0"], 2, ["not above 0"]),
    ],
)
def test_a_wrong_word_is_answered_with_what_there_is(
    world: CommandLine, words: list[str], code: int, told: list[str]
) -> None:
    failed(world(*words), code, *told)


# --- Client.action ----------------------------------------------------------------------------------------------------


def goal_of(position: float, seconds: int) -> dict[str, Any]:
    point = {"positions": [position], "time_from_start": {"secs": seconds}}
    return {"trajectory": {"joint_names": ["joint6"], "points": [point]}}


def test_a_script_sends_follows_and_cancels(client: Client) -> None:
    with client.action("arm_controller") as arm:
        assert arm.wait(arm.send(goal_of(0.5, 1)), timeout=30).succeeded
        goal_id = arm.send(goal_of(0.0, 3000))
        assert "desired" in next(arm.follow(goal_id, timeout=30))  # type: ignore[operator]
        with pytest.raises(TimedOut, match=r"has not ended within 0\.1 s"):
            arm.wait(goal_id, timeout=0.1)
        arm.cancel(goal_id)
        assert arm.wait(goal_id, timeout=30).state == "preempted"


def test_a_goal_that_the_server_forgets_is_lost(client: Client) -> None:
    with client.action("arm_controller") as arm:
        goal_id = arm.send(goal_of(0.0, 3000))
        entry = {"goal_id": {"id": goal_id}, "status": 1}
        for listed in ([entry], []):
            arm._lists.add({"msg": {"status_list": listed}})
            arm._is_gone(goal_id)
        arm._lists.add({"msg": {"status_list": []}})
        assert arm.wait(goal_id, timeout=30).state == "lost"
        arm.cancel(goal_id)


def test_a_goal_is_lost_when_the_process_that_serves_its_action_ends(world: CommandLine, client: Client) -> None:
    with world.client() as server:
        server.subscribe("/tool/goal", "control_msgs/GripperCommandActionGoal")
        server.advertise("/tool/status", "actionlib_msgs/GoalStatusArray")
        for topic in ("result", "feedback"):
            server.advertise(f"/tool/{topic}", f"control_msgs/GripperCommandAction{topic.capitalize()}")
        server.flush()
        tool = client.action("/tool")
        goal_id = tool.send({})
    assert tool.wait(goal_id, timeout=30) == (
        9,
        "the action has no server any more: its robot or its controller was removed",
        {},
    )


def test_an_action_that_is_not_there_or_not_alone_is_an_error(client: Client) -> None:
    with pytest.raises(UnknownName, match="no action 'leg'"):
        client.action("leg")
    client.advertise("/arm/arm_controller/other/goal", "control_msgs/GripperCommandActionGoal")
    client.flush()
    with pytest.raises(AmbiguousName, match="more than one action"):
        client.action("arm_controller")


def test_after_an_abort_it_is_told_that_the_motion_goes_on_or_that_it_has_stopped(
    world: CommandLine, tmp_path: Path
) -> None:
    parameter = "/arm/arm_controller/stop_on_abort"

    def far_away() -> Done:
        """A goal that is too fast wherever the joint is when it comes."""
        (tmp_path / "fast.csv").write_text("time,joint1\n0.01,0\n0.02,3\n")
        return world("trajectory", "send", "arm_controller", "fast.csv", "--wait", cwd=tmp_path)

    def load_anew() -> None:
        for verb in ("stop", "unload", "spawn"):
            world.ok("controller", verb, "arm_controller")

    world.ok("sim", "reset")
    load_anew()  # others have left the arm where it fell, and goals of their own
    drives_on = "the controller drives on to the end of the trajectory, as ros_controllers do"
    failed(far_away(), 1, drives_on, "slidectl trajectory hold /arm/arm_controller")
    world.ok("trajectory", "hold", "arm_controller")
    world.ok("param", "set", parameter, "true")
    try:
        load_anew()
        failed(far_away(), 1, f"the joints stop where they are ({parameter})")
    finally:
        world.ok("param", "delete", parameter)
        load_anew()


def test_a_position_beyond_a_limit_is_warned_of(world: CommandLine) -> None:
    try:
        done = plan(world, "--to", "joint2=9", "--duration", "100")
        assert done.returncode == 0
        assert "warning: /arm/arm_controller: joint2 is commanded to 9, outside its limits" in done.stderr
    finally:
        world.ok("trajectory", "hold", "arm_controller")


def test_a_goal_in_a_paused_world_is_given_up_unless_the_world_goes_on(world: CommandLine) -> None:
    world.ok("sim", "reset")
    world.ok("sim", "pause")
    try:
        done = plan(world, "--to", "joint1=0.1", "--duration", "0.2", "--wait")
        assert done.returncode == 4
        assert "the simulation is paused; this waits 10 s for it to go on: slidectl sim resume" in done.stderr
        assert "has not ended within 10 s\nthe simulation is paused; resume it with: slidectl sim resume" in done.stderr
        waiting = world.start("trajectory", "plan", "arm_controller", "--to", "joint1=0", "--duration", "2", "--wait")
        assert waiting.stderr is not None
        assert "this waits 10 s" in waiting.stderr.readline()
        world.ok("sim", "resume")
        waiting.communicate(timeout=DEADLINE_S)
        assert waiting.returncode == 0
    finally:
        world.ok("sim", "resume")
