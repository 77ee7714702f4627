"""Messages of the daemon, in the shape of ROS 1, as messages of ROS 2 and back.

The classes of ROS 2 say which fields there are; a field is converted to the one of the same name. What differs between
the two besides is in the tables of this module.
"""

from __future__ import annotations

import math
import re
from binascii import a2b_base64, b2a_base64
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from slidectl import msgs
from slidectl.errors import SlidectlError
from slidectl.msgs import Field, Message
from slidectl.msgs.schema import BYTES, CODES, FLOATS, PRIMITIVES, SCALAR, TIMES, nanoseconds

_MANAGER = "controller_manager_msgs"
_TYPES = {
    "time": "builtin_interfaces/msg/Time",
    "duration": "builtin_interfaces/msg/Duration",
    "rosgraph_msgs/Log": "rcl_interfaces/msg/Log",
    "slidectl/PidState": "control_msgs/msg/PidState",
    "slidectl/LifecycleState": "lifecycle_msgs/msg/State",
    "slidectl/SwitchControllers": f"{_MANAGER}/srv/SwitchController",
    **{
        f"slidectl/{name}": f"{_MANAGER}/msg/{name}"
        for name in (
            *("ChainConnection", "ControllerManagerActivity", "ControllerState", "HardwareComponentState"),
            *("HardwareInterface", "NamedLifecycleState"),
        )
    },
    **{
        f"slidectl/{name}": f"{_MANAGER}/srv/{name}"
        for name in (
            *("CleanupController", "ConfigureController", "ListControllers", "ListHardwareComponents"),
            *("ListHardwareInterfaces", "SetHardwareComponentState"),
        )
    },
    "slidectl/JointTrajectoryControllerState": "control_msgs/msg/JointTrajectoryControllerState",
    "slidectl/QueryTrajectoryState": "control_msgs/srv/QueryTrajectoryState",
}
"""Types of the daemon that have another name or package in ROS 2."""
_FIELDS = {
    "control_msgs/JointTrajectoryControllerState": {"desired": "reference", "actual": "feedback"},
    "controller_manager_msgs/SwitchControllerRequest": {
        "start_controllers": "activate_controllers",
        "stop_controllers": "deactivate_controllers",
        "start_asap": "activate_asap",
    },
    "sensor_msgs/CameraInfo": {"D": "d", "K": "k", "R": "r", "P": "p"},
}
"""Type of ROS 1 -> its fields that have another name in ROS 2."""
_LEFT_OUT = {"std_msgs/Header": {"seq": 0}}
"""Type of ROS 1 -> its fields that ROS 2 does not have, with the value that they get."""
_ADDED = {"control_msgs/QueryTrajectoryStateResponse": {"success": True}}
"""Type of ROS 1 -> fields that only ROS 2 has, with a value other than their default."""
_STATES = {"running": "active", **dict.fromkeys(("initialized", "stopped", "waiting", "aborted"), "inactive")}
"""States of a controller -> those of ROS 2, which activates one that is inactive."""
_STATES_OF_ROS2 = {"active": "running", "inactive": "stopped", "unconfigured": "initialized", "finalized": "aborted"}
_LOG_LEVELS = {1: 10, 2: 20, 4: 30, 8: 40, 16: 50}
OWN_PACKAGES = frozenset({"slidectl", "rosapi", "actionlib_msgs"})
"""Packages that ROS 2 never has."""
_NUMBERS = {
    "boolean": ("bool",), "float": ("float32",), "double": ("float64",), "octet": ("byte", "uint8", "char"),
    "uint8": ("uint8", "char"), "int8": ("int8", "byte"),
    **{kind: (kind,) for kind in ("int16", "uint16", "int32", "uint32", "int64", "uint64")},
}  # fmt: skip
"""Number types of ROS 2 -> those of ROS 1 that hold the same values."""
_LAST_SECOND = 2**31 - 1
_SEQUENCE = re.compile(r"sequence<(?P<type>[^,]*)(, (?P<most>\d+))?>")
_ARRAY = re.compile(r"(?P<type>.*)\[(?P<length>\d+)\]")
_TEXT = re.compile(r"w?string(<(?P<most>\d+)>)?")

