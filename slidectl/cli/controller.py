"""`slidectl controller`: the services of the controller managers, and loading their parameters."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import click

from slidectl.cli import live, robots
from slidectl.cli.commands import Variadic, group
from slidectl.cli.context import Context
from slidectl.cli.managers import Report, chosen, owner, owner_of_some, wait_for_owner
from slidectl.client.client import BEST_EFFORT, STRICT, UNLOADED, Manager, each
from slidectl.errors import NoDaemon, Refused, UsageError

Decorator = Callable[[Any], Any]

_cm: Decorator = click.option(
    "--cm", "manager", metavar="NAMESPACE", shell_complete=live.managers, help="Which controller manager, as /rrbot."
)
_names: Decorator = click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=live.controllers)


def _strictness(function: Any) -> Any:
    strict = click.option(
        "--strict/--best-effort", "strict", default=True, help="All or nothing (default), or what goes."
    )
    asap = click.option("--asap", is_flag=True, help="Start each one as soon as its joints are ready.")
    return strict(asap(function))


def _rests(function: Any) -> Any:
    """`--zero` and `--hold`, as the one argument `rest`: None when neither was given."""

    @functools.wraps(function)
    def with_rest(*given: Any, zero: bool, hold: bool, **named: Any) -> Any:
        if zero and hold:
            raise UsageError("--zero and --hold contradict each other", "give one of them")
        return function(*given, rest="zero" if zero else "hold" if hold else None, **named)

    zero = click.option("--zero", is_flag=True, help="Then let their joints go: efforts and velocities of 0.")
    hold = click.option("--hold", is_flag=True, help="Then keep their joints in place: positions and velocities only.")
    return zero(hold(with_rest))


class Rest:
    """What the joints of controllers do after these have been stopped.

    Nothing by default: as in ros_control the last command stays with the hardware.
    """

    def __init__(self, ctx: Context, manager: Manager, stopping: Sequence[str], command: str | None) -> None:
        self._ctx = ctx
        self._command = command
        self._request = {"robot": manager.namespace, "controllers": list(stopping), "command": command or ""}

    def check(self, starting: Sequence[str] = ()) -> None:
        """Raises Refused when the joints cannot do it, before a controller is stopped."""
        if self._command:
            self._ask(check_only=True, left_to=list(starting))

    def apply(self) -> None:
        """Raises Refused."""
        if self._command:
            self._ctx.say(self._ask()["message"])

    def _ask(self, **more: Any) -> dict[str, Any]:
        answer = self._ctx.call("/slidectl/rest_joints", {**self._request, **more})
        if not answer["success"]:
            raise Refused(answer["message"])
        return answer


@group(
    examples=["slidectl controller list", "slidectl controller spawn joint_state_controller joint1_position_controller"]
)
def controller() -> None:
    """Load, start, stop and list controllers."""


@controller.command("list", examples=["slidectl controller list", "slidectl controller list -v --json"])
@_cm
@click.option("--all", "with_unloaded", is_flag=True, help="Those too that have parameters but are not loaded.")
@click.pass_obj
def list_controllers(ctx: Context, manager: str | None, with_unloaded: bool) -> None:
    """List the loaded controllers with their states.

    With -v also what they claim. JSON keys: manager, name, state, type, claimed_resources (hardware_interface and
    resources).
    """
    managers = chosen(ctx, manager)
    rows = [row for one in managers for row in _rows(one, with_unloaded)]
    stopped = ctx.call("/slidectl/status")["estop"]
    if stopped:
        spaces = {robot["namespace"] for robot in robots.all_robots(ctx) if robot["name"] in stopped}
        robots.warn_stopped(ctx, [one.namespace for one in managers if one.namespace in spaces])
    columns = ["manager", "name", "state", "type"] + (["claimed"] if ctx.verbose and ctx.format != "json" else [])
    if "claimed" in columns:
        rows = [{**row, "claimed": claimed_text(row["claimed_resources"])} for row in rows]
    ctx.emit_rows(
        rows, columns, empty="no controllers are loaded; 'slidectl controller spawn NAME' loads and starts one"
    )


def _rows(manager: Manager, with_unloaded: bool) -> list[dict[str, Any]]:
    loaded = manager.controllers()
    rows = [{"manager": manager.namespace, **{key: one[key] for key in _KEYS}} for one in loaded]
    if with_unloaded:
        missing = sorted(set(manager.configured()) - {one["name"] for one in loaded})
        rows += [_unloaded_row(manager, name) for name in missing]
    return rows


_KEYS = ("name", "state", "type", "claimed_resources")


def _unloaded_row(manager: Manager, name: str) -> dict[str, Any]:
    return {
        "manager": manager.namespace,
        "name": name,
        "state": UNLOADED,
        "type": manager.type_parameter(name),
        "claimed_resources": [],
    }


def claimed_text(resources: Sequence[dict[str, Any]]) -> str:
    """`EffortJointInterface: joint1 joint2`, several parted by semicolons."""
    parts = ((item["hardware_interface"].rpartition("::")[2], item["resources"]) for item in resources)
    return "; ".join(f"{interface}: {' '.join(names)}" if names else interface for interface, names in parts)


@controller.command("types", examples=["slidectl controller types"])
@_cm
@click.pass_obj
def types(ctx: Context, manager: str | None) -> None:
    """List the types of controllers that can be loaded.

    Without a daemon, or without a robot, those that this installation has. JSON keys: type, base_class.
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


