"""Baselines of cases: chosen fields of each run are compared with those of an earlier run, in a folder of tables.

A baseline is a CSV file named after its case: a reader of a pull request sees which numbers changed, and by how much.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from slidectl import msgs
from slidectl.client import Client
from slidectl.errors import Refused, SlidectlError
from slidectl.extensions.recording.comparison import TABLE, GoldenTable
from slidectl.extensions.scenarios.case_run import FAILED, CaseResult
from slidectl.extensions.scenarios.scenario_file import SUFFIXES, BaselineFields, Case
from slidectl.msgs.field_path import select
from slidectl.msgs.schema import nanoseconds
from slidectl.names import cut_from_field

_JOINT_STATES = "sensor_msgs/JointState"
_DEFAULT = ("position", "velocity", "effort")
"""The fields of all joint states, which are compared when the scenario names none."""
_QUEUE = 1_000_000


class RecordedFields:
    """Collects the messages with fields of a baseline. A topic is recorded from the end of the step that creates it."""

    def __init__(self, client: Client, wanted: BaselineFields) -> None:
        self._client = client.another()  # no wait uses this client, so its messages do not end a slice of cycles
        self._wanted = wanted
        self._names = [name for field in wanted.fields for name, _ in cut_from_field(field)]
        self._types: dict[str, str] = {}
        self._records: list[tuple[str, int, Any]] = []
        self._subscriptions: list[Any] = []

    def update(self) -> None:
        """Handle received messages, and subscribe to new topics."""
        for topic, kind in self._client.topics().items():
            if topic not in self._types and self._is_wanted(topic, kind):
                self._types[topic] = kind
                self._subscriptions.append(
                    self._client.subscribe(topic, kind, queue_length=_QUEUE, take=self._add, wait=False)
                )
        self._client.flush()

    def _is_wanted(self, topic: str, kind: str) -> bool:
        if not self._wanted.fields:
            return kind == _JOINT_STATES
        return any(topic == name or topic.endswith(f"/{name}") for name in self._names)

    def _add(self, published: dict[str, Any]) -> None:
        self._records.append((published["topic"], nanoseconds(published["time"]), published["msg"]))

    def table(self) -> GoldenTable:
        """The table of the messages up to the last `update`. Raises UnknownName, AmbiguousName, Refused."""
        self._client.close()
        if lost := sum(subscription.dropped for subscription in self._subscriptions):
            raise Refused(f"{lost} messages of its fields came faster than they could be read")
        fields = self._wanted.fields or {
            f"{topic}/{field}": self._wanted.tol for topic in sorted(self._types) for field in _DEFAULT
        }
        topics = {topic: partial(select, msgs.fields, kind) for topic, kind in self._types.items()}
        table = GoldenTable(fields, topics, "in this run")
        for topic, time_ns, message in self._records:
            if topic in table.topics:
                table.add(topic, time_ns, message)
        return table


class Baselines:
    """A folder of baselines. With `is_updated` changed ones are written; none is ever removed."""

    def __init__(self, folder: str, is_updated: bool) -> None:
        self._folder = Path(folder)
        self._is_updated = is_updated

    def path(self, case: Case) -> Path:
        """`FOLDER/PATH_OF_SCENARIO.csv`, or `.../CASE.csv` for a table; the path is relative to the folder's parent."""
        file = os.path.relpath(case.file, self._folder.absolute().parent)
        if file.startswith(os.pardir):
            file = os.path.abspath(case.file).lstrip(os.sep)
        stem = self._folder / os.path.splitext(file)[0]
        return stem / f"{quote(case.name, safe=' ,=+')}{TABLE}" if case.name else stem.with_name(stem.name + TABLE)

    def judge(self, case: Case, table: GoldenTable, result: CaseResult) -> None:
        """Compare a passed case with its baseline, and fail it if it differs; with `is_updated` write the baseline."""
        path = self.path(case)
        try:
            if not path.exists():
                if self._is_updated and table.rows:
                    table.write(path)
                    result.baseline = f"{path}: new, {len(table.columns)} fields, {len(table.rows)} messages"
                elif table.rows:
                    result.verdict = FAILED
                    result.message = f"it has no baseline {path}"
                    result.hint = "to make this run the baseline: --update-baseline"
                return
            found = table.differences(GoldenTable.read(path), str(path))
        except SlidectlError as error:
            what, hint, detail, time_s = str(error), error.hint or "", {}, result.sim_time
        else:
            if not found:
                return
            others = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
            what, hint = f"{path}: {found[0]}{others}", "if that is right: --update-baseline"
            detail, time_s = found[0]._asdict(), found[0].time
        if self._is_updated:
            table.write(path)
            result.baseline = f"{path}: updated; before, {what.removeprefix(f'{path}: ')}"
            return
        result.verdict, result.message, result.hint = FAILED, f"differs from its baseline: {what}", hint
        result.detail, result.failed_at = detail, time_s

    def without_case(self, known: Sequence[Case]) -> Iterator[tuple[Case, CaseResult]]:
        """Failures for files in the folder that belong to no known case and no other scenario file."""
        mine = {self.path(case) for case in known}
        read = {os.path.realpath(case.file) for case in known}
        for path in sorted(self._folder.rglob(f"*{TABLE}")):
            inside = path.relative_to(self._folder)
            scenarios = [
                f"{root / stem}{suffix}"
                for root in (self._folder.absolute().parent, Path(os.sep))
                for stem in (inside.with_suffix(""), inside.parent)
                for suffix in SUFFIXES
            ]
            others = [file for file in scenarios if os.path.isfile(file) and os.path.realpath(file) not in read]
            if path not in mine and not others:
                result = CaseResult(str(path), FAILED, message="no case has this baseline", hint=f"rm {path}")
                yield Case(str(path), "", path.stem), result