Convert = Callable[[Any], Any]


class NotInRos2(SlidectlError):
    """A type that ROS 2 lacks, or has with other fields."""

    def __init__(self, message: str, hint: str = "", package: str = "") -> None:
        """`package` is one that ROS 2 lacks with all its types."""
        super().__init__(message, hint)
        self.package = package


class Conversion(NamedTuple):
    """A message type in both: its class in ROS 2, and the functions that convert a whole message."""

    name: str
    ros2_class: Any
    to_ros2: Callable[[Message], Any]
    """Raises ValueError: a list or text exceeds its bound in ROS 2."""
    from_ros2: Callable[[Any], Message]


def ros2_name(name: str, kind: str = "msg") -> str:
    """The name that ROS 2 has for a type of the daemon: `std_msgs/Float64` is `std_msgs/msg/Float64`."""
    package, _, stem = name.partition("/")
    return _TYPES.get(name) or f"{package}/{kind}/{stem}"


def ros1_name(name: str) -> str:
    """The daemon's name for a type of ROS 2; of types that the daemon does not know, what it would be."""
    known = {theirs: ours for ours, theirs in _TYPES.items() if "/" in ours}
    package, _, stem = name.partition("/")
    plain = f"{package}/{stem.rpartition('/')[2]}"
    return plain if msgs.exists(plain) or msgs.service_exists(plain) else known.get(name, plain)


@cache
def conversion(name: str) -> Conversion:
    """The conversion of a message type of the daemon. Raises UnknownName, NotInRos2."""
    return _conversion(name, _class(ros2_name(name)), msgs.fields(name))


class ServiceConversion(NamedTuple):
    """A service type in both."""

    name: str
    ros2_class: Any
    request: Conversion
    response: Conversion


@cache
def service_conversion(name: str) -> ServiceConversion:
    """The conversion of a service type of the daemon. Raises UnknownName, NotInRos2."""
    request, response = msgs.request_type(name), msgs.response_type(name)
    ros2_class = _class(ros2_name(name, "srv"))
    return ServiceConversion(
        name,
        ros2_class,
        _conversion(request, ros2_class.Request, msgs.fields(request)),
        _conversion(response, ros2_class.Response, msgs.fields(response)),
    )


class ActionConversion(NamedTuple):
    """An action type in both."""

    name: str
    ros2_class: Any
    goal: Conversion
    feedback: Conversion
    result: Conversion


@cache
def action_conversion(name: str) -> ActionConversion:
    """The conversion of an action type of the daemon, `pkg/Name` as in ROS 2. Raises UnknownName, NotInRos2."""
    ros2_class = _class(ros2_name(name, "action"))
    goal, feedback, result = (
        _conversion(f"{name}{part}", getattr(ros2_class, part), msgs.fields(f"{name}{part}"))
        for part in ("Goal", "Feedback", "Result")
    )
    return ActionConversion(name, ros2_class, goal, feedback, result)


def _class(full_name: str) -> Any:
    """The class of a type `pkg/msg/Name`, `pkg/srv/Name` or `pkg/action/Name`. Raises NotInRos2."""
    package, kind, name = full_name.split("/")
    if package in OWN_PACKAGES:
        raise NotInRos2(f"ROS 2 has no package {package}")
    try:
        return getattr(import_module(f"{package}.{kind}"), name)
    except ModuleNotFoundError:
        hint = f"apt install ros-$ROS_DISTRO-{package.replace('_', '-')}, or a wheel of it"
        raise NotInRos2(f"the package {package} is not installed in ROS 2", hint, package) from None
    except AttributeError:
        raise NotInRos2(f"the package {package} of ROS 2 has no {kind}/{name}") from None
    except ImportError as error:
        raise NotInRos2(f"the package {package} of ROS 2 cannot be loaded: {error}") from None


