"""Snapshots: going on from one gives the same bits as never having stopped, here, later and in another simulation."""

from __future__ import annotations

import hashlib
import json
import math
import os
import random
import subprocess
import sys
import threading
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from random import Random
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest
import yaml
from engine_scenes import EFFORT, GAINS, POSITION, TOPICS, VELOCITY, Heard, add, arm, at_random, happen, switch, usual
from engine_scenes import vars_of as numbers_of
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_robots import STATES
from test_simulation_compiled_controllers import FOLLOWERS, JOINTS, random_trajectory
from test_simulation_force_torque import IMU, PLUGIN
from test_simulation_force_torque import arm as tool_arm

import slidectl
from slidectl import Simulation, description
from slidectl.control import registry
from slidectl.control.controller_interface import Controller
from slidectl.control.hardware_interface import EffortJointInterface
from slidectl.control.node_handle import NodeHandle
from slidectl.control.registry import controller
from slidectl.errors import BadFile, BadName, Refused, SlidectlError, UnknownName
from slidectl.features import snapshot_files
from slidectl.features.snapshots import RESTORED, restore
from slidectl.physics import Diverged, MujocoRobotHW
from slidectl.simulation.compiled import object_file
from slidectl.simulation.topics import TopicSubscription

CONFIG = Path(__file__).parent.parent.parent / "config"
ENGINES = ["plain", *(["compiled"] if object_file.is_possible() else [])]
Build = Callable[[Simulation], None]
Act = Callable[[Simulation, Random], None]
"""Builds a scene; and lets something happen in it."""


