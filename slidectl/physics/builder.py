"""A robot on paper becomes bodies, joints and geoms of a MuJoCo specification, named `ROBOT/LINK` and `ROBOT/JOINT`.

Links on fixed joints are part of their parent's body (see lumping.py), which has the name of its first link. Builds
only; it compiles nothing and knows no state. Units and frames are URDF's: the child's frame is the joint's.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco

from slidectl.control.hardware_interface import EffortJointInterface, command_interface
from slidectl.description.inertia import LEAST, can_move
from slidectl.description.rigid_bodies import rigid_bodies
from slidectl.description.robot import Joint, Robot
from slidectl.description.structure import TOO_DEEP, too_deep
from slidectl.description.transmissions import driving
from slidectl.physics.frames import compose
from slidectl.physics.hulls import Hulls
from slidectl.physics.inertia import BadInertia, put_inertia
from slidectl.physics.lumping import Lump, lumps
from slidectl.physics.parts import BadPart
from slidectl.physics.rotation import Pose, perpendicular, unit, wxyz
from slidectl.physics.solids import put_shapes
from slidectl.physics.touching import ORDINARY, self_colliding
from slidectl.rotations import Vector, from_rpy

UNDAMPED = 1e-200
"""Damping of a joint that has none, N·s/m or N·m·s/rad. It vanishes in every sum, but with any damping at all MuJoCo's
Euler solves once more with the damped inertia: so every robot takes that path, whatever its neighbours have."""

NARROWEST_RANGE = 1e-6
"""m or rad. MuJoCo wants the lower limit below the upper; a joint locked by equal limits gets this much."""

_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
_BALL = mujoco.mjtJoint.mjJNT_BALL

SCALAR_TYPES = {"revolute": _HINGE, "continuous": _HINGE, "prismatic": _SLIDE}
"""The joints that have one position, with MuJoCo's type."""


class BadJoint(BadPart):
    """A joint that cannot be simulated."""

    kind = "joint"


