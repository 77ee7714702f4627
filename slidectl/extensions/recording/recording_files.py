"""Reads and writes recordings, `.bag` and `.mcap`, also files that were cut off.

A writer writes whole chunks, so that a killed process loses at most the current chunk. Such a file has no index; it is
read from the beginning to its end, and reports that in `damage`.
"""

from __future__ import annotations

import fcntl
import math
import os
import stat
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

from slidectl import input_files, names, writing
from slidectl.errors import BadFile, Refused, SlidectlError, UnknownName, UsageError
from slidectl.extensions.recording import cut_chunks
from slidectl.extensions.recording.codec import BadDefinition, Codec, Record, RecordedTopic
from slidectl.extensions.recording.codec import of as codec_of
from slidectl.msgs.field_path import Selection, select
from slidectl.msgs.schema import Schema
from slidectl.paths import install_command

COMPRESSIONS = {".bag": ("none", "bz2", "lz4"), ".mcap": ("none", "lz4", "zstd")}
EVERY_CYCLE = "/clock|/gazebo/(link|model)_states"
"""A regular expression for topics with a message in every cycle. The frames on /tf have the same information."""
CHUNK = 768 * 1024
"""Bytes of messages in a chunk, as in rosbag."""
MEGABYTE = 1_000_000
_NOT_CLOSED, _CUT_OFF, _DAMAGED = "it was not closed", "it was cut off", "a part of it is damaged"
_CHECK_SIZE_EVERY = 64
"""The number of messages between two checks of the file's size."""
_BAG_MAGIC = b"#ROSBAG V2.0\n"
_MCAP_MAGIC = b"\x89MCAP0\r\n"


class NoMcap(Refused):
    """The library for .mcap files is not installed."""

    def __init__(self) -> None:
        super().__init__(".mcap files need the library mcap", f"install it: {install_command('mcap')}, or use .bag")


def _check_mcap() -> None:
    """Raise NoMcap if mcap is missing."""
    try:
        import mcap  # noqa: F401
    except ImportError:
        raise NoMcap from None


class BadRecording(BadFile):
    """A recording is damaged, or its file cannot be read."""


class NotARecording(BadRecording):
    """A file is not a recording."""


@dataclass
class Summary:
    """The content of a recording. `counts` are messages by topic; the times are None if there are no messages."""

    begin_ns: int | None
    end_ns: int | None
    counts: Counter[str]
    compression: str
    chunks: int


# --- writing ----------------------------------------------------------------------------------------------------------


class RecordingWriter(ABC):
    """A recording that is being written. An error of the disk is an OSError; `close` completes the file."""

    file: BinaryIO

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def add(self, topic: str, codec: Codec, latching: bool, callerid: str = "") -> Any:
        """Add a topic, or another publisher of a topic. Returns the handle for `write`."""

    @abstractmethod
    def write(self, topic: Any, time_ns: int, raw: bytes) -> None:
        """Write a message."""

    @abstractmethod
    def flush(self) -> None:
        """Write everything so far to the file, so that it can be read even if nothing follows."""

    @abstractmethod
    def close(self) -> None:
        """Complete the file with its index."""

    @abstractmethod
    def abandon(self) -> None:
        """Close the file as it is. After a failed `write` or `flush` nothing else may be called."""

    @property
    def size(self) -> int:
        """The present size of the file in bytes."""
        return self.path.stat().st_size


def usual_suffix() -> str:
    """The suffix of recordings that are kept by default: MCAP if its library is installed."""
    return ".mcap" if find_spec("mcap") else ".bag"


def check_kind(path: Path, compression: str = "none") -> None:
    """Check suffix and compression of a recording. Raises UsageError: not supported. NoMcap."""
    known = COMPRESSIONS.get(path.suffix)
    if known is None:
        raise UsageError(f"{path} is neither a .bag nor a .mcap file", "the suffix is the format")
    if compression not in known:
        raise UsageError(f"{path.suffix} files have no compression {compression!r}", f"choose from: {', '.join(known)}")
    if path.suffix == ".mcap":
        _check_mcap()


def create(path: Path, compression: str = "none", force: bool = False) -> RecordingWriter:
    """Create a recording of the kind of its suffix, of which the beginning is on the disk then.

    `force` replaces an existing file. A link stays, and its target is written.

    Raises:
        UsageError, NoMcap: as `check_kind` does. Refused: the file exists, is being recorded, or cannot be created.
    """
    check_kind(path, compression)
    target = Path(os.path.realpath(path))
    try:
        if not force:
            refuse_existing(path)
            return _begun(target, compression)
        refuse_unreplaceable(path)
        with writing.draft(target) as new:  # the old file is not lost for nothing
            writer = _begun(new, compression)
        writer.path = target
        return writer
    except OSError as error:
        raise writing.CannotWrite(path, error) from None


