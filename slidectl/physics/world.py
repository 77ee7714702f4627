"""The simulated world: robots come and go while it runs, and the state of the others stays as it is to the last bit.

It counts no time (the simulation does) and knows neither controllers nor topics. SI units; quaternions x y z w.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np

from slidectl.description.robot import Robot
from slidectl.errors import Refused, SlidectlError, UnknownName
from slidectl.physics import engine
from slidectl.physics.body import Body, RobotState
from slidectl.physics.compiler import Settings, compile_world
from slidectl.physics.forces import ExternalForces, JointForce, Wrench
from slidectl.physics.observer import Observer, Twist
from slidectl.physics.rotation import ORIGIN, Pose, Vector, normalized

GRAVITY: Vector = (0.0, 0.0, -9.8)
"""m/s², the default of SDF and so of Gazebo."""

HUGE = 1e10
"""A position or velocity beyond this is nonsense; MuJoCo's own bound."""


class Diverged(SlidectlError):
    """The state of a robot is no longer a number, or huge."""

    def __init__(self, robot: str) -> None:
        text = f"the simulation of robot {robot!r} diverged: its state is not finite or huge"
        super().__init__(text, "reset it (slidectl sim reset) or delete the robot; check masses, damping and gains")
        self.robot = robot


@dataclass(frozen=True)
class Snapshot:
    """The whole state of a world at one moment, for the same robots again."""

    time: float
    robots: dict[str, RobotState]
    joint_forces: tuple[JointForce, ...]
    wrenches: tuple[Wrench, ...]


