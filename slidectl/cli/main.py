"""The root command: a table of all commands, whose modules are imported only when they run.

It parses the options before the command, and nothing else.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli.commands import Group
from slidectl.cli.context import Context
from slidectl.cli.failure import guard
from slidectl.cli.options import environment_namespace

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

COMPLETION_VARIABLE = "_SLIDECTL_COMPLETE"


class Entry:
    """One line of the command table. The command object has the command's name in its module.

    `help` is equal to the first sentence of the command's own help (a test compares them). No NamedTuple: making
    such a class takes longer than to import this module.
    """

    __slots__ = ("help", "module", "section")

    def __init__(self, section: str, module: str, help: str) -> None:
        self.section = section
        self.module = module
        self.help = help


COMMANDS = {
    "daemon": Entry("The daemon", "daemon", "Start, stop and watch the daemon that holds the world."),
    "sim": Entry("The daemon", "sim", "Time of the world: status, pause, step, speed, reset."),
    "spawn": Entry("Robots", "spawn", "Put a robot into the world."),
    "delete": Entry("Robots", "robots", "Take robots out of the world."),
    "robots": Entry("Robots", "robots", "List the robots, or show one with its joints."),
    "estop": Entry("Robots", "robots", "Stop robots at once, or release them."),
    "check": Entry("Robots", "check", "Check a model, a launch file or controllers, without a daemon."),
    "urdf": Entry("Robots", "urdf", "Print the URDF that xacro makes of a model, without a daemon."),
    "controller": Entry("Robots", "controller", "Load, start, stop and list controllers."),
    "launch": Entry("Robots", "launch", "Run a launch file as roslaunch does."),
    "pub": Entry("Topics, services, parameters", "pub", "Publish a message."),
    "echo": Entry("Topics, services, parameters", "echo", "Print the messages of a topic."),
    "wait": Entry("Topics, services, parameters", "wait", "Wait until a field of a topic has a value."),
    "topic": Entry("Topics, services, parameters", "topic", "List, inspect and measure topics."),
    "hz": Entry("Topics, services, parameters", "topic_measure", "Measure how often messages come."),
    "service": Entry("Topics, services, parameters", "service", "List, inspect and call services."),
    "param": Entry("Topics, services, parameters", "param", "Get, set, load and dump parameters."),
    "tf": Entry("Topics, services, parameters", "tf", "Show the frames and the transforms between them."),
    "msg": Entry("Topics, services, parameters", "msg", "Show message types."),
    "srv": Entry("Topics, services, parameters", "msg", "Show service types."),
    "ros": Entry("The ROS commands", "ros.command", "Run a ROS command word for word."),
    "ros-commands": Entry("The ROS commands", "ros.command", "Print shell functions named as the ROS commands."),
    "shell": Entry("slidectl", "shell", "Run many commands in one process."),
    "completion": Entry("slidectl", "completion", "Print the completion script of a shell."),
    "version": Entry("slidectl", "version", "Print the version."),
}

_CALLED_ELSEWHERE = {
    "kill": ("daemon stop", "delete ROBOT", "ros rosnode kill NODE"),
    "run": ("launch FILE", "ros rosrun PACKAGE NODE"),
    "start": ("launch FILE",),
    "switch_controller": ("controller switch",),
    **{tool: (f"ros {tool}",) for tool in ("roslaunch", "rostopic", "rosservice", "rosparam", "rosrun", "rosnode")},
}
"""Words that people type for a command -> the commands."""

HELP = """Run the ros_control and Gazebo tutorials from the shell, without ROS and without Gazebo.

A daemon holds the simulated world; every other command talks to it. Start with 'slidectl daemon start' and
'slidectl spawn slider'. 'slidectl help COMMAND' is 'slidectl COMMAND --help'.

\b
Exit codes:
  0    done
  1    refused or failed: the service said no, or the condition is false
  2    wrong usage, or a bad file
  3    no daemon answers
  4    timed out
  130  interrupted (Ctrl-C)

\b
Environment:
  SLIDECTL_INSTANCE, SLIDECTL_SOCKET   as --instance and --socket
  SLIDECTL_NAMESPACE                   as --ns
  NO_COLOR                             no colours
"""


class Root(Group):
    """The group at the top. It knows names and short helps from the table alone."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        entry = COMMANDS.get(cmd_name)
        return None if entry is None else load(cmd_name, entry)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] != "help":
            return super().resolve_command(ctx, args)
        if not args[1:]:
            from slidectl.cli import output

            output.write(ctx.get_help())
            ctx.exit()
        return super().resolve_command(ctx, [*args[1:], "--help"])

    def elsewhere(self, ctx: click.Context, name: str) -> list[str]:
        """The full commands that a name may mean: the groups that have one of that name, or what others call it."""
        found = []
        for group_name in COMMANDS:
            group = self.get_command(ctx, group_name)
            if isinstance(group, Group) and name in group.list_commands(ctx):
                found.append(f"slidectl {group_name} {name}")
        return found + [f"slidectl {meant}" for meant in _CALLED_ELSEWHERE.get(name, ())]

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        extra.setdefault("obj", Context())
        return super().make_context(*args, **extra)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        width = max(map(len, COMMANDS))
        for section in dict.fromkeys(entry.section for entry in COMMANDS.values()):
            rows = [(name.ljust(width), entry.help) for name, entry in COMMANDS.items() if entry.section == section]
            with formatter.section(section):
                formatter.write_dl(rows)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        items = [
            CompletionItem(name, help=entry.help) for name, entry in COMMANDS.items() if name.startswith(incomplete)
        ]
        return items + click.Command.shell_complete(self, ctx, incomplete)


def load(name: str, entry: Entry) -> click.Command:
    """Import the module of a command and take the command out of it."""
    command = getattr(import_module(f"slidectl.cli.{entry.module}"), name.replace("-", "_"))
    assert isinstance(command, click.Command)
    return command


def _print_version(click_context: click.Context, _param: click.Parameter, value: bool) -> None:
    if value and not click_context.resilient_parsing:
        from slidectl import __version__
        from slidectl.cli import output

        output.write(f"slidectl {__version__}")
        click_context.exit()


root = Root(
    "slidectl",
    help=HELP,
    examples=["slidectl daemon start", "slidectl spawn slider --controllers config/slider_control.yaml"],
    context_settings={"max_content_width": 110},
    params=[
        click.Option(
            ["--version"],
            is_flag=True,
            expose_value=False,
            is_eager=True,
            callback=_print_version,
            help="Print the version and exit.",
        )
    ],
)


def run(argv: Sequence[str]) -> int:
    """Run one command line; its exit code. Prints errors itself and raises nothing but KeyboardInterrupt."""
    context = Context()
    if COMPLETION_VARIABLE in os.environ:
        return _complete(os.environ[COMPLETION_VARIABLE])
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    return guard(lambda: _invoke(list(argv), context), context, argv)


def _invoke(argv: list[str], context: Context) -> None:
    context.namespace = environment_namespace()
    with root.make_context("slidectl", argv, obj=context) as click_context:
        root.invoke(click_context)


def _complete(instruction: str) -> int:
    from click.shell_completion import shell_complete

    return shell_complete(root, {}, "slidectl", COMPLETION_VARIABLE, instruction)
