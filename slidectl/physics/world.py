"""The simulated world: robots come and go while it runs; one looks at their state, changes it, and pushes them.

It counts no time (the simulation does) and knows neither controllers nor topics. The state of the robots that stay is
carried over every rebuild of the model, to the last bit. SI units; quaternions x y z w.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import mujoco
import numpy as np

from slidectl.description.robot import Robot
from slidectl.errors import Refused, SlidectlError, UnknownName, listing
from slidectl.physics import hulls, mujoco_library
from slidectl.physics.body import Body
from slidectl.physics.hulls import Hulls
from slidectl.physics.loads import JointForce, Loads, Wrench
from slidectl.physics.observer import Observer, Twist
from slidectl.physics.touching import depths, link_of
from slidectl.physics.world_spec import Settings, WorldSpec
from slidectl.rotations import ORIGIN, Pose, Vector, normalized

GRAVITY: Vector = (0.0, 0.0, -9.8)
"""m/s², the default of SDF and so of Gazebo."""


HUGE = 1e10
"""A position or velocity beyond this is nonsense; MuJoCo's own bound."""

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
"""Arrays by the kind of their rows, as `Body.part` names it. Of the model: where roots were put, and each robot's own
weights."""
_OF_LAST_STEP = ("cacc", "cfrc_int", "xpos", "xquat", "xmat", "xipos", "ximat", "subtree_com", "cvel")
"""What sensors make their values of: the last step computed it, and the state after that step does not give it back."""
_PLACED = ("body_pos", "body_quat")


class Diverged(SlidectlError):
    """The state of a robot is no longer a number, or huge."""

    def __init__(self, robot: str) -> None:
        text = f"the simulation of robot {robot!r} diverged: its state is not finite or huge"
        super().__init__(text, "reset it (slidectl sim reset) or delete the robot; check masses, damping and gains")
        self.robot = robot


class Memory(NamedTuple):
    """Addresses of MjModel and MjData, and of arrays of numbers; and the lengths of qpos and qvel."""

    model: int
    data: int
    positions: int
    dofs: int
    arrays: list[int]
    """qpos, qvel, qfrc_applied, efforts of the loads, velocities and table of the motors, and dof_frictionloss and
    dof_invweight0, which the motors change."""


class Views(NamedTuple):
    """Arrays of the state as memoryviews, for the hot path: indexing one costs a third of what a numpy scalar costs.

    `qpos`, `qvel` and `forces` (qfrc_applied) of MuJoCo, `efforts` of the loads and `velocities` of the motors. Others
    when the model was rebuilt.
    """

    qpos: memoryview[float]
    qvel: memoryview[float]
    forces: memoryview[float]
    efforts: memoryview[float]
    velocities: memoryview[float]


class _State(NamedTuple):
    """What a world is, for the way back when a robot cannot come or go after all."""

    bodies: dict[str, Body]
    model: Any
    data: Any
    loads: dict[str, Any]


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


