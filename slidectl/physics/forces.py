"""Forces from outside: joint efforts and wrenches on links, each from a time and for a duration.

`Loads` puts them on top of what the robots apply, for one step. Nothing here knows clocks or services.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from slidectl.physics.effort import EffortTruncation
from slidectl.physics.frames import add
from slidectl.physics.rotation import cross
from slidectl.rotations import Vector

if TYPE_CHECKING:
    from slidectl.physics.body import Body


@dataclass(frozen=True, slots=True)
class _Span:
    """When: from `start_ns` up to and including `start_ns + duration_ns`; a negative duration never ends."""

    start_ns: int
    duration_ns: int

    def holds(self, now_ns: int) -> bool:
        return now_ns >= self.start_ns and not self.is_over(now_ns)

    def is_over(self, now_ns: int) -> bool:
        return self.duration_ns >= 0 and now_ns > self.start_ns + self.duration_ns


@dataclass(frozen=True, slots=True)
class JointForce:
    """N or N·m on one joint, cut like every effort by the limits of the joint."""

    body: Body
    joint: str
    effort: float
    span: _Span


@dataclass(frozen=True, slots=True)
class Wrench:
    """Force (N) and torque (N·m), in the world's axes, on the centre of mass of one link."""

    body: Body
    link: str
    force: Vector
    torque: Vector
    span: _Span


class ExternalForces:
    """The forces that were asked for and are not over."""

    def __init__(self) -> None:
        self.joint_forces: list[JointForce] = []
        self.wrenches: list[Wrench] = []

    @property
    def is_empty(self) -> bool:
        """True when nothing waits and nothing acts."""
        return not self.joint_forces and not self.wrenches

    def add_joint(self, body: Body, joint: str, effort: float, start_ns: int, duration_ns: int) -> None:
        """Raises UnknownName when the robot has no such moving joint."""
        body.place(joint)
        self.joint_forces.append(JointForce(body, joint, effort, _Span(start_ns, duration_ns)))

    def add_wrench(self, body: Body, link: str, force: Vector, torque: Vector, start_ns: int, duration_ns: int) -> None:
        """Raises UnknownName when the robot has no such link."""
        body.link(link)
        self.wrenches.append(Wrench(body, link, force, torque, _Span(start_ns, duration_ns)))

    def drop(self, keep: Callable[[JointForce | Wrench], bool]) -> None:
        """Forget all forces but those that `keep` says yes to."""
        self.joint_forces = [force for force in self.joint_forces if keep(force)]
        self.wrenches = [wrench for wrench in self.wrenches if keep(wrench)]

    def apply(self, model: Any, data: Any, now_ns: int, efforts: dict[int, float]) -> None:
        """Add what holds at `now_ns` to qfrc_applied, xfrc_applied and, by dof, `efforts`; forget what is over."""
        self.drop(lambda force: not force.span.is_over(now_ns))
        for force in self.joint_forces:
            if force.span.holds(now_ns):
                place = force.body.joints[force.joint]
                effort = EffortTruncation.of(place.joint).cut(force.effort, float(data.qvel[place.dof]))
                data.qfrc_applied[place.dof] += effort
                efforts[place.dof] = efforts.get(place.dof, 0.0) + effort
        acting = [(wrench, wrench.body.links[wrench.link]) for wrench in self.wrenches if wrench.span.holds(now_ns)]
        if any(link.arm is not None for _, link in acting):
            mujoco.mj_kinematics(model, data)  # the attitudes of now; the step computes them again
        for wrench, link in acting:
            torque = wrench.torque
            if link.arm is not None:
                arm = np.zeros(3)
                mujoco.mju_rotVecQuat(arm, np.array(link.arm), data.xquat[link.body])
                x, y, z = arm.tolist()
                torque = add(torque, cross((x, y, z), wrench.force))
            data.xfrc_applied[link.body] += (*wrench.force, *torque)
