"""The hardware of a simulated robot, after gazebo_ros_control's DefaultRobotHWSim: joints read, limited and driven.

First one joint with its limits (initSim, registerJointLimits), then how its command drives it (writeSim), then the
robot. `read` and `write` are the hot path: plain tuples and memoryviews, no allocations. It uses no controllers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar

from slidectl.control.angular_distance import distance_with_limits, shortest_angular_distance, unwrapped
from slidectl.control.hardware_interface import (
    COMMAND_INTERFACES,
    ControllerInfo,
    D,
    ForceTorqueSensorInterface,
    ImuSensorInterface,
    JointCommands,
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    RobotHW,
    SensorHandle,
)
from slidectl.control.laws import Columns, law
from slidectl.control.limits import (
    LARGEST,
    NO_LIMITS,
    JointLimits,
    LimitHandle,
    bounded,
    in_order,
    limit_handle,
    limits_from_joint,
    limits_from_parameters,
    soft_limits_from_joint,
    soft_limits_from_parameters,
)
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import BadParameter
from slidectl.control.pid import Pid, ReconfigurablePid, next_command, next_command_from
from slidectl.control.user_classes import is_of_a_user
from slidectl.description import interfaces
from slidectl.description.robot import Joint, Robot, TransmissionInfo, TransmissionJoint
from slidectl.description.sensors import ForceTorque, Imu, Sensor
from slidectl.description.transmissions import driving
from slidectl.errors import Refused, SlidectlError, closest, listing, quoted
from slidectl.physics import sensing
from slidectl.physics.applied_forces import EffortTruncation, truncated
from slidectl.physics.attached_robot import AttachedRobot, JointPlace
from slidectl.physics.builder import BadTransmission, loaded
from slidectl.physics.world import World

S = TypeVar("S", bound=Sensor)

INITIAL_POSITION = 1.0
INITIAL_EFFORT = 1.0
"""Values of a handle before the first read, as in DefaultRobotHWSim. Angles are unwrapped from there."""


class UnsupportedInterface(BadTransmission):
    """A transmission asks for an interface that simulated hardware does not have."""

    def __init__(self, robot: str, transmission: TransmissionInfo, joint: TransmissionJoint) -> None:
        asked = joint.hardware_interfaces[0]
        trouble = f"joint {joint.name!r} requires {asked!r}, which simulated hardware does not have"
        near = closest(asked, [interface.written for interface in interfaces.ALL])
        meant = f"did you mean {near!r}? " if near else ""
        super().__init__(robot, transmission, trouble, f"{meant}it has: {interfaces.KNOWN}")


class MissingJoint(BadTransmission):
    """A transmission drives a joint that does not exist, or that is fixed, planar or floating."""

    def __init__(self, robot: AttachedRobot, transmission: TransmissionInfo, joint: str) -> None:
        super().__init__(
            robot.name, transmission, f"no joint {joint!r} that moves", f"such joints: {listing(robot.joints)}"
        )


class HardwareJoint:
    """A driven joint: its handle, the interface for its commands, and its bounds."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("handle",)
    saved_or_none: ClassVar[tuple[str, ...]] = ("limit",)

    __slots__ = ("handle", "interface", "joint", "limit", "lower", "most_effort", "name", "quantity", "upper")

    def __init__(self, joint: Joint, interface: type[JointCommands]) -> None:
        self.name = joint.name
        self.joint = joint
        self.interface = interface
        self.quantity = interface.declared.quantity
        self.handle = JointHandle(joint.name)
        self.lower, self.upper, self.most_effort = -LARGEST, LARGEST, LARGEST
        """Limits for PIDs and motors: positions in m or rad, effort in N or N·m."""
        self.limit: LimitHandle | None = None
        self.reset()

    def reset(self) -> None:
        """Set the values that a handle has before the first read."""
        handle = self.handle
        handle.position, handle.velocity, handle.effort = INITIAL_POSITION, 0.0, INITIAL_EFFORT
        self.command(0.0)
        if self.limit is not None:
            self.limit.reset()

    def command(self, command: float) -> None:
        """Set the command, and further commands of velocity or acceleration to 0."""
        self.handle.command = command
        for beside in self.interface.declared.beside:
            setattr(self.handle, beside, 0.0)

    def rest(self) -> None:
        """Set the resting command, and discard the past of the limits."""
        self.command(self.resting_command())
        if self.limit is not None:
            self.limit.reset()

    def resting_command(self) -> float:
        """The command that moves the joint least: its position, or a velocity or effort of 0."""
        return self.handle.position if self.quantity == "position" else 0.0

    def written_limits(self) -> JointLimits | None:
        """The limits that the model has; None without any."""
        return limits_from_joint(self.joint)

    def register_limits(self, node: NodeHandle) -> None:
        """Read limits from `<limit>`, then from the parameters `joint_limits/<joint>`, which override them by field.

        Soft limits replace the saturation. Without any limits neither is used.

        Raises SlidectlError: a limit that the interface requires is missing.
        """
        written = self.written_limits()
        limits = limits_from_parameters(node, self.name, written or NO_LIMITS) or written
        if limits is None:
            return
        if limits.has_position_limits:
            self.lower, self.upper = limits.min_position, limits.max_position
        if limits.has_effort_limits:
            self.most_effort = limits.max_effort
        soft = soft_limits_from_parameters(node, self.name) or soft_limits_from_joint(self.joint)
        self.limit = limit_handle(self.interface, self.handle, limits, soft)
        self.handle.lowest, self.handle.highest = self.limit.command_bounds()
        if self.quantity == "effort":  # Gazebo also clips efforts by the URDF, independent of the parameters
            most = EffortTruncation.of(self.joint).effort
            self.handle.lowest, self.handle.highest = max(self.handle.lowest, -most), min(self.handle.highest, most)


