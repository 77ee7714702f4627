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
_CONTACT = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)


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
            self.weights = _weights(data)
            self.contact_rows, self.contact_hessians = _contacts(model, data)


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
        jacobian = np.ascontiguousarray(moment.jacobian[:, self._part])
        own = np.asarray(jacobian.any(axis=1))
        self.is_constrained = bool(own.any())
        pushing = own & (moment.weights > 0.0)
        touching = own[moment.contact_rows].any(axis=1) & moment.contact_hessians.any(axis=(1, 2))
        if not pushing.any() and not touching.any():
            return None
        rows = jacobian[pushing]
        stiffness: Array = (rows.T * moment.weights[pushing]) @ rows
        if touching.any():
            contacts = jacobian[moment.contact_rows[touching]]
            weighted = moment.contact_hessians[touching] @ contacts
            flat = (-1, contacts.shape[2])
            stiffness += contacts.reshape(flat).T @ weighted.reshape(flat)
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


def _weights(data: Any) -> Array:
    """How stiff each row answers a small change of acceleration; 0 where its force is at its bound, and for contacts.

    Told by the forces: MuJoCo fills its own record of it (efc_state) only when it solves without islands.
    """
    kind, force = data.efc_type, data.efc_force
    friction = (kind == _FRICTION) & (np.abs(force) < data.efc_frictionloss)
    one_sided = (kind != _FRICTION) & (kind != _CONTACT) & (force > 0.0)
    pushing = (kind == _EQUALITY) | friction | one_sided
    weights: Array = np.where(pushing, data.efc_D, 0.0)
    return weights


def _contacts(model: Any, data: Any) -> tuple[Array, Array]:
    """The rows (contacts, 3) of each contact, and the second derivatives (contacts, 3, 3) of its cost.

    The formulas are those of MuJoCo for elliptic cones. u = (n, t) is the violation, scaled so that the cone of
    friction is round: the contact is open where n >= mu |t|, holds where mu n + |t| <= 0, and slides in between.
    """
    contact = data.contact
    active = contact.efc_address >= 0
    rows: Array = contact.efc_address[active][:, None] + np.arange(3)
    mu = contact.mu[active]
    scale = np.column_stack((mu, contact.friction[active][:, :2]))
    violation = np.zeros(data.nefc)
    mujoco.mj_mulJacVec(model, data, violation, data.qacc)  # sparse: the sums of a robot are those when it is alone
    u = (violation - data.efc_aref)[rows] * scale
    n, t = u[:, 0], np.hypot(u[:, 1], u[:, 2])
    weights = data.efc_D[rows]
    hessians = np.zeros((len(rows), 3, 3))
    holds = (n < mu * t) | (n < 0.0)
    slides = holds & (mu * n + t > 0.0) & (t > 0.0)
    holds &= ~slides
    hessians[holds] = weights[holds][:, :, None] * np.eye(3)
    mu, n, t, u, scale = mu[slides], n[slides], t[slides], u[slides], scale[slides]
    sliding = np.zeros((len(mu), 3, 3))
    sliding[:, 0, 0] = 1.0
    sliding[:, 0, 1:] = sliding[:, 1:, 0] = -(mu / t)[:, None] * u[:, 1:]
    sliding[:, 1:, 1:] = (mu * n / (t * t * t))[:, None, None] * u[:, 1:, None] * u[:, None, 1:]
    sliding[:, 1:, 1:] += (mu * mu - mu * n / t)[:, None, None] * np.eye(2)
    sliding *= scale[:, :, None] * scale[:, None, :]
    hessians[slides] = sliding * (weights[slides, 0] / (mu * mu * (1.0 + mu * mu)))[:, None, None]
    return rows, hessians


def _full_inertia(model: Any, data: Any) -> Array:
    inertia = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, data, inertia)
    except TypeError:  # its arguments before MuJoCo 4
        mujoco.mj_fullM(model, inertia, data.qM)
    return inertia
