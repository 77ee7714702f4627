"""The services of the controller manager of a robot of ROS 2: configure, hardware, switching, states in its words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from slidectl.control.controller_switch import BEST_EFFORT, STRICT
from slidectl.control.duration import header_of
from slidectl.control.hardware_interface import JOINT_STATES, HardwareComponent
from slidectl.control.node_handle import Message
from slidectl.description import interfaces
from slidectl.effects import Effect
from slidectl.errors import UnknownName, listing, quoted
from slidectl.simulation.manager_services import Act, ManagerServices, as_in_ros1
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.control.controller_manager import ControllerManager
    from slidectl.control.loaded_controller import LoadedController
    from slidectl.simulation.graph import GraphNode
    from slidectl.simulation.loop import Loop

STATE_IDS = {"unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}
"""States of ros2_control -> their numbers in lifecycle_msgs/State."""
_DEFAULT_STRICTNESS = "controller_manager/defaults/switch_controller/strictness"
_STRICTNESS = {"strict": STRICT, "best_effort": BEST_EFFORT}
_DEFAULT_TIMEOUT_S = 1.0


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
            partial(self._enqueue, lambda *_: {"controller": [_message(entry, rate_hz) for entry in manager.in_order]}),
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
        found, claimed = self._interfaces(self._manager.components()), self._claimed()
        for entry in self._manager.in_order:
            if not entry.is_configured:
                continue
            for kind, exported in (
                ("command_interfaces", _references(entry)),
                ("state_interfaces", _exported_states(entry)),
            ):
                for name in (f"{entry.name}/{each}" for each in exported):
                    is_claimed = kind == "command_interfaces" and name in claimed
                    one = {"name": name, "data_type": "double", "is_available": entry.is_running}
                    found[kind].append({**one, "is_claimed": is_claimed})
        return {kind: sorted(listed, key=lambda one: str(one["name"])) for kind, listed in found.items()}

    def _claimed(self) -> set[str]:
        """The commands that running controllers claim, by their names in ros2_control."""
        return {name for entry in self._manager.running for name in _commands(entry)}

    def _interfaces(self, components: Sequence[HardwareComponent]) -> Message:
        """The interfaces of components, by name, each as slidectl/HardwareInterface."""
        claimed = self._claimed()
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


# Controllers in the words of ros2_control.


def _commands(entry: LoadedController) -> list[str]:
    """The commands that a controller claims, as `joint1/effort`."""
    claims = entry.info.claimed_resources
    return [name for one in claims for name in interfaces.ros2_commands(one.hardware_interface, one.resources)]


def _references(entry: LoadedController) -> list[str]:
    """The references that it exports, without its own name, as `joint1/position`."""
    found = []
    for kind, handle in entry.controller.exported_references:
        found += interfaces.ros2_commands(kind.type_name, [handle.name.removeprefix(f"{entry.name}/")])
    return found


def _exported_states(entry: LoadedController) -> list[str]:
    """The states that it exports, without its own name, as `joint1/position`."""
    joints = [one.name.removeprefix(f"{entry.name}/") for one in entry.controller.exported_states]
    return [f"{joint}/{state}" for joint in joints for state in JOINT_STATES]


def _message(entry: LoadedController, rate_hz: int) -> Message:
    """A controller as slidectl/ControllerState. `rate_hz` is the rate of the updates."""
    is_configured = entry.is_configured
    commands = _commands(entry) if is_configured else []
    return {
        "name": entry.name,
        "state": entry.shown_state,
        "type": entry.info.type,
        "update_rate": rate_hz,
        "claimed_interfaces": commands if entry.is_running else [],
        "required_command_interfaces": commands,
        "required_state_interfaces": list(entry.states_read) if is_configured else [],
        "is_chainable": bool(entry.exported()),
        "is_chained": entry.controller.is_chained and entry.is_running,
        "exported_state_interfaces": _exported_states(entry) if is_configured else [],
        "reference_interfaces": _references(entry) if is_configured else [],
        "chain_connections": [{"name": one.name, "reference_interfaces": _references(one)} for one in entry.writes_to],
    }
