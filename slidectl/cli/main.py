"""The root command: the table of all commands, whose modules are imported only when they run, and the exit codes.

It parses only the options before the command. No other module turns an exception into lines on stderr and an exit
code. With `--json` the lines are one object with the keys error, hint (null when there is none) and exit_code.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from slidectl import __version__
from slidectl.cli import output
from slidectl.cli.command_table import COMMANDS, WINDOWS, load
from slidectl.cli.commands import Group, full_namespace
from slidectl.cli.context import Context, paint
from slidectl.errors import (
    EXIT_DONE,
    EXIT_INTERRUPTED,
    EXIT_REFUSED,
    EXIT_USAGE,
    NoDaemon,
    NoDescriptors,
    Refused,
    SlidectlError,
    UsageError,
    cut,
)

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

COMPLETION_VARIABLE = "_SLIDECTL_COMPLETE"


_CALLED_ELSEWHERE = {
    "kill": ("daemon stop", "delete ROBOT", "ros rosnode kill NODE"),
    "rosbag": ("record", "play", "bag"),
    "run": ("launch FILE", "ros rosrun PACKAGE NODE"),
    "start": ("launch FILE",),
    "gazebo": ("daemon start", "launch FILE"),
    "list": ("controller list", "topic list", "robots"),
    "ros2": ("topic", "service", "param", "action", "controller", "launch", "ros"),
    "switch_controller": ("controller switch",),
    **{tool: (f"ros {tool}",) for tool in ("roslaunch", "rostopic", "rosservice", "rosparam", "rosrun", "rosnode")},
}
"""Words that users may type in place of a command -> the commands."""

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
    """The top-level group. It reads names and short helps from the table, and further names from installed packages."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        return load(cmd_name) if cmd_name in COMMANDS else self.find_installed(cmd_name)

    def entry_point(self, name: str) -> str:
        return name

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] != "help":
            self._answer_window(ctx, args)
            return super().resolve_command(ctx, args)
        if not args[1:]:
            output.write(ctx.get_help())
            ctx.exit()
        return super().resolve_command(ctx, [*args[1:], "--help"])

    def _answer_window(self, ctx: click.Context, args: list[str]) -> None:
        """Raise UsageError for the name of a window of ROS or Gazebo, with the commands that show the same."""
        if args[0] in COMMANDS or args[0].startswith("-"):
            return
        if args[0] in WINDOWS and args[0] not in self.installed():
            context = ctx.find_object(Context)
            from slidectl.open_page import instead_of_window

            package = WINDOWS[args[0]][0]
            hint = instead_of_window(package, args[1:], context.paths if context is not None else None)
            raise UsageError(f"no command {args[0]!r}", "\n".join(hint))

    def elsewhere(self, ctx: click.Context, name: str) -> list[str]:
        """The full commands that a name may mean: commands of that name in groups, and those of _CALLED_ELSEWHERE."""
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
        self.format_installed(formatter, width)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        helps = {name: entry.help for name, entry in COMMANDS.items()}
        helps |= {name: part.owner for name, part in self.installed().items()}
        items = [CompletionItem(name, help=text) for name, text in helps.items() if name.startswith(incomplete)]
        return items + click.Command.shell_complete(self, ctx, incomplete)


root = Root(
    "slidectl",
    help=HELP,
    examples=["slidectl daemon start", "slidectl spawn slider --controllers config/slider_control.yaml"],
    context_settings={"max_content_width": 110},
)
click.version_option(__version__, message="slidectl %(version)s", help="Print the version and exit.")(root)


def run(argv: Sequence[str]) -> int:
    """Run one command line and return its exit code. It prints errors, and raises only KeyboardInterrupt."""
    if COMPLETION_VARIABLE in os.environ:
        from click.shell_completion import shell_complete

        with suppress(SlidectlError):  # a broken package: a traceback would stand in the user's line
            return shell_complete(root, {}, "slidectl", COMPLETION_VARIABLE, os.environ[COMPLETION_VARIABLE])
        return EXIT_REFUSED
    context = Context()
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]

    def act() -> None:
        if namespace := os.environ.get("SLIDECTL_NAMESPACE"):
            context.namespace = full_namespace(namespace)
        invoke(argv, context)

    return guard(act, context, argv)


def invoke(argv: Sequence[str], context: Context) -> None:
    """Run the command of a command line. Its exceptions pass through."""
    with root.make_context("slidectl", list(argv), obj=context) as click_context:
        root.invoke(click_context)


# --- how a command ends ---------------------------------------------------------------------------------------------


def guard(action: Callable[[], None], context: Context, words: Sequence[str] = ()) -> int:
    """Run the action and return the exit code. Errors are printed, with a traceback when `-v` was given twice.

    `words` are those of the command line.
    """
    try:
        action()
        return EXIT_DONE
    except click.exceptions.Exit as leaving:
        return leaving.exit_code
    except output.ClosedPipe:
        return EXIT_INTERRUPTED if output.terminal_is_closed() else EXIT_DONE
    except (KeyboardInterrupt, click.Abort):
        return EXIT_INTERRUPTED
    except BrokenPipeError as error:
        if output.is_reader_gone():
            return EXIT_DONE
        return _report(NoDaemon(f"the connection broke: {error}"), context, words)
    except Exception as error:
        if output.terminal_is_closed():  # SIGHUP may come after a failed write
            return EXIT_INTERRUPTED
        return _report(error, context, words)


def _report(error: Exception, context: Context, words: Sequence[str]) -> int:
    if context.verbose >= 2:
        import traceback

        traceback.print_exception(error)
    message, hint, code = described(error)
    # In a command line that cannot be parsed, the parser may not have reached the option.
    as_json = isinstance(error, click.UsageError) and "--json" in words and words[0] != "ros"
    with suppress(OSError):  # stderr may be on a full disk; then only the exit code shows the error
        if context.format == "json" or as_json:
            record = {"error": cut(message), "hint": hint, "exit_code": code}
            print(output.as_json(record), file=sys.stderr, flush=True)
        else:
            text = f"{message}\n{hint}" if hint else message
            print(paint("error:", "red"), "\n".join(map(cut, text.rstrip().splitlines())), file=sys.stderr, flush=True)
    return code


def described(error: Exception) -> tuple[str, str | None, int]:
    """The message of an error, a hint (None when there is none) and its exit code."""
    if isinstance(error, OSError) and error.errno in NoDescriptors.ERRNOS:
        error = NoDescriptors("slidectl")
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:  # raised by click's output
        error = Refused(f"cannot write the output: {error.strerror}")
    if isinstance(error, SlidectlError):
        return error.message, error.hint, error.exit_code
    if isinstance(error, click.UsageError):
        see = f"see '{error.ctx.command_path} --help'" if error.ctx is not None else None
        return error.format_message().replace("\n\t", " "), see, EXIT_USAGE
    if isinstance(error, click.ClickException):
        return error.format_message(), None, error.exit_code
    fault = "this is a bug in slidectl; -vv shows the traceback"
    return f"{type(error).__name__}: {error}", fault, EXIT_REFUSED