def hardware_joints(robot: AttachedRobot) -> list[HardwareJoint]:
    """The joints that transmissions drive, in the order of the file (see `driving`): one for each joint and interface.

    Of several interfaces of a joint only the first counts, with or without its prefix. Of a real transmission all that
    simulated hardware has count, one at a time.

    Raises UnsupportedInterface, MissingJoint: a transmission cannot be simulated.
    """
    joints: list[HardwareJoint] = []
    for transmission, driven in driving(robot.description.transmissions):
        found = [interface for interface in map(interfaces.find, driven.hardware_interfaces) if interface is not None]
        if not found:
            raise UnsupportedInterface(robot.name, transmission, driven)
        try:
            joint = robot.place(driven.name).joint
        except SlidectlError as error:
            raise MissingJoint(robot, transmission, driven.name) from error
        joints += [HardwareJoint(joint, COMMAND_INTERFACES[interface]) for interface in dict.fromkeys(found)]
    return joints


GAINS = "gazebo_ros_control/pid_gains"

REACH = 1.01
"""A position command is reached by a motion if that needs at most this multiple of the velocity limit, else set."""

EFFORT, VELOCITY, LENGTH, REVOLVING, TURNING, VELOCITY_MOTOR, POSITION_MOTOR = range(7)
"""Kinds of drives. EFFORT: the command is the effort. The next four: a PID on the error of a velocity, a length, an
angle between limits, an angle on the circle. The last two: a motor follows a velocity or a position."""


@law
def drive_error(drive: Drive, joint: JointHandle) -> float:
    """Command minus the last measured value. For angles the shortest turn, within the limits if there are any."""
    if drive.kind == VELOCITY:
        return joint.command - joint.velocity
    if drive.kind == REVOLVING:
        return distance_with_limits(joint.position, joint.command, drive.lower, drive.upper)
    if drive.kind == TURNING:
        return shortest_angular_distance(joint.position, joint.command)
    return joint.command - joint.position


@law
def drive_effort(drive: Drive, pid: Pid, joint: JointHandle, period_s: float) -> float:
    """The effort for the joint's command, before it is clipped to the joint's bounds."""
    if drive.kind == EFFORT:
        return joint.command
    return bounded(next_command(pid, drive_error(drive, joint), period_s), -drive.limit, drive.limit)


