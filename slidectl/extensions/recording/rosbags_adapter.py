"""All access to private parts of the rosbags library, for features that its `Reader` and `Writer` do not have.

* A recorder that is killed loses no more than a chunk: `write_chunk` puts the open one into the file, and
  `chunk_threshold` bounds it. `bio`, the file itself, is locked while it is written.
* A long recording needs little memory: `write_chunk` leaves the index of a chunk that is in the file in `connections`.
* rosbag of ROS cannot read the lz4 frames of the library: `compressor` makes frames that it can.
* A bag that was cut off has no index, and `Reader` refuses it: `Header` and the functions beside it read its records.
* `chunk_infos`, `chunks` and `decompressors` tell how many chunks a bag has, and how they are compressed.

pyproject.toml names the versions for which this holds, and a test compares these parts with those that were read.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from rosbags.rosbag1 import Reader, Writer, reader

from slidectl.extensions.recording import cut_chunks
from slidectl.extensions.recording.codec import Record, RecordedTopic

NO_TIME_NS = 1
"""The value for time 0 in a bag, which rosbag does not accept."""


def bag_time(time_ns: int) -> int:
    """The recorded time for a time in a bag."""
    return 0 if time_ns == NO_TIME_NS else time_ns


class ChunkWriter(Writer):
    """A new bag, open, with so many bytes of messages in a chunk. `file` is the file."""

    def __init__(self, path: Path, compression: str, chunk_size: int) -> None:
        super().__init__(path)
        self.chunk_threshold = chunk_size
        if compression != "none":
            self.set_compression(Writer.CompressionFormat[compression.upper()])
        if compression == "lz4":
            from lz4 import frame

            self.compressor = lambda chunk: frame.compress(
                chunk, 0, block_linked=False, content_checksum=True, store_size=False
            )
        self.open()
        assert self.bio is not None
        self.file: BinaryIO = self.bio

    def write_chunk(self, chunk: Any) -> None:
        """Of a chunk that is in the file the library wants no more than how many messages each topic has in it."""
        super().write_chunk(chunk)
        for number, entries in chunk.connections.items():
            chunk.connections[number] = range(len(entries))

    def flush(self) -> None:
        """Put all messages so far into the file."""
        self.write_chunk(self.chunks[-1])
        self.file.flush()


def index_and_chunks(file: BinaryIO) -> tuple[int, int]:
    """Where the bag says that its index begins, 0 when it was not closed; and how many chunks it has then."""
    header = reader.Header.read(file, reader.RecordType.BAGHEADER)
    return header.get_uint64("index_pos"), header.get_uint32("chunk_count")


def chunks_and_compression(bag: Reader) -> tuple[int, str]:
    """How many chunks an open bag has, and how they are compressed."""
    names = {function: name for name, function in reader.decompressors.items()}
    return len(bag.chunk_infos), next((names[chunk.decompressor] for chunk in bag.chunks.values()), "none")


def chunks(file: BinaryIO, known: dict[int, RecordedTopic]) -> Iterator[tuple[str, bool, Iterator[Record]]]:
    """The compression of each chunk, whether it is whole, and its messages, from where the file stands.

    Topics are put into `known`. Any exception ends it: the file is cut off or damaged there, and no further chunk can
    be found. An exception of the messages concerns their chunk alone.
    """
    end = os.fstat(file.fileno()).st_size
    while file.tell() < end:
        header, data, is_whole = _record(file, end)
        kind = header.get_uint8("op")
        if kind == reader.RecordType.CHUNK:
            compression = header.get_string("compression")
            content = cut_chunks.decompressed(compression, data, header.get_uint32("size"))
            yield compression, is_whole, _messages(content, known)
        elif kind == reader.RecordType.CONNECTION:
            _note_topic(header, data, known)
        if not is_whole:
            raise reader.ReaderError("The last record is cut off.")


def _messages(data: bytes, known: dict[int, RecordedTopic]) -> Iterator[Record]:
    chunk = io.BytesIO(data)
    while chunk.tell() < len(data):
        header, content, is_whole = _record(chunk, len(data))
        if not is_whole:
            raise reader.ReaderError("The last record of the chunk is cut off.")
        if header.get_uint8("op") != reader.RecordType.MSGDATA:
            _note_topic(header, content, known)
        elif (topic := known.get(header.get_uint32("conn"))) is not None:  # unknown if an earlier chunk is damaged
            yield Record(topic, bag_time(header.get_time("time")), content)


def _note_topic(header: Any, content: bytes, known: dict[int, RecordedTopic]) -> None:
    number = header.get_uint32("conn")
    if number in known:
        return
    about = reader.Header.read(io.BytesIO(struct.pack("<L", len(content)) + content))
    latching = about.get("latching", b"0") == b"1"
    kind, text, md5 = (about.get_string(name) for name in ("type", "message_definition", "md5sum"))
    callerid = about.get("callerid", b"").decode("utf-8", "replace")
    known[number] = RecordedTopic(number, header.get_string("topic"), kind, text, md5, latching, callerid)


def _record(file: BinaryIO, end: int) -> tuple[Any, bytes, bool]:
    """Header and data of the next record, and whether the data are whole. Raises ReaderError: the header is not."""
    if reader.read_uint32(file) > end - file.tell():  # the library would ask for so much memory
        raise reader.ReaderError("The header is cut off.")
    file.seek(-4, os.SEEK_CUR)
    header = reader.Header.read(file)
    size = reader.read_uint32(file)
    data = file.read(min(size, end - file.tell()))
    return header, data, len(data) == size
