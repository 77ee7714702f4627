"""Publishing for `slidectl pub`: fill a message, send it, wait until it has been taken in; at a rate if wanted.

It knows the topic and gets parsed values; where these come from is for pub.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any

from slidectl.cli.values import is_numeric
from slidectl.errors import TimedOut
from slidectl.msgs.fill import fields_from, fill

if TYPE_CHECKING:
    from slidectl.cli.context import Context
    from slidectl.cli.templates import Template
    from slidectl.cli.topics import Target

Values = Sequence[Any]
"""What a message is made of: one mapping of fields, or one value for each field."""

_FELL_BEHIND_S = 1.0
_KEPT_UP = 0.95
_MOST_TOLD = 5
"""Different warnings that one command passes on: a wave beyond the limits has a new one in every message."""


class Publication:
    """Messages on one topic. Leaving its `with` tells what was published, and whether the rate was kept."""

    def __init__(self, ctx: Context, target: Target, rate: float | None, *, latch: bool, advertise: bool) -> None:
        self._ctx = ctx
        self._target = target
        self._rate = rate
        self._latch = latch
        self._type = target.type if advertise else None
        self._fields_of = fields_from(target.typedefs)
        self._began = self._latest = 0.0
        self._told: set[str] = set()
        self.published = 0

    def __enter__(self) -> Publication:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._rate is not None and kind in (None, KeyboardInterrupt):
            self._judge_rate(self._rate)
        if kind is None:
            target = self._target
            record = {
                "topic": target.topic,
                "type": target.type,
                "published": self.published,
                "subscribers": target.users,
            }
            self._ctx.emit(record, "")
            if self._ctx.verbose:
                users = ", ".join(target.users) or "nobody"
                self._ctx.detail(f"published {self.published} on {target.topic} to {users}")

    def _judge_rate(self, rate: float) -> None:
        seconds = self._latest - self._began
        reached = (self.published - 1) / seconds if seconds > 0 else math.inf
        # One late message among a handful says nothing about the rate.
        if self.published > 10 and reached < _KEPT_UP * rate:
            self._ctx.warn(f"published at {reached:.1f} Hz instead of {rate:g} Hz")

    def publish(self, sources: Iterable[Values]) -> None:
        """Send one message for each of the values and wait until it has been taken in.

        Raises:
            BadMessage: values that do not fit the type. MessageRefused: a subscriber will not take the message.
            ExpressionError, EvaluationError: an expression that is none, or cannot be computed. NoDaemon, TimedOut.
        """
        previous: Values | None = None
        template: Template | None = None
        self._began = monotonic()
        for index, values in enumerate(sources):
            if values is not previous:
                template, previous = self._template(values), values
            self._wait_for(index)
            self._send(values if template is None else template.at(index, index / (self._rate or 1.0)), template)

    def hold(self) -> None:
        """Stay connected, so that a latched message stays. Raises TimedOut after `--timeout`, NoDaemon."""
        self._ctx.say(f"{self._target.topic} is latched; Ctrl-C ends it")
        limit = self._ctx.wait_limit(math.inf)
        deadline = monotonic() + limit
        while (left := deadline - monotonic()) > 0:
            next(self._ctx.client.events(left), None)
        raise TimedOut(f"{self._target.topic} was latched for {limit:g} s")

    def _template(self, values: Values) -> Template | None:
        """None for values without text: nothing in them can be an expression or stand for the time."""
        if is_numeric(values):
            return None
        from slidectl.cli.templates import Template

        return Template(self._target.schema, values, expressions=self._rate is not None)

    def _wait_for(self, index: int) -> None:
        """Until the message of this number is due. The schedule is absolute; after a long halt it begins anew."""
        if self._rate is None:
            return
        due = self._began + index / self._rate
        late = monotonic() - due
        if late > _FELL_BEHIND_S:
            self._began += late
        while (left := due - monotonic()) > 0:
            next(self._ctx.client.events(left), None)

    def _send(self, values: Values, template: Template | None) -> None:
        client, target = self._ctx.client, self._target
        now = None
        if template is not None and template.needs_clock:
            time = client.call("/rosapi/get_time")["time"]
            now = (time["secs"], time["nsecs"])
        message = fill(self._fields_of, target.type, values, now)
        client.deliver(target.topic, message, self._type, self._latch)
        self.published += 1
        self._latest = monotonic()
        self._pass_on(client.reasons)

    def _pass_on(self, reasons: Sequence[str]) -> None:
        """What the subscribers say of a message that they took; the same words once, and no more than a few."""
        for reason in reasons:
            if reason not in self._told and len(self._told) < _MOST_TOLD:
                self._told.add(reason)
                self._ctx.warn(reason)
