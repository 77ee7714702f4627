"""Recordings for `rostopic echo -b`, `rostopic list -b` and `rosmsg show -b`.

The types are from the recording itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.echo import MessageFormat, predicate, writer
from slidectl.cli.topic_streams import Event
from slidectl.errors import BadFile
from slidectl.extensions.recording.recording_files import NotARecording, Recording, opened
from slidectl.extensions.ros_commands.arguments import Failure
from slidectl.msgs.schema import Schema


@contextmanager
def open_bag(path: str) -> Iterator[Recording]:
    """Open the recording at `path`. Raises Failure (1) when it is missing or damaged."""
    if not Path(path).exists():
        raise Failure(f"ERROR: bag file [{path}] does not exist")
    try:
        with opened(Path(path)) as recording:
            yield recording
    except NotARecording:
        raise Failure("ERROR: unable to use bag file: This does not appear to be a bag file") from None
    except BadFile as error:
        raise Failure(f"ERROR: unable to use bag file: {error.reason}") from None


def schemas_of(recording: Recording) -> dict[str, Schema]:
    """Topic -> schema, in the order of the first appearance in the recording."""
    return {channel.topic: recording.codec(channel).schema for channel in recording.channels}


def list_topics(path: str, namespace: str | None) -> None:
    """Print the topics; with a namespace, the number of messages in it, and the times of the first and the last."""
    with open_bag(path) as recording:
        topics = list(schemas_of(recording))
        if namespace is None:
            return output.write("\n".join(topics))
        inside = {topic for topic in topics if names.is_under(topic, namespace)}
        times = [record.time_ns for record in recording.records(inside)]
        if not times:
            raise Failure(f"ERROR: no messages on [{namespace}] in {path}; topics: {', '.join(topics)}")
        first, last = (time.strftime("%d %b %Y %H:%M:%S", time.localtime(t // 10**9)) for t in (min(times), max(times)))
        return output.write(f"{len(times)} message(s) from {first} to {last}")


def echo(
    ctx: Context, path: str, target: str | None, look: MessageFormat, condition: str | None, count: int | None
) -> None:
    """Print the messages of a topic or a field, or without a target of all topics, in recorded order."""
    printed = 0
    with open_bag(path) as recording:
        schemas = schemas_of(recording)
        fields = dict.fromkeys(schemas, "") if target is None else _chosen(schemas, target, path)
        writers = {topic: writer(ctx, schemas[topic], field, look) for topic, field in fields.items()}
        keeps = {topic: predicate(condition, schemas[topic]) for topic in fields}
        for record in recording.records(set(fields)):
            if count is not None and printed >= count:
                return
            topic, message = record.channel.topic, recording.message(record)
            if keeps[topic](message):
                writers[topic](Event(topic, message, record.time_ns))
                printed += 1


def _chosen(schemas: dict[str, Schema], target: str, path: str) -> dict[str, str]:
    """Topic -> field, for `target`."""
    for topic, field in names.cut_from_field(target):
        if topic in schemas:
            return {topic: field}
    raise Failure(f"ERROR: no topic [{target}] in {path}; topics: {', '.join(schemas)}")


def definition(path: str, type_name: str, raw: bool) -> str:
    """The definition of a type in the bag, as `rosmsg show` prints it. Raises Failure when the bag has no such type."""
    with open_bag(path) as recording:
        codecs = [recording.codec(channel) for channel in recording.channels]
        for codec in codecs:
            if type_name in codec.schema.types:
                return codec.texts[type_name] if raw else "\n".join(_shown(codec.schema, type_name, ""))
        known = sorted({name for codec in codecs for name in codec.schema.types})
    raise Failure(f"Unable to load msg [{type_name}]: it is not in {path}\ntypes: {' '.join(known)}")


def _shown(schema: Schema, type_name: str, indent: str) -> Iterator[str]:
    for field in schema.fields(type_name):
        yield f"{indent}{field.type_text} {field.name}"
        yield from _shown(schema, field.type, indent + "  ")
