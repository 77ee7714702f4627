"""Publishes what one sensor measures, after ros2_controllers' broadcasters of IMUs and of forces and torques.

A message comes with each update of the controller, with `frame_id` as its frame. Nothing is commanded.

Topics `~/imu` (sensor_msgs/Imu) and `~/wrench` (geometry_msgs/WrenchStamped).
"""

from __future__ import annotations

from math import nan
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import Controller
from slidectl.control.duration import header_of
from slidectl.control.hardware_interface import (
    ForceTorqueData,
    ForceTorqueSensorInterface,
    ImuSensorInterface,
    SensorHandle,
)
from slidectl.control.node_handle import Message, NodeHandle, publish_if_wanted
from slidectl.control.params import NUMBER, TEXT, BadParameter, Kind, Parameter, within
from slidectl.control.registry import ros2_controller
from slidectl.control.ros2_controller import UPDATE_RATE, Ros2Controller, fixed
from slidectl.errors import Refused, UnknownName
from slidectl.rotations import Quaternion, Vector, conjugate, from_rpy, matrix, multiply, normalized, rotate
from slidectl.rotations import message as quaternion_message

NINE = Kind(
    "a list of nine floats, such as 0.001",
    lambda value: value if isinstance(value, list) and [type(item) for item in value] == [float] * 9 else None,
)
NO_FILTERS: Kind[Any] = Kind("left out, since slidectl has no filters", lambda _: None)

SENSOR, FRAME = fixed(
    Parameter("sensor_name", TEXT, "the sensor", required=True),
    Parameter("frame_id", TEXT, "the frame in the header", required=True),
)
COVARIANCES = fixed(
    *(
        Parameter(f"static_covariance_{what}", NINE, f"of the {what.replace('_', ' ')}, row by row", default=[0.0] * 9)
        for what in ("orientation", "angular_velocity", "linear_acceleration")
    )
)
ROTATION = within(
    "rotation_offset",
    fixed(
        *(
            Parameter(angle, NUMBER, "turns the measurement into another frame", "rad", default=0.0)
            for angle in ("roll", "pitch", "yaw")
        )
    ),
)
_UNMEASURED: tuple[Quaternion, Vector] = ((nan, nan, nan, nan), (nan, nan, nan))


