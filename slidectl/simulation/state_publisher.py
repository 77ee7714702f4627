"""robot_state_publisher of every robot: moving joints on `/tf` at 50 Hz, fixed ones latched on `/tf_static`.

It reads the joints of the world themselves, so it needs no joint_states and shows passive joints too. In a world that
stands still whoever begins to listen to `/tf` gets the present transforms at once. Its parameters
below `/<ns>/robot_state_publisher`, publish_frequency, tf_prefix and enabled, take effect whenever they are set.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from slidectl import names
from slidectl.control.node_handle import Message
from slidectl.description.robot import Joint
from slidectl.physics.frames import compose, relative
from slidectl.physics.rotation import Pose
from slidectl.rotations import IDENTITY, from_rpy
from slidectl.simulation.assembly import SpawnedRobot
from slidectl.simulation.clock import SECOND, stamp
from slidectl.simulation.periodic import PeriodicTopic
from slidectl.simulation.topics import NodePublisher, TopicPublisher

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

FREQUENCY_HZ = 50
ROTARY = ("revolute", "continuous")
NODE = "robot_state_publisher"
ENABLED = "enabled"
"""The parameter that, when it is false, takes the node out of the graph."""


class StatePublisher:
    """One robot's transforms. Frames carry `tf_prefix` if that parameter is found in or above the node's namespace.

    `chosen` is a prefix that nobody asked for: with that one all robots still share the frame `world`.
    """

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, chosen: str = "") -> None:
        self._simulation = simulation
        self._robot = robot
        self._chosen = chosen
        self._moving = [joint for joint in robot.paper.joints.values() if joint.type != "fixed"]
        self._node = names.join(robot.namespace, NODE)
        self._prefix = ""
        self._period_ns = 0
        self._tf: PeriodicTopic | None = None
        self._static: TopicPublisher | None = None
        self._configure()
        self._watch = simulation.parameters.watch(self._node, self._configure)

    def close(self) -> None:
        """Take the topics back."""
        self._watch.close()
        self._silence()

    def _silence(self) -> None:
        for publisher in (self._tf, self._static):
            if publisher is not None:
                publisher.close()
        self._tf = self._static = None

    def _configure(self) -> None:
        """What the parameters of the node ask for; called whenever one is set or deleted."""
        prefix = _prefix(self._simulation, self._robot) or self._chosen
        has_other_names, self._prefix = prefix != self._prefix, prefix
        if self._simulation.parameters.get(names.join(self._node, ENABLED), True) is False:
            self._silence()
            return
        period_ns = self._asked_period_ns()
        if self._tf is None or period_ns != self._period_ns:
            self._period_ns = period_ns
            self._publish_moving()
        if self._static is None or has_other_names:
            self._publish_fixed()

    def _publish_moving(self) -> None:
        if self._tf is not None:
            self._tf.close()
        simulation = self._simulation
        self._tf = PeriodicTopic(
            simulation.graph,
            "/tf",
            "tf2_msgs/TFMessage",
            self._node,
            self._period_ns,
            self._dynamic,
            lambda: simulation.driven and simulation.loop.stands_still,
        )

    def _publish_fixed(self) -> None:
        if self._static is None:
            topics = self._simulation.graph.topics
            kind = "tf2_msgs/TFMessage"
            self._static = topics.advertise("/tf_static", kind, self._node, latch=True, kind=NodePublisher)
        fixed = [joint for joint in self._robot.paper.joints.values() if joint.type == "fixed"]
        if fixed:
            self._static.publish({"transforms": [self._transform(joint, _origin(joint)) for joint in fixed]})

    def _asked_period_ns(self) -> int:
        asked = self._simulation.parameters.get(names.join(self._node, "publish_frequency"), FREQUENCY_HZ)
        if isinstance(asked, int | float) and not isinstance(asked, bool) and 0 < asked <= SECOND:
            return max(1, round(SECOND / asked))
        self._robot.node.log("warn", f"{self._node}: publish_frequency is above 0 Hz, not {asked!r}; it stays at 50")
        return SECOND // FREQUENCY_HZ

    def frame(self, link: str) -> str:
        """Name of a link's frame."""
        is_shared = link == "world" and self._prefix == self._chosen
        return link if is_shared or not self._prefix else f"{self._prefix}/{link}"

    def frames(self) -> set[str]:
        """All frames but the world's."""
        return {self.frame(link) for link in self._robot.paper.links} - {"world"}

    def _dynamic(self) -> Message:
        return {"transforms": [self._transform(joint, self._pose(joint)) for joint in self._moving]}

    def _pose(self, joint: Joint) -> Pose:
        """The child in the parent: by the joint's equation, or as the world has it (planar, floating)."""
        world, robot = self._simulation.world, self._robot.name
        if joint.name not in world.body(robot).joints:
            return relative(world.link_pose(robot, joint.child), world.link_pose(robot, joint.parent))
        return compose(_origin(joint), _displacement(joint, world.joint_state(robot, joint.name)[0]))

    def _transform(self, joint: Joint, place: Pose) -> Message:
        (x, y, z), (qx, qy, qz, qw) = place
        return {
            "header": {"seq": 0, "stamp": stamp(self._simulation.time_ns), "frame_id": self.frame(joint.parent)},
            "child_frame_id": self.frame(joint.child),
            "transform": {
                "translation": {"x": x, "y": y, "z": z},
                "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
            },
        }


def _origin(joint: Joint) -> Pose:
    return joint.origin.xyz, from_rpy(joint.origin.rpy)


def _displacement(joint: Joint, position: float) -> Pose:
    """What the joint's position (m or rad) does along or about its axis."""
    x, y, z = joint.axis
    if joint.type in ROTARY:
        sine = math.sin(position / 2)
        return (0.0, 0.0, 0.0), (x * sine, y * sine, z * sine, math.cos(position / 2))
    return (x * position, y * position, z * position), IDENTITY


def companion(simulation: Simulation) -> Callable[[SpawnedRobot], Callable[[], None]]:
    """What gives every robot of the simulation its state publisher."""
    publishers: dict[str, StatePublisher] = {}

    def bring_up(robot: SpawnedRobot) -> Callable[[], None]:
        others = {frame for publisher in publishers.values() for frame in publisher.frames()}
        clash = others & (set(robot.paper.links) - {"world"})
        chosen = _choose_prefix(simulation, robot) if clash and not _prefix(simulation, robot) else None
        prefix = _prefix(simulation, robot) if chosen else ""
        publisher = publishers[robot.name] = StatePublisher(simulation, robot, prefix)

        def take_back() -> None:
            del publishers[robot.name]
            publisher.close()
            if chosen and simulation.parameters.has(chosen):
                simulation.parameters.delete(chosen)

        return take_back

    return bring_up


def _prefix(simulation: Simulation, robot: SpawnedRobot) -> str:
    found = simulation.parameters.search(names.join(robot.namespace, NODE), "tf_prefix")
    value = simulation.parameters.get(found) if found else None
    return value.strip("/") if isinstance(value, str) else ""


def _choose_prefix(simulation: Simulation, robot: SpawnedRobot) -> str:
    """Two robots with the same links would speak of the same frames: the later one gets a prefix of its own.

    Returns the name of the parameter that says so.
    """
    prefix = robot.namespace.strip("/") or robot.name
    name = names.join(robot.namespace, f"{NODE}/tf_prefix")  # in a namespace above, it would be others' too
    simulation.parameters.set(name, prefix)
    robot.node.log("info", f"{robot.name}: another robot has frames of the same names; these are {prefix}/LINK on /tf")
    return name
