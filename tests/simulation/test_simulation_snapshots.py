"""Snapshots: going on from one gives the same bits as never having stopped, here, later and in another simulation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
import yaml
from engine_scenes import EFFORT, GAINS, POSITION, VELOCITY, add, arm
from engine_scenes import vars_of as numbers_of
from sim_robots import STATES
from test_simulation_compiled_controllers import FOLLOWERS, JOINTS, random_trajectory
from test_simulation_force_torque import IMU, PLUGIN
from test_simulation_force_torque import arm as tool_arm

from slidectl import Simulation, description
from slidectl.control import registry
from slidectl.simulation import snapshot_files
from slidectl.simulation.compiled import object_file
from slidectl.simulation.snapshots import put
from slidectl.simulation.topics import TopicSubscription

CONFIG = Path(__file__).parent.parent.parent / "config"
ENGINES = ["plain", *(["compiled"] if object_file.is_possible() else [])]
Build = Callable[[Simulation], None]
Act = Callable[[Simulation, Random], None]
"""Builds a scene; and lets something happen in it."""


def made(engine: str) -> Simulation:
    simulation = Simulation(engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    return simulation


def everything(simulation: Simulation) -> list[Any]:
    """All that the future depends on, to the bit."""
    data = simulation.world.data
    simulation.loop.settle()
    left: list[Any] = [simulation.time_ns, simulation.cycles, simulation.parameters.tree()]
    left += [array.tobytes() for array in (data.qpos, data.qvel, data.qfrc_applied, data.qacc_warmstart)]
    for robot in simulation.robots:
        if robot.is_controlled:
            left += [numbers_of(joint.handle) for joint in robot.hardware.driven()]
            left += [numbers_of(robot.manager.get(name)) for name in robot.manager.names()]
            left += [robot.manager.list(), robot.emergency_stop]
    return left


def future(simulation: Simulation, act: Act, topics: list[str]) -> list[Any]:
    """What is published next, and what is left then."""
    heard: list[tuple[str, str]] = []

    def hear(topic: str) -> TopicSubscription:
        take = lambda message: heard.append((topic, repr(message)))  # noqa: E731
        return simulation.graph.topics.subscribe(topic, None, "/listener", take)

    subscriptions, dice = list(map(hear, topics)), Random(7)
    heard.clear()
    for _ in range(12):
        act(simulation, dice)
        simulation.step(dice.choice((1, 17, 60, 150)))
    for subscription in subscriptions:
        subscription.close()
    return [everything(simulation), heard]


# -- scenes ------------------------------------------------------------------------------------------------------------


def publishing(commands: dict[str, Callable[[Random], dict[str, Any]]]) -> Act:
    """One of these messages."""

    def act(simulation: Simulation, dice: Random) -> None:
        topic = dice.choice(list(commands))
        simulation.publish(topic, commands[topic](dice))

    return act


def number(dice: Random) -> dict[str, Any]:
    return {"data": dice.uniform(-1.5, 1.5)}


def numbers(dice: Random) -> dict[str, Any]:
    return {"data": [dice.uniform(-1.5, 1.5) for _ in JOINTS]}


def one_each(interface: str, types: list[str], gains: bool = True) -> tuple[Build, Act]:
    """A controller of a joint each; joints of positions and velocities are driven by PIDs, or by motors."""

    def build(simulation: Simulation) -> None:
        own = dict.fromkeys(JOINTS, GAINS) if gains else {}
        simulation.parameters.set("/a/gazebo_ros_control/pid_gains", own)
        goals = {f"goal{k}": {"type": kind, "joint": f"joint{k}", "pid": GAINS} for k, kind in enumerate(types, 1)}
        add(
            simulation,
            "a",
            arm(interface=interface, safety=gains),
            {"states": {"type": STATES, "publish_rate": 80}} | goals,
        )

    return build, publishing({f"/a/goal{k}/command": number for k in range(1, len(types) + 1)})


def group(kind: str) -> tuple[Build, Act]:
    own = {"type": kind, "joints": JOINTS} | {joint: {"pid": GAINS} for joint in JOINTS if "Position" in kind}
    xml = arm(interface=kind.partition("_")[0].title())
    return lambda simulation: add(simulation, "a", xml, {"group": own}), publishing({"/a/group/command": numbers})


def following(kind: str) -> tuple[Build, Act]:
    """Goals, trajectories and cancellations in the midst of others; the joints may have left their path."""
    prefix = {"pos_vel": "position", "pos_vel_acc": "position"}.get(kind, kind)
    interface = {"pos_vel": "PosVel", "pos_vel_acc": "PosVelAcc"}.get(kind, kind.title())
    own = {"type": f"{kind}_controllers/JointTrajectoryController", "joints": JOINTS, **FOLLOWERS[prefix]}
    own |= {"allow_partial_joints_goal": True, "constraints": {"goal_time": 0.2, "stopped_velocity_tolerance": 0.0}}

    def act(simulation: Simulation, dice: Random) -> None:
        trajectory = random_trajectory(dice)
        tolerances = [{"name": joint, "position": dice.choice((0.05, 9.0))} for joint in JOINTS]
        action = "/a/arm/follow_joint_trajectory"
        what = dice.random()
        if what < 0.6:
            simulation.publish(f"{action}/goal", {"goal": {"trajectory": trajectory, "goal_tolerance": tolerances}})
        elif what < 0.9:
            simulation.publish("/a/arm/command", trajectory)
        else:
            simulation.publish(f"{action}/cancel", {})

    return lambda simulation: add(simulation, "a", arm(interface=interface), {"arm": own}), act


def gripping(interface: str) -> tuple[Build, Act]:
    own: dict[str, Any] = {"type": f"{interface.lower()}_controllers/GripperActionController", "joint": "joint1"}
    own |= {"gains": {"joint1": {"p": 90.0, "d": 25.0}}, "stall_timeout": 0.1, "goal_tolerance": 0.05}

    def goal(dice: Random) -> dict[str, Any]:
        return {
            "goal": {"command": {"position": dice.choice((0.4, -0.4, 4.0)), "max_effort": dice.choice((3.0, 25.0))}}
        }

    xml = arm(("prismatic",), interface=interface)
    return lambda simulation: add(simulation, "a", xml, {"gripper": own}), publishing(
        {"/a/gripper/gripper_cmd/goal": goal}
    )


def shipped_model(
    model: str, commands: dict[str, Callable[[Random], dict[str, Any]]], **arguments: str
) -> tuple[Build, Act]:
    """A shipped model on the ground, with all controllers of its configuration."""

    def build(simulation: Simulation) -> None:
        own = yaml.safe_load((CONFIG / f"{model}_control.yaml").read_text())[model]
        add(simulation, model, description.load(model, arguments, description.Packages()).xml, own)

    return build, publishing(commands)


def twist(dice: Random) -> dict[str, Any]:
    return {"linear": {"x": dice.uniform(-1, 1)}, "angular": {"z": dice.choice((0.0, 0.9))}}


def axles(dice: Random) -> dict[str, Any]:
    return {
        "speed": dice.uniform(0.1, 0.5),
        "front_steering_angle": dice.uniform(-0.5, 0.5),
        "rear_steering_angle": 0.1,
    }


def sensing() -> tuple[Build, Act]:
    """The controllers measure, in an update, what the last step computed; a force pushes the tool meanwhile."""
    rate = {"publish_rate": 400}
    own: dict[str, dict[str, Any]] = {
        "imu": {"type": "imu_sensor_controller/ImuSensorController", **rate},
        "wrist_wrench": {"type": "force_torque_sensor_controller/ForceTorqueSensorController", **rate},
        "push": {"type": EFFORT, "joint": "slide"},
    }

    def act(simulation: Simulation, dice: Random) -> None:
        simulation.publish("/a/push/command", number(dice))
        force = (dice.uniform(-5, 5), 0.0, 2.0)
        simulation.world.add_wrench("a", "tool", force, (0.0, 0.0, 0.1), simulation.time_ns, 40_000_000)

    xml = tool_arm(PLUGIN.format(rate=50, noise=0.2) + IMU, mount='type="revolute"')
    return lambda simulation: add(simulation, "a", xml, own), act


def ackermann() -> tuple[Build, Act]:
    xml = arm(("continuous", "revolute"), interface="Velocity")
    own = {
        "type": "ackermann_steering_controller/AckermannSteeringController",
        "rear_wheel": "joint1",
        "front_steer": "joint2",
        "wheel_separation_h": 0.4,
        "wheel_radius": 0.1,
        "pose_covariance_diagonal": [0.001] * 6,
        "twist_covariance_diagonal": [0.001] * 6,
    }
    head, tail = xml.rsplit("VelocityJointInterface", 1)
    steered = f"{head}PositionJointInterface{tail}"
    return lambda simulation: add(simulation, "a", steered, {"base": own}), publishing({"/a/base/cmd_vel": twist})


def plugin_drive(drive: str) -> tuple[Build, Act]:
    """A model that drives by itself: its wheels measure their way, or it glides."""
    glides = """<robot name="box"><link name="base"><inertial><mass value="2"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
      <gazebo><plugin name="glide" filename="libgazebo_ros_planar_move.so"/></gazebo></robot>"""

    def build(simulation: Simulation) -> None:
        wheels = description.load("cart", {"drive": "plugin"}, description.Packages()).xml
        simulation.spawn(wheels if drive == "wheels" else glides, "a")

    return build, publishing({"/cart/cmd_vel" if drive == "wheels" else "/a/cmd_vel": twist})


def stopped() -> tuple[Build, Act]:
    """Emergency stops and releases, switches, another timestep's worth of parameters."""
    build, _ = one_each("Position", ["position_controllers/JointPositionController"] * 3)

    def act(simulation: Simulation, dice: Random) -> None:
        simulation.publish(f"/a/goal{dice.choice('123')}/command", number(dice))
        simulation.call("/slidectl/estop", {"names": ["a"], "stop": dice.random() < 0.5})
        simulation.parameters.set("/a/gazebo_ros_control/pid_gains/joint2/p", dice.uniform(1, 80))
        goal = f"goal{dice.choice('123')}"
        request = {"start_controllers": [goal], "stop_controllers": [goal], "strictness": 1}
        simulation.call("/a/controller_manager/switch_controller", request)

    return build, act