def _conversion(name: str, ros2_class: Any, fields: tuple[Field, ...]) -> Conversion:
    if name == "rosgraph_msgs/Log":
        return _log_conversion(ros2_class)
    if name == "controller_manager_msgs/ControllerState":
        return _controller_conversion(ros2_class)
    theirs = ros2_class.get_fields_and_field_types()
    renamed, left_out, added = _FIELDS.get(name, {}), _LEFT_OUT.get(name, {}), _ADDED.get(name, {})
    there, back = [], []
    for field in fields:
        if field.name in left_out:
            continue
        their_name = renamed.get(field.name, field.name)
        if their_name not in theirs:
            raise NotInRos2(f"{ros2_name(name)} of ROS 2 has no field {their_name}")
        to, fro = _field(name, field, theirs[their_name])
        there.append((field.name, their_name, to))
        back.append((field.name, their_name, fro))

    def to_ros2(message: Message) -> Any:
        made = ros2_class(**added)
        for ours, their_name, convert in there:
            value = message[ours]
            setattr(made, their_name, value if convert is None else convert(value))
        return made

    def from_ros2(message: Any) -> Message:
        made: Message = dict(left_out)
        for ours, their_name, convert in back:
            value = getattr(message, their_name)
            made[ours] = value if convert is None else convert(value)
        return made

    return Conversion(name, ros2_class, to_ros2, from_ros2)


def _field(owner: str, field: Field, theirs: str) -> tuple[Convert | None, Convert | None]:
    """How a field is converted there and back; None for a value that is the same in both. Raises NotInRos2."""
    most: int | None = None
    length: int | None = None
    if sequence := _SEQUENCE.fullmatch(theirs):
        element, most = sequence["type"], int(sequence["most"]) if sequence["most"] else None
    elif array := _ARRAY.fullmatch(theirs):
        element, length = array["type"], int(array["length"])
    else:
        element = theirs
    is_list = element != theirs
    if is_list != (field.array != SCALAR) or (length is not None and length != field.array):
        raise _differs(owner, field, theirs)
    to, fro = _element(owner, field, element, theirs)
    if not is_list:
        return to, fro
    if element == "octet" or field.type not in CODES:
        to, fro = _each(to), _each(fro)
    elif field.type in BYTES:
        to, fro = _to_bytes if length is None else lambda value: list(_to_bytes(value)), _from_bytes
    else:
        to, fro = _floats_to if field.type in FLOATS else None, _list_of
    return _bounded(to, most, field), fro


def _element(owner: str, field: Field, theirs: str, whole: str) -> tuple[Convert | None, Convert | None]:
    kind = field.type
    if theirs in _NUMBERS:
        if kind not in _NUMBERS[theirs]:
            raise _differs(owner, field, whole)
        if theirs == "octet":  # rclpy holds it as bytes of length 1
            is_signed = kind == "byte"
            return (
                lambda value: value.to_bytes(1, "little", signed=is_signed),
                lambda value: int.from_bytes(value, "little", signed=is_signed),
            )
        return (_float_to if kind in FLOATS else None), None
    if text := _TEXT.fullmatch(theirs):
        if kind != "string":
            raise _differs(owner, field, whole)
        return _bounded(None, int(text["most"]) if text["most"] else None, field), None
    if kind in FLOATS and theirs == "builtin_interfaces/Duration":  # seconds in ROS 1
        time = _time_conversion("duration")
        return (
            lambda seconds: time.to_ros2({"secs": 0, "nsecs": round(_float_to(seconds) * 1e9)}),
            lambda value: value.sec + value.nanosec * 1e-9,
        )
    if kind in PRIMITIVES and kind not in TIMES:
        raise _differs(owner, field, whole)
    package, _, name = theirs.partition("/")
    expected = ros2_name(kind).split("/")
    if [package, name] != [expected[0], expected[-1]]:
        raise _differs(owner, field, whole)
    inner = _time_conversion(kind) if kind in TIMES else conversion(kind)
    return inner.to_ros2, inner.from_ros2


@cache
def _time_conversion(kind: str) -> Conversion:
    """The conversion of `time` or `duration`. ROS 2's seconds end in 2038, and its nanoseconds are never negative."""
    ros2_class = _class(_TYPES[kind])

    def to_ros2(time: Message) -> Any:
        seconds, rest = divmod(nanoseconds(time), 10**9)
        return ros2_class(sec=min(seconds, _LAST_SECOND), nanosec=rest)

    return Conversion(kind, ros2_class, to_ros2, lambda time: {"secs": time.sec, "nsecs": time.nanosec})