class RobotBuilder:
    """Adds one robot to a specification."""

    def __init__(self, spec: Any, robot: Robot, name: str, hulls: Hulls) -> None:
        self.spec = spec
        self.robot = robot
        self.name = name
        self._self_colliding = self_colliding(robot)
        self.hulls = hulls
        self._motors = {
            transmission.joints[0].name
            for transmission in driving(robot.transmissions)
            if command_interface(transmission.joints[0].hardware_interfaces[0]) is not EffortJointInterface
        }
        """Joints that may get one."""

    def build(self, pose: Pose) -> None:
        """Add everything, the root at `pose`: welded there when the root link is called `world`, free otherwise.

        Raises:
            BadInertia, BadJoint, BadShape: naming the robot and the link or joint.
        """
        check_depth(self.robot, self.name)
        places: dict[str, tuple[Any, Pose]] = {}
        for lump in lumps(self.robot):
            body = self._root(pose) if lump.joint is None else self._child(*places[lump.joint.parent], lump.joint)
            self._fill(body, lump)
            places.update({link: (body, frame) for link, frame in lump.frames.items()})
        check_moving_masses(self.robot, self.name)
        for joint in self.robot.joints.values():
            self._mimic(joint)

    def _named(self, part: str) -> str:
        return f"{self.name}/{part}"

    def _root(self, pose: Pose) -> Any:
        position, attitude = pose
        root = self.spec.worldbody.add_body(name=self._named(self.robot.root), pos=position, quat=wxyz(attitude))
        if not self.robot.is_fixed_to_world:
            free = root.add_freejoint(name=self._named(""))
            free.align = False
            set_damping(free, UNDAMPED)
        return root

    def _child(self, parent: Any, frame: Pose, joint: Joint) -> Any:
        """The body that a joint moves; `frame` is the parent link's in the parent's body."""
        position, attitude = compose(frame, (joint.origin.xyz, from_rpy(joint.origin.rpy)))
        body = parent.add_body(name=self._named(joint.child), pos=position, quat=wxyz(attitude))
        if joint.type in SCALAR_TYPES:
            self._scalar(body, joint)
        elif joint.type == "planar":
            self._planar(body, joint)
        elif joint.type == "floating":
            self._floating(body, joint)
        return body

    def _fill(self, body: Any, lump: Lump) -> None:
        links = {link: self.robot.links[link] for link in lump.frames}
        put_inertia(body, self.name, [(link, lump.frames[link.name]) for link in links.values()])
        body.gravcomp = 1.0 if lump.moves and lump.has_gravity is False else 0.0
        for name, link in links.items():
            bits = self._self_colliding.get(name, ORDINARY)
            put_shapes(self.spec, body, self.name, link, lump.frames[name], bits, self.hulls)

    def _scalar(self, body: Any, joint: Joint) -> None:
        made = body.add_joint(name=self._named(joint.name), type=SCALAR_TYPES[joint.type], axis=self._axis(joint))
        self._resist(made, joint)
        limits = range_of(joint)
        made.limited = limits is not None
        if limits is not None:
            made.range = limits

    def _planar(self, body: Any, joint: Joint) -> None:
        """Two slides in the plane and a turn about its normal."""
        normal = self._axis(joint)
        along, across = perpendicular(normal)
        for part, kind, axis in (("x", _SLIDE, along), ("y", _SLIDE, across), ("yaw", _HINGE, normal)):
            self._resist(body.add_joint(name=f"{self._named(joint.name)}/{part}", type=kind, axis=axis), joint)

    def _floating(self, body: Any, joint: Joint) -> None:
        """Three slides and a ball: a free joint may only hang on the world itself."""
        axes = (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)))
        for part, axis in axes:
            self._resist(body.add_joint(name=f"{self._named(joint.name)}/{part}", type=_SLIDE, axis=axis), joint)
        self._resist(body.add_joint(name=f"{self._named(joint.name)}/turn", type=_BALL), joint)

    def _axis(self, joint: Joint) -> Vector:
        if not all(map(math.isfinite, joint.axis)) or not any(joint.axis):
            raise BadJoint(self.name, joint, f"axis {joint.axis} has no direction", '<axis xyz="0 0 1"/>, for example')
        return unit(joint.axis)

    def _resist(self, made: Any, joint: Joint) -> None:
        for what, value in (("damping", joint.damping), ("friction", joint.friction)):
            if not 0.0 <= value < math.inf:
                raise BadJoint(self.name, joint, f"{what} {value:g} must be 0 or more")
        set_damping(made, joint.damping or UNDAMPED)
        if joint.name not in self._motors:
            made.frictionloss = joint.friction
        elif joint.friction > 0.0:  # a motor needs the joint's own; see motors.py
            tendon = self.spec.add_tendon(name=made.name, frictionloss=joint.friction)
            tendon.wrap_joint(made.name, 1.0)

    def _mimic(self, joint: Joint) -> None:
        """position = offset + multiplier * leader's position, as a constraint on the two."""
        if joint.mimic is None or joint.type not in SCALAR_TYPES:
            return
        leader = self.robot.joints.get(joint.mimic.joint)
        if leader is None or leader.type not in SCALAR_TYPES or leader is joint:
            raise BadJoint(self.name, joint, f"it cannot mimic {joint.mimic.joint!r}: no other joint with one position")
        tie = self.spec.add_equality(name=self._named(joint.name), type=mujoco.mjtEq.mjEQ_JOINT)
        tie.objtype = mujoco.mjtObj.mjOBJ_JOINT
        tie.name1, tie.name2 = self._named(joint.name), self._named(leader.name)
        tie.data[:5] = [joint.mimic.offset, joint.mimic.multiplier, 0.0, 0.0, 0.0]


def set_damping(made: Any, damping: float) -> None:
    """Linear damping of an MjsJoint: a number, or the first coefficient of a polynomial in newer versions of MuJoCo."""
    made.damping = damping if isinstance(made.damping, float) else [damping, 0.0, 0.0]


def range_of(joint: Joint) -> tuple[float, float] | None:
    """Lower and upper limit that stop the joint (only revolute and prismatic ones have any), or None."""
    if joint.limit is None or joint.type not in ("revolute", "prismatic"):
        return None
    lower, upper = sorted((joint.limit.lower, joint.limit.upper))
    if upper - lower < NARROWEST_RANGE:
        middle = (lower + upper) / 2 if abs(upper) < 1e300 else upper
        half = max(NARROWEST_RANGE / 2, math.ulp(middle))
        return middle - half, middle + half
    return lower, upper


def check_depth(robot: Robot, name: str) -> None:
    """Raises BadJoint for a link that hangs too far below the root."""
    joint = too_deep(robot.root, robot.joints)
    if joint is not None:
        raise BadJoint(name, joint, TOO_DEEP)


def check_moving_masses(robot: Robot, name: str) -> None:
    """Raises BadInertia for a link that moves and has too little inertia, its own or that of links welded to it."""
    for body in rigid_bodies(robot.root, robot.joints):
        weighing = [inertial for link in body.links if (inertial := robot.links[link].inertial) is not None]
        if not body.moves or any(can_move(inertial.mass, inertial.inertia) for inertial in weighing):
            continue
        head = robot.links[body.head]
        if not weighing:
            hint = 'add <inertial> with <mass value="..."/> and <inertia .../>'
            raise BadInertia(name, head, "it moves but has no inertia", hint)
        raise BadInertia(name, head, f"it moves, and its mass or a moment of it is below {LEAST:g}")
