"""Reads the whole messages of a chunk that is cut off, as a full disk leaves one at the end of a file."""

from __future__ import annotations

import io
import os
import struct
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from mcap.records import Chunk

_MCAP_RECORD = struct.Struct("<BQ")
"""The beginning of each record of .mcap: its kind, and the size of the rest."""
_MCAP_CHUNK = struct.Struct("<QQQLL")
"""Start, end, size before compression, checksum, and how long the name of the compression is."""
_MCAP_SIZE = struct.Struct("<Q")


def decompressed(compression: str, data: bytes, size: int) -> bytes:
    """The beginning of a chunk of `size` bytes, as far as the data go; empty when they are damaged.

    bz2 compresses up to 900 kB as one block, of which no part can be had; lz4 and zstd have smaller blocks.
    """
    with suppress(Exception):  # of the libraries, each of which has its own
        if compression in ("", "none"):
            return data
        if compression == "bz2":
            import bz2

            return bz2.BZ2Decompressor().decompress(data, size)
        if compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            return bytes(LZ4FrameDecompressor().decompress(data, size))
        if compression == "zstd":
            from zstandard import ZstdDecompressor

            return bytes(ZstdDecompressor().stream_reader(io.BytesIO(data)).read(size))
    return b""


def mcap_chunk(file: BinaryIO) -> Chunk | None:
    """The chunk of an .mcap file that is cut off, with the records in it that are whole; None when there is none.

    The file is positioned at the beginning of a record.
    """
    from mcap.opcode import Opcode
    from mcap.records import Chunk

    end = os.fstat(file.fileno()).st_size
    with suppress(struct.error, UnicodeDecodeError):
        while True:
            kind, size = _MCAP_RECORD.unpack(file.read(_MCAP_RECORD.size))
            if file.tell() + size > end:
                break
            file.seek(size, os.SEEK_CUR)
        if kind != Opcode.CHUNK:
            return None
        begin_ns, end_ns, whole_size, _, length = _MCAP_CHUNK.unpack(file.read(_MCAP_CHUNK.size))
        name = file.read(min(length, end)).decode()
        _MCAP_SIZE.unpack(file.read(_MCAP_SIZE.size))
        records = decompressed(name, file.read(), whole_size)
        return Chunk("", records[: _whole_records(records)], end_ns, begin_ns, 0, 0)
    return None


def _whole_records(records: bytes) -> int:
    """The size of the records of .mcap at the beginning that are whole."""
    place = 0
    while place + _MCAP_RECORD.size <= len(records):
        after = place + _MCAP_RECORD.size + _MCAP_RECORD.unpack_from(records, place)[1]
        if after > len(records):
            break
        place = after
    return place
