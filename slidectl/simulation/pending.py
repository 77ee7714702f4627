"""An answer that may come later: what a service call gives when its effect needs simulated time.

Single-threaded and without waiting: whoever is interested hangs a callback on it. Not a future of asyncio.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from slidectl.errors import SlidectlError


class Pending:
    """Settled once, by `resolve`, `reject` or `cancel`; what comes after the first of them is ignored."""

    __slots__ = ("_callbacks", "_value", "cancelled", "done", "error", "on_cancel")

    def __init__(self, on_cancel: Callable[[], None] | None = None) -> None:
        self.done = False
        self.cancelled = False
        self.error: SlidectlError | None = None
        self.on_cancel = on_cancel
        """Called once when the asker has gone; lets the answering side drop its work."""
        self._value: Any = None
        self._callbacks: list[Callable[[Pending], None]] = []

    @classmethod
    def of(cls, value: Any) -> Pending:
        """An answer that is there already."""
        pending = cls()
        pending.resolve(value)
        return pending

    @classmethod
    def attempt(cls, call: Callable[[], Any]) -> Pending:
        """What the call gives: that answer if it is one (a Pending), else one that is there, or refused as the call."""
        pending = cls()
        try:
            given = call()
        except SlidectlError as error:
            pending.reject(error)
            return pending
        return given if isinstance(given, Pending) else cls.of(given)

    def resolve(self, value: Any) -> None:
        """The answer. Callbacks run before this returns."""
        if not self.done:
            self._value = value
            self._settle()

    def reject(self, error: SlidectlError) -> None:
        """There will be no answer, for this reason."""
        if not self.done:
            self.error = error
            self._settle()

    def settle(self, call: Callable[[], Any]) -> None:
        """The answer is what the call gives; a SlidectlError that it raises fails it."""
        try:
            value = call()
        except SlidectlError as error:
            self.reject(error)
        else:
            self.resolve(value)

    def cancel(self) -> None:
        """The asker has gone: no callback is called any more, and the answering side is told."""
        if self.done:
            return
        self.done = self.cancelled = True
        self._callbacks.clear()
        on_cancel, self.on_cancel = self.on_cancel, None
        if on_cancel is not None:
            on_cancel()

    def then(self, callback: Callable[[Pending], None]) -> Pending:
        """Call back with this object as soon as it is settled, at once when it is already. Returns itself."""
        if not self.done:
            self._callbacks.append(callback)
        elif not self.cancelled:
            callback(self)
        return self

    def converted(self, convert: Callable[[Pending], Any]) -> Pending:
        """The answer that `convert` makes of this one when it is settled; a SlidectlError that it raises fails it.

        Cancelling it cancels this one.
        """
        answer = Pending(on_cancel=self.cancel)
        self.then(lambda done: answer.settle(lambda: convert(done)))
        return answer

    def result(self) -> Any:
        """The answer.

        Raises:
            SlidectlError: the call failed. RuntimeError: asked before it is settled, or after it was cancelled.
        """
        if self.error is not None:
            raise self.error
        if not self.done or self.cancelled:
            raise RuntimeError("no answer: " + ("cancelled" if self.cancelled else "not yet settled"))
        return self._value

    def _settle(self) -> None:
        self.done = True
        self.on_cancel = None  # it refers to this object, whose answer may be large: not to be left to the collector
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)
