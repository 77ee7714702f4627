"""The PID of control_toolbox 1.19 (ROS 1), to the bit: its equation, its state, and gains that are parameters.

`pid_law` is the equation, `next_command` one step that updates the state; `Pid` holds gains and state. None of them
uses parameters, topics or clocks. `ReconfigurablePid` reads the gains from parameters and changes them by service or
parameter between two cycles, after control_toolbox's init and its dynamic_reconfigure server; the state does not change
then. The parameters always equal the gains: a change that the PID cannot use is refused, and a value that it normalizes
(the sign of a clamp) is written back.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, isnan
from typing import Any, ClassVar, NamedTuple

from slidectl.control import params
from slidectl.control.duration import from_seconds, header_of, to_stamp
from slidectl.control.laws import Columns, law
from slidectl.control.node_handle import NodeHandle, ParameterChange, publish_if_wanted
from slidectl.control.params import BOOLEAN, NUMBER, Parameter, check_values
from slidectl.control.reconfigure import Option, ReconfigureServer, Values
from slidectl.errors import Refused


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
            self.report(error, period_s)
        return command

    def report(self, error: float, period_s: float) -> None:
        """Call the observer, if a command was computed for this error."""
        if self.observer is not None and period_s != 0.0 and isfinite(error) and isfinite(self.d_error):
            self.observer(period_s)

    def terms(self) -> tuple[float, float, float]:
        """The proportional, integral and derivative terms of the last command."""
        i_term = self.i * self.i_error
        if not self.antiwindup:
            i_term = min(max(i_term, self.i_min), self.i_max)
        return self.p * self.p_error, i_term, self.d * self.d_error


GAINS = (
    Parameter("p", NUMBER, "proportional gain", required=True, live=True),
    Parameter("i", NUMBER, "integral gain", default=0.0, live=True),
    Parameter("d", NUMBER, "derivative gain", default=0.0, live=True),
    Parameter("i_clamp", NUMBER, "bound of the integral term in both directions", default=0.0, live=True),
    Parameter("i_clamp_min", NUMBER, "lower bound of the integral term; overrides i_clamp", live=True),
    Parameter("i_clamp_max", NUMBER, "upper bound of the integral term; overrides i_clamp", live=True),
    Parameter("antiwindup", BOOLEAN, "bounds the integral itself, not only its term", default=False, live=True),
    Parameter("publish_state", BOOLEAN, "publishes control_msgs/PidState", default=False),
)
"""The parameters of a namespace of gains, as control_toolbox reads them."""


class ReconfigurablePid:
    """A PID, `pid`, whose gains stay equal to the parameters in the namespace of `node`."""

    saved_attributes: ClassVar[None] = None

    def __init__(self, node: NodeHandle) -> None:
        """Read the gains, write them back, and advertise the reconfigure service.

        Raises:
            BadParameter: `p` is not set. Refused: a gain is not a number.
        """
        self._node = node
        self._writing = False
        self._is_idle = False
        gains = gains_from_parameters(node)
        self.pid = Pid(*gains)
        if params.read(node, "publish_state", BOOLEAN):
            self._state = node.advertise("state", "control_msgs/PidState")
            self.pid.observer = self._publish_state
        self._server = ReconfigureServer(
            node, OPTIONS, lambda: to_parameters(self.pid.gains), lambda values: self.set_gains(gains_of(values))
        )
        i_clamp = params.read(node, "i_clamp", NUMBER)
        self.set_gains(gains)
        # The value as set, even if i_clamp_min and i_clamp_max override it: setting it again then changes nothing.
        self._i_clamp = None if i_clamp is None else abs(i_clamp)
        node.guard_params(self._judge)
        node.watch_param(node.namespace, self._parameters_changed)

    def set_gains(self, gains: Gains) -> None:
        """Use these gains from the next cycle on, write them to the parameters and publish them."""
        old = self.pid.gains
        self.pid.set_gains(gains)
        for name in ("p", "i", "d"):
            value = getattr(gains, name)
            if value < 0.0 and value != getattr(old, name):
                self._node.log("warn", f"{self._node.namespace}: {name} = {value} drives away from the set point")
        is_idle = gains.i != 0.0 and gains.i_min == gains.i_max == 0.0
        if is_idle and (gains.i != old.i or not self._is_idle):
            self._node.log("warn", f"{self._node.namespace}: i = {gains.i} has no effect without i_clamp")
        self._is_idle = is_idle
        self._write_back(gains)
        self._server.publish()

    def _write_back(self, gains: Gains) -> None:
        """Write the six gain parameters and, if set, i_clamp, which is the upper bound as in the controller's state."""
        values = to_parameters(gains)
        if self._node.has_param("i_clamp"):
            values["i_clamp"] = self._i_clamp = gains.i_max
        self._writing = True
        try:
            for name, value in values.items():
                there = self._node.get_param(name, None)
                if type(there) is not type(value) or there != value:  # `param get` prints 1, 1.0 and true differently
                    self._node.set_param(name, value)
        finally:
            self._writing = False

    def _judge(self, change: ParameterChange) -> None:
        """Refuse a change of the parameters that the PID cannot use."""
        if self._writing:
            return
        check_values(self._node, GAINS, change)
        after = change.after if isinstance(change.after, dict) else {}
        gone = [name for name in to_parameters(self.pid.gains) if name not in after]
        if change.deletes and gone:
            raise Refused(
                f"{self._node.namespace}/{gone[0]} is a gain of a loaded controller and cannot be deleted",
                "unload the controller first: slidectl controller unspawn NAME",
            )

    def _parameters_changed(self) -> None:
        """Use the changed parameters. A gain whose parameter is missing keeps its value, which is written back."""
        if self._writing:
            return
        gains = self._wanted()
        if gains != self.pid.gains:
            self.set_gains(gains)
        else:
            self._write_back(gains)

    def _wanted(self) -> Gains:
        """The gains that the parameters give now. A changed i_clamp sets both bounds.

        At construction i_clamp_min and i_clamp_max take precedence. By the same rule i_clamp would never count here,
        since both are always set by now.
        """
        old = self.pid.gains
        gains = gains_from_parameters(self._node, old)
        i_clamp = params.read(self._node, "i_clamp", NUMBER)
        if i_clamp is None or abs(i_clamp) == self._i_clamp or (gains.i_min, gains.i_max) != (old.i_min, old.i_max):
            return gains
        return gains._replace(i_min=-abs(i_clamp), i_max=abs(i_clamp))

    def _publish_state(self, period_s: float) -> None:
        """Publish control_msgs/PidState after a command that was computed for this period."""
        pid = self.pid
        p_term, i_term, d_term = pid.terms()
        publish_if_wanted(
            self._state,
            lambda: {
                "header": header_of(self._node.now_ns()),
                "timestep": to_stamp(from_seconds(period_s)),
                "error": pid.p_error,
                "error_dot": pid.d_error,
                "p_error": pid.p_error,
                "i_error": pid.i_error,
                "d_error": pid.d_error,
                "p_term": p_term,
                "i_term": i_term,
                "d_term": d_term,
                "i_max": pid.i_max,
                "i_min": pid.i_min,
                "output": pid.command,
            },
        )


