"""Worlds for both engines: a scene is played on each, and everything that can be seen is compared. Helpers."""

from __future__ import annotations

import struct
from array import array
from collections import deque
from collections.abc import Callable
from random import Random
from typing import Any

from sim_robots import STATES, cart

from slidectl import fault_kinds
from slidectl.control.controller_interface import Controller
from slidectl.control.hardware_interface import EffortJointInterface, PositionJointInterface
from slidectl.control.node_handle import NodeHandle
from slidectl.control.registry import controller
from slidectl.errors import SlidectlError
from slidectl.simulation import Simulation
from slidectl.simulation.clock import NEVER

POSITION = "effort_controllers/JointPositionController"
VELOCITY = "effort_controllers/JointVelocityController"
EFFORT = "effort_controllers/JointEffortController"
GAINS = {"p": 40.0, "i": 3.0, "d": 4.0, "i_clamp_min": -2.0, "i_clamp_max": 5.0}

KINDS = ("prismatic", "revolute", "continuous")

Scene = Callable[[Simulation], None]


def arm(
    kinds: tuple[str, ...] = ("prismatic", "revolute", "continuous"),
    safety: bool = False,
    plugin: str = "",
    interface: str = "Effort",
) -> str:
    """Joints of several kinds, each between the world and a link of its own; nothing touches anything."""
    parts = "".join(_joint(number + 1, kind, safety) for number, kind in enumerate(kinds))
    parts = parts.replace("EffortJointInterface", f"{interface}JointInterface")
    block = f'<gazebo><plugin name="c" filename="libgazebo_ros_control.so">{plugin}</plugin></gazebo>'
    return f'<robot name="arm"><link name="world"/>{parts}{block}</robot>'


def _joint(number: int, kind: str, safety: bool) -> str:
    bounds = '<limit lower="-3.0" upper="2.5" effort="30" velocity="4"/>'
    if kind == "continuous":
        bounds = '<limit effort="30" velocity="9"/>'
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="1" k_position="20" k_velocity="15"/>'
    axis = "1 0 0" if kind == "prismatic" else "0 1 0"
    return f"""
  <joint name="joint{number}" type="{kind}"><parent link="world"/><child link="part{number}"/>
    <origin xyz="0 {number} 3"/><axis xyz="{axis}"/><dynamics damping="0.7"/>{bounds}{soft if safety else ""}</joint>
  <link name="part{number}"><inertial><origin xyz="0.2 0 0.1"/><mass value="1.5"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="t{number}"><type>transmission_interface/SimpleTransmission</type>
    <joint name="joint{number}"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
    <actuator name="m{number}"/></transmission>"""


def add(simulation: Simulation, name: str, xml: str, controllers: dict[str, dict[str, Any]]) -> None:
    """A robot with these controllers running."""
    for controller_name, parameters in controllers.items():
        simulation.parameters.set(f"/{name}/{controller_name}", parameters)
    simulation.spawn(xml, name)
    for controller_name in controllers:
        assert simulation.call(f"/{name}/controller_manager/load_controller", {"name": controller_name})["ok"]
    switch(simulation, name, start=list(controllers))


def switch(simulation: Simulation, name: str, **request: Any) -> None:
    """Ask for a switch; the answer comes when it comes."""
    simulation.graph.services.call(
        f"/{name}/controller_manager/switch_controller",
        {f"{key}_controllers": value for key, value in request.items()} | {"strictness": 1},
    )


def usual() -> dict[str, dict[str, Any]]:
    """One controller of each kind that runs compiled: states, two positions, a velocity."""
    return {
        "states": {"type": STATES, "publish_rate": 80},
        "one": {"type": POSITION, "joint": "joint1", "pid": GAINS},
        "two": {"type": POSITION, "joint": "joint2", "pid": GAINS | {"antiwindup": True}},
        "three": {"type": VELOCITY, "joint": "joint3", "pid": GAINS},
    }


def add_driven(simulation: Simulation, name: str, interface: str, safety: bool = False, gains: bool = True) -> None:
    """A robot whose joints take positions or velocities, with PIDs of the hardware unless it has none."""
    for joint in ("joint1", "joint2", "joint3"):
        own = GAINS if gains else {}
        simulation.parameters.set(f"/{name}/gazebo_ros_control/pid_gains/{joint}", own)
        simulation.parameters.set(f"/{name}/joint_limits/{joint}", {"has_acceleration_limits": joint != "joint1"})
        simulation.parameters.set(f"/{name}/joint_limits/{joint}/max_acceleration", 20.0)
    kind = f"{interface.lower()}_controllers/Joint{interface}Controller"
    goals = {f"goal{k}": {"type": kind, "joint": f"joint{k}"} for k in (1, 2, 3)}
    states = {"states": {"type": STATES, "publish_rate": 100}}
    add(simulation, name, arm(safety=safety, interface=interface), states | goals)


