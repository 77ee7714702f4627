"""The hardware of a simulated robot, after gazebo_ros_control's DefaultRobotHWSim: joints read, limited and driven.

First one joint with its limits (initSim, registerJointLimits), then how its command drives it (writeSim), then the
robot. `read` and `write` are the hot path: plain tuples and memoryviews, nothing allocated. It knows no controllers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from slidectl.control.angular_distance import distance_with_limits, shortest_angular_distance, unwrapped
from slidectl.control.hardware_interface import (
    COMMAND_INTERFACES,
    D,
    EffortJointInterface,
    ForceTorqueSensorInterface,
    ImuSensorInterface,
    JointCommandInterface,
    JointHandle,
    JointStateInterface,
    PositionJointInterface,
    RobotHW,
    SensorHandle,
    command_interface,
)
from slidectl.control.laws import Columns, law
from slidectl.control.limits import (
    LARGEST,
    NO_LIMITS,
    LimitHandle,
    bounded,
    in_order,
    limit_handle,
    limits_from_joint,
    limits_from_parameters,
    soft_limits_from_joint,
)
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import BadParameter
from slidectl.control.pid import Pid, next_command
from slidectl.control.reconfigurable_pid import ReconfigurablePid
from slidectl.description.robot import ForceTorque, Imu, Joint, Robot, Sensor, TransmissionInfo, TransmissionJoint
from slidectl.description.transmissions import SIMULATED_INTERFACES, driving
from slidectl.errors import Refused, SlidectlError, listing
from slidectl.physics import sensing
from slidectl.physics.body import Body, JointPlace
from slidectl.physics.builder import BadPart
from slidectl.physics.loads import EffortTruncation, truncated
from slidectl.physics.world import World

S = TypeVar("S", bound=Sensor)

INITIAL_POSITION = 1.0
INITIAL_EFFORT = 1.0
"""What a handle holds before the first read, as in DefaultRobotHWSim; angles are unwrapped from there."""


class BadTransmission(BadPart, Refused):
    """A transmission that simulated hardware cannot do."""

    kind = "transmission"


class UnsupportedInterface(BadTransmission):
    """A transmission asks for an interface that simulated hardware has not."""

    def __init__(self, robot: str, transmission: TransmissionInfo, joint: TransmissionJoint) -> None:
        asked = joint.hardware_interfaces[0]
        trouble = f"joint {joint.name!r} asks for {asked!r}, which simulated hardware has not"
        super().__init__(robot, transmission, trouble, f"it has: {', '.join(SIMULATED_INTERFACES)}")


class MissingJoint(BadTransmission):
    """A transmission drives a joint that the robot has not, or that has no one position."""

    def __init__(self, body: Body, transmission: TransmissionInfo, joint: str) -> None:
        super().__init__(
            body.name, transmission, f"no joint {joint!r} that moves", f"such joints: {listing(body.joints)}"
        )


@dataclass(slots=True)
class Bounds:
    """What PID modes and motors need of the limits: m or rad, N or N·m; the largest float where there is none."""

    lower: float = -LARGEST
    upper: float = LARGEST
    effort: float = LARGEST


class HardwareJoint:
    """A driven joint: where it is in the world, its handle, the interface it takes commands by, and its bounds."""

    __slots__ = ("bounds", "handle", "interface", "joint", "limit", "name")

    def __init__(self, joint: Joint, interface: type[JointCommandInterface]) -> None:
        self.name = joint.name
        self.joint = joint
        self.interface = interface
        self.handle = JointHandle(joint.name)
        self.bounds = Bounds()
        self.limit: LimitHandle | None = None
        self.reset()

    def reset(self) -> None:
        """As on the first day."""
        handle = self.handle
        handle.position, handle.velocity, handle.effort, handle.command = INITIAL_POSITION, 0.0, INITIAL_EFFORT, 0.0
        if self.limit is not None:
            self.limit.reset()

    def register_limits(self, node: NodeHandle) -> None:
        """Take limits from `<limit>`, then from the parameters `joint_limits/<joint>`, which win field by field.

        Soft limits, where there are some, stand in for the saturation. Without any limits there is neither.

        Raises:
            SlidectlError: the limits lack one that the interface needs.
        """
        written = limits_from_joint(self.joint)
        limits = limits_from_parameters(node, self.name, written or NO_LIMITS) or written
        if limits is None:
            return
        if limits.has_position_limits:
            self.bounds.lower, self.bounds.upper = limits.min_position, limits.max_position
        if limits.has_effort_limits:
            self.bounds.effort = limits.max_effort
        soft = soft_limits_from_joint(self.joint)
        self.limit = limit_handle(self.interface, self.handle, limits, soft)
        self.handle.lowest, self.handle.highest = self.limit.command_bounds()
        if self.interface is EffortJointInterface:  # Gazebo cuts by the URDF, whatever the parameters say
            most = EffortTruncation.of(self.joint).effort
            self.handle.lowest, self.handle.highest = max(self.handle.lowest, -most), min(self.handle.highest, most)


def hardware_joints(body: Body) -> list[HardwareJoint]:
    """The joints that the transmissions drive, in the order of the file; those with several joints are passed over.

    Of several interfaces of a joint the first counts, with or without its prefix.

    Raises:
        UnsupportedInterface, MissingJoint.
    """
    found = driving(body.robot.transmissions)
    return [_hardware_joint(body, transmission, transmission.joints[0]) for transmission in found]


def _hardware_joint(body: Body, transmission: TransmissionInfo, driven: TransmissionJoint) -> HardwareJoint:
    interface = command_interface(driven.hardware_interfaces[0])
    if interface is None:
        raise UnsupportedInterface(body.name, transmission, driven)
    try:
        return HardwareJoint(body.place(driven.name).joint, interface)
    except SlidectlError as error:
        raise MissingJoint(body, transmission, driven.name) from error


GAINS = "gazebo_ros_control/pid_gains"

REACH = 1.01
"""A position command at most this many times the velocity limit away (per step) is moved to, else it is set."""

EFFORT, VELOCITY, LENGTH, REVOLVING, TURNING, VELOCITY_MOTOR, POSITION_MOTOR = range(7)
"""What a drive makes of a command: an effort; an effort by a PID on the difference of two velocities, lengths, angles
between limits, or angles on the circle; the velocity of a motor."""


@law
def drive_error(drive: Drive, joint: JointHandle) -> float:
    """Command minus what was measured at the last read. For angles the shortest turn, within the limits if any."""
    if drive.kind == VELOCITY:
        return joint.command - joint.velocity
    if drive.kind == REVOLVING:
        return distance_with_limits(joint.position, joint.command, drive.lower, drive.upper)
    if drive.kind == TURNING:
        return shortest_angular_distance(joint.position, joint.command)
    return joint.command - joint.position


@law
def drive_effort(drive: Drive, pid: Pid, joint: JointHandle, period_s: float) -> float:
    """The effort for the joint's command, before the joint's bounds cut it."""
    if drive.kind == EFFORT:
        return joint.command
    return bounded(next_command(pid, drive_error(drive, joint), period_s), -drive.limit, drive.limit)


@law
def motor_velocity(drive: Drive, joint: JointHandle, position: float, step_s: float) -> float:
    """The velocity that a motor is to reach in the step, which begins at this position; nan to set the joint instead.

    After the step a position joint is where the command says, whatever acts on it. Gazebo puts it there and lets the
    links keep their velocities, so gravity makes these grow for ever. Here the joint moves with the velocity that leads
    there, when its velocity limit allows that in one step; a command farther off, or of a joint without velocity limit,
    puts it there at rest. Either way a motor without bounds holds it against gravity and contacts.
    """
    if drive.kind == VELOCITY_MOTOR:
        return joint.command
    velocity = (joint.command - position) / step_s
    return velocity if abs(velocity) <= drive.fastest else math.nan


class Drive:
    """What makes something of one joint's command once a step. Limits were enforced before."""

    columns = Columns(fixed="kind lower upper limit fastest", places="pid joint", whole="kind pid joint")

    def __init__(self, joint: HardwareJoint, kind: int, pid: Pid | None = None) -> None:
        self.joint = joint
        self.handle = joint.handle
        self.kind = kind
        self.pid = pid
        self.lower, self.upper, self.limit = joint.bounds.lower, joint.bounds.upper, joint.bounds.effort
        limit = joint.joint.limit
        self.fastest = -1.0 if limit is None else REACH * limit.velocity
        self.truncation = EffortTruncation.of(joint.joint)

    @property
    def most_effort(self) -> float | None:
        """Of a motor; None when it has none."""
        return {VELOCITY_MOTOR: self.limit, POSITION_MOTOR: math.inf}.get(self.kind)

    def bind(self, world: World, place: JointPlace) -> None:
        """The joint is there from now on."""
        self._world, self._qpos, self._dof = world, place.qpos, place.dof

    def apply(self, period_s: float, stopped: bool) -> None:
        """Drive the joint for the step to come; `period_s` since the last call.

        `stopped` is the emergency stop: no effort, no velocity. The hardware holds the commands of positions then.
        """
        if self.most_effort is not None:
            self._ask_motor(stopped)
        elif self.pid is None:
            self._push(0.0 if stopped else self.handle.command)
        else:
            error = -self.handle.velocity if stopped and self.kind == VELOCITY else drive_error(self, self.handle)
            self._push(bounded(self.pid.compute_command(error, period_s), -self.limit, self.limit))

    def _push(self, effort: float) -> None:
        """Gazebo's SetForce: cut by the joint's limits; several in one step add up."""
        qvel, forces = self._world.views.qvel, self._world.views.forces
        forces[self._dof] += self.truncation.cut(effort, qvel[self._dof])

    def _ask_motor(self, stopped: bool) -> None:
        views = self._world.views
        velocity = motor_velocity(self, self.handle, views.qpos[self._qpos], self._world.timestep)
        if stopped and self.kind == VELOCITY_MOTOR:
            velocity = 0.0
        if math.isnan(velocity):
            views.qpos[self._qpos], views.qvel[self._dof], velocity = self.handle.command, 0.0, 0.0
        views.velocities[self._dof] = velocity


