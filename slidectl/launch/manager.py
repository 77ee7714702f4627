"""A controller manager as the ROS scripts use it: its services by name, with the reasons of a refusal.

Only service calls. What the scripts do with it is in nodes/.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slidectl import names
from slidectl.errors import Refused
from slidectl.launch.task import Run

STRICT = 2
BEST_EFFORT = 1
SERVICES = ("load_controller", "switch_controller", "unload_controller")


class Manager:
    """The controller manager of `namespace`; `limit_s` is how long one call may take, None as the client has it."""

    def __init__(self, run: Run, namespace: str, limit_s: float | None = None) -> None:
        self.run = run
        self.namespace = namespace
        self.limit_s = limit_s

    @property
    def name(self) -> str:
        """`/ns/controller_manager`."""
        return names.join(self.namespace, "controller_manager")

    def is_there(self) -> bool:
        """Whether its services exist."""
        known = self.run.call("/rosapi/services")["services"]
        return all(f"{self.name}/{service}" in known for service in SERVICES)

    def _ask(self, verb: str, **request: Any) -> dict[str, Any]:
        return self.run.call(f"{self.name}/{verb}", request, self.limit_s)

    def _act(self, what: str, verb: str, **request: Any) -> None:
        """Raises Refused with what was logged meanwhile."""
        for earlier in self.run.heard():
            self.run.console.warn(earlier)
        ok = self._ask(verb, **request)["ok"]
        reasons = self.run.heard()
        if not ok:
            raise Refused(f"cannot {what}: {'; '.join(reasons[-2:]) or 'no reason was logged'}")
        for reason in reasons:
            self.run.console.warn(reason)

    def controllers(self) -> list[dict[str, Any]]:
        """The loaded ones, in load order (controller_manager_msgs/ControllerState)."""
        return list(self._ask("list_controllers")["controller"])

    def states(self) -> dict[str, str]:
        """Name -> state of the loaded ones."""
        return {controller["name"]: controller["state"] for controller in self.controllers()}

    def types(self) -> list[str]:
        """The types that can be loaded."""
        return list(self._ask("list_controller_types")["types"])

    def load(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"load {name}", "load_controller", name=name)

    def unload(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"unload {name}", "unload_controller", name=name)

    def switch(self, start: Sequence[str], stop: Sequence[str], strictness: int = STRICT) -> None:
        """In one cycle. Raises Refused with the reasons."""
        wishes = [f"{verb} {', '.join(wanted)}" for verb, wanted in (("stop", stop), ("start", start)) if wanted]
        self._act(
            " and ".join(wishes) or "switch",
            "switch_controller",
            start_controllers=list(start),
            stop_controllers=list(stop),
            strictness=strictness,
            start_asap=False,
            timeout=0.0,
        )

    def reload_libraries(self) -> None:
        """Raises Refused when controllers are in the way."""
        self._act("reload the libraries", "reload_controller_libraries", force_kill=True)

    def configured(self) -> list[str]:
        """Controllers that have a `type` parameter here."""
        prefix = self.namespace.rstrip("/") + "/"
        known = self.run.call("/rosapi/get_param_names")["names"]
        inside = (name.removeprefix(prefix) for name in known if name.startswith(prefix))
        return [name.removesuffix("/type") for name in inside if name.endswith("/type") and name.count("/") == 1]
