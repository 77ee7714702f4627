"""A gateway's process: start it in the background, find it, stop it, run it. A daemon has at most one of each kind.

A held lock means that it runs. The lock file holds the process id and the address, one per line.
"""

from __future__ import annotations

import json
import logging
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl import processes
from slidectl.errors import EXIT_DONE, Refused, SlidectlError, TimedOut
from slidectl.extensions.gateways import gateway_kinds
from slidectl.logfile import LogFile
from slidectl.operating_system import return_large_blocks
from slidectl.paths import InstancePaths, command, instance, make_private

if TYPE_CHECKING:
    from collections.abc import Iterator

START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0
_POLL_EVERY_S = 0.02


class RunningGateway(NamedTuple):
    """A gateway's process and the address where it listens."""

    kind: str
    pid: int
    address: str


def find(paths: InstancePaths, kind: str) -> RunningGateway | None:
    """The running gateway of that kind for the daemon of `paths`, or None. While it starts, its address is empty."""
    found = processes.listening(_lock_file(paths, kind))
    return None if found is None else RunningGateway(kind, *found)


def find_all(paths: InstancePaths) -> list[RunningGateway]:
    """All running gateways, those of slidectl first. Their lock files name them: the packages need not be read."""
    begin, end = _lock_file(paths, "\0").name.split("\0")
    try:
        names = [name for name in os.listdir(paths.folder) if name.startswith(begin) and name.endswith(end)]
    except OSError:  # there is no folder: no daemon has ever run
        return []
    others = sorted(name.removeprefix(begin).removesuffix(end) for name in names)
    return [found for kind in dict.fromkeys([*gateway_kinds.OURS, *others]) if (found := find(paths, kind)) is not None]


def log_file(paths: InstancePaths, kind: str) -> Path:
    """The log file of a background gateway."""
    return paths.folder / f"{paths.prefix}gateway-{kind}.log"


def _lock_file(paths: InstancePaths, kind: str) -> Path:
    return paths.folder / f"{paths.prefix}gateway-{kind}.lock"


def start(
    paths: InstancePaths, kind: str, options: dict[str, Any], timeout_s: float = START_LIMIT_S
) -> tuple[RunningGateway, bool]:
    """Start a gateway in the background and wait until it listens. Returns also whether it ran already.

    Raises:
        Refused: the process ended, with the reason. TimedOut.
    """
    make_private(paths.folder)
    if (found := find(paths, kind)) is not None:
        return found, True
    read_end, write_end = os.pipe()
    text = json.dumps({"kind": kind, "options": options, "ready_fd": write_end, "socket": paths.socket_text})
    log_file(paths, kind).unlink(missing_ok=True)
    with os.fdopen(read_end, "rb") as ready, processes.opened_log(log_file(paths, kind)) as log:
        words = processes.command_of("slidectl.extensions.gateways")
        process = processes.start(words, log, stdin=subprocess.PIPE, pass_fds=[write_end])
        os.close(write_end)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin:  # not as arguments: a token would be visible in the process list
            process.stdin.write(text.encode())
        try:
            if not select.select([ready], [], [], timeout_s)[0]:
                raise TimedOut(f"the {kind} gateway (process {process.pid}) is not ready within {timeout_s:g} s")
            answer = json.loads(ready.readline() or "{}")
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if "address" in answer:
        return RunningGateway(kind, process.pid, answer["address"]), False
    process.wait()
    if "error" in answer:
        error = Refused(answer["error"], answer["hint"])
        error.exit_code = answer["exit_code"]
        raise error
    raise Refused(f"the {kind} gateway did not start", processes.last_lines(log_file(paths, kind), 0))


def stop(paths: InstancePaths, kind: str, timeout_s: float = STOP_LIMIT_S) -> RunningGateway | None:
    """Stop a gateway and wait until its process has ended. Returns it, or None if none ran. Raises TimedOut."""
    found = find(paths, kind)
    if found is None:
        return None
    with suppress(ProcessLookupError):
        if found.pid:
            os.kill(found.pid, signal.SIGTERM)
    deadline = time.monotonic() + timeout_s
    while find(paths, kind) is not None:
        if time.monotonic() > deadline:
            raise TimedOut(f"the {kind} gateway still runs after {timeout_s:g} s", f"kill -KILL {found.pid}")
        time.sleep(_POLL_EVERY_S)
    with suppress(ChildProcessError):  # a long-lived process that started it is still its parent
        os.waitpid(found.pid, os.WNOHANG)
    return found


def run(paths: InstancePaths, kind: str, options: dict[str, Any], opened: Callable[[str], None]) -> None:
    """Run a gateway in this process until SIGTERM or Ctrl-C; `opened` is called with the address when it listens.

    Raises:
        Refused: a gateway of that kind runs already, a port is taken, or a library is missing. NoDaemon, UnknownName.
        PartError: an installed package that adds it is broken.
    """
    gateway_class = gateway_kinds.load(kind)
    import asyncio

    from slidectl.extensions.gateways.gateway import serve

    def listens(address: str) -> None:
        tell(address)
        opened(address)

    return_large_blocks()
    part = gateway_kinds.find(kind)
    with nullcontext() if part is None else gateway_kinds.GATEWAYS.running(part), _locked(paths, kind) as tell:
        asyncio.run(serve(gateway_class(gateway_class.Options(**options)), paths, listens))


@contextmanager
def _locked(paths: InstancePaths, kind: str) -> Iterator[Callable[[str], object]]:
    """Hold the lock; the context gives a function that writes the address there. Raises Refused: the lock is taken."""
    make_private(paths.folder)
    path = _lock_file(paths, kind)
    fd = processes.lock(path)
    if fd is None:
        found = find(paths, kind)
        where = f": process {found.pid}, {found.address}" if found is not None else ""
        hint = "stop it with: " + command(paths, f"gateway {kind} stop")
        raise Refused(f"a {kind} gateway of this daemon runs already{where}", hint)
    try:
        yield lambda address: os.write(fd, address.encode())
    finally:
        path.unlink(missing_ok=True)
        os.close(fd)


def main(text: str) -> int:
    """Run the process that `start` starts. Returns its exit code."""
    begun = json.loads(text)
    ready_fd = begun["ready_fd"]

    def say(**answer: Any) -> None:
        with suppress(OSError):
            os.write(ready_fd, (json.dumps(answer) + "\n").encode())
            os.close(ready_fd)

    os.umask(0o077)
    try:
        paths = instance(socket=begun["socket"])
        logging.basicConfig(handlers=[LogFile(log_file(paths, begun["kind"]))])
        run(paths, begun["kind"], begun["options"], lambda address: say(address=address))
    except SlidectlError as error:
        print(f"slidectl gateway: {error}", file=sys.stderr, flush=True)
        say(error=error.message, hint=error.hint, exit_code=error.exit_code)
        return error.exit_code
    return EXIT_DONE
