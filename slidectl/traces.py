"""Traces: the values of a joint or of a topic's field over time, live or from a recording. For slidectl.measures.

A joint is named `joint1` or `slider/joint1`, followed by `/velocity` or `/effort` for these; a field is named
`joint_states/position[0]`. A short name is the unique end of a full one. The value of a vector is its length, that of a
list of vectors the length of their sum.
"""

from __future__ import annotations

import math
from binascii import a2b_base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slidectl import measures, names
from slidectl.errors import UnknownName, UsageError, listing
from slidectl.fault_kinds import QUANTITIES
from slidectl.measures import Array, Measured, NoMeasure
from slidectl.msgs.field_path import select
from slidectl.msgs.schema import Schema, from_typedefs, nanoseconds

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.extensions.recording.recording_files import Recording
    from slidectl.msgs.typed import ResolveResponseMsg

_TURNING = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}
JOINT_UNITS = {
    "prismatic": {"position": "m", "velocity": "m/s", "effort": "N"},
    "revolute": _TURNING,
    "continuous": _TURNING,
}
"""Units by the type of the joint."""
_JOINT_STATE = "sensor_msgs/JointState"
_SECOND = 10**9
_LONGEST_QUEUE = 1_000_000
_NOW = 1e-9
"""A request for the last 1e-9 s gives one sample: the present one."""


# --- a trace and its measures -----------------------------------------------------------------------------------------


@dataclass
class JointOrFieldTrace:
    """Values over simulated time (s); all arrays have the shape (n,). SI units."""

    name: str
    times: Array
    values: Array
    unit: str = ""
    """The unit of the values; empty when it is not known."""
    velocities: Array | None = None
    efforts: Array | None = None
    """For joints only."""
    effort_unit: str = ""
    set_points: Array | None = None
    """The desired values, if a field with them was given."""
    lower: float = -math.inf
    upper: float = math.inf
    max_effort: float = math.nan
    """The largest effort; nan, or for bounds infinite, when not known."""

    def since(self, time: float) -> JointOrFieldTrace:
        """The samples from `time` (s) on."""
        here = self.times >= time - 1e-9
        cut: dict[str, Any] = {name: each[here] for name, each in vars(self).items() if isinstance(each, np.ndarray)}
        return replace(self, **cut)

    def measure(
        self, name: str, set_point: float | None = None, start: float | None = None, band: float = measures.BAND
    ) -> Measured:
        """Compute one of MEASURES.

        Args:
            set_point: the end of the step (by default its last value), or the value that errors are relative to.
            start: the time of the step, s; by default when the motion began.
            band: half the settling band, as a part of the step.

        Raises:
            UnknownName: no such measure. NoMeasure: there are not enough samples.
        """
        if name not in MEASURES:
            raise UnknownName("measure", name, list(MEASURES))
        _, _, kind, compute = MEASURES[name]
        if kind == "step":
            if set_point is None and self.set_points is not None and len(self.set_points):
                set_point = float(self.set_points[-1])
            more = {"band": band} if name == "settling" else {}
            return compute(self.times, self.values, set_point, start, **more)
        if kind == "error":
            wanted = self.set_points if set_point is None else set_point
            if wanted is None:
                raise NoMeasure("an error needs what the value was to be: a set point")
            return compute(self.times, self.values, wanted)
        if kind == "joint" and self.efforts is None:
            raise NoMeasure(f"{self.name} has no effort: that is measured of a joint")
        return compute(self)

    def holds(self, condition: str, wanted: float, tolerance: float = 0.0) -> tuple[bool, Measured]:
        """Check that every value is `near` (within the tolerance), `above` or `below` a number, or `equals` it.

        Returns:
            The result, and the value that violates the condition most, or is closest to violating it.

        Raises:
            UnknownName: no such condition. NoMeasure: there are no samples.
        """
        values = self.values
        excesses = {
            "near": np.maximum(wanted - tolerance - values, values - (wanted + tolerance)),
            "above": wanted - values,
            "below": values - wanted,
            "equals": np.abs(values - wanted),
        }
        if condition not in excesses:
            raise UnknownName("condition", condition, list(excesses))
        if not len(values):
            raise NoMeasure("there are no samples")
        excess = excesses[condition]
        worst = int(np.argmax(np.where(np.isnan(excess), np.inf, excess)))
        holds = excess[worst] < 0 if condition in ("above", "below") else excess[worst] <= 0
        return bool(holds), Measured(values[worst], self.times[worst])

    def unit_of(self, name: str) -> str:
        """The unit of a measure; empty for a count, and when the unit of the values is not known."""
        unit = MEASURES[name].unit
        own = {"value": self.unit, "effort": self.effort_unit, "value·s": self.unit and f"{self.unit}·s"}
        return own.get(unit, unit)


