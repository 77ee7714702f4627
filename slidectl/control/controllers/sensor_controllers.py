"""Publishes what the robot's sensors measure, after imu_sensor_controller and force_torque_sensor_controller.

Each sensor has its topic: its name in the robot's namespace. Parameter `publish_rate`. Nothing is commanded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import Controller
from slidectl.control.duration import from_seconds, header_of
from slidectl.control.hardware_interface import (
    ForceTorqueData,
    ForceTorqueSensorInterface,
    I,
    ImuData,
    ImuSensorInterface,
)
from slidectl.control.node_handle import Message, NodeHandle
from slidectl.control.params import NUMBER, Parameter
from slidectl.control.registry import controller
from slidectl.rotations import Vector
from slidectl.rotations import message as quaternion

RATE = Parameter(
    "publish_rate",
    NUMBER,
    "messages of each sensor per simulated second; none unless above 0",
    "1/s",
    required=True,
    unless_positive="nothing is published",
)


class SensorController(Controller[I]):
    """Base of the controllers that publish one topic per sensor, all at the same times."""

    parameters: ClassVar[tuple[Parameter, ...]] = (RATE,)
    message_type: ClassVar[str]
    message: ClassVar[Callable[[Message, Any], Message]]
    """Makes the message from a header and a measurement."""

    def init_in_root(self, interface: I, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: publish_rate is not set, or its period is not a valid duration."""
        rate: float = params.value_of(node, RATE)
        self._period_ns = from_seconds(1.0 / rate) if rate > 0.0 else None
        if self._period_ns is None:
            node.log("warn", f"{node.namespace}/publish_rate is not above 0: nothing is published")
        if not interface.names():
            node.log("warn", f"{node.namespace}: no sensor is in {interface.type_name}: nothing is published")
        self._published_ns = 0
        self._sensors = []
        for name in interface.names():
            topic = root.advertise(names.join(root.namespace, name), self.message_type)
            self._sensors.append((interface.get_handle(name), topic))

    def starting(self, time_ns: int) -> None:
        """Set the time of the start. The first messages are due a period later."""
        self._published_ns = time_ns

    def update(self, time_ns: int, period_s: float) -> None:
        if self._period_ns is None or self._published_ns + self._period_ns >= time_ns:
            return
        self._published_ns += self._period_ns
        make = type(self).message
        for sensor, topic in self._sensors:
            if topic.wanted:
                topic.publish(make(header_of(time_ns, sensor.frame_id), sensor.measure()))
            else:
                topic.sequence += 1


def imu_message(header: Message, data: ImuData) -> Message:
    """sensor_msgs/Imu. A covariance that begins with -1 marks a quantity that is not measured."""
    return {
        "header": header,
        "orientation": quaternion(data.orientation or (0.0, 0.0, 0.0, 0.0)),
        "orientation_covariance": _covariance(data.orientation, data.orientation_covariance),
        "angular_velocity": _vector(data.angular_velocity),
        "angular_velocity_covariance": _covariance(data.angular_velocity, data.angular_velocity_covariance),
        "linear_acceleration": _vector(data.linear_acceleration),
        "linear_acceleration_covariance": _covariance(data.linear_acceleration, data.linear_acceleration_covariance),
    }


def wrench_message(header: Message, data: ForceTorqueData) -> Message:
    """geometry_msgs/WrenchStamped."""
    return {"header": header, "wrench": {"force": _vector(data.force), "torque": _vector(data.torque)}}


def _vector(vector: Vector | None) -> Message:
    return dict(zip("xyz", vector or (0.0, 0.0, 0.0), strict=True))


def _covariance(quantity: object, covariance: Sequence[float] | None) -> list[float]:
    if covariance is not None:
        return list(covariance)
    return [0.0 if quantity is not None else -1.0, *[0.0] * 8]


@controller("imu_sensor_controller/ImuSensorController")
class ImuSensorController(SensorController[ImuSensorInterface]):
    """sensor_msgs/Imu of each IMU."""

    interface_type = ImuSensorInterface
    message_type = "sensor_msgs/Imu"
    message = imu_message


@controller("force_torque_sensor_controller/ForceTorqueSensorController")
class ForceTorqueSensorController(SensorController[ForceTorqueSensorInterface]):
    """geometry_msgs/WrenchStamped of each force and torque sensor."""

    interface_type = ForceTorqueSensorInterface
    message_type = "geometry_msgs/WrenchStamped"
    message = wrench_message
