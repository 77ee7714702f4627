"""`rostopic`, `rosservice` and `rosparam` as nodes: the commands of this program in their place, as child processes."""

from __future__ import annotations

import sys

from slidectl.description.packages import Packages
from slidectl.launch.nodes.process import Process
from slidectl.launch.task import Run
from slidectl.paths import with_package


class Tool(Process):
    """A tool starts when all other nodes have, so that whom it talks to is there."""

    family = "tool"
    comes_last = True

    def _program(self, packages: Packages) -> list[str]:  # noqa: ARG002
        # -P: a file of the user's that is called like a library must not be taken for it.
        return [sys.executable, "-P", "-m", "slidectl", "ros", self.node.type]

    @property
    def command(self) -> list[str]:
        # In front of the topic: behind it `a:=b` may be a text to publish. Only rostopic publishes.
        remaps = self.node.remaps if self.node.type == "rostopic" else ()
        return [
            *self.executable,
            *self.node.words[:1],
            *(f"{remap.source}:={remap.target}" for remap in remaps),
            *self.node.words[1:],
        ]

    @property
    def text(self) -> str:
        return f"run {' '.join([self.node.type, *self.node.words])}"

    def _environment(self, run: Run) -> dict[str, str]:
        return with_package(super()._environment(run))
