"""The page in a browser, for `--view` and `gui:=true`: `slidectl view` as a process that ends with the launch."""

from __future__ import annotations

import sys
from pathlib import Path

from slidectl.extensions.launch.nodes.programs import Process
from slidectl.extensions.launch.plan import LaunchPlan, Location, Node
from slidectl.extensions.launch.task import Run
from slidectl.open_page import address_of
from slidectl.paths import with_package


class OpenPage(Process):
    """`slidectl view` for the daemon of the launch. When the page is open already, its address is shown."""

    def __init__(self, plan: LaunchPlan, why: str) -> None:
        node = Node("slidectl", "view", "page", "/", Location(why, None))
        node.output = "screen"
        super().__init__(node, plan, [sys.executable, "-P", "-m", "slidectl", "--quiet", "view"])
        self._is_open_already = False

    @property
    def text(self) -> str:
        return "open the page: slidectl view"

    @property
    def keeps_running(self) -> bool:  # type: ignore[override]
        return not self._is_open_already

    def start(self, run: Run) -> str | None:
        address = address_of(run.client.paths)
        if self.child is None:
            if address is not None:
                self._is_open_already = True
                self.settled(run, f"the page is open already: {address}", url=address)
                return None
            self._begin(run)
        elif not self.is_alive:
            return None
        elif address is not None:
            self.settled(run, f"the page is open: {address}", url=address)
            return None
        return "the page"

    def _to_run(self, log: Path) -> list[str]:  # noqa: ARG002 - it has no log
        return list(self.executable)

    def _environment(self, run: Run) -> dict[str, str]:
        return with_package(super()._environment(run))
