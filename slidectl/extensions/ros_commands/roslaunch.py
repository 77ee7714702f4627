"""`roslaunch` and `roscore`.

`roslaunch` passes its options to `slidectl launch`, which does the work. Options without a meaning here are accepted;
for those about ports or threads a warning is printed. `roscore` runs a daemon until the command ends.
"""

from __future__ import annotations

import select
import signal
from collections.abc import Sequence
from optparse import Option, Values
from typing import Any

import click

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.errors import BadFile, SlidectlError, UnknownName
from slidectl.extensions.ros_commands.arguments import Failure, Parser, option
from slidectl.operating_system import ProcessEnd

PREFIX = "RLException: "

_USAGE = """roslaunch [options] [package] <filename> [arg_name:=value...]
       roslaunch [options] <filename> [<filename>...] [arg_name:=value...]

If <filename> is a single dash ('-'), launch XML is read from standard input."""
_EXCLUSIVE = ("nodes", "find_node", "args", "ros_args")

_SILENT_OPTIONS = (
    option("--local", "no effect: everything is local"),
    option("--no-summary", "no effect: there is no summary"),
    option("--skip-log-check", "no effect: the log has a bound"),
    option("--disable-title", "no effect: the terminal's title stays"),
)
_CORE = option("--core", "no effect: the daemon is the master")
_VERBOSE = option("-v", "print more", dest="verbose")
# Options of both tools; a warning says that they have no effect.
_IDLE = (
    option("-p --port", "no effect: there are no ports", "PORT"),
    option("-w --numworkers", "no effect: there is one thread", "NUM_WORKERS"),
    option("-t --timeout", "no effect: there are no ports", "TIMEOUT"),
    option("--master-logger-level", "no effect", "LEVEL"),
)


def roslaunch(ctx: Context, argv: Sequence[str]) -> None:
    """Launch, or print a listing. Raises the exceptions of `slidectl launch`."""
    from slidectl.extensions.launch.commands.launch import launch

    own = [param for param in launch.params if isinstance(param, click.Option)]
    passed_on = [
        Option(param.opts[0], help=param.help, action="store_true")
        if param.is_flag
        else Option(param.opts[0], help=param.help, action="append", metavar=param.metavar)
        for param in own
    ]
    parser = Parser("roslaunch", _USAGE, *passed_on, *_SILENT_OPTIONS, _CORE, *_IDLE, _VERBOSE)
    given = parser.parse(argv)
    files = [word for word in given.words if ":=" not in word]
    if sum(bool(getattr(given, dest)) for dest in _EXCLUSIVE) > 1:
        parser.error("only one of [--nodes, --find-node, --args --ros-args] may be specified")
    if not files:
        parser.error("you must specify at least one input file")
    if files.count("-") > 1:
        parser.error("Only a single instance of the dash ('-') may be specified.")
    _warn_idle(ctx, given)
    words: list[str] = []
    for each in passed_on:
        values = getattr(given, str(each.dest)) or []
        words += [each.get_opt_string()] if values is True else [f"{each.get_opt_string()}={v}" for v in values]
    ctx.verbose += bool(given.verbose)
    with launch.make_context("roslaunch", [*words, "--", *given.words], obj=ctx) as click_context:
        try:
            launch.invoke(click_context)
        except (UnknownName, BadFile) as error:
            raise _in_its_words(error, files) from None


def _warn_idle(ctx: Context, given: Values) -> None:
    idle = [each.get_opt_string() for each in (_CORE, *_IDLE) if getattr(given, str(each.dest), None) is not None]
    if idle:
        ctx.warn(f"{', '.join(idle)} {'has' if len(idle) == 1 else 'have'} no effect here")


def _in_its_words(error: UnknownName | BadFile, names: Sequence[str]) -> SlidectlError:
    """For a missing launch file, an error with roslaunch's line and `error` below it; else `error`."""
    if isinstance(error, UnknownName):
        is_missing = error.kind in ("package", "launch file", "shipped launch file") and error.name in names
    else:
        is_missing = error.file in names and error.reason == "no such launch file"
    if not is_missing:
        return error
    if len(names) == 2:
        text = f"[{names[1]}] is neither a launch file in package [{names[0]}] nor is [{names[0]}] a launch file name"
    else:
        text = f"[{names[0]}] is not a launch file name"
    return Failure(f"{PREFIX}{text}\n{error}")


# --- roscore ----------------------------------------------------------------------------------------------------------


def roscore(ctx: Context, argv: Sequence[str]) -> None:
    """Start the daemon and wait until it ends. Ctrl-C and SIGTERM end both with exit code 0."""
    from slidectl.cli.daemon import STOP_LIMIT_S
    from slidectl.daemon import lifecycle

    parser = Parser(
        "roscore",
        "roscore [options]",
        *_IDLE,
        _VERBOSE,
        option("--sigint-timeout", "seconds that the daemon may take to end", "TIMEOUT"),
        option("--sigterm-timeout", "no effect", "TIMEOUT"),
    )
    given = parser.parse(argv, most=0, extra="roscore does not take arguments")
    _warn_idle(ctx, given)
    complaint = f"option --sigint-timeout: invalid floating-point value: {given.sigint_timeout!r}"
    limit = parser.number(float, given.sigint_timeout, STOP_LIMIT_S, complaint)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        pid = _start(ctx)
        process = ProcessEnd(pid)
        select.select([process], [], [])
    except KeyboardInterrupt:
        output.write("[master] killing on exit\nshutting down processing monitor...")
        lifecycle.stop(ctx.paths, ctx.wait_limit(limit))
        return output.write("... shutting down processing monitor complete\ndone")
    code = process.code()
    if code:
        raise Failure(f"[master] process has died [pid {pid}, exit code {code}]")
    return output.write("[master] process has finished cleanly")


def _start(ctx: Context) -> int:
    """Start a daemon with the parameters of a roscore; its process id. Raises Failure when one runs already."""
    from slidectl import __version__
    from slidectl.cli.daemon import START_LIMIT_S
    from slidectl.cli.param import store
    from slidectl.daemon import lifecycle
    from slidectl.daemon.options import DaemonOptions

    uri = f"unix://{ctx.paths.socket_text}"
    already = lifecycle.running(ctx.paths) is not None
    if not already:
        output.write(f"... logging to {ctx.paths.log}\nPress Ctrl-C to interrupt\nstarted roslaunch server {uri}")
        pid, already = lifecycle.start(ctx.paths, DaemonOptions(child=True), ctx.wait_limit(START_LIMIT_S))
    if already:
        raise Failure(
            f"{PREFIX}roscore cannot run as another roscore/master is already running. \n"
            f"Please kill other roscore/master processes before relaunching.\nThe ROS_MASTER_URI is {uri}"
        )
    # In ROS these texts end with a newline.
    parameters: dict[str, Any] = {"/rosdistro": "noetic\n", "/rosversion": f"{__version__}\n"}
    store(ctx, parameters)
    listed = "".join(f" * {name}: {value}" for name, value in parameters.items())
    output.write(
        f"slidectl version {__version__}\n\n\nSUMMARY\n========\n\nPARAMETERS\n{listed}\nNODES\n\n"
        f"auto-starting new master\nprocess[master]: started with pid [{pid}]\n"
        f"ROS_MASTER_URI={uri}\nstarted core service [/rosout]"
    )
    return pid
