"""Sensors of robots: what a model declares is measured and published at its rate. Without a listener it costs nothing.

Every run gives the same bits, whoever listens.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

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
from slidectl.description.robot import Bumper, Camera, ForceTorque, GroundTruth, Imu, JointStates, Laser, Sensor
from slidectl.physics import sensing
from slidectl.rotations import Quaternion, Vector, add, cross, message, subtract
from slidectl.simulation.camera_topics import CameraTopics
from slidectl.simulation.clock import period_ns_of
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_TYPES = {
    Laser: "sensor_msgs/LaserScan",
    Imu: ImuSensorController.message_type,
    ForceTorque: ForceTorqueSensorController.message_type,
    GroundTruth: "nav_msgs/Odometry",
    Bumper: "gazebo_msgs/ContactsState",
    JointStates: "sensor_msgs/JointState",
}


class SensorTopic:
    """One sensor of one robot, on its topic until `close`."""

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, sensor: Sensor) -> None:
        self._simulation = simulation
        self._world = simulation.world
        self._robot = robot.name
        self._sensor = sensor
        build: dict[type[Sensor], Callable[[], Message]] = {
            Laser: self._scan,
            Imu: self._imu,
            ForceTorque: self._wrench,
            GroundTruth: self._odometry,
            Bumper: self._contacts,
            JointStates: self._joints,
        }
        if isinstance(sensor, Laser):
            angles = np.linspace(sensor.min_angle, sensor.max_angle, sensor.samples)
            self._directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sensor.samples)])
        self._topic = PeriodicTopic(
            simulation.graph,
            names.join(robot.namespace, sensor.topic),
            _TYPES[type(sensor)],
            names.join(robot.namespace, "gazebo") if robot.namespace != "/" else "/gazebo",
            period_ns_of(sensor.rate_hz, simulation.timestep_ns),
            build[type(sensor)],
        )

    def close(self) -> None:
        """Take the topic back."""
        self._topic.close()

    def _header(self) -> Message:
        return header_of(self._simulation.time_ns, self._sensor.frame)

    def _draws(self) -> Callable[[], float]:
        """Noise for this message."""
        return sensing.draws(self._robot, self._sensor, self._simulation.time_ns)

    def _scan(self) -> Message:
        sensor = self._sensor
        assert isinstance(sensor, Laser)
        pose = sensing.sensor_pose(self._world, self._robot, sensor)
        found = sensing.distances(self._world, pose, self._directions, sensor.min_range, sensor.max_range)
        draw = self._draws()
        noisy = [
            min(max(distance + draw(), sensor.min_range), sensor.max_range) if distance < math.inf else math.inf
            for distance in found.tolist()
        ]
        spacings = max(1, sensor.samples - 1)
        return {
            "header": self._header(),
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

    def _imu(self) -> Message:
        sensor = self._sensor
        assert isinstance(sensor, Imu)
        return imu_message(self._header(), sensing.imu(self._world, self._robot, sensor, self._simulation.time_ns))

    def _wrench(self) -> Message:
        sensor = self._sensor
        assert isinstance(sensor, ForceTorque)
        return wrench_message(
            self._header(), sensing.force_torque(self._world, self._robot, sensor, self._simulation.time_ns)
        )

    def _odometry(self) -> Message:
        draw, variance = self._draws(), self._sensor.noise**2
        pose = sensing.sensor_pose(self._world, self._robot, self._sensor)
        linear, angular = sensing.sensor_twist(self._world, self._robot, self._sensor)
        covariance = [variance if row == column else 0.0 for row in range(6) for column in range(6)]
        position = sensing.noisy(pose[0], draw)
        return {
            "header": self._header(),
            "child_frame_id": self._sensor.link,
            "pose": {"pose": _pose(position, pose[1]), "covariance": covariance},
            "twist": {
                "twist": {
                    "linear": _vector(sensing.noisy(linear, draw)),
                    "angular": _vector(sensing.noisy(angular, draw)),
                },
                "covariance": covariance,
            },
        }

    def _contacts(self) -> Message:
        by_pair: dict[str, list[sensing.Touch]] = {}
        for touch in sensing.touches(self._world, self._robot, self._sensor.link):
            by_pair.setdefault(touch.other, []).append(touch)
        states = [self._contact_state(other, touches) for other, touches in by_pair.items()]
        return {"header": self._header(), "states": states}

    def _contact_state(self, other: str, touches: list[sensing.Touch]) -> Message:
        """gazebo_msgs/ContactState. Torques are about the link's origin."""
        origin = self._world.link_pose(self._robot, self._sensor.link)[0]
        wrenches = []
        total_force: Vector = (0.0, 0.0, 0.0)
        total_torque: Vector = (0.0, 0.0, 0.0)
        for touch in touches:
            torque = cross(subtract(touch.position, origin), touch.force)
            total_force, total_torque = add(total_force, touch.force), add(total_torque, torque)
            wrenches.append({"force": _vector(touch.force), "torque": _vector(torque)})
        return {
            "info": f"{len(touches)} contact points",
            "collision1_name": touches[0].own,
            "collision2_name": other,
            "wrenches": wrenches,
            "total_wrench": {"force": _vector(total_force), "torque": _vector(total_torque)},
            "contact_positions": [_vector(touch.position) for touch in touches],
            "contact_normals": [_vector(touch.normal) for touch in touches],
            "depths": [touch.depth for touch in touches],
        }

    def _joints(self) -> Message:
        sensor = self._sensor
        assert isinstance(sensor, JointStates)
        moving = [joint for joint in sensor.joints if joint in self._world.body(self._robot).joints]
        states = [self._world.joint_state(self._robot, joint) for joint in moving]
        return {
            "header": self._header(),
            "name": moving,
            "position": [state[0] for state in states],
            "velocity": [state[1] for state in states],
            "effort": [state[2] for state in states],
        }


def _vector(vector: Vector) -> Message:
    return dict(zip("xyz", vector, strict=True))


def _pose(position: Vector, attitude: Quaternion) -> Message:
    return {"position": _vector(position), "orientation": message(attitude)}


def bring_up(simulation: Simulation, robot: SpawnedRobot) -> Callable[[], None]:
    """Give a robot the topics of its sensors. Returns what takes them back."""
    topics = [
        CameraTopics(simulation, robot, sensor)
        if isinstance(sensor, Camera)
        else SensorTopic(simulation, robot, sensor)
        for sensor in robot.paper.sensors
        if sensor.topic
    ]

    robot.kept["sensors"] = topics

    def take_back() -> None:
        for topic in topics:
            topic.close()

    return take_back
