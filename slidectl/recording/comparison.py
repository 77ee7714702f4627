"""Golden traces: a recording against an earlier one of the same run, exactly or within tolerances."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from slidectl import names, writing
from slidectl.errors import BadFile, Refused, UnknownName, cut
from slidectl.field_path import Selection, select
from slidectl.recording.recording_files import COMPRESSIONS, Record, Recording, opened

LEFT_OUT = ("/rosout",)
"""Topics that are not compared unless a field of them is asked for."""
_SECOND = 10**9
_SHOWN = 60


class Difference(NamedTuple):
    """Where two recordings differ first. `value` and `baseline` are None for a message that only one of them has."""

    topic: str
    field: str
    """Empty for a whole message."""
    time: float
    """Simulated, s."""
    value: Any
    baseline: Any
    tolerance: float

    def __str__(self) -> str:
        place = f"{self.topic}/{self.field}" if self.field else self.topic
        one, other = (
            "no message" if value is None else cut(str(value), _SHOWN) for value in (self.value, self.baseline)
        )
        allowed = f" ± {self.tolerance:g}" if self.tolerance else ""
        return f"{place} at {self.time:.9g} s: {one}, baseline: {other}{allowed}"


def compare(
    run: Recording,
    baseline: Recording,
    fields: Sequence[str] = (),
    tolerances: float | Mapping[str, float] = 0.0,
) -> list[Difference]:
    """The first difference of each field, the earliest first; none when the run is as the baseline.

    Messages belong together that were published on a topic at the same simulated time, in their order.

    Args:
        fields: topics, or `TOPIC/FIELD[I]`, by names as the command line has them; without any all topics of the
            baseline but LEFT_OUT.
        tolerances: how far numbers may be off, of all or by field as it stands in `fields`; 0 compares exactly.

    Raises:
        UnknownName, AmbiguousName: not in the baseline. BadRecording.
    """
    found: list[Difference] = []
    for wanted in fields or [topic for topic in baseline.topics if topic not in LEFT_OUT]:
        allowed = tolerances if isinstance(tolerances, float | int) else tolerances.get(wanted, 0.0)
        topic, field = _named(wanted, baseline)
        found += itertools.islice(_differences(run, baseline, topic, field, allowed), 1)
    return sorted(found, key=lambda difference: difference.time)


def compare_file(
    run: Path,
    baseline: Path,
    fields: Sequence[str] = (),
    tolerances: float | Mapping[str, float] = 0.0,
    update: bool = False,
) -> list[Difference]:
    """`compare` with a .bag or .mcap file, or with that of the run's name in a folder; `update` puts the run there.

    Raises:
        BadFile: there is no such baseline. Refused: it cannot be written. And what `compare` raises.
    """
    kept = baseline if baseline.suffix in COMPRESSIONS else baseline / run.name
    if update:
        opened(run).close()
        try:
            kept.parent.mkdir(parents=True, exist_ok=True)
            writing.replace(kept, run.read_bytes())
        except OSError as error:
            raise Refused(f"cannot write {kept}: {error.strerror or error}") from None
        return []
    if not kept.exists():
        raise BadFile("there is no such baseline", str(kept), hint="make it of this run: --update-baseline")
    with opened(run) as one, opened(kept) as other:
        return compare(one, other, fields, tolerances)


def _named(text: str, baseline: Recording) -> tuple[str, str]:
    """Topic and field. Raises UnknownName, AmbiguousName."""
    for name, field in names.cut_from_field(text):
        with suppress(UnknownName):
            return names.resolve(name, baseline.topics, kind="topic"), field
    raise UnknownName("topic", text, baseline.topics, f"in {baseline.path}")


class _Reader:
    """One topic of a recording, and the field in its messages."""

    def __init__(self, recording: Recording, topic: str, field: str) -> None:
        self.recording = recording
        self.records: Iterator[Record] = recording.records({topic})
        self._field = field
        self._selections: dict[int, Selection] = {}

    def value(self, record: Record) -> Any:
        number = record.channel.number
        if number not in self._selections:
            types = self.recording.codec(record.channel).types
            self._selections[number] = select(lambda name: types.get(name, ()), record.channel.type, self._field)
        return self._selections[number].take(self.recording.message(record))


def _differences(run: Recording, baseline: Recording, topic: str, field: str, tolerance: float) -> Iterator[Difference]:
    ours, theirs = _Reader(run, topic, field), _Reader(baseline, topic, field)
    for one, other in itertools.zip_longest(ours.records, theirs.records):
        if one is None or other is None or one.time_ns != other.time_ns:
            is_ours = other is None or (one is not None and one.time_ns < other.time_ns)
            time = (one if is_ours else other).time_ns / _SECOND
            yield Difference(topic, "", time, "a message" if is_ours else None, None if is_ours else "a message", 0.0)
            return
        if one.channel.md5 != other.channel.md5:
            yield Difference(topic, "", one.time_ns / _SECOND, one.channel.type, other.channel.type, 0.0)
            return
        if one.raw != other.raw:
            for path, value, expected in _leaves(field, ours.value(one), theirs.value(other)):
                if not _is_same(value, expected, tolerance):
                    yield Difference(topic, path, one.time_ns / _SECOND, value, expected, tolerance)


def _leaves(path: str, value: Any, expected: Any) -> Iterator[tuple[str, Any, Any]]:
    """What there is in two values, side by side, with its path."""
    if isinstance(value, dict) and isinstance(expected, dict):
        for name in expected:
            yield from _leaves(f"{path}/{name}" if path else name, value[name], expected[name])
    elif isinstance(value, list) and isinstance(expected, list) and len(value) == len(expected):
        for place, (one, other) in enumerate(zip(value, expected, strict=True)):
            yield from _leaves(f"{path}[{place}]", one, other)
    else:
        yield path, value, expected


def _is_same(value: Any, expected: Any, tolerance: float) -> bool:
    if isinstance(value, float) and isinstance(expected, float):
        return abs(value - expected) <= tolerance or value == expected or (math.isnan(value) and math.isnan(expected))
    if tolerance and isinstance(value, int) and isinstance(expected, int):
        return abs(value - expected) <= tolerance
    return bool(value == expected)