class World:
    """A ground, a light, gravity, and robots."""

    step: Callable[[], None]
    """Advance by one time step. Replaced when the model is rebuilt or forces come and go: see `on_rebuild`."""

    def __init__(self, timestep: float = 0.001, gravity: Vector = GRAVITY, ground: bool = True) -> None:
        mujoco_library.prepare()
        self._settings = Settings(positive(timestep), finite(gravity), ground)
        self._bodies: dict[str, Body] = {}
        self._listeners: list[Callable[[], None]] = []
        self.loads = Loads()
        self.clock: Callable[[], int] = lambda: round(float(self.data.time + self._settings.timestep) * 1e9)
        """Time in ns of the cycle that is stepped, for forces with a start and an end; the simulation puts its own."""
        self._spec: WorldSpec | None = WorldSpec(self._settings)
        self._install(self._spec.compile(), 0.0)
        self._bind_loads()

    # -- robots ----------------------------------------------------------------------------------------------------

    def attach(self, robot: Robot, name: str, pose: Pose = ORIGIN, hulls_read: Hulls | None = None) -> Body:
        """Put a robot into the world under `name`, all or nothing; the others go on as if nothing had happened.

        `hulls_read` has what its meshes collide as; without it their files are read now.

        Raises:
            Refused: the name is taken, or the pose is not finite. BadInertia, BadJoint, BadShape, BadModel: MuJoCo
            cannot simulate it.
        """
        if name in self._bodies:
            raise Refused(f"a robot named {name!r} is in the world already", "give another name, or delete it first")
        known = hulls.read_all(robot) if hulls_read is None else hulls_read
        body = Body(name, robot, finite_pose(pose), known)
        spec = WorldSpec(self._settings, (body,))
        model = spec.compile(name)
        body.bind(model, None)
        if self._bodies:
            spec, self._spec = self._spec or WorldSpec(self._settings, self._bodies.values()), None
            spec.add(body)  # only the new robot is built, the others are in the specification
            model = spec.compile(name)
        self._rebuild({**self._bodies, name: body}, model, spec)
        return body

    @contextmanager
    def attached(self, robot: Robot, name: str, pose: Pose = ORIGIN, hulls_read: Hulls | None = None) -> Iterator[Body]:
        """The same; the robot stays if the block ends well. Else the world is what it was before, the old model again:
        nothing is compiled, so the way back cannot fail. No step may be made inside.
        """
        before = self._state()
        body = self.attach(robot, name, pose, hulls_read)
        try:
            yield body
        except BaseException:
            self._go_back(before)
            raise

    def detach(self, name: str) -> None:
        """Take a robot out, with the forces on it, all or nothing. Raises UnknownName."""
        gone = self.body(name)
        bodies = {key: body for key, body in self._bodies.items() if body is not gone}
        spec, self._spec = self._spec, None
        if spec is not None:
            spec.remove(gone)
        else:
            spec = WorldSpec(self._settings, bodies.values())
        self._rebuild(bodies, spec.compile(), spec, gone)

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

    def _rebuild(self, bodies: dict[str, Body], model: Any, spec: WorldSpec | None, gone: Body | None = None) -> None:
        """Go on with these robots, whose model it is: those that were there, without `gone`, then a new one.

        If anything fails on the way, a listener too, the world is what it was before.
        """
        before = self._state()
        try:
            self._bodies = bodies
            self._install(model, self.data.time)
            carry_over(before.model, before.data, model, self.data, gone)
            if gone is not None:
                self.loads.forget(gone)
            unmoved = list(before.bodies).index(gone.name) if gone is not None else len(before.bodies)
            for place, (name, body) in enumerate(bodies.items()):
                if place < unmoved:
                    body.follow(model, self.data)
                else:
                    body.bind(model, self.data)
                if name not in before.bodies:
                    body.put_at_spawn()
            self._bind_loads()
            self._announce_all()
        except BaseException:
            self._go_back(before)
            raise
        self._spec = spec

    def _state(self) -> _State:
        return _State(self._bodies, self.model, self.data, self.loads.snapshot())

    def _go_back(self, before: _State) -> None:
        """Be again what the world was before a robot came or went; no step has been made since.

        The specification holds what came of the change half-way: it is made anew when it is needed.
        """
        self._spec = None
        self._bodies = before.bodies
        self._use(before.model, before.data)
        for body in before.bodies.values():
            body.bind(before.model, before.data)
        self.loads.restore(before.loads, before.bodies)
        self._bind_loads()
        self._announce_all()

    def _announce_all(self) -> None:
        for body in self._bodies.values():
            body.announce()
        self._announce()

    def _replace_broken_data(self) -> None:
        """An EngineError leaves MjData unusable; go on with a new one then."""
        if self.data.pstack:
            self._rebuild(self._bodies, self.model, self._spec)

    def _install(self, model: Any, time: float) -> None:
        data = mujoco.MjData(model)
        data.time = time
        self._use(model, data)

    def _use(self, model: Any, data: Any) -> None:
        self.model, self.data = model, data
        self._observer = Observer(model, data)
        self._forces_at = math.nan
        """MuJoCo's time after the step whose accelerations and forces are in `data`, where `restore` has put them."""
        self._advance = partial(mujoco.mj_step, model, data)
        self.step = self._advance if self.loads.is_empty else self._step_with_loads

    def _bind_loads(self) -> None:
        """Go on with what acts on the robots, which are bound to the model."""
        self.loads.bind(self.model, self.data)
        data, loads = self.data, self.loads
        arrays: list[Any] = [data.qpos, data.qvel, data.qfrc_applied, loads.efforts, loads.motors.velocities]
        views: list[Any] = [memoryview(array) for array in arrays]
        self.views = Views(*views)
        self._choose_step()

    def _announce(self) -> None:
        for callback in self._listeners:
            callback()

    # -- running ---------------------------------------------------------------------------------------------------

    @property
    def steps_alone(self) -> bool:
        """True while a step needs nothing but MuJoCo, and what is in `memory` of motors."""
        loads = self.loads
        return not loads.has_forces and (loads.motors.is_empty or loads.motors.is_compilable)

    def memory(self) -> Memory:
        """Where the model and its state lie, until the next rebuild."""
        model, data = self.model, self.data
        loads, motors = self.loads, self.loads.motors
        state = (data.qpos, data.qvel, data.qfrc_applied, loads.efforts)
        arrays = (*state, motors.velocities, motors.table, model.dof_frictionloss, model.dof_invweight0)
        addresses = mujoco_library.struct_address(model), mujoco_library.struct_address(data)
        return Memory(*addresses, model.nq, model.nv, [array.ctypes.data for array in arrays])

    def check(self) -> None:
        """Raises Diverged when a robot's state is not finite or huge. A few microseconds: meant for once per slice."""
        positions, velocities = np.abs(self.data.qpos) < HUGE, np.abs(self.data.qvel) < HUGE
        if positions.all() and velocities.all():
            return
        for body in self._bodies.values():
            if not (positions[body.coordinates].all() and velocities[body.dofs].all()):
                raise Diverged(body.name)

    def _step_with_loads(self) -> None:
        self.loads.step(self.model, self.data, self.clock())
        if self.loads.is_empty:
            self._loads_changed()

    def _choose_step(self) -> None:
        if self.loads.is_empty:
            self.loads.clear_efforts()
        self.step = self._advance if self.loads.is_empty else self._step_with_loads

    def _loads_changed(self) -> None:
        before = self.step
        self._choose_step()
        if before != self.step:
            self._announce()

    @property
    def timestep(self) -> float:
        """Length of a step, s."""
        return self._settings.timestep

    def set_timestep(self, timestep: float) -> None:
        """Raises Refused unless it is above 0."""
        self._settings.timestep = self.model.opt.timestep = positive(timestep)
        self._bind_loads()
        self._announce()

    @property
    def has_ground(self) -> bool:
        """Whether there is a floor at height 0."""
        return self._settings.ground

    @property
    def gravity(self) -> Vector:
        """m/s²."""
        return self._settings.gravity

    def set_gravity(self, gravity: Vector) -> None:
        """Raises Refused unless it is finite."""
        self._settings.gravity = finite(gravity)
        self.model.opt.gravity[:] = self._settings.gravity

    # -- state -----------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """All robots back to how they were attached, without forces from outside."""
        self._replace_broken_data()
        self.loads.motors.velocities[:] = 0.0
        self.loads.clear_efforts()
        self.loads.keep(lambda _: False)
        self._loads_changed()
        for body in self._bodies.values():
            body.put_at_spawn()
        self._observer.invalidate()

    def numbers(self) -> bytes:
        """All positions, velocities and forces, and what is asked of the joints, as 64-bit floats; see `number_names`.

        A few microseconds: a journal takes them each simulated second.
        """
        return b"".join(self.views)

    def number_names(self) -> list[str]:
        """What each of `numbers` is, `ROBOT, JOINT: position`, say."""
        nq, nv = self.model.nq, self.model.nv
        names = [""] * (nq + 4 * nv)
        for body in self._bodies.values():
            places = {place.qpos: (joint, place.dof) for joint, place in body.joints.items()}
            dofs = dict(places.values())
            root = f"{body.name}, root"
            names[body.coordinates] = [
                f"{body.name}, {places[at][0]}: position" if at in places else f"{root}: pose[{at - body.root_qpos}]"
                for at in range(nq)[body.coordinates]
            ]
            joints = {dof: joint for joint, dof in dofs.items()}
            for kind, what in enumerate(("velocity", "force", "effort", "velocity asked for")):
                for dof in range(nv)[body.dofs]:
                    of = f"{body.name}, {joints[dof]}" if dof in joints else f"{root}[{dof - body.root_dof}]"
                    names[nq + kind * nv + dof] = f"{of}: {what}"
        return names

    def snapshot(self) -> dict[str, Any]:
        """The state of this moment as plain data and arrays of numbers, for `restore`."""
        self.compute_body_forces()
        return {
            "robots": list(self._bodies),
            "time": float(self.data.time),
            "data": {name: getattr(self.data, name).copy() for name in (*_OF_DATA, *_OF_LAST_STEP)},
            "model": {name: getattr(self.model, name).copy() for name in _PLACED},
            "loads": self.loads.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Back to the moment of the snapshot, exactly. Raises Refused when other robots are in the world now."""
        self._replace_broken_data()
        pairs = [
            (getattr(owner, name), values)
            for owner, arrays in ((self.data, snapshot["data"]), (self.model, snapshot["model"]))
            for name, values in arrays.items()
        ]
        if snapshot["robots"] != list(self._bodies) or any(one.shape != other.shape for one, other in pairs):
            raise Refused(f"the snapshot is of other robots: {listing(snapshot['robots'])}")
        for array, values in pairs:
            array[:] = values
        self.data.time = self._forces_at = snapshot["time"]
        self.loads.motors.release(self.model)
        self.loads.restore(snapshot["loads"], self._bodies)
        self._bind_loads()
        self.loads.restore_last_step(snapshot["loads"])
        self._announce_all()
        self._observer.invalidate()

    def compute_body_forces(self) -> None:
        """Compute in `data` the accelerations of bodies and the forces between them in the last step."""
        if self._forces_at != self.data.time:
            mujoco.mj_rnePostConstraint(self.model, self.data)  # writes nothing else

    def link_pose(self, name: str, link: str) -> Pose:
        """Place of the link's frame in the world. Raises UnknownName."""
        return self._observer.pose(self.body(name).link(link))

    def link_twist(self, name: str, link: str) -> Twist:
        """Velocity of the link's frame (linear at its origin, angular), in the world's axes. Raises UnknownName."""
        return self._observer.twist(self.body(name).link(link))

    def present(self) -> Any:
        """An MjData with the geometry of this moment, to look at; the world's own has that of its last step's start."""
        return self._observer.geometry()

    def joint_state(self, name: str, joint: str) -> tuple[float, float, float]:
        """Position, velocity and applied effort of any moving joint, actuated or not. Raises UnknownName."""
        place = self.body(name).place(joint)
        effort = float(self.data.qfrc_applied[place.dof] + self.loads.efforts[place.dof])
        return float(self.data.qpos[place.qpos]), float(self.data.qvel[place.dof]), effort

    def set_pose(self, name: str, pose: Pose, twist: Twist | None = None) -> None:
        """Put a robot's root there, and give it the twist (world's axes) if there is one; a fixed robot has none.

        Raises:
            UnknownName: no such robot. Refused: not finite.
        """
        body = self.body(name)
        body.put_root(finite_pose(pose))
        self._observer.invalidate()
        if twist is not None and not body.robot.is_fixed_to_world:
            self.set_root_twist(name, (finite(twist[0]), finite(twist[1])))

    def set_root_twist(self, name: str, twist: Twist) -> None:
        """Let a root link that is free have this velocity (finite, world's axes). Raises UnknownName."""
        # A free joint's velocities are linear in the world's axes and angular in the body's.
        body, turn, local = self.body(name), np.zeros(4), np.zeros(3)
        start = body.root_qpos + 3
        mujoco.mju_negQuat(turn, self.data.qpos[start : start + 4])
        mujoco.mju_rotVecQuat(local, np.array(twist[1]), turn)
        self.data.qvel[body.root_dof : body.root_dof + 6] = [*twist[0], *local]
        self._observer.invalidate()

    def set_joint(self, name: str, joint: str, position: float, velocity: float | None = None) -> None:
        """Put a joint there; its velocity stays unless one is given. Raises UnknownName, Refused (not finite)."""
        place = self.body(name).place(joint)
        self.data.qpos[place.qpos] = number(position)
        if velocity is not None:
            self.data.qvel[place.dof] = number(velocity)
        self._observer.invalidate()

    def put_joints(self, name: str, positions: Mapping[str, float]) -> None:
        """Put joints there, at rest, and those that follow them. Raises UnknownName, Refused (not finite)."""
        for joint, position in positions.items():
            self.set_joint(name, joint, position, 0.0)
        self.body(name).put_joints(positions)

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
        body = self.body(name)
        body.place(joint)
        self.loads.joint_forces.append(JointForce(body, joint, number(effort), start_ns, duration_ns))
        self._loads_changed()

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
        """A force (N) and torque (N·m), world's axes, on a link's centre of mass, as long as `add_joint_force` says.

        Raises:
            UnknownName: no such robot or link. Refused: not finite.
        """
        body = self.body(name)
        body.link(link)
        self.loads.wrenches.append(Wrench(body, link, finite(force), finite(torque), start_ns, duration_ns, source))
        self._loads_changed()

    def drop_wrenches(self, source: str) -> None:
        """End those that have this source."""
        self.loads.keep(lambda force: isinstance(force, JointForce) or force.source != source)
        self._loads_changed()

    def clear_joint_forces(self, name: str, joint: str) -> None:
        """End all efforts on a joint that came from outside. Raises UnknownName."""
        body = self.body(name)
        body.place(joint)
        self.loads.keep(lambda force: isinstance(force, Wrench) or force.body is not body or force.joint != joint)
        self._loads_changed()

    def clear_wrenches(self, name: str, link: str) -> None:
        """End all wrenches on a link. Raises UnknownName."""
        body = self.body(name)
        body.link(link)
        self.loads.keep(lambda force: isinstance(force, JointForce) or force.body is not body or force.link != link)
        self._loads_changed()

    def set_motors(self, body: Body, most_efforts: dict[str, float]) -> None:
        """Hold these joints by motors, each with at most this effort (N or N·m), and no others but `lasting_motors`.

        `loads.motors.velocities` has what they are to reach.
        """
        self.loads.motors.release(self.model)
        self.loads.efforts[body.dofs] = 0.0
        self.loads.motors.put_of(body, most_efforts | body.lasting_motors)
        self._bind_loads()
        self._announce()

    @contextmanager
    def changing_friction(self) -> Iterator[None]:
        """Inside, somebody changes the friction of joints in the model: afterwards motors find their constraints."""
        yield
        self._bind_loads()
        self._announce()

    def add_motors(self, body: Body, most_efforts: dict[str, float]) -> None:
        """Hold these joints too, as long as the robot is in the world, whatever `set_motors` is told."""
        body.lasting_motors |= most_efforts
        self.set_motors(body, self.loads.motors.of(body))


def number(value: float) -> float:
    if not math.isfinite(value):
        raise Refused(f"{value} is not a finite number")
    return float(value)


def finite(vector: Vector) -> Vector:
    x, y, z = (number(part) for part in vector)
    return (x, y, z)


def finite_pose(pose: Pose) -> Pose:
    x, y, z, w = (number(part) for part in pose[1])
    return finite(pose[0]), normalized((x, y, z, w))


def positive(timestep: float) -> float:
    if not (math.isfinite(timestep) and timestep > 0.0):
        raise Refused(f"a time step of {timestep} s is not possible", "give a number above 0, such as 0.001")
    return float(timestep)


def carry_over(model: Any, data: Any, new_model: Any, new_data: Any, gone: Body | None) -> None:
    """Copy all that the robots' future depends on besides their specification; `gone` is in the old world only."""
    for old, new, arrays in ((data, new_data, _OF_DATA), (model, new_model, _OF_MODEL)):
        for name, kind in arrays.items():
            values = getattr(old, name)
            if gone is not None:
                values = np.delete(values, gone.part(kind), axis=0)
            getattr(new, name)[: len(values)] = values
