"""Sensors of forces and torques in joints, and the controllers of sensors, against statics and Newton's law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from slidectl import Simulation, description, msgs

GRAVITY = 9.8
MASS, ARM = 2.0, 0.1
"""Of the tool: kg, and m from the joint to its centre of mass along x."""
INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
PLUGIN = """<gazebo reference="mount"><provideFeedback>true</provideFeedback></gazebo>
  <gazebo><plugin name="wrist" filename="libgazebo_ros_ft_sensor.so"><jointName>mount</jointName>
  <topicName>wrench</topicName><updateRate>{rate}</updateRate><gaussianNoise>{noise}</gaussianNoise></plugin></gazebo>"""
SENSOR = """<gazebo reference="mount"><sensor type="force_torque" name="wrist"><force_torque>
  <frame>{frame}</frame><measure_direction>{direction}</measure_direction></force_torque>
  <plugin name="p" filename="libgazebo_ros_ft_sensor.so"><topicName>wrench</topicName></plugin></sensor></gazebo>"""
IMU = """<gazebo reference="tool"><sensor type="imu" name="attitude"><update_rate>100</update_rate>
  <plugin name="p" filename="libgazebo_ros_imu_sensor.so"><topicName>imu</topicName>
  <gaussianNoise>0.1</gaussianNoise></plugin></sensor></gazebo>"""


def arm(
    more: str = PLUGIN.format(rate=0, noise=0.0), rpy: str = "0 0 0", mount: str = 'type="fixed"', root: str = "world"
) -> str:
    """A carriage that slides along x, and a tool on it."""
    return f"""<robot name="arm"><link name="{root}"/>
      <link name="carriage"><inertial><mass value="3"/>{INERTIA}</inertial>
        <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
      <joint name="slide" type="prismatic"><parent link="{root}"/><child link="carriage"/><axis xyz="1 0 0"/>
        <limit lower="-9" upper="9" effort="100" velocity="100"/></joint>
      <link name="tool"><inertial><origin xyz="{ARM} 0 0"/><mass value="{MASS}"/>{INERTIA}</inertial></link>
      <joint name="mount" {mount}><parent link="carriage"/><child link="tool"/><origin rpy="{rpy}"/>
        <axis xyz="0 1 0"/><limit lower="0" upper="0" effort="100" velocity="100"/></joint>
      <transmission name="t"><type>transmission_interface/SimpleTransmission</type>
        <joint name="slide"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
        <actuator name="m"/></transmission>{more}
      <gazebo><plugin name="control" filename="libgazebo_ros_control.so"/></gazebo></robot>"""


def listen(simulation: Simulation, topic: str) -> list[dict[str, Any]]:
    heard: list[dict[str, Any]] = []
    type_name = simulation.graph.topics.type_of(topic)
    simulation.subscribe(topic, lambda message: heard.append(msgs.check(type_name, message)))
    return heard


def wrenches(urdf: str, cycles: int = 500, before: Callable[[Simulation], Any] = str) -> list[dict[str, Any]]:
    """What the sensor says in these cycles."""
    simulation = Simulation()
    simulation.spawn(urdf, "arm", pose=((0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0)))
    heard = listen(simulation, "/arm/wrench")
    before(simulation)
    simulation.step(cycles)
    return heard


def components(message: dict[str, Any], part: str) -> list[float]:
    return list(message["wrench"][part].values())


WEIGHT = MASS * GRAVITY


@pytest.mark.parametrize("mount", ['type="fixed"', 'type="revolute"'], ids=["fixed", "at its limit"])
def test_a_sensor_feels_the_weight_that_the_child_puts_on_the_joint(mount: str) -> None:
    last = wrenches(arm(mount=mount))[-1]
    assert last["header"]["frame_id"] == "tool"
    assert components(last, "force") == pytest.approx([0, 0, -WEIGHT], abs=0.05)  # a joint stop gives a little
    assert components(last, "torque") == pytest.approx([0, ARM * WEIGHT, 0], abs=0.01)


def test_it_speaks_in_the_axes_of_the_child() -> None:
    last = wrenches(arm(rpy="1.5707963267948966 0 0"))[-1]
    assert components(last, "force") == pytest.approx([0, -WEIGHT, 0], abs=1e-6)
    assert components(last, "torque") == pytest.approx([0, 0, -ARM * WEIGHT], abs=1e-6)


@pytest.mark.parametrize(
    ("frame", "direction", "name", "force"),
    [
        ("child", "child_to_parent", "tool", [0, -WEIGHT, 0]),
        ("child", "parent_to_child", "tool", [0, WEIGHT, 0]),
        ("parent", "child_to_parent", "carriage", [0, 0, -WEIGHT]),
        ("parent", "parent_to_child", "carriage", [0, 0, WEIGHT]),
    ],
)
def test_frame_and_direction_of_a_sensor_count(frame: str, direction: str, name: str, force: list[float]) -> None:
    last = wrenches(arm(SENSOR.format(frame=frame, direction=direction), "1.5707963267948966 0 0"))[-1]
    assert last["header"]["frame_id"] == name
    assert components(last, "force") == pytest.approx(force, abs=1e-6)


def test_it_feels_what_is_accelerated() -> None:
    def push(simulation: Simulation) -> None:
        request = {"joint_name": "arm::slide", "effort": 10.0, "duration": {"secs": -1}}
        simulation.call("/gazebo/apply_joint_effort", request)

    last = wrenches(arm(), 100, push)[-1]
    assert components(last, "force") == pytest.approx([-MASS * 10.0 / (3.0 + MASS), 0, -WEIGHT], abs=1e-3)


def test_it_feels_what_pushes_the_tool_from_outside_while_it_pushes() -> None:
    def push(simulation: Simulation) -> None:
        wrench = {"force": {"y": 5.0}, "torque": {"x": 0.5}}
        request = {"body_name": "arm::tool", "wrench": wrench, "duration": {"nsecs": 50_000_000}}
        simulation.call("/gazebo/apply_body_wrench", request)

    heard = wrenches(arm(), 200, push)
    assert components(heard[20], "force") == pytest.approx([0, 5.0, -WEIGHT], abs=1e-6)
    assert components(heard[20], "torque") == pytest.approx([0.5, ARM * WEIGHT, 5.0 * ARM], abs=1e-6)
    assert components(heard[-1], "force") == pytest.approx([0, 0, -WEIGHT], abs=1e-6)


def test_a_tool_without_gravity_puts_nothing_on_its_joint() -> None:
    weightless = '<gazebo reference="tool"><turnGravityOff>true</turnGravityOff></gazebo>'
    last = wrenches(arm(PLUGIN.format(rate=0, noise=0.0) + weightless))[-1]
    assert components(last, "force") == pytest.approx([0, 0, 0], abs=1e-6)


def test_on_a_robot_that_stands_on_the_ground_it_feels_the_weight_too() -> None:
    last = wrenches(arm(root="base"), 3000)[-1]
    assert components(last, "force") == pytest.approx([0, 0, -WEIGHT], abs=1e-2)


def test_rate_and_noise_are_those_of_the_model() -> None:
    heard = wrenches(arm(PLUGIN.format(rate=100, noise=0.5)), 10_000)
    assert len(heard) == 1000
    values = [components(message, "force")[0] for message in heard]
    assert sum(values) / 1000 == pytest.approx(0.0, abs=0.06)
    assert (sum(value * value for value in values) / 1000) ** 0.5 == pytest.approx(0.5, rel=0.1)


def test_controllers_publish_what_the_sensors_of_the_model_measure() -> None:
    simulation = Simulation()
    simulation.spawn(arm(PLUGIN.format(rate=100, noise=0.1) + IMU), "arm")
    for name, kind in (("forces", "force_torque"), ("attitudes", "imu")):
        words = "".join(word.title() for word in kind.split("_"))
        values = {"type": f"{kind}_sensor_controller/{words}SensorController", "publish_rate": 100}
        simulation.graph.parameters.set(f"/arm/{name}", values)
        assert simulation.call("/arm/controller_manager/load_controller", {"name": name})["ok"]
    topics = [listen(simulation, f"/arm/{name}") for name in ("wrist", "wrench", "attitude", "imu")]
    simulation.call(
        "/arm/controller_manager/switch_controller",
        {"start_controllers": ["forces", "attitudes"], "strictness": 2},
    )
    simulation.step(1000)
    forces, from_plugin, attitudes, from_sensor = topics
    assert len(forces) == len(attitudes) == 99
    assert components(forces[-1], "force") == pytest.approx(components(from_plugin[-1], "force"), abs=1.0)
    assert attitudes[-1]["header"]["frame_id"] == from_sensor[-1]["header"]["frame_id"] == "tool"
    assert attitudes[-1]["linear_acceleration"]["z"] == pytest.approx(GRAVITY, abs=1.0)
    assert attitudes[-1]["linear_acceleration_covariance"] == from_sensor[-1]["linear_acceleration_covariance"]


def test_a_controller_of_sensors_says_that_the_robot_has_none() -> None:
    simulation = Simulation()
    simulation.spawn(arm(""), "arm")
    values = {"type": "imu_sensor_controller/ImuSensorController", "publish_rate": 100}
    simulation.graph.parameters.set("/arm/attitudes", values)
    heard: list[str] = []
    simulation.subscribe("/rosout", lambda message: heard.append(message["msg"]))
    assert simulation.call("/arm/controller_manager/load_controller", {"name": "attitudes"})["ok"]
    text = "/arm/attitudes: no sensor is in hardware_interface::ImuSensorInterface: nothing is published"
    assert text in heard


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (PLUGIN.format(rate=0, noise=0).replace("<jointName>mount", "<jointName>no"), "there is no joint 'no'"),
        (PLUGIN.format(rate=0, noise=0).replace("topicName", "topic"), "<topicName> is missing"),
        (SENSOR.format(frame="sensor", direction="child_to_parent"), "'sensor' has no effect: it is child, or parent"),
        (SENSOR.format(frame="child", direction="child_to_parent").replace("force_torque", "torque"), "force_torque"),
    ],
)
def test_what_has_no_effect_is_told(more: str, text: str) -> None:
    assert any(text in str(notice) for notice in description.parse(arm(more)).report)
