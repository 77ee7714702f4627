"""static_transform_publisher of tf and of tf2_ros: one transform, latched on /tf_static.

tf's own sends it on /tf again and again; whoever listens knows the same.
"""

from __future__ import annotations

import math
from typing import Any

from slidectl import rotations
from slidectl.client import Client
from slidectl.errors import BadFile
from slidectl.launch.plan import LaunchPlan, Node
from slidectl.launch.task import Run, Task, number, parse

_TOLERANCE = 10e-3
"""Of the square of a quaternion's length, as in tf2."""
_USAGE = {
    "tf": "x y z yaw pitch roll (or qx qy qz qw) FRAME CHILD PERIOD_MS",
    "tf2_ros": "x y z yaw pitch roll (or qx qy qz qw) FRAME CHILD",
}


class StaticTransform(Task):
    """It is there as long as the node."""

    family = "frames"
    needs_presence = True

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = parse(node, {}).rest
        try:
            if node.package == "tf" and len(words) in (9, 10):
                number(node, "the period", words.pop())
            if len(words) not in (8, 9):
                few = "few" if len(words) < 8 else "many"
                raise node.place.error(f"{node.full_name}: {len(words)} arguments are too {few}")
            *values, parent, child = words
            self.numbers = [number(node, "each of the values", value) for value in values]
        except BadFile as error:
            error.hint = f"{node.type} takes: {_USAGE[node.package]}"
            raise
        self.parent, self.child = parent.lstrip("/"), child.lstrip("/")
        if self.parent == self.child:
            raise node.place.error(f"{node.full_name}: {self.child} is its own parent", "the two frames must differ")
        if len(turn := self.numbers[3:]) == 4:
            length = math.hypot(*turn)
            if abs(length * length - 1.0) > _TOLERANCE:
                raise node.place.error(
                    f"{node.full_name}: the quaternion has the length {length:g}, and a rotation has 1",
                    "tf drops such a transform; give qx qy qz qw of length 1, or yaw pitch roll",
                )
            self.numbers[3:] = [part / length for part in turn]
        self._client: Client | None = None

    @property
    def text(self) -> str:
        return f"the frame {self.child} in {self.parent}"

    def start(self, run: Run) -> str | None:
        x, y, z, *turn = self.numbers
        if len(turn) == 4:
            rotation = dict(zip("xyzw", turn, strict=True))
        else:
            rotation = rotations.message(rotations.from_rpy((turn[2], turn[1], turn[0])))
        transform: dict[str, Any] = {
            "header": {"stamp": run.call("/rosapi/get_time")["time"], "frame_id": self.parent},
            "child_frame_id": self.child,
            "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": rotation},
        }
        # A publisher of its own: a latched topic keeps one message of each.
        self._client = Client(socket=run.client.paths.socket_text, timeout=run.client.timeout)
        self._client.publish("/tf_static", {"transforms": [transform]}, "tf2_msgs/TFMessage", latch=True)
        self._client.flush()
        self.settled(run, f"the frame {self.child} in {self.parent}, on /tf_static")
        return None

    def stop(self, run: Run) -> None:  # noqa: ARG002
        if self._client is not None:
            self._client.close()
