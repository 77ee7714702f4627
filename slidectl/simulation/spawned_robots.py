"""The robots of the world: spawned completely or not at all, deleted completely.

A robot is its description, body, hardware, controller manager and services. Each step of a spawn puts its cleanup on a
stack, so that a failed spawn and a deletion do the same. Requests of clients come through the services of `/gazebo`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import ClassVar

from slidectl import description, names
from slidectl.control.controller_manager import ControllerManager
from slidectl.control.duration import from_seconds, header_of
from slidectl.control.node_handle import Message
from slidectl.control.registry import ControllerTypes
from slidectl.control.user_classes import file_of, raised, watched_for, watched_hardware
from slidectl.description import source_note
from slidectl.description.gazebo_tags import TRANSMISSIONS
from slidectl.description.robot import ControlPlugin, Robot, check_position
from slidectl.description.ros2_control import start_positions
from slidectl.effects import Effect
from slidectl.errors import BadFile, Refused, UnknownName
from slidectl.physics import EngineError, Overlap, World
from slidectl.physics.attached_robot import AttachedRobot
from slidectl.physics.hulls import Hull, Hulls
from slidectl.physics.hulls import sources as mesh_sources
from slidectl.physics.robot_hw import MujocoRobotHW
from slidectl.physics.ros2_robot_hw import Ros2RobotHW
from slidectl.rotations import ORIGIN, Pose
from slidectl.simulation.clock import SECOND
from slidectl.simulation.cycle import ControlCycle
from slidectl.simulation.graph import GraphNode
from slidectl.simulation.loop import Loop
from slidectl.simulation.manager_services import ManagerServices
from slidectl.simulation.parameters import Parameters
from slidectl.simulation.ros2_manager_services import Ros2ManagerServices
from slidectl.simulation.topics import PeriodicTopic

DESCRIPTION = "robot_description"
ACTUATOR_RATE_HZ = 50
UPDATE_RATE = "update_rate"
"""The parameter in a namespace of ROS 2 that sets how often controllers run, Hz: that of its controller manager."""
DEFAULT_UPDATE_RATE_HZ = 100
RESERVED = ("world", "map")
"""Names that gazebo_ros takes for the world wherever a model is possible."""
STANDING = 0.001
"""m. An overlap up to this depth is normal contact, such as standing on the ground."""
MOST_NAMED = 5
"""The most robots, and pairs of links of each, in the warning of one spawn."""
_SEVERITIES = {"wrong": "warn", "ignored": "warn", "converted": "info"}


class ControlParts:
    """The parts that a robot's cycle uses."""

    hardware: MujocoRobotHW
    manager: ControllerManager
    cycle: ControlCycle


@dataclass(eq=False, repr=False)
class ParsedRobot:
    """A robot whose URDF was read: its full namespace, its description, and its URDF."""

    name: str
    namespace: str
    description: Robot
    xml: str
    note: str
    """The origins of its lines, and the places of its meshes."""
    caller: int
    """The session id of the process that requested it, 0 when it is unknown."""
    is_controlled: bool
    """False for a model without control: it has no hardware, no controllers and no cycle."""
    may_use_files: bool
    """False when it was spawned by a client that may not name files: no file is read or shown for it."""


