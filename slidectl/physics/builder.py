"""Builds the bodies, joints and geoms of a robot in a MuJoCo specification, named `ROBOT/LINK` and `ROBOT/JOINT`.

Links on fixed joints are part of their parent's body, which has the name of its first link. The order here: errors,
links that form one body, its inertia, its collision shapes, the robot. This module compiles no world and has no state.
Units and frames are those of URDF: the child's frame is the joint's.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from slidectl.control.transmission_interface import LoadedTransmission, load
from slidectl.description import interfaces
from slidectl.description.inertia import LEAST, can_move, is_mass, why_impossible
from slidectl.description.parser import TOO_DEEP, too_deep
from slidectl.description.rigid_bodies import lumped, rigid_bodies, surroundings
from slidectl.description.robot import (
    Box,
    Cylinder,
    Inertial,
    Joint,
    Link,
    Mesh,
    Robot,
    Shape,
    Sphere,
    Surface,
    TransmissionInfo,
)
from slidectl.description.sensors import ForceTorque
from slidectl.description.transmissions import driving
from slidectl.errors import Refused, SlidectlError
from slidectl.physics import surfaces
from slidectl.physics.collisions import ORDINARY, self_colliding
from slidectl.physics.hulls import Hull, Hulls, source_of
from slidectl.rotations import (
    ORIGIN,
    Pose,
    Quaternion,
    Vector,
    compose,
    cross,
    from_rpy,
    matrix,
    perpendicular,
    rotate,
    unit,
    wxyz,
)

Array = np.ndarray[Any, np.dtype[Any]]

UNDAMPED = 1e-200
"""Damping of a joint that has none, N·s/m or N·m·s/rad. It is too small to change a sum. But with any damping in the
world, MuJoCo's Euler solves again with the damped inertia; so all robots do that, independent of the others."""

NARROWEST_RANGE = 1e-6
"""m or rad. MuJoCo requires the lower limit below the upper one; a joint locked by equal limits gets this range."""

_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
_BALL = mujoco.mjtJoint.mjJNT_BALL

SCALAR_TYPES = {"revolute": _HINGE, "continuous": _HINGE, "prismatic": _SLIDE}
"""The joint types with one position, with MuJoCo's type."""

GAZEBO_FRICTION = 1.0
"""Gazebo's default mu of a surface, equal to MuJoCo's default sliding friction."""

LARGEST_FRICTION = 1e6
"""Upper bound of coefficients, also for `Inf`: nothing slides at it, and its square is an exact number."""

_ROUND = 0.95
"""The least part of its radius to which a mesh that is a wheel reaches in every direction."""
_DIRECTIONS = 36

STEEPEST_AXLE = 0.5
"""Sine of the largest angle between the axle of a wheel and the ground on which its robot stands."""


class BadPart(SlidectlError):
    """A part that cannot be simulated."""

    kind: ClassVar[str] = "part"

    def __init__(
        self, robot: str, part: Link | Joint | TransmissionInfo, trouble: str, hint: str | None = None
    ) -> None:
        super().__init__(f"{self.kind} {part.name!r} of robot {robot!r}{place(part.file, part.line)}: {trouble}", hint)


def place(file: str | None, line: int | None) -> str:
    """` (file:line)`, or the known part of it; empty when nothing is known."""
    if line is None:
        return "" if file is None else f" ({file})"
    return f" (line {line})" if file is None else f" ({file}:{line})"


class BadInertia(BadPart):
    """A link whose mass or inertia cannot be simulated."""

    kind = "link"


class BadShape(BadPart):
    """A collision shape that MuJoCo cannot simulate."""

    kind = "link"

    def __init__(self, robot: str, link: Link, shape: Shape, trouble: str) -> None:
        super().__init__(robot, link, f"collision shape{place(shape.file, shape.line)}: {trouble}")


class BadJoint(BadPart):
    """A joint that cannot be simulated."""

    kind = "joint"


class BadTransmission(BadPart, Refused):
    """A transmission that simulated hardware does not support."""

    kind = "transmission"


