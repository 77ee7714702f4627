"""All that acts in a step besides what the robots' hardware pushes: forces from outside, and motors.

Put on before the step and taken off after it, so that qfrc_applied belongs to the hardware alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from slidectl.physics.body import Body
from slidectl.physics.forces import ExternalForces
from slidectl.physics.motors import Motors


class Loads:
    """Forces from outside, motors, and the efforts on joints that they came to in the last step."""

    def __init__(self) -> None:
        self.forces = ExternalForces()
        self.motors = Motors()
        self.efforts: dict[int, float] = {}
        """N or N·m by dof; always the same dict."""

    @property
    def is_empty(self) -> bool:
        """True when steps need nothing of this."""
        return self.forces.is_empty and self.motors.is_empty

    def step(self, model: Any, data: Any, now_ns: int, advance: Callable[[], None]) -> None:
        """One step with everything that acts at `now_ns`; what the hardware applies is put back exactly afterwards.

        Raises:
            Diverged: a robot with motors has no state to compute forces from.
        """
        joint_forces, link_forces = data.qfrc_applied.copy(), data.xfrc_applied.copy()
        self.efforts.clear()
        try:
            self.forces.apply(model, data, now_ns, self.efforts)
            if not self.motors.is_empty:
                self.motors.apply(model, data, self.efforts)
            advance()
        finally:
            data.qfrc_applied[:], data.xfrc_applied[:] = joint_forces, link_forces

    def forget(self, body: Body) -> None:
        """Drop all that acts on one robot."""
        self.forces.drop(lambda force: force.body is not body)
        self.motors.drop(body)
