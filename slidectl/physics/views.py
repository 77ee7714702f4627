"""Direct views of MuJoCo's state for the hot path: indexing one costs a third of what a numpy scalar costs.

They must be taken anew whenever the model is rebuilt. Nothing is copied.
"""

from __future__ import annotations

from typing import Any


class Views:
    """`qpos`, `qvel` and `forces` (qfrc_applied) of one MjData as memoryviews of floats."""

    __slots__ = ("forces", "qpos", "qvel")

    qpos: memoryview[float]
    qvel: memoryview[float]
    forces: memoryview[float]

    def take(self, data: Any) -> None:
        """View this data from now on."""
        self.qpos = memoryview(data.qpos)
        self.qvel = memoryview(data.qvel)
        self.forces = memoryview(data.qfrc_applied)
