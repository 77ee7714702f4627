"""Reading a robot's files for a spawn: the model, its name and pose, and its controllers' parameters.

It knows no connection. The description package is imported inside the functions: a script that spawns nothing, and
every other command, starts without it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slidectl import names, rotations
from slidectl.errors import NotThere, Refused, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.description import Document, Packages
    from slidectl.description.missing import Missing
    from slidectl.description.robot import Robot
    from slidectl.description.sdf import Scene, SdfModel

Tree = dict[str, Any]

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
    """Expand the model. An xacro argument `namespace` is set to `/name` unless given. Raises BadFile, UnknownName.

    `places` is where packages are; by default they are searched from the working folder upwards.
    """
    from slidectl import description

    places = places or description.Packages({}, Path.cwd())
    if name and "namespace" not in arguments and "namespace" in description.declared_arguments(source, places):
        arguments = {**arguments, "namespace": f"/{names.legal_robot(name)}"}
    return description.load(source, dict(arguments), places, title=title, missing=missing)


def with_transmissions(model: Document, how: str | None, xml: str | None = None) -> str:
    """The URDF `xml`, by default the model's, with transmissions of the kind `how`; None leaves them unchanged."""
    from slidectl import description

    xml = model.xml if xml is None else xml
    return xml if how is None else description.with_transmissions(xml, how, model.file)


def identity(
    xml: str, model: Document, name: str | None, strict: bool = False, joints: Mapping[str, float] | None = None
) -> tuple[str, str, Robot]:
    """The robot's name, made legal, its namespace, and the robot. `joints` holds start positions of joints, rad or m.

    Raises:
        BadFile: the model is broken. BadName. UnknownName: no such moving joint. Refused: a position out of range.
    """
    from slidectl import description
    from slidectl.description.robot import MOVING, check_position

    robot = description.parse(xml, model.file, strict=strict)
    chosen = names.legal_robot(robot.name if name is None else name)
    moving = {one.name: one for one in robot.joints.values() if one.type in MOVING}
    for joint, position in (joints or {}).items():
        if joint not in moving:
            raise UnknownName("moving joint", joint, list(moving), f"on robot {chosen!r}")
        check_position(moving[joint], position)
    return chosen, description.namespace_of(robot, chosen), robot


def check_free(robots: Sequence[Mapping[str, Any]], name: str, namespace: str) -> None:
    """Raise Refused when the name or the namespace is taken, before any parameter is touched."""
    for robot in robots:
        if robot["name"] == name:
            raise Refused(
                f"a robot {name!r} is there already", f"give another name with -n, or: slidectl delete {name}"
            )
        if robot["namespace"] == namespace and robot["kind"] == "robot":
            hint = "a model with an xacro argument `namespace` gets its own with -n NAME"
            raise Refused(f"the namespace {namespace} is that of the robot {robot['name']!r}", hint)


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
) -> None:
    """Raise UsageError for options that only a URDF or xacro robot has."""
    if arguments:
        raise UsageError(f"SDF takes no arguments: {', '.join(arguments)}")
    if joints:
        raise UsageError(f"models of SDF start as their file says, and not with joints at {', '.join(joints)}")
    if controllers is not None or start:
        raise UsageError("models of SDF have no controllers", "describe a robot that is driven in URDF or xacro")
    if transmissions is not None:
        raise UsageError("models of SDF have no transmissions", "describe a robot that is driven in URDF or xacro")


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


def request(model: SdfModel, at: Sequence[float] = (), what: str = "at") -> dict[str, Any]:
    """A gazebo_msgs/SpawnModel request: the model's own pose moved by X Y Z (m) R P Y (rad)."""
    place = rotations.compose(_pose(at, what), model.pose)
    return {"model_name": names.legal_robot(model.name), "model_xml": model.xml, "initial_pose": _message(place)}


def pose(at: Sequence[float], what: str = "at") -> dict[str, Any]:
    """geometry_msgs/Pose of X Y Z (m), or X Y Z R P Y (rad). Raises UsageError; `what` names the option in the text."""
    return _message(_pose(at, what))


def _message(pose: rotations.Pose) -> dict[str, Any]:
    return {"position": dict(zip("xyz", pose[0], strict=True)), "orientation": rotations.message(pose[1])}


def _pose(at: Sequence[float], what: str) -> rotations.Pose:
    given = " ".join(f"{value:g}" for value in at)
    if len(at) not in (0, 3, 6):
        raise UsageError(f"{what} takes X Y Z or X Y Z R P Y, not {given}")
    if not all(map(math.isfinite, at)):
        raise UsageError(f"{what} takes finite numbers, not {given}")
    if any(abs(value) > FARTHEST for value in at):
        raise UsageError(f"{what} takes numbers up to ±{FARTHEST:g} (m, rad), not {given}")
    x, y, z, roll, pitch, yaw = (*at, *[0.0] * (6 - len(at)))
    return (x, y, z), rotations.from_rpy((roll, pitch, yaw))


# --- files of controllers ---------------------------------------------------------------------------------------------


def find(file: str) -> Path:
    """The file, else the shipped file of that name, so that the tutorials' commands work in any folder."""
    from slidectl.paths import share

    path = Path(os.path.expanduser(file))
    shipped = share("config") / path.name
    if not path.exists() and path.parent.name in ("", "config") and shipped.exists():
        return shipped
    return path


def controller_parameters(file: str, namespace: str) -> Tree:
    """The parameters of a file by full name, for the robot in `namespace`. Raises BadFile."""
    from slidectl.description import controllers_file

    tree, _ = controllers_file.retarget(controllers_file.read(find(file), []), namespace)
    return dict(leaves(tree))


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
