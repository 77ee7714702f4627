"""The hardware of a robot of ROS 2: joints with several interfaces, of which the running controllers' claims decide.

After gz_ros2_control: a joint that no controller commands is held at rest, unless the plugin says otherwise. Limits are
enforced where the controller manager of ROS 2 enforces them, once in each control period. Description:
description/ros2_control.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

from slidectl.control.hardware_interface import COMMAND_INTERFACES, ControllerInfo, HardwareComponent, JointCommands
from slidectl.control.limits import LARGEST, JointLimits, limits_from_joint
from slidectl.control.node_handle import NodeHandle
from slidectl.control.pid import Pid
from slidectl.description.interfaces import JointInterface
from slidectl.description.robot import Joint
from slidectl.description.ros2_control import ControlledJoint, Interface, PidGains, Ros2Control
from slidectl.physics.robot_hw import (
    LENGTH,
    POSITION_MOTOR,
    REACH,
    REVOLVING,
    TURNING,
    VELOCITY,
    VELOCITY_MOTOR,
    Drive,
    HardwareJoint,
    MujocoRobotHW,
)

_KINDS = {"revolute": REVOLVING, "continuous": TURNING}
_FASTEST = 1000.0
"""m/s or rad/s. A commanded position that a joint without velocity limit reaches only faster is set."""


class Held(JointCommands):
    """Joints that no controller commands, and that are held."""

    declared = JointInterface("held", "velocity", "a velocity of")
    type_name = "held"


class Free(JointCommands):
    """Joints that no controller commands, and that are free."""

    declared = JointInterface("free", "effort", "an effort of")
    type_name = "free"


class Released(HardwareJoint):
    """A joint while no controller commands it."""

    def register_limits(self, node: NodeHandle) -> None:  # noqa: ARG002 - the method of all joints
        """It has no commands to limit; the effort that holds it is bounded by the URDF."""
        limits = limits_from_joint(self.joint)
        if limits is not None and limits.max_effort > 0.0:
            self.most_effort = limits.max_effort


class CommandedJoint(HardwareJoint):
    """A joint with a command interface of `<ros2_control>`, whose values tighten the limits of the URDF."""

    def __init__(self, joint: Joint, interface: type[JointCommands], controlled: ControlledJoint) -> None:
        self._controlled = controlled
        super().__init__(joint, interface)

    def written_limits(self) -> JointLimits | None:
        """The limits of the URDF, tightened by `min` and `max` of the command interfaces."""
        command = self._controlled.command(self.quantity)
        if not self._controlled.is_limited or (command is not None and not command.is_limited):
            return None
        return tightened(limits_from_joint(self.joint), self._controlled, self.joint)


def tightened(limits: JointLimits | None, controlled: ControlledJoint, joint: Joint) -> JointLimits | None:
    """Limits with those of command interfaces. Positions intersect; of other quantities the least magnitude counts.

    None when there is none at all.
    """
    most = {quantity: _largest(controlled.command(quantity)) for quantity in ("velocity", "effort")}
    most["acceleration"] = _largest(controlled.commands.get("acceleration"))
    position = controlled.command("position")
    lower = position.minimum if position is not None else None
    upper = position.maximum if position is not None else None
    if limits is None and not any(value is not None for value in (lower, upper, *most.values())):
        return None
    found = limits or JointLimits()
    if joint.type != "continuous" and (lower is not None or upper is not None):
        least = found.min_position if found.has_position_limits else -LARGEST
        largest = found.max_position if found.has_position_limits else LARGEST
        found = replace(
            found,
            has_position_limits=True,
            min_position=max(least, lower) if lower is not None else least,
            max_position=min(largest, upper) if upper is not None else largest,
        )
    for quantity, value in most.items():
        flag, name = f"has_{quantity}_limits", f"max_{quantity}"
        if value is not None:
            before = getattr(found, name) if getattr(found, flag) else LARGEST
            changes: dict[str, Any] = {flag: True, name: min(before, value)}
            found = replace(found, **changes)
    # Laws of effort and of soft positions read the velocity limit.
    for flag, name in (("has_velocity_limits", "max_velocity"), ("has_effort_limits", "max_effort")):
        if not getattr(found, flag):
            unlimited: dict[str, Any] = {flag: True, name: LARGEST}
            found = replace(found, **unlimited)
    return found


def _largest(interface: Interface | None) -> float | None:
    """The largest magnitude that an interface allows; None without bounds."""
    if interface is None or not interface.is_limited:
        return None
    bounds = [abs(value) for value in (interface.minimum, interface.maximum) if value is not None]
    return min(bounds) if bounds else None


class PeriodicDrive(Drive):
    """A motor for commands that come once in a control period, in which the joint gets to its position evenly.

    A command of velocity beside that of the position does not change the way: it is that of the positions.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = ("steps_left",)

    def __init__(self, joint: HardwareJoint, kind: int, pid: Pid | None = None) -> None:
        super().__init__(joint, kind, pid)
        self.steps_left = 1
        self.fastest = _FASTEST if joint.limit is None else min(_FASTEST, REACH * joint.limit.max_velocity)

    def begin(self, period_s: float) -> None:
        """A control period begins, with a new command."""
        self.steps_left = max(1, round(period_s / self._world.timestep))

    def _velocity(self, position: float, step_s: float) -> float:
        if self.kind == VELOCITY_MOTOR:
            return self.handle.command
        velocity = (self.handle.command - position) / (self.steps_left * step_s)
        self.steps_left = max(1, self.steps_left - 1)
        return velocity if abs(velocity) <= self.fastest else math.nan


