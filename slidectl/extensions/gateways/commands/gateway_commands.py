"""`slidectl gateway`: the processes that connect programs of other protocols to the daemon."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import Group, finite, group
from slidectl.cli.commands import command as cli_command
from slidectl.cli.context import Context
from slidectl.entry_points import Part, PartError
from slidectl.errors import NoDaemon, Refused
from slidectl.extensions.gateways import gateway_kinds
from slidectl.extensions.gateways.gateway_kinds import GATEWAYS
from slidectl.extensions.gateways.ros2 import MOST_DOMAIN
from slidectl.paths import command

if TYPE_CHECKING:
    from slidectl.extensions.gateways.process import RunningGateway

PORTS = {"ros1": 11311, "websocket": 9090, "foxglove": 8765}
"""The default port of each gateway, as of roscore, rosbridge and Foxglove's bridge."""
_ACTIONS = ("run", "start", "stop", "status")


class _GatewayGroup(Group):
    """The group of the gateways, with those that installed packages add.

    One of ours has a command of its own in this file where its options need more than `Options` says, or where a
    library of it may be missing: a help imports the class of any other.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *gateway_kinds.OURS})

    def installed(self) -> dict[str, Part]:
        return GATEWAYS.parts() | super().installed()

    def refused(self) -> list[PartError]:
        return GATEWAYS.refused() + super().refused()

    def find_installed(self, name: str) -> click.Command | None:
        part = None if name in gateway_kinds.OURS else GATEWAYS.find(name)
        known = part is not None or name in gateway_kinds.OURS
        return _command_of(name, part) if known else super().find_installed(name)


@group(
    cls=_GatewayGroup,
    examples=["slidectl gateway ros1 start", "slidectl gateway websocket run --port 9090", "slidectl gateway status"],
)
def gateway() -> None:
    """Connect ROS 1 nodes, rosbridge clients and Foxglove.

    A gateway is a process of its own, and a client of the daemon. It waits for the daemon when that ends, and 'slidectl
    daemon stop' ends both. All listen on this machine alone unless --host says otherwise.
    """


_HOST = click.option("--host", default="localhost", show_default=True, metavar="ADDRESS",
                     help="Address of this machine to listen on.")  # fmt: skip
_TRUST = (
    click.option(
        "--allow",
        type=click.Choice(["files", "code"]),
        multiple=True,
        help="Let clients also name files to read and write, or code to run; may repeat.",
    ),
    click.option(
        "--any-user",
        is_flag=True,
        help="Accept programs of all users of this machine. Default without a token: yours alone.",
    ),
)
_FOR_BROWSERS = (
    click.option("--cert", default="", metavar="FILE", shell_complete=completion.files,
                 help="Certificate (PEM), for TLS."),
    click.option("--key", default="", metavar="FILE", shell_complete=completion.files,
                 help="Its private key (PEM), if it is not in the same file."),
    click.option("--token", default="", envvar="SLIDECTL_TOKEN", metavar="WORD", help="Require this token."),
    click.option("--token-file", default="", metavar="FILE", shell_complete=completion.files,
                 help="Read the token from this file."),
    click.option("--origin", "origins", multiple=True, metavar="URL",
                 help="Accept pages of this site (https://site:port; null: files; *: all); may repeat. Default: none."),
    click.option("--read-only", is_flag=True, help="Let clients read only."),
    click.option("--max-connections", type=click.IntRange(1), default=200, show_default=True, metavar="N",
                 help="Maximum number of clients."),
)  # fmt: skip
"""Options of the gateways that browsers reach."""


def _listening(kind: str, *more: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add the argument and the options of every gateway, and `more` options."""
    port = click.option("--port", type=click.IntRange(0, 65535), default=PORTS[kind], show_default=True, metavar="N",
                        help="Port; 0: a free one.")  # fmt: skip
    action = click.argument("action", type=click.Choice(_ACTIONS), default="run")

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed((action, port, _HOST, *more, *_TRUST)):
            function = decorator(function)
        return click.pass_obj(function)

    return decorate


@gateway.command("ros1", examples=["slidectl gateway ros1 start", "slidectl gateway ros1 --master http://other:11311"])
@_listening("ros1")
@click.option("--master", default="", metavar="URI", help="Join the ROS master at this URI instead of being one.")
def ros1(ctx: Context, action: str, **options: Any) -> None:
    """Serve ROS 1 nodes and tools, as their master.

    ACTION is run (until Ctrl-C, the default), start (in the background), stop or status. rostopic, rospy and roscpp
    nodes, rosbag and RViz work as with roscore, with ROS_MASTER_URI set to the address that is printed.

    JSON keys: kind, running, pid, address, already (of start), and the counters of status.
    """
    _act(ctx, "ros1", action, options)


