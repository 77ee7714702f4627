"""One robot in the world: the indices of its links, joints and state in MuJoCo's arrays, and changes of that state.

An AttachedRobot stays valid over rebuilds of the model: `bind` finds its indices again. It makes no steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from slidectl.description.robot import Joint, Robot
from slidectl.errors import UnknownName
from slidectl.physics.builder import SCALAR_TYPES, lumps
from slidectl.physics.hulls import Hulls
from slidectl.rotations import IDENTITY, Pose, Vector, compose, subtract, wxyz

Array = np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True, slots=True)
class LinkPlace:
    """Place of a link: MuJoCo's id of the body that it is part of, and the link's constant pose in that body."""

    body: int
    frame: Pose
    arm: Vector | None
    """Vector from the body's centre of mass to the link's, in the body's axes, m; None when it is zero."""


@dataclass(frozen=True, slots=True)
class JointPlace:
    """Place of a joint with one position: its index into qpos, and its index into qvel and the forces."""

    joint: Joint
    qpos: int
    dof: int


class AttachedRobot:
    """A robot that is attached under `name`."""

    def __init__(self, name: str, description: Robot, pose: Pose, hulls: Hulls) -> None:
        self.name = name
        self.description = description
        self.spawn_pose = pose
        self.hulls = hulls
        """Hulls of its meshes. They are kept for a rebuild, since the files may change or be deleted."""
        self.links: dict[str, LinkPlace] = {}
        """All links by name, also those on fixed joints."""
        self.joints: dict[str, JointPlace] = {}
        """Revolute, continuous and prismatic joints by name, in the file's order. Changed indices make a new dict."""
        self.start: dict[str, float] = {}
        """Initial positions of joints that do not start at 0, rad or m."""
        self.lasting_motors: dict[str, float] = {}
        """Joints that motors hold as long as the robot is in the world, with the largest effort of each, N or N·m."""
        self._weights: dict[str, Array] = {}
        """Inverse weights of its bodies, dofs and tendons, by which MuJoCo scales its constraints. They are taken from
        the robot compiled alone: compiled with others they differ by rounding errors."""
        self._lumps = lumps(description)
        self._model: Any = None
        self._data: Any = None
        self._rebound: list[Callable[[], None]] = []
        self._slices: dict[str, slice] = {}

    @property
    def root_id(self) -> int:
        """MuJoCo's body id of the root link."""
        return self.links[self.description.root].body

    @property
    def root_qpos(self) -> int:
        """Index into qpos of a free root's pose (7 numbers); its 6 velocities start at `root_dof`."""
        return int(self._slices["qpos"].start)

    @property
    def root_dof(self) -> int:
        """Index into qvel of a free root's first velocity."""
        return int(self._slices["dof"].start)

    @property
    def dofs(self) -> slice:
        """The robot's part of qvel."""
        return self._slices["dof"]

    @property
    def coordinates(self) -> slice:
        """The robot's part of qpos."""
        return self._slices["qpos"]

    def part(self, kind: str) -> slice:
        """The robot's part of arrays over all `qpos`, `dof`, `body`, `tie` (equality constraints) or `tendon`."""
        return self._slices[kind]

    def link(self, link: str) -> LinkPlace:
        """The place of the link. Raises UnknownName."""
        try:
            return self.links[link]
        except KeyError:
            raise UnknownName("link", link, list(self.links), f"on robot {self.name!r}") from None

    def place(self, joint: str) -> JointPlace:
        """The place of the joint. Raises UnknownName, also for fixed, planar and floating joints."""
        try:
            return self.joints[joint]
        except KeyError:
            raise UnknownName("moving joint", joint, list(self.joints), f"on robot {self.name!r}") from None

    def on_rebound(self, callback: Callable[[], None]) -> None:
        """Call back after every rebuild of the model. The data is then a new one, and `joints` if indices changed."""
        self._rebound.append(callback)

    def bind(self, model: Any, data: Any) -> None:
        """Find the robot's indices in a newly compiled model."""
        self._model, self._data = model, data
        body, joint = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_JOINT
        ids = [mujoco.mj_name2id(model, body, f"{self.name}/{lump.head}") for lump in self._lumps]
        frames = {
            link: (at, frame) for at, lump in zip(ids, self._lumps, strict=True) for link, frame in lump.frames.items()
        }
        self.links = {}
        for name, link in self.description.links.items():
            at, frame = frames[name]
            centre = link.inertial.origin.xyz if link.inertial is not None else (0.0, 0.0, 0.0)
            x, y, z = model.body_ipos[at].tolist()
            arm = subtract(compose(frame, (centre, IDENTITY))[0], (x, y, z))
            self.links[name] = LinkPlace(at, frame, arm if any(arm) else None)
        self.joints = {}
        for made in self.description.joints.values():
            if made.type in SCALAR_TYPES:
                index = mujoco.mj_name2id(model, joint, f"{self.name}/{made.name}")
                self.joints[made.name] = JointPlace(made, int(model.jnt_qposadr[index]), int(model.jnt_dofadr[index]))
        self._slices = _slices(model, self.root_id, len(ids))
        for kind in ("body", "dof", "tendon"):
            weights = getattr(model, f"{kind}_invweight0")[self._slices[kind]]
            weights[:] = self._weights.setdefault(kind, weights.copy())

    def follow(self, model: Any, data: Any) -> None:
        """Use a new model that differs only in robots after this one, so that its indices are the same."""
        self._model, self._data = model, data

    def weight_of(self, place: JointPlace) -> float:
        """The inverse weight of a joint's dof."""
        return float(self._weights["dof"][place.dof - self.root_dof])

    def announce(self) -> None:
        """Call the callbacks of `on_rebound`, since indices and views may have changed."""
        for callback in self._rebound:
            callback()

    def reset_to_spawn(self) -> None:
        """Restore the state right after attaching: spawn pose, initial joint positions, at rest, no forces."""
        data, model, part = self._data, self._model, self._slices
        data.qpos[part["qpos"]] = model.qpos0[part["qpos"]]
        for array in (data.qvel, data.qacc_warmstart, data.qfrc_applied):
            array[part["dof"]] = 0.0
        data.xfrc_applied[part["body"]] = 0.0
        data.eq_active[part["tie"]] = model.eq_active0[part["tie"]]
        self.set_root_pose(self.spawn_pose)
        self.set_joints(self.start)

    def set_joints(self, positions: Mapping[str, float]) -> None:
        """Set joint positions. Mimic joints that are not among them follow their leaders. Raises UnknownName."""
        for name, position in positions.items():
            self._data.qpos[self.place(name).qpos] = position
        for name, place in self.joints.items():
            if place.joint.mimic is not None and name not in positions:
                self._data.qpos[place.qpos] = self._mimicked(place.joint)

    def _mimicked(self, joint: Joint) -> float:
        """The position of a mimic joint by its leader, also through several mimic joints."""
        position, factor = 0.0, 1.0
        for _ in range(len(self.joints)):
            if joint.mimic is None:
                break
            position, factor = position + factor * joint.mimic.offset, factor * joint.mimic.multiplier
            joint = self.joints[joint.mimic.joint].joint
        return position + factor * float(self._data.qpos[self.joints[joint.name].qpos])

    def set_root_pose(self, pose: Pose) -> None:
        """Set the pose of the root link. Velocities stay."""
        position, attitude = pose[0], wxyz(pose[1])
        if self.description.is_fixed_to_world:
            self._model.body_pos[self.root_id], self._model.body_quat[self.root_id] = position, attitude
        else:
            start = self.root_qpos
            self._data.qpos[start : start + 3], self._data.qpos[start + 3 : start + 7] = position, attitude


def _slices(model: Any, root: int, bodies: int) -> dict[str, slice]:
    """The robot's slices, by kind. MuJoCo numbers depth first, so a robot's bodies, joints, dofs and positions are each
    consecutive."""
    ends = [root, root + bodies]
    joints = np.searchsorted(model.jnt_bodyid, ends)
    starts = np.append(model.jnt_qposadr, model.nq)
    dofs = np.searchsorted(model.dof_bodyid, ends)
    ties, tendons = model.eq_obj1id, model.wrap_objid[model.tendon_adr]
    return {
        "body": slice(root, root + bodies),
        "dof": slice(int(dofs[0]), int(dofs[1])),
        "qpos": slice(int(starts[joints[0]]), int(starts[joints[1]])),
        "tie": slice(*np.searchsorted(ties, joints).tolist()),
        "tendon": slice(*np.searchsorted(tendons, joints).tolist()),
    }
