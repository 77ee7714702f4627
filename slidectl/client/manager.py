"""The controller manager of a namespace, as scripts, commands and launches call it: its services by name.

Only service calls: nothing here waits for a manager or prints.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.errors import Refused

if TYPE_CHECKING:
    from slidectl.client.client import Client

STRICT = 2
BEST_EFFORT = 1
UNLOADED = "unloaded"
STARTED = ("running", "waiting")
_SERVICES = ("load_controller", "switch_controller", "unload_controller")


class Manager:
    """`/<namespace>/controller_manager/*`. What it refuses is raised with the reasons that its answer brings.

    Args:
        warn: called with each reason of a request that went well.
        limit_s: wall seconds that one call may take; None: as the client has it.
        timeout_s: longest simulated time that a switch may take; 0: no limit.
    """

    def __init__(
        self,
        client: Client,
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

    def _call(self, verb: str, **request: Any) -> dict[str, Any]:
        return self.client.call(f"{self.name}/{verb}", request, timeout=self._limit_s)

    def _answered(self, what: str, call_id: str) -> None:
        """Wait for the answer of a service that says `ok`. Raises Refused."""
        ok = self.client.answer(call_id, timeout=self._limit_s)["ok"]
        if not ok:
            raise self.refusal(what, self.client.reasons)
        for reason in self.client.reasons:
            self.warn(reason)

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        """The error when the manager said no to do `what`."""
        return Refused("\n".join(reasons[-2:]) or f"cannot {what}, and no reason was given")

    def _act(self, what: str, verb: str, **request: Any) -> None:
        self._answered(what, self.client.call_async(f"{self.name}/{verb}", request))

    # --- what there is ------------------------------------------------------------------------------------------

    def is_there(self) -> bool:
        """Whether its services exist."""
        known = self.client.call("/rosapi/services")["services"]
        return all(f"{self.name}/{service}" in known for service in _SERVICES)

    def controllers(self) -> list[dict[str, Any]]:
        """The loaded controllers, in load order (controller_manager_msgs/ControllerState)."""
        return list(self._call("list_controllers")["controller"])

    def states(self) -> dict[str, str]:
        """Name -> state of the loaded controllers."""
        return {controller["name"]: controller["state"] for controller in self.controllers()}

    def types(self) -> dict[str, Any]:
        """`types` and `base_classes`, parallel lists."""
        return self._call("list_controller_types")

    def configured(self) -> list[str]:
        """Controllers that have a `type` parameter here, loaded or not."""
        prefix = self.namespace.rstrip("/") + "/"
        parameters = sorted(self.client.call("/rosapi/get_param_names")["names"])
        inside = (name.removeprefix(prefix) for name in parameters if name.startswith(prefix))
        return [name.removesuffix("/type") for name in inside if name.endswith("/type") and name.count("/") == 1]

    def known(self) -> list[str]:
        """Controllers that are loaded or could be."""
        return sorted({*self.states(), *self.configured()})

    def type_parameter(self, name: str) -> str:
        """The type that the parameters give a controller; empty when they give none."""
        request = {"name": names.join(self.namespace, f"{name}/type"), "default": '""'}
        return str(json.loads(self.client.call("/rosapi/get_param", request)["value"]))

    # --- changes ------------------------------------------------------------------------------------------------

    def load(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"load {name}", "load_controller", name=name)

    def unload(self, name: str) -> None:
        """Raises Refused with the reason."""
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
        """Raises Refused when controllers are in the way."""
        self._act("reload the libraries", "reload_controller_libraries", force_kill=True)

    def load_all(self, wanted: Sequence[str]) -> None:
        """Load them in one go; all are tried. Raises Refused with what went wrong."""
        self.loaded(self.ask_to_load(wanted))

    def ask_to_load(self, wanted: Sequence[str]) -> dict[str, str]:
        """Send the requests; `loaded` takes the answers."""
        service = f"{self.name}/load_controller"
        return {name: self.client.call_async(service, {"name": name}) for name in dict.fromkeys(wanted)}

    def loaded(self, calls: dict[str, str]) -> None:
        """The answers to `ask_to_load`. Raises Refused with what went wrong."""
        each(lambda name: self._answered(f"load {name}", calls[name]), list(calls))

    def bring_up(self, wanted: Sequence[str], start: bool = True) -> None:
        """Load what is not loaded, then start what does not run in one strict switch. Raises Refused."""
        states = self.states()
        self.load_all([name for name in wanted if name not in states])
        idle = [name for name in dict.fromkeys(wanted) if states.get(name) != "running"]
        if start and idle:
            self.start(idle)

    def start(self, wanted: Sequence[str]) -> None:
        """Start loaded controllers in one strict switch, and see that they run. Raises Refused."""
        self.switch(wanted)
        self.check_started(wanted)

    def check_started(self, wanted: Sequence[str]) -> None:
        """A switch may be done and a controller still not run: it aborted, or it waits for its joints."""
        states = self.states()
        failed = [f"{name} is {states.get(name, UNLOADED)}" for name in wanted if states.get(name) not in STARTED]
        if failed:
            raise Refused(f"did not start: {', '.join(failed)}", "slidectl daemon logs says why")


def each(action: Callable[[str], None], wanted: Sequence[str]) -> None:
    """Try all of them; then raise Refused with what went wrong."""
    failures = []
    for name in wanted:
        try:
            action(name)
        except Refused as error:
            failures.append(str(error))
    if failures:
        raise Refused("\n".join(failures))
