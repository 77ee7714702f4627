"""The robots of the world: spawned as a whole or not at all, deleted without a trace.

The registry and its rules about names. Knows no requests of clients; those come through the services of `/gazebo`.
"""

from __future__ import annotations

from collections.abc import Iterator

from slidectl import description, names
from slidectl.description import source_note
from slidectl.description.robot import Robot
from slidectl.errors import Refused, UnknownName
from slidectl.physics import World
from slidectl.simulation.assembly import ORIGIN, Companion, Pose, SpawnedRobot, assemble, report
from slidectl.simulation.loop import Loop

RESERVED = ("world", "map")
"""What gazebo_ros takes for the world wherever it could be a model: such a robot could not be told from it."""


class Sources:
    """Notes of robots' texts (see description.source_note) by the texts' digests: the latest ones, within bounds."""

    MOST = 256
    MOST_CHARACTERS = 32 * 1024 * 1024

    def __init__(self) -> None:
        self._notes: dict[str, str] = {}
        self._characters = 0

    def put(self, digest: str, note: str) -> None:
        """Remember a note; the oldest ones go when there are too many."""
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

    def __init__(self, world: World, loop: Loop) -> None:
        self._world = world
        self._loop = loop
        self._robots: dict[str, SpawnedRobot] = {}
        self.companions: list[Companion] = []
        self.sources = Sources()

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

        The namespace is the one given, else the plugin's robotNamespace, else `/name`.

        Raises:
            BadFile: the URDF is broken (file, line). Refused: the name or the namespace is taken. BadName.
            SlidectlError: the world or the hardware cannot take it. Nothing is left behind then.
        """
        self._loop.between_cycles("spawn a robot")
        self._check_name(name)
        urdf, note = source_note.split(xml)
        digest = source_note.digest(urdf)
        note = note or self.sources.get(digest)
        paper = description.parse(source_note.join(urdf, note))
        place = self._namespace(name, namespace, paper)
        robot = SpawnedRobot(name, place, paper, urdf, self._loop.graph.node(place))
        assemble(robot, self._world, self._loop, pose, self.companions)
        self._robots[name] = robot
        if note:
            self.sources.put(digest, note)
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
        written = asked or (paper.plugin.robot_namespace if paper.plugin else None) or name
        namespace = names.check(names.join("/", written).rstrip("/") or "/")
        taken = {robot.namespace: robot.name for robot in self}
        if namespace in taken:
            raise Refused(
                f"the namespace {namespace} belongs to robot {taken[namespace]!r} already",
                "give this one another namespace",
            )
        return namespace
