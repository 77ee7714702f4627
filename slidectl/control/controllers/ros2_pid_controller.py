"""One PID for each degree of freedom, as in ros2_controllers. It can follow others in a chain.

command = pid(reference - state) + feed-forward. The feed-forward is the gain times the reference; with two interfaces
it is the gain times the rate. It is outside the bounds of the output. A command stays as it is while its reference or
state is not finite, and when the controller stops. There is no timeout.

References come on `reference` (control_msgs/MultiDOFCommand) and stay until the next ones; nan leaves a reference as it
is. With `use_external_measured_states` the states come on `measured_state` (the same type). Each update publishes
`controller_state` (control_msgs/MultiDOFStateStamped), and, where `activate_state_publisher` is true, the state of a
PID on `JOINT/pid_state` (slidectl/PidState). In a chain the references come from the handles `CONTROLLER/JOINT` alone.

The PID is that of control_toolbox for ROS 2: output = p error + integral + d error_dot, within `u_clamp_min` and
`u_clamp_max`; then the integral grows by i error dt, within `i_clamp_min` and `i_clamp_max`. With `back_calculation` it
also grows by dt (output - unbounded output) / `tracking_time_constant`; with `conditional_integration` it does not grow
while that would lead further beyond a bound.
"""

from __future__ import annotations

