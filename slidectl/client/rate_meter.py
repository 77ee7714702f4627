"""The rate of messages."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise


class RateMeter:
    """The rate of the last `most` messages, or of the messages in the last `span_ns` (at least two).

    It starts again when the clock or the count jumps back: after a reset, or with another publisher.
    """

    def __init__(self, most: int | None = None, span_ns: float = math.inf) -> None:
        self._span_ns = span_ns
        self._taken: deque[tuple[int, int]] = deque(maxlen=most)
        """Time in ns and count of each message."""

    def __len__(self) -> int:
        return len(self._taken)

    def add(self, time_ns: int, count: int | None = None) -> None:
        """Add a message. `count`: messages that the publisher had sent before, if not all of them are added."""
        last_ns, last = self._taken[-1] if self._taken else (time_ns, -1)
        count = last + 1 if count is None else count
        if time_ns < last_ns or count < last:
            self._taken.clear()
        self._taken.append((time_ns, count))
        while len(self._taken) > 2 and time_ns - self._taken[0][0] > self._span_ns:
            self._taken.popleft()

    @property
    def rate(self) -> float | None:
        """The rate in Hz; None while unknown."""
        if not self._taken:
            return None
        (begin_ns, first), (end_ns, last) = self._taken[0], self._taken[-1]
        return (last - first) * 1e9 / (end_ns - begin_ns) if end_ns > begin_ns else None

    @property
    def intervals(self) -> list[float]:
        """The intervals between consecutive messages, s."""
        return [(after - before) / 1e9 for (before, _), (after, _) in pairwise(self._taken)]

    def is_silent(self, now_ns: int) -> bool:
        """True when no message came for longer than `span_ns` and for longer than twice the last interval."""
        times_ns = [time_ns for time_ns, _ in self._taken]
        return bool(times_ns) and now_ns - times_ns[-1] > max(self._span_ns, 2 * (times_ns[-1] - times_ns[-2:][0]))
