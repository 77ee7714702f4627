"""`slidectl spawn`: expand a model here, load its controllers' parameters, have the daemon put it into the world.

The order of the checks matters: nothing of the world or of the parameters changes before the rest is known to be right.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl import names, rotations
from slidectl.cli import configuration, live, robots
from slidectl.cli.bringup import bring_up
from slidectl.cli.commands import Variadic, command, looks_like_number
from slidectl.cli.context import Context
from slidectl.cli.managers import Manager
from slidectl.errors import BadFile, Refused, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.description import Document

SPAWN_LIMIT_S = 30.0


@command(
    examples=[
        "slidectl spawn slider --controllers config/slider_control.yaml",
        "slidectl spawn slider -n left --at 0 1 0 --controllers config/slider_control.yaml"
        " --start joint_state_controller",
        "slidectl spawn models/rrbot.xacro --fixed",
    ]
)
@click.argument("model", shell_complete=live.models)
@click.argument("arguments", nargs=-1, metavar="[KEY:=VALUE]...")
@click.option("-n", "--name", metavar="NAME", help="Name of the robot; by default that of the model.")
@click.option(
    "--at", cls=Variadic, type=float, takes=looks_like_number, metavar="X Y Z [R P Y]", help="Place, m and rad."
)
@click.option("--fixed/--free", "fixed", default=None, help="Fix the root to the world, or free it.")
@click.option("--controllers", metavar="FILE", shell_complete=live.files, help="Parameters of its controllers (YAML).")
@click.option("--start", cls=Variadic, metavar="CONTROLLER...", help="Load and start these controllers.")
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", help="Where a ROS package is; may repeat.")
@click.pass_obj
def spawn(
    ctx: Context,
    model: str,
    arguments: tuple[str, ...],
    name: str | None,
    at: tuple[float, ...],
    fixed: bool | None,
    controllers: str | None,
    start: tuple[str, ...],
    packages: tuple[str, ...],
) -> None:
    """Put a robot into the world.

    MODEL is a .xacro or .urdf file, a shipped model (slider, rrbot), or - for standard input. KEY:=VALUE are xacro
    arguments; a model with an argument `namespace` gets /NAME for it when -n is given. A root link called `world` is
    fixed, any other is free. JSON keys: name, namespace, fixed, pose, links, joints, controllers, report.
    """
    if name is not None:
        names.check_robot(name)
    document = _document(ctx, model, pairs(arguments, ":="), name, pairs(packages, "="))
    xml = _rooted(document, fixed)
    pose = _pose(at)
    wanted, namespace = _identity(xml, document, name)
    _check_free(ctx, wanted, namespace)
    if controllers is not None:
        configuration.store(ctx, configuration.read(ctx, controllers, [namespace]))
    manager = Manager(ctx, namespace)
    _check_configured(manager, start)
    _request(ctx, wanted, xml, pose)
    _tell_report(ctx, wanted, document)
    try:
        bring_up(manager, start)
    except Refused:
        _tell(ctx, wanted)
        raise
    _tell(ctx, wanted)


def pairs(words: Sequence[str], sign: str, command: str = "spawn") -> dict[str, str]:
    """`key:=value` words as a mapping. Raises UsageError."""
    for word in words:
        if not word.partition(sign)[0] or sign not in word:
            hint = f"slidectl {command} --help shows the order of arguments"
            raise UsageError(f"{word!r} is not KEY{sign}VALUE", hint)
    return {key: value for key, _, value in (word.partition(sign) for word in words)}


def _document(
    ctx: Context, model: str, arguments: dict[str, str], name: str | None, packages: dict[str, str]
) -> Document:
    from slidectl import description

    places = description.Packages({key: Path(value) for key, value in packages.items()})
    source = _noted(ctx, _standard_input()) if model == "-" else model
    if name and "namespace" not in arguments and "namespace" in description.declared_arguments(source, places):
        arguments = {**arguments, "namespace": f"/{name}"}
    return description.load(source, arguments, places, title="<stdin>" if model == "-" else None)


def _noted(ctx: Context, xml: str) -> str:
    """A text with what the daemon knows of its sources: it may be a parameter's, as `slidectl param get` prints it."""
    from slidectl.description import source_note

    answer = ctx.call("/slidectl/sources", {"digest": source_note.digest(xml)})
    return source_note.join(xml, answer["note"])