from math import isfinite, isinf, isnan, nan
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.angular_distance import shortest_angular_distance
from slidectl.control.controller_interface import MissingInterface, MultiInterfaceController, State
from slidectl.control.duration import header_of
from slidectl.control.hardware_interface import (
    AnyInterface,
    ClaimedResources,
    EffortJointInterface,
    JointCommandInterface,
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    PositionJointInterface,
    RobotHW,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import warn_of_other_joints
from slidectl.control.node_handle import Message, NodeHandle, publish_if_wanted
from slidectl.control.params import BOOLEAN, NUMBER, TEXTS, Kind, Parameter, within
from slidectl.control.registry import ros2_controller
from slidectl.control.ros2_pid import LivePid, gain_parameters
from slidectl.errors import MessageRefused, Refused, listing

INTERFACES: dict[str, type[JointCommandInterface]] = {
    "position": PositionJointInterface,
    "velocity": VelocityJointInterface,
    "effort": EffortJointInterface,
}


def _as_quantities(value: Any) -> list[str] | None:
    """A list of one or two different interfaces; None for other values."""
    names = params.as_texts(value) or []
    return names if len(names) == len(set(names)) in (1, 2) and set(names) <= set(INTERFACES) else None


QUANTITY = Kind("position, velocity or effort", lambda value: value if value in tuple(INTERFACES) else None)
QUANTITIES = Kind("a list of one or two of position, velocity and effort", _as_quantities)

_WARNING_PERIOD_NS = 1_000_000_000
_DEADBAND = 1e-16
_COMMANDED = Parameter("dof_names", TEXTS, "the joints that it commands", required=True, names_joints=True)
_CONTROLLED = Parameter(
    "reference_and_state_dof_names", TEXTS, "the joints whose states it controls, in the same order; those by default"
)
_COMMAND = Parameter("command_interface", QUANTITY, "what it commands", required=True)
_QUANTITIES = Parameter(
    "reference_and_state_interfaces",
    QUANTITIES,
    "what it controls; a second one is the rate of the first",
    required=True,
)
_HOLDS = Parameter(
    "set_current_state_as_first_setpoint", BOOLEAN, "the first references are the present states", default=True
)
_EXTERNAL = Parameter(
    "use_external_measured_states", BOOLEAN, "the states come from ~/measured_state, not from joints", default=False
)
_OPTIONS = (
    Parameter(
        "feedforward_gain", NUMBER, "gain of the reference, or of its rate if there is one", default=0.0, live=True
    ),
    Parameter("angle_wraparound", BOOLEAN, "the error is the shortest turn", default=False, live=True),
    Parameter("save_i_term", BOOLEAN, "a start keeps the integral part", default=True, live=True),
)


class Dof:
    """One degree of freedom: its PID, the commanded joint, the references, and the state that is controlled."""

    def __init__(self, name: str, command: JointHandle, state: JointStateHandle | None, quantities: list[str]) -> None:
        """`state`: the handle of the measured state; None when it comes from a topic."""
        self.name = name
        self.command = command
        self.state = state
        self.quantities = quantities
        self.references = [JointHandle(name, nan, nan, nan, nan) for _ in quantities]
        self.shown = JointStateHandle(name, nan, nan, nan)
        """The exported state."""
        self.received = [nan for _ in quantities]
        """The references of the last message, until an update uses them; nan: none."""
        self.measured = [nan for _ in quantities]
        """The controlled state: a value for each interface."""
        self.feedforward_gain = 0.0
        self.wraps = False
        self.keeps_integral = True

    def measure(self) -> None:
        """Read the controlled state from the joint, unless it comes from a topic, and write it to exported handles."""
        state = self.state
        if state is not None:
            self.measured = [getattr(state, quantity) for quantity in self.quantities]
        for handle in (self.shown, *self.references):
            if state is not None:
                handle.position, handle.velocity, handle.effort = state.position, state.velocity, state.effort
            for quantity, value in zip(self.quantities, self.measured, strict=True):
                setattr(handle, quantity, value)

    def error(self) -> float:
        """Reference minus measurement; the shortest turn for an angle that wraps around."""
        reference, measured = self.references[0].command, self.measured[0]
        if self.wraps and isfinite(reference) and isfinite(measured):
            return shortest_angular_distance(measured, reference)
        return reference - measured


@ros2_controller("pid_controller/PidController")
class Ros2PidController(MultiInterfaceController):
    """command = pid(reference - state) + feed-forward, for each degree of freedom."""

    interface_types: ClassVar[tuple[type[AnyInterface], ...]] = (*INTERFACES.values(), JointStateInterface)
    allow_optional_interfaces = True
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(_COMMANDED, _CONTROLLED, _COMMAND, _QUANTITIES, _HOLDS, _EXTERNAL),
        *within("gains/<joint>", (*gain_parameters(_DEADBAND), *_OPTIONS)),
    )

    def init(self, hw: RobotHW, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter is missing or wrong, or a joint is missing."""
        self._node = node
        commanded, controlled, quantities = _names(node)
        self._holds = params.value_of(node, _HOLDS)
        is_external = params.value_of(node, _EXTERNAL)
        commands = _needed(hw, INTERFACES[params.value_of(node, _COMMAND)])
        states = None if is_external else _needed(hw, JointStateInterface)
        self._dofs = [
            Dof(name, commands.get_handle(joint), None if states is None else states.get_handle(name), quantities)
            for joint, name in zip(commanded, controlled, strict=True)
        ]
        self.exported_references = [
            (INTERFACES[quantity], dof.references[k]) for k, quantity in enumerate(quantities) for dof in self._dofs
        ]
        self.exported_states = [dof.shown for dof in self._dofs]
        self._pids = [LivePid(node, f"gains/{joint}", _DEADBAND, f"{joint}/pid_state") for joint in commanded]
        self._commanded = commanded
        self._read_options()
        node.watch_param("gains", self._read_options)
        warn_of_other_joints(node, "gains", [name.partition("/")[0] for name in commanded])
        self._states = node.advertise("controller_state", "control_msgs/MultiDOFStateStamped")
        self._last_warning_ns = -_WARNING_PERIOD_NS
        node.subscribe("reference", "control_msgs/MultiDOFCommand", self._receive)
        if is_external:
            node.subscribe("measured_state", "control_msgs/MultiDOFCommand", self._receive_state)

    def _claim(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> tuple[ClaimedResources, ...]:
        """Only the claims of the interface that it commands."""
        return tuple(claim for claim in super()._claim(hw, root, node) if claim.resources)

    def _read_options(self) -> None:
        for joint, dof in zip(self._commanded, self._dofs, strict=True):
            gain, wraps, keeps = within(f"gains/{joint}", _OPTIONS)
            dof.feedforward_gain = params.value_of(self._node, gain)
            dof.wraps = params.value_of(self._node, wraps)
            dof.keeps_integral = params.value_of(self._node, keeps)

    def starting(self, time_ns: int) -> None:
        """Set the references to the present states, or to nan, and reset the PIDs."""
        for dof, live in zip(self._dofs, self._pids, strict=True):
            # ROS 2 shows nan until the first update. A preceding controller that begins with the state needs it now.
            dof.measure()
            for reference, value in zip(dof.references, dof.measured, strict=True):
                reference.command = value if self._holds else nan
            live.pid.reset(keep_integral=dof.keeps_integral)

    def update(self, time_ns: int, period_s: float) -> None:
        for dof, live in zip(self._dofs, self._pids, strict=True):
            if not self.is_chained:
                _take(dof)
            dof.measure()
            _command(dof, live, period_s)
            live.publish(time_ns, period_s)
        publish_if_wanted(self._states, lambda: self._message(time_ns, period_s))

    def _message(self, time_ns: int, period_s: float) -> Message:
        """The state as control_msgs/MultiDOFStateStamped. An output is the present command, which may be an old one."""
        found = []
        for dof in self._dofs:
            measured, references = dof.measured, [handle.command for handle in dof.references]
            has_rate = len(measured) > 1
            found.append(
                {
                    "name": dof.name,
                    "reference": references[0],
                    "feedback": measured[0],
                    "feedback_dot": measured[1] if has_rate else 0.0,
                    "error": dof.error(),
                    "error_dot": references[1] - measured[1] if has_rate else 0.0,
                    "time_step": period_s,
                    "output": dof.command.command,
                }
            )
        return {"header": header_of(time_ns), "dof_states": found}

    def _receive(self, message: Message) -> None:
        """Keep the references of a message for the next update; nan leaves a reference as it is."""
        values = self._values_of(message, "reference")
        if self.is_chained and self.state is State.RUNNING:
            self._warn("other controllers write its references: the message has no effect")
            return
        for dof, one in zip(self._dofs, values, strict=True):
            if not isnan(one[0]):
                dof.received = one

    def _receive_state(self, message: Message) -> None:
        """Use the measured states of a message from now on."""
        for dof, values in zip(self._dofs, self._values_of(message, "measured_state"), strict=True):
            dof.measured = values

    def _values_of(self, message: Message, topic: str) -> list[list[float]]:
        """The values of a message in the order of the degrees of freedom: for each one a value for each interface.

        Raises MessageRefused: wrong names, a wrong number of values, or an infinite one.
        """
        names, values, rates = (list(message[key]) for key in ("dof_names", "values", "values_dot"))
        known = [dof.name for dof in self._dofs]
        wrong = ""
        if names and sorted(names) != sorted(known):
            wrong = f"it names {listing(names)}"
        elif len(values) != len(known):
            wrong = f"it has {len(values)} values"
        elif len(self._dofs[0].quantities) > 1 and len(rates) not in (0, len(known)):
            wrong = f"it has {len(rates)} values_dot"
        elif any(map(isinf, (*values, *rates))):
            wrong = "a value is infinite"
        if wrong:
            text = f"{self._node.namespace}/{topic} takes a finite value for each of {listing(known)}, and {wrong}"
            self._node.log("error", text)
            raise MessageRefused(text)
        if not names:
            self._warn(f"a message on {topic} has no dof_names: its values are taken in the order of {listing(known)}")
        order = [names.index(name) for name in known] if names else range(len(known))
        both = [values, rates or [nan] * len(known)][: len(self._dofs[0].quantities)]
        return [[one[place] for one in both] for place in order]

    def _warn(self, text: str) -> None:
        """Log a warning, at most once per second."""
        now_ns = self._node.now_ns()
        if not 0 <= now_ns - self._last_warning_ns < _WARNING_PERIOD_NS:
            self._last_warning_ns = now_ns
            self._node.log("warn", f"{self._node.namespace}: {text}")


def _take(dof: Dof) -> None:
    """Use the references of the last message, which acts once."""
    if not isnan(dof.received[0]):
        for reference, value in zip(dof.references, dof.received, strict=True):
            if not isnan(value):
                reference.command = value
        dof.received = [nan] * len(dof.received)


def _command(dof: Dof, live: LivePid, period_s: float) -> None:
    """Set the command. It stays as it is while the reference or the state is not finite."""
    references, measured = [handle.command for handle in dof.references], dof.measured
    if not isfinite(references[0]) or not isfinite(measured[0]):
        return
    error = dof.error()
    if len(references) == 1:
        ahead = dof.feedforward_gain * references[0]
    else:
        ahead = dof.feedforward_gain * references[1] if isfinite(references[1]) else 0.0
    if len(references) > 1 and isfinite(references[1]) and isfinite(measured[1]):
        output = live.pid.step_with_rate(error, references[1] - measured[1], period_s)
    else:
        output = live.pid.step(error, period_s)
    dof.command.command = ahead + output


def _needed(hw: RobotHW, interface_type: type[AnyInterface]) -> AnyInterface:
    """The interface of that type. Raises MissingInterface."""
    found: AnyInterface | None = hw.get(interface_type)
    if found is None:
        raise MissingInterface(interface_type.type_name, hw)
    return found


def _names(node: NodeHandle) -> tuple[list[str], list[str], list[str]]:
    """The commanded joints, the controlled ones, and the controlled quantities. Raises SlidectlError."""
    commanded: list[str] = params.value_of(node, _COMMANDED)
    controlled: list[str] = params.value_of(node, _CONTROLLED) or commanded
    quantities: list[str] = params.value_of(node, _QUANTITIES)
    for parameter, found in ((_COMMANDED, commanded), (_CONTROLLED, controlled)):
        if not found or len(set(found)) < len(found):
            raise Refused(f"parameter {node.namespace}/{parameter.name} must name joints, none of them twice")
    if len(controlled) != len(commanded):
        text = f"{len(controlled)} entries, and {_COMMANDED.name} has {len(commanded)}"
        raise Refused(f"parameter {node.namespace}/{_CONTROLLED.name} has {text}: each joint needs one")
    return commanded, controlled, quantities
