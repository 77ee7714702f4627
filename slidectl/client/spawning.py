"""A spawn: what is read from a robot's files, the plan that follows from it, and how a client carries it out.

A plan says everything before anything is changed: parameters, models, positions of joints, controllers. `Spawn` sends
its requests in that order and takes back what a refusal has made void. The description package is imported inside the
functions: a script that spawns nothing, and every other command, starts without it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slidectl import names, rotations
from slidectl.client.manager import Manager, configured
from slidectl.client.parameter_client import json_of
from slidectl.errors import NoDaemon, NotThere, Refused, SlidectlError, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client.connection import GraphClient
    from slidectl.description import Document, Packages
    from slidectl.description.missing import Missing
    from slidectl.description.robot import Robot
    from slidectl.description.sdf import Scene, SdfModel
    from slidectl.msgs.typed import RobotInfoMsg

Tree = dict[str, Any]
Message = dict[str, Any]

LIMIT_S = 30.0
"""Limit of the spawn of one model, in wall seconds: meshes are read and shapes built."""
FARTHEST = 1e6
"""The largest coordinate, in m or rad. The physics fails at 1e10, and models become unstable long before."""


def document(
    source: str,
    arguments: Mapping[str, str],
    name: str | None,
    places: Packages | None = None,
    missing: Missing | None = None,
    title: str | None = None,
) -> Document:
    """Expand the model. An xacro argument `namespace` is set to `/name` unless given or a part of names.

    `places` is where packages are; by default they are searched from the working folder upwards. Raises BadFile,
    UnknownName.
    """
    from slidectl import description

    places = places or description.Packages({}, Path.cwd())
    if name and "namespace" not in arguments and description.takes_namespace(source, places):
        arguments = {**arguments, "namespace": f"/{names.legal_robot(name)}"}
    return description.load(source, dict(arguments), places, title=title, missing=missing)


def rooted(xml: str, file: str, fixed: bool | None) -> str:
    """The URDF with its root fixed to the world, or free; unchanged for None."""
    from slidectl import description

    if fixed is None:
        return xml
    return description.with_root_fixed(xml, file) if fixed else description.with_root_free(xml, file)


def is_scene(source: str) -> bool:
    """True for an SDF model: a .sdf or .world file, or `model://NAME`."""
    from slidectl.description import sdf

    return sdf.is_scene(source)


def check_scene_options(
    arguments: Mapping[str, str],
    controllers: str | None = None,
    start: Sequence[str] = (),
    joints: Mapping[str, float] | None = None,
    transmissions: str | None = None,
    namespace: str | None = None,
) -> None:
    """Raise UsageError for options that only a URDF or xacro robot has."""
    if arguments:
        raise UsageError(f"SDF takes no arguments: {', '.join(arguments)}")
    if joints:
        raise UsageError(f"SDF models take no joint positions: {', '.join(joints)}")
    if controllers is not None or start:
        raise UsageError("SDF models have no controllers", "describe a robot that is driven in URDF or xacro")
    if transmissions is not None:
        raise UsageError("SDF models have no transmissions", "describe a robot that is driven in URDF or xacro")
    if namespace is not None:
        raise UsageError("SDF models have no controllers, and need no namespace of these")


def scene(source: str, places: Packages | None = None, missing: Missing | None = None) -> Scene:
    """The models of an SDF file, of a world, or of `model://NAME`. Raises BadFile, NotThere: it has no models."""
    from slidectl import description
    from slidectl.description import sdf

    places = places or description.Packages({}, Path.cwd())
    found = sdf.read(sdf.find(source, places), places, missing)
    if missing is not None:
        missing.refuse()
    if not found.models:
        raise NotThere(f"no model is left to spawn in {source}")
    return found


def pose(at: Sequence[float], what: str = "at") -> rotations.Pose:
    """The pose of X Y Z (m), or X Y Z R P Y (rad). Raises UsageError; `what` names the option in the text."""
    given = " ".join(f"{value:g}" for value in at)
    if len(at) not in (0, 3, 6):
        raise UsageError(f"{what} takes X Y Z or X Y Z R P Y, not {given}")
    if not all(map(math.isfinite, at)):
        raise UsageError(f"{what} takes finite numbers, not {given}")
    if any(abs(value) > FARTHEST for value in at):
        raise UsageError(f"{what} takes numbers up to ±{FARTHEST:g} (m, rad), not {given}")
    x, y, z, roll, pitch, yaw = (*at, *[0.0] * (6 - len(at)))
    return (x, y, z), rotations.from_rpy((roll, pitch, yaw))


def request(name: str, xml: str, at: rotations.Pose, **options: str) -> Message:
    """A gazebo_msgs/SpawnModel request."""
    place = {"position": dict(zip("xyz", at[0], strict=True)), "orientation": rotations.message(at[1])}
    return {"model_name": name, "model_xml": xml, "initial_pose": place, **options}


# --- the plan ---------------------------------------------------------------------------------------------------------


@dataclass
class SpawnPlan:
    """What a spawn does, in this order: parameters, models, positions of joints, controllers."""

    models: list[Message]
    """gazebo_msgs/SpawnModel requests: a robot of a URDF, or the models of a scene, which are spawned all or none."""
    is_scene: bool = False
    namespace: str = ""
    """That of the robot's controller manager; empty for a scene."""
    robot: Robot | None = None
    """The robot of a URDF, as far as it was read for the plan."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Start positions of joints, in rad or m."""
    parameters: Tree = field(default_factory=dict)
    """By full name. They are set before the robot is there, because its hardware reads some."""
    controllers: list[str] = field(default_factory=list)
    """Those to load, and to start in one cycle."""
    own_files: list[str] = field(default_factory=list)
    """Files of parameters that the model itself names; they count where the user gives none."""
    warnings: list[str] = field(default_factory=list)
    """What the model asks for and does not get."""


