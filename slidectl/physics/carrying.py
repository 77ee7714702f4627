"""What of a world outlives a rebuild of its model: the arrays that hold state, less the part of a robot that leaves.

Robots keep their order and new ones are the last, so what is carried over is the beginning of the new arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slidectl.physics.body import Body

_OF_DATA = {
    "qpos": "qpos",
    "qvel": "dof",
    "qacc_warmstart": "dof",
    "qfrc_applied": "dof",
    "xfrc_applied": "body",
    "eq_active": "tie",
}
_OF_MODEL = {
    "body_pos": "body",
    "body_quat": "body",
    "body_invweight0": "body",
    "dof_invweight0": "dof",
    "tendon_invweight0": "tendon",
}
"""Arrays by the kind of their rows, as `Body.part` names it. Of the model: where roots were put, and each robot's own
weights."""


def carry_over(model: Any, data: Any, new_model: Any, new_data: Any, gone: Body | None) -> None:
    """Copy all that the robots' future depends on besides their specification; `gone` is in the old world only."""
    for old, new, arrays in ((data, new_data, _OF_DATA), (model, new_model, _OF_MODEL)):
        for name, kind in arrays.items():
            values = getattr(old, name)
            if gone is not None:
                values = np.delete(values, gone.part(kind), axis=0)
            getattr(new, name)[: len(values)] = values
