"""Putting one robot together: paper, body, hardware, controller manager, services; and taking it apart.

Each thing that is brought up leaves its undoing on a stack, so a failure half-way and a deletion are the same path.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from slidectl import names
from slidectl.control.duration import from_seconds
from slidectl.control.manager import ControllerManager
from slidectl.control.node import Message
from slidectl.description.gazebo_tags import SIM_TYPES
from slidectl.description.robot import ControlPlugin, Robot
from slidectl.errors import BadFile
from slidectl.physics import World
from slidectl.physics.body import Body
from slidectl.physics.robot_hw import MujocoRobotHW
from slidectl.simulation.cycle import ControlCycle
from slidectl.simulation.loop import Loop
from slidectl.simulation.manager_services import ManagerServices
from slidectl.simulation.node import GraphNode

if TYPE_CHECKING:
    from slidectl.simulation.compiled.seat import Seat

Pose = tuple[tuple[float, float, float], tuple[float, float, float, float]]
"""Position in m, and quaternion x y z w."""
ORIGIN: Pose = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
DESCRIPTION = "robot_description"
_SEVERITIES = {"wrong": "warn", "ignored": "warn", "converted": "info"}


class ControlParts:
    """What runs in a robot's cycle."""

    hardware: MujocoRobotHW
    manager: ControllerManager
    cycle: ControlCycle


class SpawnedRobot:
    """One robot in the world with all that belongs to it. `taken` gives everything back, the last first.

    `parts` are for whoever runs the cycles. Everybody else comes in by `hardware`, `manager`, `cycle` or a callback of
    the node, so that those who run the cycles hear of it before.
    """

    def __init__(self, name: str, namespace: str, paper: Robot, xml: str, node: GraphNode) -> None:
        self.name = name
        self.namespace = namespace
        self.paper = paper
        self.xml = xml
        self.node = node
        self.taken = ExitStack()
        self.body: Body
        self.parts = ControlParts()
        self.services: ManagerServices
        self.seat: Seat | None = None
        """Where it is in the tables of the compiled cycle."""

    def watch_entries(self, callback: Callable[[], None]) -> None:
        """Call back before anybody outside of the cycle looks at the robot's control, or changes it."""
        self.node.before_entry = callback

    @property
    def hardware(self) -> MujocoRobotHW:
        """The joints as controllers see them."""
        self.node.before_entry()
        return self.parts.hardware

    @property
    def manager(self) -> ControllerManager:
        """The controllers."""
        self.node.before_entry()
        return self.parts.manager

    @property
    def cycle(self) -> ControlCycle:
        """Its part of each cycle of the world."""
        self.node.before_entry()
        return self.parts.cycle

    @property
    def emergency_stop(self) -> bool:
        """True: efforts and velocities are 0, positions are held. Controllers go on; its end starts them anew."""
        return self.parts.cycle.emergency_stop

    @emergency_stop.setter
    def emergency_stop(self, stopped: bool) -> None:
        self.cycle.emergency_stop = self.hardware.estop = stopped

    def look(self) -> None:
        """Read the joints outside of a cycle: after the world was changed, and before the first cycle."""
        self.hardware.read(self.node.now_ns(), 0.0)

    def __repr__(self) -> str:
        return f"SpawnedRobot({self.name!r}, {self.namespace!r})"


Companion = Callable[[SpawnedRobot], Callable[[], None]]
"""Something that every robot gets beside its controllers (a state publisher, say); what it returns takes it back."""


def assemble(robot: SpawnedRobot, world: World, loop: Loop, pose: Pose, companions: list[Companion]) -> None:
    """Bring the robot up in `world`.

    Raises:
        SlidectlError: it cannot be; then nothing of it is left behind.
    """
    plugin = robot.paper.plugin or ControlPlugin()
    _check_hardware_type(plugin)
    with ExitStack() as stack:
        stack.callback(robot.node.shutdown)
        _put_description(robot, loop, stack)
        robot.body = world.attach(robot.paper, robot.name, pose)
        stack.callback(world.detach, robot.name)
        parts = robot.parts
        parts.hardware = MujocoRobotHW(world, robot.body, robot.paper, robot.node, robot.namespace)
        robot.look()
        parts.manager = ControllerManager(parts.hardware, robot.node)
        parts.cycle = ControlCycle(parts.hardware, parts.manager, _control_period(plugin, loop.step_ns, robot))
        robot.services = ManagerServices(parts.manager, robot.node, robot.look, loop)
        _subscribe_emergency_stop(robot, plugin)
        for companion in companions:
            stack.callback(companion(robot))
        robot.taken = stack.pop_all()


def report(robot: SpawnedRobot) -> None:
    """What became of the tags of the robot's file, on the log."""
    for notice in robot.paper.report:
        if notice.verdict in _SEVERITIES:
            robot.node.log(_SEVERITIES[notice.verdict], f"{robot.name}: {notice}")


def _put_description(robot: SpawnedRobot, loop: Loop, stack: ExitStack) -> None:
    parameters = loop.graph.parameters
    name = names.join(robot.namespace, DESCRIPTION)
    parameters.set(name, robot.xml)

    def take_back() -> None:
        if parameters.has(name):
            parameters.delete(name)

    stack.callback(take_back)


def _check_hardware_type(plugin: ControlPlugin) -> None:
    if plugin.robot_sim_type not in SIM_TYPES:
        raise BadFile(
            f"<robotSimType> {plugin.robot_sim_type!r} is no simulated hardware; there is {SIM_TYPES[0]}",
            DESCRIPTION,
            plugin.line,
        )


def _control_period(plugin: ControlPlugin, step_ns: int, robot: SpawnedRobot) -> int:
    if plugin.control_period is None:
        return step_ns
    period_ns = from_seconds(plugin.control_period)
    comparison = f"controlPeriod {plugin.control_period:g} s, the simulation's step {step_ns * 1e-9:g} s"
    if period_ns < step_ns:
        robot.node.log("error", f"{robot.name}: controllers cannot run faster than the simulation: {comparison}")
    elif period_ns > step_ns:
        robot.node.log("warn", f"{robot.name}: controllers run slower than the simulation: {comparison}")
    return period_ns


def _subscribe_emergency_stop(robot: SpawnedRobot, plugin: ControlPlugin) -> None:
    if plugin.estop_topic is None:
        return

    def take(message: Message) -> None:
        robot.emergency_stop = message["data"]

    robot.node.subscribe(plugin.estop_topic, "std_msgs/Bool", take)
