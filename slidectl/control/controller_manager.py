"""The controller manager: loads, lists, switches and unloads the controllers of one robot, and updates them.

After ros_control's controller_manager. All calls come from one thread, between two cycles or (`update`) in one.
It does not know the names of the services that call it, nor the clients that wait for an answer.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, TypeVar

from slidectl import names
from slidectl.control import registry
from slidectl.control.controller_interface import ControllerBase, State
from slidectl.control.controller_switch import BEST_EFFORT, STRICT, Switch, known, not_loaded, way_out
from slidectl.control.hardware_interface import (
    JOINT_STATES,
    CommandAttribute,
    HardwareComponent,
    JointHandle,
    JointStateInterface,
    RobotHW,
    UnknownResource,
)
from slidectl.control.loaded_controller import LoadedController, UpdateTimes
from slidectl.control.node_handle import NodeHandle, ParameterChange
from slidectl.control.params import judge
from slidectl.control.registry import ControllerTypes
from slidectl.control.ros2_names import refuse_others
from slidectl.control.user_classes import (
    CallbackGuard,
    WatchedHandles,
    described,
    file_of,
    is_of_a_user,
    watched,
    watched_hardware,
)
from slidectl.errors import BadName, Refused, SlidectlError, UnknownName, listing, quoted

if TYPE_CHECKING:
    from slidectl.msgs.typed import ControllerStateMsg

T = TypeVar("T")


def _in_update_order(loaded: Iterable[LoadedController]) -> tuple[LoadedController, ...]:
    """The controllers in load order, but each before those whose references it writes."""
    waiting, ordered = list(loaded), dict[LoadedController, None]()

    def add(entry: LoadedController) -> None:
        for one in waiting:
            if entry in one.writes_to and one not in ordered:
                add(one)
        ordered.setdefault(entry)

    for entry in waiting:
        add(entry)
    return tuple(ordered)


Names = list[str]
Messages = list[dict[str, Any]]
ControllerStates = list["ControllerStateMsg"]


class ControllerManager:
    """The controllers of one robot. Refusals are logged as errors and answered with False."""

    def __init__(self, hw: RobotHW, node: NodeHandle, types: ControllerTypes = registry.common) -> None:
        """`node` is the robot's namespace: a controller's parameters and topics are below `<node>/<name>`. `types` are
        those that the world knows."""
        self._hw = hw
        self._node = node
        self.known = types
        """The types of controllers that can be loaded."""
        self._loaded: dict[str, LoadedController] = {}
        """In load order."""
        self._order: tuple[LoadedController, ...] = ()
        """All loaded controllers in the order of their updates: the load order, but each before those whose references
        it writes."""
        self._running: tuple[LoadedController, ...] = ()
        self._updates: tuple[tuple[Callable[[int, float], None], UpdateTimes], ...] = ()
        self._commands: tuple[tuple[LoadedController, list[CommandAttribute]], ...] = ()
        """The commands of each running controller."""
        self._commanded: tuple[JointHandle, ...] = ()
        """The joints of these commands."""
        self._further: tuple[CommandAttribute, ...] = ()
        """Those of these commands that are not the attribute `command`."""
        self._switch: Switch | None = None
        self.on_change: Callable[[], None] = lambda: None
        """Called when controllers have started, stopped or failed."""

    # The cycle.

    def update(self, time_ns: int, period_s: float, reset_controllers: bool = False) -> None:
        """One cycle: update every running controller, then carry on with a pending switch.

        A controller that starts in this cycle has its first update in the next one. `reset_controllers` stops
        and starts all running ones first.
        """
        if reset_controllers:
            self.restart_running(time_ns)
        # UpdateTimes.add inline, with one clock reading per controller: hot path, a further call would be measurable.
        clock_ns = perf_counter_ns
        began_ns = clock_ns()
        try:
            for update, times in self._updates:
                update(time_ns, period_s)
                now_ns = clock_ns()
                took_ns = now_ns - began_ns
                times.count += 1
                times.total_ns += took_ns
                if took_ns > times.notable_ns:
                    times.note(took_ns, now_ns)
                began_ns = now_ns
        except Exception as failure:
            self._carry_on(self._updates.index((update, times)), failure, time_ns, period_s)
        # Hot path: one sum finds whether a command may be wrong. It is nan for infinity and nan.
        total = 0.0
        for handle in self._commanded:
            total += handle.command
        if total - total != 0.0 or self._further:
            self._check_commands(time_ns)
        if self._switch is not None:
            self.manage_switch(time_ns)

    def finish_update(self, done: int, time_ns: int, period_s: float, failure: Exception | None = None) -> None:
        """Finish an `update` in which `done` controllers were updated. `failure`: the exception of the last of them."""
        if failure is not None:
            self._carry_on(done - 1, failure, time_ns, period_s)
        else:
            self._update_rest(done, time_ns, period_s)
        self._check_commands(time_ns)
        if self._switch is not None:
            self.manage_switch(time_ns)

    def _check_commands(self, time_ns: int) -> None:
        """Abort each controller with a command that is not finite: the world could not go on. Its joints get the
        commands that move them least, since a limit would remember the wrong one."""
        failed = []
        for entry, commands in self._commands:
            errors = [text for one in commands if entry.is_running and (text := one.error_text())]
            if errors:
                failed.append(entry)
                entry.fail(Refused(errors[0]), time_ns, "update")
                for one in commands:
                    if one.error_text():
                        one.rest()
        if failed:
            self._abort_chains(failed, time_ns)
            self._refresh()

    def _abort_chains(
        self, failed: Iterable[LoadedController], time_ns: int, starting: Collection[LoadedController] = ()
    ) -> None:
        """Abort the whole chains of controllers that have failed, as far as they run or are `starting`.

        A chain also ends for a controller that reads states of one in it, but such a reader ends no chain.
        """
        aborted = list(failed)
        for one in aborted:
            for entry in self._order:
                is_next = one in entry.needs or entry in one.writes_to
                if is_next and entry not in aborted and (entry.is_running or entry in starting):
                    entry.fail_with(one, time_ns)
                    aborted.append(entry)

    def manage_switch(self, time_ns: int) -> None:
        """Advance a pending switch by one cycle. For a paused simulation; `update` does it by itself."""
        switch = self._switch
        if switch is None:
            return
        ok = True
        with self._node.answering(switch.reasons):
            try:
                with watched_hardware(self._hw, self.known.code):
                    finished = switch.advance(self._hw, time_ns)
            except Refused as failure:
                self._node.log("fatal", described(failure))
                switch.give_up(time_ns)
                finished, ok = True, False
            starting = switch.start_request
            self._abort_chains([one for one in starting if one.is_aborted and switch.has_begun], time_ns, starting)
        self._refresh()
        if finished:
            self._switch = None
            switch.on_done(ok)

    def restart_running(self, time_ns: int) -> None:
        """Stop and start every running controller, one after the other."""
        running = sorted(self._running, key=lambda entry: entry.depth)  # starts each after those that it needs
        for entry in running:
            entry.enter_state(State.STOPPED, time_ns)
            if not entry.is_aborted:
                entry.start(time_ns)
        self._abort_chains([entry for entry in running if entry.is_aborted], time_ns)
        self._refresh()

    def stop_running(self, time_ns: int) -> None:
        """Stop every running controller, in the order of updates, because the robot is removed."""
        for entry in self._running:
            entry.enter_state(State.STOPPED, time_ns)
        self._refresh()

    def _carry_on(self, position: int, failure: Exception, time_ns: int, period_s: float) -> None:
        """Abort the controller at this position and update those after it."""
        failed = self._running[position]
        failed.fail(failure, time_ns, "update")
        self._abort_chains([failed], time_ns)
        self._update_rest(position + 1, time_ns, period_s)
        self._refresh()

    def _update_rest(self, done: int, time_ns: int, period_s: float) -> None:
        """Update the running controllers after the first `done`."""
        for entry in self._running[done:]:
            entry.update_if_running(time_ns, period_s)
            if entry.is_aborted:
                self._abort_chains([entry], time_ns)

    def _reorder(self) -> None:
        """Set the order of updates. It is called after each change of the loaded controllers."""
        self._order = _in_update_order(self._loaded.values())

    def _refresh(self) -> None:
        self._running = tuple(entry for entry in self._order if entry.is_running)
        self._hw.release_unclaimed([entry.info for entry in self._running])
        self._updates = tuple((entry.bare_update, entry.times) for entry in self._running)
        self._commands = tuple(
            (entry, commands)
            for entry in self._running
            if (commands := self._hw.commands_of(entry.info.claimed_resources))
        )
        found = [command for _, commands in self._commands for command in commands]
        self._commanded = tuple(command.handle for command in found if command.attribute == "command")
        self._further = tuple(command for command in found if command.attribute != "command")
        self.on_change()

    # Queries.

    @property
    def is_of_ros2(self) -> bool:
        """True for a robot with a `<ros2_control>` tag: the states of its controllers are those of ros2_control."""
        return self._hw.is_of_ros2

    @property
    def switching(self) -> bool:
        """True while an accepted switch is not finished: it waits for the next cycle, or for the hardware."""
        return self._switch is not None

    @property
    def running(self) -> tuple[LoadedController, ...]:
        """The running controllers, in the order of their updates. A change of these makes a new tuple."""
        return self._running

    def names(self) -> list[str]:
        """The names of all loaded controllers, in load order."""
        return list(self._loaded)

    def loaded(self) -> Sequence[tuple[str, str, Any]]:
        """Names, types and parameters with which all controllers were loaded, in load order."""
        return [(entry.name, entry.info.type, entry.loaded_with) for entry in self._loaded.values()]

    def get(self, name: str) -> ControllerBase | None:
        """The loaded controller of that name, else None."""
        entry = self._loaded.get(name)
        return entry.controller if entry is not None else None

    def list(self) -> ControllerStates:
        """All loaded controllers in the order of updates, each as controller_manager_msgs/ControllerState."""
        return [entry.message() for entry in self._order]

    def states(self) -> dict[str, str]:
        """Name -> state of all loaded controllers as clients see it, in load order."""
        return {entry.name: entry.shown_state for entry in self._loaded.values()}

    def components(self) -> Sequence[HardwareComponent]:
        """The hardware components of a robot of ROS 2."""
        return self._hw.components()

    @property
    def in_order(self) -> Sequence[LoadedController]:
        """All loaded controllers, in the order of updates."""
        return self._order

    def update_times(self) -> Messages:
        """The update times of all loaded controllers, in load order, each as slidectl/UpdateTimes."""
        return [entry.times.message() for entry in self._loaded.values()]

    def types(self) -> Names:
        """The controller types that can be loaded; for a robot of ROS 2, those that behave as in ros2_controllers."""
        return self.known.types_of_ros2() if self.is_of_ros2 else self.known.types()

    def base_classes(self) -> Names:
        """The base class of each of `types`."""
        return len(self.types()) * [registry.BASE_CLASS_OF_ROS2 if self.is_of_ros2 else registry.BASE_CLASS]

    # Loading.

    def load(self, name: str) -> bool:
        """Load and initialise the controller with the parameters `<node>/<name>`. False: refused, nothing remains."""
        try:
            self.load_again(name)
        except Exception as failure:
            return self._refuse(f"cannot load controller {quoted(name)}: {described(failure)}")
        return True

    def load_again(self, name: str) -> None:
        """As `load`, but raises the error."""
        if name in self._loaded:
            is_running = self._loaded[name].is_running
            verb = "configure" if not self._loaded[name].is_configured else "start"
            next_step = ", and running" if is_running else f"; {verb} it: slidectl controller {verb} {name}"
            raise Refused(f"it is loaded already{next_step}")
        self.check_new(name)
        self._loaded[name] = self._load(name)
        self._reorder()

    def check_new(self, name: str) -> None:
        """Raise Refused when a controller of that name is loaded, BadName when the name is not legal."""
        if name in self._loaded:
            raise Refused("it is loaded already")
        if not names.is_legal(name) or name.startswith("~"):
            raise BadName(name)

    def _load(self, name: str) -> LoadedController:
        node = self._node.child(name)
        try:
            type_name, for_ros2 = _type_of(node, self._hw.is_of_ros2)
            controller, code = self.known.create(type_name, for_ros2=for_ros2), self.known.code
            guard = CallbackGuard(type(controller), code, node) if is_of_a_user(type(controller)) else None
            node.guard = guard
            of_all = WatchedHandles(*self._hw.joint_handles(only_new=False), file_of(type(controller)))
            self._hw.joint_handles(only_new=True)
            with watched(type(controller), code, of_all):
                controller.init_request(self._hw, self._node, node)
        except BaseException as failure:
            node.shutdown()
            if isinstance(failure, UnknownResource) and failure.kind == JointStateInterface.kind:
                failure.hint = f"{failure.hint}\n{self._about(failure.name)}"
            raise
        node.guard_params(partial(self._judge, node, controller))
        handles, commands = self._hw.joint_handles(only_new=True)
        watch = None
        if guard is not None:
            watch = guard.handles = WatchedHandles(handles, commands, file_of(type(controller)))
        is_of_ros2 = self._hw.is_of_ros2
        read = sorted({handle.name for handle in handles}) if is_of_ros2 else ()
        states = [f"{joint}/{state}" for joint in read for state in JOINT_STATES]
        entry = LoadedController(
            name, type_name, controller, node, code, watch, is_of_ros2=is_of_ros2, states_read=states
        )
        of_others = {id(handle): (kind, one) for one in self._loaded.values() for kind, handle in one.exported()}
        used = [of_others[id(handle)] for handle in handles if id(handle) in of_others]
        entry.writes_to = tuple({one: None for kind, one in used if kind.claims})
        entry.reads_from = tuple({one: None for kind, one in used if not kind.claims})
        for kind, handle in entry.exported():
            handle.name = f"{name}/{handle.name}"
            self._hw.export(kind, handle)
        return entry

    def _judge(self, node: NodeHandle, controller: ControllerBase, change: ParameterChange) -> None:
        """Refuse a change that the controller cannot use. One of ROS 2 that does not run takes all when configured."""
        declared = controller.parameters
        if self._hw.is_of_ros2 and controller.state is not State.RUNNING:
            declared = tuple(replace(parameter, fixed=False) for parameter in declared)
        judge(node, declared, change)

    def _about(self, joint: str) -> str:
        """What to do about a joint that no controller can get."""
        owner, slash, _ = joint.rpartition("/")
        if not slash:
            return self._hw.about_joint(joint)
        if owner in self._loaded:
            names_there = list(dict.fromkeys(handle.name for _, handle in self._loaded[owner].exported()))
            return f"controller {quoted(owner)} exports: {listing(names_there)}"
        return f"{quoted(joint)} is of controller {quoted(owner)}: load it first: slidectl controller load {owner}"

    def _users_of(self, entry: LoadedController) -> Sequence[LoadedController]:
        """The loaded controllers that have handles of this one."""
        return [one for one in self._order if entry in one.needs]

    def _users_first(self) -> Sequence[str]:
        """The names of all controllers, each before those whose handles it has."""
        return [one.name for one in sorted(self._order, key=lambda one: -one.depth)]

    def _check_unused(self, entry: LoadedController) -> None:
        """Raise Refused when another controller has handles of this one."""
        if users := [one.name for one in self._users_of(entry)]:
            verb = "have" if len(users) > 1 else "has"
            hint = f"unload before it: slidectl controller unload {' '.join(users)}"
            raise Refused(f"{listing(map(quoted, users))} {verb} interfaces of it", hint)

    def _shut_down(self, entry: LoadedController) -> None:
        """End its topics, services and exported handles."""
        self._hw.withdraw(handle.name for _, handle in entry.exported())
        entry.node.shutdown()

    def configure(self, name: str) -> bool:
        """Make a controller of a robot of ROS 2 `inactive`, so that it can start. Its parameters count as they are now.

        False: it is not loaded, it runs, a switch is pending, or it cannot be loaded with its parameters.
        """
        entry = self._idle(name, "configure")
        if entry is None:
            return False
        has_changed = entry.loaded_with != entry.node.get_param(entry.node.namespace, None)
        if has_changed or (entry.is_configured and not self._users_of(entry)):
            try:
                self._check_unused(entry)
                self._clean_up(entry)
                self._shut_down(entry)
                entry = self._loaded[name] = self._load(name)  # an existing key keeps its place in the order
            except Exception as failure:
                return self._refuse(f"cannot configure controller {quoted(name)}: {described(failure)}")
            self._reorder()
        entry.is_configured = True
        return True

    def clean_up(self, name: str) -> bool:
        """Make a controller of a robot of ROS 2 `unconfigured`. False: it is not loaded, it runs, or a switch is
        pending."""
        entry = self._idle(name, "clean up")
        if entry is not None and entry.is_configured:
            self._clean_up(entry)
        return entry is not None

    def _clean_up(self, entry: LoadedController) -> None:
        entry.is_configured = False
        if not self._users_of(entry):
            entry.loaded_with = None

    def _idle(self, name: str, verb: str) -> LoadedController | None:
        """The controller of that name, unless it runs or a switch is pending. Logs why it is None."""
        entry = self._loaded.get(name)
        if entry is None:
            self._refuse(f"cannot {verb}: {described(not_loaded(self._loaded, name, verb, self._node))}")
        elif self._switch is not None:
            self._refuse(f"cannot {verb} controller {quoted(name)}: a switch is in progress")
        elif entry.is_running:
            hint = f"deactivate it first: slidectl controller stop {name}"
            self._refuse(f"cannot {verb} controller {quoted(name)}: it is active; {hint}")
        else:
            return entry
        return None

    def unload(self, name: str) -> bool:
        """Remove a controller that is not running. False: it runs, it is not loaded, or a switch is pending."""
        entry = self._loaded.get(name)
        if entry is None:
            return self._refuse(f"cannot unload: {described(UnknownName('controller', name, self.names()))}")
        if self._switch is not None:
            return self._refuse(f"cannot unload controller {quoted(name)}: a switch is in progress")
        if entry.is_running:
            return self._refuse(f"cannot unload controller {quoted(name)}: it is running; stop it first")
        try:
            self._check_unused(entry)
        except Refused as refusal:
            return self._refuse(f"cannot unload controller {quoted(name)}: {described(refusal)}")
        del self._loaded[name]
        self._reorder()
        self._shut_down(entry)
        return True

    def renew(self, name: str) -> State:
        """Import the file of a loaded controller's class again, for `exchange`. Returns the controller's state.

        Raises:
            Refused: it is not loaded. SlidectlError: as `ControllerTypes.renewed`; nothing has changed.
        """
        entry = self._loaded.get(name)
        if entry is None:
            hint = f"load it: slidectl controller load {name}"
            raise Refused(f"cannot reload controller {quoted(name)}: it is not loaded", hint)
        try:
            self._check_unused(entry)
        except Refused as refusal:
            raise Refused(f"cannot reload controller {quoted(name)}: {refusal}", refusal.hint) from None
        self.known.renewed(type(entry.controller))
        return entry.state

    def failure_of(self, name: str) -> str:
        """The message of the exception that aborted a controller since its last start; empty: none."""
        return self._loaded[name].failure if name in self._loaded else ""

    def exchange(self, name: str) -> bool:
        """Replace a stopped controller with a new one of the class that its type means now. The load order stays.

        False: the new class cannot be loaded, so the former class is loaded again.
        """
        entry = self._loaded[name]
        if entry.is_running:
            return self._refuse(f"cannot reload controller {quoted(name)}: it is still running")
        former, is_configured = type(entry.controller), entry.is_configured
        self._shut_down(entry)
        try:
            self._loaded[name] = self._load(name)  # an existing key keeps its place in the order
            self._loaded[name].is_configured = is_configured
        except Exception as failure:
            text = f"cannot load controller {quoted(name)} from its edited file: {described(failure)}"
            self.known.restore(former)
        else:
            self._reorder()
            return True
        try:
            self._loaded[name] = self._load(name)
            self._loaded[name].is_configured = is_configured
        except Exception:
            del self._loaded[name]
            self._reorder()
            return self._refuse(f"{text}; nor can the former class be loaded again")
        self._reorder()
        return self._refuse(f"{text}; the former class is loaded again")

    def save_state(self) -> dict[str, Any]:
        """The state of the controllers for a snapshot, in load order."""
        entries = self._loaded.items()
        return {
            "controllers": {name: entry.controller for name, entry in entries},
            "states": {name: entry.state for name, entry in entries},
            "failures": {name: entry.failure for name, entry in entries},
            "configured": [name for name, entry in entries if entry.is_configured],
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore states and failures. The controllers' own attributes are already restored."""
        for name, entry in self._loaded.items():
            entry.controller.state, entry.failure = state["states"][name], state["failures"][name]
            entry.is_configured = name in state["configured"]
        running = [entry for entry in self._order if entry.is_running]
        for entry in running:
            if entry.controller.exported_references:
                entry.controller.is_chained = any(entry in one.writes_to for one in running)
        if running != list(self._running):
            self._refresh()

    def keep_only(self, kept: Sequence[str]) -> None:
        """Stop and unload all controllers but these."""
        gone = [entry for name, entry in self._loaded.items() if name not in kept]
        for entry in sorted(gone, key=lambda one: -one.depth):
            if entry.is_running:
                entry.enter_state(State.STOPPED, self._node.now_ns())
        self._refresh()
        for entry in reversed(gone):
            self.unload(entry.name)

    def reload_libraries(self, force_kill: bool) -> bool:
        """Prepare a reload of libraries, for which all controllers are unloaded. Registered classes stay.

        Refused without `force_kill` while controllers are loaded; for a robot of ROS 2, while controllers run.
        """
        in_the_way = len(self._running if self.is_of_ros2 else self._loaded)
        if in_the_way and not force_kill:
            are = "active" if self.is_of_ros2 else "loaded"
            return self._refuse(f"cannot reload while {in_the_way} controllers are {are}; unload them, or force it")
        if self._loaded:
            self._node.log("info", f"stopping and unloading {len(self._loaded)} controllers")
            is_stopped = self.request_switch([], self.names(), BEST_EFFORT)
            if is_stopped:
                self.manage_switch(self._node.now_ns())
            if not is_stopped or not all(map(self.unload, self._users_first())):
                return self._refuse("cannot reload: the controllers could not be stopped and unloaded")
        self._node.log("info", f"searched again for controllers of {registry.BASE_CLASS}")
        return True

    def fail(self, name: str, failure: Exception) -> bool:
        """Abort a running controller as if its update had raised `failure`. False: no controller of that name runs."""
        entry = self._loaded.get(name)
        if entry is None or not entry.is_running:
            return False
        entry.fail(failure, self._node.now_ns())
        self._abort_chains([entry], self._node.now_ns())
        self._refresh()
        return True

    def kill(self, name: str) -> bool:
        """Stop a controller at once and unload it, and before it those that have handles of it. False: it is not
        loaded, or a switch is pending."""
        entry = self._loaded.get(name)
        if entry is None or self._switch is not None:
            return False
        for user in self._users_of(entry):
            self.kill(user.name)
        if entry.is_running:
            entry.enter_state(State.STOPPED, self._node.now_ns())
            self._refresh()
        return self.unload(name)

    # Switching.

    def request_switch(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int,
        start_asap: bool = False,
        timeout_s: float = 0.0,
        on_done: Callable[[bool], None] = lambda _: None,
    ) -> bool:
        """Accept a switch, carried out at the end of the next cycle. False: refused, nothing changes.

        `on_done(True)` is called when it is finished, even if a controller to start was aborted; `on_done(False)` when
        the hardware failed. `timeout_s` is the simulated time for the hardware to become ready; 0: no limit.
        """
        node, is_strict = self._node, strictness == STRICT
        try:
            if self._switch is not None:
                raise Refused("another switch is in progress")
            if strictness not in (BEST_EFFORT, STRICT):
                text = f"strictness {strictness} is neither BEST_EFFORT (1) nor STRICT (2); BEST_EFFORT is used"
                node.log("warn", text)
            to_stop = known(self._loaded, stop, "stop", is_strict, node)
            to_start = known(self._loaded, start, "start", is_strict, node)
            switch = Switch(to_start, to_stop, start_asap, timeout_s, node.now_ns(), on_done, node.reasons)
            switch.check_chains(self._loaded.values(), is_strict, node)
            switch.plan(self._loaded.values(), is_strict)
            switch.plan_chains(self._loaded.values())
            conflicts = self._hw.check_for_conflict(switch.running)
            if conflicts:
                for conflict in conflicts:
                    node.log("warn", f"resource conflict: {conflict}")
                text = f"resource conflict: {'; '.join(map(str, conflicts))}"
                raise Refused(text + way_out(conflicts, {info.name for info in switch.start}))
            with watched_hardware(self._hw, self.known.code):
                is_possible = self._hw.prepare_switch(switch.start, switch.stop)
            if not is_possible:
                raise Refused("the hardware cannot run this combination of controllers")
        except SlidectlError as refusal:
            return self._refuse(f"cannot switch controllers: {described(refusal)}")
        self._switch = switch
        return True

    def _refuse(self, reason: str) -> bool:
        self._node.log("error", reason)
        return False


def _type_of(node: NodeHandle, for_ros2: bool) -> tuple[str, bool]:
    """The parameter `type`, and whether the controller is one of ros2_controllers.

    Raises Refused: it is not set, or is a type of ROS 2 that is not here.
    """
    type_name = node.get_param("type", None)
    if not isinstance(type_name, str):
        hint = "load its configuration first: slidectl controller config FILE.yaml"
        raise Refused(f"parameter {names.join(node.namespace, 'type')} is not set", hint)
    values = node.get_param(node.namespace, {})
    is_of_ros2 = registry.is_of_ros2(type_name, values, for_ros2)
    if not is_of_ros2:
        refuse_others(type_name, values)
    return type_name, is_of_ros2
