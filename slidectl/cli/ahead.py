"""`slidectl echo TOPIC` subscribes before click is imported: messages are on their way while that takes its time.

What it does is what the command would do first, on the connection that the command goes on with. Anything but the
plainest line, and whatever goes wrong, is left to the command: nothing is printed here, and nothing is kept then.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from slidectl.cli.context import DEFAULT_TIMEOUT_S, Context, Found
from slidectl.cli.topics import PUBLISHERS, look_up
from slidectl.client import Subscription
from slidectl.errors import SlidectlError

_PATIENCE_S = 0.2
"""A daemon that is slower is asked again, and waited for, by the command."""


class AheadContext(Context):
    """A context that has begun: it knows what was looked up, and has the subscription."""

    def __init__(self) -> None:
        super().__init__()
        self._found: dict[Hashable, Any] = {}
        self._subscriptions: dict[str, Subscription] = {}

    def recall(self, key: Hashable, find: Callable[[], Found]) -> Found:
        """What was found ahead, once: the command does not look it up again."""
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]  # type: ignore[no-any-return]

    def subscribe(self, topic: str) -> Subscription:
        """The subscription that was made ahead, else a new one."""
        return self._subscriptions.pop(topic, None) or super().subscribe(topic)

    def begin(self, target: str) -> None:
        """Look the topic up and subscribe it. Raises as the client does."""
        self.timeout = _PATIENCE_S
        topic = look_up(self, target, PUBLISHERS).topic
        self._subscriptions[topic] = self.client.subscribe(topic)
        self.timeout = None
        self.client.timeout = DEFAULT_TIMEOUT_S


def begin(argv: Sequence[str]) -> Context:
    """The context for a command line: one that has begun, where that is plain to do."""
    target = _target(argv)
    if target is not None:
        context = AheadContext()
        try:
            context.begin(target)
            return context
        except (SlidectlError, ValueError, TypeError, LookupError):  # the command will meet it too, and can tell
            context.close()
    return Context()


def _target(argv: Sequence[str]) -> str | None:
    """The topic of `echo TOPIC`, perhaps with `-n COUNT` and `--json`; None for all other lines."""
    words = [word for word in argv[1:] if word != "--json"]
    for place, word in enumerate(words[:-1]):
        if word == "-n" and words[place + 1].isdecimal():
            del words[place : place + 2]
            break
    plain = argv[0] == "echo" and len(words) == 1 and not words[0].startswith("-")
    return words[0] if plain and "SLIDECTL_NAMESPACE" not in os.environ else None
