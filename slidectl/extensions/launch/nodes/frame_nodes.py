"""robot_state_publisher and static_transform_publisher: the frames of robots, and static frames.

The simulation publishes the frames of its robots itself; a robot_state_publisher only configures it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slidectl import names, rotations
from slidectl.client import Client
from slidectl.errors import BadFile, closest
from slidectl.extensions.launch.nodes.spawn_model import SpawnModel
from slidectl.extensions.launch.plan import LaunchPlan, Node
from slidectl.extensions.launch.task import HOOK_LIMIT_S, Run, Task, number, parse

if TYPE_CHECKING:
    from slidectl.msgs.typed import RobotInfoMsg

HONOURED = ("publish_frequency", "tf_prefix")
"""The parameters of the node that have an effect."""
SEARCHED = ("tf_prefix",)
"""Those parameters that may also be set in the namespaces above the node."""
WITHOUT_EFFECT = {
    "use_tf_static": "fixed joints are on /tf_static always",
    "ignore_timestamp": "the frames are those of the moment when they are published",
    "use_robot_description": "the description is the robot's own",
}
_JOINT_STATE = "sensor_msgs/JointState"


class RobotStatePublisher(Task):
    """Configures the state publisher that every robot has here. The node's namespace and parameters select it."""

    family = "frames"
    waits_lightly = True

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self.copied: list[str] = []

    @property
    def text(self) -> str:
        return f"frames on /tf, of the robot with {self._topic}"

    @property
    def _topic(self) -> str:
        """The topic on which the real node would receive joint states."""
        return self.node.resolve("joint_states")

    def start(self, run: Run) -> str | None:
        robots = run.controlled_robots()
        robot = self._by_namespace(robots)
        awaited = [task.model for task in _spawns(run) if task not in run.left_out and task.model not in run.spawned]
        if robot is None and awaited:  # any of them may be the node's robot
            return f"the robot {awaited[0]}"
        if not robots:
            return "a robot"
        robot = robot or self._meant(run, robots)
        if robot is None:
            known = ", ".join(robot["namespace"] for robot in robots)
            self.warn(run, f"several robots fit: {known}; all have their frames anyway")
        else:
            self._set_up(run, robot)
        return None

    def _set_up(self, run: Run, robot: RobotInfoMsg) -> None:
        place = names.join(robot["namespace"], "robot_state_publisher")
        if run.parameter(names.join(place, "enabled")) is False:  # it was ended by `rosnode kill`
            run.call("/rosapi/delete_param", {"name": names.join(place, "enabled")})
        for parameter in HONOURED:
            full = names.join(self.node.full_name, parameter)
            own = _find_parameter(run, full) if parameter in SEARCHED else full
            value = None if own is None else run.parameter(own)
            if value is not None and names.join(place, parameter) != own:
                run.set_parameter(names.join(place, parameter), value)
                self.copied.append(names.join(place, parameter))
        for parameter, why in WITHOUT_EFFECT.items():
            if run.parameter(names.join(self.node.full_name, parameter)) is not None:
                self.warn(run, f"the parameter {parameter} has no effect: {why}")
        frequency = run.parameter(names.join(place, "publish_frequency"))
        rate = f"{frequency:g}" if isinstance(frequency, int | float) else "50"
        self.settled(run, f"the simulation publishes the frames of {robot['name']} at {rate} Hz")

    def _by_namespace(self, robots: list[RobotInfoMsg]) -> RobotInfoMsg | None:
        """The robot in the namespace of the topic, else of the node. The root selects none here."""
        by_namespace = {robot["namespace"]: robot for robot in robots}
        for namespace in (names.parent(self._topic), self.node.namespace):
            if namespace in by_namespace and namespace != "/":
                return by_namespace[namespace]
        return None

    def _surely_meant(self, run: Run, robots: list[RobotInfoMsg]) -> RobotInfoMsg | None:
        """The robot of this node, found without regard to other nodes.

        By its namespace, by the description parameter that it shares with one spawn node, or as the robot in the root.
        """
        found = self._by_namespace(robots)
        if found is not None:
            return found
        by_name = {robot["name"]: robot for robot in robots}
        description = _find_parameter(run, self.node.resolve("robot_description"))
        spawns = [task for task in _spawns(run) if task.parameter == description and task.model in by_name]
        beside = [task for task in spawns if task.node.namespace == self.node.namespace]
        for fitting in (spawns, beside):
            if len(fitting) == 1:
                return by_name[fitting[0].model]
        in_root = [robot for robot in robots if robot["namespace"] == "/"]
        return in_root[0] if in_root and "/" in (names.parent(self._topic), self.node.namespace) else None

    def _meant(self, run: Run, robots: list[RobotInfoMsg]) -> RobotInfoMsg | None:
        """The robot that is surely meant; else, of the robots without another node, the one with this description,
        or the only one.
        """
        sure = self._surely_meant(run, robots)
        if sure is not None:
            return sure
        others = [task for task in run.tasks if isinstance(task, RobotStatePublisher) and task is not self]
        taken = [robot["name"] for task in others if (robot := task._surely_meant(run, robots)) is not None]
        left = [robot for robot in robots if robot["name"] not in taken]
        description = _find_parameter(run, self.node.resolve("robot_description"))
        wanted = None if description is None else run.parameter(description)
        for robot in left if wanted is not None else ():
            if run.parameter(names.join(robot["namespace"], "robot_description")) == wanted:
                return robot
        return left[0] if len(left) == 1 else None

    def afterwards(self, run: Run) -> None:
        """Warn when joint states have no publisher: the remap of the tutorial often causes that."""
        if run.call("/rosapi/publishers", {"topic": self._topic})["publishers"]:
            return
        there = [
            topic
            for topic in run.call("/rosapi/topics_for_type", {"type": _JOINT_STATE})["topics"]
            if run.call("/rosapi/publishers", {"topic": topic})["publishers"]
        ]
        near = closest(self._topic, there) or (there[0] if len(there) == 1 else None)
        suggestion = f"; did you mean {near}?" if near else ""
        place, what = self.node.place, "it listens to"
        if (remap := self.node.remap_of("joint_states")) is not None:
            place, what = remap.place, f"{remap.source} is remapped to"
        run.console.warn(
            f"{place}: {self.node.full_name}: {what} {self._topic}, which has no publisher{suggestion}"
            " (the frames are right: the simulation reads the joints themselves)"
        )

    def stop(self, run: Run) -> None:
        for name in self.copied:
            if run.call("/rosapi/has_param", {"name": name}, timeout=HOOK_LIMIT_S)["exists"]:
                run.call("/rosapi/delete_param", {"name": name}, timeout=HOOK_LIMIT_S)