class Measure(NamedTuple):
    """A measure: its description, its unit, and the function that computes it."""

    help: str
    unit: str
    kind: str
    """What it is measured from: `step`, `error`, `joint`, or `values`."""
    compute: Callable[..., Measured]
    """The function. For a step or an error it takes times, values and more; else the trace."""


MEASURES: dict[str, Measure] = {
    "rise": Measure("Rise time, from 10 % to 90 % of the step", "s", "step", measures.rise_time),
    "overshoot": Measure("Overshoot, in % of the step", "%", "step", measures.overshoot),
    "settling": Measure("Time until it stays within 2 % of the step", "s", "step", measures.settling_time),
    "error": Measure("Steady-state error, of the last tenth", "value", "error", measures.steady_state_error),
    "rms-error": Measure("Root of the mean square error", "value", "error", measures.rms),
    "max-error": Measure("Largest error", "value", "error", measures.peak),
    "iae": Measure("Integral of the absolute error", "value·s", "error", measures.integral_of_absolute_error),
    "effort-rms": Measure(
        "Root of the mean square effort", "effort", "joint", lambda trace: measures.rms(trace.times, trace.efforts)
    ),
    "effort-peak": Measure(
        "Largest effort", "effort", "joint", lambda trace: measures.peak(trace.times, trace.efforts)
    ),
    "saturation": Measure(
        "Time at the effort limit", "s", "joint",
        lambda trace: measures.saturation_time(trace.times, trace.efforts, trace.max_effort),
    ),
    "energy": Measure(
        "Work that the actuator did", "J", "joint",
        lambda trace: measures.energy(trace.times, trace.efforts, trace.velocities),
    ),
    "limit-hits": Measure(
        "Number of contacts with a bound", "", "values",
        lambda trace: measures.limit_hits(trace.times, trace.values, trace.lower, trace.upper),
    ),
    "contact": Measure(
        "Time in contact, of a force", "s", "values", lambda trace: measures.contact_time(trace.times, trace.values)
    ),
    "peak-force": Measure(
        "Largest force, of a force", "value", "values", lambda trace: measures.peak(trace.times, trace.values)
    ),
}  # fmt: skip


# --- joints -----------------------------------------------------------------------------------------------------------


def _find_joint(text: str, known: Sequence[str], namespace: str) -> tuple[str, str] | None:
    """The full name of the joint that `text` means, and the quantity; None when there is none. Raises AmbiguousName."""
    if "[" in text:
        return None
    head, _, tail = text.rpartition("/")
    ways = [(text, "position")] + ([(head, tail)] if head and tail in QUANTITIES else [])
    for name, quantity in ways:
        with suppress(UnknownName):
            return names.resolve(name, known, kind="joint", namespace=namespace), quantity
    return None


def _joint_trace(name: str, quantity: str, rows: Array, about: Mapping[str, Any]) -> JointOrFieldTrace:
    """The trace of rows of time, position, velocity, effort (n, 4); `about` is the joint's slidectl/JointInfo."""
    units = JOINT_UNITS.get(str(about.get("type")), dict.fromkeys(QUANTITIES, ""))
    columns = dict(zip(QUANTITIES, rows.T[1:], strict=True))
    is_position = quantity == "position"
    bounds = {key: about[key] for key in ("lower", "upper") if is_position and about.get(key) is not None}
    if about.get("max_effort") is not None:
        bounds["max_effort"] = about["max_effort"]
    return JointOrFieldTrace(
        name if is_position else f"{name}/{quantity}", rows[:, 0], columns[quantity], units[quantity],
        columns["velocity"], columns["effort"], units["effort"], **bounds
    )  # fmt: skip


