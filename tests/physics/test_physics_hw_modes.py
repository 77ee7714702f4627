"""Position and velocity joints: by motors, and by PID where gains are given."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from physics_hardware import Bench
from physics_robots import POSITION, VELOCITY, arm, at, block, driven, one_joint, state_of

from slidectl.control.pid import Pid
from slidectl.description.robot import Limit, Surface
from slidectl.physics import World

LIMIT = Limit(-2.0, 2.0, velocity=1.0, effort=10.0)


def gains(**values: float) -> dict[str, Any]:
    """The parameters that give joint1 a PID."""
    return {"gazebo_ros_control": {"pid_gains": {"joint1": values}}}


def falling(bench: Bench) -> Bench:
    """The same bench with weight on it."""
    bench.world.set_gravity((0.0, 0.0, -9.8))
    return bench


def test_a_velocity_joint_has_its_velocity_after_one_step(bench: Bench) -> None:
    falling(bench).take(driven(one_joint(limit=Limit(-2.0, 2.0, 1.0, 1000.0)), VELOCITY))
    bench.cycle(joint1=0.4)
    assert bench.handle().velocity == pytest.approx(0.4, abs=1e-12)
    assert bench.handle().effort == pytest.approx(400.0 + 9.8)


def test_a_velocity_joint_uses_no_more_than_its_effort_limit(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY))
    bench.cycle(joint1=0.4)
    assert bench.handle().velocity == pytest.approx(10.0 * 0.001)
    bench.cycle(50, joint1=0.4)
    assert bench.handle().velocity == pytest.approx(0.4, abs=1e-12)


def test_a_velocity_joint_is_held_at_rest_without_command(bench: Bench) -> None:
    falling(bench).take(driven(one_joint(limit=LIMIT), VELOCITY))
    bench.cycle(1000)
    assert bench.handle().position == pytest.approx(0.0, abs=1e-9)


def test_velocity_commands_are_saturated(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY))
    bench.cycle(300, joint1=5.0)
    assert bench.handle().velocity == pytest.approx(1.0)


def test_all_joints_of_an_arm_have_their_velocities_at_once(bench: Bench) -> None:
    falling(bench).take(driven(arm(4), VELOCITY))
    bench.cycle(300, joint0=0.1, joint1=-0.2, joint2=0.3, joint3=-0.4)
    for joint, velocity in (("joint0", 0.1), ("joint1", -0.2), ("joint2", 0.3), ("joint3", -0.4)):
        assert bench.handle(joint).velocity == pytest.approx(velocity, abs=1e-9)


def test_a_position_joint_is_where_it_was_told_after_one_step(bench: Bench) -> None:
    falling(bench).take(driven(one_joint("continuous", axis=(0.0, 1.0, 0.0)), POSITION))
    bench.cycle(joint1=1.0)
    assert bench.handle().position == pytest.approx(1.0, abs=1e-12)
    bench.cycle(500, joint1=1.0)
    assert bench.handle().position == pytest.approx(1.0, abs=1e-12)


def test_a_position_joint_moves_no_faster_than_its_velocity_limit(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), POSITION))
    bench.cycle(250, joint1=1.0)
    assert bench.handle().position == pytest.approx(0.25, abs=1e-9)
    assert bench.handle().velocity == pytest.approx(1.0, abs=1e-9)
    bench.cycle(1000, joint1=1.0)
    assert bench.handle().position == pytest.approx(1.0, abs=1e-9)
    assert bench.handle().velocity == pytest.approx(0.0, abs=1e-9)


def test_a_position_joint_is_driven_to_zero_before_any_command_comes(bench: Bench) -> None:
    bench.take(driven(one_joint("continuous"), POSITION))
    bench.world.set_joint("robot", "joint1", 0.5)
    bench.cycle()
    assert bench.handle().position == pytest.approx(0.0, abs=1e-9)


def test_a_position_joint_with_a_velocity_limit_takes_one_step_towards_zero_then(bench: Bench) -> None:
    """The limit replaces the command in the handle, and nobody writes it again."""
    bench.take(driven(one_joint(limit=LIMIT), POSITION))
    bench.world.set_joint("robot", "joint1", 0.5)
    bench.cycle(100)
    assert bench.handle().position == pytest.approx(0.499, abs=1e-9)


def test_a_position_joint_heeds_no_load(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), POSITION))
    bench.world.add_wrench("robot", "cart", (0.0, 0.0, 1e4), (0.0, 0.0, 0.0))
    bench.cycle(100, joint1=0.0)
    assert bench.handle().position == pytest.approx(0.0, abs=1e-9)


def test_a_position_joint_pushes_a_block_away() -> None:
    bench = Bench()
    robot = one_joint(axis=(1.0, 0.0, 0.0), limit=LIMIT)
    cart = replace(robot.links["cart"], collisions=block((0.1, 0.1, 0.1)).links["base"].collisions)
    bench.take(driven(replace(robot, links={**robot.links, "cart": cart}), POSITION))
    bench.world.attach(block((0.1, 0.1, 0.1), 5.0, Surface(turn_gravity_off=True)), "block", at(0.2, 0.0, 0.0))
    bench.cycle(1000, joint1=0.5)
    assert bench.handle().position == pytest.approx(0.5, abs=1e-4)
    assert bench.world.link_pose("block", "base")[0][0] > 0.55


def test_an_emergency_stop_holds_positions_and_brakes_velocities(bench: Bench) -> None:
    hardware = bench.take(driven(arm(2, reach=2.0), {"joint0": POSITION, "joint1": VELOCITY}))
    bench.cycle(100, joint0=1.0, joint1=0.5)
    held = bench.handle("joint0").position
    assert held > 0.01
    hardware.estop = True
    bench.cycle(100, joint0=1.0, joint1=0.5)
    assert bench.handle("joint0").position == pytest.approx(held, abs=1e-6)
    assert bench.handle("joint1").velocity == pytest.approx(0.0, abs=1e-6)
    hardware.estop = False
    bench.cycle(100, joint0=1.0, joint1=0.5)
    assert bench.handle("joint0").position > held + 0.01
    assert bench.handle("joint1").velocity == pytest.approx(0.5)


def test_motors_go_with_their_robot_and_with_a_reset(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY))
    bench.cycle(10, joint1=0.5)
    bench.world.reset()
    for _ in range(10):
        bench.world.step()
    assert bench.world.joint_state("robot", "joint1") == (0.0, 0.0, 0.0)
    bench.cycle(10, joint1=0.5)
    bench.world.detach("robot")
    assert bench.world.applied_forces.is_empty


def test_a_joint_without_gains_says_that_it_has_none(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY))
    expected = "joint 'joint1' is driven without PID: no gains at /robot/gazebo_ros_control/pid_gains/joint1"
    assert ("info", expected) in bench.log


def test_gains_that_are_no_numbers_are_an_error_on_the_log_and_none_are_used(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY), **gains(p="much"))  # type: ignore[arg-type]
    assert any(severity == "error" and "must be a number" in text for severity, text in bench.log)
    bench.cycle(100, joint1=0.5)
    assert bench.handle().velocity == pytest.approx(0.5)


def test_a_position_pid_gives_the_effort_of_its_law_within_the_limit(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), POSITION), **gains(p=20.0, d=0.5))
    law = Pid(p=20.0, d=0.5)
    for _ in range(200):
        bench.hardware.read(0, 0.001)
        position = bench.handle().position
        bench.handle().command = 0.3
        bench.hardware.write(0, 0.001)
        expected = law.compute_command(bench.handle().command - position, 0.001)
        bench.hardware.read(0, 0.001)
        assert bench.handle().effort == max(-10.0, min(10.0, expected))
        bench.world.step()


def test_a_position_pid_turns_the_short_way_round_when_the_joint_is_continuous(bench: Bench) -> None:
    bench.take(driven(one_joint("continuous"), POSITION), **gains(p=1.0))
    bench.cycle(joint1=-2.5)
    assert bench.handle().effort == pytest.approx(-2.5)
    bench.cycle(joint1=4.0)
    assert bench.handle().effort == pytest.approx(4.0 - 6.283185307179586, abs=1e-2)


def test_a_position_pid_heeds_the_limits_of_a_revolute_joint(bench: Bench) -> None:
    limit = Limit(-2.9, 2.9, velocity=1e6, effort=1e6)
    bench.take(driven(one_joint("revolute", limit=limit), POSITION), **gains(p=1.0))
    bench.world.set_joint("robot", "joint1", -1.5)
    bench.cycle(joint1=2.0)
    assert bench.handle().effort == pytest.approx(3.5, abs=0.1), "not the short way, through the limit"


def test_a_velocity_pid_gives_the_effort_of_its_law_and_brakes_when_stopped(bench: Bench) -> None:
    hardware = bench.take(driven(one_joint(limit=LIMIT), VELOCITY), **gains(p=5.0))
    bench.cycle(joint1=0.5)
    assert bench.handle().effort == 2.5
    velocity = bench.handle().velocity
    hardware.estop = True
    bench.cycle(joint1=0.5)
    assert bench.handle().effort == -5.0 * velocity


def test_gains_can_be_changed_while_the_robot_runs(bench: Bench) -> None:
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY), **gains(p=5.0))
    bench.cycle(joint1=0.5)
    bench.world.set_joint("robot", "joint1", 0.0, velocity=0.0)
    bench.graph.parameters.set("/robot/gazebo_ros_control/pid_gains/joint1/p", 2.0)
    bench.cycle(joint1=0.5)
    assert bench.handle().effort == 1.0


def test_a_reset_forgets_what_a_pid_has_gathered(bench: Bench) -> None:
    hardware = bench.take(driven(one_joint(limit=LIMIT), POSITION), **gains(p=1.0, i=50.0, i_clamp=5.0, d=0.1))
    first = []
    for _ in range(2):
        efforts = []
        for _ in range(50):
            bench.cycle(joint1=0.3)
            efforts.append(bench.handle().effort)
        first.append(efforts)
        bench.world.reset()
        hardware.reset()
    assert first[0] == first[1]


def test_one_robot_with_motors_leaves_the_others_to_themselves() -> None:
    bench = Bench()
    bench.world.attach(one_joint(damping=0.3), "other")
    bench.take(driven(one_joint(limit=LIMIT), VELOCITY))
    alone = World(gravity=(0.0, 0.0, 0.0), ground=False)
    alone.attach(one_joint(damping=0.3), "other")
    for world in (bench.world, alone):
        world.set_joint("other", "joint1", 0.0, velocity=1.0)
    bench.cycle(100, joint1=0.5)
    for _ in range(100):
        alone.step()
    assert bench.world.joint_state("other", "joint1") == alone.joint_state("other", "joint1")


def test_what_motors_say_that_they_push_is_what_they_push(bench: Bench) -> None:
    """The same efforts, without motors, move the arm in the same way; some motors are at their limits on the way."""
    bench = falling(bench)
    robot = arm(4, damping=0.0, reach=2.0)
    bench.take(driven(robot, VELOCITY))
    other = World(ground=False)
    other.attach(robot, "robot")
    at_limit = 0
    for cycle in range(400):
        bench.cycle(joint0=1.5, joint1=-1.0, joint2=1.0 if cycle < 200 else -1.5, joint3=0.5)
        efforts = {joint: bench.handle(joint).effort for joint in robot.joints}
        for joint, effort in efforts.items():
            other.data.qfrc_applied[other.robot("robot").joints[joint].dof] = effort
        other.step()
        at_limit += sum(abs(effort) == 10.0 for effort in efforts.values())
    assert at_limit > 20
    for joint in robot.joints:
        assert bench.handle(joint).position == pytest.approx(other.joint_state("robot", joint)[0], abs=1e-7)


@pytest.mark.parametrize(("effort", "velocity"), [(0.5, 0.0), (3.0, 0.4)])
def test_a_motor_must_overcome_the_friction_of_its_joint(bench: Bench, effort: float, velocity: float) -> None:
    limit = Limit(-2.0, 2.0, velocity=1.0, effort=effort)
    bench.take(driven(one_joint(limit=limit, friction=1.0), VELOCITY))
    bench.cycle(1000, joint1=0.4)
    assert bench.handle().velocity == pytest.approx(velocity, abs=1e-3)
    assert bench.handle().effort == pytest.approx(min(effort, 1.0), rel=1e-3)


def test_robots_elsewhere_change_not_one_bit_of_motors_at_their_limits_on_the_ground() -> None:
    def run(crowd: bool) -> bytes:
        bench = Bench()
        bench.world = World()
        robot = arm(3, free=True, reach=1.0, friction=0.3)
        if crowd:
            bench.world.attach(block(), "early", at(5.0, 0.0, 1.0))
        bench.take(driven(robot, VELOCITY))
        for cycle in range(300):
            if crowd and cycle == 100:
                bench.world.attach(arm(4, free=True, friction=0.3), "late", at(9.0, 0.0, 1.0))
            if crowd and cycle == 200:
                bench.world.detach("early")
            bench.cycle(joint0=1.0, joint1=-1.0, joint2=1.0)
        return state_of(bench.world, "robot")

    assert run(crowd=True) == run(crowd=False)