def _spawns(run: Run) -> list[SpawnModel]:
    """The nodes of the launch that spawn robots from URDF."""
    return [task for task in run.tasks if isinstance(task, SpawnModel) and not task.is_sdf]


def _find_parameter(run: Run, name: str) -> str | None:
    """The full name of a parameter in its namespace or the nearest one above; None when it is not set."""
    namespace, last = names.parent(name), name.rpartition("/")[2]
    while run.parameter(full := names.join(namespace, last)) is None:
        if namespace == "/":
            return None
        namespace = names.parent(namespace)
    return full


# --- static_transform_publisher --------------------------------------------------------------------------------------

_TOLERANCE = 10e-3
"""Tolerance of the square of a quaternion's length, as in tf2."""
_USAGE = {
    "tf": "x y z yaw pitch roll (or qx qy qz qw) FRAME CHILD PERIOD_MS",
    "tf2_ros": "x y z yaw pitch roll (or qx qy qz qw) FRAME CHILD",
}


class StaticTransform(Task):
    """static_transform_publisher of tf and tf2_ros: one transform, latched on /tf_static, as long as the node runs.

    tf's own sends it on /tf repeatedly; subscribers get the same.
    """

    family = "frames"
    needs_presence = True

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = parse(node, {}).rest
        try:
            if node.package == "tf" and len(words) in (9, 10):
                number(node, "the period", words.pop())
            if len(words) not in (8, 9):
                few = "few" if len(words) < 8 else "many"
                raise self.error(f"{len(words)} arguments are too {few}")
            *values, parent, child = words
            self.numbers = [number(node, "each of the values", value) for value in values]
        except BadFile as error:
            error.hint = f"{node.type} takes: {_USAGE[node.package]}"
            raise
        self.parent, self.child = parent.lstrip("/"), child.lstrip("/")
        if self.parent == self.child:
            raise self.error(f"{self.child} is its own parent", "the two frames must differ")
        if len(turn := self.numbers[3:]) == 4:
            length = math.hypot(*turn)
            if abs(length * length - 1.0) > _TOLERANCE:
                raise self.error(
                    f"the quaternion has the length {length:g}, and a rotation has 1",
                    "tf drops such a transform; give qx qy qz qw of length 1, or yaw pitch roll",
                )
            self.numbers[3:] = [part / length for part in turn]
        self._client: Client | None = None

    @property
    def text(self) -> str:
        return f"the frame {self.child} in {self.parent}"

    def start(self, run: Run) -> str | None:
        x, y, z, *turn = self.numbers
        if len(turn) == 4:
            rotation = dict(zip("xyzw", turn, strict=True))
        else:
            rotation = rotations.message(rotations.from_rpy((turn[2], turn[1], turn[0])))
        transform: dict[str, Any] = {
            "header": {"stamp": run.call("/rosapi/get_time")["time"], "frame_id": self.parent},
            "child_frame_id": self.child,
            "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": rotation},
        }
        # An own connection: a latched topic keeps one message for each publisher.
        self._client = run.client.another()
        self._client.publish("/tf_static", {"transforms": [transform]}, "tf2_msgs/TFMessage", latch=True)
        self._client.flush()
        self.settled(run, f"the frame {self.child} in {self.parent}, on /tf_static")
        return None

    def stop(self, run: Run) -> None:  # noqa: ARG002
        if self._client is not None:
            self._client.close()