_POSITION_KINDS = {"revolute": REVOLVING, "continuous": TURNING}


def drive_for(joint: HardwareJoint, node: NodeHandle) -> Drive:
    """The drive of a joint's interface: with a PID where `gazebo_ros_control/pid_gains/<joint>/p` is a number."""
    if joint.interface is EffortJointInterface:
        return Drive(joint, EFFORT)
    pid = _pid_of(joint, node)
    if joint.interface is PositionJointInterface:
        return Drive(joint, POSITION_MOTOR if pid is None else _POSITION_KINDS.get(joint.joint.type, LENGTH), pid)
    return Drive(joint, VELOCITY_MOTOR if pid is None else VELOCITY, pid)


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
    """Joint states, and effort, position and velocity commands of the joints that have a transmission.

    All interfaces exist always, even empty. `node` is the robot's: limits are looked for at
    `joint_limits/<joint>` and gains at `gazebo_ros_control/pid_gains/<joint>` in it.

    Raises:
        UnsupportedInterface, MissingJoint: a transmission cannot be simulated. BadLimits: limits that no handle takes.
    """

    def __init__(self, world: World, body: Body, robot: Robot, node: NodeHandle, namespace: str) -> None:
        super().__init__()
        self.robot = robot
        self._world = world
        self._loads = world.loads
        self._body = body
        self._places: dict[str, JointPlace] = {}
        self._joints = hardware_joints(body)
        node = node if node.namespace == namespace else node.child(namespace)
        self._register(node)
        self._enforce = tuple(limit.enforce for limit in self.limits())
        self._held: list[float] | None = None
        self._drives = tuple(drive_for(joint, node) for joint in self._joints if not self._is_pushed(joint))
        motors = {drive.joint.name: effort for drive in self._drives if (effort := drive.most_effort) is not None}
        if motors:
            world.add_motors(body, motors)
        self.estop = False
        self._bind()
        body.on_rebound(self._bind)

    # -- the cycle -------------------------------------------------------------------------------------------------

    def read(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002 - the interface of all hardware
        """Positions, velocities and the efforts of the last step into the handles; angles are unwrapped."""
        qpos, qvel, forces = self._qpos, self._qvel, self._forces
        for handle, place, dof in self._sliding:
            handle.position = qpos[place]
            handle.velocity = qvel[dof]
            handle.effort = forces[dof]
        for handle, place, dof in self._turning:
            handle.position = unwrapped(handle.position, qpos[place])
            handle.velocity = qvel[dof]
            handle.effort = forces[dof]
        if self._loads.has_efforts:
            efforts = self._efforts
            for handle, _, dof in (*self._sliding, *self._turning):
                handle.effort += efforts[dof]

    def write(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002 - the interface of all hardware
        """Limit the commands, then drive the joints by them."""
        if self._is_special:
            self._mind_estop()
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
        """True: efforts are zero, velocities are braked, positions are held. Controllers go on."""
        return self._estop

    @estop.setter
    def estop(self, stopped: bool) -> None:
        self._estop = stopped
        self._is_special = stopped or bool(self._drives)
        if not stopped:
            self._held = None

    @property
    def drives(self) -> tuple[Drive, ...]:
        """What drives the joints that are not simply pushed, in the order in which `write` asks them."""
        return self._drives

    def driven(self) -> list[DrivenJoint]:
        """All joints that have a command, and where they are in the world until it is rebuilt."""
        return [self._driven_joint(joint) for joint in self._joints]

    def _driven_joint(self, joint: HardwareJoint) -> DrivenJoint:
        place, bounds = self._body.place(joint.name), EffortTruncation.of(joint.joint)
        is_pushed = self._is_pushed(joint)
        turns = joint.joint.type != "prismatic"
        return DrivenJoint(joint.handle, place.qpos, place.dof, turns, is_pushed, bounds.effort, bounds.velocity)

    def limits(self) -> list[LimitHandle]:
        """The limit handles in the order in which `write` enforces them."""
        return in_order(joint.limit for joint in self._joints if joint.limit is not None)

    def resting_commands(self, claims: Iterable[tuple[str, str]], hold: bool) -> dict[tuple[str, str], float]:
        """The commands by which joints are let go, or with `hold` keep their places: by interface and joint.

        Raises:
            Refused: an interface that cannot do that; an effort of 0 holds nothing, a position of 0 is a movement.
        """
        commands = {}
        for kind, name in claims:
            joint = next((one for one in self._joints if (one.interface.type_name, one.name) == (kind, name)), None)
            if joint is None:
                continue  # another interface of the joint is the one that drives
            if hold and joint.interface is EffortJointInterface:
                raise Refused(
                    f"{name} is commanded by its effort, and without a controller no effort holds it where it is",
                    "leave a controller of positions running, or let the joint go: --zero",
                )
            if not hold and joint.interface is PositionJointInterface:
                raise Refused(
                    f"{name} is commanded by its position: zero would move it to 0",
                    "it holds its last command by itself; --hold lets it stay where it is",
                )
            commands[kind, name] = joint.handle.position if joint.interface is PositionJointInterface else 0.0
        return commands

    def command(self, commands: Mapping[tuple[str, str], float]) -> None:
        """Set commands, by interface and joint, that stay until a controller writes others."""
        for joint in self._joints:
            joint.handle.command = commands.get((joint.interface.type_name, joint.name), joint.handle.command)

    def reset(self) -> None:
        """After the world was reset: angles unwrapped anew, commands 0, limits and gains without a past."""
        for joint in self._joints:
            joint.reset()
        for drive in self._drives:
            if drive.pid is not None:
                drive.pid.reset()
        self._held = None
        self.read(0, 0.0)

    def _register(self, node: NodeHandle) -> None:
        states = JointStateInterface()
        commands = {kind: kind() for kind in COMMAND_INTERFACES}
        for joint in self._joints:
            states.register_handle(joint.handle)
            commands[joint.interface].register_handle(joint.handle)
            joint.register_limits(node)
        self.register_interface(states)
        self.register_interface(ImuSensorInterface(self._sensors(Imu, sensing.imu)))
        self.register_interface(ForceTorqueSensorInterface(self._sensors(ForceTorque, sensing.force_torque)))
        for interface in commands.values():
            self.register_interface(interface)

    def _sensors(self, kind: type[S], measure: Callable[[World, str, S, int], D]) -> Iterator[SensorHandle[D]]:
        """Handles of the model's sensors of a kind. What nobody asks for is not measured."""

        def handle(sensor: S) -> SensorHandle[D]:
            world, robot = self._world, self._body.name
            return SensorHandle(sensor.name, sensor.frame, lambda: measure(world, robot, sensor, world.clock()))

        return (handle(sensor) for sensor in self.robot.sensors if isinstance(sensor, kind))

    def _is_pushed(self, joint: HardwareJoint) -> bool:
        """Effort joints, except those that several transmissions drive: their efforts add up."""
        alone = sum(other.name == joint.name for other in self._joints) == 1
        return alone and joint.interface is EffortJointInterface

    def _bind(self) -> None:
        """The model was rebuilt: look at its new data, and find the joints if they have moved."""
        self._qpos, self._qvel, self._forces, self._efforts, _ = self._world.views
        for drive in self._drives:
            drive.bind(self._world, self._body.place(drive.joint.name))
        if self._places is not self._body.joints:
            self._places = self._body.joints
            self._find_joints()

    def _find_joints(self) -> None:
        self._driven = tuple({self._body.place(drive.joint.name).dof for drive in self._drives})
        sliding: list[_Measured] = []
        turning: list[_Measured] = []
        pushed: list[_Pushed] = []
        for joint in self._joints:
            place = self._body.place(joint.name)
            group = sliding if joint.joint.type == "prismatic" else turning
            group.append((joint.handle, place.qpos, place.dof))
            if self._is_pushed(joint):
                bounds = EffortTruncation.of(joint.joint)
                pushed.append((joint.handle, place.dof, bounds.effort, bounds.velocity))
        self._sliding, self._turning, self._pushed = tuple(sliding), tuple(turning), tuple(pushed)

    def _drive(self, period_s: float) -> None:
        """All that is not simply pushed; and in an emergency stop nothing is pushed."""
        if self._estop:
            for _, dof, _, _ in self._pushed:
                self._forces[dof] = 0.0
        for dof in self._driven:
            self._forces[dof] = 0.0
        for drive in self._drives:
            drive.apply(period_s, self._estop)

    def _mind_estop(self) -> None:
        """While stopped, position commands are the positions that were read when it began."""
        if self._estop and self._held is None:
            self._held = [joint.handle.position for joint in self._joints]
        for joint, position in zip(self._joints, self._held or (), strict=False):
            if joint.interface is PositionJointInterface:
                joint.handle.command = position
