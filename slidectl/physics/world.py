"""The simulated world: robots are attached and detached while it runs, their state is read and set, forces are applied.

It counts no time (the simulation does) and uses no controllers and no topics. A rebuild of the model copies the state
of the remaining robots to the bit. SI units; quaternions x y z w.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np

from slidectl.description.robot import Robot
from slidectl.errors import Refused, SlidectlError, UnknownName, listing
from slidectl.physics import hulls, mujoco_library
from slidectl.physics.applied_forces import AppliedForces, JointForce, Wrench
from slidectl.physics.attached_robot import AttachedRobot, LinkPlace
from slidectl.physics.collisions import depths, link_of
from slidectl.physics.hulls import Hulls
from slidectl.physics.world_spec import Settings, WorldSpec
from slidectl.rotations import ORIGIN, Pose, Vector, add, compose, cross, normalized, rotate, xyzw

Twist = tuple[Vector, Vector]
"""Linear (m/s) and angular (rad/s) velocity, in the world's axes."""

GRAVITY: Vector = (0.0, 0.0, -9.8)
"""m/s², the default of SDF and so of Gazebo."""

HUGE = 1e10
"""A position or velocity beyond this counts as diverged. It is MuJoCo's own bound."""

_OF_DATA = {
    "qpos": "qpos",
    "qvel": "dof",
    "qacc_warmstart": "dof",
    "qfrc_applied": "dof",
    "xfrc_applied": "body",
    "eq_active": "tie",
}
_OF_MODEL = {
    "body_pos": "body",
    "body_quat": "body",
    "body_invweight0": "body",
    "dof_invweight0": "dof",
    "tendon_invweight0": "tendon",
}
"""Arrays of MjData and MjModel that a rebuild copies, with the kind of their rows (see `AttachedRobot.part`).

Those of the model are the poses of roots and each robot's own weights."""
_OF_LAST_STEP = ("cacc", "cfrc_int", "xpos", "xquat", "xmat", "xipos", "ximat", "subtree_com", "cvel")
"""Results of the last step that sensors use. They cannot be computed from the state after the step."""
_PLACED = ("body_pos", "body_quat")


class Diverged(SlidectlError):
    """The state of a robot is no longer a number, or huge."""

    def __init__(self, robot: str) -> None:
        text = f"the simulation of robot {robot!r} diverged: its state is not finite or huge"
        super().__init__(text, "reset it (slidectl sim reset) or delete the robot; check masses, damping and gains")
        self.robot = robot


class Memory(NamedTuple):
    """Addresses of MjModel, MjData and arrays of numbers, and the lengths of qpos and qvel, for compiled code."""

    model: int
    data: int
    positions: int
    dofs: int
    arrays: list[int]
    """qpos, qvel, qfrc_applied, efforts of applied forces, velocities and table of the motors, and dof_frictionloss and
    dof_invweight0, which the motors change."""


class Views(NamedTuple):
    """Arrays of the state as memoryviews, for the hot path: indexing takes a third of the time that numpy takes.

    `qpos`, `qvel` and `forces` (qfrc_applied) of MuJoCo, `efforts` of applied forces and `velocities` of the motors. A
    rebuild of the model makes new ones.
    """

    qpos: memoryview[float]
    qvel: memoryview[float]
    forces: memoryview[float]
    efforts: memoryview[float]
    velocities: memoryview[float]


@dataclass(frozen=True)
class Overlap:
    """A link that penetrates a link of another robot, or the ground."""

    link: str
    robot: str | None
    """The other robot, or None for the ground."""
    other: str | None
    """The other robot's link."""
    depth: float
    """Penetration depth, m."""


