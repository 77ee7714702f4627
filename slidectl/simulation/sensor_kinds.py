"""Kinds of sensors that installed packages add: the base class, what a sensor may ask the world, and its topic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from slidectl import names
from slidectl.control import user_classes
from slidectl.control.duration import header_of
from slidectl.control.node_handle import Message
from slidectl.description import sensors
from slidectl.description.element_values import parse_number
from slidectl.description.sensors import OtherSensor
from slidectl.description.xml_tree import Element, below
from slidectl.entry_points import WrongPart
from slidectl.errors import Refused, SlidectlError, UnknownName
from slidectl.msgs.checking import check
from slidectl.physics import sensing
from slidectl.rotations import Pose, Vector
from slidectl.simulation.clock import period_ns_of
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


class SensorTags:
    """The tags of a `<sensor>`. A path is tags one below the other, such as `range/max`."""

    def __init__(self, sensor: Element) -> None:
        self._sensor = sensor

    def number(self, path: str, default: float) -> float:
        """The number in a tag; the default when the tag is missing or empty. Raises BadFile, with file and line."""
        found = below(self._sensor, *path.split("/"))
        if found is None or not found.first_text:
            return default
        return parse_number(found.first_text, found, f"<sensor>/<{path}>")

    def text(self, path: str, default: str) -> str:
        """The text in a tag; the default when the tag is missing or empty."""
        found = below(self._sensor, *path.split("/"))
        return default if found is None else found.first_text or default


class SensorView:
    """What a sensor may ask of the world in the present cycle. Nothing here changes the world."""

    def __init__(self, simulation: Simulation, robot: str, sensor: OtherSensor) -> None:
        self._simulation = simulation
        self._robot = robot
        self._sensor = sensor
        self.time_ns: int = simulation.time_ns
        """Simulated time."""
        self.noise = sensing.draws(robot, sensor, simulation.time_ns)
        """A function: the sensor's noise, in the unit of what is measured; 0 without `<noise>`."""

    @property
    def header(self) -> Message:
        """A std_msgs/Header of the present time, in the frame of the sensor's link."""
        return header_of(self.time_ns, self._sensor.frame)

    @property
    def pose(self) -> Pose:
        """The sensor's position in the world, m, and its attitude, a quaternion x, y, z, w."""
        return sensing.sensor_pose(self._simulation.world, self._robot, self._sensor)

    @property
    def twist(self) -> tuple[Vector, Vector]:
        """The sensor's linear and angular velocity in the world's axes, m/s and rad/s."""
        return sensing.sensor_twist(self._simulation.world, self._robot, self._sensor)

    def distances(self, directions: Sequence[Vector], nearest: float, farthest: float) -> list[float]:
        """The distance to the first shape along each ray from `nearest` on, m; `inf` if there is none up to `farthest`.

        The directions are unit vectors in the sensor's frame.
        """
        rays = np.array(directions, dtype=float)
        return [float(one) for one in sensing.distances(self._simulation.world, self.pose, rays, nearest, farthest)]


class SensorKind:
    """A kind of sensors of links: `<sensor type="NAME">`. Each sensor of each robot has an instance.

    An instance keeps what its tags say and nothing that changes, so that snapshots need nothing of it.
    """

    message_type: ClassVar[str]
    """The type of its messages, such as `sensor_msgs/Range`."""

    def __init__(self, tags: SensorTags) -> None:
        """Read the tags of the kind. Raises BadFile. `topic`, `update_rate`, `pose` and `noise` are read already."""

    def measure(self, view: SensorView) -> Message:
        """The message of the present cycle; missing fields get defaults. Called only while there are subscribers."""
        raise NotImplementedError


class OtherSensorTopic:
    """A sensor of an installed kind, on its topic until the robot is deleted."""

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, sensor: OtherSensor) -> None:
        """Raises PartError: the kind cannot be loaded. Refused, BadFile: it refuses the sensor."""
        self._simulation = simulation
        self._robot = robot
        self._sensor = sensor
        self._is_broken = False
        with user_classes.watched_for("sensor", sensor.name, simulation.types.code):
            kind = _kind(sensor.kind)
            self._measurer = kind(SensorTags(sensor.tags))
            self._type = str(kind.message_type)
        topic = PeriodicTopic(
            simulation.graph,
            names.join(robot.namespace, sensor.topic),
            self._type,
            names.join(robot.namespace, "gazebo"),
            period_ns_of(sensor.rate_hz, simulation.timestep_ns),
            self._measure,
        )
        robot.cleanup.callback(topic.close)

    def _measure(self) -> Message | None:
        """The message; None after the first error of the kind's code, which the log has."""
        if self._is_broken:
            return None
        try:
            with user_classes.watched_for("sensor", self._sensor.name, self._simulation.types.code):
                message = self._measurer.measure(SensorView(self._simulation, self._robot.name, self._sensor))
            return check(self._type, message)
        except SlidectlError as error:
            self._is_broken = True
            text = error.message if isinstance(error, Refused) else f"sensor {self._sensor.name}: {error.message}"
            self._robot.node.log("error", f"{text}; the sensor stops measuring")
            return None


def _kind(name: str) -> type[SensorKind]:
    part = sensors.INSTALLED.find(name)
    if part is None:  # it was uninstalled since the model was read
        raise UnknownName("sensor", name, list(sensors.INSTALLED.parts()))
    kind: Any = sensors.INSTALLED.load(part)
    if not (isinstance(kind, type) and issubclass(kind, SensorKind)):
        raise WrongPart(part, sensors.INSTALLED.kind, "class derived from SensorKind")
    return kind
