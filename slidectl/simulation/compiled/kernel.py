"""The compiled cycle: what `Loop` and `ControlCycle` do with objects, done with rows, by the same laws.

`run` is compiled by `compiler.py`. It stops wherever the interpreter has its turn and goes on from there when it is
called again. Nothing here is called by the interpreter.
"""

from __future__ import annotations

from typing import Any

from slidectl.control.angles import unwrapped
from slidectl.control.controllers.forward import hand_on
from slidectl.control.controllers.joint_position import track_position
from slidectl.control.controllers.joint_state import states_are_due
from slidectl.control.controllers.joint_velocity import track_velocity
from slidectl.control.laws import law
from slidectl.control.limit_steps import enforce
from slidectl.control.pid_controller import state_is_due
from slidectl.physics.divergence import HUGE
from slidectl.physics.drives import drive_effort
from slidectl.physics.effort import truncated
from slidectl.simulation.compiled.rows import (
    CHECK_EVERY,
    CONTROLLER_IN_PYTHON,
    DIVERGED,
    DONE,
    FAILED,
    FORWARD,
    JOINT_POSITION,
    JOINT_STATE,
    JOINT_VELOCITY,
    NEW_CYCLE,
    PUBLICATION,
    ROBOT_IN_PYTHON,
    STEP_IN_PYTHON,
)
from slidectl.simulation.cycle import begin_to_write, control_is_due

Table = Any


def physics_step(step: int, model: int, data: int, error_hook: int) -> int:
    """mj_step, with its errors caught: not 0 for one. Machine code; see `guard.py`."""
    raise NotImplementedError


@law
def read(robot: Any, joints: Table, qpos: Any, qvel: Any, forces: Any) -> None:
    """MujocoRobotHW.read."""
    for k in range(robot.first_joint, robot.first_joint + robot.joints):
        joint = joints[k]
        angle_or_length = qpos[joint.qpos]
        joint.position = unwrapped(joint.position, angle_or_length) if joint.turns else angle_or_length
        joint.velocity = qvel[joint.dof]
        joint.effort = forces[joint.dof]


@law
def add_outside_efforts(robot: Any, joints: Table, outside: Any) -> None:
    """The rest of MujocoRobotHW.read, while something pushes from outside."""
    for k in range(robot.first_joint, robot.first_joint + robot.joints):
        joint = joints[k]
        joint.effort += outside[joint.dof]


@law
def write(
    robot: Any, period_s: float, joints: Table, limits: Table, drives: Table, pids: Table, qvel: Any, forces: Any
) -> None:
    """MujocoRobotHW.write."""
    for k in range(robot.first_limit, robot.first_limit + robot.limits):
        enforce(limits[k], joints[limits[k].joint], period_s)
    for k in range(robot.first_joint, robot.first_joint + robot.joints):
        joint = joints[k]
        forces[joint.dof] = 0.0
        if joint.is_pushed:
            forces[joint.dof] = truncated(joint.command, qvel[joint.dof], joint.max_effort, joint.max_velocity)
    for k in range(robot.first_drive, robot.first_drive + robot.drives):
        joint = joints[drives[k].joint]
        effort = drive_effort(drives[k], pids[drives[k].pid], joint, period_s)
        forces[joint.dof] += truncated(effort, qvel[joint.dof], joint.max_effort, joint.max_velocity)


@law
def update(
    kind: int,
    row: int,
    time_ns: int,
    period_s: float,
    joints: Table,
    pids: Table,
    forwards: Table,
    positions: Table,
    velocities: Table,
    states: Table,
) -> int:
    """`update` of one controller. Returns for what the interpreter has its turn, DONE for nothing."""
    speaks = False
    if kind == JOINT_POSITION:
        position = positions[row]
        track_position(position, pids[position.pid], joints[position.joint], period_s)
        speaks = state_is_due(position) and position.wanted
    elif kind == JOINT_STATE:
        speaks = states_are_due(states[row], time_ns) and states[row].wanted
    elif kind == FORWARD:
        hand_on(forwards[row], joints[forwards[row].joint])
    elif kind == JOINT_VELOCITY:
        velocity = velocities[row]
        track_velocity(velocity, pids[velocity.pid], joints[velocity.joint], period_s)
        speaks = state_is_due(velocity) and velocity.wanted
    else:
        return CONTROLLER_IN_PYTHON
    return PUBLICATION if speaks else DONE


@law
def is_sane(values: Any, count: int) -> bool:
    """No value is huge or not a number, as `check_divergence` judges."""
    for k in range(count):  # noqa: SIM110 - this is what compiles
        if not abs(values[k]) < HUGE:
            return False
    return True


def run(
    progress: Any,
    robots: Table,
    joints: Table,
    controllers: Table,
    limits: Table,
    drives: Table,
    pids: Table,
    forwards: Table,
    positions: Table,
    velocities: Table,
    states: Table,
    qpos: Any,
    qvel: Any,
    forces: Any,
    outside: Any,
) -> int:
    """`progress.left` cycles, or fewer up to a turn of the interpreter. Returns for what it stopped."""
    while progress.left > 0:
        if progress.robot == NEW_CYCLE:
            progress.time_ns += progress.step_ns
            progress.robot = 0
        time_ns = progress.time_ns
        while progress.robot < progress.robots:
            robot = robots[progress.robot]
            if robot.is_plain:
                return ROBOT_IN_PYTHON
            if progress.controller == 0:
                if control_is_due(robot, time_ns):
                    read(robot, joints, qpos, qvel, forces)
                    if progress.has_outside:
                        add_outside_efforts(robot, joints, outside)
                else:
                    progress.controller = robot.controllers
            while progress.controller < robot.controllers:
                place = controllers[robot.first_controller + progress.controller]
                progress.controller += 1
                period_s = robot.period_s
                turn = update(
                    place.kind, place.row, time_ns, period_s, joints, pids, forwards, positions, velocities, states
                )
                if turn != DONE:
                    return turn
            period_s = begin_to_write(robot, time_ns)
            write(robot, period_s, joints, limits, drives, pids, qvel, forces)
            progress.controller = 0
            progress.robot += 1
        if progress.step == 0:
            return STEP_IN_PYTHON
        if physics_step(progress.step, progress.model, progress.data, progress.error_hook) != 0:
            return FAILED
        progress.robot = NEW_CYCLE
        progress.left -= 1
        progress.cycles += 1
        if progress.cycles % CHECK_EVERY == 0 and not (
            is_sane(qpos, progress.positions) and is_sane(qvel, progress.dofs)
        ):
            return DIVERGED
    return DONE