@gateway.command("ros2", examples=["slidectl gateway ros2 start", "slidectl gateway ros2 --domain 7"])
@click.argument("action", type=click.Choice(_ACTIONS), default="run")
@click.option("--domain", type=click.IntRange(0, MOST_DOMAIN), default=None, metavar="N",
              help="ROS_DOMAIN_ID; by default that of the environment, or 0.")  # fmt: skip
@click.option("--any-host", is_flag=True, help="Let nodes of other hosts take part; by default those of this machine.")
@click.option("--read-only", is_flag=True, help="Let nodes read only.")
@click.option(
    "--topics", multiple=True, metavar="PATTERN", help="Bridge these topics and actions only (*, ?, [...]); may repeat."
)
@_TRUST[0]
@click.pass_obj
def ros2(ctx: Context, /, action: str, **options: Any) -> None:
    """Serve ROS 2 nodes and tools, as nodes of their domain.

    ACTION is run (until Ctrl-C, the default), start (in the background), stop or status. Needs rclpy: source a ROS 2
    whose Python is slidectl's, or pip install '.[ros2]' in a clone with Python 3.12.

    ROS 2 knows no users: every program in the domain can use it.

    JSON keys: kind, running, pid, address, already (of start), and the counters of status.
    """
    _act(ctx, "ros2", action, options)


@gateway.command(
    "websocket", examples=["slidectl gateway websocket start", "slidectl gateway websocket --token-file secret.txt"]
)
@_listening("websocket", *_FOR_BROWSERS)
@click.option("--max-rate", type=click.IntRange(1), default=5000, show_default=True, metavar="N",
              help="Maximum frames per second from one client; further ones wait.")  # fmt: skip
@click.option("--max-size", type=click.IntRange(1, 16777216), default=16777216, show_default=True, metavar="BYTES",
              help="Maximum size of a frame from a client, and of all of its fragments.")  # fmt: skip
@click.option("--compress/--no-compress", default=None,
              help="Compress frames for clients that can; by default for other machines only.")  # fmt: skip
def websocket(ctx: Context, action: str, **options: Any) -> None:
    """Serve rosbridge clients over WebSocket.

    ACTION is run (until Ctrl-C, the default), start (in the background), stop or status. Needs pip install
    '.[websocket]' in a clone.

    JSON keys: kind, running, pid, address, already (of start), and the counters of status.
    """
    _act(ctx, "websocket", action, options)


@gateway.command("foxglove", examples=["slidectl gateway foxglove start"])
@_listening("foxglove", *_FOR_BROWSERS)
def foxglove(ctx: Context, action: str, **options: Any) -> None:
    """Serve the Foxglove app.

    ACTION is run (until Ctrl-C, the default), start (in the background), stop or status. Needs pip install
    '.[foxglove]' in a clone.

    JSON keys: kind, running, pid, address, already (of start), and the counters of status.
    """
    _act(ctx, "foxglove", action, options)


_FORMS: dict[Any, dict[str, Any]] = {
    int: {"type": int, "metavar": "N"},
    float: {"type": float, "callback": finite, "metavar": "X"},
    str: {"type": str, "metavar": "TEXT"},
    bool: {"is_flag": True},
    tuple[str, ...]: {"type": str, "multiple": True, "metavar": "TEXT"},
}
"""Type of a field of a gateway's options -> how its option of the command line is made."""


