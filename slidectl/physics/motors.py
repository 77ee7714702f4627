"""Joint motors: forces found anew each step, such that joints reach asked velocities, within bounds of effort.

What ODE's joint motor does as a constraint is done here by inverse dynamics, since MuJoCo's constraints take no
target velocity. The forces are a function of the state alone, so snapshots need nothing more.
"""

from __future__ import annotations

from typing import Any

import mujoco

from slidectl.physics.body import Body
from slidectl.physics.motor_forces import Moment, RobotMotors

PASSES = 3
"""How often the forces of a robot under constraints (contacts, limits) are found: each time they may change which
constraints push back. Without constraints the first time is exact."""

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
        """Add the motors' forces to qfrc_applied and, by dof, to `efforts`. The warm start used up here is put back."""
        warmstart = data.qacc_warmstart.copy()
        motors = [RobotMotors(body, asked) for body, asked in self._asked.items()]
        waiting = motors
        for _ in range(PASSES):
            mujoco.mj_forward(model, data)
            moment = Moment(model, data)
            for robot in waiting:
                robot.improve(moment)
            waiting = [robot for robot in waiting if robot.is_constrained]
            if not waiting:
                break
        data.qacc_warmstart[:] = warmstart
        for robot in motors:
            for dof, force in zip(robot.dofs, robot.forces.tolist(), strict=True):
                efforts[dof] = efforts.get(dof, 0.0) + force