def made(engine: str) -> Simulation:
    simulation = Simulation(engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    return simulation


def everything(simulation: Simulation) -> list[Any]:
    """All that the future depends on, to the bit."""
    data = simulation.world.data
    simulation.loop.settle()
    left: list[Any] = [simulation.time_ns, simulation.cycles, simulation.parameters.tree()]
    left += [array.tobytes() for array in (data.qpos, data.qvel, data.qfrc_applied, data.qacc_warmstart)]
    model = simulation.world.model
    left += [array.tobytes() for array in (model.dof_frictionloss, model.dof_damping, model.body_inertia)]
    left += [simulation.faults.messages(), simulation.world.applied_forces.snapshot()["wrenches"]]
    for robot in simulation.robots:
        if robot.is_controlled:
            left += [numbers_of(joint.handle) for joint in robot.hardware.driven()]
            left += [numbers_of(robot.manager.get(name)) for name in robot.manager.names()]
            left += [robot.manager.list(), robot.emergency_stop]
    return left


def future(simulation: Simulation, act: Act, topics: list[str]) -> list[Any]:
    """What is published next, and what is left then."""
    heard: list[tuple[str, str]] = []

    def hear(topic: str) -> TopicSubscription:
        take = lambda message: heard.append((topic, repr(message)))  # noqa: E731
        return simulation.graph.topics.subscribe(topic, None, "/listener", take)

    subscriptions, dice = list(map(hear, topics)), Random(7)
    heard.clear()
    for _ in range(12):
        act(simulation, dice)
        simulation.step(dice.choice((1, 17, 60, 150)))
    for subscription in subscriptions:
        subscription.close()
    return [everything(simulation), heard]


# -- scenes ------------------------------------------------------------------------------------------------------------


def publishing(commands: dict[str, Callable[[Random], dict[str, Any]]]) -> Act:
    """One of these messages."""

    def act(simulation: Simulation, dice: Random) -> None:
        topic = dice.choice(list(commands))
        simulation.publish(topic, commands[topic](dice))

    return act


def number(dice: Random) -> dict[str, Any]:
    return {"data": dice.uniform(-1.5, 1.5)}


def numbers(dice: Random) -> dict[str, Any]:
    return {"data": [dice.uniform(-1.5, 1.5) for _ in JOINTS]}


def one_each(interface: str, types: list[str], gains: bool = True) -> tuple[Build, Act]:
    """A controller of a joint each; joints of positions and velocities are driven by PIDs, or by motors."""

    def build(simulation: Simulation) -> None:
        own = dict.fromkeys(JOINTS, GAINS) if gains else {}
        simulation.parameters.set("/a/gazebo_ros_control/pid_gains", own)
        goals = {f"goal{k}": {"type": kind, "joint": f"joint{k}", "pid": GAINS} for k, kind in enumerate(types, 1)}
        add(
            simulation,
            "a",
            arm(interface=interface, safety=gains),
            {"states": {"type": STATES, "publish_rate": 80}} | goals,
        )

    return build, publishing({f"/a/goal{k}/command": number for k in range(1, len(types) + 1)})


def group(kind: str) -> tuple[Build, Act]:
    own = {"type": kind, "joints": JOINTS} | {joint: {"pid": GAINS} for joint in JOINTS if "Position" in kind}
    xml = arm(interface=kind.partition("_")[0].title())
    return lambda simulation: add(simulation, "a", xml, {"group": own}), publishing({"/a/group/command": numbers})


def following(kind: str) -> tuple[Build, Act]:
    """Goals, trajectories and cancellations in the midst of others; the joints may have left their path."""
    prefix = {"pos_vel": "position", "pos_vel_acc": "position"}.get(kind, kind)
    interface = {"pos_vel": "PosVel", "pos_vel_acc": "PosVelAcc"}.get(kind, kind.title())
    own = {"type": f"{kind}_controllers/JointTrajectoryController", "joints": JOINTS, **FOLLOWERS[prefix]}
    own |= {"allow_partial_joints_goal": True, "constraints": {"goal_time": 0.2, "stopped_velocity_tolerance": 0.0}}

    def act(simulation: Simulation, dice: Random) -> None:
        trajectory = random_trajectory(dice)
        tolerances = [{"name": joint, "position": dice.choice((0.05, 9.0))} for joint in JOINTS]
        action = "/a/arm/follow_joint_trajectory"
        what = dice.random()
        if what < 0.6:
            simulation.publish(f"{action}/goal", {"goal": {"trajectory": trajectory, "goal_tolerance": tolerances}})
        elif what < 0.9:
            simulation.publish("/a/arm/command", trajectory)
        else:
            simulation.publish(f"{action}/cancel", {})

    return lambda simulation: add(simulation, "a", arm(interface=interface), {"arm": own}), act


def following_of_ros2(interface: str, **more: Any) -> tuple[Build, Act]:
    """As `following`, with replacements, speeds and holds of ros2_controllers."""
    own = {"type": "joint_trajectory_controller/JointTrajectoryController", "joints": JOINTS}
    own |= {"command_interfaces": [interface], "state_interfaces": ["position", "velocity"]}
    own |= {"allow_partial_joints_goal": True, "allow_nonzero_velocity_at_trajectory_end": True, "cmd_timeout": 0.3}
    braking = {joint: {"max_deceleration_on_cancel": 9.0, "trajectory": 0.5} for joint in JOINTS}
    own |= {"constraints": {"goal_time": 0.2, "decelerate_on_cancel": True, **braking}, **more}

    def act(simulation: Simulation, dice: Random) -> None:
        trajectory, what, action = random_trajectory(dice), dice.random(), "/a/arm/follow_joint_trajectory"
        if what < 0.4:
            simulation.publish(f"{action}/goal", {"goal": {"trajectory": trajectory}})
        elif what < 0.8:
            simulation.publish("/a/arm/joint_trajectory", trajectory)
        elif what < 0.9 and interface == "position":
            simulation.publish("/a/arm/speed_scaling_input", {"factor": dice.uniform(0.3, 1.5)})
        else:
            simulation.publish(f"{action}/cancel", {})

    return lambda simulation: add(simulation, "a", arm(interface=interface.title()), {"arm": own}), act


def gripping(interface: str) -> tuple[Build, Act]:
    own: dict[str, Any] = {"type": f"{interface.lower()}_controllers/GripperActionController", "joint": "joint1"}
    own |= {"gains": {"joint1": {"p": 90.0, "d": 25.0}}, "stall_timeout": 0.1, "goal_tolerance": 0.05}

    def goal(dice: Random) -> dict[str, Any]:
        return {
            "goal": {"command": {"position": dice.choice((0.4, -0.4, 4.0)), "max_effort": dice.choice((3.0, 25.0))}}
        }

    xml = arm(("prismatic",), interface=interface)
    return lambda simulation: add(simulation, "a", xml, {"gripper": own}), publishing(
        {"/a/gripper/gripper_cmd/goal": goal}
    )


def parallel_gripping() -> tuple[Build, Act]:
    own: dict[str, Any] = {"type": "parallel_gripper_action_controller/GripperActionController", "joint": "joint1"}
    own |= {"stall_timeout": 0.1, "goal_tolerance": 0.05, "action_monitor_rate": 20.0}
    xml = arm(("prismatic",), interface="Position")
    return lambda simulation: add(simulation, "a", xml, {"gripper": own}), publishing(
        {
            "/a/gripper/gripper_cmd/goal": lambda dice: {
                "goal": {"command": {"position": [dice.choice((0.4, -0.4, 4.0))]}}
            }
        }
    )


def shipped_model(
    model: str, commands: dict[str, Callable[[Random], dict[str, Any]]], **arguments: str
) -> tuple[Build, Act]:
    """A shipped model on the ground, with all controllers of its configuration."""

    def build(simulation: Simulation) -> None:
        own = yaml.safe_load((CONFIG / f"{model}_control.yaml").read_text())[model]
        add(simulation, model, description.load(model, arguments, description.Packages()).xml, own)

    return build, publishing(commands)


def twist(dice: Random) -> dict[str, Any]:
    return {"linear": {"x": dice.uniform(-1, 1)}, "angular": {"z": dice.choice((0.0, 0.9))}}


def axles(dice: Random) -> dict[str, Any]:
    return {
        "speed": dice.uniform(0.1, 0.5),
        "front_steering_angle": dice.uniform(-0.5, 0.5),
        "rear_steering_angle": 0.1,
    }


def sensing() -> tuple[Build, Act]:
    """The controllers measure, in an update, what the last step computed; a force pushes the tool meanwhile."""
    rate = {"publish_rate": 400}
    own: dict[str, dict[str, Any]] = {
        "imu": {"type": "imu_sensor_controller/ImuSensorController", **rate},
        "wrist_wrench": {"type": "force_torque_sensor_controller/ForceTorqueSensorController", **rate},
        "head": {
            "type": "imu_sensor_broadcaster/IMUSensorBroadcaster",
            "sensor_name": "attitude",
            "frame_id": "tool",
            "update_rate": 70,
        },
        "forces": {
            "type": "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster",
            "sensor_name": "wrist",
            "frame_id": "tool",
            "offset": {"force": {"z": 19.6}},
        },
        "push": {"type": EFFORT, "joint": "slide"},
    }

    def act(simulation: Simulation, dice: Random) -> None:
        simulation.publish("/a/push/command", number(dice))
        force = (dice.uniform(-5, 5), 0.0, 2.0)
        simulation.world.add_wrench("a", "tool", force, (0.0, 0.0, 0.1), simulation.time_ns, 40_000_000)

    xml = tool_arm(PLUGIN.format(rate=50, noise=0.2) + IMU, mount='type="revolute"')
    return lambda simulation: add(simulation, "a", xml, own), act


def ackermann() -> tuple[Build, Act]:
    xml = arm(("continuous", "revolute"), interface="Velocity")
    own = {
        "type": "ackermann_steering_controller/AckermannSteeringController",
        "rear_wheel": "joint1",
        "front_steer": "joint2",
        "wheel_separation_h": 0.4,
        "wheel_radius": 0.1,
        "pose_covariance_diagonal": [0.001] * 6,
        "twist_covariance_diagonal": [0.001] * 6,
    }
    head, tail = xml.rsplit("VelocityJointInterface", 1)
    steered = f"{head}PositionJointInterface{tail}"
    return lambda simulation: add(simulation, "a", steered, {"base": own}), publishing({"/a/base/cmd_vel": twist})


def of_ros2() -> tuple[Build, Act]:
    """Controllers of ROS 2 at rates of their own, with commands of the wrong size among the good ones."""
    forward = "forward_command_controller"
    own: dict[str, dict[str, Any]] = {
        "states": {"type": "joint_state_broadcaster/JointStateBroadcaster", "update_rate": 300},
        "arm": {
            "type": f"{forward}/ForwardCommandController",
            "joints": JOINTS[1:],
            "interface_name": "effort",
            "update_rate": 250,
        },
        "one": {
            "type": f"{forward}/MultiInterfaceForwardCommandController",
            "joint": JOINTS[0],
            "interface_names": ["effort"],
        },
    }

    def some(dice: Random) -> dict[str, Any]:
        return {"data": [dice.uniform(-1.5, 1.5) for _ in range(dice.choice((0, 1, 2)))]}

    return lambda simulation: add(simulation, "a", arm(), own), publishing(
        {"/a/arm/commands": some, "/a/one/commands": some}
    )


def drive_of_ros2() -> tuple[Build, Act]:
    """The shipped cart, with limits, a time-out that passes between commands, and poses that are set."""
    own = {
        "type": "diff_drive_controller/DiffDriveController",
        "left_wheel_names": ["left_wheel_joint"],
        "right_wheel_names": ["right_wheel_joint"],
        "wheel_separation": 0.4,
        "wheel_radius": 0.1,
        "cmd_vel_timeout": 0.1,
        "linear": {"x": {"max_acceleration": 1.0, "max_jerk": 20.0}},
        "update_rate": 200,
    }

    def build(simulation: Simulation) -> None:
        xml = description.load("cart", {"drive": "controller"}, description.Packages()).xml
        add(simulation, "cart", xml, {"base": own})

    def act(simulation: Simulation, dice: Random) -> None:
        if dice.random() < 0.2:
            simulation.call("/cart/base/set_odometry", {"x": dice.uniform(-1, 1), "yaw": 0.5})
        else:
            simulation.publish("/cart/base/cmd_vel", {"twist": twist(dice)})

    return build, act


def plugin_drive(drive: str) -> tuple[Build, Act]:
    """A model that drives by itself: its wheels measure their way, or it glides."""
    glides = """<robot name="box"><link name="base"><inertial><mass value="2"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
      <gazebo><plugin name="glide" filename="libgazebo_ros_planar_move.so"/></gazebo></robot>"""

    def build(simulation: Simulation) -> None:
        wheels = description.load("cart", {"drive": "plugin"}, description.Packages()).xml
        simulation.spawn(wheels if drive == "wheels" else glides, "a")

    return build, publishing({"/cart/cmd_vel" if drive == "wheels" else "/a/cmd_vel": twist})


def stopped() -> tuple[Build, Act]:
    """Emergency stops and releases, switches, another timestep's worth of parameters."""
    build, _ = one_each("Position", ["position_controllers/JointPositionController"] * 3)

    def act(simulation: Simulation, dice: Random) -> None:
        simulation.publish(f"/a/goal{dice.choice('123')}/command", number(dice))
        simulation.call("/slidectl/estop", {"names": ["a"], "stop": dice.random() < 0.5})
        simulation.parameters.set("/a/gazebo_ros_control/pid_gains/joint2/p", dice.uniform(1, 80))
        goal = f"goal{dice.choice('123')}"
        request = {"start_controllers": [goal], "stop_controllers": [goal], "strictness": 1}
        simulation.call("/a/controller_manager/switch_controller", request)

    return build, act


def chained(interfaces: list[str]) -> tuple[Build, Act]:
    """A group of ROS 1 before PIDs of ROS 2, which is stopped and started now and then."""
    gains = {"p": 40.0, "i": 30.0, "d": 4.0, "u_clamp_max": 8.0, "u_clamp_min": -8.0}
    gains |= {"antiwindup_strategy": "back_calculation", "activate_state_publisher": True}
    pids = {"type": "pid_controller/PidController", "dof_names": JOINTS, "command_interface": "effort"}
    pids |= {"reference_and_state_interfaces": interfaces, "gains": dict.fromkeys(JOINTS, gains)}
    front = {"type": "position_controllers/JointGroupPositionController", "joints": [f"pids/{one}" for one in JOINTS]}
    own = {"states": {"type": STATES, "publish_rate": 80}, "pids": pids, "front": front}

    def act(simulation: Simulation, dice: Random) -> None:
        values = [dice.uniform(-1.5, 1.5) for _ in JOINTS]
        if dice.random() < 0.5:
            simulation.publish("/a/front/command", {"data": values})
        elif dice.random() < 0.5:
            simulation.publish("/a/pids/reference", {"dof_names": JOINTS, "values": values, "values_dot": []})
        else:
            running = [one["name"] for one in simulation.robots.get("a").manager.list() if one["state"] == "running"]
            switch(simulation, "a", **{"stop" if "front" in running else "start": ["front"]})

    return lambda simulation: add(simulation, "a", arm(), own), act


SCENES: dict[str, tuple[Build, Act]] = {
    "efforts": one_each("Effort", [POSITION, VELOCITY, EFFORT]),
    "velocities": one_each(
        "Velocity", ["velocity_controllers/JointPositionController", "velocity_controllers/JointVelocityController"]
    ),
    "velocities of motors": one_each("Velocity", ["velocity_controllers/JointVelocityController"] * 3, gains=False),
    "positions": one_each("Position", ["position_controllers/JointPositionController"] * 3),
    "positions of motors": one_each("Position", ["position_controllers/JointPositionController"] * 3, gains=False),
    "effort group": group("effort_controllers/JointGroupPositionController"),
    "forwarding effort group": group("effort_controllers/JointGroupEffortController"),
    "velocity group": group("velocity_controllers/JointGroupVelocityController"),
    "position group": group("position_controllers/JointGroupPositionController"),
    "effort trajectory": following("effort"),
    "velocity trajectory": following("velocity"),
    "position trajectory": following("position"),
    "pos-vel trajectory": following("pos_vel"),
    "pos-vel-acc trajectory": following("pos_vel_acc"),
    "effort trajectory of ROS 2": following_of_ros2(
        "effort", gains={joint: {"p": 90.0, "d": 12.0, "i": 5.0, "i_clamp_max": 3.0} for joint in JOINTS}
    ),
    "position trajectory of ROS 2": following_of_ros2("position"),
    "effort gripper": gripping("Effort"),
    "position gripper": gripping("Position"),
    "parallel gripper of ROS 2": parallel_gripping(),
    "a cart on the ground": shipped_model("cart", {"/cart/base_controller/cmd_vel": twist}, drive="controller"),
    "a car on the ground": shipped_model(
        "car", {"/car/base_controller/cmd_vel": twist, "/car/base_controller/cmd_four_wheel_steering": axles}
    ),
    "ackermann": ackermann(),
    "sensors": sensing(),
    "a chain": chained(["position"]),
    "a chain with rates": chained(["position", "velocity"]),
    "controllers of ROS 2": of_ros2(),
    "a drive of ROS 2": drive_of_ros2(),
    "wheels of a model": plugin_drive("wheels"),
    "a model that glides": plugin_drive("glides"),
    "stops and switches": stopped(),
}


def test_every_shipped_controller_is_in_a_scene() -> None:
    seen = set()
    for build, _ in SCENES.values():
        simulation = made("plain")
        build(simulation)
        for robot in simulation.robots:
            seen |= {one["type"] for one in robot.manager.list()} if robot.is_controlled else set()
    known = registry.common
    shipped = {kind for kind in known.types() if known.find(kind).__module__.startswith("slidectl.")}
    assert shipped <= seen


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("scene", SCENES)
def test_going_on_from_a_snapshot_gives_the_same_bits(scene: str, engine: str, tmp_path: Path) -> None:
    build, act = SCENES[scene]

    def begun() -> Simulation:
        simulation, dice = made(engine), Random(scene)
        build(simulation)
        for _ in range(8):
            act(simulation, dice)
            simulation.step(dice.choice((3, 41, 90)))
        return simulation

    one = begun()
    topics = [
        topic for topic in one.graph.topics.names() if topic.startswith(("/a/", "/car", "/tf")) and "image" not in topic
    ]
    inputs = ("/command", "/commands", "/cmd_vel", "/goal", "/cancel", "/joint_trajectory", "/speed_scaling_input")
    topics = [topic for topic in topics if not topic.endswith(inputs)]
    never_stopped = future(one, act, topics)

    one = begun()
    one.save("here")
    assert future(one, act, topics) == never_stopped
    one.load("here")
    assert future(one, act, topics) == never_stopped  # later in the same simulation
    for robot in one.robots:
        one.delete(robot.name)
    one.step(30)
    one.load("here")
    assert future(one, act, topics) == never_stopped  # with robots that were made again
    file = str(tmp_path / "here.snapshot")
    snapshot_files.write(one.snapshots.get("here"), file, one.host)
    other = made(engine)
    restore(other, snapshot_files.read(file, other.host))
    assert future(other, act, topics) == never_stopped  # in another simulation


@pytest.mark.parametrize("engine", ENGINES)
@given(seed=st.integers(0, 10_000), until=st.integers(0, 1500), count=st.integers(1, 800))
@settings(max_examples=6, deadline=None)
def test_any_moment_has_the_same_future(engine: str, seed: int, until: int, count: int) -> None:
    simulation, (build, act), dice = made(engine), SCENES["efforts"], Random(seed)
    build(simulation)
    while simulation.cycles < until:
        act(simulation, dice)
        simulation.step(dice.choice((1, 77, 300)))
    simulation.save("here")
    simulation.step(count)
    first = everything(simulation)
    act(simulation, dice)
    simulation.step(33)
    simulation.load("here")
    simulation.step(count)
    assert everything(simulation) == first


# -- faults ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 60))
@settings(max_examples=6, deadline=None)
def test_any_moment_among_random_faults_robots_and_commands_has_the_same_future(
    engine: str, seed: int, count: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    def begun() -> Simulation:
        simulation, dice = made(engine), Random(seed)
        simulation.heard = Heard(simulation)  # type: ignore[attr-defined]
        at_random(seed, things=0)(simulation)
        for _ in range(count):
            happen(simulation, dice, is_kept=True)
            simulation.step(dice.choice((1, 3, 17, 60)))
        return simulation

    def act(simulation: Simulation, dice: Random) -> None:
        happen(simulation, dice, is_kept=True)

    one = begun()
    topics = [topic for topic in TOPICS if one.graph.topics.exists(topic)]
    never_stopped = future(one, act, topics)
    one = begun()
    one.save("here")
    assert future(one, act, topics) == never_stopped
    one.load("here")
    assert future(one, act, topics) == never_stopped
    file = str(tmp_path_factory.mktemp("random") / "here.snapshot")
    snapshot_files.write(one.snapshots.get("here"), file, one.host)
    other = made(engine)
    other.heard = Heard(other)  # type: ignore[attr-defined]
    restore(other, snapshot_files.read(file, other.host))
    assert future(other, act, topics) == never_stopped


def test_faults_are_those_of_the_snapshot() -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), usual())
    simulation.step(10)
    simulation.save("without")
    model = simulation.world.model

    def constants() -> list[bytes]:
        return [getattr(model, name).tobytes() for name in dir(model) if name.startswith(("body_", "dof_"))]

    before = constants()
    simulation.faults.add("a/part2", "payload", 0.1, mass=3.0, name="load")
    simulation.faults.add("a/joint1", "joint-stuck", name="jam")
    simulation.faults.add("a/joint1", "sensor-bias", 0.015, bias=0.1, name="wrong")
    simulation.step(200)
    simulation.save("with_faults")
    changed = constants()
    simulation.load("without")
    assert simulation.faults.messages() == []
    assert constants() == before
    simulation.faults.add("a/joint2", "joint-stuck")
    simulation.step(10)
    simulation.load("with_faults")
    assert [(fault["name"], fault["count"]) for fault in simulation.faults.messages()] == [
        ("load", 111), ("jam", 200), ("wrong", 196),
    ]  # fmt: skip
    assert constants() == changed
    simulation.faults.remove()
    assert constants() == before