def _begun(path: Path, compression: str, mode: int | None = None) -> RecordingWriter:
    """A new recording, locked. Raises OSError: it cannot be begun, and nothing is left."""
    try:
        writer = _BagWriter(path, compression) if path.suffix == ".bag" else _McapWriter(path, compression)
    except OSError as error:
        if not isinstance(error, FileExistsError):
            path.unlink(missing_ok=True)
        raise
    try:
        if mode is not None:
            os.fchmod(writer.file.fileno(), mode)
        _lock(writer.file)
        writer.flush()
    except BaseException:
        writer.abandon()
        path.unlink(missing_ok=True)
        raise
    return writer


def _lock(file: BinaryIO) -> bool:
    """Acquire the lock that a recording has while it is written; False when another process has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        pass
    return True


def refuse_existing(path: Path) -> None:
    """Raise Refused when the file exists."""
    if path.exists():
        raise Refused(f"{path} already exists", "give another name, or --force to overwrite it")


def refuse_unreplaceable(path: Path) -> None:
    """Raise Refused when the path leads to something that no recording replaces, or to one that is being recorded."""
    if not path.exists():
        return
    if not path.is_file():
        raise Refused(f"{path} is not a regular file", "give another name")
    try:
        file = input_files.opened(path)
    except BadFile:  # it cannot be read, but perhaps replaced
        return
    with file:
        if not _lock(file):
            raise Refused(f"{path} is being recorded", "end that first, or give another name")


class _BagWriter(RecordingWriter):
    def __init__(self, path: Path, compression: str) -> None:
        super().__init__(path)
        from slidectl.extensions.recording.rosbags_adapter import NO_TIME_NS, ChunkWriter

        self._no_time_ns = NO_TIME_NS
        self._writer = ChunkWriter(path, compression, CHUNK)
        self.file = self._writer.file

    def add(self, topic: str, codec: Codec, latching: bool, callerid: str = "") -> Any:
        kind, node = codec.type.replace("/", "/msg/"), callerid or None
        return self._writer.add_connection(
            topic, kind, msgdef=codec.definition, md5sum=codec.md5, callerid=node, latching=1 if latching else None
        )

    def write(self, topic: Any, time_ns: int, raw: bytes) -> None:
        self._writer.write(topic, time_ns or self._no_time_ns, raw)

    def flush(self) -> None:
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()

    def abandon(self) -> None:
        with suppress(OSError):
            self._writer.abort()


class _McapWriter(RecordingWriter):
    def __init__(self, path: Path, compression: str) -> None:
        super().__init__(path)
        from mcap.writer import CompressionType, Writer

        self.file = path.open("xb")
        kind = CompressionType[compression.upper()]
        self._writer = Writer(self.file, chunk_size=CHUNK, compression=kind)
        self._writer.start("ros1", "slidectl")
        self._schemas: dict[str, int] = {}
        self._counts: Counter[int] = Counter()

    def add(self, topic: str, codec: Codec, latching: bool, callerid: str = "") -> Any:
        if codec.type not in self._schemas:
            self._schemas[codec.type] = self._writer.register_schema(codec.type, "ros1msg", codec.definition.encode())
        about = {"md5sum": codec.md5, "latching": "1" if latching else "", "callerid": callerid}
        about = {key: value for key, value in about.items() if value}
        return self._writer.register_channel(topic, "ros1", self._schemas[codec.type], about)

    def write(self, topic: Any, time_ns: int, raw: bytes) -> None:
        self._writer.add_message(topic, time_ns, raw, time_ns, self._counts[topic])
        self._counts[topic] += 1

    def flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.file.close()

    def abandon(self) -> None:
        with suppress(OSError):
            self.file.close()


class Recorder:
    """The one way of a message into a recording: it is encoded by the type of its topic, and goes to the file's format.

    The recording has at most `length_s` simulated seconds and `size_mb` (10^6 bytes); `split` makes further files. A
    topic is added to a file with its first message.

    Args:
        most_files: with `split` the number of last files that are kept; None: all.
        repeat_latched: with `split` write latched messages again at the beginning of each file.
        force: replace existing files.

    Raises:
        UsageError, Refused: as `create` does, with `split` for each file.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "none",
        length_s: float | None = None,
        size_mb: float | None = None,
        split: bool = False,
        most_files: int | None = None,
        repeat_latched: bool = False,
        force: bool = False,
    ) -> None:
        self._base = path
        self._compression = compression
        self._length_ns = None if length_s is None else round(length_s * 1e9)
        self._most_bytes = None if size_mb is None else size_mb * MEGABYTE
        self._split = split
        self._most_files = most_files or math.inf
        self._repeat_latched = repeat_latched
        self._force = force
        self._codecs: dict[str, Codec] = {}
        self._latched: dict[str, bytes] = {}
        self._numbers = 0
        self.files: list[Path] = []
        self.counts: Counter[str] = Counter()
        self.first_ns: int | None = None
        self.last_ns = 0
        self.bytes = 0
        """The size of the completed files, bytes."""
        self.kept = 0
        """The number of messages that can be read in a last file that could not be completed."""
        self.is_full = False
        self._writer: RecordingWriter | None = None
        """None after `close`, and if the next file could not be opened."""
        self._has_failed = False
        """True when something could not be written: no index may follow what is there."""
        self._open()

    @property
    def path(self) -> Path:
        """The current file."""
        return self.files[-1]

    def _open(self) -> None:
        path = self._base
        if self._split:
            path = path.with_name(f"{path.stem}_{self._numbers}{path.suffix}")
            self._numbers += 1
        self._writer = create(path, self._compression, self._force)
        self.files.append(path)
        self._handles: dict[str, Any] = {}
        self._begin_ns: int | None = None
        if len(self.files) > self._most_files:
            gone = self.files.pop(0)
            self.bytes -= gone.stat().st_size
            gone.unlink()

    def add(self, topic: str, type_name: str) -> None:
        """Add a topic, before its first message. Raises UnknownName: no such type."""
        self._codecs[topic] = codec_of(type_name)

    @property
    def topics(self) -> Collection[str]:
        """The topics that were added."""
        return self._codecs.keys()

    def write(self, topic: str, time_ns: int, message: Any, latching: bool = False) -> None:
        """Write a message in the shape of the wire protocol; `latching`: it was published before the subscription.

        Raises OSError, Refused: it cannot be written.
        """
        raw = self._codecs[topic].encode(message)
        try:
            if self._ends(time_ns):
                if not self._split:
                    self.is_full = True
                    return
                self.close()
                self._open()
            if self._begin_ns is None:
                self._begin(time_ns)
            if latching or topic in self._latched:
                self._latched[topic] = raw
            handle = self._handles.get(topic)
            if handle is None:
                handle = self._add(topic, latching)
            assert self._writer is not None
            self._writer.write(handle, time_ns, raw)
        except OSError:
            self._has_failed = True
            raise
        self.counts[topic] += 1
        self.first_ns = time_ns if self.first_ns is None else min(self.first_ns, time_ns)
        self.last_ns = max(self.last_ns, time_ns)

    def _begin(self, time_ns: int) -> None:
        """Begin a file at the time of its first message."""
        assert self._writer is not None
        self._begin_ns = time_ns
        if self._repeat_latched:
            for topic, raw in self._latched.items():
                self._writer.write(self._add(topic, True), time_ns, raw)

    def _add(self, topic: str, latching: bool) -> Any:
        """Add a topic to the current file. Returns its handle there."""
        assert self._writer is not None
        handle = self._handles[topic] = self._writer.add(topic, self._codecs[topic], latching)
        return handle

    def _ends(self, time_ns: int) -> bool:
        if self._length_ns is not None and self._begin_ns is not None and time_ns - self._begin_ns >= self._length_ns:
            return True
        if self._most_bytes is None or self.counts.total() % _CHECK_SIZE_EVERY:
            return False
        return self._writer is not None and self._writer.size >= self._most_bytes

    def flush(self) -> None:
        """Flush the file. Raises OSError."""
        try:
            if self._writer is not None:
                self._writer.flush()
        except OSError:
            self._has_failed = True
            raise

    def close(self) -> None:
        """Complete the file. A second call does nothing.

        A file of which something could not be written is left as it is; when nothing in it can be read it is removed.

        Raises OSError.
        """
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            if not self._has_failed:
                writer.close()
        except OSError:
            self._has_failed = True
            raise
        finally:
            if self._has_failed:
                writer.abandon()
                self.kept = readable_messages(self.path)
                if not self.kept:
                    self.path.unlink(missing_ok=True)
            self.bytes += self.path.stat().st_size if self.path.exists() else 0

    def incomplete(self, error: OSError) -> Refused:
        """The error to raise after `close` when a file could not be completed: what is kept, and what to do next."""
        of_all = f"of {self.counts.total()} messages that came"
        if not self.kept:
            return writing.CannotWrite(self.path, error, more=f"; {of_all}, none could be kept in it")
        next_step = f"complete it with: slidectl bag reindex {self.path}"
        return writing.CannotWrite(self.path, error, more=f"; {of_all}, {self.kept} can be read in it", then=next_step)