@law
def motor_velocity(drive: Drive, joint: JointHandle, position: float, step_s: float) -> float:
    """The desired velocity of a motor in the step, which begins at this position; nan: set the joint's position.

    After the step a position joint is at its command, independent of forces. Gazebo sets the position and keeps the
    velocities of the links, so gravity makes these grow without end. Here the joint moves with the velocity that leads
    there, if its velocity limit allows that in one step. For a command farther away, or a joint without velocity limit,
    the position is set, at rest. In both cases a motor without bounds holds it against gravity and contacts.
    """
    if drive.kind == VELOCITY_MOTOR:
        return joint.command
    velocity = (joint.command - position) / step_s
    return velocity if abs(velocity) <= drive.fastest else math.nan


class Drive:
    """Drives one joint by its command, once per step, after the limits are enforced."""

    saved_or_none: ClassVar[tuple[str, ...]] = ("pid",)

    columns = Columns(fixed="kind lower upper limit fastest", places="pid joint", whole="kind pid joint")

    def __init__(self, joint: HardwareJoint, kind: int, pid: Pid | None = None) -> None:
        self.joint = joint
        self.handle = joint.handle
        self.kind = kind
        self.pid = pid
        self.lower, self.upper, self.limit = joint.lower, joint.upper, joint.most_effort
        limit = joint.joint.limit
        self.fastest = -1.0 if limit is None else REACH * limit.velocity
        self.truncation = EffortTruncation.of(joint.joint)
        self._is_motor = kind in (VELOCITY_MOTOR, POSITION_MOTOR)

    def bind(self, world: World, place: JointPlace) -> None:
        """Set the world and the indices of the joint."""
        self._world, self._qpos, self._dof = world, place.qpos, place.dof

    def apply(self, period_s: float, stopped: bool) -> None:
        """Drive the joint for the coming step. `period_s`: seconds since the last call.

        `stopped` is the emergency stop: no effort, no velocity. The hardware then holds position commands.
        """
        if self._is_motor:
            self._ask_motor(stopped)
        elif self.pid is None:
            self._push(0.0 if stopped else self.handle.command)
        else:
            error = -self.handle.velocity if stopped and self.kind == VELOCITY else drive_error(self, self.handle)
            self._push(bounded(self._pid_effort(self.pid, error, period_s), -self.limit, self.limit))

    def _pid_effort(self, pid: Pid, error: float, period_s: float) -> float:
        return pid.compute_command(error, period_s)

    def _velocity(self, position: float, step_s: float) -> float:
        """The desired velocity of a motor in the step; nan to set the joint's position instead."""
        return motor_velocity(self, self.handle, position, step_s)

    def _push(self, effort: float) -> None:
        """Apply an effort like Gazebo's SetForce: clipped to the joint's limits; several in one step add up."""
        qvel, forces = self._world.views.qvel, self._world.views.forces
        forces[self._dof] += self.truncation.cut(effort, qvel[self._dof])

    def _ask_motor(self, stopped: bool) -> None:
        views = self._world.views
        velocity = self._velocity(views.qpos[self._qpos], self._world.timestep)
        if stopped and self.kind == VELOCITY_MOTOR:
            velocity = 0.0
        if math.isnan(velocity):
            views.qpos[self._qpos], views.qvel[self._dof], velocity = self.handle.command, 0.0, 0.0
        views.velocities[self._dof] = velocity


