"""Trajectory, group and base controllers on robots in the world, by their topics and actions, on both engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from engine_scenes import STATES, Scene, add, arm, play
from sim_robots import cart

from slidectl import description, msgs
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")

ROOT = Path(__file__).parent.parent.parent
GAINS = {"p": 400.0, "d": 60.0}
FOLLOWER = {
    "type": "effort_controllers/JointTrajectoryController",
    "joints": ["joint1", "joint2"],
    "gains": {"joint1": GAINS, "joint2": GAINS},
    "constraints": {"goal_time": 1.0, "joint1": {"goal": 0.05}, "joint2": {"goal": 0.05}},
}
ACTION = "/cart/arm/follow_joint_trajectory"


def trajectory(*positions: float, seconds: int = 1) -> dict[str, Any]:
    """To these positions, from wherever the joints are, with rest at the end."""
    names = [f"joint{k + 1}" for k in range(len(positions))]
    rest = [0.0] * len(positions)
    point = {"positions": positions, "velocities": rest, "time_from_start": {"secs": seconds, "nsecs": 0}}
    return {"joint_names": names, "points": [point]}


def send(simulation: Simulation, *positions: float) -> None:
    simulation.publish(f"{ACTION}/goal", {"goal": {"trajectory": trajectory(*positions)}})


def results(simulation: Simulation) -> list[tuple[int, int]]:
    """Status and error code of each result from now on."""
    found: list[tuple[int, int]] = []
    simulation.graph.topics.subscribe(
        f"{ACTION}/result",
        None,
        "/client",
        lambda message: found.append((message["status"]["status"], message["result"]["error_code"])),
    )
    return found


@pytest.fixture
def simulation() -> Simulation:
    simulation = Simulation(ground=False, engine="plain")
    states = {"states": {"type": STATES, "publish_rate": 50}}
    add(simulation, "cart", cart(joints=2), states | {"arm": FOLLOWER})
    simulation.step(1)
    return simulation


def test_a_goal_moves_the_joints_and_succeeds(simulation: Simulation) -> None:
    found = results(simulation)
    send(simulation, 0.5, -0.3)
    simulation.step(2000)
    assert found == [(3, 0)]
    joints = [joint.handle.position for joint in simulation.robots.get("cart").hardware.driven()]
    assert joints == pytest.approx([0.5, -0.3], abs=0.05)


def test_a_reset_of_the_world_ends_the_goal_and_a_new_one_is_followed(simulation: Simulation) -> None:
    found = results(simulation)
    send(simulation, 0.5, -0.3)
    simulation.step(500)
    simulation.call("/gazebo/reset_simulation")
    assert found == [(2, 0)]
    send(simulation, 0.2, 0.2)
    simulation.step(2000)
    assert found[1:] == [(3, 0)]


def test_a_robot_that_goes_ends_its_goal(simulation: Simulation) -> None:
    found = results(simulation)
    send(simulation, 0.5, -0.3)
    simulation.delete("cart")
    assert found == [(2, 0)]
    simulation.step(500)  # nothing of the action is left to be called
    assert simulation.graph.topics.publishers(f"{ACTION}/status") == []


OF_ROS_2 = {
    "type": "joint_trajectory_controller/JointTrajectoryController",
    "joints": ["joint1", "joint2"],
    "command_interfaces": ["effort"],
    "state_interfaces": ["position", "velocity"],
    "gains": {"joint1": GAINS, "joint2": GAINS},
    "constraints": {"stopped_velocity_tolerance": 0.05, "joint1": {"goal": 0.05}, "joint2": {"goal": 0.05}},
}


@pytest.fixture
def ros2_simulation() -> Simulation:
    simulation = Simulation(ground=False, engine="plain")
    add(simulation, "cart", cart(joints=2), {"arm": OF_ROS_2})
    simulation.step(1)
    return simulation


def test_a_goal_of_the_controller_of_ros_2_succeeds_near_its_end(ros2_simulation: Simulation) -> None:
    found = results(ros2_simulation)
    send(ros2_simulation, 0.5, -0.3)
    ros2_simulation.step(2000)
    assert found == [(3, 0)]
    joints = [joint.handle.position for joint in ros2_simulation.robots.get("cart").hardware.driven()]
    assert joints == pytest.approx([0.5, -0.3], abs=0.05)


def test_a_reset_aborts_the_goal_of_the_controller_of_ros_2_and_a_new_one_is_followed(
    ros2_simulation: Simulation,
) -> None:
    found = results(ros2_simulation)
    send(ros2_simulation, 0.5, -0.3)
    ros2_simulation.step(500)
    ros2_simulation.call("/gazebo/reset_simulation")
    assert found == [(4, -1)]
    send(ros2_simulation, 0.2, 0.2)
    ros2_simulation.step(2000)
    assert found[1:] == [(3, 0)]


def test_positions_of_the_controller_of_ros_2_are_reached_one_cycle_later() -> None:
    """The command is that of the next update, and the joint is there when it comes."""
    simulation = Simulation(ground=False, engine="plain")
    own = {**OF_ROS_2, "command_interfaces": ["position"], "gains": {}}
    add(simulation, "a", arm(("prismatic", "prismatic"), interface="Position"), {"arm": own})
    states: list[dict[str, Any]] = []
    simulation.graph.topics.subscribe("/a/arm/controller_state", None, "/client", states.append)
    simulation.step(1)
    simulation.publish("/a/arm/joint_trajectory", trajectory(0.5, -0.3))
    simulation.step(1000)
    moving = states[-900:-10]
    assert all(state["error"]["positions"] == pytest.approx([0.0, 0.0], abs=1e-6) for state in moving)
    t = 0.5  # a cubic at rest at both ends is half-way in the middle
    found = next(state for state in states if state["reference"]["time_from_start"]["nsecs"] == t * 1e9)
    assert found["feedback"]["positions"] == pytest.approx([0.25, -0.15], abs=1e-4)


def test_a_latched_command_from_before_the_load_does_no_harm() -> None:
    simulation = Simulation(ground=False, engine="plain")
    commands = {
        "arm": ("trajectory_msgs/JointTrajectory", trajectory(0.5, 0.5), FOLLOWER),
        "group": (
            "std_msgs/Float64MultiArray",
            {"data": [1.0]},
            {
                "type": "effort_controllers/JointGroupPositionController",
                "joints": ["joint1"],
                "joint1": {"pid": GAINS},
            },
        ),
        "one": (
            "std_msgs/Float64",
            {"data": 1.0},
            {"type": "effort_controllers/JointPositionController", "joint": "joint1", "pid": GAINS},
        ),
    }
    for name, (kind, message, _) in commands.items():
        publisher = simulation.graph.topics.advertise(f"/cart/{name}/command", kind, "/early", latch=True)
        publisher.publish(msgs.check(kind, message))
    simulation.spawn(cart(joints=2), "cart")
    for name, (_, _, parameters) in commands.items():
        simulation.parameters.set(f"/cart/{name}", parameters)
        assert simulation.call("/cart/controller_manager/load_controller", {"name": name})["ok"]


def test_the_cart_goes_where_its_odometry_says() -> None:
    simulation = Simulation(engine="plain")
    own = yaml.safe_load((ROOT / "config" / "cart_control.yaml").read_text(encoding="utf-8"))["cart"]
    add(simulation, "cart", description.load("cart", {"drive": "controller"}).xml, own)
    simulation.step(1)
    told: list[dict[str, Any]] = []
    simulation.graph.topics.subscribe("/cart/base_controller/odom", None, "/client", told.append)
    simulation.publish("/cart/base_controller/cmd_vel", {"linear": {"x": 0.5}, "angular": {"z": 0.3}})
    simulation.step(460)
    place = told[-1]["pose"]["pose"]["position"]
    assert told[-1]["twist"]["twist"]["angular"]["z"] == pytest.approx(0.3, abs=0.01)
    pose = simulation.call("/gazebo/get_model_state", {"model_name": "cart"})["pose"]["position"]
    assert place["x"] > 0.06
    assert (place["x"], place["y"]) == pytest.approx((pose["x"], pose["y"]), abs=0.02)
    assert pose["z"] == pytest.approx(0.0, abs=0.001)


@needs_numba
def test_both_engines_give_the_same_bits() -> None:
    def scene(simulation: Simulation) -> None:
        group = {"type": "effort_controllers/JointGroupEffortController", "joints": ["joint3"]}
        states = {"states": {"type": STATES, "publish_rate": 50}}
        add(simulation, "cart", arm(), states | {"arm": FOLLOWER, "group": group})
        simulation.step(10)
        for topic in ("state", "follow_joint_trajectory/feedback", "follow_joint_trajectory/result"):
            simulation.heard.listen(f"/cart/arm/{topic}")  # type: ignore[attr-defined]
        for k in range(4):
            send(simulation, 0.5 * (-1) ** k, 0.1 * k)
            simulation.publish("/cart/group/command", {"data": [0.3 * k]})
            simulation.step(700)

    def played(scene: Scene, engine: str) -> Any:
        left, simulation = play(scene, engine)
        assert str(simulation.engine) == engine
        return left

    assert played(scene, "compiled") == played(scene, "plain")