def robot_plan(
    model: Document,
    at: rotations.Pose,
    name: str | None = None,
    *,
    fixed: bool | None = None,
    joints: Mapping[str, float] | None = None,
    transmissions: str | None = None,
    strict: bool = False,
    namespace: str | None = None,
) -> SpawnPlan:
    """The plan of a robot of a URDF.

    Args:
        name: any text; what is no graph name becomes one. By default the model's.
        fixed: fix its root to the world, or free it; None leaves the model as it is.
        joints: start positions of joints, rad or m.
        transmissions: `gazebo` or `real`; overrides the model.
        strict: refuse impossible masses, inertias and shapes.
        namespace: of its controllers; by default the model's.

    Raises:
        BadFile: the model is broken. BadName. UnknownName: no such moving joint. Refused: a position out of range.
    """
    from slidectl import description
    from slidectl.description.robot import MOVING, check_position

    xml = rooted(model.xml, model.file, fixed)
    if transmissions is not None:
        xml = description.with_transmissions(xml, transmissions, model.file)
    robot = description.parse(xml, model.file, strict=strict)
    chosen = names.legal_robot(robot.name if name is None else name)
    moving = {one.name: one for one in robot.joints.values() if one.type in MOVING}
    for joint, position in (joints or {}).items():
        if joint not in moving:
            raise UnknownName("moving joint", joint, list(moving), f"on robot {chosen!r}")
        check_position(moving[joint], position)
    place = description.namespace_of(robot, chosen) if namespace is None else names.check("/" + namespace.strip("/"))
    plan = SpawnPlan([request(chosen, xml, at)], namespace=place, robot=robot, joints=joints or {})
    if robot.ros2_control is not None:
        plan.own_files, plan.warnings = _own_files(
            robot.ros2_control.parameter_files, Path(model.file).absolute().parent
        )
    return plan


def _own_files(named: Sequence[str], folder: Path) -> tuple[list[str], list[str]]:
    """The files of parameters that a model in `folder` names and may have, and a warning about each other one.

    It may have those beside it or in a package: it can be a stranger's, and all clients of the world see parameters.
    """
    from slidectl.description.install_rules import located
    from slidectl.description.packages import is_file, package_of

    files, warnings = [], []
    for file in named:
        path = located(folder / file)
        why = ""
        if not is_file(path):
            why = "are not there"
        elif folder.resolve() not in (real := path.resolve()).parents and package_of(real) is None:
            why = "are neither beside the model nor in a package, and are left out"
        if why:
            warnings.append(f"the model's plugin names the parameters {file}, which {why}: --controllers FILE")
        else:
            files.append(str(path))
    return files, warnings


