"""Controllers of several joints, compiled: the same bits as the interpreter in the midst of what happens to a robot."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from engine_scenes import GAINS, Scene, add, arm, play, switch
from sim_robots import STATES

from slidectl.errors import SlidectlError
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

pytestmark = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")

JOINTS = ["joint1", "joint2", "joint3"]


def is_compiled(simulation: Simulation, robot: str, name: str) -> bool:
    """Does machine code update that controller now?"""
    simulation.step(20)
    assert simulation.engine.compiled is not None
    times = simulation.call("/slidectl/update_times", {"robot": robot})["controllers"]
    return next(bool(one["compiled"]) for one in times if one["name"] == name)


def assert_same(scene: Scene) -> Simulation:
    """Play it on both, stepped by a script and driven. Returns the compiled one."""
    for driven in (False, True):
        (plain, _), (compiled, simulation) = (play(scene, engine, driven) for engine in ("plain", "compiled"))
        assert compiled == plain
    return simulation


def restart(simulation: Simulation, name: str) -> None:
    """Stop the controller and start it again."""
    switch(simulation, "a", stop=[name])
    simulation.step(2)
    switch(simulation, "a", start=[name])


def played(simulation: Simulation, dice: Random, things: list[Any], times: int) -> None:
    """So many of these things happen; what is refused is refused by both engines."""
    for _ in range(times):
        try:
            dice.choice(things)()
        except SlidectlError as error:
            simulation.heard.messages.append(("refused", str(error)))  # type: ignore[attr-defined]
        simulation.step(dice.choice((1, 30, 170, 400)))


GROUPS = {
    "effort_controllers/JointGroupPositionController": {joint: {"pid": GAINS} for joint in JOINTS},
    "effort_controllers/JointGroupEffortController": {},
    "velocity_controllers/JointGroupVelocityController": {},
    "position_controllers/JointGroupPositionController": {},
}


@pytest.mark.parametrize("kind", GROUPS)
def test_a_group_of_joints(kind: str) -> None:
    def scene(simulation: Simulation) -> None:
        dice = Random(kind)
        own = {"type": kind, "joints": ["joint2", "joint3", "joint1"], **GROUPS[kind]}
        interface = kind.partition("_")[0].title()
        add(simulation, "a", arm(interface=interface), {"states": {"type": STATES, "publish_rate": 80}, "group": own})
        simulation.heard.listen("/a/joint_states")  # type: ignore[attr-defined]
        for k in range(12):
            simulation.publish("/a/group/command", {"data": [dice.uniform(-1.5, 1.5) for _ in JOINTS]})
            simulation.step(dice.choice((3, 60, 200)))
            if k == 6:
                switch(simulation, "a", stop=["group"])
                switch(simulation, "a", start=["group"])

    simulation = assert_same(scene)
    assert is_compiled(simulation, "a", "group")


def test_a_pid_that_publishes_each_step_leaves_its_group_to_the_interpreter() -> None:
    own = {"type": "effort_controllers/JointGroupPositionController", "joints": JOINTS}
    pids = {joint: {"pid": {**GAINS, "publish_state": joint == "joint2"}} for joint in JOINTS}

    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), {"group": {**own, **pids}})
        simulation.heard.listen("/a/group/joint2/pid/state")  # type: ignore[attr-defined]
        simulation.step(200)

    assert_same(scene)


FOLLOWERS = {
    "effort": {"gains": {joint: {"p": 90.0, "d": 12.0, "i": 5.0, "i_clamp": 3.0} for joint in JOINTS}},
    "velocity": {"gains": {joint: {"p": 8.0} for joint in JOINTS}, "velocity_ff": dict.fromkeys(JOINTS, 1.0)},
    "position": {},
}
FOLLOWER_TOPICS = ("state", "follow_joint_trajectory/feedback", "follow_joint_trajectory/result")


def follower(kind: str, **more: Any) -> dict[str, dict[str, Any]]:
    own = {"type": f"{kind}_controllers/JointTrajectoryController", "joints": JOINTS, "state_publish_rate": 60}
    constraints = {"goal_time": 0.3, "stopped_velocity_tolerance": 0.0}
    return {"arm": {**own, **FOLLOWERS[kind], "constraints": constraints, "allow_partial_joints_goal": True, **more}}


def random_trajectory(dice: Random) -> dict[str, Any]:
    """Lines, cubics and quintics through one to five points, of all joints or some."""
    joints = dice.sample(JOINTS, dice.choice((1, 3, 3)))
    terms, time_s, points = dice.choice((1, 2, 3)), 0.0, []
    for _ in range(dice.randint(1, 5)):
        time_s += dice.uniform(0.01, 0.3)
        lists = [[dice.uniform(-1, 1) for _ in joints] if k < terms else [] for k in range(3)]
        stamp = {"secs": int(time_s), "nsecs": int(time_s % 1 * 1e9)}
        named = dict(zip(("positions", "velocities", "accelerations"), lists, strict=True))
        points.append({**named, "time_from_start": stamp})
    return {"joint_names": joints, "points": points}


def something_for_a_follower(simulation: Simulation, dice: Random) -> None:
    tolerances = [{"name": joint, "position": dice.choice((0.02, 0.3, 9.0))} for joint in JOINTS]
    goal = {"trajectory": random_trajectory(dice), "goal_tolerance": tolerances}
    if dice.random() < 0.3:
        goal["path_tolerance"] = tolerances
    action = "/a/arm/follow_joint_trajectory"
    things = [
        lambda: simulation.publish(f"{action}/goal", {"goal": goal}),
        lambda: simulation.publish(f"{action}/goal", {"goal": goal}),
        lambda: simulation.publish("/a/arm/command", random_trajectory(dice)),
        lambda: simulation.publish("/a/arm/command", {"joint_names": JOINTS}),
        lambda: simulation.publish(f"{action}/cancel", {}),
        lambda: simulation.call("/a/arm/query_state", {"time": {"secs": simulation.time_ns // 10**9 + 1, "nsecs": 0}}),
        lambda: restart(simulation, "arm"),
        lambda: simulation.world.add_joint_force("a", "joint1", dice.uniform(-20, 20), simulation.time_ns, 60_000_000),
        lambda: simulation.reset_world() if dice.random() < 0.3 else None,
    ]
    dice.choice(things)()


@pytest.mark.parametrize("kind", FOLLOWERS)
def test_a_trajectory_controller_whatever_happens(kind: str) -> None:
    def scene(simulation: Simulation) -> None:
        dice = Random(kind)
        stop = {"stop_trajectory_duration": 0.1} if kind == "velocity" else {}
        add(simulation, "a", arm(interface=kind.title()), follower(kind, **stop))
        simulation.step(1)
        for topic in FOLLOWER_TOPICS:
            simulation.heard.listen(f"/a/arm/{topic}")  # type: ignore[attr-defined]
        played(simulation, dice, [lambda: something_for_a_follower(simulation, dice)], 60)

    simulation = assert_same(scene)
    heard = {topic for topic, _ in simulation.heard.messages}  # type: ignore[attr-defined]
    assert {f"/a/arm/{topic}" for topic in FOLLOWER_TOPICS} <= heard
    assert is_compiled(simulation, "a", "arm")


@pytest.mark.parametrize("limits", [{}, {"jerk": 30.0, "acceleration": 3.0, "velocity": 0.8}])
def test_a_differential_drive_whatever_happens(limits: dict[str, float]) -> None:
    bounds = {f"has_{name}_limits": True for name in limits} | {f"max_{name}": most for name, most in limits.items()}
    own = {
        "type": "diff_drive_controller/DiffDriveController",
        "left_wheel": ["joint3", "joint2"],
        "right_wheel": ["joint1", "joint4"],
        "wheel_separation": 0.4,
        "wheel_radius": 0.1,
        "pose_covariance_diagonal": [0.001] * 6,
        "twist_covariance_diagonal": [0.001] * 6,
        "linear": {"x": bounds},
        "angular": {"z": bounds},
    }

    def scene(simulation: Simulation) -> None:
        dice = Random(len(limits))
        add(simulation, "a", arm(("continuous",) * 4, interface="Velocity"), {"base": own})
        for topic in ("/a/base/odom", "/tf"):
            simulation.heard.listen(topic)  # type: ignore[attr-defined]
        things = [
            lambda: simulation.publish(
                "/a/base/cmd_vel", {"linear": {"x": dice.uniform(-1, 1)}, "angular": {"z": dice.choice((0.0, 0.9))}}
            ),
            lambda: simulation.parameters.set("/a/base/left_wheel_radius_multiplier", dice.uniform(0.8, 1.2)),
            lambda: simulation.parameters.set("/a/base/publish_rate", dice.uniform(10.0, 90.0)),
            lambda: restart(simulation, "base"),
            lambda: simulation.reset_world() if dice.random() < 0.3 else None,
        ]
        played(simulation, dice, 3 * things[:1] + things, 40)

    simulation = assert_same(scene)
    assert {topic for topic, _ in simulation.heard.messages} >= {"/a/base/odom", "/tf"}  # type: ignore[attr-defined]
    assert is_compiled(simulation, "a", "base")


@pytest.mark.parametrize("interface", ["Effort", "Position"])
def test_a_gripper_whatever_happens(interface: str) -> None:
    gains = {"joint1": {"p": 90.0, "d": 25.0, "i": 1.0, "i_clamp": 2.0}}
    kind = f"{interface.lower()}_controllers/GripperActionController"
    own = {"type": kind, "joint": "joint1", "gains": gains, "goal_tolerance": 0.05}
    own |= {"stall_timeout": 0.1, "stall_velocity_threshold": 0.1}

    def scene(simulation: Simulation) -> None:
        dice = Random(interface)
        add(simulation, "a", arm(("prismatic",), interface=interface), {"gripper": own})
        simulation.step(1)
        simulation.heard.listen("/a/gripper/gripper_cmd/result")  # type: ignore[attr-defined]

        def send() -> None:
            command = {"position": dice.choice((0.4, -0.4, 4.0)), "max_effort": dice.choice((0.0, 3.0, 25.0))}
            simulation.publish("/a/gripper/gripper_cmd/goal", {"goal": {"command": command}})

        things = [
            send,
            send,
            lambda: simulation.publish("/a/gripper/gripper_cmd/cancel", {}),
            lambda: simulation.world.add_joint_force("a", "joint1", 9.0, simulation.time_ns, 60_000_000),
            lambda: simulation.reset_world() if dice.random() < 0.3 else None,
        ]
        played(simulation, dice, [*things, lambda: simulation.step(600)], 60)

    simulation = assert_same(scene)
    results = [text for _, text in simulation.heard.messages]  # type: ignore[attr-defined]
    assert any("'reached_goal': True" in text for text in results)
    assert any("'stalled': True" in text for text in results)
    assert is_compiled(simulation, "a", "gripper")
