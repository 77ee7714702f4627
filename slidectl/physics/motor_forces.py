"""The forces by which one robot's motors bring about velocities: the arithmetic behind `motors.py`.

Euler with implicit damping steps v' = v + h (M + h D)⁻¹ M a. Constraints answer a change of force f with a change of
acceleration (M + Jᵀ W J)⁻¹ f, over those that push back; without any it is M⁻¹ f.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from slidectl.physics.body import Array, Body
from slidectl.physics.divergence import Diverged

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)


class Moment:
    """What MuJoCo knows after mj_forward, as dense matrices over all degrees of freedom."""

    def __init__(self, model: Any, data: Any) -> None:
        self.model, self.data = model, data
        self.inertia = _full_inertia(model, data)
        self.has_constraints = data.nefc > 0
        if self.has_constraints:
            self.jacobian = np.zeros((data.nefc, model.nv))
            rows = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind.ravel())
            mujoco.mju_sparse2dense(self.jacobian, data.efc_J.ravel(), *rows)
            self.pushing = _pushing(data)


class RobotMotors:
    """The motors of one robot in one step: which dofs, what is asked of them, and the forces found so far."""

    def __init__(self, body: Body, asked: dict[str, tuple[float, float]]) -> None:
        self._body, self._part = body, body.dofs
        self.dofs = [body.joints[joint].dof for joint in asked]
        self._own = [dof - self._part.start for dof in self.dofs]
        self._wanted, self._bounds = (np.array(column) for column in zip(*asked.values(), strict=True))
        self.forces = np.zeros(len(asked))
        self.is_constrained = False
        """Whether a constraint of the robot could push back at the last look."""

    def improve(self, moment: Moment) -> None:
        """Find better forces than those that act now, and let these act (in qfrc_applied) instead.

        Raises:
            Diverged: the state is no longer one that forces could be found for.
        """
        try:
            coasting, response = self._plant(moment)
            forces = bounded_solution(response, self._wanted - coasting + response @ self.forces, self._bounds)
        except np.linalg.LinAlgError as error:
            raise Diverged(self._body.name) from error
        moment.data.qfrc_applied[self.dofs] += forces - self.forces
        self.forces = forces

    def _plant(self, moment: Moment) -> tuple[Array, Array]:
        """Velocities after the step with the forces that act now, and their change with these forces."""
        part, model, data = self._part, moment.model, moment.data
        step = model.opt.timestep
        mass = np.ascontiguousarray(moment.inertia[part, part])
        damped = mass.copy()
        damped.flat[:: len(mass) + 1] += step * model.dof_damping[part]
        response = step * np.linalg.inv(damped)
        coasting = data.qvel[part] + response @ (mass @ data.qacc[part])
        stiffness = self._stiffness(moment)
        if stiffness is not None:
            response = response @ mass @ np.linalg.inv(mass + stiffness)
        return coasting[self._own], response[self._own][:, self._own]

    def _stiffness(self, moment: Moment) -> Array | None:
        """Jᵀ W J over the constraints of this robot that push back; None when none does."""
        self.is_constrained = False
        if not moment.has_constraints:
            return None
        rows = np.ascontiguousarray(moment.jacobian[:, self._part])
        own = rows.any(axis=1)
        self.is_constrained = bool(own.any())
        pushing = own & moment.pushing
        if not pushing.any():
            return None
        rows = rows[pushing]
        stiffness: Array = (rows.T * moment.data.efc_D[pushing]) @ rows
        return stiffness


def bounded_solution(response: Array, change: Array, bounds: Array) -> Array:
    """Forces with response @ forces = change, as far as their bounds let them.

    Those that would be beyond are set to their bound, and the rest is solved for again.
    """
    forces: Array = np.linalg.solve(response, change)
    if (np.abs(forces) <= bounds).all():
        return forces
    forces, free = np.zeros(len(bounds)), np.ones(len(bounds), dtype=bool)
    while free.any():
        rest = change[free] - response[np.ix_(free, ~free)] @ forces[~free]
        forces[free] = np.linalg.solve(response[np.ix_(free, free)], rest)
        beyond = free & (np.abs(forces) > bounds)
        if not beyond.any():
            break
        forces[beyond] = np.copysign(bounds[beyond], forces[beyond])
        free &= ~beyond
    return forces


def _pushing(data: Any) -> Array:
    """Which constraint rows answer a small change of velocity: those whose force is not at its bound.

    Told by the forces: MuJoCo fills its own record of it (efc_state) only when it solves without islands.
    """
    kind, force = data.efc_type, data.efc_force
    friction = (kind == _FRICTION) & (np.abs(force) < data.efc_frictionloss)
    one_sided = (kind != _FRICTION) & (force > 0.0)
    pushing: Array = (kind == _EQUALITY) | friction | one_sided
    return pushing


def _full_inertia(model: Any, data: Any) -> Array:
    inertia = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, data, inertia)
    except TypeError:  # its arguments before MuJoCo 4
        mujoco.mj_fullM(model, inertia, data.qM)
    return inertia
