"""A recording of a replay: the messages of the run of a journal, recorded afterwards."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slidectl.errors import Refused
from slidectl.extensions.journal.journal import PICTURE
from slidectl.extensions.recording.recording_files import EVERY_CYCLE, Recorder

if TYPE_CHECKING:
    from slidectl.extensions.journal.journal_replay import Replay
    from slidectl.simulation.topics import TopicSubscription

_NODE = "/record"
_CHECK_EVERY_NS = 10_000_000
"""Simulated time between two checks for new topics, besides those after each entry of the journal."""


class ReplayRecording:
    """Subscribes to all topics of a replay, except pictures and those published in every cycle, after `begin_s`.

    `begin_s` is elapsed simulated time, also when the clock is set: the journal has a state for each second of it.

    A topic without other users is unsubscribed, so that the world has the same topics as in the run. The file is
    complete when the context ends; this raises Refused when the file could not be written completely.
    """

    def __init__(self, path: Path, begin_s: float = 0.0) -> None:
        """Raises Refused: the file exists, or cannot be created. UsageError, NoMcap: as recording_files.create."""
        if path.exists():
            raise Refused(f"{path} already exists", "give the recording another name, or remove that file")
        self._files = Recorder(path)
        self._trouble: OSError | None = None
        self._begin_s = begin_s
        self._early_ns: range | None = None
        """Clock times to skip in the second in which it begins, ns; None until that second."""
        self._has_begun = False
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._changes = -1
        self._left_out = re.compile(EVERY_CYCLE)

    def watch(self, replay: Replay) -> None:
        """Set the replay, before it runs."""
        self._replay, self._graph = replay, replay.simulation.graph
        replay.after_entry = self._subscribe
        self._graph.timers.every(_CHECK_EVERY_NS, self._subscribe)

    def _subscribe(self) -> None:
        topics = self._graph.topics
        if self._changes == topics.changes or not self._is_time():
            return
        for topic, subscription in list(self._subscriptions.items()):
            if not topics.publishers(topic) and topics.subscribers(topic) == [_NODE]:
                subscription.close()
                del self._subscriptions[topic]
        for topic, kind in topics.types().items():
            if topic not in self._subscriptions and kind != PICTURE and not self._left_out.fullmatch(topic):
                self._files.add(topic, kind)
                write = partial(self._write, topic)
                self._subscriptions[topic] = topics.subscribe(
                    topic, kind, _NODE, partial(write, False), partial(write, True)
                )
        self._changes = topics.changes

    def _is_time(self) -> bool:
        """True from `begin_s` on, also after the clock is set back."""
        whole_s, now_ns = int(self._begin_s), self._graph.clock.time_ns
        if self._early_ns is None and self._replay.states >= whole_s:
            self._early_ns = range(now_ns, now_ns + round((self._begin_s - whole_s) * 1e9))
        self._has_begun |= self._early_ns is not None and now_ns not in self._early_ns
        return self._has_begun

    def _write(self, topic: str, latched: bool, message: Any) -> None:
        if self._trouble:
            return
        try:
            self._files.write(topic, self._graph.clock.time_ns, message, latched)
        except OSError as error:  # raised at the end: a publisher must not get it
            self._trouble = error

    @property
    def messages(self) -> int:
        """The number of messages in the file."""
        return self._files.counts.total()

    def __enter__(self) -> ReplayRecording:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._files.close()
        except OSError as error:
            self._trouble = self._trouble or error
        if self._trouble is not None:
            raise self._files.incomplete(self._trouble)
