"""A switch of controllers: first the plan and its refusals, then its cycles until all are started or aborted.

After ros_control's controller manager. A refused plan changes nothing; an armed switch touches only the
controllers of its request.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from slidectl.control.duration import to_seconds
from slidectl.control.loaded import LoadedController
from slidectl.control.node import NodeHandle, Reasons
from slidectl.control.robot_hw import ControllerInfo, RobotHW, SwitchState
from slidectl.errors import Refused, UnknownName, quoted

BEST_EFFORT = 1
STRICT = 2
MOST_NAMES = 1000
"""Of one request: a robot has a few dozen controllers at most, and hooks are called for every name."""
_MOST_TOLD = 20


@dataclass
class Plan:
    """What was asked, and what it comes to: genuine starts and stops, and who will then be running."""

    start_request: list[LoadedController]
    stop_request: list[LoadedController]
    start: list[ControllerInfo] = field(default_factory=list)
    stop: list[ControllerInfo] = field(default_factory=list)
    running: list[ControllerInfo] = field(default_factory=list)


def plan_switch(
    loaded: Mapping[str, LoadedController],
    start: Sequence[str],
    stop: Sequence[str],
    *,
    strict: bool,
    node: NodeHandle,
) -> Plan:
    """The plan for a request. Names may repeat; then so do the calls of their hooks.

    Raises:
        Refused: strict and a name is unknown, already running or not running; or a running one is in both lists.
    """
    stop_request = _known(loaded, stop, "stop", strict, node)
    plan = Plan(_known(loaded, start, "start", strict, node), stop_request)
    for entry in loaded.values():
        _place(plan, entry, strict)
    return plan


def _known(
    loaded: Mapping[str, LoadedController], wanted: Iterable[str], verb: str, strict: bool, node: NodeHandle
) -> list[LoadedController]:
    found = []
    unknown = 0
    for name in wanted:
        if name in loaded:
            found.append(loaded[name])
        elif strict:
            raise UnknownName("controller", name, list(loaded), f"to {verb}")
        else:
            unknown += 1
            if unknown <= _MOST_TOLD:
                node.log("warn", f"no controller {quoted(name)} to {verb}; the rest of the request goes on")
    if unknown > _MOST_TOLD:
        node.log("warn", f"and {unknown - _MOST_TOLD} more that are not there to {verb}")
    if len(found) > MOST_NAMES:
        raise Refused(f"{len(found)} controllers to {verb}, and {MOST_NAMES} is the most in one request")
    return found


def _place(plan: Plan, entry: LoadedController, strict: bool) -> None:
    """Sort one loaded controller into the plan's lists."""
    in_stop, in_start = entry in plan.stop_request, entry in plan.start_request
    running = entry.is_running
    if in_stop and not running:
        _refuse_if(strict, f"cannot stop controller {entry.name!r}: it is not running")
        in_stop = False
    if in_start and running and not in_stop:
        _refuse_if(strict, f"cannot start controller {entry.name!r}: it is running already")
        in_start = False
    _refuse_if(in_start and in_stop, f"controller {entry.name!r} cannot be started and stopped in one switch")
    if in_stop:
        plan.stop.append(entry.info)
    elif in_start:
        plan.start.append(entry.info)
    if in_start or (running and not in_stop):
        plan.running.append(entry.info)


def _refuse_if(refused: bool, reason: str) -> None:
    if refused:
        raise Refused(reason)


class Switch:
    """An accepted switch, carried out by `advance` once a cycle, after the updates."""

    def __init__(
        self, plan: Plan, *, asap: bool, timeout_s: float, init_time_ns: int, on_done: Callable[[bool], None]
    ) -> None:
        self._plan = plan
        self._asap = asap
        self._timeout_s = timeout_s
        self._init_time_ns = init_time_ns
        self._begun = False
        self.on_done = on_done
        self.reasons: Reasons | None = None
        """Those of the request, for what goes wrong in later cycles."""

    def advance(self, hw: RobotHW, time_ns: int) -> bool:
        """One cycle of the switch: stop, then start what the hardware is ready for. True when it is finished."""
        plan = self._plan
        if not self._begun:
            hw.do_switch(plan.start, plan.stop)
            self._begun = True
        for entry in plan.stop_request:
            if entry.is_running:
                entry.stop(time_ns)
        return self._start_asap(hw, time_ns) if self._asap else self._start_together(hw, time_ns)

    def _start_together(self, hw: RobotHW, time_ns: int) -> bool:
        request = self._plan.start_request
        if hw.switch_result() is SwitchState.DONE:
            for entry in request:
                entry.start(time_ns)
            return True
        if hw.switch_result() is SwitchState.ERROR or self._timed_out(time_ns):
            for entry in request:
                entry.abort(time_ns)
            return True
        for entry in request:
            entry.wait(time_ns)
        return False

    def _start_asap(self, hw: RobotHW, time_ns: int) -> bool:
        request = self._plan.start_request
        for entry in request:
            if not entry.is_running:
                self._start_one(entry, hw, time_ns)
        return all(entry.is_running or entry.is_aborted for entry in request)

    def _start_one(self, entry: LoadedController, hw: RobotHW, time_ns: int) -> None:
        if hw.switch_result(entry.info) is SwitchState.DONE:
            entry.start(time_ns)
        elif hw.switch_result(entry.info) is SwitchState.ERROR or self._timed_out(time_ns):
            entry.abort(time_ns)
        else:
            entry.wait(time_ns)

    def _timed_out(self, time_ns: int) -> bool:
        return self._timeout_s > 0.0 and to_seconds(time_ns - self._init_time_ns) > self._timeout_s