class Ros2RobotHW(MujocoRobotHW):
    """Hardware of `<ros2_control>`: each joint has the interfaces of its tag, and one is driven at a time.

    A controller that starts decides by its claims, and is in its mode until it stops.
    """

    is_of_ros2 = True
    _began_s = 0.0
    """The control period that has begun since the last `write`, s; 0: none. A switch in the cycle must not lose it."""
    how_to_drive = (
        "is in no <ros2_control> of the model, so nothing can command it; a <joint> in there names it, with a "
        "<command_interface>"
    )

    @property
    def control(self) -> Ros2Control:
        """What the tags say."""
        assert self.robot.ros2_control is not None
        return self.robot.ros2_control

    def _made_joints(self) -> tuple[list[HardwareJoint], list[HardwareJoint]]:
        offered: list[HardwareJoint] = []
        self._released: dict[str, HardwareJoint] = {}
        for name, controlled in self.control.joints.items():
            joint = self._attached.place(name).joint
            is_held = bool(controlled.commands) and self.control.holds_joints
            self._released[name] = Released(joint, Held if is_held else Free)
            # The handle that was registered last is the state's.
            offered.append(self._released[name])
            offered += [CommandedJoint(joint, COMMAND_INTERFACES[kind], controlled) for kind in controlled.interfaces()]
        return offered, list(self._released.values())

    def _made_drive(self, joint: HardwareJoint, node: NodeHandle) -> Drive:  # noqa: ARG002 - the method of all hardware
        quantity = joint.quantity
        gains = self.control.joints[joint.name].gains.get(quantity) if isinstance(joint, CommandedJoint) else None
        if gains is None:
            return PeriodicDrive(joint, VELOCITY_MOTOR if quantity == "velocity" else POSITION_MOTOR)
        kind = VELOCITY if quantity == "velocity" else _KINDS.get(joint.joint.type, LENGTH)
        return PeriodicDrive(joint, kind, _pid(gains))

    def engage(self) -> None:
        super().engage()
        # The controller manager enforces the limits, in each control period.
        self._of_period, self._enforce = self._enforce, ()
        self._periodic = [drive for drive in self.drives if isinstance(drive, PeriodicDrive)]

    def read(self, time_ns: int, period_s: float) -> None:
        super().read(time_ns, period_s)
        self._began_s = period_s

    def write(self, time_ns: int, period_s: float) -> None:
        """Enforce the limits once in each control period, then drive the joints."""
        if self._began_s:
            if self._is_special:
                self._hold_positions()
            for enforce in self._of_period:
                enforce(self._began_s)
            for drive in self._periodic:
                drive.begin(self._began_s)
            self._began_s = 0.0
        super().write(time_ns, period_s)

    def components(self) -> list[HardwareComponent]:
        """One for each `<ros2_control>`, with the interfaces of its joints as they are written."""
        found = []
        for one in self.control.components:
            joints = [self.control.joints[name] for name in one.joints]
            commands = tuple(f"{joint.name}/{name}" for joint in joints for name in joint.commands)
            states = tuple(f"{joint.name}/{name}" for joint in joints for name in joint.states)
            found.append(HardwareComponent(one.name, one.type, one.plugin, commands, states))
        return found

    @property
    def has_compiled_form(self) -> bool:
        """False: joints change their interfaces."""
        return False

    def do_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> None:
        """Drive joints by the interfaces that starting controllers claim; release those that only stopping ones had."""
        claimed, given_back = _claims(start), _claims(stop)
        released = [
            joint.name
            for joint in self._joints
            if (joint.interface.type_name, joint.name) in given_back
            and not any(name == joint.name for _, name in claimed)
        ]
        self._release(released)
        super().do_switch(start, stop)

    def release_unclaimed(self, running: Sequence[ControllerInfo]) -> None:
        """Release the joints whose controllers have failed or are gone."""
        claims = _claims(running)
        commanded = (joint for joint in self._joints if not isinstance(joint, Released))
        self._release([joint.name for joint in commanded if (joint.interface.type_name, joint.name) not in claims])

    def _release(self, names: Sequence[str]) -> None:
        if not names:
            return
        self._joints = [self._released[one.name] if one.name in names else one for one in self._joints]
        for name in names:
            self._released[name].rest()
        self._held = None
        self.engage()

    def _find_joints(self) -> None:
        super()._find_joints()
        # Hardware of ROS 2 gives positions as they are: an angle may begin beyond half a turn.
        self._sliding, self._turning = (*self._sliding, *self._turning), ()

    def _hold_positions(self) -> None:
        if self._estop and self._held is None:  # the handles have the positions at the begin of the control period
            self._held = [self._qpos[self._attached.place(joint.name).qpos] for joint in self._joints]
        super()._hold_positions()

    def save_state(self) -> dict[str, Any]:
        return {**super().save_state(), "began_s": self._began_s}

    def load_state(self, state: dict[str, Any]) -> None:
        super().load_state(state)
        self._began_s = state["began_s"]


def _claims(infos: Sequence[ControllerInfo]) -> set[tuple[str, str]]:
    return {(of.hardware_interface, name) for one in infos for of in one.claimed_resources for name in of.resources}


def _pid(gains: PidGains) -> Pid:
    most = LARGEST if gains.most is None else gains.most
    return Pid(gains.p, gains.i, gains.d, most, -most)
