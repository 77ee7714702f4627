"""Sensors of robots: they are measured and published at the rates in the model. Without a subscriber they cost nothing.

Every run gives the same bits, independent of the subscribers.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from slidectl import names
from slidectl.control.controllers.sensor_controllers import (
    ForceTorqueSensorController,
    ImuSensorController,
    imu_message,
    wrench_message,
)
from slidectl.control.duration import header_of
from slidectl.control.node_handle import Message
from slidectl.description.sensors import (
    Bumper,
    Camera,
    ForceTorque,
    GroundTruth,
    Imu,
    JointStates,
    Laser,
    OtherSensor,
    Sensor,
)
from slidectl.features.gazebo_frames import pose_message, twist_message, vector_message
from slidectl.physics import World, rendering, sensing
from slidectl.rotations import Vector, add, cross, subtract
from slidectl.simulation.clock import period_ns_of
from slidectl.simulation.feature import Feature
from slidectl.simulation.pending import Pending
from slidectl.simulation.sensor_kinds import OtherSensorTopic
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_CHANNELS = {"mono8": 1, "rgb8": 3, "bgr8": 3}


# -- what each kind of sensor measures ---------------------------------------------------------------------------------


def _scan(world: World, robot: str, sensor: Laser, time_ns: int) -> Message:
    pose = sensing.sensor_pose(world, robot, sensor)
    rays = _rays(sensor.min_angle, sensor.max_angle, sensor.samples)
    distances = sensing.distances(world, pose, rays, sensor.min_range, sensor.max_range)
    draw = sensing.draws(robot, sensor, time_ns)
    noisy = [
        min(max(distance + draw(), sensor.min_range), sensor.max_range) if distance < math.inf else math.inf
        for distance in distances.tolist()
    ]
    spacings = max(1, sensor.samples - 1)
    return {
        "header": header_of(time_ns, sensor.frame),
        "angle_min": sensor.min_angle,
        "angle_max": sensor.max_angle,
        "angle_increment": (sensor.max_angle - sensor.min_angle) / spacings,
        "time_increment": 0.0,
        "scan_time": 0.0,
        "range_min": sensor.min_range,
        "range_max": sensor.max_range,
        "ranges": noisy,
        "intensities": [0.0] * sensor.samples,
    }


@lru_cache
def _rays(min_angle: float, max_angle: float, samples: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The unit vectors of a scan in the sensor's frame: samples x 3."""
    angles = np.linspace(min_angle, max_angle, samples)
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(samples)])


def _imu(world: World, robot: str, sensor: Imu, time_ns: int) -> Message:
    return imu_message(header_of(time_ns, sensor.frame), sensing.imu(world, robot, sensor, time_ns))


def _wrench(world: World, robot: str, sensor: ForceTorque, time_ns: int) -> Message:
    return wrench_message(header_of(time_ns, sensor.frame), sensing.force_torque(world, robot, sensor, time_ns))


def _odometry(world: World, robot: str, sensor: GroundTruth, time_ns: int) -> Message:
    draw, variance = sensing.draws(robot, sensor, time_ns), sensor.noise**2
    pose = sensing.sensor_pose(world, robot, sensor)
    linear, angular = sensing.sensor_twist(world, robot, sensor)
    covariance = [variance if row == column else 0.0 for row in range(6) for column in range(6)]
    place = sensing.noisy(pose[0], draw), pose[1]
    moving = sensing.noisy(linear, draw), sensing.noisy(angular, draw)
    return {
        "header": header_of(time_ns, sensor.frame),
        "child_frame_id": sensor.link,
        "pose": {"pose": pose_message(place), "covariance": covariance},
        "twist": {"twist": twist_message(moving), "covariance": covariance},
    }


def _contacts(world: World, robot: str, sensor: Bumper, time_ns: int) -> Message:
    origin = world.link_pose(robot, sensor.link)[0]
    by_pair: dict[str, list[sensing.Touch]] = {}
    for touch in sensing.touches(world, robot, sensor.link):
        by_pair.setdefault(touch.other, []).append(touch)
    states = [_contact_state(origin, touches) for touches in by_pair.values()]
    return {"header": header_of(time_ns, sensor.frame), "states": states}


def _contact_state(origin: Vector, touches: list[sensing.Touch]) -> Message:
    """The touches of one pair of shapes as gazebo_msgs/ContactState. Torques are about the origin."""
    wrenches = []
    total_force: Vector = (0.0, 0.0, 0.0)
    total_torque: Vector = (0.0, 0.0, 0.0)
    for touch in touches:
        torque = cross(subtract(touch.position, origin), touch.force)
        total_force, total_torque = add(total_force, touch.force), add(total_torque, torque)
        wrenches.append({"force": vector_message(touch.force), "torque": vector_message(torque)})
    return {
        "info": f"{len(touches)} contact points",
        "collision1_name": touches[0].own,
        "collision2_name": touches[0].other,
        "wrenches": wrenches,
        "total_wrench": {"force": vector_message(total_force), "torque": vector_message(total_torque)},
        "contact_positions": [vector_message(touch.position) for touch in touches],
        "contact_normals": [vector_message(touch.normal) for touch in touches],
        "depths": [touch.depth for touch in touches],
    }