class SpawnedRobot(ParsedRobot):
    """One robot in the world with all its parts.

    Only the runners of the cycles may use `parts`. Other code must use `hardware`, `manager`, `cycle` or a callback of
    the node: these first bring the objects up to date.
    """

    saved_attributes: ClassVar[None] = None

    attached: AttachedRobot
    services: ManagerServices

    def __init__(self, parsed: ParsedRobot, node: GraphNode, serial: int) -> None:
        super().__init__(**vars(parsed))
        self.node = node
        self.serial = serial
        """A number that no other robot of this world has or had."""
        self.cleanup = ExitStack()
        """The cleanup callbacks of all that was added to the robot; called in reverse order."""
        self.parts = ControlParts()
        self.on_reset: list[Callable[[], None]] = []
        """Called when the robot is reset to its state at spawn, after the world."""
        self.on_emergency_stop: list[Callable[[], None]] = []
        """Called when an emergency stop begins."""
        self.saved: dict[str, object] = {}
        """Objects that a snapshot saves in addition to hardware, manager and cycle, by name."""
        self.made_parameters: list[str] = []
        """Parameters that its spawn has set; its deletion removes them."""
        self.warnings: list[str] = []
        """Problems of its spawn: its place, or parts of the model that have no effect."""

    @property
    def kind(self) -> str:
        """`robot`, `model` (without a controller manager), or `static` (a model that does not move)."""
        if self.is_controlled:
            return "robot"
        moving = any(joint.type != "fixed" for joint in self.description.joints.values())
        return "model" if moving or not self.description.is_fixed_to_world else "static"

    def check_controlled(self) -> None:
        """Raise Refused for a model without a controller manager."""
        if not self.is_controlled:
            raise Refused(f"{self.name!r} is a model without a controller manager")

    def _enter(self) -> None:
        self.check_controlled()
        self.node.before_entry()

    @property
    def hardware(self) -> MujocoRobotHW:
        """The simulated hardware with the joints. Raises Refused for a model without a controller manager."""
        self._enter()
        return self.parts.hardware

    @property
    def manager(self) -> ControllerManager:
        """The controller manager. Raises Refused for a model without one."""
        self._enter()
        return self.parts.manager

    @property
    def cycle(self) -> ControlCycle:
        """The robot's part of each cycle. Raises Refused for a model without one."""
        self._enter()
        return self.parts.cycle

    @property
    def emergency_stop(self) -> bool:
        """True: efforts and velocities are 0, positions are held. Controllers go on; its end restarts them."""
        return self.is_controlled and self.parts.cycle.emergency_stop

    @emergency_stop.setter
    def emergency_stop(self, stopped: bool) -> None:
        self.cycle.emergency_stop = self.hardware.estop = stopped
        text = f"emergency stop is on: {self.name}; slidectl estop release ends it"
        self.node.command_warning = text if stopped else ""
        for stop in self.on_emergency_stop if stopped else ():
            stop()

    def read_joints(self) -> None:
        """Read the joints outside of a cycle: after a change of the world, and before the first cycle."""
        self.cycle.read_joints(self.node.now_ns())

    def reset(self, time_ns: int) -> None:
        """Reset to the state at spawn. Controllers stay loaded and running; each is stopped and started again.

        The hardware comes first, since a starting controller takes its set point from the measured state.
        """
        for reset in self.on_reset:
            reset()
        if not self.is_controlled:
            return
        with watched_hardware(self.hardware, self.manager.known.code):
            self.hardware.reset()
        self.cycle.rewind(time_ns)
        self.read_joints()
        self.manager.restart_running(time_ns)


class Sources:
    """Notes of robots' texts (see description.source_note) by the texts' digests: the latest ones, up to a limit."""

    MOST = 256
    MOST_CHARACTERS = 32 * 1024 * 1024

    def __init__(self) -> None:
        self._notes: dict[str, str] = {}
        self._characters = 0

    def add(self, digest: str, note: str) -> None:
        """Save a note, and drop the oldest ones above the limits."""
        self._forget(digest)
        self._notes[digest] = note
        self._characters += len(note)
        while self._notes and (len(self._notes) > self.MOST or self._characters > self.MOST_CHARACTERS):
            self._forget(next(iter(self._notes)))

    def get(self, digest: str) -> str:
        """The note, empty when there is none."""
        return self._notes.get(digest, "")

    def _forget(self, digest: str) -> None:
        self._characters -= len(self._notes.pop(digest, ""))


