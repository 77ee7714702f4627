"""Putting one robot together: paper, body, hardware, controller manager, services; and taking it apart.

Each thing that is brought up leaves its undoing on a stack, so a failure half-way and a deletion are the same path.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack

from slidectl import names
from slidectl.control.controller_manager import ControllerManager
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.description.gazebo_tags import SIM_TYPES
from slidectl.description.robot import ControlPlugin, Robot
from slidectl.errors import BadFile
from slidectl.physics import EngineError, Overlap, World
from slidectl.physics.body import Body
from slidectl.physics.robot_hw import MujocoRobotHW
from slidectl.simulation.cycle import ControlCycle
from slidectl.simulation.loop import Loop
from slidectl.simulation.manager_services import ManagerServices
from slidectl.simulation.node import GraphNode

Pose = tuple[tuple[float, float, float], tuple[float, float, float, float]]
"""Position in m, and quaternion x y z w."""
ORIGIN: Pose = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
DESCRIPTION = "robot_description"
STANDING = 0.001
"""m. What is in something else by no more than this stands on it, or beside it."""
MOST_NAMED = 5
"""Robots, and pairs of links of each, that one spawn warns of."""
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
        self.caller = 0
        """The session id of the process that asked for it, 0 when nobody knows."""
        self.warnings: list[str] = []
        """What was wrong with the place at which it was spawned."""

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
        text = f"emergency stop is on: {self.name}; slidectl estop release ends it"
        self.node.caution = text if stopped else ""

    def look(self) -> None:
        """Read the joints outside of a cycle: after the world was changed, and before the first cycle."""
        self.hardware.read(self.node.now_ns(), 0.0)

    def __repr__(self) -> str:
        return f"SpawnedRobot({self.name!r}, {self.namespace!r})"


Companion = Callable[[SpawnedRobot], Callable[[], None]]
"""Something that every robot gets beside its controllers (a state publisher, say); what it returns takes it back."""


def assemble(robot: SpawnedRobot, world: World, loop: Loop, companions: list[Companion], undoing: ExitStack) -> None:
    """Bring up all that belongs to a robot whose body is in `world`. What takes it back goes on the stack `undoing`.

    Raises:
        SlidectlError: it cannot be.
    """
    undoing.callback(robot.node.shutdown)
    _put_description(robot, loop, undoing)
    parts, plugin = robot.parts, robot.paper.plugin or ControlPlugin()
    parts.hardware = MujocoRobotHW(world, robot.body, robot.paper, robot.node, robot.namespace)
    robot.look()
    parts.manager = ControllerManager(parts.hardware, robot.node)
    period_ns = _control_period(plugin, loop.step_ns, robot)
    parts.cycle = ControlCycle(parts.hardware, parts.manager, period_ns, loop.graph.clock.time_ns)
    robot.services = ManagerServices(parts.manager, robot.node, robot.look, loop)
    _subscribe_emergency_stop(robot, plugin)
    for companion in companions:
        undoing.callback(companion(robot))


def report(robot: SpawnedRobot) -> None:
    """What became of the tags of the robot's file, on the log."""
    for notice in robot.paper.report:
        if notice.verdict in _SEVERITIES:
            robot.node.log(_SEVERITIES[notice.verdict], f"{robot.name}: {notice}")


def warn_of_overlaps(robot: SpawnedRobot, world: World) -> None:
    """Say, and keep in `robot.warnings`, into what it was put: such bodies push each other away, or jam."""
    try:
        overlaps = world.overlaps(robot.name, STANDING)
    except EngineError:  # contacts beyond number: the first step says so
        return
    others: dict[str | None, list[Overlap]] = {}
    for overlap in overlaps:
        others.setdefault(overlap.robot, []).append(overlap)
    texts = [_in_ground(found) if other is None else _in_robot(other, found) for other, found in others.items()]
    if len(texts) > MOST_NAMED:
        texts[MOST_NAMED:] = [f"it was put into {len(texts) - MOST_NAMED} robots more"]
    for text in texts:
        robot.warnings.append(f"{robot.name}: {text}")
        robot.node.log("warn", robot.warnings[-1])


def _in_ground(found: list[Overlap]) -> str:
    links = _deepest([f"{overlap.link} {_millimetres(overlap)}" for overlap in found])
    height = math.ceil(found[0].depth * 1e3) * 1e-3
    return (
        f"it was put into the ground, which pushes it out or jams it: {links} deep;"
        f" {height:.3f} m higher it is free (--at X Y Z)"
    )


def _in_robot(other: str, found: list[Overlap]) -> str:
    pairs = _deepest([f"{overlap.link} in {other}::{overlap.other} {_millimetres(overlap)}" for overlap in found])
    return (
        f"it was put into the robot {other!r}, and the two push each other away or jam: {pairs} deep;"
        " give it another place (--at X Y Z)"
    )


def _deepest(pairs: list[str]) -> str:
    rest = len(pairs) - MOST_NAMED
    return ", ".join(pairs[:MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")


def _millimetres(overlap: Overlap) -> str:
    return f"{overlap.depth * 1e3:.0f} mm"


def _put_description(robot: SpawnedRobot, loop: Loop, stack: ExitStack) -> None:
    parameters = loop.graph.parameters
    name = names.join(robot.namespace, DESCRIPTION)
    before = parameters.get(name, None)
    parameters.set(name, robot.xml)

    def take_back() -> None:
        """What somebody else has set, the launch of a robot in the root most often, is there again."""
        if before is not None and parameters.get(name, None) == robot.xml:
            parameters.set(name, before)
        elif parameters.has(name):
            parameters.delete(name)

    stack.callback(take_back)


def check_hardware_type(paper: Robot) -> None:
    """Raises BadFile for a robot whose plugin asks for hardware that is not simulated."""
    plugin = paper.plugin or ControlPlugin()
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
