"""Recordings for `rostopic echo -b`, `rostopic list -b` and `rosmsg show -b`.

Types are those that the recording itself carries.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.echo import Look, Write, predicate, writer
from slidectl.cli.ros.arguments import Failure
from slidectl.cli.topic_streams import Event
from slidectl.errors import BadFile
from slidectl.field_path import select
from slidectl.msgs.schema import Schema
from slidectl.recording.recording_files import NotARecording, Recording, opened


class Bag:
    """An open recording, with the schema of each of its topics."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.schemas: dict[str, Schema] = {}
        self.texts: dict[str, str] = {}
        for channel in recording.channels:
            codec = recording.codec(channel)
            self.texts |= codec.texts
            self.schemas[channel.topic] = codec.schema

    @property
    def topics(self) -> list[str]:
        """All topics in the order in which the recording met them."""
        return list(self.schemas)

    def messages(self, topics: set[str]) -> Iterator[Event]:
        """The messages of these topics in the order of their recording; `time_ns` is when that was."""
        for record in self._recording.records(topics):
            yield Event(record.channel.topic, self._recording.message(record), record.time_ns)

    def times(self, topics: set[str]) -> list[int]:
        """When the messages of these topics were recorded, in ns."""
        return [record.time_ns for record in self._recording.records(topics)]


@contextmanager
def open_bag(path: str, trouble: str = "ERROR: unable to use bag file: ") -> Iterator[Bag]:
    """The recording at `path`. Raises Failure (1) when there is none, or it is damaged."""
    if not Path(path).exists():
        raise Failure(f"ERROR: bag file [{path}] does not exist")
    try:
        with opened(Path(path)) as recording:
            yield Bag(recording)
    except NotARecording:
        raise Failure(f"{trouble}This does not appear to be a bag file") from None
    except BadFile as error:
        raise Failure(f"{trouble}{error.reason}") from None


# --- what the tools do with bags --------------------------------------------------------------------------------------


def list_topics(path: str, namespace: str | None) -> None:
    """The topics, or how many messages those below a namespace have, and from when to when."""
    with open_bag(path) as bag:
        if namespace is None:
            return output.write("\n".join(bag.topics))
        times = bag.times({topic for topic in bag.topics if names.is_under(topic, namespace)})
        if not times:
            raise Failure(f"ERROR: no messages on [{namespace}] in {path}; topics: {', '.join(bag.topics)}")
        first, last = (time.strftime("%d %b %Y %H:%M:%S", time.localtime(t // 10**9)) for t in (min(times), max(times)))
        return output.write(f"{len(times)} message(s) from {first} to {last}")


def echo(ctx: Context, path: str, target: str | None, look: Look, condition: str | None, count: int | None) -> None:
    """Print the messages of a topic, of a field, or with no target of all topics."""
    left = float("inf") if count is None else count
    with open_bag(path) as bag:
        fields = dict.fromkeys(bag.topics, "") if target is None else _chosen(bag, target, path)
        writers: Mapping[str, Write] = {
            topic: writer(
                ctx, bag.schemas[topic], select(bag.schemas[topic].fields, bag.schemas[topic].root, field), look
            )
            for topic, field in fields.items()
        }
        keeps = {topic: predicate(condition, bag.schemas[topic]) for topic in fields}
        for event in bag.messages(set(fields)):
            if left <= 0:
                return
            if keeps[event.topic](event.message):
                writers[event.topic](event)
                left -= 1


def _chosen(bag: Bag, target: str, path: str) -> dict[str, str]:
    for topic, field in names.cut_from_field(target):
        if topic in bag.schemas:
            return {topic: field}
    raise Failure(f"ERROR: no topic [{target}] in {path}; topics: {', '.join(bag.topics)}")


def definition(path: str, type_name: str, raw: bool) -> str:
    """What a type in the bag is made of, as `rosmsg show` prints it. Raises Failure when it holds no such type."""
    with open_bag(path) as bag:
        for schema in bag.schemas.values():
            if type_name in schema.types:
                return bag.texts[type_name] if raw else "\n".join(_shown(schema, type_name, ""))
        known = sorted({name for schema in bag.schemas.values() for name in schema.types})
    raise Failure(f"Unable to load msg [{type_name}]: it is not in {path}\ntypes: {' '.join(known)}")


def _shown(schema: Schema, type_name: str, indent: str) -> Iterator[str]:
    for field in schema.fields(type_name):
        yield f"{indent}{field.type_text} {field.name}"
        yield from _shown(schema, field.type, indent + "  ")