# -- other robots and controllers than then ----------------------------------------------------------------------------


def test_robots_controllers_and_parameters_are_as_they_were() -> None:
    simulation = made("plain")
    add(
        simulation, "a", arm(), {"one": {"type": EFFORT, "joint": "joint1"}, "two": {"type": EFFORT, "joint": "joint2"}}
    )
    add(simulation, "b", arm(), {"one": {"type": EFFORT, "joint": "joint1"}})
    simulation.publish("/a/two/command", {"data": 1.0})
    simulation.parameters.set("/mine", {"x": 1, "y": [1, 2.0]})
    simulation.set_timestep(0.002)
    simulation.step(100)
    simulation.save("here")
    derived = simulation.parameters.derived()
    assert "/b/robot_state_publisher/tf_prefix" in derived
    simulation.step(50)
    then = everything(simulation)

    simulation.parameters.set("/b/robot_state_publisher/tf_prefix", "b")
    simulation.set_timestep(0.001)
    simulation.world.set_gravity((0.0, 0.0, 0.0))
    simulation.delete("a")
    add(simulation, "c", arm(), {"one": {"type": EFFORT, "joint": "joint3"}})
    simulation.parameters.set("/mine", {"x": 1.0})
    manager = simulation.robots.get("b").manager
    manager.request_switch([], ["one"], 2)
    simulation.step(1)
    assert manager.unload("one")
    simulation.load("here")
    assert simulation.robots.names() == ["a", "b"]
    simulation.step(50)
    assert everything(simulation) == then
    assert simulation.parameters.derived() == derived
    assert not [topic for topic in simulation.graph.topics.names() if topic.startswith("/c/")]
    for name in ("a", "b"):
        simulation.delete(name)
    assert not simulation.parameters.has("/a/robot_description")