class FeedForwardDrive(Drive):
    """Drive for commands of position, velocity and maybe acceleration: the desired state at the start of the step.

    A motor moves the joint to the position that these reach at the end of the step, within its limits. The largest
    velocity is the velocity limit, or without one it follows from the command. With gains, the velocity error replaces
    the derivative of the error; the acceleration has no effect then, since the inertia is unknown.
    """

    def _pid_effort(self, pid: Pid, error: float, period_s: float) -> float:
        effort = next_command_from(pid, error, self.handle.command_velocity - self.handle.velocity, period_s)
        pid.report(error, period_s)
        return effort

    def _velocity(self, position: float, step_s: float) -> float:
        fastest = self.joint.limit.max_velocity if self.joint.limit is not None else LARGEST
        handle = self.handle
        ahead = bounded(handle.command_velocity + handle.command_acceleration * step_s / 2.0, -fastest, fastest)
        velocity = (bounded(handle.command + ahead * step_s, self.lower, self.upper) - position) / step_s
        most = self.fastest if self.fastest >= 0.0 else 2.0 * abs(ahead)
        return velocity if abs(velocity) <= most else math.nan


_POSITION_KINDS = {"revolute": REVOLVING, "continuous": TURNING}


def drive_for(joint: HardwareJoint, node: NodeHandle) -> Drive:
    """The drive of a joint's interface: with a PID where `gazebo_ros_control/pid_gains/<joint>/p` is a number."""
    if joint.quantity == "effort":
        return Drive(joint, EFFORT)
    pid = _pid_of(joint, node)
    if joint.quantity == "velocity":
        return Drive(joint, VELOCITY_MOTOR if pid is None else VELOCITY, pid)
    drive = FeedForwardDrive if joint.interface.declared.beside else Drive
    return drive(joint, POSITION_MOTOR if pid is None else _POSITION_KINDS.get(joint.joint.type, LENGTH), pid)


def _pid_of(joint: HardwareJoint, node: NodeHandle) -> Pid | None:
    gains = node.child(f"{GAINS}/{joint.name}")
    if not gains.has_param("p"):
        node.log("info", f"joint {joint.name!r} is driven without PID: no gains at {gains.namespace}")
        return None
    try:
        return ReconfigurablePid(gains).pid
    except BadParameter as error:
        node.log("error", f"joint {joint.name!r} is driven without PID: {error}")
        return None


class ActuatorState(NamedTuple):
    """State of an actuator, on its side: position in m or rad, velocity in m/s or rad/s, effort in N or N·m."""

    name: str
    position: float
    velocity: float
    effort: float


class RealTransmission:
    """A transmission whose actuators limit the joint efforts. Their rotors are in the model (builder.py)."""

    def __init__(self, robot: AttachedRobot, info: TransmissionInfo) -> None:
        """Raises BadTransmission: the loaders of ros_control refuse it."""
        self._maths, joints, self._actuators = loaded(robot.description, robot.name, info)
        self.joints = [joint.name for joint in joints]
        self._most = [actuator.max_effort for actuator in self._actuators]
        self.is_limited = min(self._most) < math.inf
        self.bind(robot)

    def bind(self, robot: AttachedRobot) -> None:
        """Find the joints after a rebuild of the model."""
        self._dofs = [robot.place(joint).dof for joint in self.joints]

    def most_effort(self, joint: str) -> float:
        """The largest effort on a joint that all actuators can give together, N or N·m."""
        at, size = self.joints.index(joint), len(self._most)
        units = [[float(row == column) for row in range(size)] for column in range(size)]
        gains = [abs(self._maths.joint_effort(unit)[at]) for unit in units]
        return float(sum(gain * most for gain, most in zip(gains, self._most, strict=True) if gain))

    def bound(self, forces: memoryview[float]) -> None:
        """Clip the joint efforts of the step, by dof, so that each actuator is within its limit.

        When no actuator exceeds its limit, the efforts stay the same to the bit.
        """
        asked = self._maths.actuator_effort([forces[dof] for dof in self._dofs])
        given = [max(-most, min(effort, most)) for effort, most in zip(asked, self._most, strict=True)]
        if given != asked:
            for dof, effort in zip(self._dofs, self._maths.joint_effort(given), strict=True):
                forces[dof] = effort

    def states(self, handles: Mapping[str, JointStateHandle]) -> Sequence[ActuatorState]:
        """The states of the actuators, computed from the joint states of the last read."""
        joints = [handles[joint] for joint in self.joints]
        positions = self._maths.actuator_position([joint.position for joint in joints])
        velocities = self._maths.actuator_velocity([joint.velocity for joint in joints])
        efforts = self._maths.actuator_effort([joint.effort for joint in joints])
        names = [actuator.name for actuator in self._actuators]
        return [ActuatorState(*row) for row in zip(names, positions, velocities, efforts, strict=True)]


