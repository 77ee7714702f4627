"""A controller manager as the nodes of a launch use it: its refusals in one line, its warnings with the nodes' others.

Only service calls. What the scripts do with it is in nodes/.
"""

from __future__ import annotations

from collections.abc import Sequence

from slidectl.client.client import Manager
from slidectl.errors import Refused
from slidectl.launch.task import Run


class NodeManager(Manager):
    """The controller manager of `namespace`; `limit_s` is how long one call may take, None as the client has it."""

    def __init__(self, run: Run, namespace: str, limit_s: float | None = None) -> None:
        super().__init__(run.client, namespace, run.console.warn, limit_s)
        self.run = run

    def missing(self) -> str:
        """What is waited for while it is not there, and where robots are instead."""
        robots = self.run.call("/slidectl/list_robots", {"name": ""})["robots"]
        elsewhere = ", ".join(f"{robot['name']} is in {robot['namespace']}" for robot in robots)
        return f"{self.name} (no robot is in {self.namespace} yet{f'; {elsewhere}' if elsewhere else ''})"

    def _answered(self, what: str, call_id: str) -> None:
        for earlier in self.run.heard():
            self.warn(earlier)
        try:
            super()._answered(what, call_id)
        finally:
            for other in self.run.heard():  # the log has what others did, too
                if other not in self.client.reasons:
                    self.warn(other)

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        return Refused(f"cannot {what}: {'; '.join(reasons[-2:]) or 'no reason was given'}")