class World:
    """A ground, a light, gravity, and robots."""

    step: Callable[[], None]
    """Advance by one time step. Replaced when the model is rebuilt or forces come and go: see `on_rebuild`."""

    def __init__(self, timestep: float = 0.001, gravity: Vector = GRAVITY, ground: bool = True) -> None:
        engine.prepare()
        self._settings = Settings(_positive(timestep), _finite(gravity), ground)
        self._bodies: dict[str, Body] = {}
        self._listeners: list[Callable[[], None]] = []
        self.forces = ExternalForces()
        self.clock: Callable[[], int] = self._own_clock
        """Time in ns of the cycle that is stepped, for forces with a start and an end; the simulation puts its own."""
        self._install(compile_world(self._settings, ()), 0.0)

    # -- robots ----------------------------------------------------------------------------------------------------

    def attach(self, robot: Robot, name: str, pose: Pose = ORIGIN) -> Body:
        """Put a robot into the world under `name`, all or nothing; the others go on as if nothing had happened.

        Raises:
            Refused: the name is taken, or the pose is not finite. BadInertia, BadJoint, BadShape, BadModel: MuJoCo
            cannot simulate it.
        """
        if name in self._bodies:
            raise Refused(f"a robot named {name!r} is in the world already", "give another name, or delete it first")
        body = Body(name, robot, (_finite(pose[0]), normalized(pose[1])))
        self._rebuild({**self._bodies, name: body}, newest=name)
        return body

    def detach(self, name: str) -> None:
        """Take a robot out, with the forces on it. Raises UnknownName."""
        gone = self.body(name)
        self.forces.drop(lambda force: force.body is not gone)
        self._rebuild({key: body for key, body in self._bodies.items() if body is not gone})

    def names(self) -> list[str]:
        """The robots in the order of their coming."""
        return list(self._bodies)

    def body(self, name: str) -> Body:
        """The robot attached under `name`. Raises UnknownName."""
        try:
            return self._bodies[name]
        except KeyError:
            raise UnknownName("model", name, list(self._bodies)) from None

    def on_rebuild(self, callback: Callable[[], None]) -> None:
        """Call back whenever `model`, `data` or `step` were replaced."""
        self._listeners.append(callback)

    def _rebuild(self, bodies: dict[str, Body], newest: str = "") -> None:
        model = compile_world(self._settings, bodies.values(), newest)
        states = {name: body.capture() for name, body in self._bodies.items() if name in bodies}
        self._bodies = bodies
        self._install(model, self.data.time)
        for name, body in bodies.items():
            body.bind(model, self.data)
            if name in states:
                body.put(states[name])
            else:
                body.put_at_spawn()
        for body in bodies.values():
            body.announce()
        self._announce()

    def _install(self, model: Any, time: float) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.data.time = time
        self._observer = Observer(model, self.data)
        self._advance = partial(mujoco.mj_step, model, self.data)
        self.step = self._advance if self.forces.is_empty else self._step_with_forces

    def _announce(self) -> None:
        for callback in self._listeners:
            callback()

    # -- running ---------------------------------------------------------------------------------------------------

    def step_n(self, cycles: int) -> None:
        """Advance by many steps with nobody in between, at the speed of C where no outside force acts."""
        if self.forces.is_empty:
            mujoco.mj_step(self.model, self.data, nstep=cycles)
            return
        for _ in range(cycles):
            self.step()

    def check(self) -> None:
        """Raises Diverged when a robot's state is not finite or huge. A few microseconds: meant for once per slice."""
        for array, part in ((self.data.qpos, "coordinates"), (self.data.qvel, "dofs")):
            good = np.abs(array) < HUGE
            if not good.all():
                raise Diverged(next(b.name for b in self._bodies.values() if not good[getattr(b, part)].all()))

    def _step_with_forces(self) -> None:
        self.forces.step(self.data, self.clock(), self._advance)
        if self.forces.is_empty:
            self._loads_changed()

    def _own_clock(self) -> int:
        return round(float(self.data.time + self._settings.timestep) * 1e9)

    @property
    def timestep(self) -> float:
        """Length of a step, s."""
        return self._settings.timestep

    def set_timestep(self, timestep: float) -> None:
        """Raises Refused unless it is above 0."""
        self._settings.timestep = self.model.opt.timestep = _positive(timestep)

    @property
    def gravity(self) -> Vector:
        """m/s²."""
        return self._settings.gravity

    def set_gravity(self, gravity: Vector) -> None:
        """Raises Refused unless it is finite."""
        self._settings.gravity = _finite(gravity)
        self.model.opt.gravity[:] = self._settings.gravity

    # -- state -----------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """All robots back to how they were attached, without forces from outside."""
        self.clear_forces()
        for body in self._bodies.values():
            body.put_at_spawn()
        self._observer.invalidate()

    def snapshot(self) -> Snapshot:
        """The state of this moment, for `restore`."""
        robots = {name: body.capture() for name, body in self._bodies.items()}
        return Snapshot(self.data.time, robots, tuple(self.forces.joint_forces), tuple(self.forces.wrenches))

    def restore(self, snapshot: Snapshot) -> None:
        """Back to the moment of the snapshot, exactly. Raises Refused when other robots are in the world now."""
        if snapshot.robots.keys() != self._bodies.keys():
            raise Refused(f"the snapshot is of other robots: {', '.join(snapshot.robots) or 'none'}")
        for name, body in self._bodies.items():
            body.put(snapshot.robots[name])
        self.data.time = snapshot.time
        self.forces.joint_forces, self.forces.wrenches = list(snapshot.joint_forces), list(snapshot.wrenches)
        self._loads_changed()
        self._observer.invalidate()

    def link_pose(self, name: str, link: str) -> Pose:
        """Place of the link's frame in the world. Raises UnknownName."""
        return self._observer.pose(self.body(name).link_id(link))

    def link_twist(self, name: str, link: str) -> Twist:
        """Velocity of the link's frame (linear at its origin, angular), in the world's axes. Raises UnknownName."""
        return self._observer.twist(self.body(name).link_id(link))

    def joint_state(self, name: str, joint: str) -> tuple[float, float, float]:
        """Position, velocity and applied effort of any moving joint, actuated or not. Raises UnknownName."""
        place = self.body(name).place(joint)
        effort = float(self.data.qfrc_applied[place.dof]) + self.forces.efforts.get(place.dof, 0.0)
        return float(self.data.qpos[place.qpos]), float(self.data.qvel[place.dof]), effort

    def set_pose(self, name: str, pose: Pose, twist: Twist | None = None) -> None:
        """Put a robot's root there, and give it the twist (world's axes) if there is one; a fixed robot has none.

        Raises:
            UnknownName: no such robot. Refused: not finite.
        """
        body = self.body(name)
        body.put_root((_finite(pose[0]), normalized(_finite4(pose[1]))))
        self._observer.invalidate()
        if twist is not None and not body.robot.is_fixed_to_world:
            self._set_root_twist(body, (_finite(twist[0]), _finite(twist[1])))

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
        self.data.qpos[place.qpos] = _number(position)
        if velocity is not None:
            self.data.qvel[place.dof] = _number(velocity)
        self._observer.invalidate()

    # -- forces from outside ---------------------------------------------------------------------------------------

    def add_joint_force(self, name: str, joint: str, effort: float, start_ns: int = 0, duration_ns: int = -1) -> None:
        """An effort (N or N·m) on a joint from `start_ns` for `duration_ns` of simulated time; negative: until cleared.

        Raises:
            UnknownName: no such robot or moving joint. Refused: not finite.
        """
        self.forces.add_joint(self.body(name), joint, _number(effort), start_ns, duration_ns)
        self._loads_changed()

    def add_wrench(
        self, name: str, link: str, force: Vector, torque: Vector, start_ns: int = 0, duration_ns: int = -1
    ) -> None:
        """A force (N) and torque (N·m), world's axes, on a link's centre of mass, as long as `add_joint_force` says.

        Raises:
            UnknownName: no such robot or link. Refused: not finite.
        """
        self.forces.add_wrench(self.body(name), link, _finite(force), _finite(torque), start_ns, duration_ns)
        self._loads_changed()

    def clear_joint_forces(self, name: str, joint: str) -> None:
        """End all efforts on a joint that came from outside. Raises UnknownName."""
        body = self.body(name)
        body.place(joint)
        self.forces.drop(lambda force: isinstance(force, Wrench) or force.body is not body or force.joint != joint)
        self._loads_changed()

    def clear_wrenches(self, name: str, link: str) -> None:
        """End all wrenches on a link. Raises UnknownName."""
        body = self.body(name)
        body.link_id(link)
        self.forces.drop(lambda force: isinstance(force, JointForce) or force.body is not body or force.link != link)
        self._loads_changed()

    def clear_forces(self) -> None:
        """End all forces from outside."""
        self.forces.drop(lambda _: False)
        self._loads_changed()

    def _loads_changed(self) -> None:
        if self.forces.is_empty:
            self.forces.efforts.clear()
        step = self._advance if self.forces.is_empty else self._step_with_forces
        if step != self.step:
            self.step = step
            self._announce()


def _number(value: float) -> float:
    if not math.isfinite(value):
        raise Refused(f"{value} is not a finite number")
    return float(value)


def _finite(vector: Vector) -> Vector:
    x, y, z = (_number(part) for part in vector)
    return (x, y, z)


def _finite4(values: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    a, b, c, d = (_number(part) for part in values)
    return (a, b, c, d)


def _positive(timestep: float) -> float:
    if not (math.isfinite(timestep) and timestep > 0.0):
        raise Refused(f"a time step of {timestep} s is not possible", "give a number above 0, such as 0.001")
    return float(timestep)
