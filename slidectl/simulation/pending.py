"""An answer that may come later: the result of a service call whose effect needs simulated time.

It is single-threaded and never blocks: callers add a callback. It is not an asyncio future.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from slidectl.errors import SlidectlError


class Pending:
    """Settled once, by `resolve`, `reject` or `cancel`; later calls of these are ignored."""

    __slots__ = ("_callbacks", "_value", "cancelled", "done", "error", "on_cancel")

    def __init__(self, on_cancel: Callable[[], None] | None = None) -> None:
        self.done = False
        self.cancelled = False
        self.error: SlidectlError | None = None
        self.on_cancel = on_cancel
        """Called once when the caller cancels; lets the answering side drop its work."""
        self._value: Any = None
        self._callbacks: list[Callable[[Pending], None]] = []

    @classmethod
    def of(cls, value: Any) -> Pending:
        """An answer that is already resolved."""
        pending = cls()
        pending.resolve(value)
        return pending

    @classmethod
    def attempt(cls, call: Callable[[], Any]) -> Pending:
        """The Pending that the call returns, or one resolved with what it returns; rejected when the call raises."""
        pending = cls()
        try:
            given = call()
        except SlidectlError as error:
            pending.reject(error)
            return pending
        return given if isinstance(given, Pending) else cls.of(given)

    def resolve(self, value: Any) -> None:
        """Set the answer. Callbacks run before this returns."""
        if not self.done:
            self._value = value
            self._settle()

    def reject(self, error: SlidectlError) -> None:
        """Fail with this error."""
        if not self.done:
            self.error = error
            self._settle()

    def settle(self, call: Callable[[], Any]) -> None:
        """Resolve with what the call returns, or reject with the SlidectlError that it raises."""
        try:
            value = call()
        except SlidectlError as error:
            self.reject(error)
        else:
            self.resolve(value)

    def cancel(self) -> None:
        """The caller does not want the answer any more: drop all callbacks, and call `on_cancel`."""
        if self.done:
            return
        self.done = self.cancelled = True
        self._callbacks.clear()
        on_cancel, self.on_cancel = self.on_cancel, None
        if on_cancel is not None:
            on_cancel()

    def then(self, callback: Callable[[Pending], None]) -> Pending:
        """Call back with this object when it is settled, or at once when it is already. Returns itself."""
        if not self.done:
            self._callbacks.append(callback)
        elif not self.cancelled:
            callback(self)
        return self

    def converted(self, convert: Callable[[Pending], Any]) -> Pending:
        """A new answer: the result of `convert` for this one when it is settled. A SlidectlError rejects it.

        Cancelling the new one cancels this one.
        """
        answer = Pending(on_cancel=self.cancel)
        self.then(lambda done: answer.settle(lambda: convert(done)))
        return answer

    def result(self) -> Any:
        """The answer.

        Raises SlidectlError: the call failed. RuntimeError: the answer is not settled, or was cancelled.
        """
        if self.error is not None:
            raise self.error
        if not self.done or self.cancelled:
            raise RuntimeError("no answer: " + ("cancelled" if self.cancelled else "not yet settled"))
        return self._value

    def _settle(self) -> None:
        self.done = True
        self.on_cancel = None  # break the reference cycle, so that a large answer is freed without the collector
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)