@dataclass(slots=True)
class Lump:
    """Links that form one body. Its frame is that of its first link, the head."""

    head: str
    joint: Joint | None
    """The joint between the head and its parent; None at the root."""
    moves: bool
    """False when it is fixed to the world."""
    frames: dict[str, Pose]
    """The constant pose of each link in the head's frame. A link comes after its parent."""
    has_gravity: bool | None = None
    """None while no link of the lump has a mass."""

    def accepts(self, link: Link) -> bool:
        """True when the link can be part of this body. MuJoCo switches gravity by body, not by link."""
        has_gravity = _has_gravity(link)
        return not self.moves or None in (has_gravity, self.has_gravity) or has_gravity == self.has_gravity

    def add(self, link: Link, pose: Pose) -> None:
        """Add a link with its pose in the head's frame."""
        self.frames[link.name] = pose
        if self.has_gravity is None:
            self.has_gravity = _has_gravity(link)


def lumps(robot: Robot) -> list[Lump]:
    """The bodies of a robot, first that of the root, each after its parent.

    Links that a fixed joint connects form one body, unless both have a mass and only one has gravity, or a sensor
    measures the force in the joint.
    """
    measured = {sensor.joint for sensor in robot.sensors if isinstance(sensor, ForceTorque)}
    moves = {link: body.moves for body in rigid_bodies(robot.root, robot.joints) for link in body.links}
    made = [Lump(robot.root, None, moves[robot.root], {})]
    made[0].add(robot.links[robot.root], ORIGIN)
    lump_of = {robot.root: made[0]}
    waiting = [robot.root]
    for parent in waiting:
        for joint in robot.children_of(parent):
            link, lump, pose = robot.links[joint.child], lump_of[parent], ORIGIN
            if joint.type == "fixed" and joint.name not in measured and lump.accepts(link):
                pose = compose(lump.frames[parent], (joint.origin.xyz, from_rpy(joint.origin.rpy)))
            else:
                lump = Lump(joint.child, joint, moves[joint.child], {})
                made.append(lump)
            lump.add(link, pose)
            lump_of[joint.child] = lump
            waiting.append(joint.child)
    return made


def _has_gravity(link: Link) -> bool | None:
    return None if link.inertial is None else not link.surface.turn_gravity_off


def set_inertia(body: Any, robot: str, links: Sequence[tuple[Link, Pose]]) -> None:
    """Set the mass, centre of mass and inertia of an MjsBody from its links, each with its frame in the body.

    A link without `<inertial>` has no mass.

    Raises BadInertia: the mass is not positive, or the moments are physically impossible.
    """
    body.explicitinertial = True
    body.mass = 0.0
    weighing = [(inertial, frame) for link, frame in links if (inertial := _checked(robot, link)) is not None]
    if not weighing:
        return
    if len(weighing) == 1:
        inertial, frame = weighing[0]
    else:
        inertial, frame = lumped([(inertial, matrix(frame[1]), frame[0]) for inertial, frame in weighing]), ORIGIN
    body.mass = inertial.mass
    body.ipos, attitude = compose(frame, (inertial.origin.xyz, from_rpy(inertial.origin.rpy)))
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    if ixy == ixz == iyz == 0.0:
        body.inertia = _within_triangle(ixx, iyy, izz)
        body.iquat = wxyz(attitude)
        return
    tensor = _turned(inertial, attitude)
    if _is_on_the_edge(tensor) and not _is_taken(tensor):
        body.inertia, body.iquat = _principal(tensor)
    else:
        body.fullinertia = _row(tensor)


def _checked(robot: str, link: Link) -> Inertial | None:
    """The inertial of the link, checked. Raises BadInertia."""
    if link.inertial is None:
        return None
    mass = link.inertial.mass
    if not is_mass(mass):
        raise BadInertia(robot, link, f"mass {mass:g} kg is not positive", 'give it <mass value="..."/> above 0')
    check_moments(robot, link, link.inertial)
    return link.inertial


def check_moments(robot: str, link: Link, inertial: Inertial) -> None:
    """Raises BadInertia unless the principal moments are positive and each is at most the sum of the others."""
    if not all(map(math.isfinite, (*inertial.inertia, *inertial.origin.xyz, *inertial.origin.rpy))):
        raise BadInertia(robot, link, "its inertia is not finite", "give numbers for ixx ... izz")
    why = why_impossible(inertial.inertia)
    if why is not None:
        hint = "for a box of sides x, y, z: ixx = m (y² + z²) / 12"
        raise BadInertia(robot, link, f"no body has its inertia: {why}", hint)


def _turned(inertial: Inertial, attitude: Quaternion) -> Array:
    """The tensor in the body's axes: R I Rᵀ, where R is the attitude in the body; its moments as `_within_triangle`."""
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    moments, axes = np.linalg.eigh(tensor)
    if moments[0] + moments[1] < moments[2]:
        moments[2] = moments[0] + moments[1]
        tensor = (axes * moments) @ axes.T
    turn = np.array(matrix(attitude))
    return np.asarray(turn @ tensor @ turn.T)


