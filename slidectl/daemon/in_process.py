"""A world with clients in one process: a simulation, its publications, and a session for each client, without sockets.

While a client waits for something, cycles run as fast as they can; while nobody waits, the world stands still. So the
same calls give the same bits. What takes wall time in a daemon takes simulated time here: see InProcessWorld.monotonic.
"""

from __future__ import annotations

import math
import os
import traceback
from collections import deque
from collections.abc import Callable
from typing import Any

from slidectl import paths
from slidectl.client import Client
from slidectl.client.lines import LineBuffer, decode
from slidectl.control.node_handle import Message
from slidectl.daemon.journal import Journal
from slidectl.daemon.outbox import Channel, Outbox, Publications
from slidectl.daemon.session import Session
from slidectl.errors import NoDaemon, Refused, TimedOut
from slidectl.names import OWN_NODE
from slidectl.simulation.simulation import Simulation

_CHUNK = 64 * 1024
_LONGEST_SLICE = 10_000
"""Cycles between two looks at what is not the world: signals, and clients that are not waited for."""
_LONGEST_STILL_S = 600.0
"""How long somebody may wait for a world that stands still, on its own clock; then it is told that nothing comes."""
_KEPT_LINES = 200
_NAME = "in-process"


class InProcessWorld:
    """A simulation that its clients drive by waiting.

    Args:
        simulation: one that nobody drives yet; a new one by default.

    `paused`, `speed` and steps mean what they mean in a daemon. `end_ns` is the simulated time at which whoever waits
    is told TimedOut; `log` has the last lines of the log. A `journal` notes what the clients do; who made it closes it.
    """

    def __init__(self, simulation: Simulation | None = None, journal: Journal | None = None) -> None:
        self.simulation = simulation or Simulation()
        self.journal = journal
        if journal is not None:
            journal.watch(self.simulation)
        self.simulation.driven = True
        self.simulation.monitor = self._status
        self._news = False
        self.simulation.loop.enough = lambda: self._news
        self.publications = _NotedPublications(self)
        self.connections: list[InProcessConnection] = []
        self.end_ns: int | None = None
        self.end_hint = ""
        """What TimedOut then says one could do."""
        self.log: deque[str] = deque(maxlen=_KEPT_LINES)
        self.stopping = ""
        """Why the world ends; empty as long as it goes on."""
        self._wall_s = 0.0
        self._still_s = 0.0
        self._serial = 0
        self._waiting: list[InProcessConnection] = []
        graph = self.simulation.graph
        graph.log.sink = self._keep_line
        graph.services.advertise("/slidectl/shutdown", "slidectl/Shutdown", OWN_NODE, self._shut_down)

    def connect(self) -> InProcessConnection:
        """A connection of its own. Raises NoDaemon: the world has ended."""
        if self.stopping:
            raise NoDaemon(f"the daemon was {self.stopping}")
        self._serial += 1
        connection = InProcessConnection(self, f"/slidectl_{self._serial}")
        self.connections.append(connection)
        return connection

    def client(self, timeout: float = 10.0) -> Client:
        """A client with a connection of its own."""
        return Client(link=InProcessLink(self), timeout=timeout)

    def monotonic(self) -> float:
        """The clock of whoever waits, in s: simulated time divided by the speed (1 for as fast as possible).

        Where the world stands still, it goes to the end of each wait at once.
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
                if not self._look_after_others():
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
        """No cycle can come, so nothing does until the deadline, or until who holds the world is let go."""
        run = self.simulation.run
        lockstep = run.lockstep if run.requests or not run.paused else None
        awaited = [] if lockstep is None else lockstep.awaited()
        for member in awaited:
            if lockstep is not None and self._still_s >= member.timeout_s:
                lockstep.let_go(member)
                return
        left_s = min([max(0.0, deadline - self._wall_s), *(member.timeout_s - self._still_s for member in awaited)])
        if self._still_s + left_s > _LONGEST_STILL_S:
            trouble = run.trouble
            why = f" ({trouble})" if trouble else ""
            raise TimedOut(f"the simulation is paused{why}, and nobody lets it go on", "first: slidectl sim resume")
        self._still_s += left_s
        self._wall_s += left_s

    def _step(self, cycles: int) -> int:
        """How many were done. A fault of ours holds the world and is told."""
        before = self.simulation.cycles
        try:
            return self.simulation.step(cycles)
        except Exception:
            self.unexpected("a control cycle failed")
            self.simulation.run.hold("a control cycle failed, see the log", "a control cycle failed")
            return max(0, self.simulation.cycles - before)

    def note_message(self, connection: InProcessConnection) -> None:
        """It has something to read: if somebody reads it, the slice ends with the cycle that runs, in both engines."""
        if not self._news and (connection.on_lines is not None or connection in self._waiting):
            self._news = True
            self.simulation.loop.end_burst()

    def _look_after_others(self) -> bool:
        """Those who take what comes have their turn. True when somebody had something."""
        self.publications.fresh.clear()
        listening = [one for one in self.connections if one.on_lines and one not in self._waiting]
        ready = [one for one in listening if one.has_lines or one.due_s <= self._wall_s]
        for connection in ready:
            if connection.on_lines is not None:  # one before it may have ended it
                connection.due_s = math.inf
                connection.on_lines()
        return bool(ready)

    def end(self) -> None:
        """Tell all clients that the world is `stopping`, and let them go."""
        for connection in list(self.connections):
            connection.session.warn(f"the daemon was {self.stopping}")
            connection.close()

    def _shut_down(self, _: Message) -> Message:
        self.stopping = "asked to stop"  # who asked gets the answer first
        return {"success": True, "message": "the world ends"}

    def _keep_line(self, severity: str, node: str, text: str, time_ns: int) -> None:
        self.log.append(f"{severity:<5} [{time_ns * 1e-9:.3f}] {node}: {text}")

    def unexpected(self, what: str) -> None:
        """Log the exception that is being handled."""
        self.log.append(f"fatal {what}\n{traceback.format_exc()}")

    def _status(self) -> dict[str, Any]:
        """The daemon's part of /slidectl/status, as far as there is one."""
        return {"pid": os.getpid(), "instance": _NAME, "connections": len(self.connections), "uptime": self._wall_s}


