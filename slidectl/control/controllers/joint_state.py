"""Publishes the states of a robot's joints as `joint_states`, after ros_controllers' JointStateController.

Parameters `publish_rate`, `joints`, `extra_joints`. It commands nothing and claims nothing.
"""

from __future__ import annotations

from math import isnan
from typing import Any, ClassVar

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import Compiled, Controller, Parts
from slidectl.control.duration import from_seconds, header_of
from slidectl.control.hardware_interface import JointStateHandle, JointStateInterface
from slidectl.control.laws import Columns, LawTables, law
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import FLOAT, LIST, NUMBER, TEXT, TEXTS, Parameter
from slidectl.control.registry import controller
from slidectl.errors import Refused

# The factor makes the first message after a start come slightly early, not a cycle late.
_HEAD_START = 1.001
_EARLIEST_NS = 1


NEVER = 1 << 62


@law
def states_are_due(rhythm: JointStateController, time_ns: int) -> bool:
    """True when a message is due. The next one is due one period after this due time, so delays do not add up."""
    if time_ns <= rhythm.due_ns:
        return False
    rhythm.due_ns += rhythm.period_ns
    rhythm.messages += 1
    return True


@law
def update_states(rhythm: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update on rows."""
    return states_are_due(rhythm, time_ns) and rhythm.wanted != 0


@controller("joint_state_controller/JointStateController")
class JointStateController(Controller[JointStateInterface]):
    """sensor_msgs/JointState on `joint_states` of the robot's namespace, at `publish_rate` per simulated second."""

    interface_type = JointStateInterface
    compiled = Compiled(
        update_states,
        Columns(changing="due_ns messages", fixed="period_ns", whole="due_ns messages period_ns"),
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "publish_rate",
            NUMBER,
            "messages per simulated second; none unless above 0",
            "1/s",
            required=True,
            unless_positive="nothing is published",
        ),
        Parameter("joints", TEXTS, "which joints, in this order; all by default", names_joints=True),
        Parameter("extra_joints", LIST, "joints that the hardware does not have"),
        Parameter("extra_joints[]/name", TEXT, "name of such a joint", required=True),
        Parameter("extra_joints[]/position", FLOAT, "its constant position", "m or rad", default=0.0),
        Parameter("extra_joints[]/velocity", FLOAT, "its constant velocity", "m/s or rad/s", default=0.0),
        Parameter("extra_joints[]/effort", FLOAT, "its constant effort", "N or N·m", default=0.0),
    )

    def init_in_root(self, interface: JointStateInterface, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: no publish_rate, or an unknown joint."""
        chosen = params.read(node, "joints", TEXTS)
        rate = params.needed(node, "publish_rate", NUMBER)
        if isnan(rate):
            raise Refused("publish_rate must be a number, not nan")
        self._publishes = rate > 0.0
        self.period_ns = from_seconds(1.0 / rate) if self._publishes else 0
        self._head_start_ns = from_seconds(_HEAD_START / rate) if self._publishes else 0
        if not self._publishes:
            node.log("warn", f"{node.namespace}/publish_rate is not above 0: nothing is published")
        self._publisher = node.advertise(names.join(root.namespace, "joint_states"), "sensor_msgs/JointState")
        self._joints = tuple(interface.get_handle(name) for name in (interface.names() if chosen is None else chosen))
        # Joints that the hardware does not have come last. Their states are constant.
        self._shown = (*self._joints, *_extra_joints(node, [joint.name for joint in self._joints]))
        self._names = [joint.name for joint in self._shown]
        # The next message is due after this time: the due time of the last one plus one period.
        self.due_ns = NEVER
        self.messages = 0
        self._started = False

    def starting(self, time_ns: int) -> None:
        """Set the first due time. It is kept over stops, and set again when time was reset."""
        if self._publishes and (not self._started or time_ns < self.due_ns - self.period_ns):
            last_ns = time_ns - self._head_start_ns
            self.due_ns = (last_ns if last_ns >= 0 else _EARLIEST_NS) + self.period_ns
            self._started = True

    def update(self, time_ns: int, period_s: float) -> None:
        if states_are_due(self, time_ns) and self._publisher.wanted:
            self.publish(time_ns, period_s)

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the states of this cycle."""
        self._publisher.sequence = self.messages - 1
        joints = self._shown
        self._publisher.publish(
            {
                "header": header_of(time_ns),
                "name": self._names,
                "position": [joint.position for joint in joints],
                "velocity": [joint.velocity for joint in joints],
                "effort": [joint.effort for joint in joints],
            }
        )

    def parts(self) -> Parts:
        """The parts of the compiled form."""
        return Parts((self._publisher,), shown=self._joints)


def _extra_joints(node: NodeHandle, taken: list[str]) -> list[JointStateHandle]:
    """The valid entries of `extra_joints`. Errors in the others are logged."""
    entries = node.get_param("extra_joints", [])
    if not isinstance(entries, list):
        node.log("error", f"{node.namespace}/extra_joints has no effect: it must be a list")
        return []
    joints: dict[str, JointStateHandle] = {}
    for position, entry in enumerate(entries):
        skipped = f"{node.namespace}/extra_joints[{position}] is skipped"
        name = entry.get("name") if isinstance(entry, dict) else None
        if not isinstance(name, str):
            node.log("error", f"{skipped}: it must be a mapping with a name")
            continue
        state = {key: entry.get(key, 0.0) for key in ("position", "velocity", "effort")}
        wrong = [key for key, value in state.items() if not isinstance(value, float)]
        if wrong:
            node.log("error", f"{skipped}: {wrong[0]} of {name!r} must be a float, such as 0.0")
        elif name in taken or name in joints:
            node.log("warn", f"{node.namespace}/extra_joints: joint {name!r} exists already")
        else:
            joints[name] = JointStateHandle(name, **state)
    return list(joints.values())