# --- values of messages -----------------------------------------------------------------------------------------------


def number(value: Any) -> float:
    """Convert the value of a field to one number. Raises UsageError when that is not possible."""
    if isinstance(value, bool | int | float):
        return float(value)
    if value is None:
        return math.nan
    if isinstance(value, dict) and value.keys() == {"secs", "nsecs"}:
        return float(value["secs"] + value["nsecs"] / _SECOND)
    if isinstance(value, dict) and value.keys() == {"x", "y", "z"}:
        return math.hypot(*map(number, value.values()))
    if isinstance(value, list) and all(isinstance(one, dict) and one.keys() == {"x", "y", "z"} for one in value):
        return math.hypot(*(sum(number(one[axis]) for one in value) for axis in "xyz"))
    raise UsageError(f"{str(value)[:80]} is not a number", "choose an element or a field: NAME/position[0]")


class _Samples:
    """Collects messages of one topic, and makes a trace of a field, with another field as set points if given."""

    def __init__(self, name: str, schema: Schema, field: str, set_point: str) -> None:
        """`field` may be empty if the type has only one field. Raises UnknownName, UsageError."""
        inside = schema.fields(schema.root)
        path = inside[0].name if not field and len(inside) == 1 else field
        self.name = f"{name}/{field}" if field else name
        paths = [path, set_point] if set_point else [path]
        self._paths = [select(schema.fields, schema.root, each) for each in paths]
        self.rows: list[list[float]] = []

    def add(self, time_ns: int, message: Any) -> None:
        """Add a message. Raises UsageError: no number. NoElement: the array is too short."""
        self.rows.append([time_ns / _SECOND, *(number(path.read(message)) for path in self._paths)])

    def trace(self) -> JointOrFieldTrace:
        rows = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), 1 + len(self._paths))
        return JointOrFieldTrace(
            self.name, rows[:, 0], rows[:, 1], set_points=rows[:, 2] if len(self._paths) > 1 else None
        )


# --- live -------------------------------------------------------------------------------------------------------------


def live(
    client: Client,
    target: str,
    *,
    last: float = 0.0,
    duration: float = 0.0,
    set_point: str = "",
    namespace: str = "/",
    timeout: float | None = None,
    begun: Callable[[], object] = lambda: None,
) -> JointOrFieldTrace:
    """A trace of the last or of the next simulated seconds; without either, of this moment alone.

    A joint has one sample per cycle in the coming seconds, and one per ten cycles in the past, as far as stored. A
    field has one sample per message; its past is not stored.

    Args:
        set_point: a field of the same topic that holds the desired value.
        timeout: wall seconds; the client's when not given.
        begun: called after a joint's samples are requested: what it publishes takes effect after the first sample.

    Raises:
        UnknownName, AmbiguousName, Unused: no such joint or topic. UsageError: the past of a topic, or not a number.
        NoMeasure: messages were lost, or none arrived. TimedOut.
    """
    robots = client.robots()
    joints = {
        names.join(robot["namespace"], joint["name"]): (robot["name"], joint)
        for robot in robots
        for joint in robot["joints"]
        if joint["position"] is not None
    }
    found = _find_joint(target, list(joints), namespace)
    if found is None:
        try:
            topic = client.resolve("topic", target, namespace=namespace, role="publishers", with_field=True)
        except UnknownName as error:
            error.hint = f"{error.hint}\njoints: {listing(joints)}"
            raise
        if last:
            raise UsageError(
                f"{topic['name']} is a topic, and the past is kept of joints only",
                "name a joint, measure the coming seconds, or record it first",
            )
        return _of_topic(client, topic, duration, set_point, timeout)
    if set_point:
        raise UsageError(f"{target} is a joint, whose set point is a number", "a field can be the set point of a field")
    full, quantity = found
    robot, joint = joints[full]
    request = {"robot": robot, "joint": joint["name"], "last": last if last or duration else _NOW, "duration": duration}
    call = client.call_async("/slidectl/trace", request)
    begun()
    samples = a2b_base64(client.answer(call, timeout=timeout)["samples"])
    rows = np.frombuffer(samples, dtype="<f8").reshape(-1, 1 + len(QUANTITIES))
    return _joint_trace(full, quantity, rows, joint)