@ros2_controller("imu_sensor_broadcaster/IMUSensorBroadcaster")
class ImuBroadcaster(Ros2Controller, Controller[ImuSensorInterface]):
    """The IMU `sensor_name`, turned by `rotation_offset`, with static covariances."""

    interface_type = ImuSensorInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (UPDATE_RATE, SENSOR, FRAME, *COVARIANCES, *ROTATION)

    def init(self, interface: ImuSensorInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter is missing or wrong, or there is no such IMU."""
        roll, pitch, yaw = (params.value_of(node, angle) for angle in ROTATION)
        self._rotation = normalized(from_rpy((roll, pitch, yaw)))
        orientation, *others = (params.value_of(node, covariance) for covariance in COVARIANCES)
        self._covariances = [orientation, *(_turned(self._rotation, covariance) for covariance in others)]
        self._frame: str = params.value_of(node, FRAME)
        self._sensor = interface.get_handle(params.value_of(node, SENSOR))
        self._publisher = node.advertise("imu", "sensor_msgs/Imu")

    def cycle(self, time_ns: int, period_s: float) -> None:
        publish_if_wanted(self._publisher, lambda: self._message(time_ns))

    def _message(self, time_ns: int) -> Message:
        data, (no_orientation, no_vector) = self._sensor.measure(), _UNMEASURED
        orientation, velocity, acceleration = self._covariances
        turned = multiply(data.orientation or no_orientation, conjugate(self._rotation))
        return {
            "header": header_of(time_ns, self._frame),
            "orientation": quaternion_message(turned),
            "orientation_covariance": orientation,
            "angular_velocity": _message_of(rotate(self._rotation, data.angular_velocity or no_vector)),
            "angular_velocity_covariance": velocity,
            "linear_acceleration": _message_of(rotate(self._rotation, data.linear_acceleration or no_vector)),
            "linear_acceleration_covariance": acceleration,
        }


def _turned(rotation: Quaternion, covariance: list[float]) -> list[float]:
    """The covariance of a turned vector, R · C · Rᵀ, row by row."""
    import numpy as np  # takes long, and most robots turn no covariance

    turn = np.array(matrix(rotation))
    turned: list[float] = (turn @ np.reshape(covariance, (3, 3)) @ turn.T).ravel().tolist()
    return turned


def _message_of(vector: Vector) -> Message:
    return dict(zip("xyz", vector, strict=True))


AXES = tuple(f"{quantity}/{axis}" for quantity in ("force", "torque") for axis in "xyz")
STATES = tuple(axis.replace("/", ".") for axis in AXES)
"""The state interfaces of a sensor, as ROS 2 has them."""
SENSOR_OF_ALL = Parameter("sensor_name", TEXT, "the sensor of all axes; it or interface_names", default="")
NAMES = within(
    "interface_names",
    [
        Parameter(axis, TEXT, f"the state interface of this axis, as `wrist/{state}`; else it is nan", default="")
        for axis, state in zip(AXES, STATES, strict=True)
    ],
)
OFFSETS, MULTIPLIERS = (
    within(name, [Parameter(axis, NUMBER, meaning, unit, default=default, live=True) for axis in AXES])
    for name, meaning, unit, default in (
        ("offset", "is added to the measured value", "N or N·m", 0.0),
        ("multiplier", "multiplies the sum", "", 1.0),
    )
)
FILTERS = Parameter("sensor_filter_chain", NO_FILTERS, "the filters of ROS 2, which slidectl does not have")


@ros2_controller("force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster")
class ForceTorqueBroadcaster(Ros2Controller, Controller[ForceTorqueSensorInterface]):
    """Each axis is (measured + offset) · multiplier."""

    interface_type = ForceTorqueSensorInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(UPDATE_RATE, SENSOR_OF_ALL, FRAME, *NAMES, *OFFSETS, *MULTIPLIERS, FILTERS),
    )

    def init(self, interface: ForceTorqueSensorInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter is missing or wrong, or there is no such sensor."""
        if node.get_param(FILTERS.name, None) is not None:
            raise BadParameter(node, FILTERS.name, FILTERS.kind.words)
        self._frame: str = params.value_of(node, FRAME)
        sensor: str = params.value_of(node, SENSOR_OF_ALL)
        named: list[str] = [params.value_of(node, name) for name in NAMES]
        if bool(sensor) == any(named):
            what = "both" if sensor else "neither"
            raise Refused(f"{node.namespace} has {what} of sensor_name and interface_names; set one of them")
        sources = [f"{sensor}/{state}" for state in STATES] if sensor else named
        self._sources = [_source(interface, source) for source in sources]
        self._read_numbers()
        for name in ("offset", "multiplier"):
            node.watch_param(name, self._read_numbers)
        self._publisher = node.advertise("wrench", "geometry_msgs/WrenchStamped")

    def _read_numbers(self) -> None:
        self._offsets, self._multipliers = (
            [params.value_of(self._node, each) for each in several] for several in (OFFSETS, MULTIPLIERS)
        )

    def cycle(self, time_ns: int, period_s: float) -> None:
        publish_if_wanted(self._publisher, lambda: self._message(time_ns))

    def _message(self, time_ns: int) -> Message:
        measured: dict[str, ForceTorqueData] = {}
        values = []
        for source, offset, factor in zip(self._sources, self._offsets, self._multipliers, strict=True):
            raw = nan
            if source is not None:
                handle, index = source
                data = measured.get(handle.name) or measured.setdefault(handle.name, handle.measure())
                raw = (*data.force, *data.torque)[index]
            values.append((raw + offset) * factor)
        force, torque = (dict(zip("xyz", three, strict=True)) for three in (values[:3], values[3:]))
        return {"header": header_of(time_ns, self._frame), "wrench": {"force": force, "torque": torque}}


def _source(interface: ForceTorqueSensorInterface, name: str) -> tuple[SensorHandle[ForceTorqueData], int] | None:
    """The sensor of a state interface such as `wrist/force.x`, and the index of the axis; None for an empty name.

    Raises UnknownName: there is none of that name.
    """
    if not name:
        return None
    sensor, _, state = name.rpartition("/")
    handle = interface.get_handle(sensor)
    if state not in STATES:
        raise UnknownName("state interface", name, [f"{sensor}/{each}" for each in STATES])
    return handle, STATES.index(state)
