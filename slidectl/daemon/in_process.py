"""A world with clients in one process: a simulation, its publications, and a session for each client, without sockets.

While a client waits, cycles run as fast as possible; without a waiting client the world stands still. So the same calls
give the same bits. Wall times of a daemon are simulated times here: see InProcessWorld.monotonic.
"""

from __future__ import annotations

import math
import os
import traceback
from collections.abc import Callable
from typing import Any

from slidectl import paths
from slidectl.client import Client
from slidectl.control.node_handle import Message
from slidectl.daemon.outbox import Channel, Outbox, Publications
from slidectl.daemon.session import Session
from slidectl.errors import NoDaemon, Refused, TimedOut
from slidectl.names import OWN_NODE
from slidectl.simulation.simulation import Simulation
from slidectl.wire.json_lines import LineBuffer, decode
from slidectl.wire.peers import went_away

_CHUNK = 64 * 1024
_LONGEST_SLICE = 10_000
"""Cycles between two checks for other work: signals, and clients that do not wait."""
_LONGEST_STILL_S = 600.0
"""How long a client may wait for a world that stands still, on the world's own clock, before it gets TimedOut."""
_NAME = "in-process"


class InProcessWorld:
    """A simulation that runs while its clients wait.

    Args:
        simulation: one without a driver; a new one by default.

    `paused`, `speed` and steps mean the same as in a daemon. `end_ns` is the simulated time at which a waiting client
    gets TimedOut; `log` has the last lines of the log.
    """

    def __init__(self, simulation: Simulation | None = None) -> None:
        self.simulation = simulation or Simulation()
        self.simulation.driven = True
        self.simulation.host.reports.append(self._status)
        self._news = False
        self.simulation.loop.enough = lambda: self._news
        self.publications = _NotedPublications(self)
        self.connections: list[InProcessConnection] = []
        self.end_ns: int | None = None
        self.end_hint = ""
        """The hint of that TimedOut."""
        self.log = self.simulation.host.lines
        self.stopping = ""
        """The reason why the world ends; empty as long as it runs."""
        self._wall_s = 0.0
        self._still_s = 0.0
        self._serial = 0
        self._waiting: list[InProcessConnection] = []
        self.simulation.features.log_broken()
        services = self.simulation.graph.services
        services.advertise("/slidectl/shutdown", "slidectl/Shutdown", OWN_NODE, self._shut_down)

    def connect(self) -> InProcessConnection:
        """Create a connection. Raises NoDaemon: the world has ended."""
        if self.stopping:
            raise NoDaemon(f"the daemon was {self.stopping}")
        self._serial += 1
        connection = InProcessConnection(self, f"/slidectl_{self._serial}")
        self.connections.append(connection)
        return connection

    def client(self, timeout: float = 10.0) -> Client:
        """Create a client with a connection of its own."""
        return Client(link=InProcessLink(self), timeout=timeout)

    def monotonic(self) -> float:
        """The clock of waiting clients, in s: simulated time divided by the speed (1 for as fast as possible).

        While the world stands still, it jumps to the end of each wait.
        """
        return self._wall_s

    def wait(self, connection: InProcessConnection, deadline: float) -> None:
        """Run until the connection has something to read, or until the deadline on `monotonic`.

        Raises:
            TimedOut: at `end_ns`, or when the world stands still and nothing can come.
        """
        self._waiting.append(connection)
        try:
            while not connection.has_lines and not self.stopping and self._wall_s < deadline:
                if not self._call_back_others():
                    others = (one.due_s for one in self.connections if one.on_lines and one not in self._waiting)
                    self._go_on(min([deadline, *others, self._wall_s + self.publications.release()]))
        finally:
            self._waiting.pop()

    def _go_on(self, deadline: float) -> None:
        simulation = self.simulation
        if simulation.run.allowed(1) == 0:
            self._stand_still(deadline)
            return
        self._still_s = 0.0
        speed = simulation.run.speed
        period_s = simulation.timestep_ns * 1e-9 / (speed if math.isfinite(speed) else 1.0)
        cycles = _LONGEST_SLICE
        if deadline - self._wall_s < cycles * period_s:
            cycles = max(1, math.ceil((deadline - self._wall_s) / period_s))
        if self.end_ns is not None:
            left = (self.end_ns - simulation.time_ns) // simulation.timestep_ns
            if left <= 0:
                raise TimedOut(f"the simulated time is up: {simulation.time_ns * 1e-9:g} s", self.end_hint)
            cycles = min(cycles, left)
        self._news = False
        self._wall_s += self._step(simulation.run.allowed(cycles)) * period_s

    def _stand_still(self, deadline: float) -> None:
        """Jump to the deadline, since no cycle can come, or until a lock-step member times out."""
        run = self.simulation.run
        awaited = run.awaited() if run.requests or not run.paused else []
        for gate, member in awaited:
            if self._still_s >= member.timeout_s:
                gate.let_go(member)
                return
        left_s = min([max(0.0, deadline - self._wall_s), *(member.timeout_s - self._still_s for _, member in awaited)])
        if self._still_s + left_s > _LONGEST_STILL_S:
            trouble = run.trouble
            why = f" ({trouble})" if trouble else ""
            raise TimedOut(f"the simulation is paused{why}, and nobody resumes it", "first: slidectl sim resume")
        self._still_s += left_s
        self._wall_s += left_s

    def _step(self, cycles: int) -> int:
        """Run cycles. Returns the number run. An internal error holds the world and is logged."""
        before = self.simulation.cycles
        try:
            return self.simulation.step(cycles)
        except Exception:
            self.unexpected("a control cycle failed")
            self.simulation.run.hold("a control cycle failed, see the log", "a control cycle failed")
            return max(0, self.simulation.cycles - before)

    def note_message(self, connection: InProcessConnection) -> None:
        """Note that a connection has something to read: if a client reads it, the slice ends with the running cycle."""
        if not self._news and (connection.on_lines is not None or connection in self._waiting):
            self._news = True
            self.simulation.loop.end_burst()

    def _call_back_others(self) -> bool:
        """Call back other clients that have something to read. Returns True when there was one."""
        self.publications.fresh.clear()
        listening = [one for one in self.connections if one.on_lines and one not in self._waiting]
        ready = [one for one in listening if one.has_lines or one.due_s <= self._wall_s]
        for connection in ready:
            if connection.on_lines is not None:  # an earlier callback may have removed it
                connection.due_s = math.inf
                connection.on_lines()
        return bool(ready)

    def end(self) -> None:
        """Tell all clients why the world is `stopping`, and close their connections."""
        for connection in list(self.connections):
            connection.session.warn(f"the daemon was {self.stopping}")
            connection.close()

    def _shut_down(self, _: Message) -> Message:
        self.stopping = "asked to stop"  # the caller gets the answer first
        return {"success": True, "message": "the world ends"}

    def unexpected(self, what: str) -> None:
        """Log the exception that is being handled."""
        self.log.append(f"fatal {what}\n{traceback.format_exc()}")

    def _status(self) -> dict[str, Any]:
        """The daemon's part of /slidectl/status, as far as it applies."""
        return {"pid": os.getpid(), "instance": _NAME, "connections": len(self.connections), "uptime": self._wall_s}


