"""The event loop: sockets, one deadline, and work that is done a piece at a time. Redis's `ae` is the model.

Serves the daemon, launches and the workers of a test run, and knows nothing of them. Waits in microseconds, which
asyncio and epoll's own wait (whole milliseconds) cannot.
"""

from __future__ import annotations

import select
from collections import deque
from collections.abc import Callable

READ = select.EPOLLIN
WRITE = select.EPOLLOUT
HANG_UP = select.EPOLLHUP | select.EPOLLERR
PEER_CLOSED = select.EPOLLRDHUP
ONCE = select.EPOLLET | PEER_CLOSED
"""Tell of each arrival once instead of as long as something is there. Only so are events told in order of arrival."""

_LONGEST_WAIT_S = 1e6
"""`select` takes no wait of any length; who asks for a longer one is called sooner."""
_EPOLL_S = 0.001
"""In what epoll's own wait counts, rounded up."""

Handler = Callable[[int], None]
"""Takes the events that are ready: a mix of READ, WRITE, PEER_CLOSED and HANG_UP."""


class EventLoop:
    """Handlers by file descriptor. An epoll descriptor can itself be waited for, and `select` waits in microseconds."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._waiting = [self._epoll.fileno()]
        self._handlers: dict[int, Handler] = {}
        self._soon: deque[Callable[[], None]] = deque()

    def watch(self, fd: int, events: int, handler: Handler) -> None:
        """Call `handler` whenever one of the events is ready; HANG_UP always counts."""
        self._handlers[fd] = handler
        self._epoll.register(fd, events)

    def change(self, fd: int, events: int) -> None:
        """Wait for other events."""
        self._epoll.modify(fd, events)

    def forget(self, fd: int) -> None:
        """Before the descriptor is closed."""
        if self._handlers.pop(fd, None) is not None:
            self._epoll.unregister(fd)

    def soon(self, action: Callable[[], None]) -> None:
        """Do this in a turn of its own: each `poll` does one."""
        self._soon.append(action)

    def is_ready(self) -> bool:
        """True when `poll` would serve somebody at once. Costs a microsecond."""
        return bool(self._soon or select.select(self._waiting, (), (), 0.0)[0])

    def poll(self, timeout_s: float | None) -> None:
        """Serve what is ready, waiting at most `timeout_s` for it, or a millisecond less; None: until something is."""
        if self._soon:
            self._soon.popleft()()
            timeout_s = 0.0
        wait_s = _LONGEST_WAIT_S if timeout_s is None else min(timeout_s, _LONGEST_WAIT_S)
        epoll_s = 0.0
        if wait_s > 2.0 * _EPOLL_S:  # one system call; who asks again waits for the rest exactly, which takes two
            epoll_s = wait_s - _EPOLL_S
        elif wait_s and not select.select(self._waiting, (), (), wait_s)[0]:
            return
        for fd, events in self._epoll.poll(epoll_s):
            handler = self._handlers.get(fd)
            if handler is not None:  # an earlier handler of this round may have closed it
                handler(events)

    def close(self) -> None:
        """Let go of the descriptor; nothing is watched any more."""
        self._handlers.clear()
        self._soon.clear()
        self._epoll.close()
