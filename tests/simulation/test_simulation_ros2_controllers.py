"""Controllers that behave as in ros2_controllers, each with a robot in a world."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest
from engine_scenes import add, arm
from test_simulation_force_torque import GRAVITY, IMU, MASS, PLUGIN
from test_simulation_force_torque import arm as tool_arm

from slidectl import Simulation, description


def world_with(xml: str, own: dict[str, dict[str, Any]]) -> Simulation:
    simulation = Simulation(ground=False)
    add(simulation, "a", xml, own)
    simulation.step(1)
    return simulation


def listened(simulation: Simulation, topic: str) -> list[dict[str, Any]]:
    """The messages on the topic from now on."""
    heard: list[dict[str, Any]] = []
    simulation.graph.topics.subscribe(topic, None, "/listener", heard.append)
    return heard


def test_the_states_of_all_joints_come_at_the_rate_of_the_broadcaster() -> None:
    own = {"type": "joint_state_broadcaster/JointStateBroadcaster", "update_rate": 100}
    simulation = world_with(arm(), {"states": own})
    heard = listened(simulation, "/a/joint_states")
    simulation.step(100)
    times = [message["header"]["stamp"]["nsecs"] // 1_000_000 for message in heard]
    assert times == list(range(times[0], times[0] + 91, 10))
    assert heard[-1]["name"] == ["joint1", "joint2", "joint3"]
    assert heard[-1]["velocity"][1] != 0.0  # the links fall


@pytest.mark.parametrize("engine", ["plain", "auto"])
def test_commands_are_passed_on_to_the_joints(engine: str) -> None:
    simulation = Simulation(ground=False, engine=engine)
    kind = "forward_command_controller/ForwardCommandController"
    own = {"type": kind, "joints": ["joint1"], "interface_name": "effort"}
    add(simulation, "a", arm(("prismatic",)), {"push": own})
    simulation.step(1)
    simulation.publish("/a/push/commands", {"data": [3.0]})
    simulation.step(1000)
    # 1.5 kg, damping 0.7 N·s/m: v = F/d · (1 - exp(-d/m · t))
    assert simulation.world.joint_state("a", "joint1")[1] == pytest.approx(
        3.0 / 0.7 * (1 - 2.71828 ** (-0.7 / 1.5)), 0.01
    )


def test_several_interfaces_of_a_joint_take_their_commands() -> None:
    kind = "forward_command_controller/MultiInterfaceForwardCommandController"
    own = {"type": kind, "joint": "joint1", "interface_names": ["velocity", "position"]}
    simulation = world_with(arm(("prismatic",), interface="PosVel"), {"move": own})
    simulation.publish("/a/move/commands", {"data": [0.0, 0.3]})
    simulation.step(500)
    assert simulation.world.joint_state("a", "joint1")[0] == pytest.approx(0.3, abs=1e-3)


def test_a_robot_of_ros_2_has_its_groups() -> None:
    simulation = Simulation(ground=False)
    simulation.spawn(arm(interface="Velocity"), "a")
    robot = next(iter(simulation.robots))
    robot.hardware.is_of_ros2 = True
    own = {"type": "velocity_controllers/JointGroupVelocityController", "joints": ["joint2", "joint3"]}
    simulation.parameters.set("/a/group", own)
    simulation.call("/a/controller_manager/load_controller", {"name": "group"})
    assert robot.manager.configure("group")
    request = {"start_controllers": ["group"], "stop_controllers": [], "strictness": 2}
    assert simulation.call("/a/controller_manager/switch_controller", request)["ok"]
    simulation.publish("/a/group/commands", {"data": [0.5, -0.25]})
    simulation.step(300)
    assert simulation.world.joint_state("a", "joint2")[1] == pytest.approx(0.5, abs=1e-6)
    assert simulation.world.joint_state("a", "joint3")[1] == pytest.approx(-0.25, abs=1e-6)


def test_a_base_drives_and_publishes_where_it_is() -> None:
    own = {
        "type": "diff_drive_controller/DiffDriveController",
        "left_wheel_names": ["left_wheel_joint"],
        "right_wheel_names": ["right_wheel_joint"],
        "wheel_separation": 0.4,
        "wheel_radius": 0.1,
        "tf_frame_prefix_enable": False,
        "update_rate": 50,
        "linear": {"x": {"max_acceleration": 0.5}},
    }
    simulation = Simulation()
    xml = description.load("cart", {"drive": "controller"}, description.Packages()).xml
    add(simulation, "cart", xml, {"base": own})
    simulation.step(1000)
    heard = listened(simulation, "/cart/base/odom")
    for _ in range(20):
        simulation.publish("/cart/base/cmd_vel", {"twist": {"linear": {"x": 0.4}}})
        simulation.step(100)
    assert len(heard) == 100
    assert heard[-1]["header"]["frame_id"] == "odom"
    assert heard[-1]["twist"]["twist"]["linear"]["x"] == pytest.approx(0.4, abs=0.01)
    travelled = 0.4 * 2.0 - 0.4 * 0.4 / 0.5 / 2.0  # it speeds up for 0.8 s
    assert heard[-1]["pose"]["pose"]["position"]["x"] == pytest.approx(travelled, abs=0.02)
    assert simulation.world.link_pose("cart", "base_link")[0][0] == pytest.approx(travelled, abs=0.03)


def test_the_sensors_of_a_model_are_broadcast() -> None:
    own: dict[str, dict[str, Any]] = {
        "head": {
            "type": "imu_sensor_broadcaster/IMUSensorBroadcaster",
            "sensor_name": "attitude",
            "frame_id": "head",
            "rotation_offset": {"roll": pi / 2},
        },
        "forces": {
            "type": "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster",
            "sensor_name": "wrist",
            "frame_id": "tool",
            "update_rate": 100,
        },
    }
    own["zeroed"] = {**own["forces"], "offset": {"force": {"z": MASS * GRAVITY}}, "multiplier": {"force": {"z": -1.0}}}
    simulation = world_with(tool_arm(PLUGIN.format(rate=0, noise=0.0) + IMU.replace(">0.1<", ">0<")), own)
    imu, *wrenches = (listened(simulation, f"/a/{topic}") for topic in ("head/imu", "forces/wrench", "zeroed/wrench"))
    simulation.step(500)
    assert (len(imu), len(wrenches[0])) == (500, 50)
    acceleration = imu[-1]["linear_acceleration"]
    assert [acceleration[axis] for axis in "xyz"] == pytest.approx([0.0, -GRAVITY, 0.0], abs=0.01)  # up is -y now
    plain, zeroed = (heard[-1]["wrench"]["force"]["z"] for heard in wrenches)
    assert abs(plain) == pytest.approx(MASS * GRAVITY, rel=0.01)
    assert zeroed == pytest.approx(-(plain + MASS * GRAVITY))