def _standard_input() -> str:
    text = sys.stdin.buffer.read().decode("utf-8", "replace")
    text = parameter_text(text)
    if not text.lstrip("\ufeff \t\r\n").startswith("<"):
        raise BadFile("is no XML", "<stdin>", hint="pipe a URDF in, or name a model")
    return text


_YAML_TEXTS = ('"', "'", "|", ">")
"""How a text of several lines begins in YAML."""


def parameter_text(text: str) -> str:
    """The robot in a text that `param get` and rosparam print as YAML; anything else as it is."""
    if text.lstrip()[:1] not in _YAML_TEXTS:
        return text
    import yaml

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    return value if isinstance(value, str) and value.lstrip().startswith("<") else text


def _rooted(document: Document, fixed: bool | None) -> str:
    from slidectl import description

    if fixed is None:
        return document.xml
    change = description.with_root_fixed if fixed else description.with_root_free
    return change(document.xml, document.file)


def _pose(at: Sequence[float]) -> dict[str, Any]:
    """geometry_msgs/Pose of `--at`. Raises UsageError."""
    given = " ".join(f"{value:g}" for value in at)
    if len(at) not in (0, 3, 6):
        raise UsageError(f"--at takes X Y Z or X Y Z R P Y, not {given}")
    if not all(map(math.isfinite, at)):
        raise UsageError(f"--at takes finite numbers, not {given}")
    x, y, z, roll, pitch, yaw = (*at, *[0.0] * (6 - len(at)))
    turn = rotations.from_rpy((roll, pitch, yaw))
    return {"position": {"x": x, "y": y, "z": z}, "orientation": rotations.message(turn)}


def _identity(xml: str, document: Document, name: str | None) -> tuple[str, str]:
    """The robot's name and namespace. Raises BadFile when the model is broken, BadName."""
    from slidectl import description

    robot = description.parse(xml, document.file)
    chosen = names.check_robot(robot.name if name is None else name)
    return chosen, description.namespace_of(robot, chosen)


def _check_free(ctx: Context, name: str, namespace: str) -> None:
    """Raise Refused when the name or the namespace is taken, before any parameter is touched."""
    for robot in robots.all_robots(ctx):
        if robot["name"] == name:
            raise Refused(
                f"a robot {name!r} is there already", f"give another name with -n, or: slidectl delete {name}"
            )
        if robot["namespace"] == namespace:
            hint = "a model with an xacro argument `namespace` gets its own with -n NAME"
            raise Refused(f"the namespace {namespace} is that of the robot {robot['name']!r}", hint)


def _check_configured(manager: Manager, start: Sequence[str]) -> None:
    known = manager.configured() if start else []
    for name in start:
        if name not in known:
            raise UnknownName("controller", name, known, f"in the parameters of {manager.namespace}")


def _request(ctx: Context, name: str, xml: str, pose: dict[str, Any]) -> None:
    request = {"model_name": name, "model_xml": xml, "initial_pose": pose}
    answer = ctx.call("/gazebo/spawn_urdf_model", request, ctx.wait_limit(SPAWN_LIMIT_S))
    if not answer["success"]:
        raise Refused(f"cannot spawn {name}: {answer['status_message']}")


def _tell_report(ctx: Context, name: str, document: Document) -> None:
    """What became of the tags: wrong ones in full, the others counted unless `-v`."""
    for notice in document.report:
        ctx.warn(str(notice))
    report = robots.find(robots.all_robots(ctx), name)["report"]
    for notice in report:
        if ctx.verbose or notice["verdict"] == "wrong":
            ctx.warn(robots.notice_text(notice))
    if not ctx.verbose:
        ctx.say(robots.summary(name, report))


def _tell(ctx: Context, name: str) -> None:
    robot = robots.record(robots.find(robots.all_robots(ctx), name))
    # Where the physics diverges at once the pose is no number, which is null on the wire.
    x, y, z = (math.nan if value is None else round(value, 3) + 0.0 for value in robot["pose"][:3])
    joints = " ".join(robots.moving(robot)) or "none"
    ctx.done(robot, f"{name}: spawned in {robot['namespace']} at {x:g} {y:g} {z:g}, joints: {joints}")