class Robots:
    """All robots by name, in the order of their spawning."""

    def __init__(self, world: World, loop: Loop, types: ControllerTypes) -> None:
        self._world = world
        self._loop = loop
        self._types = types
        self._robots: dict[str, SpawnedRobot] = {}
        self._serials = count(1)
        self.on_spawn: list[Callable[[SpawnedRobot], object]] = []
        """Called with each new robot. They register their cleanup in `SpawnedRobot.cleanup`, after each step: a later
        step may fail."""
        self.sources = Sources()

    def __iter__(self) -> Iterator[SpawnedRobot]:
        return iter(tuple(self._robots.values()))

    def __len__(self) -> int:
        return len(self._robots)

    def __contains__(self, name: object) -> bool:
        return name in self._robots

    def names(self) -> list[str]:
        """Names of the robots in the order of spawning."""
        return list(self._robots)

    def get(self, name: str) -> SpawnedRobot:
        """The robot. Raises UnknownName."""
        if name not in self._robots:
            raise UnknownName("robot", name, self.names())
        return self._robots[name]

    def spawn(
        self, xml: str, name: str, namespace: str | None = None, pose: Pose = ORIGIN, hulls: Hulls | None = None
    ) -> SpawnedRobot:
        """Parse, attach, and bring up hardware, controller manager and services: all or nothing.

        The namespace is the one given, else the plugin's robotNamespace (an empty one is the root), else `/name`.
        `hulls` holds the collision hulls of its meshes; without it their files are read now.

        Raises:
            BadFile: the URDF is broken (file, line). Refused: the name or the namespace is in use. BadName: no name.
            SlidectlError: the world or the hardware refuses it. After an error nothing is left behind.
        """
        return self.spawn_read(self.read(xml, name, namespace), pose, hulls)

    def read(self, xml: str, name: str, namespace: str | None = None, *, is_model: bool = False) -> ParsedRobot:
        """Parse a robot, and check all that can be checked without its meshes. Raises as `spawn`.

        With `is_model` it gets no controller manager, unless it has transmissions or the control plugin. A name that
        is no graph name becomes one, as Gazebo takes any; the log says so.
        """
        chosen = names.legal_robot(name)
        self._check_name(chosen)
        if remark := names.remark_on_robot(name):
            self._loop.graph.log("warn", names.OWN_NODE, remark)
        may_use_files = Effect.FILES in self._loop.graph.services.permitted
        urdf, note = source_note.split(xml)
        # A note says where meshes are: a client that may name no files gives none, and gets none.
        note = (note or self.sources.get(source_note.digest(urdf))) if may_use_files else ""
        read = self._types.code.host.read
        model = description.parse(source_note.join(urdf, note), may_use_files=may_use_files, read=read)
        asked = (names.join("/", namespace).rstrip("/") or "/") if namespace else description.namespace_of(model, name)
        place = names.check(asked)
        plugin = model.plugin or ControlPlugin()
        how = self._loop.graph.parameters.get(names.join(place, TRANSMISSIONS), None)
        if plugin.transmissions is None and how is not None:
            urdf, note = source_note.split(description.with_transmissions(source_note.join(urdf, note), str(how)))
            model = description.parse(source_note.join(urdf, note), may_use_files=may_use_files, read=read)
        try:
            self._types.hardware.check_known(plugin.robot_sim_type)
        except UnknownName as error:
            raise BadFile(error.message, plugin.file or DESCRIPTION, plugin.line, error.hint) from None
        is_controlled = not is_model or bool(model.plugin or model.transmissions or model.ros2_control)
        parsed = ParsedRobot(chosen, place, model, urdf, note, self._loop.graph.caller, is_controlled, may_use_files)
        self._check_namespace(place, is_controlled)
        return parsed

    def check_free(self, name: str, namespace: str) -> None:
        """Raise Refused when the name or, for one that is not empty, the namespace is in use."""
        self._check_name(names.legal_robot(name))
        if namespace:
            self._check_namespace(namespace)

    def spawn_read(self, parsed: ParsedRobot, pose: Pose, hulls: Hulls | None) -> SpawnedRobot:
        """Spawn a parsed robot, maybe some cycles later. Raises as `spawn`: names may have been taken meanwhile."""
        self._check_name(parsed.name)
        self._check_namespace(parsed.namespace, parsed.is_controlled)
        self._loop.between_cycles("spawn a robot")
        robot = SpawnedRobot(parsed, self._loop.graph.node(parsed.namespace), next(self._serials))
        with self._world.attached(parsed.description, parsed.name, pose, hulls) as robot.attached, robot.cleanup:
            robot.cleanup.callback(robot.node.shutdown)
            if robot.is_controlled:
                self._bring_up_control(robot)
            for bring_up in self.on_spawn:
                bring_up(robot)
            robot.cleanup.callback(self._forget, robot)
            self._robots[robot.name] = robot
            self._update_loop()
            if starts := _starts(robot.description):
                self.set_joints(robot.name, list(starts), list(starts.values()), is_start=True)
                if robot.is_controlled:
                    robot.read_joints()
            for notice in robot.description.report:
                if notice.verdict in _SEVERITIES:
                    robot.node.log(_SEVERITIES[notice.verdict], f"{robot.name}: {notice}")
            _warn_of_filled_hollows(robot)
            _warn_of_overlaps(robot, self._world)
            robot.cleanup = robot.cleanup.pop_all()
        if parsed.note:
            self.sources.add(source_note.digest(parsed.xml), parsed.note)
        return robot

    def _bring_up_control(self, robot: SpawnedRobot) -> None:
        loop, parts, plugin = self._loop, robot.parts, robot.description.plugin or ControlPlugin()
        _set_description(robot, loop.graph.parameters)
        parts.hardware = self._hardware(robot, plugin.robot_sim_type)
        parts.hardware.read(robot.node.now_ns(), 0.0)
        parts.manager = ControllerManager(parts.hardware, robot.node, self._types)
        period_ns = _control_period(plugin, loop, robot)
        parts.cycle = ControlCycle(parts.hardware, parts.manager, period_ns, loop.graph.clock.time_ns)
        places = parts.manager, robot.node, robot.read_joints, loop
        if parts.manager.is_of_ros2:
            whole_ns = -(-period_ns // loop.step_ns) * loop.step_ns  # controllers run at the next step
            robot.services = Ros2ManagerServices(*places, round(SECOND / whole_ns))
        else:
            robot.services = ManagerServices(*places)
        if parts.hardware.actuator_states():
            topic, period_ns = names.join(robot.namespace, "actuator_states"), SECOND // ACTUATOR_RATE_HZ
            build = partial(_actuator_states, robot)
            states = PeriodicTopic(loop.graph, topic, "sensor_msgs/JointState", robot.node.name, period_ns, build)
            robot.cleanup.callback(states.close)
            robot.saved["actuator_states"] = states
        if plugin.estop_topic is not None:

            def receive_emergency_stop(message: Message) -> None:
                robot.emergency_stop = message["data"]

            robot.node.subscribe(plugin.estop_topic, "std_msgs/Bool", receive_emergency_stop)

    def _hardware(self, robot: SpawnedRobot, sim_type: str) -> MujocoRobotHW:
        """The simulated hardware. Raises BadFile: an unsuitable class. Refused: a user's class failed. Else as
        `MujocoRobotHW`."""
        places = self._world, robot.attached, robot.description, robot.node, robot.namespace
        if robot.description.ros2_control is not None:
            return Ros2RobotHW(*places)
        cls = self._types.hardware.find(sim_type)
        if cls is None:
            return MujocoRobotHW(*places)
        if not issubclass(cls, MujocoRobotHW):
            hint = f"class {cls.__name__}(slidectl.physics.MujocoRobotHW): ..."
            raise BadFile(f"{sim_type} is not derived from slidectl.physics.MujocoRobotHW", file_of(cls), None, hint)
        with watched_for("robotSimType", sim_type, self._types.code):
            return cls(*places)

    def delete(self, name: str) -> None:
        """Remove all of the robot from the world, and stop its controllers. Raises UnknownName.

        Steps that can be refused come first, all or nothing. After them the robot is deleted, even if its controllers
        or subscribers raise: their errors are logged.
        """
        self._loop.between_cycles("delete a robot")
        robot = self.get(name)
        self._world.detach(name)
        try:
            with ExitStack() as ending:  # calls in reverse order, and all of them even if one fails
                ending.callback(robot.cleanup.close)
                if robot.is_controlled:
                    robot.manager.stop_running(robot.node.now_ns())
        except Exception as error:
            text = f"{name} is deleted, but not all went well: {raised(error)}"
            self._loop.graph.log("error", robot.node.name, text)

    def set_joints(self, name: str, joints: Sequence[str], positions: Sequence[float], is_start: bool = False) -> None:
        """Set joints, named `joint` or `robot::joint`, to positions at rest; all or none. `is_start`: resets too.

        A joint with a position command stays there until a controller commands another position.

        Raises UnknownName: no such robot or moving joint. Refused: an invalid position, or one beyond the limits.
        """
        if len(joints) != len(positions):
            raise Refused(f"{len(joints)} joint names but {len(positions)} positions")
        robot = self.get(name)
        short = (joint.removeprefix(f"{robot.name}::") for joint in joints)
        asked = dict(zip(short, positions, strict=True))
        for joint, position in asked.items():
            check_position(robot.attached.place(joint).joint, position)
        self._loop.history.forget()
        self._world.set_joints(name, asked)
        if is_start:
            robot.attached.start |= asked
            robot.warnings = [text for text in robot.warnings if not text.startswith(_overlap_prefix(robot))]
            _warn_of_overlaps(robot, self._world)
        if robot.is_controlled:
            robot.hardware.stay(asked)

    def reset(self) -> None:
        """Reset the world and all robots to their state at spawn, all even if one fails; then raise its error."""
        self.settle_switches()
        self._world.reset()
        with ExitStack() as resetting:  # calls in reverse order
            for robot in reversed(tuple(self)):
                resetting.callback(robot.reset, self._loop.graph.clock.time_ns)

    def settle_switches(self) -> None:
        """Finish all switches that wait for a cycle, because the world has stopped."""
        for robot in self:
            if robot.is_controlled:
                robot.services.settle()

    def _forget(self, robot: SpawnedRobot) -> None:
        self._robots.pop(robot.name, None)
        self._update_loop()

    def _update_loop(self) -> None:
        """Pass the controlled robots to the loop. Models have no part of the cycle."""
        self._loop.set_robots(tuple(robot for robot in self._robots.values() if robot.is_controlled))

    def _check_name(self, name: str) -> None:
        names.check_robot(name)
        if name in RESERVED:
            raise Refused(
                f"a robot cannot be named {name!r}: as a frame of reference that name means the world itself",
                "choose another name (-n)",
            )
        if name in self._robots:
            raise Refused(
                f"there is a robot {name!r} already, in {self._robots[name].namespace}",
                f"choose another name (-n), or delete that robot: slidectl delete {name}",
            )

    def _check_namespace(self, namespace: str, is_controlled: bool = True) -> None:
        """Raise Refused when the namespace is in use. Models do not occupy theirs."""
        controlled = [robot for robot in self if robot.is_controlled and is_controlled]
        owner = next((robot for robot in controlled if robot.namespace == namespace), None)
        if owner is not None:
            text = f"the namespace {namespace} belongs to robot {owner.name!r} already"
            hint = (
                "give this one another with --namespace NAMESPACE; a model with an xacro argument `namespace` gets its "
                "own with -n NAME"
            )
            raise Refused(text, hint)


def _set_description(robot: SpawnedRobot, parameters: Parameters) -> None:
    name = names.join(robot.namespace, DESCRIPTION)
    before = parameters.get(name, None)
    parameters.set(name, robot.xml, derived=True)
    robot.made_parameters.append(name)

    def restore() -> None:
        """Restore a description set before by other code, usually the launch of a robot in the root."""
        if before is not None and parameters.get(name, None) == robot.xml:
            parameters.set(name, before)
        elif parameters.has(name):
            parameters.delete(name)

    robot.cleanup.callback(restore)


def _actuator_states(robot: SpawnedRobot) -> Message:
    """The actuators as sensor_msgs/JointState."""
    states = robot.hardware.actuator_states()
    return {
        "header": header_of(robot.node.now_ns()),
        "name": [state.name for state in states],
        "position": [state.position for state in states],
        "velocity": [state.velocity for state in states],
        "effort": [state.effort for state in states],
    }


def _starts(model: Robot) -> dict[str, float]:
    """Where the model's joints start that do not start at 0, rad or m."""
    starts = {} if model.ros2_control is None else start_positions(model.ros2_control, model.joints)
    return {joint: position for joint, position in starts.items() if position}


def _control_period(plugin: ControlPlugin, loop: Loop, robot: SpawnedRobot) -> int:
    """The control period, ns. For a robot of ROS 2 that of the controller manager's parameter `update_rate`.

    Raises Refused: `update_rate` is not a whole number above 0.
    """
    step_ns = loop.step_ns
    if robot.description.ros2_control is not None:
        where = names.join(robot.namespace, UPDATE_RATE)
        rate = loop.graph.parameters.get(where, DEFAULT_UPDATE_RATE_HZ)
        if not isinstance(rate, int) or isinstance(rate, bool) or rate <= 0:
            raise Refused(f"parameter {where} must be a whole number above 0, in Hz, not {rate!r}")
        period_ns = SECOND // rate
        if period_ns < step_ns:
            text = f"{robot.name}: controllers cannot run faster than the simulation: update_rate {rate} Hz, the "
            robot.node.log("warn", f"{text}simulation's step {step_ns * 1e-9:g} s")
        return max(period_ns, step_ns)
    if plugin.control_period is None:
        return step_ns
    period_ns = from_seconds(plugin.control_period)
    comparison = f"controlPeriod {plugin.control_period:g} s, the simulation's step {step_ns * 1e-9:g} s"
    if period_ns < step_ns:
        robot.node.log("error", f"{robot.name}: controllers cannot run faster than the simulation: {comparison}")
    elif period_ns > step_ns:
        robot.node.log("warn", f"{robot.name}: controllers run slower than the simulation: {comparison}")
    return period_ns


def _warn_of_filled_hollows(robot: SpawnedRobot) -> None:
    """Log and keep in `robot.warnings` the meshes that collide as their hulls, although they should as their faces."""
    for source in mesh_sources(robot.description):
        hull = robot.attached.hulls.get(source)
        if isinstance(hull, Hull) and hull.fills_hollows:
            text = "has too many faces to collide as they are: its convex hull does, and its hollows are filled"
            robot.warnings.append(f"{robot.name}: the mesh {source.path} {text}; a simpler mesh has hollows")
            robot.node.log("warn", robot.warnings[-1])


def _warn_of_overlaps(robot: SpawnedRobot, world: World) -> None:
    """Log and keep in `robot.warnings` the bodies that it overlaps: they push each other away, or jam."""
    try:
        overlaps = world.overlaps(robot.name, STANDING)
    except EngineError:  # too many contacts: the first step reports it
        return
    others: dict[str | None, list[Overlap]] = {}
    for overlap in overlaps:
        others.setdefault(overlap.robot, []).append(overlap)
    texts = [_overlap_text(other, found) for other, found in others.items()]
    if len(texts) > MOST_NAMED:
        texts[MOST_NAMED:] = [f"{len(texts) - MOST_NAMED} robots more"]
    for text in texts:
        robot.warnings.append(_overlap_prefix(robot) + text)
        robot.node.log("warn", robot.warnings[-1])


def _overlap_prefix(robot: SpawnedRobot) -> str:
    return f"{robot.name}: it was put into "


def _overlap_text(other: str | None, found: list[Overlap]) -> str:
    """A text on the overlap with a robot; `other` None is the ground."""
    pairs = [
        f"{one.link} {'' if other is None else f'in {other}::{one.other} '}{one.depth * 1e3:.0f} mm" for one in found
    ]
    rest = len(pairs) - MOST_NAMED
    deepest = ", ".join(pairs[:MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")
    if other is None:
        height = math.ceil(found[0].depth * 1e3) * 1e-3
        return (
            f"the ground, which pushes it out or jams it: {deepest} deep; {height:.3f} m higher it is free (--at X Y Z)"
        )
    return (
        f"the robot {other!r}, and the two push each other away or jam: {deepest} deep;"
        " give it another place (--at X Y Z)"
    )
