"""`slidectl ros NAME ...`: runs a ROS tool with the words behind its name untouched.

It knows the tools by name only, and prints how one ended badly.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click

from slidectl.cli.commands import Command, command
from slidectl.cli.context import Context
from slidectl.cli.ros.failure import told
from slidectl.errors import SlidectlError, UsageError, closest

# name -> module in this package, whose `main` takes the Context and the words. Its `PREFIX` begins errors.
TOOLS = {
    "roslaunch": "roslaunch",
    "rostopic": "rostopic",
    "rosservice": "rosservice",
    "rosparam": "rosparam",
    "rosrun": "rosrun",
    "rosnode": "rosnode",
    "rosmsg": "rosmsg",
    "rossrv": "rossrv",
    "roscore": "roscore",
    "rosclean": "rosclean",
}


class RawCommand(Command):
    """Whatever stands behind the first word belongs to the tool, options too."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.allow_interspersed_args = False
        return super().parse_args(ctx, args)


def _complete(click_context: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    return [] if click_context.params.get("words") else [name for name in TOOLS if name.startswith(incomplete)]


@command(
    cls=RawCommand,
    examples=[
        "slidectl ros rostopic pub -1 /slider/joint1_position_controller/command std_msgs/Float64 'data: 1.0'",
        "slidectl ros rosservice call /slider/controller_manager/list_controllers",
        'eval "$(slidectl ros-commands)"; rostopic list',
    ],
)
@click.argument("words", nargs=-1, required=True, metavar="NAME [ARGUMENT]...", shell_complete=_complete)
@click.pass_obj
def ros(ctx: Context, words: tuple[str, ...]) -> None:
    """Run a ROS command word for word.

    NAME is one of roslaunch, rostopic, rosservice, rosparam, rosrun, rosnode, rosmsg, rossrv, roscore and rosclean;
    ARGUMENTs are theirs, and so are output and exit codes, save that 0 means done: 3 is no daemon, 130 Ctrl-C.
    Options of slidectl stand before NAME. 'slidectl ros-commands' makes shell functions of these names.
    """
    name, *argv = words
    if name not in TOOLS:
        near = closest(name, TOOLS)
        suggestion = f" Did you mean {near!r}?" if near else ""
        raise UsageError(f"no ROS command {name!r}.{suggestion}", f"there are: {', '.join(TOOLS)}")
    run(ctx, name, argv)


def run(ctx: Context, name: str, argv: Sequence[str]) -> None:
    """Run one tool; how it failed goes to stderr in its own words. Raises click's Exit with the code then."""
    _heed_interrupts()
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(errors="surrogateescape")  # what is no text is for the reader of YAML to refuse
    tool: Any = import_module(f"slidectl.cli.ros.{TOOLS[name]}")
    try:
        tool.main(ctx, list(argv))
    except SlidectlError as error:
        if ctx.verbose >= 2:
            raise
        print(told(error, getattr(tool, "PREFIX", "ERROR: ")), file=sys.stderr, flush=True)
        raise click.exceptions.Exit(error.exit_code) from None


def _heed_interrupts() -> None:
    """SIGINT ends a node also in the background of a script, where shells start programs with it ignored."""
    import signal

    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
