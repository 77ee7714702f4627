"""Joints of simulated hardware by all their interfaces, with the controllers that are on them, and their limits."""

from __future__ import annotations

from typing import Any

import pytest
from engine_scenes import add, arm, play

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

FOLLOWERS = {
    "Position": "position_controllers",
    "PosVel": "pos_vel_controllers",
    "PosVelAcc": "pos_vel_acc_controllers",
}


def follower(interface: str) -> dict[str, Any]:
    """A trajectory controller on the joints of `arm`."""
    kind = f"{FOLLOWERS[interface]}/JointTrajectoryController"
    return {"type": kind, "joints": ["joint1", "joint2", "joint3"], "constraints": {"goal_time": 0.1}}


def goal(seconds: int = 1) -> dict[str, Any]:
    """From rest to rest, by a quintic polynomial."""
    zeros = [0.0, 0.0, 0.0]
    ends = {"positions": [0.8, -0.5, 2.0], "velocities": zeros, "accelerations": zeros}
    points = [ends | {"time_from_start": {"secs": seconds, "nsecs": 0}}]
    return {"goal": {"trajectory": {"joint_names": ["joint1", "joint2", "joint3"], "points": points}}}


def largest_error(interface: str, **gains: float) -> tuple[float, list[int]]:
    """The largest error of a position on the way, and the statuses of the goals that ended."""
    simulation = Simulation(ground=False, engine="plain")
    for joint in ("joint1", "joint2", "joint3") if gains else ():
        simulation.parameters.set(f"/arm/gazebo_ros_control/pid_gains/{joint}", gains)
    add(simulation, "arm", arm(interface=interface), {"follow": follower(interface)})
    simulation.step(5)
    ended: list[int] = []
    topic = "/arm/follow/follow_joint_trajectory"
    take = lambda message: ended.append(message["status"]["status"])  # noqa: E731
    simulation.graph.topics.subscribe(f"{topic}/result", None, "/client", take)
    simulation.publish(f"{topic}/goal", goal())
    controller: Any = simulation.robots.get("arm").manager.get("follow")
    largest = 0.0
    for _ in range(1200):
        simulation.step(1)
        largest = max(largest, *(abs(motion.position_error) for motion in controller.motions))
    return largest, ended


def test_a_trajectory_on_positions_with_velocities_and_accelerations_is_followed_without_a_lag() -> None:
    """What a position alone is late by one cycle, 2 rad/s · 1 ms and more, is led by the velocity, and its end by the
    acceleration."""
    lag, ended = largest_error("Position")
    assert lag > 2e-3
    assert ended == [3]
    with_velocity, ended = largest_error("PosVel")
    assert with_velocity < 1e-5
    assert ended == [3]
    with_acceleration, ended = largest_error("PosVelAcc")
    assert with_acceleration < 1e-7
    assert ended == [3]


def test_with_gains_the_error_of_the_velocity_is_the_derivative_of_the_pid() -> None:
    gains = {"p": 400.0, "d": 40.0}
    by_position, _ = largest_error("Position", **gains)
    by_both, _ = largest_error("PosVel", **gains)
    assert by_both < by_position


@pytest.mark.parametrize("interface", ["PosVel", "PosVelAcc"])
def test_limits_bound_the_position_and_the_velocity_of_such_a_command(interface: str) -> None:
    """2.5 rad is the limit, and 4 rad/s; nothing goes beyond either, also while the velocity leads."""
    simulation = Simulation(ground=False, engine="plain")
    simulation.spawn(arm(("revolute",), interface=interface), "arm")
    [joint] = simulation.robots.get("arm").hardware.driven()
    for _ in range(1000):
        joint.handle.command, joint.handle.command_velocity = 9.0, 50.0
        simulation.step(1)
        position, velocity, _ = simulation.world.joint_state("arm", "joint1")
        assert position <= 2.5 + 1e-9
        assert abs(velocity) <= 4.0 * 1.01 + 1e-9
    assert position == pytest.approx(2.5)


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_such_a_robot_runs_in_the_interpreter_beside_compiled_ones_with_the_same_bits() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(interface="PosVelAcc"), {"follow": follower("PosVelAcc")})
        effort = {"type": "effort_controllers/JointEffortController", "joint": "joint1"}
        add(simulation, "b", arm(), {"push": effort})
        simulation.step(5)
        simulation.publish("/a/follow/follow_joint_trajectory/goal", goal())
        simulation.publish("/b/push/command", {"data": 0.7})
        simulation.step(700)

    assert play(scene, "plain")[0] == play(scene, "compiled")[0]


def test_soft_limits_of_parameters_go_before_those_of_the_model() -> None:
    """The velocity falls with the distance to 0.5: after 3 s with k_position 5 the joint is there, and not beyond."""
    simulation = Simulation(ground=False, engine="plain")
    limits = {"has_soft_limits": True, "soft_lower_limit": -0.5, "soft_upper_limit": 0.5}
    simulation.parameters.set("/arm/joint_limits/joint1", limits | {"k_position": 5.0, "k_velocity": 10.0})
    drive = {"type": "velocity_controllers/JointVelocityController", "joint": "joint1"}
    add(simulation, "arm", arm(("revolute",), safety=True, interface="Velocity"), {"drive": drive})
    simulation.step(2)
    simulation.publish("/arm/drive/command", {"data": 3.0})
    simulation.step(3000)
    assert simulation.world.joint_state("arm", "joint1")[0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("interface", FOLLOWERS)
def test_a_joint_that_is_commanded_by_its_position_stays_where_it_is_put(interface: str) -> None:
    simulation = Simulation(ground=False, engine="plain")
    simulation.spawn(arm(interface=interface), "arm")
    put = {"model_name": "arm", "joint_names": ["joint1", "joint2"], "joint_positions": [0.7, -0.5]}
    assert simulation.call("/gazebo/set_model_configuration", put)["success"]
    simulation.step(100)
    there = [simulation.world.joint_state("arm", joint)[0] for joint in ("joint1", "joint2", "joint3")]
    assert there == pytest.approx([0.7, -0.5, 0.0], abs=1e-6)