@cache
def _command_of(kind: str, part: Part | None) -> click.Command:
    """The command of a gateway, ours or `part` of an installed package; its options are the fields of `Options`.

    Raises Refused: a library of ours is missing. PartError.
    """
    import dataclasses
    import inspect
    from typing import get_type_hints

    from slidectl.extensions.gateways.gateway import GatewayOptions

    gateway_class: Any = gateway_kinds.load(kind)
    options: list[click.Parameter] = []
    with nullcontext() if part is None else GATEWAYS.running(part):
        of_all = {field.name for field in dataclasses.fields(GatewayOptions)}
        types = get_type_hints(gateway_class.Options)
        for field in dataclasses.fields(gateway_class.Options):
            if field.name in of_all:
                continue
            if types[field.name] not in _FORMS:
                known = "int, float, str, bool or tuple[str, ...]"
                raise TypeError(f"{field.name} of Options is of {types[field.name]}, and not of {known}")
            flag, text = f"--{field.name.replace('_', '-')}", field.metadata.get("help", "")
            needs = field.default is dataclasses.MISSING
            given = {"required": True} if needs else {"default": field.default, "show_default": True}
            options.append(click.Option([flag, field.name], help=text, **given, **_FORMS[types[field.name]]))

    @click.pass_obj
    def run(ctx: Context, /, action: str, **given: Any) -> None:
        _act(ctx, kind, action, given)

    for option in reversed(_TRUST):
        run = option(run)
    action = click.Argument(["action"], type=click.Choice(_ACTIONS), default="run")
    about = inspect.cleandoc(gateway_class.__doc__ or (part.owner if part else kind))
    text = f"{about}\n\nACTION is run (until Ctrl-C, the default), start (in the background), stop or status."
    example = f"slidectl gateway {kind} start"
    return cli_command(kind, params=[action, *options], help=text, examples=[example])(run)


@gateway.command("status", examples=["slidectl gateway status", "slidectl gateway status --json"])
@click.pass_obj
def status(ctx: Context) -> None:
    """Show the gateways of this daemon that run.

    'slidectl gateway ros1 status' shows all counters of one. JSON keys of each: kind, running, pid, address, and its
    counters.
    """
    from slidectl.extensions.gateways import process

    shown = [_state(ctx, found) for found in process.find_all(ctx.paths)]
    ctx.emit_rows(shown, ["kind", "pid", "address", "connections", "dropped"], "no gateway runs")


def known(kind: str) -> str:
    """The name of a gateway, unchanged. Raises UnknownName, PartError."""
    gateway_kinds.find(kind)
    return kind


def start(ctx: Context, kind: str, options: dict[str, Any]) -> bool:
    """Start a gateway in the background and print it. True when it ran already. Raises Refused, TimedOut."""
    from slidectl.extensions.gateways import process

    found, already = process.start(ctx.paths, kind, options, ctx.wait_limit(process.START_LIMIT_S))
    how = "runs already" if already else "started"
    text = f"{kind} gateway: {how}, process {found.pid}, {found.address}"
    ctx.done({**_place(found), "already": already}, text)
    return already


def stop_all(ctx: Context) -> None:
    """Stop the gateways of this daemon. Raises TimedOut."""
    from slidectl.extensions.gateways import process

    for found in process.find_all(ctx.paths):
        process.stop(ctx.paths, found.kind, ctx.wait_limit(process.STOP_LIMIT_S))


def _act(ctx: Context, kind: str, action: str, options: dict[str, Any]) -> None:
    from slidectl.extensions.gateways import process

    if action == "run":
        process.run(ctx.paths, kind, options, lambda address: ctx.done({"kind": kind, "address": address}, address))
    elif action == "start":
        source = click.get_current_context().get_parameter_source
        given = [name for name in options if source(name) is click.core.ParameterSource.COMMANDLINE]
        if start(ctx, kind, options) and given:
            words = ", ".join(f"--{name.replace('_', '-').replace('origins', 'origin')}" for name in given)
            ctx.warn(f"it runs already, so {words} had no effect")
    elif action == "stop":
        stopped = process.stop(ctx.paths, kind, ctx.wait_limit(process.STOP_LIMIT_S))
        how = "does not run" if stopped is None else f"stopped, it was process {stopped.pid}"
        ctx.done({"kind": kind, "running": False, "pid": stopped and stopped.pid}, f"{kind} gateway: {how}")
    else:
        found = process.find(ctx.paths, kind)
        if found is None:
            raise Refused(f"no {kind} gateway runs", "start it with: " + command(ctx.paths, f"gateway {kind} start"))
        state = _state(ctx, found)
        ctx.emit(state, output.as_lines({key: value for key, value in state.items() if key != "running"}))


def _place(found: RunningGateway) -> dict[str, Any]:
    return {"kind": found.kind, "running": True, "pid": found.pid, "address": found.address}


def _state(ctx: Context, found: RunningGateway) -> dict[str, Any]:
    """The process and address of a gateway, and its counters."""
    from slidectl.extensions.gateways.gateway import status_service

    try:
        answer = ctx.call(status_service(found.kind))
    except (NoDaemon, Refused):
        return {**_place(found), "daemon": "the gateway waits for the daemon"}
    counters = zip(answer["names"], answer["values"], strict=True)
    return _place(found) | {name: int(text) if text.isdigit() else text for name, text in counters}
