"""Curves from fields of live topics, of recordings, and from columns of the CSV files of `echo -p`.

A field with several numbers (an array, a message) gives one curve per number. Nothing is drawn here.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slidectl import input_files, names
from slidectl.errors import AmbiguousName, BadFile, Refused, UnknownName, UsageError, listing
from slidectl.extensions.viewing.plots import Curve
from slidectl.fault_kinds import QUANTITIES
from slidectl.msgs.field_path import NoElement, Selection, select
from slidectl.msgs.schema import PRIMITIVES, TIMES, Schema, from_typedefs
from slidectl.traces import JOINT_UNITS, number

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.extensions.recording.recording_files import Recording

FILES = (".bag", ".mcap", ".csv")
_JOINT_STATE = "sensor_msgs/JointState"
_SECOND = 10**9
_MOST_ELEMENTS = 32
_UNITS = {
    "geometry_msgs/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/Accel": {"linear": "m/s²", "angular": "rad/s²"},
    "geometry_msgs/Wrench": {"force": "N", "torque": "N·m"},
    "geometry_msgs/Pose": {"position": "m"},
    "geometry_msgs/PointStamped": {"point": "m"},
    "geometry_msgs/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/Transform": {"translation": "m"},
    "sensor_msgs/Imu": {"angular_velocity": "rad/s", "linear_acceleration": "m/s²"},
    "rosgraph_msgs/Clock": {"clock": "s"},
    "std_msgs/Header": {"stamp": "s"},
    "control_msgs/JointControllerState": {"time_step": "s"},
}
"""Type -> field -> unit of the field and its parts, where the message definition states it."""
_UNITS_OF_ANY_JOINT = {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N·m or N"}
"""Units for joints of unknown type."""
_RATES = {"position": "velocity", "velocity": "acceleration"}


# --- what a text means ------------------------------------------------------------------------------------------------


def braces_expanded(text: str) -> list[str]:
    """Expand `state/{a,b}` as a shell does: `state/a`, `state/b`."""
    found = re.search(r"\{([^{}]*,[^{}]*)\}", text)
    if found is None:
        return [text]
    return [
        whole
        for part in found[1].split(",")
        for whole in braces_expanded(text[: found.start()] + part + text[found.end() :])
    ]


def _numbers_in(schema: Schema, path: str) -> list[str]:
    """The paths of the numbers at a path: itself, or those inside a message.

    Raises:
        UnknownName, UsageError: no such field, or no number in it.
    """
    root = schema.root
    selection = select(schema.fields, root, path)
    if selection.type in PRIMITIVES - {"string"} and selection.depth <= 1:
        return [path]
    found: list[str] = []
    for name, kind, _ in schema.fields(selection.type):
        if kind not in ("std_msgs/Header", "string"):
            with suppress(UsageError):  # a message inside that has no numbers
                found += _numbers_in(schema, f"{path}/{name}".lstrip("/"))
    if found:
        return found
    what = f"{path} of {root}" if path else root
    if selection.depth > 1:
        raise UsageError(f"{what} is a list of lists", "choose an element: NAME[0]/FIELD")
    known = [name for name, kind, _ in schema.fields(root) if kind != "string"]
    raise UsageError(f"{what} is {selection.type}, which is not a number", f"other fields of {root}: {listing(known)}")


class Units:
    """The units of fields, from the message types and, with a daemon, from its joints and controllers."""

    def __init__(self, client: Client | None = None) -> None:
        robots = client.robots() if client else []
        self._joints = {
            names.join(robot["namespace"], joint["name"]): joint["type"]
            for robot in robots
            for joint in robot["joints"]
        }
        self._client = client
        self._controllers: dict[str, tuple[str, str]] = {}

    def of_joint(self, joint: str, quantity: str) -> str:
        """The unit of a joint's quantity; `joint` is the full name."""
        return JOINT_UNITS.get(self._joints.get(joint, ""), _UNITS_OF_ANY_JOINT).get(quantity, "")

    def of(self, topic: str, root: str, path: str, selection: Selection) -> str:
        """The unit of a field in messages of type `root`; empty when unknown."""
        unit = ""
        for step in selection.steps:
            unit = _UNITS.get(step.owner, {}).get(step.name, unit)
        return unit or ("s" if selection.type in TIMES else "") or self._of_controller(topic, root, path)

    def _of_controller(self, topic: str, root: str, path: str) -> str:
        """The unit of a field of a single-joint controller's command or state, from the controller's type."""
        if root not in ("control_msgs/JointControllerState", "std_msgs/Float64") or self._client is None:
            return ""
        space = names.parent(topic)
        if space not in self._controllers:
            about = self._client.params.get(space, None)
            about = about if isinstance(about, dict) else {}
            self._controllers[space] = str(about.get("type", "")), str(about.get("joint", ""))
        kind, joint = self._controllers[space]
        taken = re.match(r"(effort|velocity|position)_controllers/Joint(Position|Velocity|Effort)Controller\Z", kind)
        if taken is None:
            return ""
        command, controlled = taken[1], taken[2].lower()
        joint = names.join(names.parent(space), joint)
        if path in ("set_point", "process_value", "error", "data"):
            return self.of_joint(joint, controlled)
        if path == "process_value_dot":
            return self.of_joint(joint, _RATES.get(controlled, ""))
        return self.of_joint(joint, command) if path == "command" else ""