SCENES: dict[str, tuple[Build, Act]] = {
    "efforts": one_each("Effort", [POSITION, VELOCITY, EFFORT]),
    "velocities": one_each(
        "Velocity", ["velocity_controllers/JointPositionController", "velocity_controllers/JointVelocityController"]
    ),
    "velocities of motors": one_each("Velocity", ["velocity_controllers/JointVelocityController"] * 3, gains=False),
    "positions": one_each("Position", ["position_controllers/JointPositionController"] * 3),
    "positions of motors": one_each("Position", ["position_controllers/JointPositionController"] * 3, gains=False),
    "effort group": group("effort_controllers/JointGroupPositionController"),
    "forwarding effort group": group("effort_controllers/JointGroupEffortController"),
    "velocity group": group("velocity_controllers/JointGroupVelocityController"),
    "position group": group("position_controllers/JointGroupPositionController"),
    "effort trajectory": following("effort"),
    "velocity trajectory": following("velocity"),
    "position trajectory": following("position"),
    "pos-vel trajectory": following("pos_vel"),
    "pos-vel-acc trajectory": following("pos_vel_acc"),
    "effort gripper": gripping("Effort"),
    "position gripper": gripping("Position"),
    "a cart on the ground": shipped_model("cart", {"/cart/base_controller/cmd_vel": twist}, drive="controller"),
    "a car on the ground": shipped_model(
        "car", {"/car/base_controller/cmd_vel": twist, "/car/base_controller/cmd_four_wheel_steering": axles}
    ),
    "ackermann": ackermann(),
    "sensors": sensing(),
    "wheels of a model": plugin_drive("wheels"),
    "a model that glides": plugin_drive("glides"),
    "stops and switches": stopped(),
}


