"""`slidectl spawn` and `slidectl urdf`: expand a model; spawn also sends it to the daemon.

The order matters: all checks come before the first change of the world or of the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl import input_files, names, rotations
from slidectl.cli import completion, output, robots
from slidectl.cli.commands import Variadic, command, is_number
from slidectl.cli.context import Context
from slidectl.cli.controller import read_parameters
from slidectl.client import spawning
from slidectl.command_steps import CommandStep, StepEffects
from slidectl.errors import BadFile, NotThere, Refused, SlidectlError, UsageError

if TYPE_CHECKING:
    from slidectl.description import Document, Packages
    from slidectl.description.missing import Missing
    from slidectl.description.sdf import Scene
    from slidectl.msgs.typed import RobotInfoMsg


def _check_words(
    model: str, arguments: tuple[str, ...], packages: tuple[str, ...], joints: tuple[str, ...], **_: Any
) -> None:
    """Raise SlidectlError for wrong words, and for a model that does not exist."""
    from slidectl.description import models, sdf

    _positions(joints)
    places = package_lookup(packages)
    source, _given = in_package(model, arguments, places)
    if source != "-":
        models.read_file(sdf.find(source, places) if spawning.is_scene(source) else models.find(source))


def _step_effects(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:  # noqa: ARG001
    has_own = bool(parameters["start"]) and not parameters["controllers"] and _names_files(parameters)
    return StepEffects(
        controllers=parameters["controllers"] or "", named=tuple(parameters["start"]), model=parameters["model"],
        may_add_controllers=parameters["keep_going"] or has_own,
    )  # fmt: skip


def _names_files(parameters: Mapping[str, Any]) -> bool:
    """True for a model that names files of controllers, as far as it can be read now."""
    try:
        places = package_lookup(parameters["packages"])
        source, given = in_package(parameters["model"], parameters["arguments"], places)
        if source == "-" or spawning.is_scene(source):
            return False
        document = spawning.document(source, given, parameters["name"], places)
        return bool(spawning.robot_plan(document, rotations.ORIGIN).own_files)
    except SlidectlError:  # the step itself tells it
        return False


@command(
    check_words=_check_words,
    step=CommandStep(effects=_step_effects),
    examples=[
        "slidectl spawn slider --controllers config/slider_control.yaml",
        "slidectl spawn slider -n left --at 0 1 0 --controllers config/slider_control.yaml"
        " --start joint_state_controller",
        "slidectl spawn models/rrbot.xacro --fixed",
        "slidectl spawn rrbot --joint joint1=0.5 --joint joint2=-1.2",
        "slidectl spawn rrbot_description rrbot.xacro",
        "slidectl spawn house.world --at 2 0 0",
        "slidectl spawn model://table -n desk",
    ],
)
@click.argument("model", shell_complete=completion.models)
@click.argument("arguments", nargs=-1, metavar="[FILE] [KEY:=VALUE]...")
@click.option("-n", "--name", metavar="NAME", help="Name of the robot; by default that of the model.")
@click.option("--namespace", metavar="NAMESPACE", help="Namespace of its controllers; by default that of the model.")
@click.option(
    "--at",
    cls=Variadic,
    type=float,
    takes=is_number,
    metavar="X Y Z [R P Y]",
    help="Place in the world, m; roll, pitch and yaw about its axes, rad.",
)
@click.option(
    "--joint", "joints", multiple=True, metavar="JOINT=POSITION", help="Where it starts, rad or m; may repeat."
)
@click.option("--fixed/--free", "fixed", default=None, help="Fix the root to the world, or free it.")
@completion.file_option(
    "--controllers", help="Parameters of its controllers (YAML); by default those that a robot of ROS 2 names."
)
@click.option("--start", cls=Variadic, metavar="CONTROLLER...", help="Load and start these controllers.")
@click.option(
    "--transmissions",
    type=click.Choice(["gazebo", "real"]),
    help="Drive joints as gazebo_ros_control does, or through transmissions with their actuators.",
)
@click.option(
    "--strict", is_flag=True, help="Refuse impossible masses, inertias and shapes instead of correcting them."
)
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", help="Where a ROS package is; may repeat.")
@click.option("--keep-going", is_flag=True, help="Leave out missing parts, and list them at the end.")
@click.pass_obj
def spawn(
    ctx: Context,
    model: str,
    arguments: tuple[str, ...],
    name: str | None,
    namespace: str | None,
    at: tuple[float, ...],
    joints: tuple[str, ...],
    fixed: bool | None,
    controllers: str | None,
    start: tuple[str, ...],
    transmissions: str | None,
    strict: bool,
    packages: tuple[str, ...],
    keep_going: bool,
) -> None:
    """Put a robot into the world.

    MODEL is a .xacro or .urdf file, a shipped model (slider, rrbot), a package with FILE as the name of a file in it,
    or - for standard input. KEY:=VALUE are xacro arguments; a model with an argument `namespace` gets /NAME for it
    when -n is given. A root link called `world` is fixed, any other is free. MODEL may also be a .sdf or .world file,
    or model://NAME, which is looked for in GAZEBO_MODEL_PATH: all models in it are spawned, without controllers, or
    none; --at is where the file's origin is. JSON keys: name, namespace, kind, fixed, pose, links, joints, controllers,
    report.
    """
    from slidectl.description import slips
    from slidectl.description.missing import Missing

    missing = Missing("all" if keep_going else "nothing")
    positions = _positions(joints)
    places = package_lookup(packages)
    source, given = in_package(model, arguments, places)
    if spawning.is_scene(source):
        spawning.check_scene_options(given, controllers, start, positions, transmissions, namespace)
        _spawn_scene(ctx, spawning.scene(source, places, missing), name, at, fixed, strict)
        _warn_left_out(ctx, missing)
        return
    document = _document(ctx, source, given, name, places, missing)
    plan = spawning.robot_plan(
        document,
        spawning.pose(at, "--at"),
        name,
        fixed=fixed,
        joints=positions,
        transmissions=transmissions,
        strict=strict,
        namespace=namespace,
    )
    assert plan.robot is not None
    if remark := names.remark_on_robot(plan.robot.name if name is None else name):
        ctx.warn(remark)
    plan.controllers = list(start)
    spawn = spawning.Spawn(ctx.client, plan, ctx.wait_limit(spawning.LIMIT_S))
    _complete(ctx, spawn, controllers, missing, reports_moves=name is None)
    [robot, *_], warnings = spawn.apply()
    loads = spawn.ask_to_load(ctx.manager(plan.namespace))
    if loads:
        robot = spawn.robot()  # in the same round trip
    _print_report(ctx, robot, document, positions)
    for text in (*slips.of_robot(plan.robot), *warnings):
        ctx.warn(text)
    _bring_up(ctx, spawn, robot, loads, controllers, start, missing)


@command(
    examples=[
        "slidectl urdf robot.urdf.xacro width:=0.2 -o robot.urdf",
        "slidectl urdf slider | check_urdf /dev/stdin",
        "slidectl urdf rrbot_description rrbot.xacro",
    ]
)
@click.argument("model", shell_complete=completion.models)
@click.argument("arguments", nargs=-1, metavar="[FILE] [KEY:=VALUE]...")
@click.option("-o", "--output", "target", metavar="FILE", help="Write the URDF into a file.")
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", help="Where a ROS package is; may repeat.")
@click.pass_obj
def urdf(ctx: Context, model: str, arguments: tuple[str, ...], target: str | None, packages: tuple[str, ...]) -> None:
    """Print the URDF that xacro makes of a model, without a daemon.

    MODEL, FILE and KEY:=VALUE are as for spawn; of SDF, a file with one model. Any URDF parser reads what is printed;
    meshes keep the names that the model gives them. JSON keys: urdf, file.
    """
    from slidectl import description

    places = package_lookup(packages, "urdf")
    source, given = in_package(model, arguments, places, "urdf")
    if spawning.is_scene(source):
        spawning.check_scene_options(given)
        document = _single_model(source, places)
    else:
        title = "<stdin>" if source == "-" else None
        text = standard_input() if source == "-" else source
        document = description.load(text, given, places, title=title, as_written=True)
    report_own_packages(ctx, places)
    for notice in document.report:
        ctx.warn(str(notice))
    if target is None:
        if ctx.format == "text":
            output.write(document.urdf.rstrip("\n"))
        else:
            ctx.emit({"urdf": document.urdf, "file": document.file})
        return
    output.save(target, document.urdf)
    ctx.done({"file": target}, f"{target}: written")


def _complete(
    ctx: Context, spawn: spawning.Spawn, controllers: str | None, missing: Missing, reports_moves: bool
) -> None:
    """Read the parameters of the plan, and check its controllers. Those of the model count without `controllers`.

    Raises BadFile, NotThere, UnknownName: a file is broken or missing, or a controller is, and nothing may be.
    """
    plan = spawn.plan
    for text in plan.warnings if controllers is None else ():
        ctx.warn(text)
    for file in plan.own_files if controllers is None else [controllers]:
        try:
            plan.parameters |= read_parameters(ctx, file, [plan.namespace], reports_moves=reports_moves)
        except NotThere as error:
            missing.note(error, "the parameters of controllers are left out")
            missing.refuse()
    for unknown in spawn.unknown_controllers():
        if not missing.keeps_going:
            raise unknown
        _leave_out(missing, unknown.name, unknown)
        plan.controllers.remove(unknown.name)


def _bring_up(
    ctx: Context,
    spawn: spawning.Spawn,
    robot: RobotInfoMsg,
    loads: dict[str, str],
    controllers: str | None,
    start: Sequence[str],
    missing: Missing,
) -> None:
    """Start the controllers, whose loads are under way, and print the robot. Raises Refused: and how to go on."""
    left_out = (lambda name, error: _leave_out(missing, name, error)) if missing.keeps_going else None
    try:
        there = spawn.bring_up(ctx.manager(spawn.plan.namespace), loads, left_out)
    except Refused as error:
        _print_robot(ctx, robot)
        next_step = _how_to_go_on(ctx, robot, controllers, start)
        raise Refused(error.message, f"{error.hint}\n{next_step}" if error.hint else next_step) from None
    _print_robot(ctx, robot)
    _warn_left_out(ctx, missing)
    if start and not there:
        raise Refused(f"nothing is left to drive {robot['name']}: none of its controllers is there")


def _single_model(source: str, places: Packages) -> Document:
    """The URDF of an SDF file with one model. Raises UsageError when it has several."""
    from slidectl import description

    scene = spawning.scene(source, places)
    if len(scene.models) > 1:
        known = ", ".join(model.name for model in scene.models)
        raise UsageError(f"{source} has {len(scene.models)} models, and URDF holds one: {known}")
    return description.Document(scene.models[0].xml, source, tuple(scene.notices))


def pairs(words: Sequence[str], sign: str, command: str = "spawn") -> dict[str, str]:
    """`key:=value` words as a mapping. Raises UsageError."""
    for word in words:
        if not word.partition(sign)[0] or sign not in word:
            hint = f"slidectl {command} --help shows the order of arguments"
            raise UsageError(f"{word!r} is not KEY{sign}VALUE", hint)
    return {key: value for key, _, value in (word.partition(sign) for word in words)}


def _document(
    ctx: Context, source: str, given: dict[str, str], name: str | None, places: Packages, missing: Missing
) -> Document:
    """The robot in a file or on standard input, and all that its file refers to. Raises BadFile, NotThere."""
    from slidectl.description import source_note

    text, title = source, None
    if input_files.is_output(source):  # which can be read only once
        text, title = _as_model(input_files.read_bytes(source, input_files.MOST_TEXT, pipes=True), source), source
    if source == "-":  # it may be a parameter, as `slidectl param get` prints it; the daemon knows its sources
        text, title = standard_input(), "<stdin>"
        note = ctx.call("/slidectl/sources", {"digest": source_note.digest(text)})["note"]
        text = source_note.join(text, note)
    document = spawning.document(text, given, name, places, missing, title)
    report_own_packages(ctx, places)
    missing.refuse()
    return document


def _positions(words: Sequence[str]) -> dict[str, float]:
    """The positions of `--joint JOINT=POSITION`, in rad or m. Raises UsageError."""
    positions = {}
    for joint, text in pairs(words, "=").items():
        try:
            positions[joint] = float(text)
        except ValueError:
            message = f"--joint {joint} takes a number, in rad or m, not {text!r}"
            raise UsageError(message, "90 degrees are 1.5708 rad") from None
    return positions


def package_lookup(given: Sequence[str], command: str = "spawn") -> Packages:
    """The lookup of packages: those of `--package`, of the search paths, and from the working folder upwards."""
    from slidectl.description import Packages

    return Packages({name: Path(path) for name, path in pairs(given, "=", command).items()}, Path.cwd())


def report_own_packages(ctx: Context, packages: Packages) -> None:
    """Print which packages of the user were used in place of shipped ones."""
    for name, folder in packages.own.items():
        ctx.say(f"using package {name} of {folder} (also shipped)")
    packages.own.clear()


def in_package(
    model: str, words: Sequence[str], packages: Packages, command: str = "spawn"
) -> tuple[str, dict[str, str]]:
    """Resolve `MODEL [FILE] [KEY:=VALUE]...` to a model, or a file of the package MODEL, and the arguments.

    Raises:
        UsageError: a word is none of these. UnknownPackage, UnknownName: no such package, or no such file in it.
    """
    file, rest = (words[0], words[1:]) if words and ":=" not in words[0] else (None, words)
    arguments = pairs(rest, ":=", command)
    if file is None:
        return model, arguments
    from slidectl.description import models
    from slidectl.description.packages import shown
    from slidectl.extensions.launch import files

    if model == "-" or models.is_path_like(model) or model in models.shipped():
        hint = f"slidectl {command} --help shows the order of arguments"
        if command == "spawn" and file.endswith((".yaml", ".yml")):
            hint = f"a file of controllers is given with an option: --controllers {file}"
        raise UsageError(f"{file!r} is not KEY:=VALUE", hint)
    return shown(files.find_in_package(model, file, packages)), arguments


def standard_input() -> str:
    """The model on standard input. Raises BadFile when it is not XML."""
    return _as_model(input_files.read_stdin(), "<stdin>")


def _as_model(content: bytes, title: str) -> str:
    text = parameter_text(content.decode("utf-8", "replace"))
    if not text.lstrip("\ufeff \t\r\n").startswith("<"):
        raise BadFile("is not XML", title, hint="pipe a URDF in, or name a model")
    return text


_YAML_TEXTS = ('"', "'", "|", ">")
"""The first characters of a YAML text of several lines."""


def parameter_text(text: str) -> str:
    """The robot in a text that `param get` or rosparam printed as YAML; any other text unchanged."""
    if text.lstrip()[:1] not in _YAML_TEXTS:
        return text
    import yaml

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    return value if isinstance(value, str) and value.lstrip().startswith("<") else text


def _spawn_scene(
    ctx: Context, scene: Scene, name: str | None, at: Sequence[float], fixed: bool | None, strict: bool
) -> None:
    """Spawn all models of a file, or none."""
    if name is not None and (remark := names.remark_on_robot(name)):
        ctx.warn(remark)
    plan = spawning.scene_plan(scene.named(name), spawning.pose(at, "--at"), fixed=fixed, strict=strict)
    spawn = spawning.Spawn(ctx.client, plan, ctx.wait_limit(spawning.LIMIT_S))
    spawned, warnings = spawn.apply()
    told = [vars(notice) for notice in scene.notices] + [notice for robot in spawned for notice in robot["report"]]
    _warn_notices(ctx, told)
    for warning in warnings:
        ctx.warn(warning)
    for robot in spawned:
        _print_robot(ctx, robot)


def _warn_left_out(ctx: Context, missing: Missing) -> None:
    if lines := missing.lines():
        ctx.warn("\n".join(["left out:", *lines]))


def _leave_out(missing: Missing, controller: str, error: SlidectlError) -> None:
    missing.note(NotThere(error.message, hint=error.hint), f"the controller {controller} is left out")


def _how_to_go_on(ctx: Context, robot: RobotInfoMsg, controllers: str | None, start: Sequence[str]) -> str:
    """What to type after a robot has been spawned whose controllers did not start."""
    from slidectl.paths import command

    def typed(words: str) -> str:
        return command(ctx.client.paths, words)

    manager = f"--cm {robot['namespace']}"
    again = typed(f"controller spawn {' '.join(start)} {manager}")
    if controllers not in (None, "-"):
        again = f"correct {controllers}, then {typed(f'controller config {controllers} {manager}')}; {again}"
    return f"the robot stays in the world: {again}\nor take it out again: {typed('delete ' + robot['name'])}"


def _print_report(ctx: Context, robot: RobotInfoMsg, document: Document, positions: Mapping[str, float]) -> None:
    """Print the report on the tags: wrong tags and corrected inertias in full, the others counted unless `-v`."""
    from slidectl.description.parser import is_moved_inside

    for notice in document.report:
        ctx.warn(str(notice))
    report = [one for one in robot["report"] if not is_moved_inside(one["subject"], one["text"], positions)]
    _warn_notices(ctx, report)
    if not ctx.verbose:
        ctx.say(robots.summary(robot["name"], report))


def _warn_notices(ctx: Context, notices: Sequence[Mapping[str, Any]]) -> None:
    from slidectl.description.report import is_important

    for notice in notices:
        if ctx.verbose or is_important(notice["verdict"], notice["subject"]):
            ctx.warn(robots.notice_text(notice))


def _print_robot(ctx: Context, robot: RobotInfoMsg) -> None:
    # When the physics diverges at once, the pose is NaN, which the protocol sends as null.
    x, y, z = (math.nan if value is None else round(value, 3) + 0.0 for value in robot["pose"][:3])
    joints = " ".join(robots.moving(robot)) or "none"
    how = f"spawned in {robot['namespace']}" if robot["kind"] == "robot" else f"{robot['kind']}, spawned"
    ctx.done(robots.record(robot), f"{robot['name']}: {how} at {x:g} {y:g} {z:g}, joints: {joints}")