def _row(tensor: Array) -> list[float]:
    """The tensor in MuJoCo's order, xx yy zz xy xz yz."""
    return [float(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _within_triangle(ixx: float, iyy: float, izz: float) -> list[float]:
    """The three moments. The largest is clipped to the sum of the others, as the file may have rounded it up."""
    moments = [ixx, iyy, izz]
    largest = max(range(3), key=moments.__getitem__)
    # MuJoCo compares with the sum of the two without margin; the rounded difference may be larger than that sum.
    rest = sum(moments[:largest] + moments[largest + 1 :])
    moments[largest] = min(moments[largest], sum(moments) - moments[largest], rest)
    return moments


def _is_on_the_edge(tensor: Array) -> bool:
    """True when MuJoCo, which computes the principal moments of a tensor itself, may refuse it by rounding errors: the
    body is flat or very thin. These errors are at most 1e-12 of the largest moment or of 1 kg·m²."""
    small, middle, large = np.linalg.eigvalsh(tensor)
    return bool(small + middle - large < 1e-6 * large + 1e-11 or small < 1e-6 * large + 1e-13)


def _is_taken(tensor: Array) -> bool:
    """True when MuJoCo accepts the tensor of such a body. This compiles it, as the rounding is not predictable.

    Accepted tensors are passed unchanged, so that these robots move as in earlier versions, to the bit.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=1.0, explicitinertial=True, ipos=(0.0, 0.0, 0.0), fullinertia=_row(tensor))
    body.add_freejoint()
    try:
        spec.compile()
    except (ValueError, mujoco.FatalError):
        return False
    return True


def _principal(tensor: Array) -> tuple[list[float], tuple[float, float, float, float]]:
    """Principal moments that satisfy the triangle inequality to the bit, and the quaternion w x y z of their axes."""
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] = -axes[:, 2]
    attitude = np.zeros(4)
    mujoco.mju_mat2Quat(attitude, axes.ravel())
    small, middle, large = (float(max(moment, LEAST)) for moment in moments)
    w, x, y, z = (float(part) for part in attitude)
    return _within_triangle(small, middle, large), (w, x, y, z)


def add_shapes(
    spec: Any,
    body: Any,
    robot: str,
    link: Link,
    frame: Pose,
    bits: tuple[int, int],
    hulls: Hulls,
    axle: Vector | None = None,
    is_surface: bool = False,
) -> None:
    """Add one geom per collision of the link, with these collision bits (contype, conaffinity).

    `frame` is the link's pose in the body, `hulls` has the hulls of its meshes. `axle`: the body turns about this axis
    of its frame, and its cylinders about it are wheels. `is_surface` is as in MeshSource: a mesh gets several geoms.

    A wheel is an ellipsoid with the cylinder's radius and width: it touches the ground at the middle of its width. A
    cylinder touches along a line, whose ends would have to roll at different speeds when the robot turns. With the high
    friction that wheels have in models they cannot slip, and the robot would not turn. A mesh that is round about the
    axle is a wheel, too.

    Raises BadShape: a size that is not positive, or a mesh that could not be read.
    """

    def add_geom(name: str, position: Vector, attitude: Quaternion) -> Any:
        geom = body.add_geom(name=name, pos=position, quat=wxyz(attitude))
        geom.contype, geom.conaffinity = bits
        set_friction(geom, sliding_friction(link.surface))
        return geom

    for number, shape in enumerate(link.collisions):
        name = f"{robot}/{link.name}/{number}"
        position, attitude = compose(frame, (shape.origin.xyz, from_rpy(shape.origin.rpy)))
        if isinstance(shape.geometry, Mesh):
            hull = _hull_of(shape.geometry, robot, link, shape, hulls, is_surface)
            if axle is not None and (wheel := _wheel_in(hull, (position, attitude), axle)):
                position, radius, half_width = wheel
                geom = add_geom(name, position, _turn_to(axle))
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, [radius, radius, half_width]
                continue
            for piece, part in enumerate(hull.parts):
                _set_mesh(spec, add_geom(f"{name}.{piece}" if piece else name, position, attitude), part)
            continue
        geom = add_geom(name, position, attitude)
        geom.type, geom.size = _primitive(robot, link, shape)
        if axle is not None and _is_wheel(shape, position, attitude, axle):
            radius, half_width, _ = geom.size
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, [radius, radius, half_width]


def _is_wheel(shape: Shape, position: Vector, attitude: Quaternion, axle: Vector) -> bool:
    """True for a cylinder about the axle, through the body's origin, that is not wider than its diameter."""
    cylinder = shape.geometry
    if not isinstance(cylinder, Cylinder) or cylinder.length > 2.0 * cylinder.radius:
        return False
    is_along = math.hypot(*cross(rotate(attitude, (0.0, 0.0, 1.0)), axle)) < 1e-2
    return is_along and math.hypot(*cross(position, axle)) < 1e-2 * cylinder.radius


def _wheel_in(hull: Hull, place: Pose, axle: Vector) -> tuple[Vector, float, float] | None:
    """Centre, radius and half the width of the wheel that a hull at this place is; None for another shape.

    A wheel is round about the axle, which goes through the body's origin, and not wider than its diameter.
    """
    corners = surfaces.corners(hull.stl) @ np.array(matrix(place[1])).T + np.array(place[0])
    along = corners @ np.array(axle)
    sides = corners @ np.array(perpendicular(axle)).T
    radius = float(np.linalg.norm(sides, axis=1).max())
    width = float(np.ptp(along))
    angles = np.arange(_DIRECTIONS) * (2.0 * math.pi / _DIRECTIONS)
    reach = (sides @ np.stack([np.cos(angles), np.sin(angles)])).max(axis=0)
    if width > 2.0 * radius or float(reach.min()) < _ROUND * radius:
        return None
    x, y, z = (float(along.max() + along.min()) / 2.0 * part for part in axle)
    return (x, y, z), radius, width / 2.0


def _turn_to(axis: Vector) -> Quaternion:
    """The attitude (x y z w) of a frame whose z axis is this one."""
    x, y, z = axis
    if z < -1.0 + 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    length = math.sqrt(2.0 * (1.0 + z))
    return (-y / length, x / length, 0.0, (1.0 + z) / length)


def set_friction(geom: Any, mu: float) -> None:
    """Set the friction and the priority of a geom so that of two geoms the smaller coefficient counts, as in Gazebo.

    MuJoCo takes the larger one, unless one geom has priority. So a lower friction gets a higher priority. The bits of
    positive single-precision numbers, read as integers, have the order of the numbers.
    """
    geom.friction[0] = mu = min(mu, LARGEST_FRICTION)
    geom.priority = -struct.unpack("<i", struct.pack("<f", mu))[0]


def sliding_friction(surface: Surface) -> float:
    """The coefficient, which MuJoCo uses for both directions: the smaller of mu1 and mu2, else Gazebo's default.

    With the larger one, rovers whose wheels slip sideways (mu2) could not turn.
    """
    return min((mu for mu in (surface.mu1, surface.mu2) if mu is not None), default=GAZEBO_FRICTION)


def _primitive(robot: str, link: Link, shape: Shape) -> tuple[Any, list[float]]:
    """MuJoCo's geom type and size: half lengths, or radius and half length. Raises BadShape."""
    geometry = shape.geometry
    if isinstance(geometry, Box):
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, [edge / 2 for edge in geometry.size]
    elif isinstance(geometry, Cylinder):
        kind, size = mujoco.mjtGeom.mjGEOM_CYLINDER, [geometry.radius, geometry.length / 2, 0.0]
    elif isinstance(geometry, Sphere):
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, [geometry.radius, 0.0, 0.0]
    else:
        raise TypeError(f"not a primitive: {geometry!r}")
    needed = {Box: 3, Cylinder: 2, Sphere: 1}[type(geometry)]
    if not all(0.0 < length < float("inf") for length in size[:needed]):
        raise BadShape(robot, link, shape, f"{geometry} needs sizes above 0")
    return kind, size


def _hull_of(mesh: Mesh, robot: str, link: Link, shape: Shape, hulls: Hulls, is_surface: bool) -> Hull:
    """The hull or the surface of a mesh. Raises BadShape."""
    if mesh.path is None:
        raise BadShape(robot, link, shape, f"mesh {mesh.uri!r} was not found")
    hull = hulls.get(source_of(mesh, is_surface))
    if not isinstance(hull, Hull):
        raise BadShape(robot, link, shape, f"mesh {hull.message if hull is not None else mesh.path + ' was not read'}")
    return hull


def _set_mesh(spec: Any, geom: Any, hull: Hull) -> None:
    """Set a geom to a convex hull, which is a file in the specification's memory.

    MuJoCo caches its results for files, but not for vertices in the specification. The file's name is a hash of its
    content, so equal meshes share it.
    """
    spec.assets[hull.name] = hull.stl
    mesh = spec.add_mesh(name=geom.name, file=hull.name)
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name


class RobotBuilder:
    """Adds one robot to a specification."""

    def __init__(self, spec: Any, robot: Robot, name: str, hulls: Hulls) -> None:
        self.spec = spec
        self.robot = robot
        self.name = name
        self._self_colliding = self_colliding(robot)
        self._surroundings = surroundings(robot)
        self.hulls = hulls
        self._motors = {
            joint.name
            for _, joint in driving(robot.transmissions)
            for written in joint.hardware_interfaces
            if interfaces.find(written) is not interfaces.EFFORT
        }
        if robot.ros2_control is not None:  # what no controller commands is held by a motor
            self._motors |= {joint.name for joint in robot.ros2_control.joints.values() if joint.commands}
        """Names of the joints that may get a motor."""
        self._made: dict[str, Any] = {}
        """The MjsJoint of each joint with one position."""

    def build(self, pose: Pose) -> None:
        """Add the robot with its root at `pose`: fixed there when the root link is called `world`, free otherwise.

        Raises BadInertia, BadJoint, BadShape: naming the robot and the link or joint.
        """
        joint = too_deep(self.robot.root, self.robot.joints)
        if joint is not None:
            raise BadJoint(self.name, joint, TOO_DEEP)
        places: dict[str, tuple[Any, Pose]] = {}
        standing: dict[str, Pose] = {}
        for lump in lumps(self.robot):
            head = ORIGIN
            if lump.joint is not None:
                origin = lump.joint.origin
                head = compose(standing[lump.joint.parent], (origin.xyz, from_rpy(origin.rpy)))
            body = self._root(pose) if lump.joint is None else self._child(*places[lump.joint.parent], lump.joint)
            self._fill(body, lump, head[1])
            places.update({link: (body, frame) for link, frame in lump.frames.items()})
            standing.update({link: compose(head, frame) for link, frame in lump.frames.items()})
        check_moving_masses(self.robot, self.name)
        for joint in self.robot.joints.values():
            self._mimic(joint)
        for transmission in self.robot.transmissions:
            if transmission.is_real:
                self._rotors(transmission)

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
        """Add the body that a joint moves. `frame` is the parent link's pose in the parent's body."""
        position, attitude = compose(frame, (joint.origin.xyz, from_rpy(joint.origin.rpy)))
        body = parent.add_body(name=self._named(joint.child), pos=position, quat=wxyz(attitude))
        if joint.type in SCALAR_TYPES:
            self._scalar(body, joint)
        elif joint.type == "planar":
            self._planar(body, joint)
        elif joint.type == "floating":
            self._floating(body, joint)
        return body

    def _fill(self, body: Any, lump: Lump, standing: Quaternion) -> None:
        """Add masses and shapes. `standing` is the body's attitude in the root link while all joints are at 0."""
        axle = None
        if lump.joint is not None and lump.joint.type == "continuous":
            axis = self._axis(lump.joint)
            # A turntable or a fan, whose axis is upright, is no wheel.
            axle = unit(axis) if abs(rotate(standing, unit(axis))[2]) <= STEEPEST_AXLE else None
        links = {link: self.robot.links[link] for link in lump.frames}
        set_inertia(body, self.name, [(link, lump.frames[link.name]) for link in links.values()])
        body.gravcomp = 1.0 if lump.moves and lump.has_gravity is False else 0.0
        for name, link in links.items():
            bits = self._self_colliding.get(name, ORDINARY)
            is_surface = name in self._surroundings
            add_shapes(self.spec, body, self.name, link, lump.frames[name], bits, self.hulls, axle, is_surface)

    def _scalar(self, body: Any, joint: Joint) -> None:
        made = body.add_joint(name=self._named(joint.name), type=SCALAR_TYPES[joint.type], axis=self._axis(joint))
        self._made[joint.name] = made
        self._resist(made, joint)
        limits = range_of(joint)
        made.limited = limits is not None
        if limits is not None:
            made.range = limits

    def _planar(self, body: Any, joint: Joint) -> None:
        """Add two slide joints in the plane and a hinge about its normal."""
        normal = self._axis(joint)
        along, across = perpendicular(normal)
        for part, kind, axis in (("x", _SLIDE, along), ("y", _SLIDE, across), ("yaw", _HINGE, normal)):
            self._resist(body.add_joint(name=f"{self._named(joint.name)}/{part}", type=kind, axis=axis), joint)

    def _floating(self, body: Any, joint: Joint) -> None:
        """Add three slide joints and a ball joint, since MuJoCo allows a free joint only on the world."""
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
        elif joint.friction > 0.0:  # a motor uses the joint's own frictionloss; see motors.py
            tendon = self.spec.add_tendon(name=made.name, frictionloss=joint.friction)
            tendon.wrap_joint(made.name, 1.0)

    def _mimic(self, joint: Joint) -> None:
        """Add a constraint for a mimic joint: position = offset + multiplier * leader's position."""
        if joint.mimic is None or joint.type not in SCALAR_TYPES:
            return
        leader = self.robot.joints.get(joint.mimic.joint)
        if leader is None or leader.type not in SCALAR_TYPES or leader is joint:
            raise BadJoint(self.name, joint, f"it cannot mimic {joint.mimic.joint!r}: no other joint with one position")
        tie = self.spec.add_equality(name=self._named(joint.name), type=mujoco.mjtEq.mjEQ_JOINT)
        tie.objtype = mujoco.mjtObj.mjOBJ_JOINT
        tie.name1, tie.name2 = self._named(joint.name), self._named(leader.name)
        tie.data[:5] = [joint.mimic.offset, joint.mimic.multiplier, 0.0, 0.0, 0.0]

    def _rotors(self, info: TransmissionInfo) -> None:
        """Add the inertia of the actuators' rotors at the joints: reduction squared times the rotor's inertia.

        Rotors that two joints share couple them. A tendon for each rotor, with the rotor's velocity, does this.
        """
        transmission = loaded(self.robot, self.name, info)
        if any(joint.name not in self._made for joint in transmission.joints):
            return  # the hardware raises the error about the missing joint
        made = [self._made[joint.name] for joint in transmission.joints]
        felt = transmission.rotor_inertia
        if len(made) == 1 or felt[0][1] == 0.0:
            for at, joint in enumerate(made):
                joint.armature += felt[at][at]
            return
        for at, actuator in enumerate(transmission.actuators):
            if actuator.rotor_inertia:
                rotor = self.spec.add_tendon(name=f"{self.name}//{len(self.spec.tendons)}")
                rotor.armature = actuator.rotor_inertia
                for joint, ratios in zip(made, transmission.ratios, strict=True):
                    rotor.wrap_joint(joint.name, ratios[at])


def loaded(robot: Robot, name: str, info: TransmissionInfo) -> LoadedTransmission:
    """Load a transmission as the loaders of ros_control do. Raises BadTransmission with their reason."""
    try:
        return load(info, robot)
    except SlidectlError as error:
        raise BadTransmission(name, info, error.message, error.hint) from None


def set_damping(made: Any, damping: float) -> None:
    """Set the linear damping of an MjsJoint: a number, or in newer MuJoCo the first coefficient of a polynomial."""
    made.damping = damping if isinstance(made.damping, float) else [damping, 0.0, 0.0]


def range_of(joint: Joint) -> tuple[float, float] | None:
    """Lower and upper limit of the joint's motion, m or rad; None when the joint has no limits."""
    if joint.limit is None or joint.type not in ("revolute", "prismatic"):
        return None
    lower, upper = sorted((joint.limit.lower, joint.limit.upper))
    if upper - lower < NARROWEST_RANGE:
        middle = (lower + upper) / 2 if abs(upper) < 1e300 else upper
        half = max(NARROWEST_RANGE / 2, math.ulp(middle))
        return middle - half, middle + half
    return lower, upper


def check_moving_masses(robot: Robot, name: str) -> None:
    """Raises BadInertia for a moving body of which all links have too little mass or inertia."""
    for body in rigid_bodies(robot.root, robot.joints):
        weighing = [inertial for link in body.links if (inertial := robot.links[link].inertial) is not None]
        if not body.moves or any(can_move(inertial.mass, inertial.inertia) for inertial in weighing):
            continue
        head = robot.links[body.head]
        if not weighing:
            hint = 'add <inertial> with <mass value="..."/> and <inertia .../>'
            raise BadInertia(name, head, "it moves but has no inertia", hint)
        raise BadInertia(name, head, f"it moves, and its mass or a moment of it is below {LEAST:g}")
