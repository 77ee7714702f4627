"""Publishes the states of a robot's joints as `joint_states`, after ros2_controllers' joint_state_broadcaster.

Topic `joint_states` of the robot's namespace, or of the controller's own with `use_local_topics`. A message comes with
each update of the controller, and a field without a state interface is nan. It commands nothing and claims nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import nan
from typing import Any, ClassVar

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import Controller
from slidectl.control.duration import header_of
from slidectl.control.hardware_interface import JointStateHandle, JointStateInterface
from slidectl.control.node_handle import Message, NodeHandle, publish_if_wanted
from slidectl.control.params import BOOLEAN, TEXT, TEXTS, Parameter, within
from slidectl.control.registry import ros2_controller
from slidectl.control.robot_description import robot_of_model
from slidectl.control.ros2_controller import UPDATE_RATE, Ros2Controller, fixed
from slidectl.errors import Refused, listing

FIELDS = ("position", "velocity", "effort")
"""The fields of a message, and the names of the state interfaces that each joint has."""
_MOVING = ("revolute", "continuous", "prismatic")
USES_LOCAL, FILTERS, FRAME = fixed(
    Parameter("use_local_topics", BOOLEAN, "publishes ~/joint_states instead of joint_states", default=False),
    Parameter(
        "use_urdf_to_filter", BOOLEAN, "leaves out joints that do not move in the robot_description", default=True
    ),
    Parameter("frame_id", TEXT, "the frame in the header", default="base_link"),
)
JOINTS, INTERFACES, EXTRA = fixed(
    Parameter("joints", TEXTS, "which joints, in this order; only with interfaces", default=[], names_joints=True),
    Parameter("interfaces", TEXTS, "which states of these joints; only with joints", default=[]),
    Parameter("extra_joints", TEXTS, "joints that the hardware does not have; all their states are 0", default=[]),
)
MAPS = within(
    "map_interface_to_joint_state",
    fixed(
        *(Parameter(field, TEXT, f"the state interface that is shown as {field}", default=field) for field in FIELDS)
    ),
)

Sources = dict[str, str]
"""By state interface the field that shows it."""


@ros2_controller("joint_state_broadcaster/JointStateBroadcaster")
class JointStateBroadcaster(Ros2Controller, Controller[JointStateInterface]):
    """sensor_msgs/JointState on `joint_states`, of all joints or of `joints`."""

    interface_type = JointStateInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(UPDATE_RATE, USES_LOCAL, JOINTS, INTERFACES, EXTRA, *MAPS, FILTERS, FRAME),
    )

    def init_in_root(self, interface: JointStateInterface, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: an unknown joint or state interface, no joint at all, or no robot_description."""
        chosen, states = params.value_of(node, JOINTS), params.value_of(node, INTERFACES)
        if bool(chosen) != bool(states):
            text = f"{node.namespace}: joints and interfaces count only together: all joints are published"
            node.log("warn", text)
            chosen = states = []
        if chosen:
            _check_states(node, states)
        fields = _fields_by_interface(node, states)
        filters: bool = params.value_of(node, FILTERS)
        where = chosen or _joints_of_model(interface, root, filters)
        shown: dict[str, dict[str, tuple[JointStateHandle, str]]] = {}
        for joint in where:
            found = {field: state for state, field in fields.items() if state in (states or FIELDS)}
            if found:
                handle = interface.get_handle(joint)
                shown.pop(joint, None)  # a joint that is named twice has its last place
                shown[joint] = {field: (handle, state) for field, state in found.items()}
        if not shown:
            raise Refused(
                f"{node.namespace} has no state of a joint to publish", f"joints: {listing(interface.names())}"
            )
        for joint in params.value_of(node, EXTRA):
            shown.setdefault(joint, dict.fromkeys(FIELDS, (JointStateHandle(joint), FIELDS[0])))
        self._names = list(shown)
        self._shown = {field: [sources.get(field) for sources in shown.values()] for field in FIELDS}
        self._frame: str = params.value_of(node, FRAME)
        if not self._frame:
            node.log("warn", f"parameter {node.namespace}/{FRAME.name} is empty: the states have no frame")
        space = node.namespace if params.value_of(node, USES_LOCAL) else root.namespace
        self._publisher = node.advertise(names.join(space, "joint_states"), "sensor_msgs/JointState")

    def cycle(self, time_ns: int, period_s: float) -> None:
        publish_if_wanted(self._publisher, lambda: self._message(time_ns))

    def _message(self, time_ns: int) -> Message:
        values: dict[str, Any] = {
            field: [nan if source is None else getattr(*source) for source in sources]
            for field, sources in self._shown.items()
        }
        return {"header": header_of(time_ns, self._frame), "name": self._names, **values}


def _check_states(node: NodeHandle, states: Iterable[str]) -> None:
    """Raises Refused: one of them is not a state interface of joints."""
    for state in states:
        if state not in FIELDS:
            text = f"parameter {node.namespace}/{INTERFACES.name} names {state!r}"
            raise Refused(f"{text}; the state interfaces of a joint are {listing(FIELDS)}")


def _fields_by_interface(node: NodeHandle, states: Sequence[str]) -> Sources:
    """By state interface the field that shows it. A field keeps its own interface if that is in `states`."""
    fields: Sources = {}
    for field, parameter in zip(FIELDS, MAPS, strict=True):
        state: str = params.value_of(node, parameter)
        if state != field and field in states:
            text = f"parameter {node.namespace}/{parameter.name} has no effect: {field} itself is in interfaces"
            node.log("warn", text)
            state = field
        elif state not in FIELDS:
            text = f"parameter {node.namespace}/{parameter.name} is {state!r}, which no joint has: {field} is nan"
            node.log("warn", text)
        fields[state] = field
    return fields


def _joints_of_model(interface: JointStateInterface, root: NodeHandle, filters: bool) -> list[str]:
    """The joints of the hardware in alphabetical order; with `filters` those that move in the robot_description.

    Raises SlidectlError: there is no description, or it is not a URDF.
    """
    joints = robot_of_model(root).joints
    moving = {name for name, joint in joints.items() if joint.type in _MOVING}
    return [name for name in interface.names() if name in moving or not filters]
