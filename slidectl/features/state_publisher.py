"""robot_state_publisher of every robot: moving joints on `/tf` at 50 Hz, fixed ones latched on `/tf_static`.

It reads the joints from the world directly, so it needs no joint_states and includes passive joints. In a world that
stands still, a new subscriber of `/tf` gets the present transforms at once. Its parameters
below `/<ns>/robot_state_publisher`, publish_frequency, tf_prefix and enabled, take effect whenever they are set.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl import names
from slidectl.control.duration import header_of
from slidectl.control.node_handle import Message
from slidectl.description.robot import Joint
from slidectl.features.gazebo_frames import transform_message
from slidectl.rotations import Pose, from_rpy, relative
from slidectl.simulation.clock import SECOND, period_ns_of
from slidectl.simulation.feature import Feature
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import NodePublisher, PeriodicTopic, TopicPublisher

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

FREQUENCY_HZ = 50
NODE = "robot_state_publisher"


class StatePublishers(Feature):
    """The state publishers of all robots of a simulation."""

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._publishers: dict[str, StatePublisher] = {}

    def on_spawn(self, robot: SpawnedRobot) -> None:
        """Create the publisher of a robot; a model without control gets none.

        Two robots with the same links would publish the same frames: the later one gets a prefix of its own.
        """
        if not robot.is_controlled:
            return
        parameters = self._simulation.parameters
        others = {frame for publisher in self._publishers.values() for frame in publisher.frames()}
        shares_frames = not others.isdisjoint(set(robot.description.links) - {"world"})
        prefix = ""
        if shares_frames and not tf_prefix(self._simulation, robot):
            prefix = robot.namespace.strip("/") or robot.name
            chosen = names.join(robot.namespace, f"{NODE}/tf_prefix")  # further up it would apply to other robots too
            parameters.set(chosen, prefix, derived=True)
            robot.made_parameters.append(chosen)
            robot.cleanup.callback(lambda: parameters.delete(chosen) if parameters.has(chosen) else None)
            text = f"{robot.name}: another robot has frames of the same names; these are {prefix}/LINK on /tf"
            robot.node.log("info", text)
        self._publishers[robot.name] = StatePublisher(self._simulation, robot, prefix)
        robot.cleanup.callback(self._publishers.pop, robot.name)


class StatePublisher:
    """One robot's transforms. Frames have `tf_prefix` if that parameter is found in or above the node's namespace.

    `chosen` is a prefix that the user did not request: with it all robots still share the frame `world`. The node is
    not in the graph while its parameter `enabled` is false.
    """

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, chosen: str = "") -> None:
        self._simulation = simulation
        self._robot = robot
        self._chosen = chosen
        self._moving = [joint for joint in robot.description.joints.values() if joint.type != "fixed"]
        self._fixed = [joint for joint in robot.description.joints.values() if joint.type == "fixed"]
        self._node = names.join(robot.namespace, NODE)
        self._prefix = ""
        self._period_ns = 0
        self._tf: PeriodicTopic | None = None
        self._static: TopicPublisher | None = None
        robot.cleanup.callback(self._silence)
        self._configure()
        robot.cleanup.callback(simulation.parameters.watch(self._node, self._configure))

    def frames(self) -> set[str]:
        """All frames except the world's."""
        return {self._frame(link) for link in self._robot.description.links} - {"world"}

    def _silence(self) -> None:
        for publisher in (self._tf, self._static):
            if publisher is not None:
                publisher.close()
        self._tf = self._static = None

    def _configure(self) -> None:
        """Apply the parameters of the node; called whenever one is set or deleted."""
        simulation = self._simulation
        prefix = tf_prefix(simulation, self._robot) or self._chosen
        has_other_names, self._prefix = prefix != self._prefix, prefix
        if simulation.parameters.get(names.join(self._node, "enabled"), True) is False:
            self._silence()
            return
        period_ns = self._asked_period_ns()
        if self._tf is None or period_ns != self._period_ns:
            self._period_ns = period_ns
            if self._tf is not None:
                self._tf.close()
            self._tf = PeriodicTopic(
                simulation.graph,
                "/tf",
                "tf2_msgs/TFMessage",
                self._node,
                period_ns,
                lambda: {"transforms": [self._transform(joint, self._pose(joint)) for joint in self._moving]},
                lambda: simulation.driven and simulation.loop.stands_still,
            )
        if self._static is None or has_other_names:
            if self._static is None:
                advertise = simulation.graph.topics.advertise
                kind = "tf2_msgs/TFMessage"
                self._static = advertise("/tf_static", kind, self._node, latch=True, kind=NodePublisher)
            if self._fixed:
                transforms = [self._transform(joint, _origin(joint)) for joint in self._fixed]
                self._static.publish({"transforms": transforms})

    def _asked_period_ns(self) -> int:
        asked = self._simulation.parameters.get(names.join(self._node, "publish_frequency"), FREQUENCY_HZ)
        if isinstance(asked, int | float) and not isinstance(asked, bool) and 0 < asked <= SECOND:
            return period_ns_of(asked)
        self._robot.node.log("warn", f"{self._node}: publish_frequency is above 0 Hz, not {asked!r}; it stays at 50")
        return SECOND // FREQUENCY_HZ

    def _frame(self, link: str) -> str:
        is_shared = link == "world" and self._prefix == self._chosen
        return link if is_shared or not self._prefix else f"{self._prefix}/{link}"

    def _pose(self, joint: Joint) -> Pose:
        """The pose of the child in the parent: from the joint's position, or from the world (planar, floating)."""
        world, robot = self._simulation.world, self._robot.name
        if joint.name not in world.robot(robot).joints:
            return relative(world.link_pose(robot, joint.child), world.link_pose(robot, joint.parent))
        return joint.child_pose(world.joint_state(robot, joint.name)[0])

    def _transform(self, joint: Joint, place: Pose) -> Message:
        header = header_of(self._simulation.time_ns, self._frame(joint.parent))
        return {"header": header, "child_frame_id": self._frame(joint.child), "transform": transform_message(place)}


def _origin(joint: Joint) -> Pose:
    return joint.origin.xyz, from_rpy(joint.origin.rpy)


def tf_prefix(simulation: Simulation, robot: SpawnedRobot) -> str:
    """The prefix of the robot's frames: the parameter `tf_prefix` in its namespace or above; may be empty."""
    found = simulation.parameters.search(names.join(robot.namespace, NODE), "tf_prefix")
    value = simulation.parameters.get(found) if found else None
    return value.strip("/") if isinstance(value, str) else ""
