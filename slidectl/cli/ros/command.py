"""`slidectl ros NAME ...`: runs a ROS tool with the words behind its name untouched.

It knows the tools by name only, and prints how one ended badly.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click

from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.errors import NoDaemon, SlidectlError, UsageError, closest

# name -> module in this package, where the tool is called as it is here. Its `PREFIX` begins errors.
TOOLS = {
    "roslaunch": "roslaunch",
    "rostopic": "rostopic",
    "rosservice": "rosservice",
    "rosparam": "rosparam",
    "rosrun": "rosrun",
    "rosnode": "rosnode",
    "rosmsg": "rosmsg",
    "rossrv": "rosmsg",
    "roscore": "roslaunch",
}


def _complete(click_context: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    return [] if click_context.params.get("words") else [name for name in TOOLS if name.startswith(incomplete)]


@command(
    # Whatever stands behind the first word belongs to the tool, options too.
    context_settings={"allow_interspersed_args": False},
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

    NAME is one of roslaunch, rostopic, rosservice, rosparam, rosrun, rosnode, rosmsg, rossrv and roscore; ARGUMENTs
    are theirs, and so are output and exit codes, save that 0 means done: 3 is no daemon, 130 Ctrl-C.
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
    # SIGINT ends a node also in the background of a script, where shells start programs with it ignored.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(errors="surrogateescape")  # what is no text is for the reader of YAML to refuse
    module: Any = import_module(f"slidectl.cli.ros.{TOOLS[name]}")
    try:
        getattr(module, name)(ctx, list(argv))
    except SlidectlError as error:
        if ctx.verbose >= 2:
            raise
        print(_told(error, getattr(module, "PREFIX", "ERROR: ")), file=sys.stderr, flush=True)
        raise click.exceptions.Exit(error.exit_code) from None


def _told(error: SlidectlError, prefix: str) -> str:
    """What a tool prints about an error: `prefix` stands before what is not in its own words."""
    from slidectl.cli.ros.arguments import Failure

    if isinstance(error, Failure):
        return error.message
    if isinstance(error, NoDaemon):
        return f"ERROR: Unable to communicate with master!\n{error}"
    return f"{prefix}{error}"
