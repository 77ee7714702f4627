"""A controller manager as the ROS scripts use it: its services by name, with the reasons of a refusal.

Only service calls. What the scripts do with it is in nodes/.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slidectl import names
from slidectl.client.manager import ManagerServices
from slidectl.errors import Refused
from slidectl.launch.task import Run

SERVICES = ("load_controller", "switch_controller", "unload_controller")


class Manager(ManagerServices):
    """The controller manager of `namespace`; `limit_s` is how long one call may take, None as the client has it."""

    def __init__(self, run: Run, namespace: str, limit_s: float | None = None) -> None:
        super().__init__(namespace)
        self.run = run
        self.limit_s = limit_s

    @property
    def name(self) -> str:
        """`/ns/controller_manager`."""
        return names.join(self.namespace, "controller_manager")

    def is_there(self) -> bool:
        """Whether its services exist."""
        known = self.run.call("/rosapi/services")["services"]
        return all(f"{self.name}/{service}" in known for service in SERVICES)

    def missing(self) -> str:
        """What is waited for while it is not there, and where robots are instead."""
        robots = self.run.call("/slidectl/list_robots", {"name": ""})["robots"]
        elsewhere = ", ".join(f"{robot['name']} is in {robot['namespace']}" for robot in robots)
        return f"{self.name} (no robot is in {self.namespace} yet{f'; {elsewhere}' if elsewhere else ''})"

    def ask(self, verb: str, **request: Any) -> dict[str, Any]:
        return self.run.call(f"{self.name}/{verb}", request, self.limit_s)

    def act(self, verb: str, **request: Any) -> tuple[bool, list[str]]:
        for earlier in self.run.heard():
            self.warn(earlier)
        ok = self.ask(verb, **request)["ok"]
        reasons = self.run.client.reasons
        for other in self.run.heard():  # the log has what others did, too
            if other not in reasons:
                self.warn(other)
        return ok, reasons

    def warn(self, text: str) -> None:
        self.run.console.warn(text)

    def parameters(self) -> Sequence[str]:
        return list(self.run.call("/rosapi/get_param_names")["names"])

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        return Refused(f"cannot {what}: {'; '.join(reasons[-2:]) or 'no reason was given'}")
