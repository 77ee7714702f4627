"""The controller manager: loads, lists, switches and unloads the controllers of one robot, and updates them.

After ros_control's controller_manager. All calls come from one thread, between two cycles or (`update`) in one.
The service names around it, and waiting for an answer, are others' business.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from slidectl import names
from slidectl.control.controller import ControllerBase
from slidectl.control.loaded import LoadedController, described
from slidectl.control.node import NodeHandle
from slidectl.control.parameters import Guard
from slidectl.control.registry import ControllerLoader, RegistryLoader, UnknownType
from slidectl.control.robot_hw import RobotHW
from slidectl.control.switching import BEST_EFFORT, STRICT, Switch, plan_switch
from slidectl.errors import BadName, Refused, SlidectlError, UnknownName, quoted

Names = list[str]


def _nothing(_ok: bool) -> None:
    """For whoever does not wait for the end of a switch."""


class ControllerManager:
    """The controllers of one robot in load order. Refusals are logged as errors and answered with False."""

    def __init__(self, hw: RobotHW, node: NodeHandle) -> None:
        """`node` is the robot's namespace: a controller's parameters and topics are below `<node>/<name>`."""
        self._hw = hw
        self._node = node
        self._loaders: list[ControllerLoader] = [RegistryLoader()]
        self._loaded: dict[str, LoadedController] = {}
        self._running: tuple[LoadedController, ...] = ()
        self._updates: tuple[Callable[[int, float], None], ...] = ()
        self._switch: Switch | None = None

    # The cycle.

    def update(self, time_ns: int, period_s: float, reset_controllers: bool = False) -> None:
        """One cycle: update every running controller in load order, then carry on with a pending switch.

        A controller that starts in this cycle has its first update in the next one. `reset_controllers` stops
        and starts all running ones first.
        """
        if reset_controllers:
            self.restart_running(time_ns)
        try:
            for update in self._updates:
                update(time_ns, period_s)
        except Exception as failure:
            self._carry_on(self._updates.index(update), failure, time_ns, period_s)
        if self._switch is not None:
            self.manage_switch(time_ns)

    def finish_update(self, done: int, time_ns: int, period_s: float, failure: Exception | None = None) -> None:
        """The rest of an `update` in which `done` controllers had their turn; the last of them failed so, if at all."""
        if failure is not None:
            self._carry_on(done - 1, failure, time_ns, period_s)
        else:
            for entry in self._running[done:]:
                entry.update(time_ns, period_s)
        if self._switch is not None:
            self.manage_switch(time_ns)

    def manage_switch(self, time_ns: int) -> None:
        """Carry a pending switch one cycle further. For a world that stands still; `update` does it by itself."""
        switch = self._switch
        if switch is None:
            return
        with self._node.answering(switch.reasons):
            finished = switch.advance(self._hw, time_ns)
        self._refresh()
        if finished:
            self._switch = None
            switch.on_done(True)

    def restart_running(self, time_ns: int) -> None:
        """Stop and start every running controller, one after the other."""
        for entry in self._running:
            entry.stop(time_ns)
            if not entry.is_aborted:
                entry.start(time_ns)
        self._refresh()

    def stop_running(self, time_ns: int) -> None:
        """Stop every running controller, in load order, because the robot goes."""
        for entry in self._running:
            entry.stop(time_ns)
        self._refresh()

    def _carry_on(self, position: int, failure: Exception, time_ns: int, period_s: float) -> None:
        """Abort the controller at this position and update those after it."""
        running = self._running
        running[position].fail(failure, time_ns)
        for entry in running[position + 1 :]:
            entry.update(time_ns, period_s)
        self._refresh()

    def _refresh(self) -> None:
        self._running = tuple(entry for entry in self._loaded.values() if entry.is_running)
        self._updates = tuple(entry.controller.update for entry in self._running)

    # What is there.

    @property
    def switching(self) -> bool:
        """True while an accepted switch waits for its cycle, or for the hardware."""
        return self._switch is not None

    @property
    def running_count(self) -> int:
        """The number of running controllers."""
        return len(self._running)

    @property
    def updates(self) -> tuple[Callable[[int, float], None], ...]:
        """`update` of each running controller, in order: another tuple whenever these are others."""
        return self._updates

    def names(self) -> list[str]:
        """The names of all loaded controllers, in load order."""
        return list(self._loaded)

    def get(self, name: str) -> ControllerBase | None:
        """The loaded controller of that name, else None."""
        entry = self._loaded.get(name)
        return entry.controller if entry is not None else None

    def list(self) -> list[dict[str, Any]]:
        """All loaded controllers in load order, each as controller_manager_msgs/ControllerState."""
        return [entry.message() for entry in self._loaded.values()]

    def types(self) -> Names:
        """The controller types that can be loaded."""
        return [type_name for loader in self._loaders for type_name in loader.types()]

    def base_classes(self) -> Names:
        """The base class of each of `types`."""
        return [loader.base_class for loader in self._loaders for _ in loader.types()]

    def register_loader(self, loader: ControllerLoader) -> None:
        """Ask this loader too, after those that are there."""
        self._loaders.append(loader)

    # Loading.

    def load(self, name: str) -> bool:
        """Load and initialise the controller that `<node>/<name>` describes. False: refused, nothing is left."""
        try:
            self._loaded[name] = self._load(name)
        except Exception as failure:
            return self._refuse(f"cannot load controller {quoted(name)}: {described(failure)}")
        return True

    def _load(self, name: str) -> LoadedController:
        if name in self._loaded:
            raise Refused("it is loaded already")
        if not names.is_legal(name) or name.startswith("~"):
            raise BadName(name)
        node = self._node.child(name)
        try:
            type_name = _type_of(node)
            controller = self._create(type_name)
            controller.init_request(self._hw, self._node, node)
        except BaseException:
            node.shutdown()
            raise
        node.guard_params(Guard(node, controller.parameters).judge)
        return LoadedController(name, type_name, controller, node)

    def _create(self, type_name: str) -> ControllerBase:
        for loader in self._loaders:
            if type_name in loader.types():
                return loader.create(type_name)
        raise UnknownType(type_name, self.types())

    def unload(self, name: str) -> bool:
        """Remove a controller that is not running. False: it is running, or there is none of that name."""
        entry = self._loaded.get(name)
        if entry is None:
            return self._refuse(f"cannot unload: {described(UnknownName('controller', name, self.names()))}")
        if self._switch is not None:
            return self._refuse(f"cannot unload controller {quoted(name)}: a switch is under way")
        if entry.is_running:
            return self._refuse(f"cannot unload controller {quoted(name)}: it is running; stop it first")
        del self._loaded[name]
        entry.node.shutdown()
        return True

    def reload_libraries(self, force_kill: bool) -> bool:
        """Let the loaders look anew. Loaded controllers are in the way: they are killed, or it is refused."""
        if self._loaded and not force_kill:
            return self._refuse(
                f"cannot reload while {len(self._loaded)} controllers are loaded; unload them, or force it"
            )
        if self._loaded and not self._kill_all():
            return self._refuse("cannot reload: the controllers could not be stopped and unloaded")
        for loader in self._loaders:
            loader.reload()
            self._node.log("info", f"looked anew for controllers of {loader.base_class}")
        return True

    def _kill_all(self) -> bool:
        self._node.log("info", f"stopping and unloading {len(self._loaded)} controllers")
        if not self.request_switch([], self.names(), BEST_EFFORT):
            return False
        self.manage_switch(self._node.now_ns())
        return all(self.unload(name) for name in self.names())

    # Switching.

    def request_switch(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int,
        start_asap: bool = False,
        timeout_s: float = 0.0,
        on_done: Callable[[bool], None] = _nothing,
    ) -> bool:
        """Arm a switch, to be carried out at the end of the next cycle. False: refused, nothing changes.

        `on_done(True)` follows when it is finished, even if what should start was aborted. `timeout_s` is simulated
        time that the hardware has to get ready; 0 is for ever.
        """
        try:
            self._switch = self._armed(start, stop, strictness, start_asap, timeout_s, on_done)
        except SlidectlError as refusal:
            return self._refuse(f"cannot switch controllers: {described(refusal)}")
        return True

    def _armed(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int,
        asap: bool,
        timeout_s: float,
        on_done: Callable[[bool], None],
    ) -> Switch:
        if self._switch is not None:
            raise Refused("another switch is under way")
        if strictness == 0:
            self._node.log(
                "warn", "a switch should say its strictness, BEST_EFFORT (1) or STRICT (2); this one is BEST_EFFORT"
            )
        elif strictness not in (BEST_EFFORT, STRICT):
            self._node.log(
                "warn", f"strictness {strictness} is neither BEST_EFFORT (1) nor STRICT (2); it counts as BEST_EFFORT"
            )
        plan = plan_switch(self._loaded, start, stop, strict=strictness == STRICT, node=self._node)
        conflicts = self._hw.check_for_conflict(plan.running)
        if conflicts:
            for conflict in conflicts:
                self._node.log("warn", f"resource conflict: {conflict}")
            raise Refused(f"resource conflict: {'; '.join(map(str, conflicts))}")
        if not self._hw.prepare_switch(plan.start, plan.stop):
            raise Refused("the hardware cannot run this combination of controllers")
        switch = Switch(plan, asap=asap, timeout_s=timeout_s, init_time_ns=self._node.now_ns(), on_done=on_done)
        switch.reasons = self._node.reasons
        return switch

    def _refuse(self, reason: str) -> bool:
        self._node.log("error", reason)
        return False


def _type_of(node: NodeHandle) -> str:
    type_name = node.get_param("type", None)
    if not isinstance(type_name, str):
        where = names.join(node.namespace, "type")
        raise Refused(
            f"parameter {where} is not set", "load its configuration first: slidectl controller config FILE.yaml"
        )
    return type_name
