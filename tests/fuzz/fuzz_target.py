"""The daemon under attack, and what must hold after every attack: it lives, it answers, and nobody saw a traceback."""

from __future__ import annotations

import json
import os
import select
import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from random import Random
from typing import Any

from daemon_fixture import Runtime

MARKS = ("Traceback (most recent call last)", "a bug in slidectl")
ANSWER_LIMIT_S = 20.0
"""How long an answer may take on a busy machine. The world is paused: no answer may need a cycle."""
MEMORY_BOUND = 200 * 2**20
"""How much the daemon may grow in an attack, bytes: caches fill, and allocators keep what they had."""


class Fault(AssertionError):
    """Something that may not happen, whatever the input."""


class Tally:
    """What was tried, by kind and outcome, and the faults that were found."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[str, str]] = Counter()
        self.slowest: dict[str, tuple[float, int]] = {}
        """By kind: wall seconds, and the number of the case."""
        self.faults: list[str] = []

    def count(self, kind: str, outcome: str, case: int, seconds: float) -> None:
        self.counts[kind, outcome] += 1
        self.slowest[kind] = max(self.slowest.get(kind, (0.0, case)), (seconds, case))

    def text(self) -> str:
        """A line for each kind."""
        kinds = dict.fromkeys(kind for kind, _ in self.counts)
        rows = []
        for kind in kinds:
            outcomes = {outcome: number for (one, outcome), number in sorted(self.counts.items()) if one == kind}
            listed = ", ".join(f"{number} {outcome}" for outcome, number in outcomes.items())
            seconds, case = self.slowest[kind]
            rows.append(
                f"{kind:<9} {sum(outcomes.values()):>6} tried: {listed}; the slowest took {seconds:.2f} s (case {case})"
            )
        return "\n".join([*rows, *(f"FAULT {fault}" for fault in self.faults)])


def case_random(seed: int, kind: str, case: int) -> Random:
    """The random numbers of one case: the same for a seed whatever else is tried."""
    return Random(f"{seed}/{kind}/{case}")


def check_text(text: str, where: str) -> None:
    """Raises Fault when people would see a traceback."""
    for mark in MARKS:
        if mark in text:
            raise Fault(f"{where}: {text[max(0, text.index(mark) - 300) :][:1500]}")


class Target:
    """A daemon with a paused world, and a client beside whoever attacks it."""

    def __init__(self, runtime: Runtime) -> None:
        self.runtime = runtime
        self.client = runtime.client(ANSWER_LIMIT_S)
        self.pid = runtime.pid
        self.closing = ExitStack()
        """Ends what an attack has started."""
        self._log_read = 0
        self._memory = 0

    def call(self, service: str, **request: Any) -> dict[str, Any]:
        return self.client.call(service, request)

    def check(self) -> None:
        """Raises Fault unless the daemon is the same one, answers, and logs no traceback."""
        if self.runtime.pid != self.pid:
            raise Fault(f"the daemon died; its log ends: {self.runtime.log[-1500:]}")
        status = self.call("/slidectl/status")
        if not status["paused"]:
            self.call("/gazebo/pause_physics")
        with self.runtime.paths.log.open("rb") as log:
            log.seek(self._log_read if os.fstat(log.fileno()).st_size >= self._log_read else 0)
            text = log.read()
            self._log_read = log.tell()
        check_text(text.decode("utf-8", "replace"), "the log")
        self._check_memory(status["memory"])

    def _check_memory(self, memory: int) -> None:
        if not self._memory:
            self._memory = memory
        if memory > self._memory + MEMORY_BOUND:
            raise Fault(f"memory grew from {self._memory >> 20} to {memory >> 20} MiB")

    def world(self) -> str:
        """All that a refused request must leave as it was, as text."""
        robots = self.call("/slidectl/list_robots", name="")["robots"]
        states = {}
        for robot in robots:
            service = f"{robot['namespace'].rstrip('/')}/controller_manager/list_controllers"
            states[robot["name"]] = [(one["name"], one["state"]) for one in self.call(service)["controller"]]
        names = self.call("/rosapi/get_param_names")["names"]
        topics = self.client.topics()
        services = self.call("/rosapi/services")["services"]
        parts = [robots, states, sorted(names), sorted(topics), sorted(services)]
        return json.dumps(parts, sort_keys=True)

    def close(self) -> None:
        self.closing.close()
        self.client.close()


@contextmanager
def target() -> Iterator[Target]:
    """A daemon of its own."""
    runtime = Runtime()
    try:
        runtime.start(paused=True)
        made = Target(runtime)
        try:
            yield made
        finally:
            made.close()
        runtime.stop()
    finally:
        runtime.remove()


class RawWire:
    """A connection on which anything may be sent."""

    def __init__(self, runtime: Runtime) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(ANSWER_LIMIT_S)
        self.socket.connect(runtime.paths.socket_text)

    def send(self, line: bytes) -> bool:
        """False when the daemon has hung up."""
        try:
            self.socket.sendall(line + b"\n")
        except (BrokenPipeError, ConnectionResetError):
            return False
        return True

    def until(self, mark: bytes) -> bytes:
        """What comes until `mark` does, or until the daemon hangs up. Raises Fault when neither happens."""
        deadline, got = time.monotonic() + ANSWER_LIMIT_S, b""
        while mark not in got:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self.socket], [], [], left)[0]:
                raise Fault(f"no answer within {ANSWER_LIMIT_S:g} s")
            try:
                piece = self.socket.recv(1 << 16)
            except ConnectionResetError:
                piece = b""
            if not piece:
                return got
            got += piece
        return got

    def close(self) -> None:
        self.socket.close()


def write(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path
