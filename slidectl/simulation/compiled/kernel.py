"""The compiled cycle: what `Loop` and `ControlCycle` do with objects, done with rows, by the same laws.

`run` is compiled by `compiler.py`; `guard.py` has `physics_step` and `update_controller`. It returns wherever the
interpreter must continue, and the next call continues from there. The interpreter calls nothing in this file.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from slidectl.control.angular_distance import unwrapped
from slidectl.control.hardware_interface import is_finite
from slidectl.control.laws import law
from slidectl.control.limits import enforce
from slidectl.physics.applied_forces import truncated
from slidectl.physics.motors import (
    ACTUATION,
    BOUND,
    CONSTRAINT,
    COUNT,
    DOF,
    EULER,
    FORCES,
    HEADER,
    MOTOR,
    QPOS,
    REFERENCES,
    RELEASES,
    ROW,
    SOFTNESS,
    STEP1,
    STEP_S,
    UNBOUNDED,
    WEIGHT,
)
from slidectl.physics.robot_hw import VELOCITY_MOTOR, drive_effort, motor_velocity
from slidectl.physics.world import HUGE
from slidectl.simulation.compiled import tables as turns
from slidectl.simulation.compiled.tables import CONTROLLER_SIZE, INTERPRETED, NEW_CYCLE
from slidectl.simulation.cycle import CHECK_EVERY, begin_to_write, control_is_due
from slidectl.simulation.history import EVERY, ROWS, WRITTEN
from slidectl.simulation.history import HEADER as FIRST_ROW

Table = Any


class CycleTables(NamedTuple):
    """The tables of `tables.TABLES`, the arrays of `slidectl.physics.world.Memory`, and the block of the history."""

    robots: Table
    joints: Table
    controllers: Table
    limits: Table
    drives: Table
    pids: Table
    qpos: Any
    qvel: Any
    forces: Any
    outside: Any
    velocities: Any
    motors: Any
    bounds: Any
    weights: Any
    history: Any


def physics_step(step: int, model: int, data: int, error_hook: int) -> int:
    """Run mj_step. Returns 0, or another number after an error of MuJoCo. Machine code; see `guard.py`."""
    raise NotImplementedError


def update_controller(controller: int, joints: int, pids: int, time_ns: int, period_s: float) -> int:
    """Run the law of the controller whose row is at this address: DONE, PUBLICATION, LEFT or RAISED. Machine code."""
    raise NotImplementedError


def element(variable: int, index: int) -> float:
    """An element of the array that the variable at this address points to. Machine code; see `guard.py`."""
    raise NotImplementedError


def set_element(variable: int, index: int, value: float) -> None:
    """Set an element of the array that the variable at this address points to. Machine code; see `guard.py`."""
    raise NotImplementedError


@law
def read(robot: Any, tables: CycleTables, has_outside: int) -> None:
    """The same as MujocoRobotHW.read. `has_outside`: there are external efforts."""
    for k in range(robot.first_joint, robot.first_joint + robot.joints):
        joint = tables.joints[k]
        angle_or_length = tables.qpos[joint.qpos]
        joint.position = unwrapped(joint.position, angle_or_length) if joint.turns else angle_or_length
        joint.velocity = tables.qvel[joint.dof]
        joint.effort = tables.forces[joint.dof]
        if has_outside:
            joint.effort += tables.outside[joint.dof]


@law
def are_finite(robot: Any, tables: CycleTables) -> bool:
    """False when the interpreter must look for a controller whose command is not finite."""
    for k in range(robot.first_joint, robot.first_joint + robot.joints):  # noqa: SIM110 - numba compiles this form
        if not is_finite(tables.joints[k]):
            return False
    return True


@law
def write(robot: Any, period_s: float, tables: CycleTables) -> None:
    """The same as MujocoRobotHW.write."""
    joints, limits, drives, qvel, forces = tables.joints, tables.limits, tables.drives, tables.qvel, tables.forces
    for k in range(robot.first_limit, robot.first_limit + robot.limits):
        enforce(limits[k], joints[limits[k].joint], period_s)
    for k in range(robot.first_joint, robot.first_joint + robot.joints):
        joint = joints[k]
        forces[joint.dof] = 0.0
        if joint.is_pushed:
            forces[joint.dof] = truncated(joint.command, qvel[joint.dof], joint.max_effort, joint.max_velocity)
    for k in range(robot.first_drive, robot.first_drive + robot.drives):
        joint = joints[drives[k].joint]
        if drives[k].kind >= VELOCITY_MOTOR:
            velocity = motor_velocity(drives[k], joint, tables.qpos[joint.qpos], tables.motors[STEP_S])
            if math.isnan(velocity):
                tables.qpos[joint.qpos] = joint.command
                qvel[joint.dof] = velocity = 0.0
            tables.velocities[joint.dof] = velocity
            continue
        effort = drive_effort(drives[k], tables.pids[drives[k].pid], joint, period_s)
        forces[joint.dof] += truncated(effort, qvel[joint.dof], joint.max_effort, joint.max_velocity)


@law
def motor_step(progress: Any, tables: CycleTables) -> int:
    """The same as Motors.step. Returns 0, or 1 after an error of MuJoCo."""
    motors, qpos, qvel = tables.motors, tables.qpos, tables.qvel
    step_s, references, forces = motors[STEP_S], int(motors[REFERENCES]), int(motors[FORCES])
    last = HEADER + int(motors[COUNT]) * MOTOR
    is_bounded, is_wrong, releases = False, True, RELEASES
    while is_wrong:
        if physics_step(int(motors[STEP1]), progress.model, progress.data, progress.error_hook) != 0:
            return 1
        for k in range(HEADER, last, MOTOR):
            dof = int(motors[k + DOF])
            set_element(references, int(motors[k + ROW]), (tables.velocities[dof] - qvel[dof]) / step_s)
        for stage in range(ACTUATION, CONSTRAINT + 1):
            if physics_step(int(motors[stage]), progress.model, progress.data, progress.error_hook) != 0:
                return 1
        is_wrong = False
        for k in range(HEADER, last, MOTOR):
            dof, size = int(motors[k + DOF]), abs(element(forces, int(motors[k + ROW])))
            if size > motors[k + BOUND]:
                is_bounded = is_wrong = True
                tables.bounds[dof] = motors[k + BOUND]
                tables.weights[dof] = motors[k + WEIGHT]
            elif releases > 0 and tables.bounds[dof] < UNBOUNDED and size < motors[k + BOUND]:
                is_wrong = True
                tables.bounds[dof] = UNBOUNDED
                tables.weights[dof] = SOFTNESS * motors[k + WEIGHT]
        releases -= 1
    if physics_step(int(motors[EULER]), progress.model, progress.data, progress.error_hook) != 0:
        return 1
    for k in range(HEADER, last, MOTOR):
        dof = int(motors[k + DOF])
        tables.outside[dof] = effort = element(forces, int(motors[k + ROW]))
        if abs(effort) < motors[k + BOUND]:
            qpos[int(motors[k + QPOS])] += step_s * (tables.velocities[dof] - qvel[dof])
            qvel[dof] = tables.velocities[dof]
        if is_bounded:
            tables.bounds[dof] = UNBOUNDED
            tables.weights[dof] = SOFTNESS * motors[k + WEIGHT]
    return 0


@law
def is_sane(values: Any, count: int) -> bool:
    """True when no value is huge or NaN, by the same rule as `check_divergence`."""
    for k in range(count):  # noqa: SIM110 - numba compiles this form
        if not abs(values[k]) < HUGE:
            return False
    return True


@law
def keep(progress: Any, tables: CycleTables) -> None:
    """The same as History.keep."""
    history, positions, dofs = tables.history, progress.positions, progress.dofs
    at = FIRST_ROW + int(history[WRITTEN] % history[ROWS]) * (1 + positions + 3 * dofs)
    history[WRITTEN] += 1.0
    history[at] = progress.time_ns
    at += 1
    for k in range(positions):
        history[at + k] = tables.qpos[k]
    at += positions
    for k in range(dofs):
        history[at + k] = tables.qvel[k]
        history[at + dofs + k] = tables.forces[k]
        history[at + 2 * dofs + k] = tables.outside[k]


def run(progress: Any, tables: CycleTables) -> int:
    """Run `progress.left` cycles, or fewer until the interpreter must continue. Returns the reason of the return."""
    while progress.left > 0:
        if progress.robot == NEW_CYCLE:
            progress.time_ns += progress.step_ns
            progress.robot = 0
        time_ns = progress.time_ns
        while progress.robot < progress.robots:
            robot = tables.robots[progress.robot]
            if robot.is_plain:
                return turns.ROBOT_IN_PYTHON
            if progress.controller == 0:
                if control_is_due(robot, time_ns):
                    read(robot, tables, progress.has_outside)
                else:
                    progress.controller = robot.controllers
            while progress.controller < robot.controllers:
                number = robot.first_controller + progress.controller
                progress.controller += 1
                if tables.controllers[number].law == INTERPRETED:
                    return turns.CONTROLLER_IN_PYTHON
                address = progress.controllers + number * CONTROLLER_SIZE
                turn = update_controller(address, progress.joints, progress.pids, time_ns, robot.period_s)
                if turn != turns.DONE:
                    return turn
            if not are_finite(robot, tables):
                return turns.NOT_FINITE
            period_s = begin_to_write(robot, time_ns)
            write(robot, period_s, tables)
            progress.controller = 0
            progress.robot += 1
        if progress.step == 0:
            return turns.STEP_IN_PYTHON
        if tables.motors[COUNT] > 0.0:
            if motor_step(progress, tables) != 0:
                return turns.FAILED
        elif physics_step(progress.step, progress.model, progress.data, progress.error_hook) != 0:
            return turns.FAILED
        progress.robot = NEW_CYCLE
        progress.left -= 1
        progress.cycles += 1
        if progress.cycles % EVERY == 0:
            keep(progress, tables)
        # A velocity is huge some cycles before it is no number, and then disturbs the other robots.
        if not is_sane(tables.qvel, progress.dofs):
            return turns.DIVERGED
        if progress.cycles % CHECK_EVERY == 0 and not is_sane(tables.qpos, progress.positions):
            return turns.DIVERGED
    return turns.DONE
