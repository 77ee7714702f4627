"""Statistics of a stream: intervals (hz), sizes (bw) and delays, over a window of messages.

Numbers and their text, in the forms of rostopic with more digits. It reads no topic itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from slidectl.cli.topics import Schema
from slidectl.msgs.schema import BYTES, TIMES

_SIZES = {
    "bool": 1, "int8": 1, "uint8": 1, "byte": 1, "char": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "float32": 4, "int64": 8, "uint64": 8, "float64": 8, "time": 8, "duration": 8,
}  # fmt: skip


class Spread:
    """Minimum, maximum, mean, population standard deviation and percentiles of numbers. There must be one at least."""

    def __init__(self, numbers: Sequence[float]) -> None:
        ordered = sorted(numbers)
        count = len(ordered)
        self.min, self.max = ordered[0], ordered[-1]
        self.mean = math.fsum(ordered) / count
        self.std_dev = math.sqrt(math.fsum((number - self.mean) ** 2 for number in ordered) / count)
        self.p50 = ordered[(count - 1) // 2]
        self.p99 = ordered[math.ceil(0.99 * count) - 1]

    def record(self) -> dict[str, float]:
        """The figures by name, those that every report has."""
        return {"min": self.min, "max": self.max, "std_dev": self.std_dev, "p50": self.p50, "p99": self.p99}

    def line(self, window: int) -> str:
        """The second line of a report, as rostopic indents it, with microseconds."""
        return f"\tmin: {self.min:.6f}s max: {self.max:.6f}s std dev: {self.std_dev:.6f}s window: {window}"


class Meter:
    """Base of the three: `take` one message with its times in seconds, `record` the figures at the time `now`."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.total = 0
        self.new = 0
        self.now = 0.0

    def count(self) -> None:
        self.total += 1
        self.new += 1

    def record(self) -> dict[str, Any]:
        """The figures; those that cannot be told yet are None. `new` counts messages since the last report."""
        raise NotImplementedError

    def text(self) -> str:
        """The figures in rostopic's form, or `no new messages`."""
        raise NotImplementedError


class RateMeter(Meter):
    """Intervals between messages; a silent topic keeps its rate. A clock that jumps back starts the window anew."""

    def __init__(self, topic: str, window: int) -> None:
        super().__init__(topic)
        self._intervals: deque[float] = deque(maxlen=window - 1)
        self._last: int | None = None

    def take(self, at_ns: int) -> None:
        """A message at this time."""
        self.count()
        if self._last is not None and at_ns < self._last:
            self._intervals.clear()
        elif self._last is not None:
            self._intervals.append((at_ns - self._last) / 1e9)
        self._last = at_ns

    def spread(self) -> Spread | None:
        """The spread of the intervals in s; None before the second message."""
        return Spread(self._intervals) if self._intervals else None

    def rate(self) -> float | None:
        """Messages per second; None before the second message or when all came at one time."""
        spread = self.spread()
        return 1.0 / spread.mean if spread is not None and spread.mean > 0 else None

    def record(self) -> dict[str, Any]:
        spread = self.spread()
        figures = spread.record() if spread else dict.fromkeys(("min", "max", "std_dev", "p50", "p99"))
        window = len(self._intervals) + 1 if self.total else 0
        return {"topic": self.topic, "rate": self.rate(), **figures, "window": window, "new": self.new}

    def text(self) -> str:
        spread, rate = self.spread(), self.rate()
        if not self.new or spread is None:
            return "no new messages"
        shown = "inf" if rate is None else f"{rate:.3f}"
        return f"average rate: {shown}\n{spread.line(len(self._intervals) + 1)}"


class SizeMeter(Meter):
    """Bytes per second, counted from the oldest message of the window to `now`."""

    def __init__(self, topic: str, window: int) -> None:
        super().__init__(topic)
        self._messages: deque[tuple[float, int]] = deque(maxlen=window)

    def take(self, at: float, size: int) -> None:
        """A message of `size` bytes at this time."""
        self.count()
        if self._messages and at < self._messages[-1][0]:
            self._messages.clear()
        self._messages.append((at, size))

    def rate(self) -> float | None:
        """Bytes per second; None before the second message or when no time has passed."""
        if len(self._messages) < 2 or self.now <= self._messages[0][0]:
            return None
        return sum(size for _, size in self._messages) / (self.now - self._messages[0][0])

    def record(self) -> dict[str, Any]:
        sizes = [size for _, size in self._messages]
        spread = Spread(sizes) if sizes else None
        figures = (
            {"mean": spread.mean, "min": spread.min, "max": spread.max}
            if spread
            else dict.fromkeys(("mean", "min", "max"))
        )
        return {"topic": self.topic, "rate": self.rate(), **figures, "window": len(sizes), "new": self.new}

    def text(self) -> str:
        rate = self.rate()
        if rate is None:
            return "no new messages"
        spread = Spread([size for _, size in self._messages])
        mean, least, most = map(_bytes, (spread.mean, spread.min, spread.max))
        return f"average: {_bytes(rate)}/s\n\tmean: {mean} min: {least} max: {most} window: {len(self._messages)}"


def _bytes(number: float) -> str:
    divisor, unit = (1, "B") if number < 1000 else (1000, "KB") if number < 1_000_000 else (1_000_000, "MB")
    return f"{number / divisor:.2f}{unit}"


class DelayMeter(Meter):
    """Time from a message's stamp to its arrival."""

    def __init__(self, topic: str, window: int) -> None:
        super().__init__(topic)
        self._delays: deque[float] = deque(maxlen=window)

    def take(self, delay: float) -> None:
        """A message that came `delay` s after its stamp."""
        self.count()
        self._delays.append(delay)

    def spread(self) -> Spread | None:
        """The spread of the delays in s; None before the first message."""
        return Spread(self._delays) if self._delays else None

    def record(self) -> dict[str, Any]:
        spread = self.spread()
        figures = spread.record() if spread else dict.fromkeys(("min", "max", "std_dev", "p50", "p99"))
        delay = spread.mean if spread else None
        return {"topic": self.topic, "delay": delay, **figures, "window": len(self._delays), "new": self.new}

    def text(self) -> str:
        if not self.new:
            return "no new messages"
        spread = Spread(self._delays)
        return f"average delay: {spread.mean:.6f}\n{spread.line(len(self._delays))}"


def size_counter(schema: Schema) -> Callable[[dict[str, Any]], int]:
    """The function that gives the bytes of a message in ROS 1's serialisation (what rostopic bw counts)."""
    return lambda message: _size(schema, schema.root, message)


def _size(schema: Schema, type_name: str, value: Any) -> int:
    if type_name in _SIZES:
        return _SIZES[type_name]
    if type_name == "string":
        return 4 + len(value.encode("utf-8", "surrogatepass"))
    return sum(_field_size(schema, f.type, f.array, value[f.name]) for f in schema.fields(type_name))


def _field_size(schema: Schema, type_name: str, array: int, value: Any) -> int:
    if array < 0:
        return _size(schema, type_name, value)
    prefix = 4 if array == 0 else 0
    if type_name in BYTES and isinstance(value, str):
        return prefix + len(value.rstrip("=")) * 3 // 4
    if type_name in _SIZES or type_name in TIMES:
        return prefix + _SIZES[type_name] * len(value)
    return prefix + sum(_size(schema, type_name, element) for element in value)