class _NotedPublications(Publications):
    """Notes new messages for the readers of a channel."""

    def __init__(self, world: InProcessWorld) -> None:
        super().__init__(world.simulation.run, world.monotonic)
        self._world = world

    def note(self, channel: Channel) -> None:
        super().note(channel)
        for reader in channel.readers:
            assert isinstance(reader, InProcessConnection)
            if reader.is_prompt:
                self._world.note_message(reader)

    def hold(self, channel: Channel) -> None:
        if channel not in self.held:  # the running slice may be longer than the throttle
            self._world.simulation.loop.end_burst()
        super().hold(channel)


class InProcessConnection:
    """The daemon's end of a connection: a session and its outgoing lines."""

    unread = 0
    is_overfull = False  # unread lines are memory of the client's own process

    def __init__(self, world: InProcessWorld, node: str) -> None:
        self._world = world
        self._incoming = LineBuffer()
        self.on_lines: Callable[[], object] | None = None
        """Called between two cycles when lines have come while another client waits. None: they stay until read."""
        self.is_prompt = True
        """True when messages of topics end a slice of cycles for it, as answers do."""
        self.due_s = math.inf
        """The time on the world's clock at which `on_lines` is called although nothing has come."""
        graph = world.simulation.graph
        self.node = node
        recorder = world.simulation.host.recorder
        self.session = Session(self, graph, world.publications, world.unexpected, node, os.getsid(0), recorder)
        self.outbox = Outbox(self.session.report, world.publications)
        self.open = True

    def send(self, line: bytes) -> None:
        """Send a line that must arrive."""
        self.outbox.add(line)
        self._world.note_message(self)

    def check_end(self) -> None:
        """Nothing to do: a client in the same process ends at once."""

    @property
    def has_lines(self) -> bool:
        """True while there is something to read."""
        return bool(self._incoming.lines or self.outbox)

    def next_line(self) -> bytes | None:
        """The next line for the client; None without one."""
        lines = self._incoming.lines
        if not lines and self.outbox:
            self._incoming.feed(self.outbox.next_piece(_CHUNK))
        return lines.popleft() if lines else None

    def close(self) -> None:
        """Close the connection; lines that the client has not read can still be read."""
        if self.open:
            self.open = False
            self._world.connections.remove(self)
            while self.outbox:
                self._incoming.feed(self.outbox.next_piece(_CHUNK))
            self.session.closed()


