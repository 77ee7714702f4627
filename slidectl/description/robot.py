"""The data model of a robot: what URDF says, as plain data with file and line.

No parsing and no physics here. SI units, angles in radians, `rpy` is fixed-axis roll pitch yaw as in URDF.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from slidectl import names, rotations
from slidectl.errors import Refused

if TYPE_CHECKING:
    from slidectl.description.ros2_control import Ros2Control
    from slidectl.description.sensors import Sensor

Vector = tuple[float, float, float]
JointType = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]
MOVING = ("revolute", "continuous", "prismatic")
"""The types of joints that move with one degree of freedom."""
Verdict = Literal["used", "converted", "ignored", "wrong"]
Transmissions = Literal["gazebo", "real"]
"""How joints are driven: as in gazebo_ros_control, or through their real transmissions."""


@dataclass(frozen=True)
class Notice:
    """One line of the report: the effect of a tag, an attribute or a value."""

    verdict: Verdict
    subject: str
    """The thing that it is about, such as `<gazebo reference="link2">/<kp>`."""
    text: str
    """What happens and why, as a clause without a full stop."""
    file: str
    line: int | None

    @property
    def where(self) -> str:
        """`file:line`, or the file alone."""
        return self.file if self.line is None else f"{self.file}:{self.line}"

    def __str__(self) -> str:
        return f"{self.where}: {self.subject}: {self.text}"


@dataclass(frozen=True)
class Pose:
    """Position and rotation in the parent's frame: metres, and fixed-axis roll pitch yaw in radians."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Inertial:
    """Mass in kg; inertia (ixx, ixy, ixz, iyy, iyz, izz) in kg·m² about the origin's axes at the centre of mass."""

    origin: Pose
    mass: float
    inertia: tuple[float, float, float, float, float, float]
    line: int | None = None
    mended: bool = False
    """True when the values are not from the file: those of several links combined, or corrected ones."""


@dataclass(frozen=True)
class Box:
    size: Vector
    """Full lengths of the edges, m."""


@dataclass(frozen=True)
class Cylinder:
    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    radius: float


@dataclass(frozen=True)
class Mesh:
    uri: str
    """The name of the mesh as written in the file."""
    path: str | None
    """The file on disk, absolute; None when it could not be found (then the report says so)."""
    scale: Vector = (1.0, 1.0, 1.0)


Geometry = Box | Cylinder | Sphere | Mesh


@dataclass(frozen=True)
class Material:
    name: str
    rgba: tuple[float, float, float, float] | None = None
    texture: str | None = None


@dataclass(frozen=True)
class Shape:
    """A visual or a collision of a link."""

    geometry: Geometry
    origin: Pose = Pose()
    name: str | None = None
    material: Material | None = None
    line: int | None = None
    file: str | None = None


@dataclass(frozen=True)
class Surface:
    """The properties in `<gazebo reference="LINK">`; None where a tag is missing."""

    mu1: float | None = None
    """Friction coefficient, 0 or more; may be infinite."""
    mu2: float | None = None
    turn_gravity_off: bool = False
    self_collide: bool | None = None
    material: str | None = None


@dataclass(frozen=True)
class Link:
    name: str
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()
    surface: Surface = Surface()
    line: int | None = None
    file: str | None = None


@dataclass(frozen=True)
class Limit:
    """`<limit>`: position in m or rad, velocity in m/s or rad/s, effort in N or N·m."""

    lower: float
    upper: float
    velocity: float
    effort: float
    line: int | None = None


@dataclass(frozen=True)
class Safety:
    """`<safety_controller>`: soft limits in m or rad; k_position in 1/s, k_velocity in N·s/m or N·m·s/rad."""

    soft_lower_limit: float
    soft_upper_limit: float
    k_position: float
    k_velocity: float