@controller.command("load", examples=["slidectl controller load joint1_position_controller"])
@_cm
@_names
@click.pass_obj
def load(ctx: Context, manager: str | None, names: tuple[str, ...]) -> None:
    """Load controllers; they are ready to be started."""
    from slidectl.cli import configuration

    target, local = owner(ctx, manager, names)
    configuration.warn_unknown(ctx, target.namespace, local)
    with Report(ctx, target, local):
        target.loaded(target.ask_to_load(local))


@controller.command("unload", examples=["slidectl controller unload joint1_position_controller"])
@_cm
@_names
@click.pass_obj
def unload(ctx: Context, manager: str | None, names: tuple[str, ...]) -> None:
    """Unload controllers that are stopped."""
    target, local = owner(ctx, manager, names)
    with Report(ctx, target, local):
        each(target.unload, local)


@controller.command("start", examples=["slidectl controller start joint1_position_controller"])
@_cm
@_strictness
@_names
@click.pass_obj
def start(ctx: Context, manager: str | None, strict: bool, asap: bool, names: tuple[str, ...]) -> None:
    """Start loaded controllers, all in the same cycle."""
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
@_rests
@_names
@click.pass_obj
def stop(ctx: Context, manager: str | None, strict: bool, asap: bool, rest: str | None, names: tuple[str, ...]) -> None:
    """Stop running controllers, all in the same cycle.

    As in ROS the last command stays with the hardware: an effort or a velocity goes on acting, a position is held.
    --zero and --hold set another one, which the joint's interface must be able to do.
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
    "--start", "to_start", cls=Variadic, metavar="NAME...", shell_complete=live.controllers, help="Start these."
)
@click.option("--stop", "to_stop", cls=Variadic, metavar="NAME...", shell_complete=live.controllers, help="Stop these.")
@_rests
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

    --start and --stop take names until the next option, and may repeat. --timeout also goes into the request: a
    switch that has not happened by then is given up. Joints that only stopped controllers claim keep their last
    commands, as in ROS; --zero and --hold set others.
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
    target, local = (owner if strict else owner_of_some)(ctx, manager, [*start, *stop])
    starting, stopping = local[: len(start)], local[len(start) :]
    known = local if strict else [name for name in local if name in target.known()]
    after = Rest(ctx, target, stopping, rest)
    after.check(starting)
    with Report(ctx, target, known):
        target.switch(starting, stopping, STRICT if strict else BEST_EFFORT, asap)
        if strict:
            target.check_started(starting)
        after.apply()


@controller.command(
    "spawn",
    examples=[
        "slidectl controller spawn joint_state_controller joint1_position_controller",
        "slidectl controller spawn joint1_position_controller --stopped --cm /rrbot",
    ],
)
@_cm
@click.option("--stopped", is_flag=True, help="Load only.")
@click.option("--wait", is_flag=True, help="Wait until the robot is there (at most --timeout, 30 s).")
@_names
@click.pass_obj
def spawn(ctx: Context, manager: str | None, stopped: bool, wait: bool, names: tuple[str, ...]) -> None:
    """Load controllers and start them, all in the same cycle.

    Those that are loaded or run already are left as they are. If one cannot be loaded none is started.
    """
    if wait:
        wait_for_owner(ctx, manager, names)
    from slidectl.cli import configuration

    target, local = owner(ctx, manager, names)
    configuration.warn_unknown(ctx, target.namespace, local)
    with Report(ctx, target, local):
        target.bring_up(local, start=not stopped)


@controller.command("unspawn", examples=["slidectl controller unspawn joint1_position_controller"])
@_cm
@_rests
@_names
@click.pass_obj
def unspawn(ctx: Context, manager: str | None, rest: str | None, names: tuple[str, ...]) -> None:
    """Stop controllers and unload them.

    As in ROS the last commands stay with the hardware; --zero and --hold set others, as with 'controller stop'.
    """
    target, local = owner(ctx, manager, names)
    with Report(ctx, target, local) as report:
        running = [name for name in local if report.before.get(name) in ("running", "waiting")]
        after = Rest(ctx, target, [name for name in local if name in report.before], rest)
        after.check()
        if running:
            target.switch((), running)
        after.apply()
        each(target.unload, [name for name in reversed(local) if name in report.before])


@controller.command("config", examples=["slidectl controller config config/slider_control.yaml"])
@_cm
@click.argument("file", shell_complete=live.files)
@click.pass_obj
def config(ctx: Context, manager: str | None, file: str) -> None:
    """Load controllers' parameters from a YAML file into the robot's namespace.

    The file is that of a tutorial: its top key is the namespace (`slider:`); without one it goes to that of the robot.
    """
    from slidectl.cli import configuration

    tree = configuration.read(ctx, file, [one.namespace for one in chosen(ctx, manager)])
    configuration.store(ctx, tree)
    ctx.done({"file": file, "parameters": len(tree)}, f"{file}: {len(tree)} parameters")
