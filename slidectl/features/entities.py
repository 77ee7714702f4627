"""Robots and models for the simulator services: found by name, read in frames of reference, spawned and moved.

`/gazebo` and the services of simulation_interfaces both use it. It knows neither topics nor services.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from slidectl.control.node_handle import Message
from slidectl.description import sdf
from slidectl.effects import Effect
from slidectl.errors import AmbiguousName, Refused, SlidectlError, UnknownName
from slidectl.features.gazebo_frames import STILL, WORLD, Frame, into_world, pose, seen_from
from slidectl.physics import hulls
from slidectl.physics.hulls import Hulls
from slidectl.physics.world import Twist
from slidectl.rotations import Pose, compose
from slidectl.simulation.pending import Pending
from slidectl.simulation.spawned_robots import ParsedRobot, SpawnedRobot

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

WORLD_FRAMES = ("", "world", "map", "/map", "/world")
_MOST_TAGS = 25_000
"""The most elements of a URDF: about a thousand links. Reading more would block the world."""

Placed = tuple[ParsedRobot, Pose]
"""A parsed robot, and its pose in the world."""


class Entities:
    """The entities of one simulation. A link or joint is named `model::link`; the model may be left out when only one
    robot has a part of that name."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._world = simulation.world
        self._robots = simulation.robots

    # Names, and frames of reference

    def find(self, kind: Literal["link", "joint"], name: str) -> tuple[str, str]:
        """The robot and the link (or joint) that `name` means.

        Raises:
            UnknownName: there is none. AmbiguousName: several robots have one of that name.
        """
        known = [
            f"{robot.name}::{part}"
            for robot in self._robots
            for part in (robot.description.links if kind == "link" else robot.description.joints)
        ]
        matches = [full for full in known if full == name or ("::" not in name and full.endswith(f"::{name}"))]
        if not matches:
            raise UnknownName(kind, name, known)
        if len(matches) > 1:
            raise AmbiguousName(kind, name, matches, "write the full name: ROBOT::NAME")
        robot, _, part = matches[0].partition("::")
        return robot, part

    def link_frame(self, robot: str, link: str) -> Frame:
        """Pose and twist of a link. Raises UnknownName."""
        return Frame(self._world.link_pose(robot, link), self._world.link_twist(robot, link))

    def model_frame(self, robot: str) -> Frame:
        """Pose and twist of a robot: that of its root link. Raises UnknownName."""
        return self.link_frame(robot, self._robots.get(robot).description.root)

    def frame(self, name: str) -> Frame:
        """A frame of reference: the world, a model, or a link. Raises UnknownName, AmbiguousName."""
        if name in WORLD_FRAMES:
            return WORLD
        return self.model_frame(name) if name in self._robots else self.link_frame(*self.find("link", name))

    def set_state(self, name: str, place: Pose | None, moving: Twist | None, viewer: Frame) -> None:
        """Set the pose and the twist of a robot's root, expressed in `viewer`; None keeps the present one.

        Raises UnknownName, and Refused: a twist for a robot fixed to the world, or numbers that are not finite.
        """
        robot, present = self._robots.get(name), self.model_frame(name)
        if robot.description.is_fixed_to_world and moving not in (None, STILL):
            raise Refused(f"{name!r} is fixed to the world and cannot have a twist", "leave the twist out")
        seen = seen_from(present, viewer)
        there = into_world(Frame(place or seen.pose, moving or seen.twist), viewer)
        self._world.set_pose(
            name, there.pose if place is not None else present.pose, there.twist if moving is not None else None
        )

    # Spawning

    def read_request(self, request: Message, *, is_sdf: bool) -> list[Placed]:
        """Parse what a gazebo_msgs/SpawnModel request spawns. Raises as Robots.read."""
        xml, name, namespace = request["model_xml"], request["model_name"], request["robot_namespace"] or None
        place = compose(self.frame(request["reference_frame"]).pose, pose(request["initial_pose"]))
        return self.read_sdf(xml, name, namespace, place) if is_sdf else [(self.read(xml, name, namespace), place)]

    def read(self, xml: str, name: str, namespace: str | None, *, is_model: bool = False) -> ParsedRobot:
        """Parse a robot from URDF. Raises as Robots.read."""
        check_size("URDF", xml)
        return self._robots.read(xml, name, namespace, is_model=is_model)

    def read_sdf(self, xml: str, name: str, namespace: str | None, place: Pose) -> list[Placed]:
        """Parse the parts of one model from SDF or, as in Gazebo, from URDF.

        A part gets no controller manager, unless it is URDF with transmissions or the control plugin. Raises as
        Robots.read.
        """
        check_size("SDF", xml)
        if sdf.is_urdf(xml):
            return [(self._robots.read(xml, name, namespace, is_model=True), place)]
        may_use_files = Effect.FILES in self._simulation.graph.services.permitted
        parts = self._simulation.host.read_or_raise(
            f"SDF of {name}",  # it may include other files
            lambda: [
                (part.xml, part.name, part.pose)
                for part in sdf.parse(xml, "model_xml", may_use_files=may_use_files).named(name)
            ],
        )
        return [
            (self._robots.read(text, part, namespace, is_model=True), compose(place, (tuple(xyz), tuple(turn))))
            for text, part, (xyz, turn) in parts
        ]

    def spawn(self, read: list[Placed]) -> Pending:
        """Spawn all of them or none: at once, or when their meshes are read; with a driver the world runs meanwhile.

        Resolved with the robots (SpawnedRobot).
        """
        meshes = list(dict.fromkeys(source for one, _ in read for source in hulls.sources(one.description)))
        if not meshes:
            return Pending.of(self._spawn_now(read, {}))

        def go_on(hulls_read: Pending) -> list[SpawnedRobot]:
            try:
                return self._spawn_now(read, hulls_read.result())
            except SlidectlError:
                raise
            except Exception as error:  # only the caller would see it
                raise Refused(f"{read[0][0].name!r} cannot be spawned: {type(error).__name__}: {error}") from error

        return self._simulation.host.read_meshes(meshes).converted(go_on)

    def _spawn_now(self, read: list[Placed], known: Hulls) -> list[SpawnedRobot]:
        spawned: list[SpawnedRobot] = []
        try:
            for one, place in read:
                spawned.append(self._robots.spawn_read(one, place, known))
        except BaseException:
            for robot in reversed(spawned):
                self._robots.delete(robot.name)
            raise
        return spawned


def check_size(kind: str, xml: str) -> None:
    """Raise Refused for too many elements: reading them would block the world."""
    tags = xml.count("<") - xml.count("</")
    if tags > _MOST_TAGS:
        raise Refused(f"the {kind} has {tags} tags; the maximum is {_MOST_TAGS}")