def test_what_does_not_fit_changes_nothing() -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"own": {"type": "tests/HookedKeeper", "joint": "joint1"}})
    simulation.save("here")
    simulation.step(50)
    before = everything(simulation)
    HookedKeeper.refusals.append("not today")
    with pytest.raises(Refused, match="not today"):
        simulation.load("here")
    assert everything(simulation) == before
    with pytest.raises(UnknownName, match="no snapshot 'there'"):
        simulation.load("there")
    with pytest.raises(BadName):
        simulation.save("no name")
    with pytest.raises(Refused, match="with ground"):
        restore(Simulation(ground=False), simulation.snapshots.get("here"))


# -- goals, waits and switches -----------------------------------------------------------------------------------------


def test_goals_go_on_as_they_were_and_those_sent_since_end() -> None:
    simulation, (build, _) = made("plain"), following("position")
    build(simulation)
    results: list[tuple[str, int, str]] = []

    def take(message: dict[str, Any]) -> None:
        status = message["status"]
        results.append((status["goal_id"]["id"], status["status"], status["text"]))

    simulation.subscribe("/a/arm/follow_joint_trajectory/result", take)

    def send(name: str, seconds: int) -> None:
        point = {"positions": [0.3] * 3, "velocities": [0.0] * 3, "time_from_start": {"secs": seconds}}
        goal = {"trajectory": {"joint_names": JOINTS, "points": [point]}}
        simulation.publish("/a/arm/follow_joint_trajectory/goal", {"goal_id": {"id": name}, "goal": goal})

    send("first", 1)
    simulation.step(500)
    simulation.save("on the way".replace(" ", "_"))
    simulation.step(1000)
    assert [result[:2] for result in results] == [("first", 3)]
    send("second", 5)
    simulation.step(500)
    simulation.load("on_the_way")
    assert results[1:] == [("second", 2, RESTORED)]
    simulation.step(1000)
    assert [result[:2] for result in results[2:]] == [("first", 3)]