# --- reading ----------------------------------------------------------------------------------------------------------


class Recording(ABC):
    """An open recording; a context manager. `damage` describes what is wrong with the file, or is empty."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.path = path
        self.damage = ""
        self.channels: list[RecordedTopic] = []
        self._file = file
        self._codecs: dict[int, Codec] = {}

    @abstractmethod
    def records(self, topics: set[str] | None = None) -> Iterator[Record]:
        """The messages of these topics (None: all), by time."""

    @abstractmethod
    def summary(self) -> Summary:
        """Summarize the content."""

    @property
    def topics(self) -> list[str]:
        """The topics in order of their first appearance."""
        return list(dict.fromkeys(channel.topic for channel in self.channels))

    def topic_and_field(self, text: str, namespace: str = "/") -> tuple[str, str]:
        """Resolve `TOPIC/FIELD[I]` among its topics. Raises UnknownName, AmbiguousName."""
        return topic_and_field(text, self.topics, f"in {self.path}", namespace)

    def schema(self, topic: str) -> Schema:
        """The schema of a topic's messages. Raises BadRecording."""
        return self.codec(next(channel for channel in self.channels if channel.topic == topic)).schema

    def select(self, topic: str, path: str) -> Selection:
        """Select a path in the messages of a topic. Raises UnknownName, UsageError, BadRecording."""
        schema = self.schema(topic)
        return select(schema.fields, schema.root, path)

    def codec(self, channel: RecordedTopic) -> Codec:
        """The codec for its messages. Raises BadRecording."""
        if channel.number not in self._codecs:
            with _library_errors_as_bad_recording(self.path):
                self._codecs[channel.number] = Codec(channel.type, channel.definition, channel.md5)
        return self._codecs[channel.number]

    def message(self, record: Record) -> Any:
        """Decode a message to the shape of the wire protocol. Raises BadRecording."""
        codec = self.codec(record.channel)
        with _library_errors_as_bad_recording(self.path):
            return codec.decode(record.raw)

    def refuse_written(self) -> None:
        """Raise Refused when the recording is being written, here or in another process."""
        if not _lock(self._file):
            raise Refused(f"{self.path} is being recorded", "end that first: Ctrl-C, or kill PID with --detach")

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def topic_and_field(text: str, topics: Iterable[str], where: str, namespace: str = "/") -> tuple[str, str]:
    """Resolve `TOPIC/FIELD[I]` among these topics, which are found `where`. Raises UnknownName, AmbiguousName."""
    for name, field_path in names.cut_from_field(text):
        with suppress(UnknownName):
            return names.resolve(name, topics, kind="topic", namespace=namespace), field_path
    raise UnknownName("topic", text, sorted(topics), where)


