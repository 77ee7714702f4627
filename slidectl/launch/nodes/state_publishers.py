"""robot_state_publisher and joint_state_publisher: the simulation is both, so one is set up and the other refused."""

from __future__ import annotations

from typing import Any

from slidectl import names
from slidectl.errors import closest
from slidectl.launch.nodes.spawn_model import SpawnModel
from slidectl.launch.plan import LaunchPlan, Node
from slidectl.launch.task import HOOK_LIMIT_S, LeftOut, Run, Task

HONOURED = ("publish_frequency", "tf_prefix")
"""The parameters of the node that count."""
SEARCHED = ("tf_prefix",)
"""Those of them that count in the namespaces above the node, too."""
WITHOUT_EFFECT = {
    "use_tf_static": "fixed joints are on /tf_static always",
    "ignore_timestamp": "the frames are those of the moment when they are published",
    "use_robot_description": "the description is the robot's own",
}
_JOINT_STATE = "sensor_msgs/JointState"


class RobotStatePublisher(Task):
    """Every robot has its state publisher here; the node's parameters and namespace say which is meant, and how."""

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
        """Where the real one would listen for joint states."""
        return self.node.resolve("joint_states")

    def start(self, run: Run) -> str | None:
        robots = run.robots()
        robot = self._by_namespace(robots)
        coming = [task for task in _spawns(run) if task not in run.left_out]
        awaited = [task.model for task in coming if task.model not in run.spawned]
        if robot is None and awaited:  # any of them may be the one that is meant
            return f"the robot {awaited[0]}"
        if not robots:
            return "a robot"
        robot = robot or self._meant(run, robots)
        if robot is None:
            known = ", ".join(robot["namespace"] for robot in robots)
            self.warn(run, f"which robot is meant is not clear (there are {known}); all have their frames anyway")
        else:
            self._set_up(run, robot)
        return None

    def _set_up(self, run: Run, robot: dict[str, Any]) -> None:
        place = names.join(robot["namespace"], "robot_state_publisher")
        if run.parameter(names.join(place, "enabled")) is False:  # `rosnode kill` has ended it
            run.call("/rosapi/delete_param", {"name": names.join(place, "enabled")})
        for parameter in HONOURED:
            full = names.join(self.node.full_name, parameter)
            own = _found(run, full) if parameter in SEARCHED else full
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

    def _by_namespace(self, robots: list[dict[str, Any]]) -> dict[str, Any] | None:
        """The robot in the namespace of the topic, else in that of the node; the root says nothing yet."""
        by_namespace = {robot["namespace"]: robot for robot in robots}
        for namespace in (names.parent(self._topic), self.node.namespace):
            if namespace in by_namespace and namespace != "/":
                return by_namespace[namespace]
        return None

    def _surely_meant(self, run: Run, robots: list[dict[str, Any]]) -> dict[str, Any] | None:
        """The robot that is meant, whatever other nodes there are.

        By its namespace, by the parameter of its description that both nodes name, or as the robot in the root.
        """
        found = self._by_namespace(robots)
        if found is not None:
            return found
        by_name = {robot["name"]: robot for robot in robots}
        description = _found(run, self.node.resolve("robot_description"))
        spawns = [task for task in _spawns(run) if task.parameter == description and task.model in by_name]
        beside = [task for task in spawns if task.node.namespace == self.node.namespace]
        for fitting in (spawns, beside):
            if len(fitting) == 1:
                return by_name[fitting[0].model]
        in_root = [robot for robot in robots if robot["namespace"] == "/"]
        return in_root[0] if in_root and "/" in (names.parent(self._topic), self.node.namespace) else None

    def _meant(self, run: Run, robots: list[dict[str, Any]]) -> dict[str, Any] | None:
        """The robot that is surely meant; else, of those that are no other node's, the one of this description, or the
        only one.
        """
        sure = self._surely_meant(run, robots)
        if sure is not None:
            return sure
        others = [task for task in run.tasks if isinstance(task, RobotStatePublisher) and task is not self]
        taken = [robot["name"] for task in others if (robot := task._surely_meant(run, robots)) is not None]
        left = [robot for robot in robots if robot["name"] not in taken]
        description = _found(run, self.node.resolve("robot_description"))
        wanted = None if description is None else run.parameter(description)
        for robot in left if wanted is not None else ():
            if run.parameter(names.join(robot["namespace"], "robot_description")) == wanted:
                return robot
        return left[0] if len(left) == 1 else None

    def afterwards(self, run: Run) -> None:
        """Point out joint states that nobody publishes: the tutorial's slip."""
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
            f"{place}: {self.node.full_name}: {what} {self._topic}, which nobody publishes{suggestion}"
            " (frames are right all the same: the simulation reads the joints themselves)"
        )

    def stop(self, run: Run) -> None:
        for name in self.copied:
            if run.call("/rosapi/has_param", {"name": name}, HOOK_LIMIT_S)["exists"]:
                run.call("/rosapi/delete_param", {"name": name}, HOOK_LIMIT_S)


def _spawns(run: Run) -> list[SpawnModel]:
    """The nodes of the launch that put robots into the world."""
    return [task for task in run.tasks if isinstance(task, SpawnModel)]


def _found(run: Run, name: str) -> str | None:
    """The full name of a parameter in its namespace or the nearest one above that has it, None when none has."""
    namespace, last = names.parent(name), name.rpartition("/")[2]
    while True:
        full = names.join(namespace, last)
        if run.parameter(full) is not None:
            return full
        if namespace == "/":
            return None
        namespace = names.parent(namespace)


class JointStatePublisher(LeftOut):
    """A second source of joint states would contradict the world: it is left out, with a warning."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self._is_launched = bool(plan.files)
        self._has_robot = any(other.type in ("spawn_model", "spawn_model.py") for other in plan.nodes)

    @property
    def text(self) -> str:
        if self._has_robot:
            return (
                "left out: the joints of a simulated robot are where the world has them,"
                " and its joint_state_controller says so"
            )
        none = ", and this launch spawns none" if self._is_launched else ""
        return (
            f"left out: joints are those of a robot in the world here{none};"
            " spawn it (slidectl spawn MODEL) with a joint_state_controller, and move it with slidectl pub"
        )