def test_sleeps_and_waits_keep_what_is_left_of_them() -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"states": {"type": STATES, "publish_rate": 100}})
    simulation.save("beginning")
    simulation.step(1000)
    sleep = simulation.graph.services.call("/slidectl/sleep", {"duration": 0.5})
    request = {"topic": "/a/joint_states", "field": "position[0]", "condition": "above", "value": "9.0", "within": 0.5}
    wait = simulation.graph.services.call("/slidectl/wait", request)
    simulation.step(300)
    simulation.load("beginning")
    simulation.step(199)
    assert not sleep.done
    assert not wait.done
    simulation.step(1)
    assert sleep.result()["time"] == 0.2
    assert not wait.result()["success"]


def test_while_a_switch_is_under_way_nothing_is_saved_or_loaded() -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"one": {"type": EFFORT, "joint": "joint1"}})
    simulation.save("before")
    simulation.driven = True
    request = {"stop_controllers": ["one"], "strictness": 2}
    simulation.graph.services.call("/a/controller_manager/switch_controller", request)
    for act in (simulation.save, simulation.load):
        with pytest.raises(Refused, match="a switch of controllers of 'a' is under way"):
            act("before")
    simulation.step(1)
    simulation.load("before")
    assert [one["state"] for one in simulation.robots.get("a").manager.list()] == ["running"]