@contextmanager
def _library_errors_as_bad_recording(path: Path) -> Iterator[None]:
    """Turn any exception of a library about invalid or damaged bytes into BadRecording."""
    try:
        yield
    except BadDefinition as error:
        raise BadRecording(error.message, str(path)) from None
    except SlidectlError:
        raise
    except Exception as error:  # besides the libraries' own classes, codecs, asserts and parsers raise others
        text = str(error).partition("\n")[0] or type(error).__name__
        raise BadRecording(f"it is damaged: {text}", str(path)) from None


def opened(path: Path) -> Recording:
    """Open a recording; its content decides which kind it is.

    Raises:
        BadRecording: no such file, or not a recording. NoMcap.
    """
    try:
        file = input_files.opened(path)
    except BadFile as error:
        raise BadRecording(error.reason, str(path), hint=error.hint) from None
    try:
        with _library_errors_as_bad_recording(path):
            magic = file.read(len(_BAG_MAGIC))
            if magic == _BAG_MAGIC:
                return _open_bag(path, file)
            if magic.startswith(_MCAP_MAGIC):
                return _McapRecording(path, file)
        what = "is empty" if not magic else "is neither a bag (of format 2.0) nor an mcap file"
        raise NotARecording(what, str(path))
    except BaseException:
        file.close()
        raise