def scene_plan(
    models: Sequence[SdfModel],
    at: rotations.Pose = rotations.ORIGIN,
    *,
    fixed: bool | None = None,
    strict: bool = False,
    **options: str,
) -> SpawnPlan:
    """The plan of models of SDF, each at its own pose moved by `at`; `fixed` and `strict` as in `robot_plan`.

    `options` are further fields of the gazebo_msgs/SpawnModel requests.
    """
    requests = []
    for model in models:
        xml = rooted(model.xml, model.file, fixed)
        if strict:
            from slidectl import description

            description.parse(xml, model.file, strict=True)
        place = rotations.compose(at, model.pose)
        requests.append(request(names.legal_robot(model.name), xml, place, **options))
    return SpawnPlan(requests, is_scene=True)


# --- carrying it out --------------------------------------------------------------------------------------------------


class SpawnRefused(Refused):
    """The world did not take a model. `reason` is what it said: the reason, and lines with hints."""

    def __init__(self, model: str, reason: str) -> None:
        super().__init__(f"cannot spawn {model}: {reason}")
        self.reason = reason


class Spawn:
    """Carries out a plan on a client's world: `apply`, then `bring_up`.

    For a robot with two controllers these are five requests in four round trips, without `robot`.

    Args:
        limit_s: limit of the spawn of one model, in wall seconds.
    """

    def __init__(
        self,
        client: GraphClient,
        plan: SpawnPlan,
        limit_s: float = LIMIT_S,
    ) -> None:
        self.client = client
        self.plan = plan
        self._limit_s = limit_s

    @property
    def names(self) -> list[str]:
        """The names of the models."""
        return [str(model["model_name"]) for model in self.plan.models]

    def unknown_controllers(self) -> list[UnknownName]:
        """An error for each of the plan's controllers that no parameter describes, there or in the plan."""
        plan = self.plan
        known = configured(list(plan.parameters), plan.namespace)
        if set(plan.controllers) <= set(known):
            return []
        there = self.client.call("/rosapi/get_param_names")["names"]
        known = configured(sorted({*there, *plan.parameters}), plan.namespace)
        where = f"in the parameters of {plan.namespace}"
        return [UnknownName("controller", name, known, where) for name in plan.controllers if name not in known]

    def apply(self) -> tuple[list[RobotInfoMsg], list[str]]:
        """Set the parameters, spawn the models and put the joints. Returns the robots, and the world's warnings.

        For a scene the world is paused meanwhile, so that no cycle runs between the requests.

        Raises:
            Refused: no model is left in the world; parameters stay.
        """
        plan = self.plan
        if not plan.is_scene:
            return self._spawn_model(plan.models[0])
        _check_all_free(self.client.call("/slidectl/list_robots")["robots"], self.names)
        robots: list[RobotInfoMsg] = []
        warnings: list[str] = []
        with self._undone_on_failure() as there:
            for model in plan.models:
                spawned, told = self._spawn_model(model)
                there.append(model["model_name"])  # after the call: a refused name may be another model's
                robots += spawned
                warnings += told
        return robots, warnings

    def _spawn_model(self, model: Message) -> tuple[list[RobotInfoMsg], list[str]]:
        plan = self.plan
        joints = {} if model is not plan.models[0] else plan.joints
        request = {
            **model,
            "sdf": plan.is_scene,
            "robot_namespace": model.get("robot_namespace") or plan.namespace,
            "parameter_names": list(plan.parameters),
            "parameter_values": [json_of(name, value) for name, value in plan.parameters.items()],
            "joint_names": list(joints),
            "joint_positions": list(joints.values()),
        }
        try:
            answer = self.client.call("/slidectl/spawn", request, timeout=self._limit_s)
        except Refused as error:
            raise SpawnRefused(model["model_name"], str(error)) from None
        return answer["robots"], answer["warnings"]

    @contextmanager
    def _undone_on_failure(self) -> Iterator[list[str]]:
        """Pause the world inside the context. On an exception, delete the models in the list that it gives."""
        was_running = not self.client.call("/slidectl/status")["paused"]
        there: list[str] = []
        if was_running:
            self.client.call("/gazebo/pause_physics")
        try:
            yield there
        except BaseException:
            for name in reversed(there):
                with suppress(SlidectlError):
                    self.client.call("/gazebo/delete_model", {"model_name": name})
            raise
        finally:
            if was_running:
                with suppress(NoDaemon):
                    self.client.call("/gazebo/unpause_physics")

    def robot(self) -> RobotInfoMsg:
        """The first model as it is in the world now (slidectl/RobotInfo)."""
        return self.client.call("/slidectl/list_robots", {"name": self.names[0]})["robots"][0]

    def ask_to_load(self, manager: Manager) -> dict[str, str]:
        """Send the requests to load the controllers, for `bring_up`. The robot is new, so none is loaded yet."""
        return manager.ask_to_load(self.plan.controllers)

    def bring_up(
        self,
        manager: Manager,
        loads: dict[str, str],
        left_out: Callable[[str, Refused], None] | None = None,
    ) -> list[str]:
        """Start the controllers, whose loads are under way, in one cycle. Returns their names.

        With `left_out` each is started that can be, and it gets the others with their errors. Raises Refused.
        """
        wanted, robot = self.plan.controllers, self.plan.robot
        configures = robot is None or robot.ros2_control is not None
        if left_out is None:
            if wanted:
                manager.bring_up(wanted, states={}, loads=loads, configures=configures)
            return wanted
        there = []
        for name, load in loads.items():
            try:
                manager.bring_up([name], states={}, loads={name: load}, configures=configures)
            except Refused as error:
                left_out(name, error)
            else:
                there.append(name)
        return there


