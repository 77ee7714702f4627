"""The daemon's process: comes up, runs the one loop, and leaves nothing behind.

Heavy imports happen in `serve`, after the lock and the socket are taken: two starts at once are told apart early, and
clients that knock meanwhile wait instead of being turned away.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from slidectl.daemon.lock import holder
from slidectl.daemon.logfile import LogFile
from slidectl.daemon.options import Start, parse
from slidectl.errors import EXIT_DONE, Refused, SlidectlError

if TYPE_CHECKING:
    import socket

    from slidectl.daemon.place import Place

_OOM_SCORE = "300"
_LEAST_DESCRIPTORS = 24
"""File descriptors: those of a daemon with a few clients that reads a robot and starts a compiler."""
_LONGEST_NUMBER = 640
"""Digits of an integer, the least that Python can be told: reading them takes time that grows with their square."""
_PR_SET_PDEATHSIG = 1


class Stopped(BaseException):
    """A signal came before the loop ran."""


class Starter:
    """The process that waits for us, if any. It gets one JSON line: `state` is ready, running or failed."""

    def __init__(self, fd: int | None) -> None:
        self._fd = fd

    def tell(self, state: str, **details: Any) -> None:
        """Tell it once; later calls do nothing."""
        if self._fd is not None:
            with suppress(OSError):
                os.write(self._fd, (json.dumps({"state": state, **details}) + "\n").encode())
                os.close(self._fd)
            self._fd = None


def main(arguments: Sequence[str]) -> int:
    """Run a daemon until it is stopped. Returns the exit code."""
    start = parse(arguments)
    starter = Starter(start.ready_fd)
    try:
        _check_limit()
        _settle_in(start)
        return _run(start, starter)
    except Stopped:
        return EXIT_DONE
    except SlidectlError as error:
        starter.tell("failed", error=str(error), exit_code=error.exit_code)
        print(f"slidectl daemon: {error}", file=sys.stderr, flush=True)
        return error.exit_code


def _check_limit() -> None:
    """Raises Refused: what a daemon opens before it answers does not fit into the limit, and imports would fail."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= limit < _LEAST_DESCRIPTORS:
        raise Refused(
            f"a daemon needs {_LEAST_DESCRIPTORS} open files at least, and the limit is {limit}",
            "raise it: ulimit -n 1024",
        )


def _settle_in(start: Start) -> None:
    """Be nobody's child: private files, no terminal, none of the starter's descriptors or its folder."""
    os.umask(0o077)
    sys.set_int_max_str_digits(_LONGEST_NUMBER)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _early.take)
    if start.parent is not None:
        _end_with(start.parent)
    if start.foreground:
        return
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with suppress(OSError):
        os.setsid()
    os.chdir("/")
    for fd in map(int, os.listdir("/proc/self/fd")):
        if fd > 2 and fd != start.ready_fd:
            with suppress(OSError):
                os.close(fd)
    with suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as score:
        score.write(_OOM_SCORE)  # when memory runs out, the simulation goes rather than the user's session


def _end_with(parent: int) -> None:
    """Have the kernel send us a SIGTERM when our parent ends."""
    import ctypes

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        raise Stopped


class _EarlyStop:
    """Signals before the loop runs. Some are lost in C code that is being imported, so they are remembered too."""

    def __init__(self) -> None:
        self.asked = False
        self._raises = True

    def take(self, *_: object) -> None:
        """The handler. It raises Stopped once, so that nothing keeps the way out from being gone to its end."""
        self.asked = True
        if self._raises:
            self._raises = False
            raise Stopped

    def check(self) -> None:
        """Raise Stopped if a signal has come by now."""
        if self.asked:
            raise Stopped

    @contextmanager
    def held(self) -> Iterator[None]:
        """Inside, signals are only remembered."""
        self._raises = False
        yield
        self._raises = True
        self.check()


_early = _EarlyStop()


def _run(start: Start, starter: Starter) -> int:
    from slidectl.daemon.place import Place

    with ExitStack() as stack:
        place = Place(start.paths)
        stack.callback(place.give_back)
        if not place.take():
            starter.tell("running", pid=holder(start.paths.lock))
            print(f"a daemon runs there already (process {holder(start.paths.lock)})", file=sys.stderr, flush=True)
            return EXIT_DONE
        log = LogFile(start.paths.log, start.foreground)
        with _early.held():
            listener = place.listen()
        _serve(start, place, listener, log, lambda: starter.tell("ready", pid=os.getpid()))
    return EXIT_DONE


def _serve(start: Start, place: Place, listener: socket.socket, log: LogFile, ready: Callable[[], None]) -> None:
    began = time.monotonic()
    gc.disable()  # what is imported stays; looking through it for garbage would only take time
    # MuJoCo's package looks for a way to draw when it is imported. Nothing is drawn here, and the search takes 30 ms.
    os.environ.setdefault("MUJOCO_GL", "disable")
    from slidectl.daemon.daemon import Daemon

    daemon = Daemon(start, place, listener, log, began)
    gc.freeze()
    _early.check()
    ready()
    daemon.run()