def test_a_world_that_diverged_goes_on_from_its_snapshot() -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"one": {"type": EFFORT, "joint": "joint1"}})
    simulation.step(10)
    simulation.save("sound")
    simulation.step(300)
    then = everything(simulation)
    simulation.world.data.qvel[:] = 1e11
    with pytest.raises(Diverged):
        simulation.step(300)
    with pytest.raises(Refused, match="cannot go on"):
        simulation.save("broken")
    simulation.load("sound")
    simulation.step(300)
    assert everything(simulation) == then


# -- classes of users --------------------------------------------------------------------------------------------------


class Phase(Enum):
    OUT = 1
    BACK = 2


class Target(NamedTuple):
    position: float
    phase: Phase


@dataclass
class Step:
    targets: list[Target]


@controller("tests/Keeper")
class Keeper(Controller[EffortJointInterface]):
    """Has state of many kinds."""

    interface_type = EffortJointInterface

    def init(self, interface: EffortJointInterface, node: NodeHandle) -> None:
        self.node = node
        self.joint = interface.get_handle(node.get_param("joint"))
        self.dice = random.Random(3)
        self.noise = np.random.default_rng(4)
        self.past: deque[float] = deque(maxlen=3)
        self.sums = np.zeros(2)
        self.seen = {"count": 0}
        self.same = self.seen
        self.act = self.go_out
        self.step: Step | None = None
        self.told = node.advertise("told", "std_msgs/Float64", latch=True)
        node.call_every(7_000_000, self.tick)

    def tick(self) -> None:
        self.seen["count"] += 1

    def go_out(self) -> float:
        if self.joint.position > 0.02:
            self.act = self.go_back
            self.late = 5
        return 2.0

    def go_back(self) -> float:
        if self.joint.position < -0.02:
            self.act = self.go_out
        return -2.0

    def update(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002
        self.past.append(self.dice.gauss(0.0, 1.0) + float(self.noise.normal()))
        self.sums += self.past[0]
        self.same["count"] += 1
        self.step = Step([Target(self.joint.position, Phase.OUT if self.act == self.go_out else Phase.BACK)])
        self.joint.command = self.act() + sum(self.past) + 1e-3 * float(self.sums[0]) + 1e-3 * self.seen["count"]


@controller("tests/HookedKeeper")
class HookedKeeper(Keeper):
    """Says itself what its state is."""

    refusals: ClassVar[list[str]] = []

    def init(self, interface: EffortJointInterface, node: NodeHandle) -> None:
        super().init(interface, node)
        self.lock = threading.Lock()

    def save_state(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "lock"}

    def load_state(self, state: dict[str, Any]) -> None:
        if self.refusals:
            raise Refused(self.refusals.pop())
        vars(self).update(state)


@pytest.mark.parametrize("kind", ["tests/Keeper", "tests/HookedKeeper"])
def test_a_controller_of_a_user_goes_on_with_all_that_its_attributes_hold(kind: str, tmp_path: Path) -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"own": {"type": kind, "joint": "joint1"}})
    simulation.step(123)
    file = str(tmp_path / "here.snapshot")
    simulation.call("/slidectl/save", {"name": "here", "file": file})
    simulation.step(400)
    then = everything(simulation)
    simulation.load("here")
    simulation.step(400)
    assert everything(simulation) == then
    other = made("plain")
    other.call("/slidectl/load", {"file": file})
    keeper: Any = other.robots.get("a").manager.get("own")
    assert keeper.same is keeper.seen
    other.step(400)
    assert everything(other) == then


class SlowMotors(MujocoRobotHW):
    """Efforts follow the commands with a delay."""

    def init(self, node: NodeHandle) -> None:
        self.node = node
        self.efforts: dict[str, float] = {}

    def write(self, time_ns: int, period_s: float) -> None:
        super().write(time_ns, period_s)
        before = self.efforts.get("joint1", 0.0)
        self.efforts["joint1"] = before + 0.05 * (self.joint_effort("joint1") - before)
        self.set_joint_effort("joint1", self.efforts["joint1"])


