"""The base of the controllers that behave as in ros2_controllers: a controller is updated at a rate of its own.

After ros2_control's controller_manager. It knows no topics and commands nothing.
"""

from __future__ import annotations

from dataclasses import replace
from math import floor
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import ControllerBase
from slidectl.control.duration import NANOSECONDS, to_seconds
from slidectl.control.hardware_interface import ClaimedResources, RobotHW
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import INTEGER, BadParameter, Kind, Parameter, as_number
from slidectl.errors import Reason, Refused

UPDATE_RATE = Parameter(
    "update_rate", INTEGER, "updates per simulated second; 0: one in each control cycle", "1/s", default=0, fixed=True
)


def _number_from(least: float) -> Kind[float]:
    def convert(value: Any) -> float | None:
        number = as_number(value)
        return number if number is not None and number >= least else None

    return Kind(f"a number of {least:g} or more", convert)


NOT_NEGATIVE = _number_from(0.0)
RATE = _number_from(0.1)
MONITOR_RATE = Parameter(
    "action_monitor_rate", RATE, "how often the goal's feedback and result are sent", "1/s", default=20.0, fixed=True
)


def checked_value(node: NodeHandle, parameter: Parameter, joint: str = "") -> Any:
    """The value of a parameter, or its default. Raises BadParameter: it is missing or wrong, which ROS 2 refuses."""
    name = parameter.name.replace("<joint>", joint)
    value = node.get_param(name, None)
    if value is None and not parameter.required:
        return parameter.default
    converted = parameter.kind.convert(value)
    if converted is None:
        raise BadParameter(node, name, parameter.kind.words)
    return converted


def fixed(*parameters: Parameter) -> tuple[Parameter, ...]:
    """The parameters as those that cannot change while the controller is loaded."""
    return tuple(replace(parameter, fixed=True) for parameter in parameters)


class LogThrottle:
    """Logs one line of a kind per simulated second. The sender of a request gets each of its own."""

    def __init__(self, node: NodeHandle) -> None:
        self._node = node
        self._last_ns = -NANOSECONDS

    def log(self, severity: str, text: str) -> None:
        """Log the text. If the last one was less than a second ago, only add it to the answer of a present request."""
        now_ns = self._node.now_ns()
        if not 0 <= now_ns - self._last_ns < NANOSECONDS:
            self._last_ns = now_ns
            self._node.log(severity, text)
        elif self._node.reasons is not None:
            self._node.reasons.append(Reason(text, severity))


class Ros2Controller(ControllerBase):
    """A controller with the parameter `update_rate`. A subclass defines `cycle` instead of `update`.

    The first update after the start is in the next control cycle. Then it is updated in every n-th one, n being the
    rate of the control cycles over `update_rate`, rounded. A subclass that overrides `starting` calls this one's.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (UPDATE_RATE,)
    _node: NodeHandle
    """The controller's own node handle."""

    def cycle(self, time_ns: int, period_s: float) -> None:
        """One update. `period_s` is the time since the last one, of the first one the nominal period."""
        raise NotImplementedError

    def starting(self, time_ns: int) -> None:
        self._cycles_per_update = 0
        """Set by the first update, since the period of the control cycle is known only then."""
        self._cycles = 0
        """Control cycles since the last update."""
        self._last_update_ns = time_ns

    def update(self, time_ns: int, period_s: float) -> None:
        self._cycles += 1
        if self._cycles < self._cycles_per_update:
            return
        if not self._cycles_per_update:
            self._cycles_per_update = self._rounded(period_s)
            period_s *= self._cycles_per_update
        elif self._cycles > 1:
            period_s = to_seconds(time_ns - self._last_update_ns)
        self._cycles = 0
        self._last_update_ns = time_ns
        self.cycle(time_ns, period_s)

    def _claim(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> tuple[ClaimedResources, ...]:
        self._node = node
        self._update_rate: int = params.value_of(node, UPDATE_RATE)
        if self._update_rate < 0:
            raise Refused(f"parameter {node.namespace}/{UPDATE_RATE.name} must be 0 or above, not {self._update_rate}")
        return super()._claim(hw, root, node)

    def _rounded(self, period_s: float) -> int:
        """Control cycles per update. Logs a warning when the rate is not one of them."""
        if not self._update_rate or period_s <= 0.0:
            return 1
        where, cycle_rate = f"{self._node.namespace}/{UPDATE_RATE.name}", 1.0 / period_s
        ratio = cycle_rate / self._update_rate
        rounded = max(1, floor(ratio + 0.5))
        if ratio < 1.0 - 1e-9:
            text = f"{where} is {self._update_rate}, and the control cycle runs {cycle_rate:g} times per second"
            self._node.log("warn", f"{text}: the controller is updated in each cycle")
        elif abs(ratio - rounded) > 1e-9 * ratio:
            text = f"{where} is {self._update_rate}, which does not divide the rate of the control cycle"
            text += f", {cycle_rate:g}: the controller is updated {cycle_rate / rounded:g} times per second"
            self._node.log("warn", text)
        return rounded
