"""The six services of a robot's controller manager, handled in the same order as in ros_control.

A seventh, `switch_controllers`, is the switch with the field names of ros2_control. A robot of ROS 2 has further ones
(Ros2ManagerServices).

While a switch is armed, all requests wait in a queue, as they do at the manager's mutex. When the world stands still
the switch is finished at once, at the present time; ros_control would hang.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from slidectl.control.controller_interface import State
from slidectl.control.controller_manager import BEST_EFFORT, STRICT
from slidectl.control.duration import header_of, to_seconds
from slidectl.control.node_handle import Message, Reasons
from slidectl.effects import Effect
from slidectl.errors import Reason, Refused, SlidectlError, UnknownName, listing, quoted
from slidectl.msgs.schema import nanoseconds
from slidectl.simulation.clock import Timer
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.control.controller_manager import ControllerManager
    from slidectl.control.hardware_interface import HardwareComponent
    from slidectl.simulation.graph import GraphNode
    from slidectl.simulation.loop import Loop

Act = Callable[[Message, Pending], Message | None]
"""Handles a request. Returns the response, or None when the answer is resolved at the end of a switch."""


class ManagerServices:
    """`/<ns>/controller_manager/*` for one manager.

    Args:
        read_joints: reads the joints outside of a cycle, for controllers that start then.
        loop: knows whether a cycle will come without a request.
    """

    def __init__(
        self, manager: ControllerManager, node: GraphNode, read_joints: Callable[[], None], loop: Loop
    ) -> None:
        self._manager = manager
        self._node = node
        self._read_joints = read_joints
        self._loop = loop
        self._queue: deque[tuple[Act, Message, Pending, Reasons | None]] = deque()
        self._switch: Pending | None = None
        self._after_update: dict[Callable[[], None], Timer] = {}
        """Callbacks for the first update of a controller, with timers."""
        acts: dict[str, tuple[str, Act]] = {
            "list_controllers": ("ListControllers", lambda *_: {"controller": manager.list()}),
            "list_controller_types": (
                "ListControllerTypes",
                lambda *_: {"types": manager.types(), "base_classes": manager.base_classes()},
            ),
            "load_controller": ("LoadController", lambda request, _: {"ok": manager.load(request["name"])}),
            "unload_controller": ("UnloadController", lambda request, _: {"ok": manager.unload(request["name"])}),
            "reload_controller_libraries": (
                "ReloadControllerLibraries",
                lambda request, _: {"ok": manager.reload_libraries(request["force_kill"])},
            ),
            "switch_controller": ("SwitchController", self._start_switch),
        }
        self._own_node = node.child("controller_manager")
        self._advertise("controller_manager_msgs", acts)
        self._own_node.advertise_service("switch_controllers", "slidectl/SwitchControllers", self._switch_as_in_ros2)

    def _advertise(self, package: str, acts: Mapping[str, tuple[str, Act]]) -> None:
        for name, (kind, act) in acts.items():
            effect = Effect.READS if name.startswith("list_") else Effect.WRITES
            self._own_node.advertise_service(name, f"{package}/{kind}", partial(self._enqueue, act), effect)

    def settle(self) -> None:
        """Finish an armed switch and all waits for a first update now, because the world has stopped."""
        for finish in tuple(self._after_update):
            finish()
        if self._switch is not None and self._manager.switching:
            self._read_joints()
            self._manager.manage_switch(self._node.now_ns())

    @property
    def is_busy(self) -> bool:
        """True while a switch or a wait for a controller's first update is open."""
        return self._switch is not None or bool(self._queue or self._after_update)

    def load_file(self, name: str, file: str, class_name: str) -> Pending:
        """Load a user's class from a file under a name; its type becomes the controller's parameter `type`.

        Answered with `ok`. On failure nothing changes. Raises as `ControllerTypes.add_file`, and when the name is not
        free.
        """

        def load(_request: Message, _pending: Pending) -> Message:
            manager, node = self._manager, self._node
            try:
                manager.check_new(name)
            except Refused as error:
                raise Refused(
                    f"cannot load controller {name!r}: {error}", f"slidectl controller reload {name}"
                ) from None
            type_name = manager.known.add_file(file, class_name)
            parameter = f"{name}/type"
            before = node.get_param(parameter, None)
            node.set_param(parameter, type_name)
            ok = manager.load(name)
            if not ok and before is not None:
                node.set_param(parameter, before)
            elif not ok:
                node.delete_param(parameter)
            return {"ok": ok}

        return self._enqueue(load, {})

    def reload(self, name: str, control_period_ns: int) -> Pending:
        """Load the present content of a controller's file: stop the controller if it runs, replace it, start it again.

        An aborted controller is started too. Name, parameters and place in the order of updates stay. Answered with
        `ok` after the first update, or at once when the world stands still. Raises as `ControllerTypes.renewed`, and
        then nothing changes; when the new class fails to load, the old controller goes on.
        """
        manager = self._manager
        if self._switch is not None:
            raise Refused(f"cannot reload controller {name!r}: a switch is under way")
        state = manager.renew(name)
        acts: list[tuple[Act, Message]] = [(lambda *_: {"ok": manager.exchange(name)}, {})]
        strict = {"start_asap": False, "timeout": 0.0, "strictness": STRICT}
        if state is State.RUNNING:
            acts.insert(0, (self._start_switch, {**strict, "start_controllers": [], "stop_controllers": [name]}))
        if state in (State.RUNNING, State.ABORTED):
            acts.append((self._start_switch, {**strict, "start_controllers": [name], "stop_controllers": []}))
            acts.append((partial(self._see_update, name, control_period_ns), {}))
        answers = [self._enqueue(act, request) for act, request in acts]
        return answers[-1].converted(lambda _: {"ok": all(answer.result()["ok"] for answer in answers)})

    def _see_update(self, name: str, control_period_ns: int, _request: Message, answer: Pending) -> None:
        """Resolve `answer` after the first update of a started controller: `ok` is False when it aborted in it."""
        reasons = self._node.reasons

        def finish() -> None:
            timer = self._after_update.pop(finish)
            timer.cancel()
            failure = self._manager.failure_of(name)
            if failure and reasons is not None and failure not in reasons:
                reasons.append(Reason(failure))
            answer.resolve({"ok": not failure})

        self._after_update[finish] = self._loop.graph.timers.after(control_period_ns + self._loop.step_ns, finish)
        if self._loop.stands_still:
            finish()

    def _enqueue(self, act: Act, request: Message) -> Pending:
        pending = Pending()
        self._queue.append((act, request, pending, self._node.reasons))
        self._work()
        return pending

    def _work(self) -> None:
        """Handle queued requests, up to the next switch that needs a cycle."""
        while self._queue and self._switch is None:
            act, request, pending, reasons = self._queue.popleft()
            if pending.cancelled:
                continue
            with self._node.answering(reasons):  # it may have waited for the switch of another request
                self._node.before_entry()  # brings the robot's objects up to date
                try:
                    response = act(request, pending)
                except SlidectlError as error:
                    self._switch = None
                    pending.reject(error)
                else:
                    if response is not None:
                        pending.resolve(response)

    def _switch_as_in_ros2(self, request: Message) -> Pending:
        """Switch controllers by a request with the field names of ros2_control."""
        reasons = self._node.reasons
        return self._enqueue(self._start_switch, as_in_ros1(request)).converted(
            lambda done: {**done.result(), "message": "\n".join(reasons or ())}
        )

    def _start_switch(self, request: Message, answer: Pending) -> Message | None:
        def finish(ok: bool) -> None:
            self._switch = None
            answer.resolve({"ok": ok})
            self._work()

        self._switch = answer
        armed = self._manager.request_switch(
            request["start_controllers"],
            request["stop_controllers"],
            request["strictness"],
            request["start_asap"],
            request["timeout"],
            lambda ok: self._loop.after_cycle(partial(finish, ok)),
        )
        if not armed:
            self._switch = None
            return {"ok": False}
        if self._loop.stands_still:
            self.settle()
        return None