def _joints(world: World, robot: str, sensor: JointStates, time_ns: int) -> Message:
    moving = [joint for joint in sensor.joints if joint in world.robot(robot).joints]
    states = [world.joint_state(robot, joint) for joint in moving]
    positions, velocities, efforts = (list(column) for column in zip(*states, strict=True)) if states else ([], [], [])
    header = header_of(time_ns, sensor.frame)
    return {"header": header, "name": moving, "position": positions, "velocity": velocities, "effort": efforts}


_MEASURED: dict[type[Sensor], tuple[str, Callable[[World, str, Any, int], Message]]] = {
    Laser: ("sensor_msgs/LaserScan", _scan),
    Imu: (ImuSensorController.message_type, _imu),
    ForceTorque: (ForceTorqueSensorController.message_type, _wrench),
    GroundTruth: ("nav_msgs/Odometry", _odometry),
    Bumper: ("gazebo_msgs/ContactsState", _contacts),
    JointStates: ("sensor_msgs/JointState", _joints),
}
"""The message type of each kind of sensor, and the function that measures: world, robot, sensor and time to message."""


class SensorTopic:
    """One sensor of one robot, on its topic until the robot is deleted."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("_topic",)

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, sensor: Sensor) -> None:
        message_type, measure = _MEASURED[type(sensor)]
        self._topic = PeriodicTopic(
            simulation.graph,
            names.join(robot.namespace, sensor.topic),
            message_type,
            names.join(robot.namespace, "gazebo"),
            period_ns_of(sensor.rate_hz, simulation.timestep_ns),
            lambda: measure(simulation.world, robot.name, sensor, simulation.time_ns),
        )
        robot.cleanup.callback(self._topic.close)


# -- cameras -----------------------------------------------------------------------------------------------------------

_KEEPS_UP = 0.9
"""The part of the rate that is asked from which on a camera keeps up."""
_TO_KEEP_UP = (
    "drawing does not keep up: smaller pictures (<width>, <height>), a lower <update_rate> "
    "or a slower world (slidectl sim speed) help"
)
_LEAST_COUNTED = 10
_MOST_AT_ONCE = 2
"""Pictures of a camera that are under way. With one alone, a picture that takes a little longer than the period would
halve the rate."""


class CameraTopics:
    """The picture and the geometry of one camera, on their topics until the robot is deleted.

    A picture is published when it is rendered; while one is being rendered and another one waits, the next ones are
    skipped. So the number of pictures depends on the machine, but their content does not.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = ("_pictures", "_info")

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, camera: Camera) -> None:
        self._simulation = simulation
        self._robot = robot
        self._camera = camera
        self._has_failed = self._is_broken = False
        self._drawn_by = ""
        self._due = self._skipped = 0
        """Pictures that were due, and those of them that were skipped, since the rate was counted last."""
        self._reached_hz: float | None = None
        self._has_warned = False
        self._rendering: list[Pending] = []
        """The picture that is being rendered, and the one that waits for it."""
        node = names.join(robot.namespace, "gazebo")
        period_ns = period_ns_of(camera.rate_hz)
        self._asked_hz = 1e9 / (period_ns or simulation.timestep_ns)
        topic, info = (_inside(robot.namespace, topic) for topic in (camera.topic, camera.info_topic))
        self.topic = topic
        self._pictures = PeriodicTopic(simulation.graph, topic, "sensor_msgs/Image", node, period_ns, self._render)
        robot.cleanup.callback(self._pictures.close)
        self._info = PeriodicTopic(simulation.graph, info, "sensor_msgs/CameraInfo", node, period_ns, self._geometry)
        robot.cleanup.callback(self._info.close)
        robot.cleanup.callback(self._cancel)

    def _header(self) -> Message:
        return header_of(self._simulation.time_ns, self._camera.frame)

    def _render(self) -> None:
        """Start to render the present state; the picture is published when it is done."""
        self._count()
        if len(self._rendering) >= _MOST_AT_ONCE or self._is_broken:
            return
        simulation, camera, robot = self._simulation, self._camera, self._robot.name
        pose = sensing.sensor_pose(simulation.world, robot, camera)
        header, seed = self._header(), zlib.crc32(f"{robot}/{camera.name}/{simulation.time_ns}".encode())
        picture = simulation.host.render(simulation.world, camera, pose, seed)
        self._rendering.append(picture)
        picture.then(lambda done: self._publish(header, done))

    def _count(self) -> None:
        """Count a picture that is due, and once in a simulated second the rate; warn when it is too low.

        The first picture does not count: what draws is started for it.
        """
        if not self._drawn_by:
            return
        self._due += 1
        self._skipped += len(self._rendering) >= _MOST_AT_ONCE
        if self._due < max(_LEAST_COUNTED, self._asked_hz):
            return
        self._reached_hz = self._asked_hz * (self._due - self._skipped) / self._due
        self._due = self._skipped = 0
        if self._reached_hz < _KEEPS_UP * self._asked_hz and not self._has_warned:
            self._has_warned = True
            rates = f"{self._asked_hz:.4g} Hz asked, {self._reached_hz:.4g} reached"
            self._robot.node.log("warn", f"{self.topic}: {rates}; {_TO_KEEP_UP}")

    def rates(self) -> tuple[float, float, str] | None:
        """The rate that is asked and the one of the last second with subscribers, Hz, and what helps if it is too low.

        None while there are no subscribers, and in their first second.
        """
        if self._reached_hz is None or not self._pictures.wanted:
            return None
        is_slow = self._reached_hz < _KEEPS_UP * self._asked_hz
        return self._asked_hz, self._reached_hz, _TO_KEEP_UP if is_slow else ""

    def _cancel(self) -> None:
        for picture in self._rendering:
            picture.cancel()

    def _publish(self, header: Message, done: Pending) -> None:
        self._rendering.remove(done)
        if done.error is not None:  # a killed render process is started again, once
            self._has_failed, self._is_broken = True, self._has_failed
            last = "; it makes no more pictures" if self._is_broken else ""
            self._robot.node.log("error", f"camera {self._camera.name}: {done.error}{last}")
            return
        self._has_failed = False
        camera = self._camera
        drawn_by, self._drawn_by = self._drawn_by, self._simulation.host.drawn_by()
        if self._drawn_by != drawn_by and self._drawn_by.startswith(rendering.BY_SOFTWARE):
            text = f"camera {camera.name} is drawn by {self._drawn_by}; {rendering.INSTALL}"
            self._robot.node.log("info", text)
        self._pictures.publish(
            {
                "header": header,
                "height": camera.height,
                "width": camera.width,
                "encoding": camera.encoding,
                "is_bigendian": 0,
                "step": camera.width * _CHANNELS[camera.encoding],
                "data": done.result(),
            }
        )

    def _geometry(self) -> Message:
        camera = self._camera
        length = camera.width / (2.0 * math.tan(camera.field_of_view / 2.0))
        x, y = (camera.width + 1) / 2.0, (camera.height + 1) / 2.0
        return {
            "header": self._header(),
            "height": camera.height,
            "width": camera.width,
            "distortion_model": "plumb_bob",
            "D": [0.0] * 5,
            "K": [length, 0.0, x, 0.0, length, y, 0.0, 0.0, 1.0],
            "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "P": [length, 0.0, x, -length * camera.baseline, 0.0, length, y, 0.0, 0.0, 0.0, 1.0, 0.0],
            "binning_x": 0,
            "binning_y": 0,
            "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
        }


