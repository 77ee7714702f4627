"""robot_state_publisher and joint_state_publisher: the simulation is both, so one is set up and the other refused."""

from __future__ import annotations

from typing import Any

from slidectl import names
from slidectl.errors import closest
from slidectl.launch.plan import Node, Place, Plan
from slidectl.launch.task import HOOK_LIMIT_S, Run, Task

HONOURED = ("publish_frequency", "tf_prefix")
"""The parameters of the node that count; tf_prefix does in the namespaces above it, too."""
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

    def __init__(self, node: Node, plan: Plan) -> None:
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
        robots: list[dict[str, Any]] = run.call("/slidectl/list_robots", {"name": ""})["robots"]
        if not robots:
            return "a robot"
        robot = self._meant(run, robots)
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
            own = names.join(self.node.full_name, parameter)
            value = run.parameter(own)
            if value is not None and names.join(place, parameter) != own:
                run.set_parameter(names.join(place, parameter), value)
                self.copied.append(names.join(place, parameter))
        for parameter, why in WITHOUT_EFFECT.items():
            if run.parameter(names.join(self.node.full_name, parameter)) is not None:
                self.warn(run, f"the parameter {parameter} has no effect: {why}")
        frequency = run.parameter(names.join(place, "publish_frequency"))
        rate = f"{frequency:g}" if isinstance(frequency, int | float) else "50"
        self.settled(run, f"the simulation publishes the frames of {robot['name']} at {rate} Hz")

    def _meant(self, run: Run, robots: list[dict[str, Any]]) -> dict[str, Any] | None:
        """The robot that is meant: by the topic, by the namespace, by the description; else the only one."""
        by_namespace = {robot["namespace"]: robot for robot in robots}
        for namespace in (names.parent(self._topic), self.node.namespace):
            if namespace in by_namespace:
                return by_namespace[namespace]
        wanted = run.parameter(self.node.resolve("robot_description"))
        if wanted is not None:
            for namespace, robot in by_namespace.items():
                if run.parameter(names.join(namespace, "robot_description")) == wanted:
                    return robot
        return robots[0] if len(robots) == 1 else None

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
        place, what = self._origin()
        run.console.warn(
            f"{place}: {self.node.full_name}: {what} {self._topic}, which nobody publishes{suggestion}"
            " (frames are right all the same: the simulation reads the joints themselves)"
        )

    def _origin(self) -> tuple[Place, str]:
        full = self.node.absolute("joint_states")
        for remap in reversed(self.node.remaps):
            if self.node.absolute(remap.source) == full:
                return remap.place, f"{remap.source} is remapped to"
        return self.node.place, "it listens to"

    def stop(self, run: Run) -> None:
        for name in self.copied:
            if run.call("/rosapi/has_param", {"name": name}, HOOK_LIMIT_S)["exists"]:
                run.call("/rosapi/delete_param", {"name": name}, HOOK_LIMIT_S)


class JointStatePublisher(Task):
    """A second source of joint states would contradict the world: it is left out, with a warning."""

    family = "notice"
    keeps_running = False

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        self._is_launched = bool(plan.files)
        self._has_robot = any(other.type in ("spawn_model", "spawn_model.py") for other in plan.nodes)

    @property
    def text(self) -> str:
        return f"left out: {self._reason}"

    @property
    def _reason(self) -> str:
        if self._has_robot:
            where = "the joints of a simulated robot are where the world has them"
            return f"{where}, and its joint_state_controller says so"
        none = ", and this launch spawns none" if self._is_launched else ""
        return (
            f"joints are those of a robot in the world here{none};"
            " spawn it (slidectl spawn MODEL) with a joint_state_controller, and move it with slidectl pub"
        )

    def start(self, run: Run) -> str | None:
        self.warn(run, self.text)
        return None
