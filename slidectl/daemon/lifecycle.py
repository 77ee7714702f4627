"""Start, find, list and stop daemons' processes, for the command line; standard library only.

The lock tells whether a daemon runs, its socket whether it answers; nothing else is used.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import stat
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import IO, TYPE_CHECKING, NoReturn

from slidectl import processes
from slidectl.client import Client
from slidectl.daemon.options import DaemonOptions, Start
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.operating_system import ProcessEnd, command_line
from slidectl.paths import InstancePaths, command, instances, is_ours, make_private, with_package

if TYPE_CHECKING:
    from slidectl.msgs.typed import StatusResponseMsg

_MODULE = "slidectl.daemon"
_PAUSE_S = 0.01
_END_TIMEOUT_S = 5.0
_AT_A_TIME = 32
"""Daemons that are asked at the same time: one that does not answer takes the whole wait of its thread."""


def running(paths: InstancePaths) -> int | None:
    """The process id of the daemon that runs at `paths`, or None. It may still be starting."""
    return processes.holder(paths.lock)


def start(paths: InstancePaths, options: DaemonOptions | None = None, timeout: float = 30.0) -> tuple[int, bool]:
    """Start a daemon and wait until it answers.

    Returns:
        Its process id, and whether it was already running (then the options had no effect).

    Raises:
        Refused: it ended, with the reason or the last lines of its log; or the folder is not private. TimedOut.
        KeyboardInterrupt: a process that was started here has been ended again.
    """
    beginning = DaemonStart(paths, options)
    try:
        return beginning.wait(timeout)
    except KeyboardInterrupt:
        beginning.abandon()
        raise


def options_of(pid: int) -> DaemonOptions | None:
    """The start options of a daemon's process, from its command line; None when that cannot be read."""
    try:
        return Start.read(command_line(pid).partition(f" {_MODULE} ")[2]).options
    except (LookupError, ValueError, TypeError):
        return None