class _Observer:
    """Kinematics of the present state, computed at the first query after a change.

    It uses its own MjData, so that queries never change data on which the next step depends, such as warm starts.
    """

    def __init__(self, model: Any, data: Any) -> None:
        self._model = model
        self._data = data
        self._copy: Any = None
        self._twist = np.zeros(6)
        self.invalidate()

    def invalidate(self) -> None:
        """Discard the kinematics, because the state was changed by other means than a step."""
        self._poses_at = self._twists_at = float("nan")

    def pose(self, link: LinkPlace) -> Pose:
        """Pose of the link's frame in the world: position (m), attitude x y z w."""
        self._refresh_poses()
        return compose(self._body_pose(link.body), link.frame)

    def twist(self, link: LinkPlace) -> Twist:
        """Linear velocity of the origin of the link's frame and angular velocity, in the world's axes."""
        self._refresh_twists()
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self._model, self._copy, kind, link.body, self._twist, 0)
        wx, wy, wz, vx, vy, vz = self._twist.tolist()
        arm = rotate(self._body_pose(link.body)[1], link.frame[0])
        return add((vx, vy, vz), cross((wx, wy, wz), arm)), (wx, wy, wz)

    def geometry(self) -> Any:
        """The copy, with the present poses of bodies and geoms."""
        self._refresh_poses()
        return self._copy

    def _body_pose(self, body: int) -> Pose:
        x, y, z = self._copy.xpos[body].tolist()
        return (x, y, z), xyzw(tuple(self._copy.xquat[body].tolist()))

    def _refresh_poses(self) -> None:
        if self._poses_at == self._data.time:
            return
        if self._copy is None:
            self._copy = mujoco.MjData(self._model)
        self._copy.qpos[:] = self._data.qpos
        mujoco.mj_kinematics(self._model, self._copy)
        self._poses_at = self._data.time

    def _refresh_twists(self) -> None:
        self._refresh_poses()
        if self._twists_at == self._data.time:
            return
        self._copy.qvel[:] = self._data.qvel
        mujoco.mj_comPos(self._model, self._copy)
        mujoco.mj_comVel(self._model, self._copy)
        self._twists_at = self._data.time


