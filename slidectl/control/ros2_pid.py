"""The PID of control_toolbox 6 (ROS 2): its equation, its state, and gains that are parameters.

It differs from that of ROS 1 (`pid.py`): the output has bounds, the integral part is added before it is integrated, and
the integral is the contribution to the output, already times the gain. `Ros2Pid` uses no parameters and no topics.
`LivePid` reads the gains from parameters, follows changes of these, and publishes the state.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite, isnan, nan, sqrt
from typing import Any, ClassVar, NamedTuple

from slidectl import names
from slidectl.control.duration import from_seconds, header_of, to_stamp
from slidectl.control.node_handle import NodeHandle, ParameterChange, Publisher, publish_if_wanted
from slidectl.control.params import BOOLEAN, NUMBER, Kind, Parameter, described
from slidectl.errors import Refused

NONE, BACK_CALCULATION, CONDITIONAL_INTEGRATION = "none", "back_calculation", "conditional_integration"
STRATEGIES = (NONE, BACK_CALCULATION, CONDITIONAL_INTEGRATION)
"""How the integral is kept from growing while the output is at a bound."""
STRATEGY = Kind(
    f"{NONE}, {BACK_CALCULATION} or {CONDITIONAL_INTEGRATION}", lambda value: value if value in STRATEGIES else None
)
EPSILON = 2.0**-52
"""A shorter period, in s, counts as none; a smaller difference of two outputs as none."""


class Ros2Gains(NamedTuple):
    """Gains in output per error. `u_*` bound the output, `i_clamp_*` the integral part, both in units of the output."""

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    u_clamp_max: float = inf
    u_clamp_min: float = -inf
    i_clamp_max: float = inf
    i_clamp_min: float = -inf
    antiwindup_strategy: str = NONE
    tracking_time_constant: float = 0.0
    """Of back calculation, s. 0: chosen from the gains."""
    error_deadband: float = EPSILON
    """An error of at most this size is not integrated."""

    def checked(self) -> Ros2Gains:
        """The gains with the tracking time constant that is used.

        Raises Refused: gains that the PID cannot use.
        """
        for name in ("p", "i", "d", "tracking_time_constant", "error_deadband"):
            if not isfinite(getattr(self, name)):
                raise Refused(f"{name} must be a finite number, not {getattr(self, name)}")
        for name in ("u_clamp_max", "u_clamp_min", "i_clamp_max", "i_clamp_min"):
            if isnan(getattr(self, name)):
                raise Refused(f"{name} must be a number, not nan")
        if self.u_clamp_min >= self.u_clamp_max:
            raise Refused(f"u_clamp_min {self.u_clamp_min} must be below u_clamp_max {self.u_clamp_max}")
        if self.i_clamp_min > 0.0 or self.i_clamp_max < 0.0:
            text = "i_clamp_min must not be above 0, and i_clamp_max not below"
            raise Refused(f"{text}; they are {self.i_clamp_min} and {self.i_clamp_max}")
        if self.antiwindup_strategy not in STRATEGIES:
            raise Refused(f"antiwindup_strategy must be {STRATEGY.words}, not {self.antiwindup_strategy!r}")
        if self.antiwindup_strategy != BACK_CALCULATION or self.i == 0.0:
            return self
        constant = self.tracking_time_constant
        if constant == 0.0 and self.d == 0.0:
            constant = self.p / self.i
        elif constant == 0.0:
            constant = sqrt(self.d / self.i) if self.d / self.i > 0.0 else nan
        # control_toolbox divides by a 0 that remains here.
        if not constant > 0.0:
            hint = "it is sqrt(d/i), or p/i without d, when it is not set or 0; set it above 0"
            raise Refused("back_calculation needs a tracking_time_constant above 0", hint)
        return self._replace(tracking_time_constant=constant)


class Ros2Pid:
    """Gains and state of one control loop.

    Errors are in units of the controlled quantity, periods in seconds. The state: `i_term`, the integral part of the
    next output; `last_error`, from which the next rate is computed; `error`, `error_dot` and `output` of the last step.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = ("error", "error_dot", "i_term", "last_error", "output")

    def __init__(self, gains: Ros2Gains | None = None) -> None:
        """Raises Refused: gains that the PID cannot use."""
        self.set_gains(gains or Ros2Gains())
        self.i_term = 0.0
        self.reset()

    def set_gains(self, gains: Ros2Gains) -> None:
        """Use other gains from the next step on. The state stays. Raises Refused, and keeps the old ones."""
        self.gains = gains.checked()

    def reset(self, keep_integral: bool = False) -> None:
        """Reset the state, but with `keep_integral` not the integral. The last error is then 0, so that the next output
        contains d * error / dt."""
        self.error = self.error_dot = self.last_error = self.output = 0.0
        if not keep_integral:
            self.i_term = 0.0

    def step(self, error: float, period_s: float) -> float:
        """The output after a period with this error. Its rate is computed from the last error.

        nan for an error that is not finite; the last output for a period of 0. Raises ValueError: a negative period.
        """
        if _is_zero(period_s):
            return self.output
        if not isfinite(error):
            self.output = nan
            return nan
        error_dot = (error - self.last_error) / period_s
        self.last_error = error
        return self.step_with_rate(error, error_dot, period_s)

    def step_with_rate(self, error: float, error_dot: float, period_s: float) -> float:
        """As `step`, with the rate of the error given. The error from which `step` computes a rate stays."""
        if _is_zero(period_s):
            return self.output
        self.error, self.error_dot = error, error_dot
        if not isfinite(error) or not isfinite(error_dot):
            self.output = nan
            return nan
        gains = self.gains
        unbounded = gains.p * error + self.i_term + gains.d * error_dot
        self.output = min(max(unbounded, gains.u_clamp_min), gains.u_clamp_max)
        if abs(error) > gains.error_deadband:
            self._integrate(error, self.output - unbounded, unbounded, period_s)
        self.i_term = min(max(self.i_term, gains.i_clamp_min), gains.i_clamp_max)
        return self.output

    def _integrate(self, error: float, excess: float, unbounded: float, period_s: float) -> None:
        """Change the integral. `excess` is what the bounds added to the unbounded output."""
        gains = self.gains
        if gains.antiwindup_strategy == BACK_CALCULATION:
            if gains.i != 0.0:
                self.i_term += period_s * (gains.i * error + excess / gains.tracking_time_constant)
        elif (
            gains.antiwindup_strategy == NONE
            or abs(excess) <= EPSILON
            or error * unbounded <= 0.0  # integrating leads away from the bound
        ):
            self.i_term += period_s * gains.i * error


