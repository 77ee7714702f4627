"""Reads mesh files in processes of their own, so that no file holds up the world, takes its memory or ends it.

Each robot's meshes are one job: a fork of the daemon, which has all that it needs in memory already, within limits of
time and memory that the kernel keeps. It says what it has read on a pipe. Nothing here knows robots or clients.
"""

from __future__ import annotations

import io
import os
import resource
import select
import signal
import struct
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from slidectl.description.meshes import BadMesh
from slidectl.errors import Refused
from slidectl.event_loop import READ, EventLoop
from slidectl.physics import hulls
from slidectl.physics.hulls import Hull, MeshSource
from slidectl.processes import end_with
from slidectl.simulation.pending import Pending

MOST_CPU_S = 30
"""Of computing, for all meshes of a robot."""
MOST_S = 60
"""Of waiting too: for a file on a network that does not answer."""
MOST_MEMORY = 2 * 2**30
"""Bytes, besides what the daemon has."""
AT_ONCE = 2
"""Processes. Further jobs wait for their turn."""

_NICER = 10
_PIECE = 1 << 16
_LARGEST_DESCRIPTOR = 2**31 - 1
_RESULT = struct.Struct("<?II")
"""One result: whether it is a hull, the length of its name (or of the reason why there is none), that of its file."""
_WHY = {
    signal.SIGXCPU: f"reading it took more than {MOST_CPU_S} s",
    signal.SIGALRM: f"it could not be read within {MOST_S} s",
}


class MeshReader:
    """Jobs in processes, served by `loop`. `unexpected` logs the exception that is being handled."""

    def __init__(self, loop: EventLoop, unexpected: Callable[[str], None]) -> None:
        self._loop = loop
        self._unexpected = unexpected
        self._waiting: deque[_Job] = deque()
        self._running: dict[int, _Job] = {}
        """By the descriptor of the pipe."""

    def read(self, sources: Sequence[MeshSource]) -> Pending:
        """Resolved with the hulls (physics.hulls.Hulls). Who cancels it ends the process."""
        job = _Job(sources)
        job.pending.on_cancel = job.end  # its pipe ends too then, and it is reaped
        self._waiting.append(job)
        self._begin()
        return job.pending

    def close(self) -> None:
        """End all processes; nobody is answered any more."""
        self._waiting.clear()
        for descriptor, job in list(self._running.items()):
            job.end()
            # One that the kernel holds (a dead network drive) is not waited for; it ends with us.
            has_ended = bool(select.select([descriptor], (), (), 1.0)[0])
            self._reap(descriptor, 0 if has_ended else os.WNOHANG)

    def _begin(self) -> None:
        while self._waiting and len(self._running) < AT_ONCE:
            job = self._waiting.popleft()
            if job.pending.done:
                continue
            try:
                descriptor = job.begin()
            except OSError as error:
                job.pending.reject(Refused(f"no process can be started to read meshes: {error.strerror}"))
                continue
            self._running[descriptor] = job
            self._loop.watch(descriptor, READ, partial(self._take, descriptor))

    def _take(self, descriptor: int, _: int) -> None:
        """More of what a process says, or its end."""
        job = self._running[descriptor]
        piece = os.read(descriptor, _PIECE)
        job.said += piece
        if piece:
            return
        status = self._reap(descriptor)
        self._begin()
        if not job.pending.done:
            job.settle(status)
            self._loop.soon(lambda: self._prepare(job))

    def _reap(self, descriptor: int, options: int = 0) -> int:
        """Its wait status. Memory is given back before descriptors are closed, so there is nothing to wait for."""
        job = self._running.pop(descriptor)
        self._loop.forget(descriptor)
        os.close(descriptor)
        with suppress(ChildProcessError):
            return os.waitpid(job.pid, options)[1]
        return 0

    def _prepare(self, job: _Job) -> None:
        """MuJoCo prepares one more hull, or the job is done. Each is a turn of its own: cycles run in between."""
        if job.unprepared and not job.pending.done:
            hulls.prepare(job.unprepared.popleft())
            self._loop.soon(lambda: self._prepare(job))
            return
        try:
            job.pending.resolve(job.results)
        except Exception:
            self._unexpected("the answer of a reader of meshes")