class Heard:
    """All messages on topics, in the order of their coming."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.messages: list[tuple[str, str]] = []

    def listen(self, topic: str) -> None:
        """From now on, as a client of the daemon does: it sees nothing but messages."""
        topics = self._simulation.graph.topics
        topics.subscribe(topic, None, "/listener", lambda message: self.messages.append((topic, repr(message))))


def play(scene: Scene, engine: str, driven: bool = False) -> tuple[list[Any], Simulation]:
    """What is left of a scene: the state of physics, handles and PIDs, time and the past, and all messages."""
    simulation = Simulation(ground=False, engine=engine)
    simulation.driven = driven
    if engine == "compiled":
        simulation.engine.complete()
    heard = Heard(simulation)
    simulation.heard = heard  # type: ignore[attr-defined]
    scene(simulation)
    data = simulation.world.data
    arrays = [data.qpos, data.qvel, data.qfrc_applied, data.qacc_warmstart]
    left: list[Any] = [simulation.time_ns, simulation.cycles, [array.tobytes() for array in arrays], heard.messages]
    for robot in simulation.robots:
        places = simulation.world.robot(robot.name).joints.values()
        left += [simulation.loop.history.of_joint(place.qpos, place.dof, 0, NEVER).tobytes() for place in places]
        left += [vars_of(joint.handle) for joint in robot.hardware.driven()]
        left += [vars_of(robot.manager.get(name)) for name in robot.manager.names()]
        left.append(robot.manager.list())
    return left, simulation


def vars_of(thing: Any) -> Any:
    """All numbers of an object, and of what it consists of, to the bit."""
    names = [
        *getattr(thing, "__dict__", {}),
        *(name for cls in type(thing).__mro__ for name in getattr(cls, "__slots__", ())),
    ]
    found = {name: _seen(getattr(thing, name)) for name in names if name not in ("observer", "segment", "next_s")}
    return {name: value for name, value in found.items() if value is not None}


def _seen(value: Any) -> Any:
    if isinstance(value, int | float):
        return _bits(value)
    if isinstance(value, list | tuple | array | deque):
        return [_seen(one) for one in value]
    is_part = type(value).__module__.startswith(("slidectl.control.controllers", "slidectl.control.pid"))
    return vars_of(value) if is_part else None


def _bits(value: float) -> bytes:
    return struct.pack("<d", value)


@controller("tests/Swinger")
class Swinger(Controller[EffortJointInterface]):
    """In Python only: an effort that depends on the state and its own memory; tells of it now and then."""

    interface_type = EffortJointInterface

    def init(self, interface: EffortJointInterface, node: NodeHandle) -> None:
        self.joint = interface.get_handle(node.get_param("joint"))
        self.sum = 0.0
        self.target = 0.5
        self.fails_at = node.get_param("fails_at", -1)
        self.told = node.advertise("told", "std_msgs/Float64")
        node.subscribe("target", "std_msgs/Float64", self.take)

    def take(self, message: dict[str, Any]) -> None:
        self.target = message["data"]
        self.joint.command *= 0.5

    def update(self, time_ns: int, period_s: float) -> None:
        self.sum += period_s * (self.target - self.joint.position)
        self.joint.command = 9.0 * (self.target - self.joint.position) - self.joint.velocity + self.sum
        if time_ns == self.fails_at:
            raise ZeroDivisionError("a fault of the user's")
        if time_ns % 7_000_000 == 0 and self.told.wanted:
            self.told.publish({"data": self.joint.effort})
            self.joint.command += 0.25


@controller("tests/Stepper")
class Stepper(Controller[PositionJointInterface]):
    """In Python only: a position that steps to and fro, from where the joint is."""

    interface_type = PositionJointInterface

    def init(self, interface: PositionJointInterface, node: NodeHandle) -> None:
        self.joint = interface.get_handle(node.get_param("joint"))

    def update(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002
        if time_ns % 50_000_000 == 0:
            self.joint.command = self.joint.position + (0.3 if time_ns % 100_000_000 else -0.3)


def mixed() -> dict[str, dict[str, Any]]:
    """A controller in Python between compiled ones."""
    return {
        "states": {"type": STATES, "publish_rate": 80},
        "one": {"type": POSITION, "joint": "joint1", "pid": GAINS},
        "swing": {"type": "tests/Swinger", "joint": "joint2"},
        "three": {"type": EFFORT, "joint": "joint3"},
    }


def at_random(seed: int, things: int = 100) -> Scene:
    """Four robots, and so many things that happen to them."""

    def scene(simulation: Simulation) -> None:
        dice = Random(seed)
        add(simulation, "a", arm(), usual())
        add(simulation, "b", arm(safety=dice.random() < 0.5), mixed())
        add(simulation, "c", cart(), {"effort": {"type": EFFORT, "joint": "joint1"}})
        add_driven(simulation, "d", dice.choice(("Position", "Velocity")), safety=dice.random() < 0.5)
        for _ in range(things):
            happen(simulation, dice)
            simulation.step(dice.choice((1, 3, 17, 60, 300)))

    return scene


def happen(simulation: Simulation, dice: Random, is_kept: bool = False) -> None:
    """One thing. What is refused is refused by both engines. `is_kept`: one that is in a snapshot."""
    robot = dice.choice("abcd")
    things: list[Callable[[], object]] = [
        lambda: simulation.publish(dice.choice(_COMMANDS), {"data": dice.uniform(-3, 3)}, "std_msgs/Float64"),
        lambda: simulation.publish("/b/swing/target", {"data": dice.uniform(-1, 1)}, "std_msgs/Float64"),
        lambda: simulation.parameters.set(f"/a/{dice.choice(('one', 'two', 'three'))}/pid/p", dice.uniform(1, 80)),
        lambda: switch(simulation, robot, stop=[dice.choice(_NAMES)], start=[dice.choice(_NAMES)]),
        lambda: simulation.world.add_joint_force("a", "joint1", dice.uniform(-5, 5), simulation.time_ns, 30_000_000),
        lambda: simulation.world.set_joint(robot, "joint1", dice.uniform(-1, 1)),
        lambda: simulation.reset_world() if dice.random() < 0.2 else None,
        lambda: simulation.reset_simulation() if dice.random() < 0.1 else None,
        lambda: _come_or_go(simulation),
        lambda: _go_wrong(simulation, dice),
        lambda: _go_wrong(simulation, dice),
        lambda: simulation.faults.remove() if dice.random() < 0.3 else None,
    ]
    if not is_kept:
        things += [
            lambda: simulation.heard.listen(dice.choice(TOPICS)),  # type: ignore[attr-defined]
            lambda: simulation.graph.timers.after(dice.randrange(1, 50_000_000), lambda: _bump(simulation)),
        ]
    try:
        dice.choice(things)()
    except SlidectlError as error:
        simulation.heard.messages.append(("refused", str(error)))  # type: ignore[attr-defined]


_COMMANDS = (
    "/a/one/command",
    "/a/two/command",
    "/a/three/command",
    "/b/one/command",
    "/b/three/command",
    "/c/effort/command",
    "/d/goal1/command",
    "/d/goal2/command",
    "/d/goal3/command",
)
TOPICS = (
    "/a/joint_states",
    "/b/joint_states",
    "/d/joint_states",
    "/a/one/state",
    "/a/three/state",
    "/b/one/state",
    "/b/swing/told",
    "/clock",
)
_NAMES = ("states", "one", "two", "three", "swing", "effort", "goal1", "goal2")


def _bump(simulation: Simulation) -> None:
    simulation.publish("/a/one/command", {"data": 0.1}, "std_msgs/Float64")


FAULT_OPTIONS = {
    "of": "all", "sd": 0.01, "bias": 0.05, "rate": 0.5, "step": 0.02, "delay": 0.013, "probability": 0.4,
    "limit": 1.5, "friction": 2.0, "damping": 3.0, "mass": 1.7, "at": (0.1, 0.2, -0.3), "force": (1.0, 2.0, 3.0),
    "torque": (0.1, 0.2, 0.0), "takes": 0.004,
}  # fmt: skip
"""A value for each option of a kind of fault."""
_FAULTY = {
    "joint": ("a/joint1", "a/joint2", "b/joint2", "c/joint1", "d/joint1"),
    "moving joint": ("a/joint1", "b/joint3", "c/joint1", "d/joint2"),
    "link": ("a/part1", "b/part2", "c/box1", "d/part3"),
    "controller": ("a/one", "a/two", "b/swing", "c/effort", "d/goal1"),
    "topic": ("/a/joint_states", "/a/one/command", "/b/swing/told", "/clock"),
}


def _go_wrong(simulation: Simulation, dice: Random) -> None:
    kind = dice.choice(sorted(fault_kinds.KINDS))
    start = simulation.time_ns / 1e9 + dice.choice((0.0, 0.02))
    options = {name: FAULT_OPTIONS[name] for name in fault_kinds.KINDS[kind].options}
    target = dice.choice(_FAULTY[fault_kinds.KINDS[kind].target])
    simulation.faults.add(target, kind, start, start + dice.uniform(0.001, 0.3), dice.randrange(9), **options)


def _come_or_go(simulation: Simulation) -> None:
    if "late" in simulation.robots:
        simulation.delete("late")
    else:
        add(simulation, "late", arm(("continuous",)), {"only": {"type": POSITION, "joint": "joint1", "pid": GAINS}})
