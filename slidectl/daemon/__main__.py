"""`python -m slidectl.daemon START`: the process that `daemon start` starts and `daemon run` becomes.

START is options.Start as JSON. Heavy imports come after the lock and the socket are taken: of two starts at once, one
fails early, and clients that connect meanwhile wait instead of being refused.
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

from slidectl.daemon.instance_files import InstanceFiles
from slidectl.daemon.options import Start
from slidectl.errors import EXIT_DONE, Refused, SlidectlError
from slidectl.logfile import LogFile
from slidectl.operating_system import end_with
from slidectl.processes import holder

if TYPE_CHECKING:
    from slidectl.daemon.main_loop import Daemon

_LEAST_DESCRIPTORS = 24
"""File descriptors that a daemon needs for a few clients, to read a robot and to start a compiler."""
_LONGEST_NUMBER = 640
"""The most digits of an integer, the lowest limit that Python accepts: parsing takes time quadratic in their number."""


def main(text: str) -> int:
    """Run a daemon until it is stopped. Returns the exit code."""
    # Block signals until the loop handles them: during imports of C code some would be lost.
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTERM, signal.SIGINT))
    start = Start.read(text)
    with ExitStack() as stack:
        try:
            daemon = _begin(start, stack)
        except SlidectlError as error:
            _report(start, "failed", error=str(error), exit_code=error.exit_code)
            print(f"slidectl daemon: {error}", file=sys.stderr, flush=True)
            return error.exit_code
        if daemon is not None:
            _report(start, "ready", pid=os.getpid())
            daemon.run()
    return EXIT_DONE


def _report(start: Start, state: str, **details: Any) -> None:
    """Write one line, only once, to the process that waits for our start, if any."""
    if start.ready_fd is not None:
        with suppress(OSError):
            os.write(start.ready_fd, (json.dumps({"state": state, **details}) + "\n").encode())
            os.close(start.ready_fd)


def _begin(start: Start, stack: ExitStack) -> Daemon | None:
    """The daemon, ready to run; None when there is nothing to run. `stack` releases its resources."""
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
    place = InstanceFiles(start.paths)
    if not start.foreground:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        os.chdir("/")
    stack.callback(place.release)
    if not place.acquire():
        pid = holder(start.paths.lock)
        _report(start, "running", pid=pid)
        print(f"a daemon already runs there (process {pid})", file=sys.stderr, flush=True)
        return None
    log = LogFile(start.paths.log, start.foreground)
    listener = place.listen()
    gc.disable()  # imported objects stay; scanning them for garbage only takes time
    # MuJoCo's package searches for an OpenGL backend on import. This process renders nothing; the search takes 30 ms.
    os.environ["MUJOCO_GL"] = "disable"
    from slidectl.daemon.main_loop import Daemon

    daemon = Daemon(start, place, listener, log, began_s)
    gc.freeze()
    return daemon


if __name__ == "__main__":
    code = main(sys.argv[1])
    # All is flushed and released; finalizing the interpreter and its libraries would only cost time.
    sys.stderr.flush()
    os._exit(code)
