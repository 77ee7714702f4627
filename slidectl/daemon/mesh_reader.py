"""Reads mesh files in processes of their own, so that no file can block the world, use its memory or end it.

Each robot's meshes are one job: a fork of the daemon, which already has all that it needs in memory, with limits of
time and memory that the kernel enforces. It writes its results to a pipe. This module knows neither robots nor clients.
"""

from __future__ import annotations

import io
import os
import select
import signal
import struct
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import BinaryIO

from slidectl.confined import Limits, start
from slidectl.description.meshes import BadMesh
from slidectl.errors import Refused
from slidectl.event_loop import READ, EventLoop
from slidectl.physics import hulls
from slidectl.physics.hulls import Hull, MeshSource
from slidectl.simulation.pending import Pending

LIMITS = Limits(cpu_s=30, wall_s=60, new_bytes=2 * 2**30)
"""Of the process that reads all meshes of a robot."""
AT_ONCE = 2
"""The number of processes at once. Further jobs wait."""

_NICER = 10
_PIECE = 1 << 16
_RESULT = struct.Struct("<?II")
"""One result: True for a hull, the length of its name (or of the reason why there is none), the length of its file."""


class MeshReader:
    """Runs jobs in processes, served by `loop`. `unexpected` logs the exception that is being handled."""

    def __init__(self, loop: EventLoop, unexpected: Callable[[str], None]) -> None:
        self._loop = loop
        self._unexpected = unexpected
        self._waiting: deque[_Job] = deque()
        self._running: dict[int, _Job] = {}
        """Running jobs by the descriptor of the pipe."""

    def read(self, sources: Sequence[MeshSource]) -> Pending:
        """Read meshes. Resolved with the hulls (physics.hulls.Hulls). Cancelling it ends the process."""
        job = _Job(sources)
        job.pending.on_cancel = job.end  # this ends the pipe too, after which the process is reaped
        self._waiting.append(job)
        self._begin()
        return job.pending

    def close(self) -> None:
        """End all processes; no request is answered any more."""
        self._waiting.clear()
        for descriptor, job in list(self._running.items()):
            job.end()
            # A process blocked in the kernel (a dead network drive) is not waited for; it ends with the daemon.
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
            self._loop.watch(descriptor, READ, partial(self._receive, descriptor))

    def _receive(self, descriptor: int, _: int) -> None:
        """Read more output of a process, or its end."""
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
        """Reap a process. Returns its wait status. Its memory is freed before its descriptors close: this is fast."""
        job = self._running.pop(descriptor)
        self._loop.forget(descriptor)
        os.close(descriptor)
        with suppress(ChildProcessError):
            return os.waitpid(job.pid, options)[1]
        return 0

    def _prepare(self, job: _Job) -> None:
        """Let MuJoCo prepare one more hull, or finish the job. Each hull is one turn: cycles run in between."""
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
        """Start the process. Returns the descriptor of its output. Raises OSError."""
        # numpy's linear algebra has threads, which are idle
        self.pid, reading = start(partial(_write_results, self.sources), LIMITS)
        os.set_blocking(reading, False)
        return reading

    def end(self) -> None:
        """Kill the process: its results are not needed any more."""
        if self.pid and not self.ended:
            self.ended = True
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def settle(self, status: int) -> None:
        """Parse the output of the process; the mesh at which it ended early gets the reason."""
        said = io.BytesIO(self.said)
        for source in self.sources:
            header = said.read(_RESULT.size)
            is_hull, text_length, file_length = _RESULT.unpack(header) if len(header) == _RESULT.size else (False, 0, 0)
            text, content = str(said.read(text_length), "utf-8", "replace"), said.read(file_length)
            if not text or len(content) < file_length:
                self.results[source] = BadMesh(f"cannot read the mesh: {LIMITS.reason(status)}", source.path)
            elif is_hull:
                self.results[source] = hull = Hull(text, content)
                self.unprepared.extend(hull.parts)
            else:
                self.results[source] = BadMesh(text, source.path)


def _write_results(sources: Sequence[MeshSource], pipe: BinaryIO) -> None:
    """Read the meshes and write the results, in the process."""
    os.nice(_NICER)
    for source in sources:
        result = hulls.read(source)
        text, content = (result.name, result.stl) if isinstance(result, Hull) else (result.reason, b"")
        name = text.encode("utf-8", "replace")
        pipe.write(_RESULT.pack(isinstance(result, Hull), len(name), len(content)) + name + content)
        pipe.flush()