def _differs(owner: str, field: Field, theirs: str) -> NotInRos2:
    return NotInRos2(f"{owner}.{field.name} is {field.type_text} here, and {theirs} in ROS 2")


def _log_conversion(ros2_class: Any) -> Conversion:
    """rosgraph_msgs/Log has a header and a list of topics, rcl_interfaces/msg/Log a stamp and levels of its own.

    The node `/ns/name` is the logger `ns.name` there.
    """
    time = _time_conversion("time")
    back_levels = {theirs: ours for ours, theirs in _LOG_LEVELS.items()}

    def to_ros2(message: Message) -> Any:
        return ros2_class(
            stamp=time.to_ros2(message["header"]["stamp"]),
            level=_LOG_LEVELS.get(message["level"], 20),
            name=message["name"].strip("/").replace("/", "."),
            **{name: message[name] for name in ("msg", "file", "function", "line")},
        )

    def from_ros2(message: Any) -> Message:
        header = {"seq": 0, "stamp": time.from_ros2(message.stamp), "frame_id": ""}
        level = back_levels.get(int(message.level), 2)
        texts = {name: getattr(message, name) for name in ("msg", "file", "function", "line")}
        return {"header": header, "level": level, "name": "/" + message.name.replace(".", "/"), **texts, "topics": []}

    return Conversion("rosgraph_msgs/Log", ros2_class, to_ros2, from_ros2)


def _controller_conversion(ros2_class: Any) -> Conversion:
    """controller_manager_msgs/ControllerState has claims by interface, in any state; ROS 2 has `joint/quantity`."""
    from slidectl.description import interfaces  # the package is slow to import

    names = {one.quantity: one.type_name for one in interfaces.ALL if not one.beside}

    def to_ros2(message: Message) -> Any:
        required = [
            name
            for claim in message["claimed_resources"]
            for name in interfaces.ros2_commands(claim["hardware_interface"], claim["resources"])
        ]
        state = _STATES.get(message["state"], message["state"])
        return ros2_class(
            name=message["name"],
            state=state,
            type=message["type"],
            required_command_interfaces=required,
            claimed_interfaces=required if state == "active" else [],
        )

    def from_ros2(message: Any) -> Message:
        resources: dict[str, list[str]] = {}
        for claimed in message.required_command_interfaces:
            resource, _, quantity = claimed.rpartition("/")
            resources.setdefault(names.get(quantity, quantity), []).append(resource)
        claims = [{"hardware_interface": name, "resources": claimed} for name, claimed in resources.items()]
        state = _STATES_OF_ROS2.get(message.state, message.state)
        return {"name": message.name, "state": state, "type": message.type, "claimed_resources": claims}

    return Conversion("controller_manager_msgs/ControllerState", ros2_class, to_ros2, from_ros2)


def _float_to(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _floats_to(values: list[Any]) -> list[float]:
    """NaN is null in a message of the daemon."""
    return [math.nan if value is None else value for value in values] if None in values else values


def _to_bytes(value: Any) -> bytes:
    return a2b_base64(value) if isinstance(value, str) else bytes(value)


def _from_bytes(value: Any) -> str:
    return b2a_base64(bytes(value), newline=False).decode("ascii")


def _list_of(values: Any) -> list[Any]:
    """A list of what rclpy holds: an array of Python or of numpy, or a list."""
    return values if isinstance(values, list) else list(values.tolist())


def _each(convert: Convert | None) -> Convert:
    return list if convert is None else lambda values: [convert(value) for value in values]


def _bounded(convert: Convert | None, most: int | None, field: Field) -> Convert | None:
    """`convert`, refusing what is longer than `most`. rclpy checks no bounds."""
    if most is None:
        return convert

    def checked(value: Any) -> Any:
        made = value if convert is None else convert(value)
        if len(made) > most:
            raise ValueError(f"{field.name} has a length of {len(made)}, and at most {most} in ROS 2")
        return made

    return checked
