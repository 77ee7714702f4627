"""The robots of the world: spawned as a whole or not at all, deleted without a trace.

The registry and its rules about names. Knows no requests of clients; those come through the services of `/gazebo`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import NamedTuple

from slidectl import description, names
from slidectl.description import source_note
from slidectl.description.robot import Robot
from slidectl.errors import Refused, UnknownName
from slidectl.physics import World
from slidectl.physics.hulls import Hulls
from slidectl.simulation.assembly import (
    ORIGIN,
    Companion,
    Pose,
    SpawnedRobot,
    assemble,
    check_hardware_type,
    report,
    warn_of_overlaps,
)
from slidectl.simulation.loop import Loop

RESERVED = ("world", "map")
"""What gazebo_ros takes for the world wherever it could be a model: such a robot could not be told from it."""


class Newcomer(NamedTuple):
    """A robot that was read and not spawned yet: its full namespace, what it is on paper, and its URDF."""

    name: str
    namespace: str
    paper: Robot
    xml: str
    note: str
    """Where its lines were written, and its meshes found."""
    caller: int
    """The session id of the process that asks for it, 0 when nobody knows."""


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

    def spawn(
        self, xml: str, name: str, namespace: str | None = None, pose: Pose = ORIGIN, hulls: Hulls | None = None
    ) -> SpawnedRobot:
        """Parse, attach, and bring up hardware, controller manager and services: all or nothing.

        The namespace is the one given, else the plugin's robotNamespace (an empty one is the root), else `/name`.
        `hulls` has what its meshes collide as; without it their files are read now.

        Raises:
            BadFile: the URDF is broken (file, line). Refused: the name or the namespace is taken. BadName.
            SlidectlError: the world or the hardware cannot take it. Nothing is left behind then.
        """
        return self._spawn(self.read(xml, name, namespace), pose, hulls)

    def read(self, xml: str, name: str, namespace: str | None = None) -> Newcomer:
        """A robot that may be spawned as far as one can tell without its meshes. Raises as `spawn`."""
        self._check_name(name)
        urdf, note = source_note.split(xml)
        note = note or self.sources.get(source_note.digest(urdf))
        paper = description.parse(source_note.join(urdf, note))
        check_hardware_type(paper)
        return Newcomer(name, self._namespace(name, namespace, paper), paper, urdf, note, self._loop.graph.caller)

    def spawn_read(self, newcomer: Newcomer, pose: Pose, hulls: Hulls) -> SpawnedRobot:
        """Spawn what was read some cycles ago. Raises as `spawn`: others may have come meanwhile."""
        self._check_name(newcomer.name)
        self._check_namespace(newcomer.namespace)
        return self._spawn(newcomer, pose, hulls)

    def _spawn(self, newcomer: Newcomer, pose: Pose, hulls: Hulls | None) -> SpawnedRobot:
        self._loop.between_cycles("spawn a robot")
        name, place, paper = newcomer.name, newcomer.namespace, newcomer.paper
        robot = SpawnedRobot(name, place, paper, newcomer.xml, self._loop.graph.node(place))
        robot.caller = newcomer.caller
        with self._world.attached(paper, name, pose, hulls) as robot.body, ExitStack() as undoing:
            assemble(robot, self._world, self._loop, self.companions, undoing)
            undoing.callback(self._forget, robot)
            self._robots[name] = robot
            self._tell_loop()
            report(robot)
            warn_of_overlaps(robot, self._world)
            robot.taken = undoing.pop_all()
        if newcomer.note:
            self.sources.put(source_note.digest(newcomer.xml), newcomer.note)
        return robot

    def delete(self, name: str) -> None:
        """Take all that belongs to the robot out of the world, and stop its controllers. Raises UnknownName.

        What can fail is done first, all or nothing. After that the robot is gone, whatever its controllers and those
        who listen make of it: their errors are on the log.
        """
        self._loop.between_cycles("delete a robot")
        robot = self.get(name)
        self._world.detach(name)
        try:
            with ExitStack() as ending:  # what is put on last comes first, and the rest comes whatever fails
                ending.callback(robot.taken.close)
                robot.manager.stop_running(robot.node.now_ns())
        except Exception as error:
            text = f"{name} is deleted, but not all went well: {type(error).__name__}: {error}"
            self._loop.graph.log("error", robot.node.name, text)

    def _forget(self, robot: SpawnedRobot) -> None:
        self._robots.pop(robot.name, None)
        self._tell_loop()

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
        self._check_namespace(namespace)
        return namespace

    def _check_namespace(self, namespace: str) -> None:
        taken = {robot.namespace: robot.name for robot in self}
        if namespace in taken:
            raise Refused(
                f"the namespace {namespace} belongs to robot {taken[namespace]!r} already",
                "give this one another namespace",
            )
