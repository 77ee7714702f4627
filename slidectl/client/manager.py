"""The controller manager of a robot as a client sees it: load, start, stop, switch and list controllers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.errors import Refused

if TYPE_CHECKING:
    from slidectl.client.connection import GraphClient
    from slidectl.msgs.typed import (
        ControllerStateMsg,
        HardwareInterfaceResourcesMsg,
        ListControllerTypesResponseMsg,
        UpdateTimesMsg,
    )

STRICT = 2
BEST_EFFORT = 1
UNLOADED = "unloaded"
RUNNING = ("running", "active")
"""The states of a running controller: that of ros_control, and that of ros2_control for a robot of ROS 2."""
STARTED = (*RUNNING, "waiting")
UNCONFIGURED = "unconfigured"
"""The state of ros2_control in which a controller cannot start."""
_MANAGER_SERVICES = ("load_controller", "switch_controller", "unload_controller")


class Manager:
    """A client of the services `/<namespace>/controller_manager/*`. A refusal raises Refused with the answer's reasons.

    Args:
        warn: called with each warning, and with each error of a request that succeeded nevertheless.
        limit_s: limit of one call in wall seconds; None for the client's `timeout`.
        timeout_s: limit of a switch in simulated seconds; 0 for no limit.
    """

    def __init__(
        self,
        client: GraphClient,
        namespace: str,
        warn: Callable[[str], None] = lambda _text: None,
        limit_s: float | None = None,
        timeout_s: float = 0.0,
    ) -> None:
        self.client = client
        self.namespace = namespace
        self.name = names.join(namespace, "controller_manager")
        self.warn = warn
        self._limit_s = limit_s
        self._timeout_s = timeout_s

    def _call(self, verb: str, **request: Any) -> Any:
        return self.client.call(f"{self.name}/{verb}", request, timeout=self._limit_s)

    def _act(self, what: str, verb: str, **request: Any) -> None:
        self._answered(what, self.client.call_async(f"{self.name}/{verb}", request))

    def _answered(self, what: str, call_id: str) -> None:
        """Wait for an answer with the field `ok`. Raises Refused."""
        ok = self.client.answer(call_id, timeout=self._limit_s)["ok"]
        for reason in self.client.reasons if ok else self.client.warnings:
            self.warn(reason)
        if not ok:
            raise self.refusal(what, self.client.errors)

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        """The error of a request that was refused for these reasons."""
        return Refused("\n".join(reasons) or f"cannot {what}: no reason was given")

    def is_there(self) -> bool:
        """True when the services of the controller manager exist."""
        known = self.client.services()
        return all(f"{self.name}/{service}" in known for service in _MANAGER_SERVICES)

    def ask_for_controllers(self) -> str:
        """Send the request of `controllers` and `states` ahead."""
        return self.client.call_async(f"{self.name}/list_controllers")

    def controllers(self, call_id: str | None = None) -> list[ControllerStateMsg]:
        """The loaded controllers, in load order (controller_manager_msgs/ControllerState)."""
        call_id = self.ask_for_controllers() if call_id is None else call_id
        return list(self.client.answer(call_id, timeout=self._limit_s)["controller"])

    def states(self, call_id: str | None = None) -> dict[str, str]:
        """Name -> state of the loaded controllers."""
        return {controller["name"]: controller["state"] for controller in self.controllers(call_id)}

    def update_times(self) -> list[UpdateTimesMsg]:
        """Update durations of the loaded controllers, in load order (slidectl/UpdateTimes)."""
        return self.client.call("/slidectl/update_times", {"robot": self.namespace})["controllers"]

    def types(self) -> ListControllerTypesResponseMsg:
        """The controller types: `types` and `base_classes`, parallel lists."""
        types: ListControllerTypesResponseMsg = self._call("list_controller_types")
        return types

    def parameter_names(self) -> list[str]:
        """The names of all parameters of the daemon, sorted."""
        return sorted(self.client.call("/rosapi/get_param_names")["names"])

    def configured(self) -> list[str]:
        """The controllers with a `type` parameter in this namespace, loaded or not."""
        return configured(self.parameter_names(), self.namespace)

    def is_configured(self, name: str) -> bool:
        """True when a controller has a `type` parameter in this namespace. Its name may hold a slash."""
        return is_configured(self.parameter_names(), self.namespace, name)

    def known(self) -> list[str]:
        """Names of the controllers that are loaded or configured, sorted."""
        return sorted({*self.states(), *self.configured()})

    def type_parameter(self, name: str) -> str:
        """The type of a controller in its parameters; empty without one."""
        request = {"name": names.join(self.namespace, f"{name}/type"), "default": '""'}
        return str(json.loads(self.client.call("/rosapi/get_param", request)["value"]))

    def load(self, name: str) -> None:
        """Load a controller. Raises Refused with the reason."""
        self._act(f"load {name}", "load_controller", name=name)

    def configure(self, name: str) -> None:
        """Configure a controller of a robot of ROS 2, which then can start. Raises Refused with the reason."""
        self._act_of_ros2("configure", name)

    def cleanup(self, name: str) -> None:
        """Make a controller of a robot of ROS 2 unconfigured. Raises Refused with the reason."""
        self._act_of_ros2("cleanup", name)

    def _act_of_ros2(self, verb: str, name: str) -> None:
        try:
            self._act(f"{verb} {name}", f"{verb}_controller", name=name)
        except Refused:
            if f"{self.name}/{verb}_controller" in self.client.services():
                raise
            text = (
                f"cannot {verb} {name}: {self.namespace} is no robot of ROS 2; its controllers are configured by load"
            )
            raise Refused(text, f"slidectl controller start {name}") from None

    def make_ready(self, wanted: Sequence[str], states: Mapping[str, str]) -> None:
        """Configure those of these controllers that are unconfigured by these states. Raises Refused."""
        each(self.configure, [name for name in dict.fromkeys(wanted) if states.get(name) == UNCONFIGURED])

    def unload(self, name: str) -> None:
        """Unload a controller. Raises Refused with the reason."""
        self._act(f"unload {name}", "unload_controller", name=name)

    def switch(
        self, start: Sequence[str], stop: Sequence[str] = (), strictness: int = STRICT, asap: bool = False
    ) -> None:
        """Stop and start in one cycle. Raises Refused with the reasons."""
        wishes = [f"{verb} {', '.join(wanted)}" for verb, wanted in (("stop", stop), ("start", start)) if wanted]
        self._act(
            " and ".join(wishes) or "switch",
            "switch_controller",
            start_controllers=list(start),
            stop_controllers=list(stop),
            strictness=strictness,
            start_asap=asap,
            timeout=self._timeout_s,
        )

    def reload_libraries(self) -> None:
        """Reload the controller libraries. Raises Refused when controllers prevent it."""
        self._act("reload the libraries", "reload_controller_libraries", force_kill=True)

    def load_file(self, name: str, file: str, class_name: str = "") -> None:
        """Load a controller from a class in a Python file (an absolute path). Raises Refused with the reason."""
        request = {"robot": self.namespace, "name": name, "file": file, "class_name": class_name}
        self._answered(f"load {name}", self.client.call_async("/slidectl/load_controller_file", request))

    def reload(self, name: str) -> None:
        """Replace a controller loaded from a user's file by the file's present version. Raises Refused with the
        reasons.
        """
        request = {"robot": self.namespace, "name": name}
        before = self.states().get(name)
        self._answered(f"reload {name}", self.client.call_async("/slidectl/reload_controller", request))
        if before in (*STARTED, "aborted"):
            self.check_started([name])

    def ask_to_load(self, wanted: Sequence[str]) -> dict[str, str]:
        """Send load requests without waiting. Returns name -> call id, for `loaded`."""
        service = f"{self.name}/load_controller"
        return {name: self.client.call_async(service, {"name": name}) for name in dict.fromkeys(wanted)}

    def loaded(self, calls: dict[str, str]) -> None:
        """Wait for the answers to `ask_to_load`. Raises Refused with the errors."""
        each(lambda name: self._answered(f"load {name}", calls[name]), list(calls))

    def bring_up(
        self,
        wanted: Sequence[str],
        start: bool = True,
        *,
        stop: Sequence[str] = (),
        states: Mapping[str, str] | None = None,
        loads: dict[str, str] | None = None,
        listing: str | None = None,
        configures: bool = True,
    ) -> dict[str, str]:
        """Load the controllers that are not loaded, then start the idle ones in one strict switch. Returns the states.

        Controllers of a robot of ROS 2 are configured, too, unless `start` is False.

        Args:
            stop: running controllers that the same switch stops.
            states: the states before; None: they are requested.
            loads: calls of `ask_to_load` under way; None: the missing controllers are loaded here.
            listing: a call of `ask_for_controllers` that was sent after `loads`; None: it is sent here.
            configures: False for a robot that is known to be none of ROS 2, which saves the listing.

        Raises:
            Refused: a controller cannot be loaded, and none is started; or one did not start.
        """
        states = self.states() if states is None else states
        loads = self.ask_to_load([name for name in wanted if name not in states]) if loads is None else loads
        if start and loads and listing is None and configures:
            listing = self.ask_for_controllers()  # in the time of the loads
        self.loaded(loads)
        if listing is not None:
            states = self.states(listing)
        idle = [name for name in dict.fromkeys(wanted) if states.get(name) not in RUNNING]
        if not start or not (idle or stop):
            return self.states()
        return self.start(idle, stop, states)

    def spawn(self, *wanted: str) -> dict[str, str]:
        """Load the controllers that are not loaded, and start them in one cycle. Returns the states. Raises Refused."""
        return self.bring_up(wanted)

    def stop(self, *running: str) -> None:
        """Stop controllers in one cycle; their joints keep the last commands. Raises Refused."""
        self.switch((), running)

    def unspawn(self, *wanted: str) -> None:
        """Stop controllers that run, and unload them. Raises Refused."""
        states = self.states()
        if running := [name for name in wanted if states.get(name) in STARTED]:
            self.switch((), running)
        each(self.unload, list(wanted)[::-1])

    def start(
        self, wanted: Sequence[str], stop: Sequence[str] = (), states: Mapping[str, str] | None = None
    ) -> dict[str, str]:
        """Start loaded controllers in one strict switch, check that they run, return the states. Raises Refused.

        Those of a robot of ROS 2 are configured first. `states`: the states before; None: they are requested.
        """
        self.make_ready(wanted, self.states() if states is None else states)
        self.switch(wanted, stop)
        return self.check_started(wanted)

    def check_started(self, wanted: Sequence[str]) -> dict[str, str]:
        """Check that controllers run: one may abort after its switch. Returns the states. Raises Refused."""
        states = self.states()
        failed = [f"{name} is {states.get(name, UNLOADED)}" for name in wanted if states.get(name) not in STARTED]
        if failed:
            raise Refused(f"did not start: {', '.join(failed)}", "slidectl daemon logs says why")
        return states


def configured(parameters: Sequence[str], namespace: str) -> list[str]:
    """Names of the controllers in a namespace that have a `type` among these parameters.

    A name may have one slash, as `arm/position`, where no controller `arm` has a parameter of that name, and not in the
    root, which holds the namespaces of others.
    """
    prefix = namespace.rstrip("/") + "/"
    inside = (name.removeprefix(prefix) for name in parameters if name.startswith(prefix))
    typed = [name.removesuffix("/type") for name in inside if name.endswith("/type")]
    plain = [name for name in typed if "/" not in name]
    grouped = [name for name in typed if name.count("/") == 1 and name.partition("/")[0] not in plain]
    return plain if prefix == "/" else plain + grouped


def is_configured(parameters: Sequence[str], namespace: str, name: str) -> bool:
    """True when a controller has a `type` among these parameters. Its name may hold a slash: `arm/position`."""
    return names.join(namespace, f"{name}/type") in parameters


def claimed_text(resources: Sequence[HardwareInterfaceResourcesMsg]) -> str:
    """The claims as text, for example `EffortJointInterface: joint1 joint2`; `; ` separates interfaces."""
    parts = ((item["hardware_interface"].rpartition("::")[2], item["resources"]) for item in resources)
    return "; ".join(f"{interface}: {' '.join(claimed)}" if claimed else interface for interface, claimed in parts)


def each(action: Callable[[str], None], wanted: Sequence[str]) -> None:
    """Call `action` for each name, then raise Refused with all the errors if there were any."""
    failures = []
    for name in wanted:
        try:
            action(name)
        except Refused as error:
            failures.append(str(error))
    if failures:
        raise Refused("\n".join(failures))
