"""`slidectl controller`: the controller managers, the lookup of a controller's manager, and parameter files.

description.controllers_file defines what a file may hold, the controller defines what a parameter means.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, robots
from slidectl.cli.commands import Variadic, group, number, seconds, wait_for_world_s
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import pause_remark
from slidectl.client.manager import (
    BEST_EFFORT,
    RUNNING,
    STARTED,
    STRICT,
    UNLOADED,
    Manager,
    claimed_text,
    configured,
    each,
)
from slidectl.command_steps import CommandStep, StepEffects
from slidectl.errors import AmbiguousName, NoDaemon, Refused, TimedOut, UnknownName, UsageError
from slidectl.names import join, resolve

if TYPE_CHECKING:
    from slidectl.client.spawning import Tree
    from slidectl.description.robot import Notice

WAIT_S = 30.0
_LOOK_AGAIN_S = 0.2

_Owner = tuple[Manager, list[str], dict[str, str]]

Decorator = Callable[[Any], Any]

_cm: Decorator = click.option(
    "--cm",
    "manager",
    metavar="NAMESPACE",
    shell_complete=completion.managers,
    help="Which controller manager, as /rrbot.",
)
_names: Decorator = click.argument(
    "names", nargs=-1, required=True, metavar="NAME...", shell_complete=completion.controllers
)


def _strictness(function: Any) -> Any:
    strict = click.option(
        "--strict/--best-effort", "strict", default=True, help="All or nothing (default), or as many as possible."
    )
    asap = click.option("--asap", is_flag=True, help="Start each one as soon as its joints are ready.")
    return strict(asap(function))


def _stop_command_options(function: Any) -> Any:
    """Add `--zero` and `--hold`. The function gets both as the argument `rest`, None when neither was given."""

    @functools.wraps(function)
    def with_rest(*given: Any, zero: bool, hold: bool, **named: Any) -> Any:
        if zero and hold:
            raise UsageError("--zero and --hold exclude each other", "give one of them")
        return function(*given, rest="zero" if zero else "hold" if hold else None, **named)

    zero = click.option("--zero", is_flag=True, help="Then command efforts and velocities of 0.")
    hold = click.option("--hold", is_flag=True, help="Then hold their joints in place: positions and velocities only.")
    return zero(hold(with_rest))


@contextmanager
def _changes(
    ctx: Context, manager: Manager, controllers: Sequence[str], before: Mapping[str, str]
) -> Iterator[dict[str, str]]:
    """Print the state of each controller before and after; when the action is refused, only where they differ.

    `before` is name -> state. Yields a dict for the states afterwards; they are asked for when it stays empty.
    """
    after: dict[str, str] = {}
    refused = None
    try:
        yield after
    except Refused as error:
        refused = error
    after = after or manager.states()
    for name in dict.fromkeys(controllers):
        was, state = before.get(name, UNLOADED), after.get(name, UNLOADED)
        if refused is None or was != state:
            record = {"manager": manager.namespace, "name": name, "state": state, "before": was}
            ctx.done(record, f"{name}: {state}" + (" already" if was == state else f" (was {was})"))
    if refused is not None:
        raise refused


def _command_stopped_joints(
    ctx: Context,
    manager: Manager,
    stopping: Sequence[str],
    command: str | None,
    *,
    check_only: bool = False,
    left_to: Sequence[str] = (),
) -> None:
    """Give the joints of stopped controllers the command of `--zero` or `--hold`. Without one the last command stays.

    Args:
        check_only: only check that the joints can take the command, before the controllers are stopped.
        left_to: controllers that start in the same switch; their joints get no command here.

    Raises:
        Refused: the joints cannot take the command.
    """
    if command is None:
        return
    request = {"robot": manager.namespace, "controllers": list(stopping), "command": command}
    answer = ctx.call("/slidectl/rest_joints", {**request, "check_only": check_only, "left_to": list(left_to)})
    if not answer["success"]:
        raise Refused(answer["message"])
    if not check_only:
        ctx.say(answer["message"])


def _step_effects(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:  # noqa: ARG001
    """The controllers that a manager must know, without their namespaces."""
    may_add = parameters.get("source") is not None
    if parameters.get("wait") or not parameters.get("strict", True):
        return StepEffects(may_add_controllers=may_add)
    full = [name for key in ("names", "to_start", "to_stop") for name in parameters.get(key) or ()]
    named = tuple(name.rpartition("/")[2] for name in full)
    return StepEffects(named=named, may_add_controllers=may_add)


@group(
    step=CommandStep(effects=_step_effects),
    examples=[
        "slidectl controller list",
        "slidectl controller spawn joint_state_controller joint1_position_controller",
    ],
)
def controller() -> None:
    """Load, start, stop and list controllers."""


@controller.command("list", examples=["slidectl controller list", "slidectl controller list -v --json"])
@_cm
@click.option("--all", "with_unloaded", is_flag=True, help="Also list those that have parameters but are not loaded.")
@click.pass_obj
def list_controllers(ctx: Context, manager: str | None, with_unloaded: bool) -> None:
    """List the loaded controllers with their states.

    -v adds what they claim, and the mean and longest wall time of their updates since the start (not of compiled ones).
    JSON keys: manager, name, state, type, claimed_resources (hardware_interface and resources); with -v update_times
    (slidectl/UpdateTimes, in s).
    """
    managers = chosen(ctx, manager)
    rows = [row for one in managers for row in _rows(one, with_unloaded)]
    if ctx.verbose:
        times = {(one.namespace, each["name"]): each for one in managers for each in one.update_times()}
        for row in rows:
            row["update_times"] = times.get((row["manager"], row["name"]))
    stopped = ctx.call("/slidectl/status")["estop"]
    if stopped:
        spaces = {robot["namespace"] for robot in ctx.client.robots() if robot["name"] in stopped}
        robots.warn_stopped(ctx, [one.namespace for one in managers if one.namespace in spaces])
    columns = ["manager", "name", "state", "type"]
    if ctx.verbose and ctx.format != "json":
        columns += ["claimed", "update"]
        for row in rows:
            row |= {"claimed": claimed_text(row["claimed_resources"]), "update": _times_text(row["update_times"])}
    ctx.emit_rows(rows, columns, "no controllers are loaded; 'slidectl controller spawn NAME' loads and starts one")


def _rows(manager: Manager, with_unloaded: bool) -> list[dict[str, Any]]:
    loaded: list[dict[str, Any]] = [{"manager": manager.namespace, **one} for one in manager.controllers()]
    if not with_unloaded:
        return loaded
    missing = sorted(set(manager.configured()) - {one["name"] for one in loaded})
    blank = {"manager": manager.namespace, "state": UNLOADED, "claimed_resources": []}
    return loaded + [{**blank, "name": name, "type": manager.type_parameter(name)} for name in missing]


def _times_text(times: dict[str, Any] | None) -> str:
    """`3.2 us, longest 41.0 us`, and the number of updates over the budget if there is one."""
    if times is None or not (times["compiled"] or times["updates"]):
        return ""
    if times["compiled"]:
        return "compiled"
    text = f"{times['mean'] * 1e6:.1f} us, longest {times['longest'] * 1e6:.1f} us"
    return f"{text}, {times['over_budget']} over {times['budget'] * 1e6:g} us" if times["budget"] else text


@controller.command("types", examples=["slidectl controller types"])
@_cm
@click.pass_obj
def types(ctx: Context, manager: str | None) -> None:
    """List the types of controllers that can be loaded.

    Without a daemon or a robot it lists the types of this installation. JSON keys: type, base_class.
    """
    found: dict[str, str] = {}
    try:
        for one in chosen(ctx, manager):
            answer = one.types()
            found |= dict(zip(answer["types"], answer["base_classes"], strict=True))
    except NoDaemon:
        if manager is not None:
            raise
    if not found:
        from slidectl.check.controllers import known_types

        found = dict(known_types())
    if ctx.format == "text":
        ctx.emit_names(sorted(found), "type")
    else:
        ctx.emit_rows([{"type": name, "base_class": found[name]} for name in sorted(found)], ["type", "base_class"])


@controller.command(
    "load",
    examples=[
        "slidectl controller load joint1_position_controller",
        "slidectl controller load my_law --from my_laws.py:Gravity",
    ],
)
@_cm
@click.option(
    "--from",
    "source",
    metavar="FILE.py[:CLASS]",
    shell_complete=completion.files,
    help="A controller of your own: this class in this file.",
)
@_names
@click.pass_obj
def load(ctx: Context, manager: str | None, source: str | None, names: tuple[str, ...]) -> None:
    """Load controllers; they are ready to be started.

    --from loads one controller from a class in a Python file; docs/extending.md has an example. Its code runs in the
    daemon. CLASS is optional if the file has one controller.
    """
    if source is not None:
        _load_file(ctx, manager, source, names)
        return
    target, local, before = owner(ctx, manager, names)
    calls = _ask_for_parameters(target, local)
    loads = target.ask_to_load(local)
    _warn_unknown(ctx, target, calls)
    with _changes(ctx, target, local, before):
        target.loaded(loads)


def _load_file(ctx: Context, manager: str | None, source: str, names: Sequence[str]) -> None:
    if len(names) > 1:
        raise UsageError(f"--from is for one controller, and here are {len(names)} names")
    file, class_name = source, ""
    if not source.endswith(".py"):
        file, _, class_name = source.rpartition(":")
    if not file.endswith(".py"):
        raise UsageError(f"--from takes FILE.py or FILE.py:CLASS, not {source!r}")
    file = os.path.abspath(os.path.expanduser(file))
    target, name = _place_for(ctx, manager, names[0])
    with _changes(ctx, target, [name], target.states()):
        target.load_file(name, file, class_name)


def _place_for(ctx: Context, manager: str | None, controller: str) -> tuple[Manager, str]:
    """The manager for a controller that may have no parameters: the only one, else the one that knows the name."""
    candidates = chosen(ctx, manager)
    inside = [one for one in candidates if controller.startswith(one.namespace.rstrip("/") + "/")] or candidates
    if len(inside) == 1:
        return inside[0], controller.removeprefix(inside[0].namespace.rstrip("/") + "/")
    if inside and not _places(_known(candidates)[1], [controller])[controller]:
        spaces = ", ".join(one.namespace for one in candidates)
        raise UsageError(f"which robot is {controller} for?", f"choose one with --cm: {spaces}")
    target, [name], _ = owner(ctx, manager, [controller])
    return target, name


@controller.command("reload", examples=["slidectl controller reload my_law"])
@_cm
@_names
@click.pass_obj
def reload(ctx: Context, manager: str | None, names: tuple[str, ...]) -> None:
    """Reload controllers of your own from their files.

    It stops each controller, loads it from its file, and starts it again if it ran or was aborted. Name, parameters and
    topics stay. If the edited file is broken, nothing changes. The command fails if the first update aborts the
    controller.
    """
    target, local, _ = owner(ctx, manager, names)
    for name in local:
        before = target.states().get(name, UNLOADED)
        target.reload(name)
        state = target.states().get(name, UNLOADED)
        record = {"manager": target.namespace, "name": name, "state": state, "before": before}
        ctx.done(record, f"{name}: reloaded, {state}" + ("" if state == before else f" (was {before})"))
        if state in RUNNING:
            ctx.say(pause_remark(ctx.call("/slidectl/status"), "nothing runs until it goes on"))


@controller.command("configure", examples=["slidectl controller configure joint_trajectory_controller"])
@_cm
@_names
@click.pass_obj
def configure(ctx: Context, manager: str | None, names: tuple[str, ...]) -> None:
    """Configure loaded controllers of a robot of ROS 2, which become inactive and can be started.

    Controllers that are inactive already are configured again with their present parameters. 'controller spawn' and
    'controller start' configure by themselves.
    """
    target, local, before = owner(ctx, manager, names)
    with _changes(ctx, target, local, before):
        each(target.configure, local)


@controller.command("cleanup", examples=["slidectl controller cleanup joint_trajectory_controller"])
@_cm
@_names
@click.pass_obj
def cleanup(ctx: Context, manager: str | None, names: tuple[str, ...]) -> None:
    """Make inactive controllers of a robot of ROS 2 unconfigured."""
    target, local, before = owner(ctx, manager, names)
    with _changes(ctx, target, local, before):
        each(target.cleanup, local)


@controller.command("unload", examples=["slidectl controller unload joint1_position_controller"])
@_cm
@_names
@click.pass_obj
def unload(ctx: Context, manager: str | None, names: tuple[str, ...]) -> None:
    """Unload controllers that are stopped."""
    target, local, before = owner(ctx, manager, names)
    with _changes(ctx, target, local, before):
        each(target.unload, local)


@controller.command("start", examples=["slidectl controller start joint1_position_controller"])
@_cm
@_strictness
@_names
@click.pass_obj
def start(ctx: Context, manager: str | None, strict: bool, asap: bool, names: tuple[str, ...]) -> None:
    """Start loaded controllers, all in the same cycle. Those of a robot of ROS 2 are configured first."""
    _switch(ctx, manager, names, (), strict, asap)


@controller.command(
    "stop",
    examples=[
        "slidectl controller stop joint1_position_controller",
        "slidectl controller stop joint1_position_controller --zero",
    ],
)
@_cm
@_strictness
@_stop_command_options
@_names
@click.pass_obj
def stop(ctx: Context, manager: str | None, strict: bool, asap: bool, rest: str | None, names: tuple[str, ...]) -> None:
    """Stop running controllers, all in the same cycle.

    As in ROS, the hardware keeps the last command: an effort or a velocity keeps acting, a position is held. --zero and
    --hold replace it; the joint's interface must allow that.
    """
    _switch(ctx, manager, (), names, strict, asap, rest)


@controller.command(
    "switch",
    examples=[
        "slidectl controller switch --stop joint1_position_controller",
        "slidectl controller switch --start joint1_position_controller joint2_position_controller --cm /rrbot",
    ],
)
@_cm
@_strictness
@click.option(
    "--start", "to_start", cls=Variadic, metavar="NAME...", shell_complete=completion.controllers, help="Start these."
)
@click.option(
    "--stop", "to_stop", cls=Variadic, metavar="NAME...", shell_complete=completion.controllers, help="Stop these."
)
@_stop_command_options
@click.pass_obj
def switch(
    ctx: Context,
    manager: str | None,
    strict: bool,
    asap: bool,
    to_start: tuple[str, ...],
    to_stop: tuple[str, ...],
    rest: str | None,
) -> None:
    """Stop some controllers and start others in one cycle.

    --start and --stop take names until the next option, and may repeat. --timeout is also part of the request: the
    manager abandons a switch that has not happened by then. Joints that only stopped controllers claim keep their last
    commands, as in ROS; --zero and --hold replace them.
    """
    if not to_start and not to_stop:
        raise UsageError("nothing to switch", "name controllers after --start, --stop or both")
    if rest and not to_stop:
        raise UsageError(f"--{rest} is for joints of controllers that are stopped", "name them after --stop")
    _switch(ctx, manager, to_start, to_stop, strict, asap, rest)


def _switch(
    ctx: Context,
    manager: str | None,
    start: Sequence[str],
    stop: Sequence[str],
    strict: bool,
    asap: bool,
    rest: str | None = None,
) -> None:
    target, local, before = (owner if strict else manager_of_some)(ctx, manager, [*start, *stop])
    starting, stopping = local[: len(start)], local[len(start) :]
    known = local if strict else target.known()
    _command_stopped_joints(ctx, target, stopping, rest, check_only=True, left_to=starting)
    with _changes(ctx, target, [name for name in local if name in known], before) as after:
        target.make_ready(starting, before)
        target.switch(starting, stopping, STRICT if strict else BEST_EFFORT, asap)
        if strict:
            after |= target.check_started(starting)
        _command_stopped_joints(ctx, target, stopping, rest)


@controller.command(
    "spawn",
    examples=[
        "slidectl controller spawn joint_state_controller joint1_position_controller",
        "slidectl controller spawn joint1_position_controller --stopped --cm /rrbot",
    ],
)
@_cm
@click.option("--stopped", is_flag=True, help="Load only.")
@click.option("--wait", is_flag=True, help="Wait until the robot exists (at most --timeout, 30 s).")
@_names
@click.pass_obj
def spawn(ctx: Context, manager: str | None, stopped: bool, wait: bool, names: tuple[str, ...]) -> None:
    """Load controllers and start them, all in the same cycle.

    Those of a robot of ROS 2 are configured in between. Controllers that are loaded or running already stay as they
    are. If one cannot be loaded, none is started.
    """
    if wait:
        wait_for_owner(ctx, manager, names)
    target, local, before = owner(ctx, manager, names)
    calls = _ask_for_parameters(target, local)
    loads = target.ask_to_load([name for name in local if name not in before])
    listing = target.ask_for_controllers() if loads and not stopped else None
    _warn_unknown(ctx, target, calls)
    with _changes(ctx, target, local, before) as after:
        after |= target.bring_up(local, start=not stopped, states=before, loads=loads, listing=listing)


@controller.command("unspawn", examples=["slidectl controller unspawn joint1_position_controller"])
@_cm
@_stop_command_options
@_names
@click.pass_obj
def unspawn(ctx: Context, manager: str | None, rest: str | None, names: tuple[str, ...]) -> None:
    """Stop controllers and unload them.

    As in ROS, the hardware keeps the last commands; --zero and --hold replace them, as in 'controller stop'.
    """
    target, local, before = owner(ctx, manager, names)
    with _changes(ctx, target, local, before):
        loaded = [name for name in local if name in before]
        running = [name for name in loaded if before[name] in STARTED]
        _command_stopped_joints(ctx, target, loaded, rest, check_only=True)
        if running:
            target.switch((), running)
        _command_stopped_joints(ctx, target, loaded, rest)
        each(target.unload, loaded[::-1])


@controller.command(
    "plot",
    examples=[
        "slidectl controller plot joint1_position_controller --step 1.0",
        "slidectl controller plot joint1_position_controller --step 1.0 --for 5 --save step.svg",
    ],
)
@_cm
@click.argument("name", shell_complete=completion.controllers)
@number("--step", required=True, help="The new set point: m or rad, m/s or rad/s, N or N m, as the command.")
@seconds("--for", "duration", default=10.0, help="Follow it for S simulated seconds (10).")
@completion.file_option("--save", help="Into a file: .svg, .png, .pdf, .html or .csv.")
@click.pass_obj
def plot(ctx: Context, manager: str | None, name: str, step: float, duration: float, save: str | None) -> None:
    """Give a controller a set point and plot the step response.

    It draws set point, state, error and effort, with the measures of docs/measures.md. The joint moves. JSON keys:
    controller, set_point, unit, start, rise, overshoot, settling, error, effort_peak (null where it is never reached or
    cannot be measured), file.
    """
    from slidectl.extensions.viewing.commands import plot as plotting
    from slidectl.extensions.viewing.step_response import step_response

    plotting.check(ctx, save)
    found, (local,), states = owner(ctx, manager, [name])
    if states.get(local) not in STARTED:
        raise Refused(f"{local} does not run", f"start it: slidectl controller spawn {local}")
    ctx.say(pause_remark(ctx.call("/slidectl/status")))
    limit = ctx.wait_limit(wait_for_world_s(duration))
    response = step_response(ctx.client, found.namespace, local, step, duration, limit)
    from slidectl.client import steady_error

    joint = str(ctx.client.params.get(f"{found.namespace}/{local}/joint", ""))
    if (why := steady_error.of_joint(ctx.client, found.namespace, joint)) is not None:
        ctx.say(why)
    measured = {key.replace("-", "_"): value for key, value in response.measured.items()}
    known = {key: value if value is not None and isfinite(value) else None for key, value in measured.items()}
    about = {"controller": local, "set_point": step, "unit": response.unit, "start": response.start}
    plotting.show(ctx, response.plot, save, records=[{**about, **known, "file": save}])


@controller.command(
    "config",
    step=CommandStep(may_add_controllers=True),
    examples=["slidectl controller config config/slider_control.yaml"],
)
@_cm
@click.argument("file", shell_complete=completion.files)
@click.pass_obj
def config(ctx: Context, manager: str | None, file: str) -> None:
    """Load controllers' parameters from a YAML file into the robot's namespace.

    The top key of the file is the namespace (`slider:`), as in the tutorials; without one, the namespace is that of the
    robot.
    """
    from slidectl.cli.param import store

    tree = read_parameters(ctx, file, [one.namespace for one in chosen(ctx, manager)])
    store(ctx, tree)
    ctx.done({"file": file, "parameters": len(tree)}, f"{file}: {len(tree)} parameters")


# --- parameter files --------------------------------------------------------------------------------------------------


def read_parameters(ctx: Context, file: str, namespaces: Sequence[str], reports_moves: bool = False) -> Tree:
    """The parameters of a file by full name, moved to the robot's namespace where the file is for another one.

    Names that no controller knows, such as `kd` for a gain, are printed as warnings, as in `check`. When the robot
    cannot be determined, the names stay as in the file, as with `rosparam load`.

    Args:
        namespaces: namespaces of the robots that the file may be for.
        reports_moves: print it when the file is for another namespace; else only with -v.

    Raises:
        BadFile: the file is missing or holds no parameters. UsageError: the robot is ambiguous.
    """
    from slidectl.check.controllers import ParameterFile, unknown
    from slidectl.check.findings import Findings
    from slidectl.client.spawning import find, leaves, placements
    from slidectl.description import controllers_file
    from slidectl.description.models import read_file

    path = find(file)
    notices: list[Notice] = []
    text = read_file(path, pipes=True)  # once: it may be the output of a command
    tree = controllers_file.read(path, notices, text)
    places = controllers_file.places(text, str(path))
    for notice in [*notices, *unknown(tree, ParameterFile(str(path), places, Findings()))]:
        ctx.warn(str(notice))
    placed, remark, moved = placements(tree, namespaces)
    if moved and len(namespaces) > 1:
        raise UsageError(f"{path} fits none of {', '.join(namespaces)} by its top key", "say which with --cm")
    if remark:
        (ctx.warn if reports_moves or not moved else ctx.detail)(f"{path}: {remark}")
    return dict(leaves(placed))


def _ask_for_parameters(manager: Manager, controllers: Sequence[str]) -> dict[str, str]:
    """Send the requests for what `_warn_unknown` looks at: the parameters, before loading a controller adds to them."""
    requests = {name: {"name": join(manager.namespace, name), "default": "null"} for name in controllers}
    return {name: manager.client.call_async("/rosapi/get_param", request) for name, request in requests.items()}


def _warn_unknown(ctx: Context, manager: Manager, calls: Mapping[str, str]) -> None:
    """Warn of parameter names that no controller knows. `calls` are those of `_ask_for_parameters`."""
    from slidectl.check.controllers import ParameterFile, unknown
    from slidectl.check.findings import Findings

    for name, call_id in calls.items():
        tree = json.loads(ctx.client.answer(call_id)["value"])
        for part in reversed(name.split("/")):
            tree = {part: tree}
        for notice in unknown(tree, ParameterFile("", {}, Findings(), manager.namespace)):
            ctx.warn(f"{notice.subject}: {notice.text}")


# --- managers and names -----------------------------------------------------------------------------------------------


def chosen(context: Context, wanted: str | None) -> list[Manager]:
    """The managers that the options select: that of `--cm`, else that of `--ns`, else all. Raises UnknownName."""
    every = context.managers()
    known = {manager.namespace: manager for manager in every}
    if wanted is not None:
        name = wanted.rstrip("/").removesuffix("controller_manager").rstrip("/") or "/"
        full = resolve(name, known, kind="controller manager", namespace=context.namespace)
        return [known[full]]
    below_root = context.namespace != "/"  # the root is also the default of `--ns`
    return [known[context.namespace]] if below_root and context.namespace in known else every


def owner(context: Context, wanted: str | None, controllers: Sequence[str]) -> _Owner:
    """The one manager that the controllers belong to, their names in it, and the states of all that are loaded there.

    A name may be full (`/slider/joint1_position_controller`). Raises AmbiguousName (2) when several managers know the
    names, UnknownName (1) when none does, UsageError when no single manager has them all.
    """
    candidates = chosen(context, wanted)
    if not candidates:
        raise Refused("no robot with controllers in the world", "spawn one: slidectl spawn slider")
    states, known = _known(candidates)
    places = _places(known, controllers)
    fitting = [m for m in candidates if all(m.namespace in found for found in places.values())]
    if len(fitting) == 1:
        (manager,) = fitting
        return manager, [places[name][manager.namespace] for name in controllers], states[manager.namespace]
    if fitting:
        spaces = [manager.namespace for manager in fitting]
        if not controllers:
            raise AmbiguousName("controller manager", "", spaces)
        matches = [join(space, name) for name in controllers for space in spaces]
        raise AmbiguousName("controller", " ".join(controllers), matches)
    for name, found in places.items():
        if not found:
            where = f"in {candidates[0].namespace}" if len(candidates) == 1 else ""
            error = UnknownName("controller", name, sorted(set().union(*known.values())), where)
            error.hint = f"{error.hint}\nload its configuration first: slidectl controller config FILE.yaml"
            raise error
    listed = "; ".join(f"{name} of {', '.join(sorted(found))}" for name, found in places.items())
    raise UsageError(f"no controller manager has all of these: {listed}", "use one command for each robot")


def manager_of_some(context: Context, wanted: str | None, controllers: Sequence[str]) -> _Owner:
    """As `owner`, for best effort: the manager need only know some of the controllers, or be the only manager."""
    places = _places(_known(chosen(context, wanted))[1], controllers)
    manager, _, states = owner(context, wanted, [name for name, found in places.items() if found])
    return manager, [name.removeprefix(manager.namespace.rstrip("/") + "/") for name in controllers], states


def _known(managers: Sequence[Manager]) -> tuple[dict[str, dict[str, str]], dict[str, set[str]]]:
    """Two by namespace, in the time of one call: the states of the loaded controllers, and all that could be loaded."""
    asked = {manager: manager.ask_for_controllers() for manager in managers}
    parameters = managers[0].parameter_names() if managers else []
    states = {manager.namespace: manager.states(call_id) for manager, call_id in asked.items()}
    return states, {space: {*loaded, *configured(parameters, space)} for space, loaded in states.items()}


def _places(known: Mapping[str, Collection[str]], controllers: Sequence[str]) -> dict[str, dict[str, str]]:
    """Controller -> namespace of each manager that knows it -> its name there."""
    places: dict[str, dict[str, str]] = {name: {} for name in controllers}
    for name, found in places.items():
        for namespace, inside in known.items():
            local = name.removeprefix(namespace.rstrip("/") + "/").rstrip("/")
            if not local.startswith("/") and local in inside:
                found[namespace] = local
    return places


def wait_for_owner(context: Context, manager: str | None, controllers: Sequence[str]) -> None:
    """Wait until a controller manager knows all the controllers. Raises TimedOut with what is missing."""
    limit, client = context.wait_limit(WAIT_S), context.client
    deadline = client.monotonic() + limit
    while True:
        try:
            owner(context, manager, controllers)
            return
        except (Refused, UnknownName) as missing:
            left = deadline - client.monotonic()
            if left <= 0:
                raise TimedOut(f"still so after {limit:g} s: {missing.message}", missing.hint) from None
            context.pause(min(_LOOK_AGAIN_S, left))
