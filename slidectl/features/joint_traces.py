"""`/slidectl/trace`: the motion of a joint over the last seconds, or over the next ones."""

from __future__ import annotations

import struct
from binascii import b2a_base64
from collections.abc import Callable
from typing import TYPE_CHECKING

from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.effects import Effect
from slidectl.errors import Refused, SlidectlError
from slidectl.features.own_services import LONGEST_S
from slidectl.names import OWN_NODE
from slidectl.simulation.clock import SECOND
from slidectl.simulation.feature import Feature
from slidectl.simulation.history import EVERY
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_MOST_SAMPLES = 100_000
"""The most samples of a trace. A longer one has every second cycle, or every third."""
_SAMPLE = struct.Struct("<4d")


class JointTraces(Feature):
    """The service."""

    def attach(self, simulation: Simulation) -> None:
        node = simulation.graph.node(OWN_NODE, OWN_NODE)
        node.advertise_service(
            "trace", "slidectl/TraceJoint", lambda request: _trace(simulation, request), Effect.READS
        )


def _trace(simulation: Simulation, request: Message) -> Pending:
    """Answer a request. Raises UnknownName, Refused."""
    last, duration = request["last"], request["duration"]
    if not 0 <= last < LONGEST_S or not 0 <= duration < LONGEST_S or bool(last) == bool(duration):
        raise Refused(
            f"a trace is of the last or of the next seconds: one of two numbers above 0, not {last}, {duration}"
        )
    robot, joint, world = simulation.robots.get(request["robot"]), request["joint"], simulation.world
    place = world.robot(robot.name).place(joint)

    def now() -> bytes:
        return _SAMPLE.pack(simulation.time_ns / SECOND, *world.joint_state(robot.name, joint))

    if duration:
        return _TraceToCome(simulation, duration, now).pending
    now_ns = simulation.time_ns
    kept = simulation.loop.history.of_joint(place.qpos, place.dof, now_ns - from_seconds(last), now_ns)
    return Pending.of(_answer(EVERY * simulation.timestep_ns, kept.astype("<f8").tobytes() + now()))


def _answer(period_ns: int, rows: bytes) -> Message:
    return {"period": period_ns / SECOND, "samples": b2a_base64(rows, newline=False).decode("ascii")}


class _TraceToCome:
    """Samples from now on, one per cycle if these are not too many; answered at the end of the duration."""

    def __init__(self, simulation: Simulation, duration: float, sample: Callable[[], bytes]) -> None:
        step_ns, duration_ns = simulation.timestep_ns, from_seconds(duration)
        self._period_ns = step_ns * max(1, -(-duration_ns // (step_ns * _MOST_SAMPLES)))
        self._sample = sample
        self._rows = [sample()]
        self.pending = Pending(on_cancel=self._close)
        timers = simulation.graph.timers
        self._timer = timers.every(self._period_ns, self._add_sample)
        self._end = timers.after(duration_ns, self._finish)

    def _add_sample(self) -> None:
        try:
            row = self._sample()
        except SlidectlError as error:  # the robot was deleted
            self._close()
            self.pending.reject(error)
            return
        if row != self._rows[-1]:
            self._rows.append(row)

    def _finish(self) -> None:
        self._add_sample()
        self._close()
        self.pending.resolve(_answer(self._period_ns, b"".join(self._rows)))  # does nothing after a `reject`

    def _close(self) -> None:
        self._timer.cancel()
        self._end.cancel()