class TopicCurves:
    """Messages of one topic as curves. The curves exist from the first message on, which gives the array lengths."""

    def __init__(self, topic: str, schema: Schema, units: Units) -> None:
        self.topic = topic
        self.curves: list[Curve] = []
        self._schema = schema
        self._units = units
        self._fields: dict[str, tuple[Selection, Selection | str, dict[int, Curve]]] = {}
        """Path -> selection; selection of joint names, or the unit; index -> curve."""
        self.last = -math.inf
        """Simulated time of the last message, s."""

    def add(self, field: str) -> None:
        """Add the curves of a field; the whole message when it is empty. Raises UnknownName, UsageError."""
        fields_of, root = self._schema.fields, self._schema.root
        for path in _numbers_in(self._schema, field):
            selection = select(fields_of, root, path)
            about: Selection | str
            if root == _JOINT_STATE and path.startswith(QUANTITIES):
                about = select(fields_of, root, re.sub(r"^\w+", "name", path))
            else:
                about = self._units.of(self.topic, root, path, selection)
            self._fields.setdefault(path, (selection, about, {}))

    def take(self, time: float, message: Any) -> None:
        """Add the samples of a message at `time` s. Raises as the function `take`."""
        self.last = time
        for path, (selection, about, curves) in self._fields.items():
            try:
                value = selection.read(message)
            except NoElement:
                if not curves:
                    raise
                value = []
            values = value if isinstance(value, list) else [value]
            if len(values) > _MOST_ELEMENTS:
                raise UsageError(
                    f"{path} of {self.topic} has {len(values)} elements, of which {_MOST_ELEMENTS} can be drawn",
                    f"choose some: '{path}[0:4]'",
                )
            for place in range(max(len(values), len(curves))):
                if place not in curves:
                    curves[place] = self._curve(path, place if isinstance(value, list) else None, about, message)
                curves[place].times.append(time)  # type: ignore[union-attr]
                curves[place].values.append(number(values[place]) if place < len(values) else math.nan)  # type: ignore[union-attr]

    def _curve(self, path: str, place: int | None, about: Selection | str, message: Any) -> Curve:
        label = path if place is None else f"{path} {place}" if path.endswith("]") else f"{path}[{place}]"
        curve = Curve(f"{self.topic}/{label}", unit=about if isinstance(about, str) else "")
        if not isinstance(about, str):
            with suppress(NoElement, IndexError):
                found = about.read(message)
                curve.about = found if place is None else found[place]
            joint = names.join(names.parent(self.topic), curve.about)
            curve.unit = self._units.of_joint(joint, path.partition("[")[0])
        self.curves.append(curve)
        return curve

    def forget(self) -> None:
        """Discard all samples so far."""
        self.keep_since(math.inf)
        self.last = -math.inf

    def keep_since(self, time: float) -> None:
        """Discard samples before `time`."""
        for curve in self.curves:
            assert isinstance(curve.times, array)
            assert isinstance(curve.values, array)
            old = bisect_left(curve.times, time)
            del curve.times[:old], curve.values[:old]


def _by_topic(
    fields: Sequence[str], look_up: Callable[[str], tuple[str, Schema, str]], units: Units
) -> dict[str, TopicCurves]:
    """Topic -> its curves. `look_up` returns the topic, its schema and the field of a text."""
    found: dict[str, TopicCurves] = {}
    for text in (whole for field in fields for whole in braces_expanded(field)):
        topic, schema, field = look_up(text)
        found.setdefault(topic, TopicCurves(topic, schema, units)).add(field)
    return found


# --- where they are from ----------------------------------------------------------------------------------------------


def of_live(client: Client, fields: Sequence[str], namespace: str = "/") -> dict[str, TopicCurves]:
    """Topic -> its curves, for live messages. Raises UnknownName, AmbiguousName, Unused, UsageError."""

    def look_up(text: str) -> tuple[str, Schema, str]:
        found = client.resolve("topic", text, namespace=namespace, role="publishers", with_field=True)
        return found["name"], from_typedefs(found["typedefs"]), found["field"]

    return _by_topic(fields, look_up, Units(client))


