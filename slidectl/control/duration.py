"""Durations as ros::Duration computes them: integer nanoseconds inside, seconds as `sec + 1e-9 * nsec`.

Results equal those of ROS to the bit, since control laws multiply and divide by these seconds. Reads no clock.
"""

from __future__ import annotations

from math import ceil, floor, isfinite
from typing import Any

from slidectl.control.laws import law
from slidectl.errors import UsageError

NANOSECONDS = 1_000_000_000
_MOST_SECONDS = 2**31 - 1


class BadDuration(UsageError):
    """Seconds that no duration can hold: not a number, infinite, or beyond 32 bits of seconds."""

    def __init__(self, seconds: float) -> None:
        super().__init__(f"{seconds!r} s is not a valid duration: it must be within ±{_MOST_SECONDS} s")


@law
def to_seconds(ns: int) -> float:
    """Seconds of `ns` nanoseconds, rounded as ros::Duration::toSec rounds."""
    seconds, nanoseconds = divmod(ns, NANOSECONDS)
    return seconds + 1e-9 * nanoseconds


def from_seconds(seconds: float) -> int:
    """Nanoseconds nearest to `seconds`, halves away from zero, as ros::Duration(double).

    Raises:
        BadDuration: not finite, or too long for 32 bits of seconds.
    """
    if not isfinite(seconds) or abs(seconds) > _MOST_SECONDS:
        raise BadDuration(seconds)
    return nearest_ns(seconds)


@law
def nearest_ns(seconds: float) -> int:
    """`from_seconds` without the check of the range."""
    whole = floor(seconds)
    value = (seconds - whole) * 1e9
    above = ceil(value)  # not floor(value + 0.5): that sum may round up by itself
    return whole * NANOSECONDS + (above - 1 if above - value > 0.5 else above)


def to_stamp(ns: int) -> dict[str, int]:
    """The time as a message holds it."""
    seconds, nanoseconds = divmod(ns, NANOSECONDS)
    return {"secs": seconds, "nsecs": nanoseconds}


def header_of(ns: int, frame: str = "") -> dict[str, Any]:
    """std_msgs/Header of a message at that time. The publisher sets `seq`."""
    return {"seq": 0, "stamp": to_stamp(ns), "frame_id": frame}
