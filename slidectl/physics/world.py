"""The simulated world: robots come and go while it runs; one looks at their state, changes it, and pushes them.

It counts no time (the simulation does) and knows neither controllers nor topics. SI units; quaternions x y z w.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from slidectl.errors import Refused, listing
from slidectl.physics.body import Body, RobotState
from slidectl.physics.core import WorldCore, finite, finite4, number
from slidectl.physics.forces import JointForce, Wrench
from slidectl.physics.motors import Asked
from slidectl.physics.observer import Twist
from slidectl.physics.rotation import Pose
from slidectl.physics.touching import depths, link_of
from slidectl.rotations import Vector, normalized


@dataclass(frozen=True)
class Overlap:
    """A link that is in something else: in a link of another robot, or in the ground."""

    link: str
    robot: str | None
    """The other robot, or None for the ground."""
    other: str | None
    """The other robot's link."""
    depth: float
    """m."""


@dataclass(frozen=True)
class Snapshot:
    """The whole state of a world at one moment, for the same robots again."""

    time: float
    robots: dict[Body, RobotState]
    joint_forces: tuple[JointForce, ...]
    wrenches: tuple[Wrench, ...]
    motors: Asked


class World(WorldCore):
    """A ground, a light, gravity, and robots."""

    # -- state -----------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """All robots back to how they were attached, without forces from outside."""
        self._mend()
        self.loads.motors.drop()
        self.clear_forces()
        for body in self._bodies.values():
            body.put_at_spawn()
        self._observer.invalidate()

    def snapshot(self) -> Snapshot:
        """The state of this moment, for `restore`."""
        robots = {body: body.capture() for body in self._bodies.values()}
        forces, motors = self.loads.forces, self.loads.motors.asked()
        return Snapshot(self.data.time, robots, tuple(forces.joint_forces), tuple(forces.wrenches), motors)

    def restore(self, snapshot: Snapshot) -> None:
        """Back to the moment of the snapshot, exactly. Raises Refused when other robots are in the world now."""
        if list(snapshot.robots) != list(self._bodies.values()):
            raise Refused(f"the snapshot is of other robots: {listing(body.name for body in snapshot.robots)}")
        self._mend()
        for body, state in snapshot.robots.items():
            body.put(state)
        self.data.time = snapshot.time
        self.loads.forces.joint_forces, self.loads.forces.wrenches = (
            list(snapshot.joint_forces),
            list(snapshot.wrenches),
        )
        self._loads_changed()
        self._observer.invalidate()

    def link_pose(self, name: str, link: str) -> Pose:
        """Place of the link's frame in the world. Raises UnknownName."""
        return self._observer.pose(self.body(name).link(link))

    def link_twist(self, name: str, link: str) -> Twist:
        """Velocity of the link's frame (linear at its origin, angular), in the world's axes. Raises UnknownName."""
        return self._observer.twist(self.body(name).link(link))

    def joint_state(self, name: str, joint: str) -> tuple[float, float, float]:
        """Position, velocity and applied effort of any moving joint, actuated or not. Raises UnknownName."""
        place = self.body(name).place(joint)
        effort = float(self.data.qfrc_applied[place.dof]) + self.loads.efforts.get(place.dof, 0.0)
        return float(self.data.qpos[place.qpos]), float(self.data.qvel[place.dof]), effort

    def set_pose(self, name: str, pose: Pose, twist: Twist | None = None) -> None:
        """Put a robot's root there, and give it the twist (world's axes) if there is one; a fixed robot has none.

        Raises:
            UnknownName: no such robot. Refused: not finite.
        """
        body = self.body(name)
        body.put_root((finite(pose[0]), normalized(finite4(pose[1]))))
        self._observer.invalidate()
        if twist is not None and not body.robot.is_fixed_to_world:
            self._set_root_twist(body, (finite(twist[0]), finite(twist[1])))

    def _set_root_twist(self, body: Body, twist: Twist) -> None:
        """A free joint's velocities: linear in the world's axes, angular in the body's."""
        turn, local = np.zeros(4), np.zeros(3)
        start = body.root_qpos + 3
        mujoco.mju_negQuat(turn, self.data.qpos[start : start + 4])
        mujoco.mju_rotVecQuat(local, np.array(twist[1]), turn)
        self.data.qvel[body.root_dof : body.root_dof + 6] = [*twist[0], *local]

    def set_joint(self, name: str, joint: str, position: float, velocity: float | None = None) -> None:
        """Put a joint there; its velocity stays unless one is given. Raises UnknownName, Refused (not finite)."""
        place = self.body(name).place(joint)
        self.data.qpos[place.qpos] = number(position)
        if velocity is not None:
            self.data.qvel[place.dof] = number(velocity)
        self._observer.invalidate()

    def overlaps(self, name: str, least: float) -> list[Overlap]:
        """Where links of the robot are in others by more than `least` (m), the deepest first. Raises UnknownName."""
        body = self.body(name)
        robots = {owner.root_id: owner.name for owner in self._bodies.values()}
        deepest: dict[tuple[str, str | None, str | None], float] = {}
        for (own, other), depth in depths(self.model, self.data, body.root_id).items():
            robot = robots.get(int(self.model.body_rootid[self.model.geom_bodyid[other]]))
            theirs = None if robot is None else link_of(self.model, other, robot)
            pair = (link_of(self.model, own, name), robot, theirs)
            deepest[pair] = max(depth, deepest.get(pair, 0.0))
        found = [Overlap(*pair, depth) for pair, depth in deepest.items() if depth > least]
        return sorted(found, key=lambda overlap: -overlap.depth)

    # -- forces from outside ---------------------------------------------------------------------------------------

    def add_joint_force(self, name: str, joint: str, effort: float, start_ns: int = 0, duration_ns: int = -1) -> None:
        """An effort (N or N·m) on a joint from `start_ns` for `duration_ns` of simulated time; negative: until cleared.

        Raises:
            UnknownName: no such robot or moving joint. Refused: not finite.
        """
        self.loads.forces.add_joint(self.body(name), joint, number(effort), start_ns, duration_ns)
        self._loads_changed()

    def add_wrench(
        self, name: str, link: str, force: Vector, torque: Vector, start_ns: int = 0, duration_ns: int = -1
    ) -> None:
        """A force (N) and torque (N·m), world's axes, on a link's centre of mass, as long as `add_joint_force` says.

        Raises:
            UnknownName: no such robot or link. Refused: not finite.
        """
        self.loads.forces.add_wrench(self.body(name), link, finite(force), finite(torque), start_ns, duration_ns)
        self._loads_changed()

    def clear_joint_forces(self, name: str, joint: str) -> None:
        """End all efforts on a joint that came from outside. Raises UnknownName."""
        body = self.body(name)
        body.place(joint)
        self.loads.forces.drop(
            lambda force: isinstance(force, Wrench) or force.body is not body or force.joint != joint
        )
        self._loads_changed()

    def clear_wrenches(self, name: str, link: str) -> None:
        """End all wrenches on a link. Raises UnknownName."""
        body = self.body(name)
        body.link(link)
        self.loads.forces.drop(
            lambda force: isinstance(force, JointForce) or force.body is not body or force.link != link
        )
        self._loads_changed()

    def clear_forces(self) -> None:
        """End all forces from outside."""
        self.loads.forces.drop(lambda _: False)
        self._loads_changed()

    def ask_motor(self, body: Body, joint: str, velocity: float, max_effort: float) -> None:
        """Let a motor bring a joint to this velocity (m/s or rad/s), with at most so much effort, in every step."""
        was_empty = self.loads.is_empty
        self.loads.motors.ask(body, joint, velocity, max_effort)
        if was_empty:
            self._loads_changed()