_Measured = tuple[JointHandle, int, int]
"""Handle, index into qpos, index into qvel and forces."""
_Pushed = tuple[JointHandle, int, float, float]
"""Handle, index into qvel and forces, effort limit, velocity limit."""


class DrivenJoint(NamedTuple):
    """A joint with a transmission: indices into qpos and into qvel and forces, and whether it is an angle.

    `is_pushed`: its command is the effort, within the bounds. Else a drive makes efforts of it.
    """

    handle: JointHandle
    qpos: int
    dof: int
    turns: bool
    is_pushed: bool
    max_effort: float
    max_velocity: float


class MujocoRobotHW(RobotHW):
    """Joint states, and commands of the joints that have a transmission, through the interfaces that it asks for.

    All interfaces exist always, even empty. `node` is the robot's: limits are read from `joint_limits/<joint>` and
    gains from `gazebo_ros_control/pid_gains/<joint>` in it.

    Raises:
        UnsupportedInterface, MissingJoint: a transmission cannot be simulated. Refused: limits that no handle takes.
    """

    how_to_drive = (
        "has no <transmission> in the model, so nothing can command it; a <transmission> names the joint and its "
        "<hardwareInterface>"
    )
    """What a joint lacks that no controller can command, as the rest of a sentence."""

    def __init__(self, world: World, attached: AttachedRobot, robot: Robot, node: NodeHandle, namespace: str) -> None:
        super().__init__()
        self.robot = robot
        self._world = world
        self._applied_forces = world.applied_forces
        self._attached = attached
        self._places: dict[str, JointPlace] = {}
        self._offered, self._joints = self._made_joints()
        """All joints with each of their interfaces, and those that are driven now, each through one interface."""
        node = node if node.namespace == namespace else node.child(namespace)
        self._register(node)
        self._transmissions = tuple(RealTransmission(attached, info) for info in robot.transmissions if info.is_real)
        self._limited = tuple(transmission for transmission in self._transmissions if transmission.is_limited)
        self._most = {joint: gears.most_effort(joint) for gears in self._limited for joint in gears.joints}
        drives = {joint: self._made_drive(joint, node) for joint in self._offered if not self._is_pushed(joint)}
        self._drive_of = drives
        self._held: list[float] | None = None
        self._estop = False
        self.engage()
        attached.on_rebound(self._bind)
        # CPython creates an object's dict at the first call of `vars`, and its attributes are then slower: `read` and
        # `write` take a third longer. So `vars` is never called on our own class.
        self._inherited = frozenset(vars(self)) | {"_inherited"} if is_of_a_user(type(self)) else None
        """Names of the attributes that a user's class inherits; None for our own class."""
        self.init(node)

    def _made_joints(self) -> tuple[list[HardwareJoint], list[HardwareJoint]]:
        """All joints with each of their interfaces, and those of them that are driven at first."""
        offered = hardware_joints(self._attached)
        first = {joint.name: joint for joint in reversed(offered)}
        are_real = any(transmission.is_real for transmission in self.robot.transmissions)
        return offered, [joint for joint in offered if not are_real or first[joint.name] is joint]

    def _made_drive(self, joint: HardwareJoint, node: NodeHandle) -> Drive:
        return drive_for(joint, node)

    def init(self, node: NodeHandle) -> None:
        """Hook for users' classes, called once at the spawn: get parameters and topics. `node`: the robot's."""

    def about_joint(self, name: str) -> str:
        joint = self.robot.joints.get(name)
        if joint is None:
            return f"the model has no joint {quoted(name)}; it has: {listing(self._attached.joints)}"
        if name not in self._attached.joints:
            return f"joint {quoted(name)} is {joint.type}: it does not move, so nothing can command it"
        if not any(offered.name == name for offered in self._offered):
            return f"joint {quoted(name)} {self.how_to_drive}"
        return super().about_joint(name)

    def joint_state(self, joint: str) -> tuple[float, float, float]:
        """Position, velocity and effort of any moving joint, of the last step. Raises UnknownName."""
        return self._world.joint_state(self._attached.name, joint)

    def joint_effort(self, joint: str) -> float:
        """The hardware's effort on a joint in the coming step. Raises UnknownName."""
        return self._world.views.forces[self._attached.place(joint).dof]

    def set_joint_effort(self, joint: str, effort: float) -> None:
        """Replace the effort after `write`. On a joint without transmission it stays. Raises UnknownName."""
        self._world.views.forces[self._attached.place(joint).dof] = effort

    def engage(self) -> None:
        """Set up drives, limits and motors for the present interfaces of the joints."""
        self._enforce = tuple(limit.enforce for limit in self.limits())
        self.drives = tuple(self._drive_of[joint] for joint in self._joints if not self._is_pushed(joint))
        """The drives of the joints that are not pushed, in the order in which `write` applies them."""
        motors = {}
        for drive in self.drives:
            name = drive.joint.name
            if drive.kind == POSITION_MOTOR:  # no bound: positions are held with any effort
                motors[name] = math.inf
            elif drive.kind == VELOCITY_MOTOR:
                motors[name] = min(drive.limit, self._most.get(name, math.inf))
        if motors or self._applied_forces.motors.of_robot(self._attached.name):
            self._world.set_motors(self._attached, motors)
        self.estop = self._estop
        self._places = {}
        self._bind()

    # -- the cycle -------------------------------------------------------------------------------------------------

    def read(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002 - the interface of all hardware
        """Copy positions, velocities and the efforts of the last step to the handles. Angles are unwrapped."""
        qpos, qvel, forces = self._qpos, self._qvel, self._forces
        for handle, place, dof in self._sliding:
            handle.position = qpos[place]
            handle.velocity = qvel[dof]
            handle.effort = forces[dof]
        for handle, place, dof in self._turning:
            handle.position = unwrapped(handle.position, qpos[place])
            handle.velocity = qvel[dof]
            handle.effort = forces[dof]
        if self._applied_forces.has_efforts:
            efforts = self._efforts
            for handle, _, dof in (*self._sliding, *self._turning):
                handle.effort += efforts[dof]

    def write(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002 - the interface of all hardware
        """Enforce the limits on the commands, then drive the joints."""
        if self._is_special:
            self._hold_positions()
        for enforce in self._enforce:
            enforce(period_s)
        qvel, forces = self._qvel, self._forces
        for handle, dof, max_effort, max_velocity in self._pushed:
            forces[dof] = truncated(handle.command, qvel[dof], max_effort, max_velocity)
        if self._is_special:
            self._drive(period_s)

    # -- everything else -------------------------------------------------------------------------------------------

    @property
    def estop(self) -> bool:
        """Emergency stop. True: efforts are zero, velocities are braked, positions are held. Controllers still run."""
        return self._estop

    @estop.setter
    def estop(self, stopped: bool) -> None:
        self._estop = stopped
        self._is_special = stopped or bool(self.drives) or bool(self._limited)
        if not stopped:
            self._held = None

    @property
    def has_compiled_form(self) -> bool:
        """False for joints with several interfaces and actuators with limits, which only the interpreter supports."""
        return len(self._offered) == len(self._joints) and not self._limited

    def do_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> None:  # noqa: ARG002
        """Switch joints with several interfaces to those that the controllers claim. The joints start at rest."""
        claims = {
            (of.hardware_interface, name) for one in start for of in one.claimed_resources for name in of.resources
        }
        claimed = [joint for joint in self._offered if (joint.interface.type_name, joint.name) in claims]
        new = [joint for joint in claimed if joint not in self._joints]
        if not new:
            return
        names = {joint.name for joint in new}
        self._joints = [
            joint for joint in self._offered if joint in new or (joint in self._joints and joint.name not in names)
        ]
        for joint in new:
            joint.rest()
            drive = self._drive_of.get(joint)
            if drive is not None and drive.pid is not None:
                drive.pid.reset()
        self._held = None
        self.engage()

    def interfaces(self) -> dict[str, str]:
        """The interface of each joint's commands now."""
        return {joint.name: joint.interface.declared.written for joint in self._joints}

    def actuator_states(self) -> list[ActuatorState]:
        """The states of the actuators of all real transmissions, by the last read."""
        handles = {joint.name: joint.handle for joint in self._joints}
        return [state for transmission in self._transmissions for state in transmission.states(handles)]

    def handles(self, joint: str) -> list[JointHandle]:
        """The handles of a joint, one for each interface. The first is the one that drives it now."""
        now = [one.handle for one in self._joints if one.name == joint]
        return now + [one.handle for one in self._offered if one.name == joint and one not in self._joints]

    def commands(self, joint: str) -> list[tuple[JointHandle, str]]:
        """For each command of the joint now: the handle and the name of the attribute."""
        return next(one.interface.commands_of(one.handle) for one in self._joints if one.name == joint)

    def driven(self) -> list[DrivenJoint]:
        """All joints that have a command, with their indices, valid until the next rebuild."""
        driven = []
        for joint in self._joints:
            place, bounds = self._attached.place(joint.name), EffortTruncation.of(joint.joint)
            turns, is_pushed = joint.joint.type != "prismatic", self._is_pushed(joint)
            driven.append(
                DrivenJoint(joint.handle, place.qpos, place.dof, turns, is_pushed, bounds.effort, bounds.velocity)
            )
        return driven

    def limits(self) -> list[LimitHandle]:
        """The limit handles in the order in which `write` enforces them."""
        return in_order(joint.limit for joint in self._joints if joint.limit is not None)

    def resting_commands(self, claims: Iterable[tuple[str, str]], hold: bool) -> dict[tuple[str, str], float]:
        """The commands that release joints, or with `hold` keep their positions, by interface and joint.

        Raises Refused: the interface cannot do that. An effort of 0 does not hold, a position of 0 is a motion.
        """
        commands = {}
        for kind, name in claims:
            joint = next((one for one in self._joints if (one.interface.type_name, one.name) == (kind, name)), None)
            if joint is None:
                continue  # another interface drives the joint now
            if hold and joint.quantity == "effort":
                raise Refused(
                    f"{name} is commanded by its effort, which cannot hold it without a controller",
                    "leave a controller of positions running, or let the joint go: --zero",
                )
            if not hold and joint.quantity == "position":
                raise Refused(
                    f"{name} is commanded by its position: zero would move it to 0",
                    "it holds its last command by itself; --hold lets it stay where it is",
                )
            commands[kind, name] = joint.resting_command()
        return commands

    def command(self, commands: Mapping[tuple[str, str], float]) -> None:
        """Set commands, by interface and joint, that stay until a controller writes others."""
        for joint in self._joints:
            if (claim := (joint.interface.type_name, joint.name)) in commands:
                joint.command(commands[claim])

    def stay(self, positions: Mapping[str, float]) -> None:
        """Command these positions to the joints that take position commands, since the joints were set there."""
        for joint in self._offered:
            if joint.quantity == "position" and joint.name in positions:
                joint.command(positions[joint.name])
                if joint.limit is not None:  # it counts from the last command
                    joint.limit.reset()

    def reset(self) -> None:
        """Reset after a reset of the world: handles, commands, limits and PIDs."""
        for joint in self._offered:
            joint.reset()
        for drive in self._drive_of.values():
            if drive.pid is not None:
                drive.pid.reset()
        self._held = None
        self.stay(self._attached.start)
        self.read(0, 0.0)

    def save_state(self) -> dict[str, Any]:
        """The state for a snapshot. `own` are the attributes of a user's class."""
        return {
            "joints": self._offered,
            "drives": list(self._drive_of.values()),
            "driven": [self._offered.index(joint) for joint in self._joints],
            "held": self._held,
            "estop": self._estop,
            "own": {}
            if self._inherited is None
            else {name: value for name, value in vars(self).items() if name not in self._inherited},
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore the state. The numbers of joints and drives are already restored."""
        driven = [self._offered[index] for index in state["driven"]]
        has_other_joints, self._joints = driven != self._joints, driven
        self._estop, self._held = state["estop"], state["held"]
        if has_other_joints:
            self.engage()
        self.estop = self._estop
        if state["own"]:
            vars(self).update(state["own"])

    def _register(self, node: NodeHandle) -> None:
        states = JointStateInterface()
        commands = {kind: kind() for kind in COMMAND_INTERFACES.values()}
        for joint in self._offered:
            states.register_handle(joint.handle)
            if joint.interface in commands:
                commands[joint.interface].register_handle(joint.handle)
            joint.register_limits(node)
        self.register_interface(states)
        self.register_interface(ImuSensorInterface(self._sensors(Imu, sensing.imu)))
        self.register_interface(ForceTorqueSensorInterface(self._sensors(ForceTorque, sensing.force_torque)))
        for interface in commands.values():
            self.register_interface(interface)

    def _sensors(self, kind: type[S], measure: Callable[[World, str, S, int], D]) -> Iterator[SensorHandle[D]]:
        """Handles of the model's sensors of a kind. They measure only when called."""

        def handle(sensor: S) -> SensorHandle[D]:
            world, robot = self._world, self._attached.name
            return SensorHandle(sensor.name, sensor.frame, lambda: measure(world, robot, sensor, world.clock()))

        return (handle(sensor) for sensor in self.robot.sensors if isinstance(sensor, kind))

    def _is_pushed(self, joint: HardwareJoint) -> bool:
        """True for effort joints, except those that several transmissions drive: these efforts add up."""
        alone = joint not in self._joints or sum(other.name == joint.name for other in self._joints) == 1
        return alone and joint.quantity == "effort"

    def _bind(self) -> None:
        """Use the data of a rebuilt model, and find the joints again if their indices have changed."""
        self._qpos, self._qvel, self._forces, self._efforts, _ = self._world.views
        for drive in self.drives:
            drive.bind(self._world, self._attached.place(drive.joint.name))
        if self._places is not self._attached.joints:
            self._places = self._attached.joints
            self._find_joints()

    def _find_joints(self) -> None:
        self._driven = tuple({self._attached.place(drive.joint.name).dof for drive in self.drives})
        sliding: list[_Measured] = []
        turning: list[_Measured] = []
        for transmission in self._transmissions:
            transmission.bind(self._attached)
        for joint in self._offered:
            place = self._attached.place(joint.name)
            group = sliding if joint.joint.type == "prismatic" else turning
            group.append((joint.handle, place.qpos, place.dof))
        self._sliding, self._turning = tuple(sliding), tuple(turning)
        self._pushed: tuple[_Pushed, ...] = tuple(
            (joint.handle, joint.dof, joint.max_effort, joint.max_velocity)
            for joint in self.driven()
            if joint.is_pushed
        )

    def _drive(self, period_s: float) -> None:
        """Apply the drives and the actuator limits. In an emergency stop, clear the efforts of pushed joints."""
        if self._estop:
            for _, dof, _, _ in self._pushed:
                self._forces[dof] = 0.0
        for dof in self._driven:
            self._forces[dof] = 0.0
        for drive in self.drives:
            drive.apply(period_s, self._estop)
        for transmission in self._limited:
            transmission.bound(self._forces)

    def _hold_positions(self) -> None:
        """During an emergency stop, command the positions that were read at its beginning."""
        if self._estop and self._held is None:
            self._held = [joint.handle.position for joint in self._joints]
        for joint, position in zip(self._joints, self._held or (), strict=False):
            if joint.quantity == "position":
                joint.command(position)