class _NotedPublications(Publications):
    """Says when a channel has something new for its readers."""

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
        if channel not in self.held:  # the slice that runs may be longer than the throttle
            self._world.simulation.loop.end_burst()
        super().hold(channel)


class InProcessConnection:
    """The daemon's end of a connection: a session, and what it has to say."""

    unread = 0
    is_overfull = False  # what waits for the client is memory of its own process

    def __init__(self, world: InProcessWorld, node: str) -> None:
        self._world = world
        self._incoming = LineBuffer()
        self.on_lines: Callable[[], object] | None = None
        """Called between two cycles when something has come while another one waits. None: it lies until it is read."""
        self.is_prompt = True
        """Whether messages of topics end a slice of cycles for it, as answers do."""
        self.due_s = math.inf
        """When it is called on the world's clock although nothing has come."""
        graph = world.simulation.graph
        self.node = node
        self.session = Session(self, graph, world.publications, world.unexpected, node, os.getsid(0), world.journal)
        self.outbox = Outbox(self.session.report, world.publications)
        self.open = True

    def send(self, line: bytes) -> None:
        """A line that must arrive."""
        self.outbox.put(line)
        self._world.note_message(self)

    def look_again(self) -> None:
        """A client in the same process ends at once."""

    @property
    def has_lines(self) -> bool:
        """True while there is something to read."""
        return bool(self._incoming.lines or self.outbox)

    def next_line(self) -> bytes | None:
        """The next of the lines for the client."""
        lines = self._incoming.lines
        if not lines and self.outbox:
            self._incoming.feed(self.outbox.take(_CHUNK))
        return lines.popleft() if lines else None

    def close(self) -> None:
        """The client has gone, or the world has; what it has not read can be read still."""
        if self.open:
            self.open = False
            self._world.connections.remove(self)
            while self.outbox:
                self._incoming.feed(self.outbox.take(_CHUNK))
            self.session.closed()


class InProcessLink:
    """The client's end of a connection, as client.link.SocketLink has it."""

    def __init__(self, world: InProcessWorld) -> None:
        """Raises NoDaemon: the world has ended."""
        self.paths = paths.instance(_NAME)
        self.daemon_pid = os.getpid()
        self.last_status = ""
        self.connection = world.connect()
        self._world = world

    def another(self, deadline: float) -> InProcessLink:  # noqa: ARG002
        """A further connection to the same world. Raises NoDaemon."""
        return InProcessLink(self._world)

    def monotonic(self) -> float:
        """The clock on which deadlines are."""
        return self._world.monotonic()

    def fileno(self) -> int:
        """Raises Refused: there is none."""
        raise Refused("a client of a world in the same process has no socket", "wait for it with `wait_until`")

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """Call it between two cycles whenever something has come while another one waits."""
        self.connection.on_lines = action
        return True

    def send(self, line: bytes, deadline: float) -> None:  # noqa: ARG002
        """Carry out a line, now. Raises NoDaemon."""
        if self._world.stopping:
            self._world.end()
        if not self.connection.open:
            while (left := self.connection.next_line()) is not None:
                self.last_status = str(decode(left).get("msg", "")) or self.last_status
            raise self._gone()
        self.connection.session.take(line)

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
        why = f": {self.last_status}" if self.last_status else ""
        return NoDaemon(f"the daemon went away{why}")

    def close(self) -> None:
        """End the connection; what it advertised and subscribed ends with it."""
        self.connection.close()
