"""Joint motors: forces found anew each step, such that joints reach asked velocities, within bounds of effort.

What ODE's joint motor does as a constraint is done here by inverse dynamics, since MuJoCo's constraints take no
target velocity. The forces are a function of the state alone, so snapshots need nothing more.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from slidectl.physics.body import Array, Body

Asked = dict[Body, dict[str, tuple[float, float]]]
"""By robot and joint: velocity, and most effort."""


class Motors:
    """What each driven joint was last asked for: a velocity (m/s or rad/s), and at most how much effort for it."""

    def __init__(self) -> None:
        self._asked: Asked = {}

    @property
    def is_empty(self) -> bool:
        """True when no joint has a motor."""
        return not self._asked

    def ask(self, body: Body, joint: str, velocity: float, max_effort: float) -> None:
        """From the next step on. Holds until something else is asked."""
        self._asked.setdefault(body, {})[joint] = (velocity, max_effort)

    def asked(self) -> Asked:
        """A copy of all that is asked, for `put`."""
        return {body: dict(joints) for body, joints in self._asked.items()}

    def put(self, asked: Asked) -> None:
        """Ask for exactly this."""
        self._asked = {body: dict(joints) for body, joints in asked.items()}

    def drop(self, body: Body | None = None) -> None:
        """Forget the motors of one robot, or all."""
        if body is None:
            self._asked.clear()
        else:
            self._asked.pop(body, None)

    def apply(self, model: Any, data: Any, efforts: dict[int, float]) -> None:
        """Add the motors' forces to qfrc_applied and to `efforts` (by dof).

        The acceleration without motors is computed first; the warm start that this uses up is put back.
        """
        warmstart = data.qacc_warmstart.copy()
        mujoco.mj_forward(model, data)
        data.qacc_warmstart[:] = warmstart
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        for body, asked in self._asked.items():
            for dof, force in _motor_forces(model, data, inertia, body, asked):
                data.qfrc_applied[dof] += force
                efforts[dof] = efforts.get(dof, 0.0) + force


def _motor_forces(
    model: Any, data: Any, inertia: Array, body: Body, asked: dict[str, tuple[float, float]]
) -> list[tuple[int, float]]:
    """The forces of one robot's motors.

    Euler with implicit damping steps v' = v + h (M + h D)⁻¹ (M a + f), a being the acceleration without motors.
    """
    part, step = body.dofs, model.opt.timestep
    dofs = [body.joints[joint].dof for joint in asked]
    own = [dof - part.start for dof in dofs]
    wanted, bounds = (np.array(column) for column in zip(*asked.values(), strict=True))
    mass = inertia[part, part]
    response = step * np.linalg.inv(mass + step * np.diag(model.dof_damping[part]))
    coasting = data.qvel[part] + response @ (mass @ data.qacc[part])
    forces = _bounded_solution(response[np.ix_(own, own)], wanted - coasting[own], bounds)
    return list(zip(dofs, forces.tolist(), strict=True))


def _bounded_solution(response: Array, change: Array, bounds: Array) -> Array:
    """Forces with response @ forces = change, as far as their bounds let them: those beyond are set to their bound and
    the rest is solved again."""
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
