"""The log: one line from a node, out on `/rosout` and to whoever keeps it (the daemon's file).

Warnings and errors also become the reasons of the request that is being carried out, if one is. Knows no file and no
terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from slidectl.control.node_handle import Reasons
from slidectl.errors import cut
from slidectl.simulation.clock import stamp
from slidectl.simulation.topics import NodePublisher, Topics

LEVELS = {"debug": 1, "info": 2, "warn": 4, "error": 8, "fatal": 16}
TOPIC = "/rosout"
MOST_REASONS = 100
"""Reasons that one answer holds; the log has the rest."""
Sink = Callable[[str, str, str, int], None]
"""Takes severity, node, text, time in ns."""


class Rosout:
    """Publishes rosgraph_msgs/Log. `sink`, when set, gets every line whether somebody subscribes or not."""

    def __init__(self, topics: Topics, now_ns: Callable[[], int], node: str) -> None:
        self.sink: Sink | None = None
        self.reasons: Reasons | None = None
        """Those of the request that is being carried out. There is one thread, so there is at most one request."""
        self._now_ns = now_ns
        self._publisher = topics.advertise(TOPIC, "rosgraph_msgs/Log", node, kind=NodePublisher)

    def __call__(self, severity: str, node: str, text: str) -> None:
        """One line; `severity` is a key of LEVELS."""
        level = LEVELS[severity]
        text = cut(text)  # what a client sent may be part of it
        if self.reasons is not None and level >= LEVELS["warn"] and len(self.reasons) < MOST_REASONS:
            self.reasons.append(text)
        now = self._now_ns()
        if self.sink is not None:
            self.sink(severity, node, text, now)
        if self._publisher.wanted:
            self._publisher.publish(_log(level, node, text, now))
        else:
            self._publisher.sequence += 1

    @contextmanager
    def answering(self, reasons: Reasons | None) -> Iterator[None]:
        """Inside, lines are reasons of that request (of none: None)."""
        before, self.reasons = self.reasons, reasons
        try:
            yield
        finally:
            self.reasons = before


def _log(level: int, node: str, text: str, now_ns: int) -> dict[str, object]:
    return {
        "header": {"seq": 0, "stamp": stamp(now_ns), "frame_id": ""},
        "level": level,
        "name": node,
        "msg": text,
        "file": "",
        "function": "",
        "line": 0,
        "topics": [],
    }