def _check_all_free(robots: Sequence[Mapping[str, Any]], names: Sequence[str]) -> None:
    taken = sorted({robot["name"] for robot in robots} & set(names))
    if taken:
        there = ", ".join(repr(name) for name in taken)
        raise Refused(f"already in the world: {there}", f"slidectl delete {' '.join(taken)}")


# --- files of controllers ---------------------------------------------------------------------------------------------


def find(file: str) -> Path:
    """The file, else the shipped file of that name, so that the tutorials' commands work in any folder."""
    from slidectl.paths import share

    path = Path(os.path.expanduser(file))
    shipped = share("config") / path.name
    if not path.exists() and path.parent.name in ("", "config") and shipped.exists():
        return shipped
    return path


def controller_parameters(files: Sequence[str], namespace: str) -> Tree:
    """The parameters of files by full name, for the robot in `namespace`; a later file counts. Raises BadFile."""
    from slidectl.description import controllers_file

    parameters: Tree = {}
    for file in files:
        tree, _ = controllers_file.retarget(controllers_file.read(find(file), []), namespace)
        parameters.update(leaves(tree))
    return parameters


def placements(tree: Tree, namespaces: Sequence[str]) -> tuple[Tree, str | None, bool]:
    """The tree moved to the best matching namespace, a remark, and whether it was changed."""
    from slidectl.description.controllers_file import retarget

    best: tuple[Tree, str | None, bool] = (tree, None, False)
    for namespace in reversed(namespaces):
        placed, remark = retarget(tree, namespace)
        if placed is tree and remark is None:
            return tree, None, False
        best = (placed, remark, placed is not tree)
    return best


def leaves(tree: Tree, namespace: str = "/") -> Iterator[tuple[str, Any]]:
    """Full name and value of every parameter in a tree. Lists and empty mappings are values.

    A key that begins with a slash is an absolute name, as with rosparam.
    """
    for key, value in tree.items():
        name = names.check_parameter(names.join(namespace, key.rstrip("/")))
        if isinstance(value, dict) and value:
            yield from leaves(value, name)
        else:
            yield name, value
