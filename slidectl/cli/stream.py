"""Messages of some topics as they come, until a simulated time has passed, with the drops counted.

Shared by the commands that follow topics. It waits on the one connection and prints nothing but the count of
dropped messages at the end.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl.cli.output import watch_reader

if TYPE_CHECKING:
    from slidectl.cli.context import Context
    from slidectl.client import Subscription

CLOCK = "/clock"
_SILENCE_S = 1.0
_ASK_AGAIN_S = 5.0


class Event(NamedTuple):
    """One message. `time_ns` is the simulated time when it came (0 when the clock is not followed)."""

    topic: str
    message: dict[str, Any]
    time_ns: int


class Stream:
    """A context manager. `with_clock` follows /clock too; `sim_seconds` of simulated time end the stream."""

    def __init__(
        self, ctx: Context, topics: list[str], *, with_clock: bool = False, sim_seconds: float | None = None
    ) -> None:
        self._ctx = ctx
        self._client = ctx.client
        self._topics = topics
        self._queue: deque[Event] = deque()
        self._with_clock = with_clock
        self._sim_seconds = sim_seconds
        self._subscriptions: list[Subscription] = []
        self._sleep: str | None = None
        self._status: str | None = None
        self._doubt = math.inf
        self.time_ns = 0
        self.ended = False

    def __enter__(self) -> Stream:
        watch_reader()
        if self._with_clock:
            self.time_ns = nanoseconds(self._client.call("/rosapi/get_time")["time"])
        if self._with_clock and CLOCK not in self._topics:
            self._follow(CLOCK, self._tick)
        if self._sim_seconds is not None:  # first, so that who sees us listen can rely on it
            self._sleep = self._client.call_async("/slidectl/sleep", {"duration": self._sim_seconds})
        for topic in self._topics:
            self._follow(topic, self._keeper(topic))
        self._doubt = monotonic() + _SILENCE_S
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for subscription in self._subscriptions:
            subscription.close()
        dropped = sum(subscription.dropped for subscription in self._subscriptions)
        if dropped:
            self._ctx.warn(f"{dropped} messages were dropped: they came faster than they were read")

    def _follow(self, topic: str, take: Callable[[dict[str, Any]], None]) -> None:
        subscription = self._ctx.subscribe(topic)
        for _ in range(len(subscription)):
            take(subscription.get())
        subscription.put = take  # type: ignore[method-assign, assignment]
        self._subscriptions.append(subscription)

    def _tick(self, message: dict[str, Any]) -> None:
        self.time_ns = nanoseconds(message["clock"])

    def _keeper(self, topic: str) -> Callable[[dict[str, Any]], None]:
        def keep(message: dict[str, Any]) -> None:
            if topic == CLOCK:
                self._tick(message)
            self._queue.append(Event(topic, message, self.time_ns))

        return keep

    def next(self, deadline: float = math.inf) -> Event | None:
        """The next message, or None: at the deadline (`time.monotonic()`), or at the end, when `ended` is true.

        Raises:
            NoDaemon: the daemon went away. Refused: the wait for the simulated time failed.
        """
        while not self._queue and not self.ended:
            if self._sleep is not None and self._client.is_answered(self._sleep):
                self._client.answer(self._sleep)
                self.ended = True
                break
            wire = next(self._client.events(max(0.0, min(deadline, self._doubt) - monotonic())), None)
            if wire is None and monotonic() >= deadline:
                return None
            if wire is None:
                self._ask_why()
            elif wire.get("op") == "service_response":
                self._take_answer(wire)
            elif self._queue and self._doubt < math.inf:
                self._doubt = monotonic() + _SILENCE_S
        return self._queue.popleft() if self._queue else None

    def _ask_why(self) -> None:
        """Nothing has come for a while: that may be because the world stands still."""
        self._doubt = monotonic() + _ASK_AGAIN_S
        self._status = self._client.call_async("/slidectl/status")

    def _take_answer(self, response: dict[str, Any]) -> None:
        if response.get("id") != self._status:
            return
        status = self._client.answer(str(self._status))
        if status["paused"]:
            self._doubt = math.inf  # said once
            self._ctx.say(
                f"{paused(status)}; nothing comes until it goes on: slidectl sim resume, or slidectl sim step"
            )

    @property
    def is_drained(self) -> bool:
        """True when all that has been taken in was read; latched messages are taken in on entry."""
        return not self._queue


def paused(status: dict[str, Any]) -> str:
    """That the world of an answer of /slidectl/status stands still, and why, where nobody wanted it."""
    return "the simulation is paused" + (f" ({status['trouble']})" if status.get("trouble") else "")


def nanoseconds(time: dict[str, int]) -> int:
    """A time message in nanoseconds."""
    return time["secs"] * 10**9 + time["nsecs"]
