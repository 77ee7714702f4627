"""Lock-step: the world goes on only when every member has called to say that it is done with its period.

This module knows simulated time and nodes only. The driver removes a member that holds the world for too long in wall
time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.errors import Refused
from slidectl.names import OWN_NODE
from slidectl.simulation.clock import Clock, Timer
from slidectl.simulation.feature import Feature
from slidectl.simulation.loop import whole_cycles
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_TIMEOUT_S = 5.0
_LONGEST_S = 1e6


class LockStepMember:
    """A client for which the world waits. `pending` is its call while its period runs; None while the world must wait.

    Times are in ns (simulated) and s (wall).
    """

    def __init__(self, node: str, period_ns: int, timeout_s: float, clock: Clock) -> None:
        self.node = node
        self.period_ns = period_ns
        self.timeout_s = timeout_s
        self.pending: Pending | None = None
        self.timer = Timer(0, self._answer)
        """Set for the time at which its call is answered; it moves with the clock when that is set."""
        self._clock = clock

    def _answer(self) -> None:
        pending, self.pending = self.pending, None
        if pending is not None:
            clock = self._clock
            pending.resolve({"success": True, "message": "", "time": clock.seconds, "cycles": clock.cycles})


class LockStepService(Feature):
    """The service `/slidectl/lockstep`, and its members."""

    def attach(self, simulation: Simulation) -> None:
        self._host = simulation.host
        self._graph = graph = simulation.graph
        self._loop = simulation.loop
        self._removed: dict[str, str] = {}
        """The reasons of removals, by node, until it was told."""
        self.members: dict[str, LockStepMember] = {}
        graph.node(OWN_NODE, OWN_NODE).advertise_service("lockstep", "slidectl/LockStep", self._serve)
        graph.on_node_closed.append(self._on_node_closed)

    def status(self) -> Message:
        return {"lockstep": sorted(self.members)}

    def allowed(self, most: int) -> int:
        """The number of cycles, at most `most`, that may run before the world must wait for a member."""
        now, step_ns = self._graph.clock.time_ns, self._loop.step_ns
        for member in self.members.values():
            if member.pending is None:
                return 0
            most = min(most, -((now - member.timer.due_ns) // step_ns))
        return most

    def awaited(self) -> list[LockStepMember]:
        """The members for which the world waits now."""
        return [member for member in self.members.values() if member.pending is None]

    def let_go(self, member: LockStepMember) -> None:
        """Remove a member that has held the world for longer than its time-out. Only this is decided by wall time."""
        self._host.let_go(member.node)
        why = f"it held the world for more than {member.timeout_s:g} s"
        self._graph.log("warn", OWN_NODE, f"{member.node} has left the lock-step: {why}")
        self._leave(member.node)
        self._removed[member.node] = why

    def _serve(self, request: Message) -> Message | Pending:
        if not self._loop.driven:
            raise Refused("this world has no driver: it advances only by its step()")
        node = self._graph.calling_node
        if request["leave"]:
            self._member(node)
            self._leave(node)
        elif request["period"]:
            self._join(node, request["period"], request["timeout"] or _TIMEOUT_S)
        else:
            member = self._member(node)
            _check_not_waiting(member)
            member.pending = Pending()
            self._graph.timers.arm(member.timer, self._graph.clock.time_ns + member.period_ns)
            return member.pending
        clock, message = self._graph.clock, "left" if request["leave"] else "joined"
        return {"success": True, "message": message, "time": clock.seconds, "cycles": clock.cycles}

    def _member(self, node: str) -> LockStepMember:
        if node not in self.members:
            why = self._removed.pop(node, "")
            text = f"{node} is not in lock-step" + (f": {why}" if why else "")
            raise Refused(text, "join again with a period above 0; a member that was removed must join again, too")
        return self.members[node]

    def _join(self, node: str, period_s: float, timeout_s: float) -> None:
        for name, value in (("period", period_s), ("timeout", timeout_s)):
            if not 0 < value <= _LONGEST_S:
                raise Refused(f"{name} is a time above 0 s and at most {_LONGEST_S:g} s, not {value:g}")
        period_ns = from_seconds(period_s)
        whole_cycles(period_ns, self._loop.step_ns)
        if node in self.members:
            _check_not_waiting(self.members[node])
        self.members[node] = LockStepMember(node, period_ns, timeout_s, self._graph.clock)
        self._removed.pop(node, None)
        if self not in self._loop.run.gates:
            self._loop.run.gates.append(self)

    def _leave(self, node: str) -> None:
        member = self.members.pop(node)
        member.timer.cancel()
        if member.pending is not None:
            member.pending.reject(Refused(f"{node} has left the lock-step"))
        if not self.members:
            self._loop.run.gates.remove(self)

    def _on_node_closed(self, node: str) -> None:
        self._removed.pop(node, None)
        if node in self.members:
            self._graph.log("warn", OWN_NODE, f"{node} has disconnected; the lock-step continues without it")
            self._leave(node)


def _check_not_waiting(member: LockStepMember) -> None:
    if member.pending is not None:
        raise Refused(f"{member.node} waits for the end of its period already")