def test_every_shipped_controller_is_in_a_scene() -> None:
    seen = set()
    for build, _ in SCENES.values():
        simulation = made("plain")
        build(simulation)
        for robot in simulation.robots:
            seen |= {one["type"] for one in robot.manager.list()} if robot.is_controlled else set()
    shipped = {kind for kind in registry.types() if registry.find(kind).__module__.startswith("slidectl.")}
    assert shipped <= seen


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("scene", SCENES)
def test_going_on_from_a_snapshot_gives_the_same_bits(scene: str, engine: str, tmp_path: Path) -> None:
    build, act = SCENES[scene]

    def begun() -> Simulation:
        simulation, dice = made(engine), Random(scene)
        build(simulation)
        for _ in range(8):
            act(simulation, dice)
            simulation.step(dice.choice((3, 41, 90)))
        return simulation

    one = begun()
    topics = [
        topic for topic in one.graph.topics.names() if topic.startswith(("/a/", "/car", "/tf")) and "image" not in topic
    ]
    topics = [topic for topic in topics if not topic.endswith(("/command", "/cmd_vel", "/goal", "/cancel"))]
    never_stopped = future(one, act, topics)

    one = begun()
    one.save("here")
    assert future(one, act, topics) == never_stopped
    one.load("here")
    assert future(one, act, topics) == never_stopped  # later in the same simulation
    for robot in one.robots:
        one.delete(robot.name)
    one.step(30)
    one.load("here")
    assert future(one, act, topics) == never_stopped  # with robots that were made again
    file = str(tmp_path / "here.snapshot")
    snapshot_files.write(one.snapshots.get("here"), file)
    other = made(engine)
    put(other, snapshot_files.read(file))
    assert future(other, act, topics) == never_stopped  # in another simulation
