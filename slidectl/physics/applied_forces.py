"""Forces in a step besides those of the robots' hardware: external forces, and motors.

External forces are added before the step and removed after it, so that qfrc_applied belongs to the hardware only.
This module uses no clocks and no services.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from slidectl.control.laws import law
from slidectl.description.robot import Joint
from slidectl.physics.attached_robot import Array, AttachedRobot
from slidectl.physics.motors import Motors
from slidectl.rotations import Vector, add, cross


@law
def truncated(effort: float, velocity: float, max_effort: float, max_velocity: float) -> float:
    """The effort that acts at this velocity: none that pushes further beyond the velocity limit, then the clamp."""
    if effort > 0.0:
        if velocity > max_velocity:
            return 0.0
        return max_effort if effort > max_effort else effort
    if effort < 0.0:
        if velocity < -max_velocity:
            return 0.0
        return -max_effort if effort < -max_effort else effort
    return effort


@dataclass(frozen=True, slots=True)
class EffortTruncation:
    """Bounds of a joint: `effort` in N or N·m, `velocity` in m/s or rad/s; infinite when there is none."""

    effort: float = math.inf
    velocity: float = math.inf

    @staticmethod
    def of(joint: Joint) -> EffortTruncation:
        """The bounds of the joint's `<limit>`; a negative value means no bound, as in Gazebo."""
        bounds = () if joint.limit is None else (joint.limit.effort, joint.limit.velocity)
        return EffortTruncation(*(bound if bound >= 0.0 else math.inf for bound in bounds))

    def cut(self, effort: float, velocity: float) -> float:
        """The effort that acts at this velocity; see `truncated`."""
        return truncated(effort, velocity, self.effort, self.velocity)


class JointForce(NamedTuple):
    """An external effort, N or N·m, on one joint of a robot, clipped like every effort by the limits of the joint.

    It acts from `start_ns` up to and including `start_ns + duration_ns`; a negative duration never ends.
    """

    robot: str
    joint: str
    effort: float
    start_ns: int
    duration_ns: int


class Wrench(NamedTuple):
    """Force (N) and torque (N·m), in the world's axes, at the centre of mass of one link. Times as in JointForce."""

    robot: str
    link: str
    force: Vector
    torque: Vector
    start_ns: int
    duration_ns: int
    source: str = ""
    """Name of its origin, by which it can be removed."""