STATE_IDS = {"unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}
"""States of ros2_control -> their numbers in lifecycle_msgs/State."""
_DEFAULT_STRICTNESS = "controller_manager/defaults/switch_controller/strictness"
_STRICTNESS = {"strict": STRICT, "best_effort": BEST_EFFORT}
_DEFAULT_TIMEOUT_S = 1.0


def as_in_ros1(request: Message) -> Message:
    """The request of slidectl/SwitchControllers as that of controller_manager_msgs/SwitchController."""
    return {
        "start_controllers": request["activate_controllers"],
        "stop_controllers": request["deactivate_controllers"],
        "strictness": request["strictness"],
        "start_asap": request["activate_asap"],
        "timeout": to_seconds(nanoseconds(request["timeout"])),
    }


def lifecycle_state(label: str) -> Message:
    """A state as slidectl/LifecycleState."""
    return {"id": STATE_IDS.get(label, 0), "label": label}


class Ros2ManagerServices(ManagerServices):
    """The services of the manager of a robot of ROS 2: those of a ManagerServices, and those that ros2_control adds.

    The latter have slidectl's own types, with the fields of ros2_control. `controller_states` is the `list_controllers`
    of ros2_control, since one name has one type.
    """

    def __init__(
        self, manager: ControllerManager, node: GraphNode, read_joints: Callable[[], None], loop: Loop, rate_hz: int
    ) -> None:
        """`rate_hz`: how often the controllers are updated. The others are those of ManagerServices."""
        super().__init__(manager, node, read_joints, loop)
        self._rate_hz = rate_hz
        acts: dict[str, tuple[str, Act]] = {
            "configure_controller": (
                "ConfigureController",
                lambda request, _: {"ok": manager.configure(request["name"])},
            ),
            "cleanup_controller": ("CleanupController", lambda request, _: {"ok": manager.clean_up(request["name"])}),
            "list_hardware_components": ("ListHardwareComponents", lambda *_: {"component": self._components()}),
            "list_hardware_interfaces": ("ListHardwareInterfaces", lambda *_: self._all_interfaces()),
            "set_hardware_component_state": ("SetHardwareComponentState", self._set_component_state),
        }
        self._advertise("slidectl", acts)
        self._own_node.advertise_service(
            "controller_states",
            "slidectl/ListControllers",
            partial(self._enqueue, lambda *_: {"controller": manager.list_as_in_ros2(rate_hz)}),
            Effect.READS,
        )
        self._activity = self._own_node.advertise("activity", "slidectl/ControllerManagerActivity", latch=True)
        self._shown: dict[str, str] | None = None
        """The states of the controllers in the last message of `activity`."""
        manager.on_change = self._publish_activity
        self._publish_activity()

    def _work(self) -> None:
        super()._work()
        self._publish_activity()

    def _publish_activity(self) -> None:
        states = self._manager.states()
        if states == self._shown:
            return
        self._shown = states
        parts = {one.name: "active" for one in self._manager.components()}
        self._activity.publish(
            {
                "header": header_of(self._node.now_ns()),
                "controllers": [{"name": name, "state": lifecycle_state(state)} for name, state in states.items()],
                "hardware_components": [{"name": name, "state": lifecycle_state(at)} for name, at in parts.items()],
            }
        )

    # Switching, with the defaults and the answers of ros2_control.

    def _switch_as_in_ros2(self, request: Message) -> Pending:
        asked = as_in_ros1(request)
        if not asked["strictness"]:
            default = self._node.get_param(_DEFAULT_STRICTNESS, "strict")
            asked["strictness"] = _STRICTNESS.get(str(default), STRICT)
        asked["timeout"] = asked["timeout"] or _DEFAULT_TIMEOUT_S
        reasons = self._node.reasons
        return self._enqueue(self._switch_if_needed, asked).converted(
            lambda done: self._verdict(asked, done.result(), reasons or [])
        )

    def _switch_if_needed(self, request: Message, answer: Pending) -> Message | None:
        """As `_start_switch`, but true without a switch when no controller has to change its state."""
        states = self._manager.states()
        start, stop = request["start_controllers"], request["stop_controllers"]
        if request["strictness"] == STRICT:
            return self._start_switch(request, answer) if start or stop else {"ok": True}
        for verb, wanted in (("deactivate", stop), ("activate", start)):
            if wanted and not any(name in states for name in wanted):
                known = f"loaded are {listing(states)}" if states else "no controller is loaded"
                text = f"cannot {verb} {', '.join(map(quoted, wanted))}: none of them is loaded; {known}"
                self._node.log("error", text)
                return {"ok": False}
        if any(states.get(name) == "active" for name in stop) or any(states.get(name) == "inactive" for name in start):
            return self._start_switch(request, answer)
        for verb, wanted in (("deactivate", stop), ("activate", start)):
            for name in wanted:
                self._node.log(
                    "warn", f"cannot {verb} controller {quoted(name)}: it is {states.get(name, 'not loaded')}"
                )
        return {"ok": True}

    def _verdict(self, request: Message, response: Message, reasons: Sequence[str]) -> Message:
        """The response of ros2_control to a switch: false when a controller did not get into its state.

        A strict switch then stops again what it has started.
        """
        states, is_strict = self._manager.states(), request["strictness"] == STRICT
        start = [name for name in request["start_controllers"] if name in states]
        stop = [name for name in request["stop_controllers"] if name in states]
        if not response["ok"]:
            return {"ok": False, "message": "\n".join(("the controllers are not switched", *reasons))}
        failed = [name for name in start if states[name] == "inactive" and name not in stop]
        remaining = [name for name in stop if states[name] == "active" and name not in start]
        lines = [f"not activated: {', '.join(failed)}"] if failed else []
        lines += [f"not deactivated: {', '.join(remaining)}"] if remaining else []
        if lines:
            started = [name for name in start if states[name] == "active"]
            if is_strict and started:
                stops = {**request, "start_controllers": [], "stop_controllers": started, "strictness": BEST_EFFORT}
                self._enqueue(self._start_switch, stops)
            return {"ok": False, "message": "\n".join(("the controllers are not all switched", *lines, *reasons))}
        if not is_strict:
            lines += [f"deactivated: {', '.join(name for name in stop if states[name] == 'inactive')}"] if stop else []
            lines += [f"activated: {', '.join(name for name in start if states[name] == 'active')}"] if start else []
        return {"ok": True, "message": "\n".join(("the controllers are switched", *lines, *reasons))}

    # Hardware.

    def _components(self) -> list[Message]:
        """The components, each as slidectl/HardwareComponentState. A simulated one is always active."""
        return [
            {
                "name": one.name,
                "type": one.kind,
                "rw_rate": self._rate_hz,
                "plugin_name": one.plugin,
                "state": lifecycle_state("active"),
                **self._interfaces([one]),
            }
            for one in self._manager.components()
        ]

    def _all_interfaces(self) -> Message:
        """The interfaces of the hardware and of controllers; those of a controller are available while it runs."""
        found, claimed = self._interfaces(self._manager.components()), self._manager.claimed_commands()
        for entry in self._manager.exporting():
            for kind, exported in (
                ("command_interfaces", entry.references()),
                ("state_interfaces", entry.shown_states()),
            ):
                for name in (f"{entry.name}/{each}" for each in exported):
                    is_claimed = kind == "command_interfaces" and name in claimed
                    one = {"name": name, "data_type": "double", "is_available": entry.is_running}
                    found[kind].append({**one, "is_claimed": is_claimed})
        return {kind: sorted(listed, key=lambda one: str(one["name"])) for kind, listed in found.items()}

    def _interfaces(self, components: Sequence[HardwareComponent]) -> Message:
        """The interfaces of components, by name, each as slidectl/HardwareInterface."""
        claimed = self._manager.claimed_commands()
        commands = sorted({name for one in components for name in one.command_interfaces})
        states = sorted({name for one in components for name in one.state_interfaces})
        always = {"data_type": "double", "is_available": True}
        return {
            "command_interfaces": [{"name": name, "is_claimed": name in claimed, **always} for name in commands],
            "state_interfaces": [{"name": name, "is_claimed": False, **always} for name in states],
        }

    def _set_component_state(self, request: Message, _: Pending) -> Message:
        known, name = [one.name for one in self._manager.components()], request["name"]
        if name not in known:
            self._node.log("error", str(UnknownName("hardware component", name, known)))
            return {"ok": False, "state": lifecycle_state("")}
        target, labels = request["target_state"], {number: label for label, number in STATE_IDS.items()}
        label = labels.get(target["id"], str(target["id"])) if target["id"] else target["label"]
        if label != "active":
            text = (
                f"hardware component {quoted(name)} cannot become {quoted(label)}: simulated hardware is always active"
            )
            self._node.log("error", text)
        return {"ok": label == "active", "state": lifecycle_state("active")}
