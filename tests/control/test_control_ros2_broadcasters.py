"""The broadcasters of IMUs and of forces and torques of ROS 2, with rotations, covariances, offsets and factors."""

from __future__ import annotations

from math import isnan, pi
from typing import Any

import numpy as np
import pytest
from fake_robot import Bench, FakeRobot

from slidectl.control.hardware_interface import (
    ForceTorqueData,
    ForceTorqueSensorInterface,
    ImuData,
    ImuSensorInterface,
    SensorHandle,
)
from slidectl.errors import Refused

TURN = (0.5, 0.5, 0.5, 0.5)  # x to y, y to z, z to x
MEASURED = ImuData(TURN, None, (1.0, 2.0, 3.0), None, (0.0, 0.0, 9.8), None)
IMU = {"type": "imu_sensor_broadcaster/IMUSensorBroadcaster", "sensor_name": "head", "frame_id": "imu_link"}
WRENCH = {"type": "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster", "frame_id": "tool"}


def bench_with(**parameters: Any) -> Bench:
    robot = FakeRobot()
    robot.register_interface(ImuSensorInterface([SensorHandle("head", "of_model", lambda: MEASURED)]))
    wrench = ForceTorqueData((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    other = ForceTorqueData((10.0, 20.0, 30.0), (40.0, 50.0, 60.0))
    sensors = [SensorHandle("wrist", "of_model", lambda: wrench), SensorHandle("foot", "of_model", lambda: other)]
    robot.register_interface(ForceTorqueSensorInterface(sensors))
    return Bench(robot, {"sensor": parameters})


def message_of(bench: Bench, topic: str) -> dict[str, Any]:
    bench.start("sensor")
    bench.run()
    return bench.graph.sent(f"/bot/sensor/{topic}")[-1]


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Z-Y'-X''."""
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def matrix(quaternion: dict[str, float]) -> np.ndarray:
    x, y, z, w = (quaternion[axis] for axis in "xyzw")
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def vector(message: dict[str, float]) -> list[float]:
    return [message[axis] for axis in "xyz"]


def test_an_imu_is_published_as_it_measures_in_the_frame_of_the_parameter() -> None:
    message = message_of(bench_with(**IMU), "imu")
    assert message["header"]["frame_id"] == "imu_link"
    assert message["header"]["stamp"] == {"secs": 0, "nsecs": 2_000_000}
    assert message["orientation"] == {"x": 0.5, "y": 0.5, "z": 0.5, "w": 0.5}
    assert vector(message["angular_velocity"]) == [1.0, 2.0, 3.0]
    assert vector(message["linear_acceleration"]) == [0.0, 0.0, 9.8]
    assert message["orientation_covariance"] == [0.0] * 9


def test_an_offset_turns_vectors_and_their_covariances_once() -> None:
    angles = (0.3, -0.7, pi / 3)
    covariances = np.random.default_rng(1).uniform(0.0, 1.0, (3, 9))
    names = ("orientation", "angular_velocity", "linear_acceleration")
    static = {f"static_covariance_{name}": row.tolist() for name, row in zip(names, covariances, strict=True)}
    offset = dict(zip(("roll", "pitch", "yaw"), angles, strict=True))
    bench = bench_with(**IMU, **static, rotation_offset=offset)
    message_of(bench, "imu")
    bench.run(5)
    message, turn = bench.graph.sent("/bot/sensor/imu")[-1], rotation(*angles)
    measured = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert matrix(message["orientation"]) == pytest.approx(measured @ turn.T)
    assert vector(message["angular_velocity"]) == pytest.approx(turn @ (1.0, 2.0, 3.0))
    assert vector(message["linear_acceleration"]) == pytest.approx(turn @ (0.0, 0.0, 9.8))
    assert message["orientation_covariance"] == pytest.approx(covariances[0])
    for name, row in zip(names[1:], covariances[1:], strict=True):
        expected = turn @ row.reshape(3, 3) @ turn.T
        assert message[f"{name}_covariance"] == pytest.approx(expected.ravel())


def test_forces_and_torques_get_their_offset_and_then_their_factor() -> None:
    offset = {"force": {"x": 0.5}, "torque": {"z": -6.0}}
    multiplier = {"force": {"x": 2.0, "y": -1.0}}
    message = message_of(bench_with(**WRENCH, sensor_name="wrist", offset=offset, multiplier=multiplier), "wrench")
    assert message["header"]["frame_id"] == "tool"
    assert vector(message["wrench"]["force"]) == [3.0, -2.0, 3.0]
    assert vector(message["wrench"]["torque"]) == [4.0, 5.0, 0.0]


def test_offsets_and_factors_change_while_it_runs() -> None:
    bench = bench_with(**WRENCH, sensor_name="wrist")
    message_of(bench, "wrench")
    bench.graph.set("/bot/sensor/offset/force/z", -3.0)
    bench.graph.set("/bot/sensor/multiplier/torque", {"x": 10.0})
    bench.run()
    wrench = bench.graph.sent("/bot/sensor/wrench")[-1]["wrench"]
    assert (wrench["force"]["z"], wrench["torque"]["x"]) == (0.0, 40.0)


def test_axes_can_come_from_several_sensors_and_the_others_are_nan() -> None:
    names = {"force": {"x": "wrist/force.x", "y": "foot/force.y"}, "torque": {"z": "foot/torque.x"}}
    wrench = message_of(bench_with(**WRENCH, interface_names=names), "wrench")["wrench"]
    assert (wrench["force"]["x"], wrench["force"]["y"], wrench["torque"]["z"]) == (1.0, 20.0, 40.0)
    assert all(map(isnan, (wrench["force"]["z"], wrench["torque"]["x"], wrench["torque"]["y"])))


def test_nothing_is_measured_while_nobody_subscribes() -> None:
    bench = bench_with(**WRENCH, sensor_name="wrist", update_rate=500)
    bench.start("sensor")
    bench.graph.publishers["/bot/sensor/wrench"].wanted = False
    bench.run(10)
    assert bench.graph.sent("/bot/sensor/wrench") == []
    assert bench.graph.publishers["/bot/sensor/wrench"].sequence == 5


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        (IMU | {"sensor_name": "heat"}, "no sensor 'heat' in hardware_interface::ImuSensorInterface. Did you mean"),
        (IMU | {"static_covariance_orientation": [1.0]}, "static_covariance_orientation"),
        (WRENCH, "/bot/sensor has neither of sensor_name and interface_names"),
        (WRENCH | {"sensor_name": "wrist", "interface_names": {"force": {"x": "wrist/force.x"}}}, "has both of"),
        (WRENCH | {"interface_names": {"force": {"x": "wrist/force"}}}, "no state interface 'wrist/force'"),
        (
            WRENCH | {"sensor_name": "wrist", "sensor_filter_chain": {"filter1": {"name": "f"}}},
            "parameter /bot/sensor/sensor_filter_chain must be left out, since slidectl has no filters",
        ),
    ],
)
def test_what_does_not_exist_is_refused(parameters: dict[str, Any], text: str) -> None:
    bench = bench_with(**parameters)
    loaded = bench.manager.load("sensor")
    if "covariance" in text:  # a value of another type counts as not set
        assert loaded
        assert f"{text} has no effect" in bench.graph.lines("warn")
    else:
        assert not loaded
        assert text in bench.graph.lines("error")


def test_the_sensor_is_fixed_when_the_controller_is_loaded() -> None:
    bench = bench_with(**IMU)
    bench.load("sensor")
    with pytest.raises(Refused, match="/bot/sensor/rotation_offset/yaw is fixed when the controller is loaded"):
        bench.graph.set("/bot/sensor/rotation_offset/yaw", 1.0)