class DaemonStart:
    """The start of a daemon: its process is started at once, so that the caller can do other things before `wait`.

    Raises:
        Refused: the folder is not private.
    """

    def __init__(self, paths: InstancePaths, options: DaemonOptions | None = None) -> None:
        make_private(paths.folder)
        self._paths = paths
        self._options = options or DaemonOptions()
        self._process: subprocess.Popen[bytes] | None = None
        self._ready: IO[bytes] | None = None
        """The pipe on which the process reports the result of its start."""
        self._log_before = 0
        if running(paths) is None:
            self._spawn()

    def _spawn(self) -> None:
        read_end, write_end = os.pipe()
        parent = os.getpid() if self._options.child else None
        begun = Start.at(self._paths, replace(self._options, child=False), parent=parent, ready_fd=write_end)
        with os.fdopen(write_end, "wb"), processes.opened_log(self._paths.log) as log:
            self._ready = os.fdopen(read_end, "rb")
            self._log_before = os.fstat(log.fileno()).st_size
            words = processes.command_of(_MODULE, begun.text())
            self._process = processes.start(words, log, stdin=subprocess.DEVNULL, pass_fds=[write_end])

    def wait(self, timeout: float = 30.0) -> tuple[int, bool]:
        """Wait until the daemon answers. Returns and raises as `start` does."""
        deadline = time.monotonic() + timeout
        while True:
            if self._process is None:
                pid = _wait_for_the_other(self._paths, deadline)
                if pid is not None:
                    return pid, True
                self._spawn()  # none runs, or it ended during its start
            process, ready = self._process, self._ready
            assert process is not None
            assert ready is not None
            if not select.select([ready], [], [], max(0.0, deadline - time.monotonic()))[0]:
                # The process keeps starting.
                hint = command(self._paths, "daemon logs")
                raise TimedOut(f"the daemon (process {process.pid}) is not ready in time", hint)
            with ready:
                line = ready.readline()
            self._process = None
            if not line:
                why = processes.last_lines(self._paths.log, self._log_before)
                raise Refused(f"the daemon did not start ({_end(process.wait())})", why)
            answer = json.loads(line)
            if answer["state"] == "ready":
                return process.pid, False
            process.wait()
            if answer["state"] == "failed":
                error = Refused(str(answer["error"]))
                error.exit_code = int(answer["exit_code"])
                raise error

    def abandon(self) -> None:
        """End the process, if one was started here that has not reported yet."""
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(_END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None


def stop(paths: InstancePaths, timeout: float = 10.0) -> int | None:
    """Stop the daemon and wait until its process has ended: by its service, then with SIGTERM.

    Returns:
        Its process id, or None when none ran.

    Raises:
        TimedOut: it is still running.
    """
    pid = running(paths)
    if pid is None:
        return None
    deadline = time.monotonic() + timeout
    process: ProcessEnd | None = None
    with suppress(OSError):  # in another pid namespace, or just ended: only the lock can be checked then
        process = ProcessEnd(pid)
    try:
        if not _ask_to_stop(paths, min(2.0, timeout / 2)) and process is not None and running(paths) == pid:
            with suppress(ProcessLookupError):
                process.send_signal(signal.SIGTERM)
        while not _has_ended(process, pid, paths):
            if time.monotonic() > deadline:
                raise TimedOut(f"the daemon (process {pid}) is still running after {timeout:g} s", f"kill -KILL {pid}")
    finally:
        if process is not None:
            process.close()
    with suppress(ChildProcessError):  # the caller may be its parent
        os.waitpid(pid, os.WNOHANG)
    return pid


def fork(source: Client, name: str, paths: InstancePaths, timeout: float) -> tuple[int, float]:
    """Start a daemon from a snapshot of the one of `source`, with its options and speed, and paused if that is.

    Returns:
        Its process id, and its simulated time in s.

    Raises:
        Refused: there is no such snapshot, or a daemon runs there. Also raises as `start`.
    """
    from tempfile import TemporaryDirectory

    status = source.call("/slidectl/status")
    options = options_of(source.daemon_pid) or DaemonOptions()
    options = options.of_another(rtf=status["speed"] or math.inf, paused=True, child=False)
    with TemporaryDirectory() as folder:
        file = os.path.join(folder, "snapshot")
        source.call("/slidectl/export_snapshot", {"name": name, "file": file})
        pid, already = start(paths, options, timeout)
        if already:
            load = command(paths, "sim load --from FILE")
            hint = f"load it there: {command(source.paths, f'sim save {name} --to FILE')}; {load}"
            raise Refused(f"a daemon {paths.name} runs already, as process {pid}", hint)
        try:
            with Client(socket=paths.socket_text, timeout=timeout) as client:
                time_s = client.load(file=file)
                if not status["paused"]:
                    client.call("/gazebo/unpause_physics")
        except BaseException:
            stop(paths)
            raise
    return pid, time_s


def _has_ended(process: ProcessEnd | None, pid: int, paths: InstancePaths) -> bool:
    """Wait briefly. Returns True when the process has ended."""
    if process is not None:
        return bool(select.select([process], [], [], 0.1)[0])
    time.sleep(_PAUSE_S)
    return running(paths) != pid


def run(paths: InstancePaths, options: DaemonOptions | None = None) -> NoReturn:
    """Become the daemon, in the foreground: the calling process is replaced, so signals reach it directly."""
    begun = Start.at(paths, options or DaemonOptions(), foreground=True)
    sys.stdout.flush()
    os.execve(sys.executable, processes.command_of(_MODULE, begun.text()), with_package(os.environ))


def _ask_to_stop(paths: InstancePaths, timeout: float) -> bool:
    try:
        with Client(socket=paths.socket_text, timeout=timeout) as client:
            client.call("/slidectl/shutdown")
    except NoDaemon as error:
        return "went away" in error.message
    except SlidectlError:
        return False
    return True


def _wait_for_the_other(paths: InstancePaths, deadline: float) -> int | None:
    """The id of the process that holds the lock, when it answers; None when there is none, or it has ended."""
    while (pid := running(paths)) is not None:
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimedOut(f"process {pid} holds {paths.lock} but does not answer", command(paths, "daemon logs"))
        try:
            with Client(socket=paths.socket_text, timeout=left) as client:
                client.call("/slidectl/status")
                return client.daemon_pid or pid
        except NoDaemon:
            time.sleep(_PAUSE_S)
    return None


def _end(code: int) -> str:
    return f"ended by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


# --- all daemons of this user -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ListedDaemon:
    """A daemon's process that runs, and its answer."""

    paths: InstancePaths
    pid: int | None
    """None when the process is in another pid namespace."""
    since: float | None
    """When it started, in s of the wall clock since 1970."""
    status: StatusResponseMsg | None = None
    """None when it did not answer."""
    trouble: str = ""
    """Why it did not answer."""


def running_daemons(chosen: InstancePaths, timeout_s: float) -> list[ListedDaemon]:
    """All daemons of this user, by instance, and that of `chosen` if it has a named socket.

    A daemon runs when its lock is held: files of one that was killed are none. All are asked at the same time; one
    that has not answered after `timeout_s` of wall time is listed with the reason.
    """
    from concurrent.futures import ThreadPoolExecutor

    places = [*instances(), *([chosen] if chosen.prefix else [])]
    running = [(place, pid) for place in places if (pid := _holder(place)) is not None]
    with ThreadPoolExecutor(_AT_A_TIME) as threads:
        return list(threads.map(lambda one: _answer_of(one[0], one[1], timeout_s), running))


def _holder(place: InstancePaths) -> int | None:
    """The process that holds the lock; None when nobody does, or the lock is not a file of this user."""
    return running(place) if is_ours(place.lock, stat.S_IFREG) else None


def _answer_of(place: InstancePaths, pid: int, timeout_s: float) -> ListedDaemon:
    try:
        # The daemon writes the lock once, when it starts.
        since = os.lstat(place.lock).st_mtime
    except OSError:  # it ends right now
        since = None
    status: StatusResponseMsg | None = None
    trouble = ""
    try:
        with Client(socket=place.socket_text, timeout=timeout_s) as client:
            status = client.call("/slidectl/status")
    except SlidectlError as error:
        trouble = error.message
    return ListedDaemon(place, pid or None, since, status, trouble)
