"""`python -m slidectl.daemon START`: the process that `daemon start` starts and `daemon run` becomes.

START is options.Start as JSON. Heavy imports happen after the lock and the socket are taken: two starts at once are
told apart early, and clients that connect meanwhile wait instead of being refused.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import sys
import time
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

from slidectl.daemon.options import Start
from slidectl.daemon.place import Place
from slidectl.errors import EXIT_DONE, Refused, SlidectlError
from slidectl.logfile import LogFile
from slidectl.processes import end_with, holder

if TYPE_CHECKING:
    from slidectl.daemon.main_loop import Daemon

_LEAST_DESCRIPTORS = 24
"""File descriptors: those of a daemon with a few clients that reads a robot and starts a compiler."""
_LONGEST_NUMBER = 640
"""Digits of an integer, the least that Python can be told: reading them takes time that grows with their square."""


def main(text: str) -> int:
    """Run a daemon until it is stopped. Returns the exit code."""
    # A signal waits until the loop takes it: in C code that is being imported some would be lost.
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTERM, signal.SIGINT))
    start = Start.read(text)
    with ExitStack() as stack:
        try:
            daemon = _begin(start, stack)
        except SlidectlError as error:
            _tell(start, "failed", error=str(error), exit_code=error.exit_code)
            print(f"slidectl daemon: {error}", file=sys.stderr, flush=True)
            return error.exit_code
        if daemon is not None:
            _tell(start, "ready", pid=os.getpid())
            daemon.run()
    return EXIT_DONE


def _tell(start: Start, state: str, **details: Any) -> None:
    """Tell the process that waits for us, if any. Only once."""
    if start.ready_fd is not None:
        with suppress(OSError):
            os.write(start.ready_fd, (json.dumps({"state": state, **details}) + "\n").encode())
            os.close(start.ready_fd)


def _begin(start: Start, stack: ExitStack) -> Daemon | None:
    """The daemon, ready to run; None when there is nothing to run. What it takes is given back by `stack`."""
    began_s = time.monotonic()
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= limit < _LEAST_DESCRIPTORS:  # imports would fail
        raise Refused(
            f"a daemon needs {_LEAST_DESCRIPTORS} open files at least, and the limit is {limit}",
            "raise it: ulimit -n 1024",
        )
    os.umask(0o077)
    sys.set_int_max_str_digits(_LONGEST_NUMBER)
    if start.parent is not None and not end_with(start.parent, signal.SIGTERM):
        return None
    place = Place(start.paths)
    if not start.foreground:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        os.chdir("/")
    stack.callback(place.give_back)
    if not place.take():
        pid = holder(start.paths.lock)
        _tell(start, "running", pid=pid)
        print(f"a daemon runs there already (process {pid})", file=sys.stderr, flush=True)
        return None
    log = LogFile(start.paths.log, start.foreground)
    listener = place.listen()
    gc.disable()  # what is imported stays; looking through it for garbage would only take time
    # MuJoCo's package looks for a way to draw when it is imported. Nothing is drawn here, and the search takes 30 ms.
    os.environ["MUJOCO_GL"] = "disable"
    from slidectl.daemon.main_loop import Daemon

    daemon = Daemon(start, place, listener, log, began_s)
    gc.freeze()
    return daemon


if __name__ == "__main__":
    code = main(sys.argv[1])
    # All is flushed and released; taking the interpreter and its libraries apart would only cost time.
    sys.stderr.flush()
    os._exit(code)