class _Job:
    """The meshes of one robot, and the process that reads them."""

    def __init__(self, sources: Sequence[MeshSource]) -> None:
        self.sources = sources
        self.pending = Pending()
        self.pid = 0
        self.ended = False
        self.said = bytearray()
        self.results: dict[MeshSource, Hull | BadMesh] = {}
        self.unprepared: deque[Hull] = deque()

    def begin(self) -> int:
        """Start the process. Returns where it is heard. Raises OSError."""
        parent = os.getpid()
        reading, writing = os.pipe2(os.O_CLOEXEC)
        try:
            with warnings.catch_warnings():
                # Python warns of threads, which are those of numpy's algebra; they have nothing to do now.
                warnings.simplefilter("ignore", DeprecationWarning)
                self.pid = os.fork()
        except OSError:
            os.close(reading)
            os.close(writing)
            raise
        if self.pid == 0:
            _work(self.sources, writing, parent)
        os.close(writing)
        os.set_blocking(reading, False)
        return reading

    def end(self) -> None:
        """Nobody wants the results any more."""
        if self.pid and not self.ended:
            self.ended = True
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def settle(self, status: int) -> None:
        """Understand what the process has said; of the mesh in the middle of which it ended, why."""
        said = io.BytesIO(self.said)
        for source in self.sources:
            header = said.read(_RESULT.size)
            is_hull, text_length, file_length = _RESULT.unpack(header) if len(header) == _RESULT.size else (False, 0, 0)
            text, content = str(said.read(text_length), "utf-8", "replace"), said.read(file_length)
            if not text or len(content) < file_length:
                self.results[source] = BadMesh(_why(status), source.path)
            elif is_hull:
                self.results[source] = hull = Hull(text, content)
                self.unprepared.append(hull)
            else:
                self.results[source] = BadMesh(text, source.path)


def _why(status: int) -> str:
    """Why a process ended before it was done."""
    if os.WIFSIGNALED(status):
        number = signal.Signals(os.WTERMSIG(status))
        return f"cannot read the mesh: {_WHY.get(number, f'the process that read it was ended by {number.name}')}"
    return "cannot read the mesh: the process that read it failed"


def _work(sources: Sequence[MeshSource], writing: int, parent: int) -> None:
    """The process: reads, says what it has read, and is gone. It never returns into the daemon's code."""
    code = 1
    try:
        _confine(writing, parent)
        with os.fdopen(writing, "wb") as pipe:
            for source in sources:
                result = hulls.read(source)
                text, content = (result.name, result.stl) if isinstance(result, Hull) else (result.reason, b"")
                name = text.encode("utf-8", "replace")
                pipe.write(_RESULT.pack(isinstance(result, Hull), len(name), len(content)) + name + content)
                pipe.flush()
        code = 0
    finally:
        os._exit(code)


def _confine(writing: int, parent: int) -> None:
    """Be a process that can do nothing but read, for so long and with so much memory, and that ends with the daemon."""
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGXCPU, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    if not end_with(parent, signal.SIGKILL):
        os._exit(1)
    # Neither the clients' sockets nor the lock may outlive the daemon in here.
    os.closerange(3, writing)
    os.closerange(writing + 1, _LARGEST_DESCRIPTOR)
    os.nice(_NICER)
    with open("/proc/self/statm", encoding="ascii") as statm:
        mapped = int(statm.read().split()[0]) * resource.getpagesize()
    _limit(resource.RLIMIT_AS, mapped + MOST_MEMORY)
    _limit(resource.RLIMIT_CPU, MOST_CPU_S)
    _limit(resource.RLIMIT_CORE, 0)
    signal.alarm(MOST_S)


def _limit(what: int, most: int) -> None:
    """Never more than is allowed already."""
    _, hard = resource.getrlimit(what)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(what, (most, hard))