def _open_bag(path: Path, file: BinaryIO) -> Recording:
    from slidectl.extensions.recording.rosbags_adapter import index_and_chunks

    index, chunks = index_and_chunks(file)
    size = os.fstat(file.fileno()).st_size
    if 0 < index < size or (index == size and not chunks):
        try:
            return _BagRecording(path, file)
        except Exception:  # the library raises many classes
            return _TruncatedBag(path, file, "its index is damaged")
    return _TruncatedBag(path, file, _NOT_CLOSED if not index else _CUT_OFF)


class _BagRecording(Recording):
    """A bag with an index."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path, file)
        from rosbags.rosbag1 import Reader

        self._reader = Reader(path)
        self._reader.open()
        self._connections = {connection.id: connection for connection in self._reader.connections}
        for one in self._reader.connections:
            latching, callerid = bool(getattr(one.ext, "latching", 0)), getattr(one.ext, "callerid", None) or ""
            kind, text = one.msgtype.replace("/msg/", "/"), str(one.msgdef.data)
            self.channels.append(RecordedTopic(one.id, one.topic, kind, text, one.digest, latching, callerid))

    def records(self, topics: set[str] | None = None) -> Iterator[Record]:
        by_id = {channel.number: channel for channel in self.channels if topics is None or channel.topic in topics}
        if not by_id:
            return
        from slidectl.extensions.recording.rosbags_adapter import bag_time

        with _library_errors_as_bad_recording(self.path):
            for connection, time_ns, raw in self._reader.messages([self._connections[number] for number in by_id]):
                yield Record(by_id[connection.id], bag_time(time_ns), raw)

    def summary(self) -> Summary:
        from slidectl.extensions.recording.rosbags_adapter import bag_time, chunks_and_compression

        reader = self._reader
        counts = Counter(dict.fromkeys(self.topics, 0))
        for connection in reader.connections:
            counts[connection.topic] += connection.msgcount
        begin, end = (bag_time(reader.start_time), reader.end_time - 1) if counts.total() else (None, None)
        chunks, compression = chunks_and_compression(reader)
        return Summary(begin, end, counts, compression, chunks)

    def close(self) -> None:
        from rosbags.rosbag1 import ReaderError

        super().close()
        with suppress(ReaderError):  # it was closed before
            self._reader.close()


class _SequentialRecording(Recording):
    """A recording that is read from the beginning to its end, without an index."""

    def __init__(self, path: Path, file: BinaryIO, damage: str) -> None:
        super().__init__(path, file)
        self.damage = damage
        self._known: dict[int, RecordedTopic] = {}
        self.compression = "none"
        self.chunks = 0
        self._is_in_order = True
        self._summary = self._summarize()

    @abstractmethod
    def _scan(self) -> Iterator[Record]:
        """All messages up to the end of the file, or to the first damage."""

    def records(self, topics: set[str] | None = None) -> Iterator[Record]:
        found = (record for record in self._scan() if topics is None or record.channel.topic in topics)
        yield from found if self._is_in_order else sorted(found, key=lambda record: record.time_ns)

    def _summarize(self) -> Summary:
        begin: int | None = None
        end: int | None = None
        counts: Counter[str] = Counter()
        for record in self._scan():
            self._is_in_order = self._is_in_order and (end is None or record.time_ns >= end)
            begin = record.time_ns if begin is None else min(begin, record.time_ns)
            end = record.time_ns if end is None else max(end, record.time_ns)
            counts[record.channel.topic] += 1
        self.channels = list(self._known.values())
        counts.update({topic: 0 for topic in self.topics if topic not in counts})
        if self.damage and not self.channels:
            raise BadRecording(f"{self.damage}, and no message in it can be read", str(self.path))
        return Summary(begin, end, counts, self.compression, self.chunks)

    def summary(self) -> Summary:
        return self._summary


class _TruncatedBag(_SequentialRecording):
    def _scan(self) -> Iterator[Record]:
        from slidectl.extensions.recording.rosbags_adapter import chunks

        self.chunks = 0
        self._file.seek(len(_BAG_MAGIC))
        every = chunks(self._file, self._known)
        while True:
            try:
                compression, is_whole, records = next(every)
            except StopIteration:
                return
            except Exception:  # where the file is cut off, or what follows is no record
                self.damage = _CUT_OFF
                return
            self.compression = compression
            self.chunks += is_whole
            try:
                yield from records
            except Exception:
                self.damage = _DAMAGED if is_whole else _CUT_OFF


class _McapRecording(_SequentialRecording):
    """An MCAP file. Its index is not used: the library's sequential reader is faster."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        _check_mcap()
        super().__init__(path, file, "")

    def _scan(self) -> Iterator[Record]:
        from mcap import records

        self.damage, self.chunks, schemas = _NOT_CLOSED, 0, {}
        for one in self._mcap_records():
            if isinstance(one, records.Schema):
                schemas[one.id] = one
            elif isinstance(one, records.Channel) and one.id not in self._known:
                schema = schemas.get(one.schema_id)
                if one.message_encoding != "ros1" or schema is None or schema.encoding != "ros1msg":
                    raise BadRecording(
                        f"{one.topic} has messages of the encoding {one.message_encoding!r}, not ros1", str(self.path)
                    )
                text, about = schema.data.decode("utf-8", "replace"), one.metadata
                latching = about.get("latching") == "1"
                self._known[one.id] = RecordedTopic(
                    one.id, one.topic, schema.name, text, about.get("md5sum", ""), latching, about.get("callerid", "")
                )
            elif isinstance(one, records.Message):
                if (topic := self._known.get(one.channel_id)) is not None:  # unknown if an earlier chunk is damaged
                    yield Record(topic, one.log_time, one.data)
            elif isinstance(one, records.Footer) and self.damage == _NOT_CLOSED:
                self.damage = ""

    def _mcap_records(self) -> Iterator[Any]:
        """The records of the file, and those in its chunks. Where it is cut off, those that are whole."""
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk

        self._file.seek(0)
        every = iter(StreamReader(self._file, emit_chunks=True).records)
        while True:
            place = self._file.tell()
            try:
                outer: Any = next(every)
            except StopIteration:
                return
            except Exception:  # besides the library's own classes, struct and others raise theirs
                break
            if not isinstance(outer, Chunk):
                yield outer
                continue
            self.chunks += 1
            self.compression = outer.compression or "none"
            try:
                inner = breakup_chunk(outer)
            except Exception:
                self.damage = _DAMAGED
            else:
                yield from inner
        if place < os.fstat(self._file.fileno()).st_size:
            self.damage = _CUT_OFF
            self._file.seek(place)
            if (rest := cut_chunks.mcap_chunk(self._file)) is not None:
                yield from breakup_chunk(rest)


