"""Compares a run with an earlier one (its baseline), exactly or within tolerances.

A baseline is a recording, or a table of chosen fields as a CSV file. A table is small, readable without a library, and
version control shows its changes line by line. Its numbers are exact.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from slidectl import input_files, writing
from slidectl.errors import BadFile, Refused, UsageError, cut, listing
from slidectl.extensions.recording.recording_files import COMPRESSIONS, Recording, opened, topic_and_field
from slidectl.msgs.field_path import NoElement, Selection
from slidectl.writing import CannotWrite

LEFT_OUT = ("/rosout",)
"""Topics that are compared only if a field of them is given."""
TABLE = ".csv"
"""The suffix of a table."""
_FIRST_COLUMNS = ["time", "topic"]
_NOTHING = "nothing"
_UPDATE = "to make this run the baseline: --update-baseline"
_SECOND = 10**9
_SHOWN = 60
_LARGEST_BASELINE = 2**30
"""The most bytes of a recording that becomes a baseline."""


class Difference(NamedTuple):
    """The first difference of two recordings. `value` or `baseline` is None for a message that is missing there."""

    topic: str
    field: str
    """The path of the field; empty for a whole message."""
    time: float
    """Simulated time, s."""
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


def tolerances_of(fields: Sequence[str], tolerance: float) -> dict[str, float]:
    """Tolerances by field, from `TOPIC/FIELD[I]` or `TOPIC/FIELD[I]=TOL`. Raises UsageError."""
    found = {}
    for name, sign, text in (field.partition("=") for field in fields):
        found[name] = _tolerance(text) if sign else tolerance
    return found


def _tolerance(text: str) -> float:
    with suppress(ValueError):
        if 0 <= (tolerance := float(text)) < math.inf:
            return tolerance
    raise UsageError(f"{text!r} is not a tolerance: a number of 0 or more")


def compare(
    run: Recording, baseline: Recording, fields: Mapping[str, float], tolerance: float = 0.0
) -> list[Difference]:
    """The first difference of each field, the earliest first; empty when the run equals the baseline.

    Messages on a topic are matched by simulated time, and by order among those of the same time.

    Args:
        fields: topics or `TOPIC/FIELD[I]`, each with the tolerance of its numbers; 0 compares exactly.
        tolerance: for the topics compared if no fields are given: all of the baseline except LEFT_OUT.

    Raises:
        UnknownName, AmbiguousName, UsageError: not in the baseline. NoElement: in no message of it. BadRecording.
    """
    wanted = fields or {topic: tolerance for topic in baseline.topics if topic not in LEFT_OUT}
    found = (
        _first_difference(run, baseline, *baseline.topic_and_field(text), allowed) for text, allowed in wanted.items()
    )
    return sorted(filter(None, found), key=lambda difference: difference.time)


def compare_file(
    run: Path,
    baseline: Path,
    fields: Mapping[str, float],
    tolerance: float,
    update: bool,
    open_file: Callable[[Path], Recording],
) -> list[Difference]:
    """`compare` with a baseline file; for a folder it is the file in it with the run's name.

    With `update` the run becomes the baseline. For a .csv baseline its columns are compared, or `fields`.

    Args:
        open_file: opens a recording, and may warn of damage.

    Raises:
        BadFile: no such baseline. Refused: it cannot be written, or the run is incomplete. Also what `compare` raises.
    """
    kept = baseline if baseline.suffix in (*COMPRESSIONS, TABLE) else baseline / run.name
    if not update and not kept.exists():
        raise BadFile("the baseline does not exist", str(kept), hint=_UPDATE)
    if kept.suffix == TABLE:
        table = GoldenTable.read(kept) if kept.exists() else GoldenTable({}, {}, "")
        wanted = fields or dict.fromkeys(table.columns, tolerance)
        if not wanted:
            raise UsageError("give the fields of the baseline", "--fields joint_states/position")
        with open_file(run) as recording:
            if update:
                _check_complete(recording)
            new = GoldenTable.of(recording, wanted)
        if not update:
            return new.differences(table, str(kept))
        new.write(kept)
        return []
    if update:
        with opened(run) as recording:
            _check_complete(recording)
        _write(kept, input_files.read_bytes(run, _LARGEST_BASELINE))
        return []
    with open_file(run) as one, open_file(kept) as other:
        return compare(one, other, fields, tolerance)


def _check_complete(run: Recording) -> None:
    """Raise Refused when the run is incomplete."""
    run.refuse_written()
    if run.damage:
        text = f"{run.path} cannot be a baseline: {run.damage}"
        raise Refused(text, f"record it again, or complete it: slidectl bag reindex {run.path}")


def _write(path: Path, content: bytes) -> None:
    """Write a file, and the folders above it. Raises CannotWrite: none of them was made then."""
    made = [folder for folder in path.parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writing.write_whole(path, content)
    except OSError as error:
        for folder in made:
            with suppress(OSError):  # another case may have put its baseline there
                folder.rmdir()
        raise CannotWrite(path, error) from None


# --- tables -----------------------------------------------------------------------------------------------------------


class GoldenTable:
    """A table with a row for each message (time in s, topic), and a column `TOPIC/FIELD[I]` for each number or text.

    Args:
        fields: the fields as on the command line, each with its tolerance.
        topics: the existing topics, each with a function that selects a path in its messages.
        where: where these topics are, for error messages.

    Raises:
        UnknownName, AmbiguousName: no such topic or field.
    """

    def __init__(
        self,
        fields: Mapping[str, float],
        topics: Mapping[str, Callable[[str], Selection]],
        where: str,
    ) -> None:
        self.rows: list[dict[str, str]] = []
        self._tolerances: dict[str, float] = {}
        """The tolerance of each column; the columns are in order of first use."""
        self._selections: dict[str, list[tuple[str, Selection, float]]] = {}
        for wanted, tolerance in fields.items():
            topic, path = topic_and_field(wanted, topics, where)
            self._selections.setdefault(topic, []).append((path, topics[topic](path), tolerance))

    @property
    def topics(self) -> set[str]:
        """The topics with fields in the table."""
        return set(self._selections)

    @property
    def columns(self) -> list[str]:
        """The names of the columns, without time and topic."""
        return list(self._tolerances)

    def add(self, topic: str, time_ns: int, message: Any) -> None:
        """Add a message of one of its topics."""
        row = {"time": repr(time_ns / _SECOND), "topic": topic}
        for path, selection, tolerance in self._selections[topic]:
            value = selection.read(message)
            for leaf, item, _ in _leaves(path, value, value):
                column = f"{topic}/{leaf}"
                row[column] = "nan" if item is None else str(item)
                self._tolerances.setdefault(column, tolerance)
        self.rows.append(row)

    def differences(self, golden: GoldenTable, where: str) -> list[Difference]:
        """The first difference of each column, the earliest first. Raises Refused: `golden` has other columns."""
        new, gone = (
            [column for column in one.columns if column not in other.columns]
            for one, other in ((self, golden), (golden, self))
        )
        if new or gone:
            counts = [f"{what} {listing(columns)}" for what, columns in (("without", new), ("with", gone)) if columns]
            raise Refused(f"{where} has other fields than this run: {', '.join(counts)}", _UPDATE)
        found: dict[tuple[str, str], Difference] = {}
        for topic in dict.fromkeys(row["topic"] for row in (*golden.rows, *self.rows)):
            ours, theirs = ([row for row in table.rows if row["topic"] == topic] for table in (self, golden))
            for one, other in itertools.zip_longest(ours, theirs):
                if one is None or other is None or one["time"] != other["time"]:
                    is_ours = other is None or (one is not None and float(one["time"]) < float(other["time"]))
                    found[topic, ""] = _unpaired(topic, float((one if is_ours else other)["time"]), is_ours)
                    break
                for column, tolerance in self._tolerances.items():
                    value, expected = (row.get(column) or _NOTHING for row in (one, other))
                    if value != expected and not _is_same(_number(value), _number(expected), tolerance):
                        field = column.removeprefix(f"{topic}/")
                        difference = Difference(topic, field, float(one["time"]), value, expected, tolerance)
                        found.setdefault((topic, field), difference)
        return sorted(found.values(), key=lambda difference: difference.time)

    def write(self, path: Path) -> None:
        """Write the table to a file in one step. Raises Refused."""
        text = io.StringIO(newline="")
        table = csv.DictWriter(text, [*_FIRST_COLUMNS, *self.columns], restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(self.rows)
        _write(path, text.getvalue().encode())

    @classmethod
    def of(cls, recording: Recording, fields: Mapping[str, float]) -> GoldenTable:
        """The table of these fields of a recording."""
        topics = {topic: partial(recording.select, topic) for topic in recording.topics}
        table = cls(fields, topics, f"in {recording.path}")
        for one in recording.records(table.topics):
            table.add(one.channel.topic, one.time_ns, recording.message(one))
        return table

    @classmethod
    def read(cls, path: Path) -> GoldenTable:
        """Read a table. Raises BadFile: it cannot be read, is no such table, or is cut off."""
        found, line = cls({}, {}, ""), 1
        try:
            text = input_files.read_bytes(path).decode()
            rows = csv.reader(io.StringIO(text, newline=""))
            header = next(rows, [])
            if header[:2] != _FIRST_COLUMNS:
                what = f"is not a table of a run: one begins with {','.join(_FIRST_COLUMNS)}"
                raise BadFile(what if text else "is empty", str(path), hint=_UPDATE)
            found._tolerances = dict.fromkeys(header[2:], 0.0)
            for row in rows:
                line = rows.line_num
                if len(row) != len(header):
                    raise BadFile("is cut off", str(path), line, hint=_UPDATE)
                float(row[0])
                found.rows.append(dict(zip(header, row, strict=True)))
        except (ValueError, csv.Error) as error:
            raise BadFile(f"cannot be read as a table: {error}", str(path), line, hint=_UPDATE) from None
        if not text.endswith("\n"):
            raise BadFile("is cut off", str(path), line, hint=_UPDATE)
        return found


def _unpaired(topic: str, time_s: float, is_ours: bool) -> Difference:
    return Difference(topic, "", time_s, "a message" if is_ours else None, None if is_ours else "a message", 0.0)


def _number(cell: str) -> float | str:
    """The number in a cell; integers stay integers. Text such as 1_0, a number only to Python, stays text."""
    with suppress(ValueError):
        return cell if "_" in cell else int(cell)
    with suppress(ValueError):
        return float(cell)
    return cell


# --- recordings -------------------------------------------------------------------------------------------------------


def _first_difference(
    run: Recording, baseline: Recording, topic: str, field: str, tolerance: float
) -> Difference | None:
    field_of = baseline.select(topic, field).read
    if field:
        _check_element(baseline, topic, field_of)
    for one, other in itertools.zip_longest(run.records({topic}), baseline.records({topic})):
        if one is None or other is None or one.time_ns != other.time_ns:
            is_ours = other is None or (one is not None and one.time_ns < other.time_ns)
            return _unpaired(topic, (one if is_ours else other).time_ns / _SECOND, is_ours)
        if one.channel.md5 != other.channel.md5:
            return Difference(topic, "", one.time_ns / _SECOND, one.channel.type, other.channel.type, 0.0)
        if one.raw != other.raw:  # of the same type, so the field is at the same place in both
            value, expected = field_of(run.message(one)), field_of(baseline.message(other))
            for path, leaf, expected_leaf in _leaves(field, value, expected):
                if not _is_same(leaf, expected_leaf, tolerance):
                    return Difference(topic, path, one.time_ns / _SECOND, leaf, expected_leaf, tolerance)
    return None


def _check_element(recording: Recording, topic: str, take: Callable[[Any], Any]) -> None:
    """Raise NoElement when `take` finds its element in no message of the topic."""
    missing: NoElement | None = None
    for record in recording.records({topic}):
        try:
            take(recording.message(record))
            return
        except NoElement as error:
            missing = error
    if missing is not None:
        raise missing


def _leaves(path: str, value: Any, expected: Any) -> Iterator[tuple[str, Any, Any]]:
    """The numbers and texts in two values, in pairs, each with its path."""
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