def gains_from_parameters(node: NodeHandle, base: Gains | None = None) -> Gains:
    """The gains that the parameters of this namespace give. Missing ones are taken from `base`.

    Raises:
        BadParameter: neither `p` nor `base`. Refused: a gain is not a number.
    """
    if base is None:
        params.needed(node, "p", NUMBER)
    base = base or Gains()
    names = ("p", "i", "d", "i_clamp", "i_clamp_min", "i_clamp_max")
    p, i, d, clamp, lower, upper = (params.read(node, name, NUMBER) for name in names)
    lower, upper = clamp if lower is None else lower, clamp if upper is None else upper
    antiwindup = params.read(node, "antiwindup", BOOLEAN)
    gains = Gains(
        p=base.p if p is None else p,
        i=base.i if i is None else i,
        d=base.d if d is None else d,
        i_max=base.i_max if upper is None else abs(upper),
        i_min=base.i_min if lower is None else -abs(lower),
        antiwindup=base.antiwindup if antiwindup is None else antiwindup,
    )
    for name, value in gains._asdict().items():
        if isnan(value) or (name in ("p", "i", "d") and not isfinite(value)):  # an infinite clamp means no clamp
            raise Refused(f"{node.namespace}: gain {name} must be a number, not {value}")
    return gains


OPTIONS = (
    Option("p", "Proportional gain", 10.0, -100000.0, 100000.0),
    Option("i", "Integral gain", 0.1, -100000.0, 100000.0),
    Option("d", "Derivative gain", 1.0, -1000.0, 1000.0),
    Option("i_clamp_min", "Least integral term", -10.0, -100000.0, 0.0),
    Option("i_clamp_max", "Largest integral term", 10.0, 0.0, 100000.0),
    Option("antiwindup", "Bound the integral itself, not only its contribution", False),
)
"""The gains as options of dynamic_reconfigure."""
_FIELDS = {option.name: option.name.replace("i_clamp", "i") for option in OPTIONS}
"""The name in Gains of each option."""


def to_parameters(gains: Gains) -> Values:
    """The six parameters that hold these gains."""
    return {name: getattr(gains, field) for name, field in _FIELDS.items()}


def gains_of(values: Values) -> Gains:
    """The gains of the six parameters."""
    found: dict[str, Any] = {_FIELDS[name]: value for name, value in values.items()}
    return Gains(**found)