def readable_messages(path: Path) -> int:
    """The number of messages that can be read in a file that may be damaged."""
    try:
        with opened(path) as recording:
            return recording.summary().counts.total()
    except SlidectlError:
        return 0


# --- copying ----------------------------------------------------------------------------------------------------------


def copy(
    records: Iterable[Record], recording: Recording, target: Path, compression: str = "none", kept: Path | None = None
) -> int:
    """Write records of a recording into a new one, which appears when it is complete. Returns their number.

    Args:
        target: the path of the new one; an existing file is replaced, where a link leads too.
        kept: where an existing file is moved instead.

    Raises:
        UsageError, Refused: it cannot be written.
    """
    check_kind(target, compression)
    if kept is None:
        refuse_unreplaceable(target)
    target = Path(os.path.realpath(target))
    mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
    count = 0
    try:
        with ExitStack() as undo:
            with writing.draft(target) as new, ExitStack() as leaving:
                writer = _begun(new, compression, mode)
                leaving.callback(writer.abandon)
                added: dict[Any, Any] = {}
                numbers: dict[int, Any] = {}
                for channel, time_ns, raw in records:
                    if channel.number not in numbers:
                        codec = recording.codec(channel)
                        key = channel.topic, codec.type, codec.md5, channel.latching, channel.callerid
                        if key not in added:  # in rosbag's files a publisher that connected twice has two connections
                            added[key] = writer.add(channel.topic, codec, channel.latching, channel.callerid)
                        numbers[channel.number] = added[key]
                    writer.write(numbers[channel.number], time_ns, raw)
                    count += 1
                writer.close()
                if kept is not None:
                    _keep(target, kept)
                    undo.callback(_give_back, target, kept)
            undo.pop_all()
    except OSError as error:
        raise writing.CannotWrite(target, error) from None
    return count


def _keep(target: Path, kept: Path) -> None:
    """Give the file another name, before another file takes its own. It keeps both until then, where that can be."""
    try:
        os.link(target, kept)
    except OSError:  # a file system without links
        target.rename(kept)


def _give_back(target: Path, kept: Path) -> None:
    """Undo `_keep`."""
    if target.exists():
        kept.unlink()
    else:
        kept.rename(target)