def test_hardware_of_a_user_goes_on_with_its_attributes() -> None:
    xml = arm(plugin="<robotSimType>tests/SlowMotors</robotSimType>")
    simulation = made("plain")
    simulation.types.hardware.add_all(sys.modules[__name__], "tests/")
    add(simulation, "a", xml, {"one": {"type": POSITION, "joint": "joint1", "pid": GAINS}})
    simulation.publish("/a/one/command", {"data": 1.0})
    simulation.step(100)
    simulation.save("here")
    simulation.step(200)
    then = everything(simulation)
    for forget in (lambda: simulation.step(100), lambda: simulation.delete("a")):
        forget()
        simulation.load("here")
        simulation.step(200)
        assert everything(simulation) == then


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (threading.Lock(), "a _thread.lock"),
        ([1, {"deep": open(__file__)}], "a _io.TextIOWrapper"),  # noqa: SIM115
        (np.array([object()]), "an array of object"),
        ((lambda held: lambda: held)(1), "a function that holds values of its own"),
    ],
)
def test_what_no_snapshot_holds_is_named(value: Any, what: str) -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"own": {"type": "tests/Keeper", "joint": "joint1"}})
    simulation.robots.get("a").manager.get("own").thing = value  # type: ignore[union-attr]
    with pytest.raises(Refused, match=rf"controllers.own.thing.*: it is {what}") as refusal:
        simulation.save("here")
    assert refusal.value.hint is not None
    assert "save_state" in refusal.value.hint


def test_a_present_state_that_cannot_be_kept_refuses_the_load_before_anything_changes() -> None:
    simulation = made("plain")
    simulation.save("empty")
    add(simulation, "a", arm(), {"own": {"type": "tests/Keeper", "joint": "joint1"}})
    simulation.robots.get("a").manager.get("own").thing = threading.Lock()  # type: ignore[union-attr]
    simulation.step(50)
    before = everything(simulation)
    with pytest.raises(Refused, match=r"after a failure.*controllers.own.thing"):
        simulation.load("empty")
    assert everything(simulation) == before


def test_joints_are_keys_and_elements_of_state(tmp_path: Path) -> None:
    simulation, file = made("plain"), str(tmp_path / "here.snapshot")
    add(simulation, "a", arm(), {"own": {"type": "tests/Keeper", "joint": "joint1"}})
    keeper: Any = simulation.robots.get("a").manager.get("own")
    keeper.phases = {keeper.joint: 1.0, Phase.BACK: 2.0}
    keeper.held = {keeper.joint}
    simulation.call("/slidectl/save", {"name": "here", "file": file})
    simulation.delete("a")
    for load in (lambda: simulation.load("here"), lambda: simulation.call("/slidectl/load", {"file": file})):
        load()
        keeper = simulation.robots.get("a").manager.get("own")
        assert keeper.phases == {keeper.joint: 1.0, Phase.BACK: 2.0}
        assert keeper.held == {keeper.joint}
        simulation.delete("a")


def test_a_topic_without_a_latched_message_then_tells_nothing() -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), {"own": {"type": "tests/Keeper", "joint": "joint1"}})
    simulation.save("here")
    simulation.robots.get("a").manager.get("own").told.publish({"data": 1.0})  # type: ignore[union-attr]
    heard: list[Any] = []
    simulation.subscribe("/a/own/told", heard.append)
    simulation.load("here")
    assert {} not in heard


def test_snapshots_are_bounded_and_a_name_may_be_saved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = made("plain")
    monkeypatch.setattr(type(simulation.snapshots), "MOST", 2)
    for name in ("one", "two", "one"):
        simulation.save(name)
    with pytest.raises(Refused, match="there are 2 snapshots already, the maximum\nslidectl sim delete"):
        simulation.save("three")


# -- files -------------------------------------------------------------------------------------------------------------


def test_a_file_that_is_cut_off_or_of_another_version_is_refused_with_the_reason(tmp_path: Path) -> None:
    simulation = made("plain")
    add(simulation, "a", arm(), usual())
    simulation.step(10)
    good = tmp_path / "good.snapshot"
    simulation.call("/slidectl/save", {"name": "good", "file": str(good)})
    content, before = good.read_bytes(), everything(simulation)

    def refused(content: bytes) -> str:
        bad = tmp_path / "bad.snapshot"
        bad.write_bytes(content)
        with pytest.raises(SlidectlError) as refusal:
            simulation.call("/slidectl/load", {"file": str(bad)})
        assert everything(simulation) == before
        return str(refusal.value)

    for size in range(0, len(content), 97):
        text = refused(content[:size])
        assert "cut off" in text or "not a snapshot of slidectl" in text
    assert "not a snapshot of slidectl" in refused(b"PK" + content)
    assert "is damaged" in refused(content[:-1] + b"x")
    version = f'"slidectl": "{slidectl.__version__}"'.encode()
    assert "saved with slidectl 9.9, and this is" in refused(content.replace(version, b'"slidectl": "9.9"'))
    with pytest.raises(BadFile, match="cannot be read"):
        simulation.call("/slidectl/load", {"file": str(tmp_path / "none")})


