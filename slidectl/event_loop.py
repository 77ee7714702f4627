"""The event loop: sockets, one deadline, and work that is done a piece at a time. Redis's `ae` is the model.

It serves the daemon, launches and the workers of a test run, and knows nothing of them. It waits in microseconds, which
asyncio and epoll's own wait (whole milliseconds) cannot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from slidectl.operating_system import HANG_UP, ONCE, PEER_CLOSED, READ, WRITE, poller

__all__ = ["HANG_UP", "ONCE", "PEER_CLOSED", "READ", "WRITE", "EventLoop"]

_LONGEST_WAIT_S = 1e6
"""The longest wait: `select` has a limit. A longer wait returns early."""
_EPOLL_S = 0.001
"""The unit of epoll's own wait, which is rounded up."""

Handler = Callable[[int], None]
"""Handles the ready events: a mix of READ, WRITE, PEER_CLOSED and HANG_UP."""


class EventLoop:
    """Handlers by file descriptor."""

    def __init__(self) -> None:
        self._epoll, self._is_ready, self._read_all = poller()
        self._handlers: dict[int, Handler] = {}
        self._soon: deque[Callable[[], None]] = deque()

    def watch(self, fd: int, events: int, handler: Handler) -> None:
        """Call `handler` whenever one of the events is ready; HANG_UP is always included."""
        self._handlers[fd] = handler
        self._epoll.register(fd, events)

    def change(self, fd: int, events: int) -> None:
        """Change the watched events of a descriptor."""
        self._epoll.modify(fd, events)

    def read_all(self, fd: int) -> None:
        """Tell that all was read that had come on a descriptor that is watched ONCE, but not its end."""
        self._read_all(fd)

    def forget(self, fd: int) -> None:
        """Stop watching a descriptor; call this before it is closed."""
        if self._handlers.pop(fd, None) is not None:
            self._epoll.unregister(fd)

    def soon(self, action: Callable[[], None]) -> None:
        """Call `action` later: each `poll` calls one such action."""
        self._soon.append(action)

    def is_ready(self) -> bool:
        """True when `poll` would have something to do at once. Costs a microsecond."""
        return bool(self._soon or self._is_ready(0.0))

    def poll(self, timeout_s: float | None) -> None:
        """Handle what is ready, after a wait of at most `timeout_s`, or a millisecond less; None: no limit."""
        if self._soon:
            self._soon.popleft()()
            timeout_s = 0.0
        wait_s = _LONGEST_WAIT_S if timeout_s is None else min(timeout_s, _LONGEST_WAIT_S)
        epoll_s = 0.0
        if wait_s > 2.0 * _EPOLL_S:  # one system call; the next `poll` waits for the exact rest, with two
            epoll_s = wait_s - _EPOLL_S
        elif wait_s and not self._is_ready(wait_s):
            return
        for fd, events in self._epoll.poll(epoll_s):
            handler = self._handlers.get(fd)
            if handler is not None:  # an earlier handler of this round may have closed it
                handler(events)

    def close(self) -> None:
        """Nothing is watched any more."""
        self._handlers.clear()
        self._soon.clear()
        self._epoll.close()
