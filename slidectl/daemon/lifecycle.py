"""Start, find and stop the daemon's process. What the command line uses; standard library only.

The lock says whether a daemon lives, its socket whether it answers; nothing else is believed.
"""

from __future__ import annotations

import errno
import json
import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from slidectl.client import Client
from slidectl.client.link import command
from slidectl.daemon.lock import holder
from slidectl.daemon.options import DaemonOptions, parse
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.paths import InstancePaths, make_private, with_package

_LAST_LINES = 8
_PAUSE_S = 0.01
_GRACE_S = 2.0


class StartFailed(Refused):
    """The daemon's process ended, or said why it cannot run."""


def running(paths: InstancePaths) -> int | None:
    """Process id of the daemon that lives at `paths`, or None. It may still be starting."""
    return holder(paths.lock)


def start(paths: InstancePaths, options: DaemonOptions | None = None, timeout: float = 30.0) -> tuple[int, bool]:
    """Start a daemon and wait until it answers.

    Returns:
        Its process id, and whether it ran already (then the options had no effect).

    Raises:
        StartFailed: with the reason, or the last lines of the log. TimedOut. Refused: the folder is not private.
        KeyboardInterrupt: and then a process that was started here has been ended again.
    """
    beginning = Beginning(paths, options)
    try:
        return beginning.wait(timeout)
    except KeyboardInterrupt:
        beginning.abandon()
        raise


def options_of(pid: int) -> DaemonOptions | None:
    """What the daemon of this process was started with, by its command line; None where that cannot be read."""
    try:
        words = os.fsdecode(Path(f"/proc/{pid}/cmdline").read_bytes()).split("\0")[:-1]
        return parse(words[words.index("slidectl.daemon") + 1 :]).options
    except (OSError, ValueError):
        return None


class Beginning:
    """A daemon on its way: its process is started at once, so that the starter can do other things until `wait`.

    Raises:
        Refused: the folder is not private.
    """

    def __init__(self, paths: InstancePaths, options: DaemonOptions | None = None) -> None:
        make_private(paths.folder)
        self.paths = paths
        self.options = options or DaemonOptions()
        self._process = None if running(paths) is not None else _Process(paths, self.options)

    def wait(self, timeout: float = 30.0) -> tuple[int, bool]:
        """Wait until it answers. Returns and raises as `start` does."""
        deadline = time.monotonic() + timeout
        while True:
            if self._process is None and running(self.paths) is not None:
                pid = _wait_for_the_other(self.paths, deadline)
                if pid is not None:
                    return pid, True
                continue  # it died while starting; now it is our turn
            self._process = self._process or _Process(self.paths, self.options)
            line = self._process.line(deadline)
            process, self._process = self._process, None
            answer = process.answer(line)
            if answer["state"] == "ready":
                return int(answer["pid"]), False
            if answer["state"] == "failed":
                error = StartFailed(str(answer["error"]))
                error.exit_code = int(answer["exit_code"])
                raise error

    def abandon(self) -> None:
        """End the process, if one was started whose answer has not come yet."""
        if self._process is not None:
            self._process.end()
            self._process = None


def stop(paths: InstancePaths, timeout: float = 10.0) -> int | None:
    """Stop the daemon and wait until its process has ended: politely, then with SIGTERM.

    Returns:
        The process id that it had, or None when none ran.

    Raises:
        TimedOut: it is still there.
    """
    pid = running(paths)
    if pid is None:
        return None
    deadline = time.monotonic() + timeout
    with _End(pid, paths) as end:
        if not _ask_to_stop(paths, min(2.0, timeout / 2)):
            end.hasten()
        while not end.has_come():
            if time.monotonic() > deadline:
                raise TimedOut(f"the daemon (process {pid}) is still there after {timeout:g} s", f"kill -KILL {pid}")
    with suppress(ChildProcessError):  # a long-lived starter is its parent still
        os.waitpid(pid, os.WNOHANG)
    return pid


def run(paths: InstancePaths, options: DaemonOptions | None = None) -> NoReturn:
    """Become the daemon, in the foreground: the calling process is replaced, so signals reach it directly."""
    arguments = [*_interpreter(), *_arguments(paths, options or DaemonOptions()), "--foreground"]
    sys.stdout.flush()
    os.execve(arguments[0], arguments, with_package(os.environ))


def _ask_to_stop(paths: InstancePaths, timeout: float) -> bool:
    try:
        with Client(socket=paths.socket_text, timeout=timeout) as client:
            client.call("/slidectl/shutdown")
    except NoDaemon as error:
        return "went away" in error.message
    except SlidectlError:
        return False
    return True


