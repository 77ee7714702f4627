"""Bags (rosbag 2.0) for `rostopic echo -b`, `rostopic list -b` and `rosmsg show -b`.

Types are those that the bag itself carries. rosbags is imported when a bag is opened, not before.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.echo import Look, Write, predicate, writer
from slidectl.cli.ros.arguments import Failure
from slidectl.cli.topic_streams import Event, Schema
from slidectl.errors import SlidectlError
from slidectl.field_path import select
from slidectl.msgs.schema import TIMES, Field

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader

_SECTION = re.compile(r"^=+\s*\nMSG: *(\S+) *\n", re.MULTILINE)
_MAGIC = b"#ROSBAG V"


class Bag:
    """An open bag. Messages come out in the shape that they have on the wire. What is damaged raises Failure."""

    def __init__(self, reader: Reader, trouble: str) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._reader = reader
        self._trouble = trouble
        self._store = get_typestore(Stores.EMPTY)
        self.schemas: dict[str, Schema] = {}
        self.texts: dict[str, str] = {}
        for connection in reader.connections:
            text = connection.msgdef.data
            self._store.register(get_types_from_msg(text, connection.msgtype))
            texts = _definitions(ros1_name(connection), text)
            self.texts |= texts
            self.schemas[connection.topic] = _schema(ros1_name(connection), texts)

    @property
    def topics(self) -> list[str]:
        """All topics in the order in which the bag met them."""
        return list(self.schemas)

    def messages(self, topics: set[str]) -> Iterator[Event]:
        """The messages of these topics in the order of their recording; `time_ns` is when that was."""
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        with _understood(self._trouble):
            for connection, time_ns, raw in self._reader.messages(connections=chosen):
                schema = self.schemas[connection.topic]
                message = self._store.deserialize_ros1(raw, connection.msgtype)
                yield Event(connection.topic, _plain(schema, schema.root, message), time_ns)

    def times(self, topics: set[str]) -> list[int]:
        """When the messages of these topics were recorded, in ns."""
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        with _understood(self._trouble):
            return [time_ns for _, time_ns, _ in self._reader.messages(connections=chosen)] if chosen else []


@contextmanager
def opened(path: str, trouble: str = "ERROR: unable to use bag file: ") -> Iterator[Bag]:
    """The bag at `path`. Raises Failure (1) when there is none, or it is damaged."""
    from rosbags.rosbag1 import Reader

    _check(path, trouble)
    with ExitStack() as stack:
        with _understood(trouble):
            bag = Bag(stack.enter_context(Reader(Path(path))), trouble)
        yield bag


def _check(path: str, trouble: str) -> None:
    try:
        with open(path, "rb") as file:
            start = file.read(len(_MAGIC))
    except FileNotFoundError:
        raise Failure(f"ERROR: bag file [{path}] does not exist") from None
    except OSError as error:
        raise Failure(f"{trouble}{error.strerror}") from None
    if start != _MAGIC:
        raise Failure(f"{trouble}This does not appear to be a bag file")


@contextmanager
def _understood(trouble: str) -> Iterator[None]:
    """Raises Failure for whatever rosbags raises about bytes that are no bag, or a damaged one."""
    try:
        yield
    except SlidectlError:
        raise
    except Exception as error:  # its classes for that are not alone: codecs, asserts and parsers join in
        text = str(error).partition("\n")[0] or type(error).__name__
        raise Failure(f"{trouble}it is damaged: {text}") from None


def ros1_name(connection: Connection) -> str:
    """`sensor_msgs/JointState`, where rosbags says `sensor_msgs/msg/JointState`."""
    return connection.msgtype.replace("/msg/", "/")


def _definitions(root: str, text: str) -> dict[str, str]:
    """Type -> definition, out of one in which those of nested types follow, each behind a line of its own."""
    first, *rest = _SECTION.split(text)
    return {root: first, **dict(zip(rest[::2], rest[1::2], strict=True))}


def _schema(root: str, texts: Mapping[str, str]) -> Schema:
    from slidectl.msgs.definitions import parse_message

    definitions = {name: parse_message(text, name) for name, text in texts.items()}
    return Schema(root, {name: tuple(Field(*field) for field in d.fields) for name, d in definitions.items()})


def _plain(schema: Schema, type_name: str, value: Any) -> Any:
    if type_name in TIMES:
        secs = value.sec if type_name == "duration" else value.sec % 2**32  # rosbags reads both as signed
        return {"secs": secs, "nsecs": value.nanosec}
    if not schema.fields(type_name):
        return value if not hasattr(value, "item") else value.item()
    return {field.name: _field(schema, field, getattr(value, field.name)) for field in schema.fields(type_name)}


def _field(schema: Schema, field: Field, value: Any) -> Any:
    if field.array < 0:
        return _plain(schema, field.type, value)
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(schema, field.type, each) for each in value]


# --- what the tools do with bags --------------------------------------------------------------------------------------


def list_topics(path: str, namespace: str | None) -> None:
    """The topics, or how many messages those below a namespace have, and from when to when."""
    with opened(path) as bag:
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
    with opened(path) as bag:
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
    with opened(path) as bag:
        for schema in bag.schemas.values():
            if type_name in schema.types:
                return bag.texts[type_name] if raw else "\n".join(_shown(schema, type_name, ""))
        known = sorted({name for schema in bag.schemas.values() for name in schema.types})
    raise Failure(f"Unable to load msg [{type_name}]: it is not in {path}\ntypes: {' '.join(known)}")


def _shown(schema: Schema, type_name: str, indent: str) -> Iterator[str]:
    for field in schema.fields(type_name):
        yield f"{indent}{field.type_text} {field.name}"
        yield from _shown(schema, field.type, indent + "  ")