def of_recording(recording: Recording, fields: Sequence[str], namespace: str = "/") -> dict[str, TopicCurves]:
    """Topic -> its curves. Raises UnknownName, AmbiguousName, UsageError, BadRecording."""

    def look_up(text: str) -> tuple[str, Schema, str]:
        topic, field = recording.topic_and_field(text, namespace)
        return topic, recording.schema(topic), field

    found = _by_topic(fields, look_up, Units())
    for record in recording.records(set(found)):
        take(found, record.channel.topic, record.time_ns, recording.message(record))
    return found


def take(found: Mapping[str, TopicCurves], topic: str, time_ns: int, message: Any) -> None:
    """Add a message. When simulated time goes back (a reset), all earlier samples are discarded.

    Raises:
        NoElement: the first message has no such element. UsageError: too many elements.
    """
    time = time_ns / _SECOND
    if time < found[topic].last:
        for messages in found.values():
            messages.forget()
    found[topic].take(time, message)


def curves_of(found: Mapping[str, TopicCurves], all_or_none: bool = False) -> list[Curve]:
    """All curves; with `all_or_none` none until all topics have samples."""
    every = [messages.curves for messages in found.values()]
    if all_or_none and not all(curves and all(len(curve.times) for curve in curves) for curves in every):
        return []
    return [curve for curves in every for curve in curves]


def of_csv(path: Path, fields: Sequence[str]) -> tuple[float, list[Curve]]:
    """The start time (s) and the columns of a CSV file of `echo -p` or `plot --save`; without fields all numeric
    columns.

    Raises:
        BadFile, UnknownName, AmbiguousName. Refused: there are no values.
    """
    texts = [whole for field in fields for whole in braces_expanded(field)]
    curves: dict[str, Curve] = {}
    header: list[str] = []
    unknown, begin = set(texts), math.inf
    try:
        with input_files.opened_text(path, input_files.LARGEST, newline="", pipes=True) as file:
            for row in (reader := csv.reader(file)):
                if row and row[0] == "%time":  # repeated where the length of an array changes
                    header = row
                    found = {text: _columns(header[1:], text) for text in texts}
                    unknown -= {text for text, columns in found.items() if columns}
                    chosen = [name for columns in found.values() for name in columns]
                    numbers = [name for name in header[1:] if not name.startswith("field.header.")]
                    for name in chosen if texts else numbers:
                        curves.setdefault(name, Curve(name))
                elif not header:
                    raise BadFile("the first column is not %time, as 'slidectl echo -p' writes it", str(path), 1)
                elif row:
                    time = int(row[0]) / _SECOND
                    begin = min(begin, time)
                    for name, cell in zip(header[1:], row[1:], strict=False):
                        if not cell or (curve := curves.get(name)) is None:
                            continue
                        if not texts and not curve.times and not _is_number(cell):
                            del curves[name]
                            continue
                        curve.times.append(time)  # type: ignore[union-attr]
                        curve.values.append(float(cell))  # type: ignore[union-attr]
    except UnicodeDecodeError:
        raise BadFile("this is not UTF-8 text", str(path)) from None
    except OverflowError:
        raise BadFile("the time is too large", str(path), reader.line_num) from None
    except ValueError as error:
        raise BadFile(
            f"this is not a number: {str(error).rpartition(':')[2].strip()}", str(path), reader.line_num
        ) from None
    except (OSError, csv.Error) as error:
        raise BadFile(f"cannot be read: {getattr(error, 'strerror', None) or error}", str(path)) from None
    if unknown:
        raise UnknownName("column", min(unknown), header[1:])
    full = [curve for curve in curves.values() if curve.times]
    if texts and len(full) < len(curves):
        raise Refused(f"no values of {', '.join(name for name, curve in curves.items() if not curve.times)} in {path}")
    if not full:
        raise Refused(f"no values in {path}")
    return begin, full


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        float(text)
        return True
    return False


def _columns(columns: Sequence[str], text: str) -> list[str]:
    """The columns that a text (`position[0]`, `joint_states/position[0]`, `field.position0`, array `position`) selects.

    Raises:
        AmbiguousName.
    """

    def plain(name: str) -> str:
        return "." + re.sub(r"\[(\d+)\]", r"\1", name.removeprefix("field.")).replace("/", ".").strip(".")

    meant: dict[str, list[str]] = {}
    """Column, or array -> its columns."""
    for name in columns:
        for whole in dict.fromkeys((name, re.sub(r"(\d+|\[\d+\])\Z", "", name))):
            meant.setdefault(whole, []).append(name)
    wanted = plain(text)
    fitting = [name for name in meant if name == text or plain(name) == wanted]
    fitting = fitting or [name for name in meant if wanted.endswith(plain(name)) or plain(name).endswith(wanted)]
    if len(fitting) > 1:
        raise AmbiguousName("column", text, fitting, "write the full name")
    return meant[fitting[0]] if fitting else []