class AppliedForces:
    """External forces that have not ended, motors, and the efforts of both on joints in the last step."""

    def __init__(self) -> None:
        self.joint_forces: list[JointForce] = []
        self.wrenches: list[Wrench] = []
        self.motors = Motors()
        self.efforts: Array = np.zeros(0)
        """N or N·m by dof. A rebuild of the model makes a new array."""
        self.has_efforts = False
        """False while all efforts are 0."""
        self._robots: Mapping[str, AttachedRobot] = {}
        self._acted: tuple[float, Array | None] = (-1.0, None)
        """MuJoCo's time after the last step with external forces, and their wrenches on MuJoCo's bodies."""

    @property
    def has_forces(self) -> bool:
        """True when an external force acts, or will act."""
        return bool(self.joint_forces or self.wrenches)

    @property
    def is_empty(self) -> bool:
        """True when there are no external forces and no motors."""
        return not self.has_forces and self.motors.is_empty

    def remove(self, ends: Callable[[JointForce | Wrench], bool]) -> None:
        """Remove all external forces for which `ends` returns True."""
        self.joint_forces = [force for force in self.joint_forces if not ends(force)]
        self.wrenches = [wrench for wrench in self.wrenches if not ends(wrench)]

    def forget(self, robot: AttachedRobot) -> None:
        """Remove all forces and motors of a robot that is detached. Call `bind` afterwards."""
        self.remove(lambda force: force.robot == robot.name)
        self.motors.drop(robot)
        self.efforts = np.delete(self.efforts, robot.dofs)

    def bind(self, model: Any, data: Any, robots: Mapping[str, AttachedRobot]) -> None:
        """Use this model of these robots, which are bound to it already."""
        self._robots = robots
        self._acted = -1.0, None
        if not self.motors.is_empty:
            self.has_efforts = True
        if len(self.efforts) < model.nv:
            self.efforts = np.append(self.efforts, np.zeros(model.nv - len(self.efforts)))
        self.motors.bind(model, data, robots)

    def snapshot(self) -> dict[str, Any]:
        """The state as plain data and arrays of numbers, with robots by name, for `restore`."""
        time, wrenches = self._acted
        return {
            "joint_forces": [list(force) for force in self.joint_forces],
            "wrenches": [list(wrench) for wrench in self.wrenches],
            "motors": {robot: dict(bounds) for robot, bounds in self.motors.bounds.items()},
            "velocities": self.motors.velocities.copy(),
            "efforts": self.efforts.copy(),
            "has_efforts": self.has_efforts,
            "acted": time,
            "acted_wrenches": None if wrenches is None else wrenches.copy(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state. Call `bind` afterwards, then `restore_last_step` if results of that step are needed."""
        self.joint_forces = [JointForce(*force) for force in state["joint_forces"]]
        self.wrenches = [Wrench(*wrench) for wrench in state["wrenches"]]
        self.motors.bounds = {robot: dict(bounds) for robot, bounds in state["motors"].items()}
        self.motors.velocities = state["velocities"].copy()
        self.efforts = state["efforts"].copy()

    def restore_last_step(self, state: dict[str, Any]) -> None:
        """Restore the results of the last step, which `bind` discards."""
        self.has_efforts = bool(state["has_efforts"])
        self._acted = state["acted"], state["acted_wrenches"]

    def clear_efforts(self) -> None:
        """Set all efforts to 0."""
        self.efforts[:] = 0.0
        self.has_efforts = not self.motors.is_empty

    def wrenches_of_step(self, data: Any) -> Array | None:
        """The external wrenches in the last step, one row for each of MuJoCo's bodies, as xfrc_applied; None: none."""
        time, forces = self._acted
        return forces if time == data.time else None

    def step(self, model: Any, data: Any, now_ns: int) -> None:
        """Make a step with all forces that act at `now_ns`, then restore the hardware's forces exactly."""
        self.has_efforts = True
        if not self.has_forces:
            self.motors.step(model, data, self.efforts)
            return
        hardware, link_forces, outside = data.qfrc_applied.copy(), data.xfrc_applied.copy(), np.zeros(model.nv)
        try:
            self._apply_forces(model, data, now_ns, outside)
            self.efforts[:] = 0.0
            if self.motors.is_empty:
                mujoco.mj_step(model, data)
            else:
                self.motors.step(model, data, self.efforts)
            self.efforts += outside
            self._acted = data.time, data.xfrc_applied - link_forces
        finally:
            data.qfrc_applied[:], data.xfrc_applied[:] = hardware, link_forces

    def _apply_forces(self, model: Any, data: Any, now_ns: int, efforts: Array) -> None:
        """Add the forces of `now_ns` to qfrc_applied, xfrc_applied and, by dof, `efforts`. Remove ended ones."""
        self.remove(lambda force: 0 <= force.duration_ns < now_ns - force.start_ns)
        for force in self.joint_forces:
            if now_ns >= force.start_ns:
                place = self._robots[force.robot].joints[force.joint]
                effort = EffortTruncation.of(place.joint).cut(force.effort, float(data.qvel[place.dof]))
                data.qfrc_applied[place.dof] += effort
                efforts[place.dof] += effort
        started = [wrench for wrench in self.wrenches if now_ns >= wrench.start_ns]
        acting = [(wrench, self._robots[wrench.robot].links[wrench.link]) for wrench in started]
        if any(link.arm is not None for _, link in acting):
            mujoco.mj_kinematics(model, data)  # the present attitudes; the step computes them again
        for wrench, link in acting:
            torque = wrench.torque
            if link.arm is not None:
                arm = np.zeros(3)
                mujoco.mju_rotVecQuat(arm, np.array(link.arm), data.xquat[link.body])
                x, y, z = arm.tolist()
                torque = add(torque, cross((x, y, z), wrench.force))
            data.xfrc_applied[link.body] += (*wrench.force, *torque)