def _is_zero(period_s: float) -> bool:
    if period_s < -EPSILON:
        raise ValueError(f"the period of a PID must not be negative: {period_s} s")
    return period_s <= EPSILON


def gain_parameters(error_deadband: float) -> tuple[Parameter, ...]:
    """The declarations of the parameters that `LivePid` reads, with the default of the dead band."""

    def declared(name: str, kind: Any, meaning: str, default: Any, unit: str = "") -> Parameter:
        return Parameter(name, kind, meaning, unit, default=default, live=True)

    return (
        declared("p", NUMBER, "proportional gain", 0.0),
        declared("i", NUMBER, "integral gain", 0.0),
        declared("d", NUMBER, "derivative gain", 0.0),
        declared("u_clamp_max", NUMBER, "upper bound of the output", inf),
        declared("u_clamp_min", NUMBER, "lower bound of the output", -inf),
        declared("i_clamp_max", NUMBER, "upper bound of the integral part; not below 0", inf),
        declared("i_clamp_min", NUMBER, "lower bound of the integral part; not above 0", -inf),
        declared("saturation", BOOLEAN, "the output has bounds; by default if one of them is finite", None),
        declared("antiwindup_strategy", STRATEGY, "keeps the integral from growing at a bound of the output", NONE),
        declared("tracking_time_constant", NUMBER, "of back_calculation; 0: from the gains", 0.0, "s"),
        declared("error_deadband", NUMBER, "an error of at most this size is not integrated", error_deadband),
        declared("activate_state_publisher", BOOLEAN, "publishes slidectl/PidState", False),
    )


class LivePid:
    """A PID, `pid`, whose gains are the parameters in one namespace, now and after each change of them."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("pid",)
    saved_or_none: ClassVar[tuple[str, ...]] = ("_publisher",)

    def __init__(self, node: NodeHandle, gains: str, error_deadband: float, topic: str) -> None:
        """`gains`: the namespace of the gains below that of `node`. `topic`: that of the state, below it too.

        Raises Refused: a parameter has another type, or the PID cannot use the gains.
        """
        self._node = node
        self._parameters = node.child(gains)
        self._declared = {parameter.name: parameter for parameter in gain_parameters(error_deadband)}
        self._topic = topic
        self._publisher: Publisher | None = None
        self.pid = Ros2Pid()
        self._use()
        self._parameters.guard_params(self._judge)
        self._parameters.watch_param(self._parameters.namespace, self._use)

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the state after a step of this period, if the parameters ask for it."""
        if self._is_published and self._publisher is not None:
            publish_if_wanted(self._publisher, lambda: self._message(time_ns, period_s))

    def _message(self, time_ns: int, period_s: float) -> dict[str, Any]:
        pid, gains = self.pid, self.pid.gains
        return {
            "header": header_of(time_ns),
            "timestep": to_stamp(from_seconds(period_s)),
            "error": pid.error,
            "error_dot": pid.error_dot,
            "i_term": pid.i_term,
            "p_gain": gains.p,
            "i_gain": gains.i,
            "d_gain": gains.d,
            "output": pid.output,
        }

    def _use(self) -> None:
        """Use the present parameters. The publisher is advertised when it is wanted for the first time, and stays."""
        self.pid.set_gains(self._gains_of(self._read))
        self._is_published = bool(self._value(self._read, "activate_state_publisher"))
        if self._is_published and self._publisher is None:
            self._publisher = self._node.advertise(self._topic, "slidectl/PidState")

    def _read(self, name: str) -> Any:
        return self._parameters.get_param(name, None)

    def _judge(self, change: ParameterChange) -> None:
        """Refuse a change to gains that the PID cannot use."""
        self._gains_of((change.after if isinstance(change.after, dict) else {}).get)

    def _gains_of(self, read: Callable[[str], Any]) -> Ros2Gains:
        """The gains, of parameters that `read` returns by name. Raises Refused: the PID cannot use them."""
        found = {name: self._value(read, name) for name in Ros2Gains._fields}
        if self._value(read, "saturation") is False:
            found.update(u_clamp_max=inf, u_clamp_min=-inf)
        try:
            return Ros2Gains(**found).checked()
        except Refused as error:
            raise Refused(f"{self._parameters.namespace}: {error}", error.hint) from None

    def _value(self, read: Callable[[str], Any], name: str) -> Any:
        """The value of a parameter, or its default. Raises Refused: it has another type."""
        parameter = self._declared[name]
        value = read(name)
        if value is None:
            return parameter.default
        converted = parameter.kind.convert(value)
        if converted is None:
            where = names.join(self._parameters.namespace, name)
            raise Refused(f"parameter {where} must be {parameter.kind.words}, not {described(value)}")
        return converted