class InProcessLink:
    """The client's end of a connection, with the interface of client.link.SocketLink."""

    def __init__(self, world: InProcessWorld) -> None:
        """Raises NoDaemon: the world has ended."""
        self.paths = paths.instance(_NAME)
        self.daemon_pid: int | None = os.getpid()
        self.last_status = ""
        self.connection = world.connect()
        self._world = world

    def another(self, deadline: float) -> InProcessLink:  # noqa: ARG002
        """Open another connection to the same world. Raises NoDaemon."""
        return InProcessLink(self._world)

    def monotonic(self) -> float:
        """The clock of deadlines, s."""
        return self._world.monotonic()

    def fileno(self) -> int:
        """Raises Refused: there is no descriptor."""
        raise Refused("a client of a world in the same process has no socket", "wait for it with `wait_until`")

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """Set the function to call between two cycles when lines have come while another client waits."""
        self.connection.on_lines = action
        return True

    def send(self, line: bytes, deadline: float) -> None:  # noqa: ARG002
        """Handle a line, in this call. Raises NoDaemon."""
        if self._world.stopping:
            self._world.end()
        if not self.connection.open:
            while (left := self.connection.next_line()) is not None:
                self.last_status = str(decode(left).get("msg", "")) or self.last_status
            raise self._gone()
        self.connection.session.handle(line)

    def receive(self, deadline: float) -> dict[str, Any] | None:
        """The next object, or None when the deadline passes first. Raises NoDaemon, and as InProcessWorld.wait."""
        if self.connection.open:
            self._world.wait(self.connection, deadline)
            if self._world.stopping and not self.connection.has_lines:
                self._world.end()
        line = self.connection.next_line()
        if line is None and not self.connection.open:
            raise self._gone()
        return None if line is None else decode(line)

    def _gone(self) -> NoDaemon:
        return went_away(self.last_status)

    def close(self) -> None:
        """Close the connection; what it advertised and subscribed ends with it."""
        self.connection.close()