def _inside(namespace: str, topic: str) -> str:
    """The topic in the robot's namespace. A model spawned in the root may name its namespace in the topic itself."""
    return names.join("/" if f"/{topic}".startswith(f"{namespace}/") else namespace, topic)


class Sensors(Feature):
    """The sensor topics of all robots."""

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def on_spawn(self, robot: SpawnedRobot) -> None:
        make: dict[type[Sensor], Callable[..., Any]] = {Camera: CameraTopics, OtherSensor: OtherSensorTopic}
        robot.saved["sensors"] = [
            make.get(type(sensor), SensorTopic)(self._simulation, robot, sensor)
            for sensor in robot.description.sensors
            if sensor.topic
        ]

    def status(self) -> Message:
        found = [
            (camera.topic, *rates)
            for robot in self._simulation.robots
            for camera in _cameras(robot)
            if (rates := camera.rates()) is not None
        ]
        return {
            "cameras": [topic for topic, *_ in found],
            "cameras_asked": [asked for _, asked, _, _ in found],
            "cameras_reached": [reached for _, _, reached, _ in found],
            "cameras_advice": [advice for *_, advice in found],
        }


def _cameras(robot: SpawnedRobot) -> list[CameraTopics]:
    sensors = robot.saved.get("sensors", [])
    return [sensor for sensor in sensors if isinstance(sensor, CameraTopics)] if isinstance(sensors, list) else []
