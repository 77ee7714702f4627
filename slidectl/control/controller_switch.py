"""A switch of controllers: what a request asks for, what it would break, and how it is carried out cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from slidectl.control.controller_interface import State
from slidectl.control.duration import to_seconds
from slidectl.control.hardware_interface import (
    Conflict,
    ControllerInfo,
    RobotHW,
    SwitchState,
)
from slidectl.control.loaded_controller import LoadedController
from slidectl.control.node_handle import NodeHandle, Reasons
from slidectl.control.user_classes import described
from slidectl.errors import Refused, SlidectlError, UnknownName, listing, quoted

BEST_EFFORT = 1
STRICT = 2
MOST_NAMES = 1000
"""Most names in one request, for hooks are called for every name. A robot has a few dozen controllers at most."""


def way_out(conflicts: Sequence[Conflict], starting: Collection[str]) -> str:
    """The switch that frees the resources of those that start; empty when they only conflict with one another."""
    claims = list(dict.fromkeys(name for conflict in conflicts for name in conflict.controllers))
    in_the_way = [name for name in claims if name not in starting]
    if not in_the_way:
        return ""
    to_start = " ".join(name for name in claims if name in starting)
    return f"; slidectl controller switch --start {to_start} --stop {' '.join(in_the_way)}"


def known(
    loaded: Mapping[str, LoadedController], wanted: Iterable[str], verb: str, strict: bool, node: NodeHandle
) -> list[LoadedController]:
    """The controllers of these names. Logs a warning about unknown ones, or raises when `strict`."""
    found = [loaded[name] for name in wanted if name in loaded]
    unknown = [name for name in wanted if name not in loaded]
    if unknown and strict:
        raise not_loaded(loaded, unknown[0], verb, node)
    unconfigured = [entry.name for entry in found if verb == "start" and not entry.is_configured]
    if unconfigured:
        reason = f"cannot start controller {quoted(unconfigured[0])}: it is unconfigured"
        hint = f"configure it first: slidectl controller configure {unconfigured[0]}"
        if strict:
            raise Refused(reason, hint)
        node.log("warn", f"{reason}; {hint}; the rest of the request goes on")
        found = [entry for entry in found if entry.is_configured]
    if unknown:
        node.log("warn", f"no controller {listing(map(quoted, unknown))} to {verb}; the rest of the request goes on")
    if len(found) > MOST_NAMES:
        raise Refused(f"{len(found)} controllers to {verb}, and {MOST_NAMES} is the most in one request")
    return found


def not_loaded(loaded: Mapping[str, LoadedController], name: str, verb: str, node: NodeHandle) -> SlidectlError:
    """The error for a controller that is not loaded: whether it could be, by its parameters."""
    with suppress(SlidectlError):  # the name may be none
        if node.get_param(f"{name}/type", None) is not None:
            hint = f"load and start it: slidectl controller spawn {name}; load it only: slidectl controller load {name}"
            return Refused(f"controller {quoted(name)} is not loaded, so there is nothing to {verb}", hint)
    return UnknownName("controller", name, list(loaded), f"to {verb}")


@dataclass
class Switch:
    """An accepted switch. `advance` carries it out, once per cycle, after the updates.

    A name may occur several times in a request; its hooks are then called as often.
    """

    start_request: list[LoadedController]
    stop_request: list[LoadedController]
    asap: bool
    timeout_s: float
    init_time_ns: int
    on_done: Callable[[bool], None]
    reasons: Reasons | None
    """The reasons of the request. Errors in later cycles are added to them."""
    start: list[ControllerInfo] = field(default_factory=list)
    """The controllers that really start; `stop`: that really stop; `running`: that run afterwards."""
    stop: list[ControllerInfo] = field(default_factory=list)
    running: list[ControllerInfo] = field(default_factory=list)
    modes: list[tuple[LoadedController, bool]] = field(default_factory=list)
    """The chainable controllers that run afterwards, and whether in chained mode."""
    has_begun: bool = False

    def check_chains(self, loaded: Collection[LoadedController], strict: bool, node: NodeHandle) -> None:
        """Leave out, with a warning, what would leave a controller without one that it needs.

        Raises Refused: strict, and there is such a controller.
        """
        while found := self._broken_chain(loaded):
            request, entry, refusal = found
            if strict:
                raise refusal
            node.log("warn", f"{described(refusal)}; the rest of the request goes on")
            request[:] = [one for one in request if one is not entry]

    def _broken_chain(
        self, loaded: Collection[LoadedController]
    ) -> tuple[list[LoadedController], LoadedController, Refused] | None:
        """A list of the request, the controller in it that must not be there, and why; None when there is none."""
        runs = [one for one in loaded if one in self.start_request or (one.is_running and one not in self.stop_request)]
        for entry in self.start_request:
            for need in entry.needs:
                if need not in runs:
                    verb = "writes the references" if need in entry.writes_to else "reads the states"
                    why = "this switch stops" if need.is_running else "does not run"
                    text = f"cannot start controller {entry.name!r}: it {verb} of {need.name!r}, which {why}"
                    hint = f"start both: slidectl controller switch --start {need.name} {entry.name}"
                    return self.start_request, entry, Refused(text, "" if need.is_running else hint)
        for entry in self.stop_request:
            for user in runs if entry.is_running and entry not in runs else ():
                if entry in user.needs:
                    verb = "writes its references" if entry in user.writes_to else "reads its states"
                    text = f"cannot stop controller {entry.name!r}: {user.name!r}, which {verb}, goes on"
                    hint = f"stop both: slidectl controller switch --stop {user.name} {entry.name}"
                    return self.stop_request, entry, Refused(text, hint)
        return None

    def plan_chains(self, loaded: Iterable[LoadedController]) -> None:
        """Set `modes`, and restart the running controllers whose mode changes. Call it after `plan`."""
        after = {info.name for info in self.running}
        runs = [entry for entry in loaded if entry.name in after]
        for entry in runs:
            if entry.controller.exported_references:
                is_chained = any(entry in one.writes_to for one in runs)
                self.modes.append((entry, is_chained))
                if entry.is_running and entry.controller.is_chained != is_chained:
                    self.stop_request.append(entry)
                    if entry not in self.start_request:
                        self.start_request.append(entry)
        # Each stops before those that it needs, and starts after them.
        self.stop_request.sort(key=lambda entry: -entry.depth)
        self.start_request.sort(key=lambda entry: entry.depth)

    def plan(self, loaded: Iterable[LoadedController], strict: bool) -> None:
        """Set `start`, `stop` and `running`.

        Raises:
            Refused: strict and a controller runs already or does not run; or a running one is in both lists.
        """
        for entry in loaded:
            is_running = entry.is_running
            stops, starts = entry in self.stop_request, entry in self.start_request
            if stops and not is_running:
                if strict:
                    raise Refused(f"cannot stop controller {entry.name!r}: it is not running")
                stops = False
            if starts and is_running and not stops:
                if strict:
                    raise Refused(f"cannot start controller {entry.name!r}: it is running already")
                starts = False
            if starts and stops:
                raise Refused(f"controller {entry.name!r} cannot be started and stopped in one switch")
            if stops:
                self.stop.append(entry.info)
            if starts:
                self.start.append(entry.info)
            if starts or (is_running and not stops):
                self.running.append(entry.info)

    def advance(self, hw: RobotHW, time_ns: int) -> bool:
        """One cycle of the switch: stop, then start what the hardware is ready for. True when it is finished."""
        if not self.has_begun:
            hw.do_switch(self.start, self.stop)
            self.has_begun = True
            for entry in self.stop_request:
                if entry.is_running:
                    entry.enter_state(State.STOPPED, time_ns)
            for entry, is_chained in self.modes:
                if entry.controller.is_chained != is_chained:
                    entry.controller.is_chained = is_chained
        if not self.asap:
            return self._start(self.start_request, None, hw, time_ns)
        for entry in self.start_request:
            if not entry.is_running and all(need.is_running for need in entry.needs):
                self._start([entry], entry.info, hw, time_ns)
        return all(
            entry.is_running or entry.is_aborted or any(need.is_aborted for need in entry.needs)
            for entry in self.start_request
        )

    def give_up(self, time_ns: int) -> None:
        """Abort the controllers that should start, because the hardware failed."""
        for entry in self.start_request:
            if not entry.is_running:
                entry.enter_state(State.ABORTED, time_ns)

    def _start(self, entries: list[LoadedController], info: ControllerInfo | None, hw: RobotHW, time_ns: int) -> bool:
        """Start the entries, let them wait, or abort them, by the hardware's state for `info`. False: they wait."""
        if hw.switch_result(info) is SwitchState.DONE:
            for entry in entries:
                if all(need.is_running for need in entry.needs):  # else it is aborted with its chain
                    entry.start(time_ns)
            return True
        has_timed_out = 0.0 < self.timeout_s < to_seconds(time_ns - self.init_time_ns)
        is_over = hw.switch_result(info) is SwitchState.ERROR or has_timed_out
        for entry in entries:
            entry.enter_state(State.ABORTED if is_over else State.WAITING, time_ns)
        return is_over
