"""Simulated time as a number, as a message, and as the topic `/clock`.

Integer nanoseconds; the time of the machine has no place here.
"""

from __future__ import annotations

from typing import Any

from slidectl.control.duration import NANOSECONDS, to_stamp
from slidectl.control.node_handle import Publisher

SECOND = NANOSECONDS
stamp = to_stamp
"""The time as it stands on messages."""


class Clock:
    """The time of the last cycle begun, and how many there were."""

    __slots__ = ("cycles", "time_ns")

    def __init__(self) -> None:
        self.time_ns = 0
        self.cycles = 0

    def now_ns(self) -> int:
        """Time in nanoseconds."""
        return self.time_ns

    @property
    def seconds(self) -> float:
        """Time in seconds, correctly rounded."""
        return self.time_ns / SECOND


class ClockTopic:
    """Publishes `/clock`: at every cycle, or at a frequency when that is above 0 (gazebo_ros' pub_clock_frequency)."""

    __slots__ = ("_period_ns", "publisher")

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self._period_ns = 0

    def set_frequency(self, frequency_hz: Any) -> None:
        """Anything but a positive number means every cycle."""
        number = frequency_hz if isinstance(frequency_hz, int | float) and not isinstance(frequency_hz, bool) else 0
        self._period_ns = round(SECOND / number) if number > 0 else 0

    def tick(self, time_ns: int, step_ns: int) -> None:
        """A cycle has begun. Phases are multiples of the period, whoever listened before."""
        period = self._period_ns
        if not period or time_ns // period != (time_ns - step_ns) // period:
            self.publisher.publish({"clock": stamp(time_ns)})

    def publish_now(self, time_ns: int) -> None:
        """After the time was set, so that listeners need not wait for the next cycle."""
        if self.publisher.wanted:
            self.publisher.publish({"clock": stamp(time_ns)})