class World:
    """A world with a ground, a light, gravity, and robots."""

    saved_attributes: ClassVar[None] = None

    step: Callable[[], None]
    """Advance by one time step. Replaced when the model is rebuilt or forces come or go: see `on_rebuild`."""

    def __init__(self, timestep: float = 0.001, gravity: Vector = GRAVITY, ground: bool = True) -> None:
        mujoco_library.prepare()
        self._settings = Settings(timestep, finite(gravity), ground)
        self._robots: dict[str, AttachedRobot] = {}
        self._listeners: list[Callable[[], None]] = []
        self._frozen: list[AttachedRobot] = []
        """Robots that diverged; see `freeze`."""
        self.applied_forces = AppliedForces()
        self.clock: Callable[[], int] = lambda: round(float(self.data.time + self._settings.timestep) * 1e9)
        """Time of the cycle in ns, for forces with a start and an end. The simulation sets its own."""
        self._spec: WorldSpec | None = WorldSpec(self._settings)
        model = self._spec.compile()
        self._use(model, mujoco.MjData(model))
        self._bind_forces()

    # -- robots ----------------------------------------------------------------------------------------------------

    def attach(
        self, description: Robot, name: str, pose: Pose = ORIGIN, hulls_read: Hulls | None = None
    ) -> AttachedRobot:
        """Add a robot to the world under `name`, all or nothing. The motion of the others does not change.

        `hulls_read` has the hulls of its meshes; without it their files are read now.

        Raises:
            Refused: the name is used, or the pose is not finite. BadInertia, BadJoint, BadShape, BadModel: MuJoCo
            cannot simulate the robot.
        """
        if name in self._robots:
            raise Refused(f"a robot named {name!r} is in the world already", "give another name, or delete it first")
        known = hulls.read_all(description) if hulls_read is None else hulls_read
        robot = AttachedRobot(name, description, finite_pose(pose), known)
        spec = WorldSpec(self._settings, (robot,))
        model = spec.compile(name)
        robot.bind(model, None)
        if self._robots:
            spec, self._spec = self._spec or WorldSpec(self._settings, self._robots.values()), None
            spec.add(robot)  # builds only the new robot
            model = spec.compile(name)
        self._rebuild({**self._robots, name: robot}, model, spec)
        return robot

    @contextmanager
    def attached(
        self, description: Robot, name: str, pose: Pose = ORIGIN, hulls_read: Hulls | None = None
    ) -> Iterator[AttachedRobot]:
        """As `attach`, but an exception of the block removes the robot. Make no step in the block."""
        with self._all_or_nothing():
            yield self.attach(description, name, pose, hulls_read)

    def detach(self, name: str) -> None:
        """Remove a robot and the forces on it, all or nothing. Raises UnknownName."""
        gone = self.robot(name)
        robots = {key: robot for key, robot in self._robots.items() if robot is not gone}
        spec, self._spec = self._spec or WorldSpec(self._settings, self._robots.values()), None
        spec.remove(gone)
        self._rebuild(robots, spec.compile(), spec, gone)

    def names(self) -> list[str]:
        """The names of the robots, in the order of attaching."""
        return list(self._robots)

    def robot(self, name: str) -> AttachedRobot:
        """The robot attached under `name`. Raises UnknownName."""
        try:
            return self._robots[name]
        except KeyError:
            raise UnknownName("model", name, list(self._robots)) from None

    def on_rebuild(self, callback: Callable[[], None]) -> None:
        """Call back whenever `model`, `data` or `step` is replaced."""
        self._listeners.append(callback)

    def _rebuild(
        self, robots: dict[str, AttachedRobot], model: Any, spec: WorldSpec | None, gone: AttachedRobot | None = None
    ) -> None:
        """Replace robots and model. `robots` are the former ones without `gone`, followed by a new one, if any.

        If anything fails, a listener too, the former world is restored.
        """
        with self._all_or_nothing():
            old_robots, old_model, old_data = self._robots, self.model, self.data
            data = mujoco.MjData(model)
            data.time = old_data.time
            self._robots = robots
            self._use(model, data)
            carry_over(old_model, old_data, model, self.data, gone)
            if gone is not None:
                self.applied_forces.forget(gone)
            unmoved = list(old_robots).index(gone.name) if gone is not None else len(old_robots)
            for place, (name, robot) in enumerate(robots.items()):
                if place < unmoved:
                    robot.follow(model, self.data)
                else:
                    robot.bind(model, self.data)
                if name not in old_robots:
                    robot.reset_to_spawn()
            self._bind_forces()
            self._announce_all()
            self._spec = spec

    @contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """After an exception in the block, restore robots, model and forces. The block makes no step.

        The specification may be half changed then, so it is discarded and made anew when it is needed.
        """
        robots, frozen, model, data = self._robots, self._frozen, self.model, self.data
        forces = self.applied_forces.snapshot()
        try:
            yield
        except BaseException:
            if self.data is not data:
                self._spec = None
                self._robots, self._frozen = robots, frozen
                self._use(model, data)
                for robot in robots.values():
                    robot.bind(model, data)
                self.applied_forces.restore(forces)
                self._bind_forces()
                self._announce_all()
            raise

    def _announce_all(self) -> None:
        for robot in self._robots.values():
            robot.announce()
        self._announce()

    def _replace_broken_data(self) -> None:
        """Make a new MjData after an EngineError, which leaves MjData unusable."""
        if self.data.pstack:
            self._rebuild(self._robots, self.model, self._spec)

    def _use(self, model: Any, data: Any) -> None:
        self.model, self.data = model, data
        self._observer = _Observer(model, data)
        self._forces_at = math.nan
        """MuJoCo's time after the step whose accelerations and forces `restore` has copied to `data`."""
        self._advance = partial(mujoco.mj_step, model, data)
        self._frozen = [robot for robot in self._frozen if robot in self._robots.values()]
        self.step = self._chosen_step()

    def _bind_forces(self) -> None:
        """Bind forces and views to the model. The robots are bound already."""
        self.applied_forces.bind(self.model, self.data, self._robots)
        data, forces = self.data, self.applied_forces
        arrays: list[Any] = [data.qpos, data.qvel, data.qfrc_applied, forces.efforts, forces.motors.velocities]
        views: list[Any] = [memoryview(array) for array in arrays]
        self.views = Views(*views)
        self._choose_step()

    def _announce(self) -> None:
        for callback in self._listeners:
            callback()

    # -- running ---------------------------------------------------------------------------------------------------

    @property
    def steps_alone(self) -> bool:
        """True while a step needs only MuJoCo and the data of motors in `memory`."""
        forces = self.applied_forces
        is_compilable = forces.motors.is_empty or all(mujoco_library.constraint_variables())
        return not self._frozen and not forces.has_forces and is_compilable

    def memory(self) -> Memory:
        """The addresses of the model and its state, valid until the next rebuild."""
        model, data = self.model, self.data
        forces, motors = self.applied_forces, self.applied_forces.motors
        state = (data.qpos, data.qvel, data.qfrc_applied, forces.efforts)
        arrays = (*state, motors.velocities, motors.table, model.dof_frictionloss, model.dof_invweight0)
        addresses = mujoco_library.struct_address(model), mujoco_library.struct_address(data)
        return Memory(*addresses, model.nq, model.nv, [array.ctypes.data for array in arrays])

    def diverged(self) -> list[str]:
        """The robots whose state is not finite or huge."""
        positions, velocities = np.abs(self.data.qpos) < HUGE, np.abs(self.data.qvel) < HUGE
        if positions.all() and velocities.all():
            return []
        return [
            robot.name
            for robot in self._robots.values()
            if not (positions[robot.coordinates].all() and velocities[robot.dofs].all())
        ]

    def check(self) -> None:
        """Raises Diverged when a robot's state is not finite or huge. Takes microseconds; call it once per slice."""
        for name in self.diverged():
            raise Diverged(name)

    @property
    def frozen(self) -> list[str]:
        """The robots that are held at rest since they diverged, in the order of attaching."""
        return [robot.name for robot in self._frozen]

    def freeze(self, name: str, positions: Any) -> None:
        """Hold a robot at rest from now on, until `reset`, or until it is detached. Forces on it are removed.

        `positions`: the qpos of a sound state of the whole world, of which the robot gets its part; None: its state at
        spawn. Raises UnknownName.
        """
        robot = self.robot(name)
        part = None if positions is None else np.asarray(positions)[robot.coordinates]
        if part is not None and (np.abs(part) < HUGE).all():
            self.data.qpos[robot.coordinates] = part
        else:
            robot.reset_to_spawn()
        for array in (self.data.qvel, self.data.qacc, self.data.qacc_warmstart, self.data.qfrc_applied):
            array[robot.dofs] = 0.0
        self.applied_forces.motors.velocities[robot.dofs] = 0.0
        self.applied_forces.efforts[robot.dofs] = 0.0
        self._frozen = [one for one in self._robots.values() if one is robot or one in self._frozen]
        self._remove_forces(lambda force: force.robot == name)
        self._observer.invalidate()

    def _step_with_frozen(self) -> None:
        """Make a step, after which the frozen robots are where they were, at rest.

        The step computes them too, without forces of their hardware, so that others still touch them.
        """
        data, motors = self.data, self.applied_forces.motors
        held = [data.qpos[robot.coordinates].copy() for robot in self._frozen]
        for robot in self._frozen:
            data.qfrc_applied[robot.dofs] = 0.0
            data.qvel[robot.dofs] = 0.0
            data.qacc_warmstart[robot.dofs] = 0.0
            motors.velocities[robot.dofs] = 0.0
        if self.applied_forces.is_empty:
            self._advance()
        else:
            self._step_with_forces()
        for robot, positions in zip(self._frozen, held, strict=True):
            data.qpos[robot.coordinates] = positions
            data.qvel[robot.dofs] = 0.0
            data.qacc_warmstart[robot.dofs] = 0.0

    def _step_with_forces(self) -> None:
        self.applied_forces.step(self.model, self.data, self.clock())
        if self.applied_forces.is_empty:
            self._forces_changed()

    def _choose_step(self) -> None:
        if self.applied_forces.is_empty:
            self.applied_forces.clear_efforts()
        self.step = self._chosen_step()

    def _chosen_step(self) -> Callable[[], None]:
        if self._frozen:
            return self._step_with_frozen
        return self._advance if self.applied_forces.is_empty else self._step_with_forces

    def _forces_changed(self) -> None:
        before = self.step
        self._choose_step()
        if before != self.step:
            self._announce()

    @property
    def timestep(self) -> float:
        """The length of a step, s."""
        return self._settings.timestep

    def set_timestep(self, timestep: float) -> None:
        """Set the length of a step, s, above 0."""
        self._settings.timestep = self.model.opt.timestep = timestep
        self._bind_forces()
        self._announce()

    @property
    def has_ground(self) -> bool:
        """True when there is a ground at height 0."""
        return self._settings.ground

    @property
    def gravity(self) -> Vector:
        """The gravity, m/s², in the world's axes."""
        return self._settings.gravity

    def set_gravity(self, gravity: Vector) -> None:
        """Set the gravity, m/s². Raises Refused unless it is finite."""
        self._settings.gravity = finite(gravity)
        self.model.opt.gravity[:] = self._settings.gravity

    # -- state -----------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Restore the state right after attaching for all robots, without external forces."""
        self._replace_broken_data()
        self._frozen = []
        self.applied_forces.motors.velocities[:] = 0.0
        self.applied_forces.clear_efforts()
        self._remove_forces(lambda _: True)
        for robot in self._robots.values():
            robot.reset_to_spawn()
        self._observer.invalidate()

    def numbers(self) -> bytes:
        """The arrays of `views` as 64-bit floats; see `number_names`.

        Takes a few microseconds. A journal records them each simulated second.
        """
        return b"".join(self.views)

    def number_names(self) -> list[str]:
        """The name of each of `numbers`, such as `ROBOT, JOINT: position`."""
        nq, nv = self.model.nq, self.model.nv
        names = [""] * (nq + 4 * nv)
        for robot in self._robots.values():
            places = {place.qpos: (joint, place.dof) for joint, place in robot.joints.items()}
            dofs = dict(places.values())
            root = f"{robot.name}, root"
            names[robot.coordinates] = [
                f"{robot.name}, {places[at][0]}: position" if at in places else f"{root}: pose[{at - robot.root_qpos}]"
                for at in range(nq)[robot.coordinates]
            ]
            joints = {dof: joint for joint, dof in dofs.items()}
            for kind, what in enumerate(("velocity", "force", "effort", "desired velocity")):
                for dof in range(nv)[robot.dofs]:
                    of = f"{robot.name}, {joints[dof]}" if dof in joints else f"{root}[{dof - robot.root_dof}]"
                    names[nq + kind * nv + dof] = f"{of}: {what}"
        return names

    def snapshot(self) -> dict[str, Any]:
        """The present state as plain data and arrays of numbers, for `restore`."""
        self.compute_body_forces()
        return {
            "robots": list(self._robots),
            "time": float(self.data.time),
            "data": {name: getattr(self.data, name).copy() for name in (*_OF_DATA, *_OF_LAST_STEP)},
            "model": {name: getattr(self.model, name).copy() for name in _PLACED},
            "loads": self.applied_forces.snapshot(),
            "frozen": self.frozen,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state of the snapshot exactly. Raises Refused when the world has other robots now."""
        self._replace_broken_data()
        pairs = [
            (getattr(owner, name), values)
            for owner, arrays in ((self.data, snapshot["data"]), (self.model, snapshot["model"]))
            for name, values in arrays.items()
        ]
        if snapshot["robots"] != list(self._robots) or any(one.shape != other.shape for one, other in pairs):
            raise Refused(f"the snapshot is of other robots: {listing(snapshot['robots'])}")
        for array, values in pairs:
            array[:] = values
        self.data.time = self._forces_at = snapshot["time"]
        self._frozen = [self._robots[name] for name in snapshot.get("frozen", ())]
        self.applied_forces.motors.release(self.model)
        self.applied_forces.restore(snapshot["loads"])
        self._bind_forces()
        self.applied_forces.restore_last_step(snapshot["loads"])
        self._announce_all()
        self._observer.invalidate()

    def compute_body_forces(self) -> None:
        """Compute the accelerations of MuJoCo's bodies and the forces between them in the last step, in `data`."""
        if self._forces_at != self.data.time:
            mujoco.mj_rnePostConstraint(self.model, self.data)  # writes nothing else

    def link_pose(self, name: str, link: str) -> Pose:
        """The pose of the link's frame in the world. Raises UnknownName."""
        return self._observer.pose(self.robot(name).link(link))

    def link_twist(self, name: str, link: str) -> Twist:
        """Velocity of the link's frame (linear at its origin, angular), in the world's axes. Raises UnknownName."""
        return self._observer.twist(self.robot(name).link(link))

    def present(self) -> Any:
        """An MjData with the present geometry, to read only. That of `data` is from the start of the last step."""
        return self._observer.geometry()

    def joint_state(self, name: str, joint: str) -> tuple[float, float, float]:
        """Position, velocity and applied effort of any moving joint, actuated or not. Raises UnknownName."""
        place = self.robot(name).place(joint)
        effort = float(self.data.qfrc_applied[place.dof] + self.applied_forces.efforts[place.dof])
        return float(self.data.qpos[place.qpos]), float(self.data.qvel[place.dof]), effort

    def set_pose(self, name: str, pose: Pose, twist: Twist | None = None) -> None:
        """Set the pose of a robot's root, and its twist (world's axes) if given. A fixed robot has no twist.

        Raises UnknownName: no such robot. Refused: not finite.
        """
        robot = self.robot(name)
        robot.set_root_pose(finite_pose(pose))
        self._observer.invalidate()
        if twist is not None and not robot.description.is_fixed_to_world:
            self.set_root_twist(name, (finite(twist[0]), finite(twist[1])))

    def set_root_twist(self, name: str, twist: Twist) -> None:
        """Set the velocity (finite, world's axes) of a free root link. Raises UnknownName."""
        # A free joint's velocities are linear in the world's axes and angular in the body's.
        robot, turn, local = self.robot(name), np.zeros(4), np.zeros(3)
        start = robot.root_qpos + 3
        mujoco.mju_negQuat(turn, self.data.qpos[start : start + 4])
        mujoco.mju_rotVecQuat(local, np.array(twist[1]), turn)
        self.data.qvel[robot.root_dof : robot.root_dof + 6] = [*twist[0], *local]
        self._observer.invalidate()

    def set_joint(self, name: str, joint: str, position: float, velocity: float | None = None) -> None:
        """Set a joint's position; its velocity stays unless one is given. Raises UnknownName, Refused (not finite)."""
        place = self.robot(name).place(joint)
        self.data.qpos[place.qpos] = number(position)
        if velocity is not None:
            self.data.qvel[place.dof] = number(velocity)
        self._observer.invalidate()

    def set_joints(self, name: str, positions: Mapping[str, float]) -> None:
        """Set joint positions, at rest, with their mimic joints. Raises UnknownName, Refused (not finite)."""
        for joint, position in positions.items():
            self.set_joint(name, joint, position, 0.0)
        self.robot(name).set_joints(positions)

    def overlaps(self, name: str, least: float) -> list[Overlap]:
        """Links of the robot that penetrate others by more than `least` (m), the deepest first. Raises UnknownName."""
        names = {robot.root_id: robot.name for robot in self._robots.values()}
        deepest: dict[tuple[str, str | None, str | None], float] = {}
        for (own, other), depth in depths(self.model, self.data, self.robot(name).root_id).items():
            owner = names.get(int(self.model.body_rootid[self.model.geom_bodyid[other]]))
            theirs = None if owner is None else link_of(self.model, other, owner)
            pair = (link_of(self.model, own, name), owner, theirs)
            deepest[pair] = max(depth, deepest.get(pair, 0.0))
        found = [Overlap(*pair, depth) for pair, depth in deepest.items() if depth > least]
        return sorted(found, key=lambda overlap: -overlap.depth)

    # -- forces from outside ---------------------------------------------------------------------------------------

    def add_joint_force(self, name: str, joint: str, effort: float, start_ns: int = 0, duration_ns: int = -1) -> None:
        """Apply an effort (N or N·m) to a joint from `start_ns` for `duration_ns`; negative: until cleared.

        Raises UnknownName: no such robot or moving joint. Refused: not finite.
        """
        self.robot(name).place(joint)
        self.applied_forces.joint_forces.append(JointForce(name, joint, number(effort), start_ns, duration_ns))
        self._forces_changed()

    def add_wrench(
        self,
        name: str,
        link: str,
        force: Vector,
        torque: Vector,
        start_ns: int = 0,
        duration_ns: int = -1,
        source: str = "",
    ) -> None:
        """Apply a force (N) and torque (N·m), world's axes, at a link's centre of mass. Times as in `add_joint_force`.

        Raises UnknownName: no such robot or link. Refused: not finite.
        """
        self.robot(name).link(link)
        wrench = Wrench(name, link, finite(force), finite(torque), start_ns, duration_ns, source)
        self.applied_forces.wrenches.append(wrench)
        self._forces_changed()

    def _remove_forces(self, ends: Callable[[JointForce | Wrench], bool]) -> None:
        self.applied_forces.remove(ends)
        self._forces_changed()

    def drop_wrenches(self, source: str) -> None:
        """End the wrenches with this source."""
        self._remove_forces(lambda force: isinstance(force, Wrench) and force.source == source)

    def clear_joint_forces(self, name: str, joint: str) -> None:
        """End all external efforts on a joint. Raises UnknownName."""
        self.robot(name).place(joint)
        self._remove_forces(lambda force: isinstance(force, JointForce) and force[:2] == (name, joint))

    def clear_wrenches(self, name: str, link: str) -> None:
        """End all wrenches on a link. Raises UnknownName."""
        self.robot(name).link(link)
        self._remove_forces(lambda force: isinstance(force, Wrench) and force[:2] == (name, link))

    def set_motors(self, robot: AttachedRobot, most_efforts: dict[str, float]) -> None:
        """Drive these joints and `lasting_motors` by motors, each with at most this effort (N or N·m), and no others.

        `applied_forces.motors.velocities` has their desired velocities.
        """
        self.applied_forces.motors.release(self.model)
        self.applied_forces.efforts[robot.dofs] = 0.0
        self.applied_forces.motors.set(robot.name, most_efforts | robot.lasting_motors)
        self._bind_forces()
        self._announce()

    @contextmanager
    def changing_friction(self) -> Iterator[None]:
        """Context for changes of joint friction in the model. Afterwards motors find their constraints again."""
        yield
        self._bind_forces()
        self._announce()

    def add_motors(self, robot: AttachedRobot, most_efforts: dict[str, float]) -> None:
        """Add motors that stay as long as the robot is in the world; `set_motors` does not remove them."""
        robot.lasting_motors |= most_efforts
        self.set_motors(robot, self.applied_forces.motors.of_robot(robot.name))


def number(value: float) -> float:
    if not math.isfinite(value):
        raise Refused(f"{value} is not a finite number")
    return float(value)


def finite(vector: Vector) -> Vector:
    x, y, z = map(number, vector)
    return (x, y, z)


def finite_pose(pose: Pose) -> Pose:
    x, y, z, w = map(number, pose[1])
    return finite(pose[0]), normalized((x, y, z, w))


def carry_over(model: Any, data: Any, new_model: Any, new_data: Any, gone: AttachedRobot | None) -> None:
    """Copy all state on which the motion of the robots depends. `gone` is in the old world only."""
    for old, new, arrays in ((data, new_data, _OF_DATA), (model, new_model, _OF_MODEL)):
        for name, kind in arrays.items():
            values = getattr(old, name)
            if gone is not None:
                values = np.delete(values, gone.part(kind), axis=0)
            getattr(new, name)[: len(values)] = values