class _End:
    """The end of a daemon's process. It is held by a descriptor, since its id may be another's once it has ended."""

    def __init__(self, pid: int, paths: InstancePaths) -> None:
        self._pid = pid
        self._paths = paths
        self._process: int | None = None
        with suppress(OSError):  # another pid namespace, or it has just ended: the lock must do
            self._process = os.pidfd_open(pid)

    def __enter__(self) -> _End:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            os.close(self._process)

    def hasten(self) -> None:
        """Send SIGTERM to the process, if it is one that can be reached and still the daemon."""
        if self._process is not None and running(self._paths) == self._pid:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._process, signal.SIGTERM)

    def has_come(self) -> bool:
        """Wait a little, and say whether it has ended."""
        if self._process is not None:
            return bool(select.select([self._process], [], [], 0.1)[0])
        select.select([], [], [], _PAUSE_S)
        return running(self._paths) != self._pid


def _wait_for_the_other(paths: InstancePaths, deadline: float) -> int | None:
    """Another process holds the lock: its id when it answers, None when it has gone."""
    while (pid := running(paths)) is not None:
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimedOut(f"process {pid} holds {paths.lock} but does not answer", command(paths, "daemon logs"))
        try:
            with Client(socket=paths.socket_text, timeout=left) as client:
                client.call("/slidectl/status")
                return client.daemon_pid
        except NoDaemon:
            select.select([], [], [], _PAUSE_S)
    return None


class _Process:
    """A daemon's process, from its start to the line in which it tells how that went."""

    def __init__(self, paths: InstancePaths, options: DaemonOptions) -> None:
        self._paths = paths
        self._read_end, write_end = os.pipe()
        log = _open_log(paths.log)
        self._log_before = os.fstat(log).st_size
        os.set_inheritable(write_end, True)
        arguments = [*_interpreter(), *_arguments(paths, options), f"--ready-fd={write_end}"]
        redirect = [(os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)]
        redirect += [(os.POSIX_SPAWN_DUP2, log, 1), (os.POSIX_SPAWN_DUP2, log, 2)]  # type: ignore[list-item]
        try:
            environment = with_package(os.environ)
            self._pid = os.posix_spawn(arguments[0], arguments, environment, file_actions=redirect, setsid=True)
        finally:
            os.close(write_end)
            os.close(log)

    def line(self, deadline: float) -> bytes:
        """Wait for its line; empty when it ended without one. Raises TimedOut, and then it goes on starting."""
        return _first_line(self._read_end, deadline, self._pid, self._paths)

    def answer(self, line: bytes) -> dict[str, Any]:
        """What the line says. Raises StartFailed when there is none."""
        os.close(self._read_end)
        if line:
            answer: dict[str, Any] = json.loads(line)
            if answer["state"] != "ready":
                _reap(self._pid)
            return answer
        why = _last_lines(self._paths.log, self._log_before)
        raise StartFailed(f"the daemon did not start ({_reap(self._pid)})", why)

    def end(self) -> None:
        """Politely, then by force."""
        os.close(self._read_end)
        process = os.pidfd_open(self._pid)  # our child, which nobody has reaped
        for number in (signal.SIGTERM, signal.SIGKILL):
            signal.pidfd_send_signal(process, number)
            if select.select([process], [], [], _GRACE_S)[0]:
                break
        os.close(process)
        _reap(self._pid)


def _first_line(fd: int, deadline: float, pid: int, paths: InstancePaths) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([fd], [], [], left)[0]:
            raise TimedOut(f"the daemon (process {pid}) does not get ready", command(paths, "daemon logs"))
        piece = os.read(fd, 65536)
        if not piece:
            return b""
        line += piece
    return line


def _reap(pid: int) -> str:
    """How the child ended, in words."""
    try:
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    except ChildProcessError:
        return "it ended"
    return f"ended by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _open_log(path: Path) -> int:
    try:
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    except OSError:
        return os.open(os.devnull, os.O_WRONLY)


def _last_lines(path: Path, after: int) -> str:
    try:
        with path.open("rb") as file:
            file.seek(after)
            text = file.read().decode("utf-8", "replace")
    except OSError as error:
        if error.errno != errno.ENOENT:
            return f"{path}: {error.strerror}"
        text = ""
    return "\n".join(text.splitlines()[-_LAST_LINES:]) or f"its log {path} says nothing"


def _interpreter() -> list[str]:
    # -P: a file of the user's that is called like a library must not be taken for it.
    return [sys.executable, "-P", "-m", "slidectl.daemon"]


def _arguments(paths: InstancePaths, options: DaemonOptions) -> list[str]:
    where = f"--socket={paths.socket_text}" if paths.prefix else f"--instance={paths.name}"
    return [where, *options.arguments()]
