"""The robots of the world: spawned as a whole or not at all, deleted without a trace.

The registry and its rules about names. Knows no requests of clients; those come through the services of `/gazebo`.
"""

from __future__ import annotations

from collections.abc import Iterator

from slidectl import description, names
from slidectl.description.robot import Robot
from slidectl.errors import Refused, UnknownName
from slidectl.physics import World
from slidectl.simulation.assembly import ORIGIN, Companion, Pose, SpawnedRobot, assemble, report
from slidectl.simulation.loop import Loop

RESERVED = ("world", "map")
"""What gazebo_ros takes for the world wherever it could be a model: such a robot could not be told from it."""


class Robots:
    """All robots by name, in the order of their spawning."""

    def __init__(self, world: World, loop: Loop) -> None:
        self._world = world
        self._loop = loop
        self._robots: dict[str, SpawnedRobot] = {}
        self.companions: list[Companion] = []

    def __iter__(self) -> Iterator[SpawnedRobot]:
        return iter(tuple(self._robots.values()))

    def __len__(self) -> int:
        return len(self._robots)

    def __contains__(self, name: object) -> bool:
        return name in self._robots

    def names(self) -> list[str]:
        """In the order of spawning."""
        return list(self._robots)

    def get(self, name: str) -> SpawnedRobot:
        """The robot. Raises UnknownName."""
        if name not in self._robots:
            raise UnknownName("robot", name, self.names())
        return self._robots[name]

    def spawn(self, xml: str, name: str, namespace: str | None = None, pose: Pose = ORIGIN) -> SpawnedRobot:
        """Parse, attach, and bring up hardware, controller manager and services.

        The namespace is the one given, else the plugin's robotNamespace (an empty one is the root), else `/name`.

        Raises:
            BadFile: the URDF is broken (file, line). Refused: the name or the namespace is taken. BadName.
            SlidectlError: the world or the hardware cannot take it. Nothing is left behind then.
        """
        self._loop.between_cycles("spawn a robot")
        self._check_name(name)
        paper = description.parse(xml)
        place = self._namespace(name, namespace, paper)
        robot = SpawnedRobot(name, place, paper, xml, self._loop.graph.node(place))
        assemble(robot, self._world, self._loop, pose, self.companions)
        self._robots[name] = robot
        self._tell_loop()
        report(robot)
        return robot

    def delete(self, name: str) -> None:
        """Stop its controllers, and take all that belongs to the robot out of the world. Raises UnknownName."""
        self._loop.between_cycles("delete a robot")
        robot = self.get(name)
        robot.manager.stop_running(robot.node.now_ns())
        del self._robots[name]
        self._tell_loop()
        robot.taken.close()

    def settle_switches(self) -> None:
        """The world has come to a stand: what waits for a cycle is finished now."""
        for robot in self:
            robot.services.settle()

    def _tell_loop(self) -> None:
        self._loop.take_robots(tuple(self._robots.values()))

    def _check_name(self, name: str) -> None:
        names.check_robot(name)
        if name in RESERVED:
            raise Refused(
                f"no robot can be named {name!r}: where a frame of reference is asked for, that is the world itself",
                "choose another name (-n)",
            )
        if name in self._robots:
            raise Refused(
                f"there is a robot {name!r} already, in {self._robots[name].namespace}",
                "choose another name (-n), or delete that one first",
            )

    def _namespace(self, name: str, asked: str | None, paper: Robot) -> str:
        home = names.join("/", asked).rstrip("/") or "/" if asked else description.namespace_of(paper, name)
        namespace = names.check(home)
        taken = {robot.namespace: robot.name for robot in self}
        if namespace in taken:
            raise Refused(
                f"the namespace {namespace} belongs to robot {taken[namespace]!r} already",
                "give this one another namespace",
            )
        return namespace
