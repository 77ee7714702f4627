"""A controller that a manager has loaded, with its name, type and node; and its requests, made safe.

What a controller's own code raises ends that controller and nothing else: it is logged as fatal and aborted.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

from slidectl.control.controller import ControllerBase
from slidectl.control.node import NodeHandle
from slidectl.control.robot_hw import ControllerInfo
from slidectl.control.states import State
from slidectl.errors import SlidectlError


class LoadedController:
    """One entry of a manager's list. Times are nanoseconds of simulated time."""

    __slots__ = ("controller", "info", "node")

    def __init__(self, name: str, type_name: str, controller: ControllerBase, node: NodeHandle) -> None:
        self.controller = controller
        self.node = node
        self.info = ControllerInfo(name, type_name, controller.claimed_resources)

    @property
    def name(self) -> str:
        """The name it was loaded under."""
        return self.info.name

    @property
    def is_running(self) -> bool:
        """True while it is updated each cycle."""
        return self.controller.state is State.RUNNING

    @property
    def is_aborted(self) -> bool:
        """True after its start, or itself, failed."""
        return self.controller.state is State.ABORTED

    def start(self, time_ns: int) -> None:
        """Start, or start again."""
        self._request(self.controller.start_request, time_ns)

    def stop(self, time_ns: int) -> None:
        """Stop."""
        self._request(self.controller.stop_request, time_ns)

    def wait(self, time_ns: int) -> None:
        """Wait one more cycle for the hardware."""
        self._request(self.controller.wait_request, time_ns)

    def abort(self, time_ns: int) -> None:
        """Give up the start."""
        self._request(self.controller.abort_request, time_ns)

    def update(self, time_ns: int, period_s: float) -> None:
        """One cycle, if it is running."""
        try:
            self.controller.update_request(time_ns, period_s)
        except Exception as failure:
            self.fail(failure, time_ns)

    def fail(self, failure: Exception, time_ns: int) -> None:
        """Log what the controller's code raised, and abort it."""
        self.node.log("fatal", f"controller {self.name!r} failed and is aborted: {described(failure)}")
        try:
            self.controller.abort_request(time_ns)
        except Exception as another:
            self.node.log("fatal", f"controller {self.name!r} failed while aborting: {described(another)}")
            self.controller.give_up()

    def message(self) -> dict[str, Any]:
        """As controller_manager_msgs/ControllerState."""
        claimed = [
            {"hardware_interface": claim.hardware_interface, "resources": list(claim.resources)}
            for claim in self.controller.claimed_resources
        ]
        state = str(self.controller.state)
        return {"name": self.name, "state": state, "type": self.info.type, "claimed_resources": claimed}

    def _request(self, request: Callable[[int], bool], time_ns: int) -> None:
        try:
            request(time_ns)
        except Exception as failure:
            self.fail(failure, time_ns)


def described(failure: Exception) -> str:
    """An error on one line: our own by their text, others with their class and the place."""
    if isinstance(failure, SlidectlError):
        return "; ".join(line.rstrip(".") for line in str(failure).splitlines())
    frames = traceback.extract_tb(failure.__traceback__)
    place = f" ({frames[-1].filename}:{frames[-1].lineno})" if frames else ""
    return f"{type(failure).__name__}: {failure}{place}".replace("\n", " ")
