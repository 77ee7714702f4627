"""Joint motors: constraints that bring joints to given velocities within a step, with no more than a given effort.

MuJoCo's dry friction of a joint is a constraint with a largest force, which brings the joint to rest. A motor is such a
constraint whose reference acceleration is set between the two halves of a step to the one that leads to the desired
velocity. So MuJoCo's solver solves motors, contacts and joint stops together, as ODE does for Gazebo's joint motors.

A step is first solved without bounds of the motors, which takes the solver one iteration. Then the bound is set for
motors that exceed it, and removed for motors that stay below it, and the step is solved again.

The solver does not include the implicit damping of the step: while a damped joint changes its velocity, the effort is
that for explicit damping. The velocity is reached nevertheless.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from slidectl.physics import mujoco_library
from slidectl.physics.attached_robot import Array, AttachedRobot

UNBOUNDED = 1e15
"""The bound of a motor without bound, N or N·m. A larger one causes rounding errors in the solver."""

SOFTNESS = 1e-5
"""Softness of a motor without bound, relative to the softest that MuJoCo's parameters allow. A motor at its bound keeps
the latter: else the solver misses the narrow range of velocities in which the force is below the bound."""

RELEASES = 3
"""The number of solutions of a step in which bounds may be removed. Later the number of bounds only grows, so that the
iteration ends."""

HEADER, MOTOR = 9, 5
COUNT, STEP_S, REFERENCES, FORCES, STEP1, ACTUATION, ACCELERATION, CONSTRAINT, EULER = range(HEADER)
DOF, QPOS, ROW, BOUND, WEIGHT = range(MOTOR)
"""Places in a table of motors for compiled code: first a header, then each motor.

The header: the number of motors, the time step (s), the addresses of the variables `efc_aref` and `efc_force`, and of
the stages of a step. A motor: indices into qvel, qpos and the constraints, its bound, and the inverse weight of its
dof. Doubles hold these integers exactly: addresses have 48 bits.
"""
_STAGES = ("mj_step1", "mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint", "mj_Euler")

_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)


class Motors:
    """The motors of all robots in one world."""

    def __init__(self) -> None:
        self.bounds: dict[str, dict[str, float]] = {}
        """The largest effort of each motor, N or N·m, by robot and joint."""
        self.velocities: Array = np.zeros(0)
        """The desired velocities, by dof, m/s or rad/s."""
        self._dofs: Array = np.zeros(0, dtype=int)
        self._coordinates = self._rows = self._dofs
        """Indices into qpos, and into MuJoCo's arrays over all constraints."""
        self._bounds_of_dofs = self._weights = self.velocities
        self.table: Array = np.zeros(HEADER)
        """The table for compiled code, see HEADER and MOTOR."""

    @property
    def is_empty(self) -> bool:
        """True when no joint has a motor."""
        return not self.bounds

    def set(self, robot: str, most_efforts: dict[str, float]) -> None:
        """Set the motors of the robot. Joints with an effort of 0 get none. Call `bind` afterwards."""
        self.bounds.pop(robot, None)
        bounds = {joint: min(effort, UNBOUNDED) for joint, effort in most_efforts.items() if effort > 0.0}
        if bounds:
            self.bounds[robot] = bounds

    def of_robot(self, robot: str) -> dict[str, float]:
        """The robot's motors: the largest effort, N or N·m, by joint."""
        return dict(self.bounds.get(robot, {}))

    def release(self, model: Any) -> None:
        """Remove all motors from this model. Call `bind` afterwards."""
        model.dof_frictionloss[self._dofs] = 0.0
        model.dof_invweight0[self._dofs] = self._weights

    def drop(self, robot: AttachedRobot) -> None:
        """Remove the motors of a robot, which has its old indices. Call `bind` afterwards, with a model without it."""
        self.bounds.pop(robot.name, None)
        self.velocities = np.delete(self.velocities, robot.dofs)

    def bind(self, model: Any, data: Any, robots: Mapping[str, AttachedRobot]) -> None:
        """Use this model of these robots, which are bound to it already. New robots get velocities of 0."""
        if len(self.velocities) < model.nv:
            self.velocities = np.append(self.velocities, np.zeros(model.nv - len(self.velocities)))
        motors = sorted(
            (
                (robots[name], robots[name].joints[joint], bound)
                for name, bounds in self.bounds.items()
                for joint, bound in bounds.items()
            ),
            key=lambda motor: motor[1].dof,
        )
        self._dofs = np.array([place.dof for _, place, _ in motors], dtype=int)
        self._coordinates = np.array([place.qpos for _, place, _ in motors], dtype=int)
        self._bounds_of_dofs = np.array([bound for _, _, bound in motors])
        self._weights = np.array([robot.weight_of(place) for robot, place, _ in motors])
        model.dof_solimp[self._dofs] = _IMPEDANCE
        self._set_bounds(model, np.zeros(len(motors), dtype=bool))
        # Rows: equalities, then the friction of dofs in their order.
        frictional = np.flatnonzero(model.dof_frictionloss > 0.0)
        self._rows = np.count_nonzero(data.eq_active) + np.searchsorted(frictional, self._dofs)
        self.table = np.zeros(HEADER + len(motors) * MOTOR)
        if motors:
            variables = [mujoco_library.struct_address(data) + place for place in mujoco_library.constraint_variables()]
            stages = [mujoco_library.address_of(stage) for stage in _STAGES]
            self.table[:HEADER] = len(self._dofs), model.opt.timestep, *variables, *stages
            columns = (self._dofs, self._coordinates, self._rows, self._bounds_of_dofs, self._weights)
            self.table[HEADER:] = np.column_stack(columns).ravel()

    def _set_bounds(self, model: Any, bounded: Array) -> None:
        """Set the bounds of these motors in the solver, and remove those of the others."""
        model.dof_frictionloss[self._dofs] = np.where(bounded, self._bounds_of_dofs, UNBOUNDED)
        model.dof_invweight0[self._dofs] = np.where(bounded, self._weights, SOFTNESS * self._weights)

    def step(self, model: Any, data: Any, efforts: Array) -> None:
        """Advance by one time step. Writes the motors' efforts (N or N·m) to `efforts`, by dof."""
        dofs, rows, bounds, step = self._dofs, self._rows, self._bounds_of_dofs, model.opt.timestep
        wanted = self.velocities[dofs]
        accelerations = (wanted - data.qvel[dofs]) / step
        bounded = np.zeros(len(dofs), dtype=bool)
        releases = RELEASES
        while True:
            mujoco.mj_step1(model, data)
            data.efc_aref[rows] = accelerations
            mujoco.mj_fwdActuation(model, data)
            mujoco.mj_fwdAcceleration(model, data)
            mujoco.mj_fwdConstraint(model, data)
            forces = data.efc_force[rows]
            sizes = np.abs(forces)
            wrong = sizes > bounds
            if releases > 0:
                wrong |= bounded & (sizes < bounds)
            if not wrong.any():
                break
            releases -= 1
            bounded ^= wrong
            self._set_bounds(model, bounded)
        mujoco.mj_Euler(model, data)
        efforts[dofs] = forces
        # The constraints leave rounding errors in the velocities, which would add up in the positions.
        free = sizes < bounds
        data.qpos[self._coordinates[free]] += step * (wanted - data.qvel[dofs])[free]
        data.qvel[dofs[free]] = wanted[free]
        if bounded.any():
            self._set_bounds(model, np.zeros_like(bounded))
