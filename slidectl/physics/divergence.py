"""When the numbers of a robot have run away: how that is seen, and the error that says whose they are.

Only looks; it stops nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from slidectl.errors import SlidectlError
from slidectl.physics.body import Body

HUGE = 1e10
"""A position or velocity beyond this is nonsense; MuJoCo's own bound."""


class Diverged(SlidectlError):
    """The state of a robot is no longer a number, or huge."""

    def __init__(self, robot: str) -> None:
        text = f"the simulation of robot {robot!r} diverged: its state is not finite or huge"
        super().__init__(text, "reset it (slidectl sim reset) or delete the robot; check masses, damping and gains")
        self.robot = robot


def check_divergence(data: Any, bodies: Iterable[Body]) -> None:
    """Raises Diverged, naming the first robot of which a position or velocity is not finite or huge."""
    positions, velocities = np.abs(data.qpos) < HUGE, np.abs(data.qvel) < HUGE
    if positions.all() and velocities.all():
        return
    for body in bodies:
        if not (positions[body.coordinates].all() and velocities[body.dofs].all()):
            raise Diverged(body.name)