def edited(source: Path, target: Path, edit: Callable[[dict[str, Any]], None]) -> str:
    """The snapshot of a file with other content, written as a whole and right one."""
    magic, first, content = source.read_bytes().split(b"\n", 2)
    values = json.loads(zlib.decompress(content))
    edit(values)
    content = zlib.compress(json.dumps(values).encode())
    about = json.loads(first) | {"size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    target.write_bytes(b"\n".join((magic, json.dumps(about).encode(), content)))
    return str(target)


def of_class(kind: str, **attributes: Any) -> Callable[[dict[str, Any]], None]:
    """Objects of the class have these attributes."""
    return lambda values: [entry[1].update(attributes) for entry in values["entries"] if entry[0] == kind] and None


def with_late_timers(values: dict[str, Any]) -> None:
    timers = [entry[1]["of"] for entry in values["entries"] if entry[0] == "Timer"]
    assert timers, "no timer is set"
    for timer in timers:
        timer[1] = "late"


def lacking(kind: str) -> Callable[[dict[str, Any]], None]:
    """Nothing refers to the objects of the class: later snapshots have them, and nobody else can make them."""

    def edit(values: dict[str, Any]) -> None:
        numbers = {number for number, entry in enumerate(values["entries"]) if entry[0] == kind}
        assert numbers, f"there is no {kind}"
        values["entries"] = without(values["entries"], numbers)

    return edit


def without(value: Any, numbers: set[int]) -> Any:
    """The saved value with None for these objects."""
    if isinstance(value, list):
        return [without(one, numbers) for one in value]
    if not isinstance(value, dict):
        return value
    if value.get("~") == "Ref" and value["of"][0] in numbers:
        return None
    return {key: without(one, numbers) for key, one in value.items()}


def without_tolerances(values: dict[str, Any]) -> None:
    """One of a controller's tolerances is a number; what else refers to them stays."""
    lists = [entry[1] for entry in values["entries"] if entry[0] == "list"]
    found = [rows for rows in lists if rows and all(isinstance(row, dict) and len(row["of"]) == 5 for row in rows)]
    found[0][0] = 2**64


def chain(values: dict[str, Any]) -> None:
    first = len(values["entries"])
    values["entries"] += [["list", [{"~": "Ref", "of": [first + k + 1]}]] for k in range(5000)] + [["list", []]]
    values["state"] = {"~": "Ref", "of": [first]}


@pytest.mark.parametrize(
    "edit",
    [
        lambda values: values.update(time_ns=math.nan),
        lambda values: values.update(time_ns=1.5),
        lambda values: values.update(time_ns=-5),
        lambda values: values.update(time_ns="abc"),
        lambda values: values.update(cycles="x"),
        lambda values: values.update(step_ns=0),
        lambda values: values.update(gravity=[0.0, 0.0]),
        of_class("ControlCycle", period_ns="x"),
        of_class("ControlCycle", run=3),
        of_class("ForwardEffortController", update=3),
        of_class("ForwardEffortController", set_point="x"),
        of_class("SidesOdometry", window=10**9),
        of_class("SidesOdometry", window=10**30),
        of_class("Motion", index=-1),
        of_class("Motion", last=10**9),
        lambda values: values["world"]["data"]["xmat"]["of"].__setitem__(0, "0 0 0"),
        lambda values: values["world"]["data"]["xmat"]["of"].__setitem__(0, "O"),
        lambda values: values["world"].update(time=10**400),
        chain,
        with_late_timers,
        without_tolerances,
        lacking("Pid"),
        lacking("Faults"),
        lambda values: [entry[1].append("x") for entry in values["entries"] if entry[0] == "list" and not entry[1]],
    ],
)
def test_a_file_whose_values_no_simulation_has_is_refused_and_changes_nothing(
    edit: Callable[[dict[str, Any]], None], tmp_path: Path
) -> None:
    simulation = made("plain")
    following("effort")[0](simulation)
    add(simulation, "z", arm(), {"effort": {"type": EFFORT, "joint": "joint1"}})
    shipped_model("cart", {}, drive="controller")[0](simulation)
    simulation.step(10)
    good = tmp_path / "good.snapshot"
    simulation.call("/slidectl/save", {"name": "good", "file": str(good)})
    before = everything(simulation)
    slept = simulation.graph.timers.next_ns
    with pytest.raises(SlidectlError):
        simulation.call("/slidectl/load", {"file": edited(good, tmp_path / "bad.snapshot", edit)})
    assert everything(simulation) == before
    assert simulation.graph.timers.next_ns == slept
    simulation.step(20)
    simulation.call("/slidectl/load", {"file": str(good)})


def test_what_is_no_regular_file_is_not_written_over_and_a_link_stays(tmp_path: Path) -> None:
    simulation = made("plain")
    pipe, link, file = tmp_path / "pipe", tmp_path / "link", tmp_path / "file"
    os.mkfifo(pipe)
    link.symlink_to(file)
    for wrong in (pipe, tmp_path):
        with pytest.raises(Refused, match="it is not a regular file"):
            simulation.call("/slidectl/save", {"name": "here", "file": str(wrong)})
    assert pipe.is_fifo()
    simulation.call("/slidectl/save", {"name": "here", "file": str(link)})
    assert link.is_symlink()
    simulation.call("/slidectl/load", {"file": str(file)})


def test_a_pipe_is_no_snapshot_and_holds_up_nobody(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(BadFile, match="is a pipe, and only regular files are read, of at most 256 MiB"):
        made("plain").call("/slidectl/load", {"file": str(pipe)})


def test_a_file_runs_no_code_that_it_names(tmp_path: Path) -> None:
    source = tmp_path / "stranger.py"
    source.write_text(
        "from slidectl.control import Controller, EffortJointInterface\n"
        "class Stranger(Controller):\n"
        "    interface_type = EffortJointInterface\n"
        "    def update(self, time_ns, period_s): pass\n"
    )
    simulation, file = made("plain"), str(tmp_path / "here.snapshot")
    simulation.spawn(arm(), "a")
    request = {"robot": "a", "name": "own", "file": str(source), "class_name": ""}
    assert simulation.call("/slidectl/load_controller_file", request)["ok"]
    simulation.call("/slidectl/save", {"name": "here", "file": file})
    script = f"from slidectl import Simulation; Simulation().call('/slidectl/load', {{'file': {file!r}}})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "controller 'own' of 'a' is a stranger/Stranger, which is unknown here" in done.stderr
    assert "slidectl daemon start --import FILE.py" in done.stderr
