"""The PID law of control_toolbox 1.19 (ROS 1), to the bit: its equation and its state.

`pid_law` is the equation, `next_command` one step that updates the state; `Pid` holds gains and state. None of them
uses parameters, topics or clocks.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import NamedTuple

from slidectl.control.laws import Columns, law


class Gains(NamedTuple):
    """Gains in effort per error; `i_min` and `i_max` bound the integral term in units of the command."""

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    i_max: float = 0.0
    i_min: float = 0.0
    antiwindup: bool = False


@law
def pid_law(
    error: float,
    error_dot: float,
    i_error: float,
    dt: float,
    p: float,
    i: float,
    d: float,
    i_min: float,
    i_max: float,
    antiwindup: bool,
) -> tuple[float, float]:
    """(command, integral of the error) after `dt` seconds. command = p error + i integral + d error_dot.

    With anti-windup the integral itself is bounded, without it only its contribution. When the lower bound is above
    the upper one, the upper one counts.
    """
    i_error += dt * error
    if antiwindup and i != 0.0:
        lower, upper = i_min / i, i_max / i
        if upper < lower:
            lower, upper = upper, lower
        if i_error < lower:
            i_error = lower
        if upper < i_error:
            i_error = upper
    i_term = i * i_error
    if not antiwindup:
        if i_term < i_min:
            i_term = i_min
        if i_max < i_term:
            i_term = i_max
    return p * error + i_term + d * error_dot, i_error


@law
def next_command_from(pid: Pid, error: float, error_dot: float, period_s: float) -> float:
    """The command of `pid` for this error and its derivative. 0.0 when one of them is not finite or the period is 0."""
    pid.p_error = error
    pid.d_error = error_dot
    if period_s == 0.0 or not isfinite(error) or not isfinite(error_dot):
        return 0.0
    pid.command, pid.i_error = pid_law(
        error,
        error_dot,
        pid.i_error,
        period_s,
        pid.p,
        pid.i,
        pid.d,
        pid.i_min,
        pid.i_max,
        pid.antiwindup,
    )
    return pid.command


@law
def next_command(pid: Pid, error: float, period_s: float) -> float:
    """The command of `pid` for this error. The derivative is computed from the last error.

    0.0, without a change of the state, when the period is 0 or the error is not finite.
    """
    if period_s == 0.0 or not isfinite(error):
        return 0.0
    error_dot = pid.d_error
    if period_s > 0.0:
        if pid.p_error_last_is_valid:
            error_dot = (error - pid.p_error_last) / period_s
        else:
            pid.p_error_last_is_valid = True
        pid.p_error_last = error
    return next_command_from(pid, error, error_dot, period_s)


class Pid:
    """Gains and state of one control loop.

    Errors are in units of the controlled quantity, periods in seconds.
    """

    __slots__ = (
        "antiwindup",
        "command",
        "d",
        "d_error",
        "i",
        "i_error",
        "i_max",
        "i_min",
        "observer",
        "p",
        "p_error",
        "p_error_last",
        "p_error_last_is_valid",
    )
    columns = Columns(
        changing="p_error p_error_last p_error_last_is_valid i_error d_error command",
        fixed="p i d i_min i_max antiwindup",
        whole="p_error_last_is_valid antiwindup",
    )

    def __init__(
        self,
        p: float = 0.0,
        i: float = 0.0,
        d: float = 0.0,
        i_max: float = 0.0,
        i_min: float = 0.0,
        antiwindup: bool = False,
    ) -> None:
        self.observer: Callable[[float], None] | None = None
        """Called with the period, in s, after each computed command, to publish the state."""
        self.set_gains(Gains(p, i, d, i_max, i_min, antiwindup))
        self.reset()

    @property
    def gains(self) -> Gains:
        """The gains now in use."""
        return Gains(self.p, self.i, self.d, self.i_max, self.i_min, self.antiwindup)

    def set_gains(self, gains: Gains) -> None:
        """Use other gains from the next command on. The state stays: the integral is not rescaled."""
        self.p, self.i, self.d, self.i_max, self.i_min, self.antiwindup = gains

    def reset(self) -> None:
        """Reset the state. The last error becomes a valid 0, so the next command contains d * error / dt."""
        self.p_error = self.p_error_last = self.i_error = self.d_error = self.command = 0.0
        self.p_error_last_is_valid = True

    def reset_to(self, d_error: float, i_error: float) -> None:
        """Set the derivative of the error, which the next command uses unchanged, and the integral of the error."""
        self.reset()
        self.d_error = d_error
        self.i_error = i_error
        self.p_error_last_is_valid = False

    def compute_command(self, error: float, period_s: float) -> float:
        """`next_command`, followed by a call of the observer."""
        command = next_command(self, error, period_s)
        if self.observer is not None:
            self.tell(error, period_s)
        return command

    def tell(self, error: float, period_s: float) -> None:
        """Call the observer, if a command was computed for this error."""
        if self.observer is not None and period_s != 0.0 and isfinite(error) and isfinite(self.d_error):
            self.observer(period_s)

    def terms(self) -> tuple[float, float, float]:
        """The proportional, integral and derivative terms of the last command."""
        i_term = self.i * self.i_error
        if not self.antiwindup:
            i_term = min(max(i_term, self.i_min), self.i_max)
        return self.p * self.p_error, i_term, self.d * self.d_error
