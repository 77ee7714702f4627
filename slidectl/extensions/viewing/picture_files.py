"""Picture files (.png, by the standard library) and video files (.mp4 and .gif, by PyAV)."""

from __future__ import annotations

import struct
import zlib
from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slidectl import writing
from slidectl.errors import Refused, UsageError
from slidectl.paths import install_command

FASTEST = {".mp4": 240, ".gif": 50}
"""Maximum pictures per second. GIF times are in hundredths of a second, and viewers show a picture for at least two."""

Pixels = NDArray[np.uint8]
"""RGB, shape (height, width, 3)."""


def write_png(path: Path, pixels: Pixels) -> None:
    """Write a PNG file. Raises Refused: it cannot be written."""
    height, width, _ = pixels.shape
    rows = np.concatenate((np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)), axis=1)  # 0: no filter
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits per channel, RGB
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    chunks = (struct.pack(">I", len(d)) + name + d + struct.pack(">I", zlib.crc32(name + d)) for name, d in parts)
    try:
        writing.write_whole(path, b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    except OSError as error:
        raise writing.CannotWrite(path, error) from None


def check_video(path: Path, size: tuple[int, int], rate: Fraction) -> None:
    """Check the arguments of a VideoFile. Raises UsageError: invalid kind, size or rate. Refused: PyAV is missing."""
    kind = path.suffix.lower()
    if kind not in FASTEST:
        raise UsageError(f"{path} is no video that can be written", f"kinds: {', '.join(FASTEST)}")
    if rate > FASTEST[kind]:
        raise UsageError(f"{kind} takes at most {FASTEST[kind]} pictures a second, not {float(rate):g}")
    if kind == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise UsageError(f".mp4 takes even widths and heights, not {size[0]}x{size[1]}")
    try:
        import av  # noqa: F401
    except ImportError:
        raise Refused("videos need the library PyAV", f"install it: {install_command('video')}") from None


class VideoFile:
    """A video file with an exact rate. It is there, and can be played, after `close`; after a failure it is not."""

    def __init__(self, path: Path, size: tuple[int, int], rate: Fraction) -> None:
        """Takes arguments that `check_video` accepts. Raises Refused: the file cannot be written."""
        import av

        kind = path.suffix.lower()
        self.path = path
        self.count = 0
        """The number of pictures so far."""
        self._av: Any = av
        self._failure: Refused | None = None
        self._leaving = ExitStack()
        self.rate = rate
        try:
            file = self._leaving.enter_context(writing.whole_file(path))
            self._file = av.open(file, "w", format=kind.removeprefix("."))
        except OSError as error:
            raise self._failed(error) from None
        codec, options = ("libx264", {"preset": "veryfast"}) if kind == ".mp4" else ("gif", {})
        video: Any = self._file
        self._stream = video.add_stream(codec, rate=rate, options=options)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p" if kind == ".mp4" else "pal8"
        self._stream.codec_context.time_base = 1 / rate
        self._graph = None if kind == ".mp4" else self._palettes(size)

    def _palettes(self, size: tuple[int, int]) -> Any:
        """A filter graph that gives each picture of a GIF its own 256 colours."""
        graph = self._av.filter.Graph()
        source = graph.add_buffer(width=size[0], height=size[1], format="rgb24", time_base=1 / self.rate)
        split, palette = graph.add("split"), graph.add("palettegen", "stats_mode=single")
        use, sink = graph.add("paletteuse", "new=1:dither=none"), graph.add("buffersink")
        source.link_to(split)
        split.link_to(palette, 0, 0)
        split.link_to(use, 1, 0)
        palette.link_to(use, 0, 1)
        use.link_to(sink)
        graph.configure()
        return graph

    def add(self, pixels: Pixels) -> None:
        """Add a picture. Raises Refused: it cannot be written."""
        frame = self._av.VideoFrame.from_ndarray(pixels, "rgb24")
        frame.pts, frame.time_base = self.count, 1 / self.rate
        try:
            if self._graph is not None:
                self._graph.push(frame)
                frame = self._graph.pull()
            self._file.mux(self._stream.encode(frame))
        except OSError as error:
            raise self._failed(error) from None
        self.count += 1

    def close(self) -> None:
        """Complete the file. Raises Refused: it cannot be written, or an earlier picture could not."""
        try:
            if self._failure is None:  # encoding into a file that has failed would crash the process
                self._file.mux(self._stream.encode())
                self._file.close()
                self._leaving.close()
        except OSError as error:
            raise self._failed(error) from None
        if self._failure is not None:
            raise self._failure

    def _failed(self, error: OSError) -> Refused:
        self._failure = writing.CannotWrite(self.path, error)
        with suppress(OSError):  # so that the file is removed
            self._leaving.__exit__(type(error), error, error.__traceback__)
        return self._failure