def _of_topic(
    client: Client, found: ResolveResponseMsg, duration: float, set_point: str, timeout: float | None
) -> JointOrFieldTrace:
    """The trace of a topic's field; `found` is the response of slidectl/Resolve."""
    samples = _Samples(found["name"], from_typedefs(found["typedefs"]), found["field"], set_point)

    def add(published: dict[str, Any]) -> None:
        samples.add(nanoseconds(published["time"]), published["msg"])

    sleep = client.call_async("/slidectl/sleep", {"duration": duration}) if duration else ""
    with client.subscribe(found["name"], queue_length=_LONGEST_QUEUE, take=add) as subscription:
        if duration:
            client.answer(sleep, timeout=timeout)
        else:
            if client.call("/slidectl/status")["paused"] and not samples.rows:
                raise NoMeasure(
                    f"{found['name']} publishes nothing while the simulation is paused",
                    "name a joint, whose state is always available, or resume the simulation: slidectl sim resume",
                )
            client.wait_until(lambda: bool(samples.rows), timeout, f"no message on {found['name']}")
    if subscription.dropped:
        raise NoMeasure(f"{subscription.dropped} messages of {found['name']} were lost: the reader is too slow")
    return samples.trace()


# --- from recordings --------------------------------------------------------------------------------------------------


def recorded(
    recording: Recording, target: str, *, last: float = 0.0, set_point: str = "", namespace: str = "/"
) -> JointOrFieldTrace:
    """A trace of a whole recording, or of its last seconds. Joints are those of sensor_msgs/JointState messages.

    Raises:
        UnknownName, AmbiguousName: not in the recording. UsageError: no number. BadRecording.
    """
    joints = dict(_recorded_joints(recording))
    found = _find_joint(target, list(joints), namespace)
    if found is not None and not set_point:
        full, quantity = found
        topic, joint = joints[full]
        rows = [_joint_row(message, joint, time_ns) for time_ns, message in _messages(recording, topic)]
        trace = _joint_trace(full, quantity, np.array(rows, dtype=np.float64).reshape(-1, 1 + len(QUANTITIES)), {})
    else:
        try:
            topic, field = recording.topic_and_field(target, namespace)
        except UnknownName as error:
            error.hint = f"{error.hint}\njoints: {listing(joints)}"
            raise
        samples = _Samples(topic, recording.schema(topic), field, set_point)
        for time_ns, message in _messages(recording, topic):
            samples.add(time_ns, message)
        trace = samples.trace()
    end_ns = recording.summary().end_ns
    return trace if not last or end_ns is None else trace.since(end_ns / _SECOND - last)


def _messages(recording: Recording, topic: str) -> Iterator[tuple[int, Any]]:
    return ((record.time_ns, recording.message(record)) for record in recording.records({topic}))


def _recorded_joints(recording: Recording) -> Iterator[tuple[str, tuple[str, str]]]:
    """The full names of joints, with topic and joint name, from the first message of each topic."""
    for topic in {channel.topic: None for channel in recording.channels if channel.type == _JOINT_STATE}:
        for _, message in _messages(recording, topic):
            yield from ((names.join(names.parent(topic), joint), (topic, joint)) for joint in message["name"])
            break


def _joint_row(message: Any, joint: str, time_ns: int) -> list[float]:
    place = message["name"].index(joint) if joint in message["name"] else len(message["name"])
    states = (message[quantity] for quantity in QUANTITIES)
    return [time_ns / _SECOND, *(state[place] if place < len(state) else math.nan for state in states)]