@dataclass(frozen=True)
class Mimic:
    """position = multiplier * position of `joint` + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    name: str
    type: JointType
    parent: str
    child: str
    origin: Pose = Pose()
    axis: Vector = (1.0, 0.0, 0.0)
    limit: Limit | None = None
    damping: float = 0.0
    """Viscous damping, N·s/m or N·m·s/rad."""
    friction: float = 0.0
    """Dry friction, N or N·m."""
    safety: Safety | None = None
    mimic: Mimic | None = None
    line: int | None = None
    file: str | None = None

    def child_pose(self, position: float) -> rotations.Pose:
        """The pose of the child in the parent at a position (m or rad) along or about the axis."""
        x, y, z = self.axis
        displacement: rotations.Pose = (x * position, y * position, z * position), rotations.IDENTITY
        if self.type in ("revolute", "continuous"):
            sine = math.sin(position / 2)
            displacement = (0.0, 0.0, 0.0), (x * sine, y * sine, z * sine, math.cos(position / 2))
        return rotations.compose((self.origin.xyz, rotations.from_rpy(self.origin.rpy)), displacement)


@dataclass(frozen=True)
class TransmissionJoint:
    name: str
    hardware_interfaces: tuple[str, ...]
    role: str = ""
    offset: float = 0.0
    reduction: float = 1.0


@dataclass(frozen=True)
class TransmissionActuator:
    name: str
    hardware_interfaces: tuple[str, ...] = ()
    reduction: float | None = None
    role: str = ""
    max_effort: float = math.inf
    """The largest effort, N or N·m."""
    rotor_inertia: float = 0.0
    """Inertia of the rotor, kg·m²; mass of a linear actuator, kg."""


@dataclass(frozen=True)
class TransmissionInfo:
    """One `<transmission>` as the parser of ros_control reads it."""

    name: str
    type: str
    joints: tuple[TransmissionJoint, ...]
    actuators: tuple[TransmissionActuator, ...]
    line: int | None = None
    file: str | None = None
    is_real: bool = False
    """True: it is computed between its actuators and joints. False: only the interface of its joint counts."""


@dataclass(frozen=True)
class ControlPlugin:
    """The parameters of the `libgazebo_ros_control.so` plugin; None where a tag is missing."""

    robot_namespace: str | None = None
    robot_param: str = "robot_description"
    robot_sim_type: str = "gazebo_ros_control/DefaultRobotHWSim"
    control_period: float | None = None
    """Control period, s."""
    estop_topic: str | None = None
    line: int | None = None
    file: str | None = None
    transmissions: Transmissions | None = None


@dataclass(frozen=True)
class BaseDrive:
    """A plugin that moves the robot at commanded velocities (geometry_msgs/Twist) and publishes nav_msgs/Odometry."""

    name: str
    namespace: str | None
    """The namespace of its topics; None: that of the robot."""
    command_topic: str
    odometry_topic: str
    odometry_frame: str
    base_frame: str
    odometry_rate_hz: float
    """Rate of odometry, Hz; 0: in each step of the world."""
    has_odometry: bool
    has_odometry_tf: bool
    tells_height: bool
    """True: z in the odometry is the robot's; False: it is 0."""
    pose_variances: Vector
    """Variances of x and y in m², and of the heading in rad²."""
    twist_variances: Vector | None


@dataclass(frozen=True)
class WheelDrive(BaseDrive):
    """libgazebo_ros_diff_drive.so and libgazebo_ros_skid_steer_drive.so: the wheels of a side have one velocity."""

    left: tuple[str, ...] = ()
    """Joints of the wheels that turn faster when the base turns to the right."""
    right: tuple[str, ...] = ()
    separation: float = 0.0
    """Distance between the sides' wheels, m."""
    diameter: float = 0.0
    """Diameter of the wheels, m."""
    torque: float = 0.0
    """The largest torque on each wheel, N·m."""
    acceleration: float = 0.0
    """The largest acceleration of the wheels along the ground, m/s²; 0: no limit except the torque."""
    update_rate_hz: float = 0.0
    """How often commands take effect, Hz; 0: in each step of the world."""
    measures_wheels: bool = False
    """True: odometry is computed from the wheels' rotation; False: from the robot's pose in the world."""
    has_joint_states: bool = False


@dataclass(frozen=True)
class PlanarMove(BaseDrive):
    """libgazebo_ros_planar_move.so: the whole robot has the commanded velocity, whatever forces act on it."""

    timeout_s: float = -1.0
    """How long a command is valid, s; below 0: until the next."""
    falls: bool = False
    """True when the robot falls and tilts as any other; else it keeps its height and its attitude in the air."""


@dataclass(frozen=True)
class Robot:
    """The whole robot. `links` and `joints` keep the order of the file."""

    name: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    root: str
    """The name of the only link that is not the child of a joint."""
    transmissions: Sequence[TransmissionInfo] = ()
    plugin: ControlPlugin | None = None
    report: Sequence[Notice] = field(default=())
    sensors: Sequence[Sensor] = ()
    drives: Sequence[BaseDrive] = ()
    ros2_control: Ros2Control | None = None
    """What `<ros2_control>` says: then this is a robot of ROS 2, and has no `transmissions`."""

    def children_of(self, link: str) -> Sequence[Joint]:
        """The joints whose parent is `link`, in the order of the file."""
        return self._children.get(link, ())

    @cached_property
    def _children(self) -> dict[str, list[Joint]]:
        children: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)
        return children

    @property
    def is_fixed_to_world(self) -> bool:
        """True when the root link is called `world`: it is the world itself."""
        return self.root == "world"


def check_position(joint: Joint, position: float) -> None:
    """Raise Refused unless the joint can be at `position` (rad or m)."""
    if not math.isfinite(position):
        raise Refused(f"position of {joint.name} must be a finite number, not {position}")
    limit = joint.limit if joint.type in ("revolute", "prismatic") else None
    if limit is not None and not limit.lower <= position <= limit.upper:
        unit = "m" if joint.type == "prismatic" else "rad"
        raise Refused(f"{joint.name} goes from {limit.lower:g} to {limit.upper:g} {unit}, not to {position:g}")


def namespace_of(robot: Robot, name: str) -> str:
    """The plugin's `robotNamespace` with a leading slash, else `/name`. An empty one means the root, `/`.

    A robot of ROS 2 is in the root, as its controller manager is there, unless the plugin names a namespace.

    A `name` that is no graph name becomes one, part by part (see names.legal_robot).

    Raises BadName: a `robotNamespace` that cannot be a namespace.
    """
    written = robot.plugin.robot_namespace if robot.plugin is not None else None
    if robot.ros2_control is not None:
        written = robot.ros2_control.namespace
    return names.legal_namespace(name) if written is None else names.check("/" + written.strip("/"))
