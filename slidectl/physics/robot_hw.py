"""The hardware of a simulated robot, after gazebo_ros_control's DefaultRobotHWSim: joints read, limited and driven.

`read` and `write` are the hot path: plain tuples and memoryviews, nothing allocated. It knows no controllers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from slidectl.control.angular_distance import unwrapped
from slidectl.control.hardware_interface import (
    COMMAND_INTERFACES,
    EffortJointInterface,
    JointHandle,
    JointStateInterface,
    PositionJointInterface,
    RobotHW,
)
from slidectl.control.limits import LimitHandle, in_order
from slidectl.control.node_handle import NodeHandle
from slidectl.description.robot import Robot
from slidectl.errors import Refused
from slidectl.physics.body import Body, JointPlace
from slidectl.physics.drives import Drive, drive_for
from slidectl.physics.effort import EffortTruncation, truncated
from slidectl.physics.hw_joint import HardwareJoint, hardware_joints
from slidectl.physics.world import World

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

    All four interfaces exist always, even empty. `node` is the robot's: limits are looked for at
    `joint_limits/<joint>` and gains at `gazebo_ros_control/pid_gains/<joint>` in it.

    Raises:
        UnsupportedInterface, MissingJoint: a transmission cannot be simulated. BadLimits: limits that no handle takes.
    """

    def __init__(self, world: World, body: Body, robot: Robot, node: NodeHandle, namespace: str) -> None:
        super().__init__()
        self.robot = robot
        self._world = world
        self._body = body
        self._places: dict[str, JointPlace] = {}
        self._joints = hardware_joints(body)
        node = node if node.namespace == namespace else node.child(namespace)
        self._register(node)
        self._enforce = tuple(limit.enforce for limit in self.limits())
        self._held: list[float] | None = None
        self._drives = self._make_drives(node)
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
        if self._outside:
            self._read_outside_efforts()

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
            drive.reset()
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
        for interface in commands.values():
            self.register_interface(interface)

    def _make_drives(self, node: NodeHandle) -> tuple[Drive, ...]:
        """How the joints that are not simply pushed are driven."""
        made = (drive_for(joint, self._world, self._body, node) for joint in self._joints if not self._is_pushed(joint))
        return tuple(made)

    def _is_pushed(self, joint: HardwareJoint) -> bool:
        """Effort joints, except those that several transmissions drive: their efforts add up."""
        alone = sum(other.name == joint.name for other in self._joints) == 1
        return alone and joint.interface is EffortJointInterface

    def _bind(self) -> None:
        """The model was rebuilt: look at its new data, and find the joints if they have moved."""
        self._qpos, self._qvel, self._forces = self._world.views
        self._outside = self._world.loads.efforts
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

    def _read_outside_efforts(self) -> None:
        for handle, _, dof in (*self._sliding, *self._turning):
            handle.effort += self._outside.get(dof, 0.0)

    def _mind_estop(self) -> None:
        """While stopped, position commands are the positions that were read when it began."""
        if self._estop and self._held is None:
            self._held = [joint.handle.position for joint in self._joints]
        for joint, position in zip(self._joints, self._held or (), strict=False):
            if joint.interface is PositionJointInterface:
                joint.handle.command = position
