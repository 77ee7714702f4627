"""The PID of control_toolbox for ROS 2: its equation, its state and its gains.

It differs from `control/pid.py`: the integral term counts one step later, and the command itself can be bounded. It
uses no parameters, topics or clocks.
"""

from __future__ import annotations

from math import inf, isfinite, isnan, sqrt
from sys import float_info
from typing import NamedTuple

from slidectl.errors import Refused

NONE, BACK_CALCULATION, CONDITIONAL_INTEGRATION = "none", "back_calculation", "conditional_integration"
STRATEGIES = (NONE, BACK_CALCULATION, CONDITIONAL_INTEGRATION)
"""What happens to the integral while the command is at its bound."""


class Ros2Gains(NamedTuple):
    """Gains in commands per error. The bounds of the command and of the integral term are in units of the command."""

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    u_max: float = inf
    u_min: float = -inf
    i_max: float = inf
    i_min: float = -inf
    tracking_time_constant: float = 0.0
    """In s, of back calculation; 0: it follows from the gains."""
    error_deadband: float = 0.0
    """Errors up to this size do not change the integral term."""
    antiwindup: str = NONE

    def check(self) -> None:
        """Raise Refused when the PID cannot use these gains, with the name of the parameter that is wrong."""
        for name in ("p", "i", "d", "error_deadband"):
            if not isfinite(getattr(self, name)):
                raise Refused(f"{name} must be a finite number, not {getattr(self, name)}")
        if not self.u_min < self.u_max or isnan(self.i_min) or isnan(self.i_max):
            raise Refused(f"u_clamp_min ({self.u_min:g}) must be below u_clamp_max ({self.u_max:g})")
        if self.i_min > 0.0 or self.i_max < 0.0:
            raise Refused(f"0 must be between i_clamp_min ({self.i_min:g}) and i_clamp_max ({self.i_max:g})")
        if self.antiwindup != BACK_CALCULATION:
            return
        if not 0.0 <= self.tracking_time_constant < inf:
            raise Refused(f"tracking_time_constant must be 0 or above, not {self.tracking_time_constant:g}")
        if self.i != 0.0 and self.used_time_constant() == 0.0:
            raise Refused(f"{BACK_CALCULATION} needs a tracking_time_constant when p and d are 0")

    def used_time_constant(self) -> float:
        """The time constant of back calculation, in s: the given one, else sqrt(d/i), without d p/i."""
        if self.tracking_time_constant != 0.0 or self.i == 0.0:
            return self.tracking_time_constant
        return sqrt(abs(self.d / self.i)) if self.d != 0.0 else self.p / self.i


class Ros2Pid:
    """Gains and state of one control loop."""

    def __init__(self, gains: Ros2Gains) -> None:
        self.set_gains(gains)
        self.reset()

    def set_gains(self, gains: Ros2Gains) -> None:
        """Use other gains, which were checked, from the next command on. The integral term stays."""
        self.p, self.i, self.d = gains.p, gains.i, gains.d
        self.u_max, self.u_min, self.i_max, self.i_min = gains.u_max, gains.u_min, gains.i_max, gains.i_min
        self.time_constant = gains.used_time_constant()
        self.error_deadband = gains.error_deadband
        self.antiwindup = gains.antiwindup

    def reset(self) -> None:
        """Set the integral term and the command to 0."""
        self.i_term = self.command = 0.0

    def next_command(self, error: float, error_dot: float, period_s: float) -> float:
        """command = p error + integral term + d error_dot, bounded, with the integral term of the steps before.

        nan when an error is not finite; the last command when the period is 0.
        """
        if abs(period_s) <= float_info.epsilon:
            return self.command
        if not isfinite(error) or not isfinite(error_dot):
            self.command = float("nan")
            return self.command
        wanted = self.p * error + self.i_term + self.d * error_dot
        self.command = min(max(wanted, self.u_min), self.u_max)
        if abs(error) > self.error_deadband:
            self._integrate(error, wanted, period_s)
        self.i_term = min(max(self.i_term, self.i_min), self.i_max)
        return self.command

    def _integrate(self, error: float, wanted: float, period_s: float) -> None:
        if self.antiwindup == BACK_CALCULATION:
            if self.i != 0.0:
                excess = self.command - wanted
                self.i_term += period_s * (self.i * error + excess / self.time_constant)
        elif self.antiwindup == NONE or not self._is_pushed_further(error, wanted):
            self.i_term += period_s * self.i * error

    def _is_pushed_further(self, error: float, wanted: float) -> bool:
        """True when the command is at its bound and the error would move it further beyond."""
        return abs(wanted - self.command) > float_info.epsilon and error * wanted > 0.0
