"""`roscore`: a daemon for as long as this command runs; Ctrl-C and SIGTERM stop both, with exit code 0."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Sequence
from typing import Any

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.arguments import Option, Parser
from slidectl.cli.ros.failure import Failure

_START_LIMIT_S = 30.0
_STOP_LIMIT_S = 10.0
_WITHOUT_EFFECT = {"port": "-p", "workers": "-w", "socket_timeout": "-t", "logger_level": "--master-logger-level"}

_PARSER = Parser(
    "roscore",
    "roscore [options]",
    [
        Option(("-p", "--port"), "port", "no effect: there are no ports", "PORT"),
        Option(("-v",), "verbose", "say more"),
        Option(("-w", "--numworkers"), "workers", "no effect: there is one thread", "NUM_WORKERS"),
        Option(("-t", "--timeout"), "socket_timeout", "no effect: there are no ports", "TIMEOUT"),
        Option(("--master-logger-level",), "logger_level", "no effect", "LEVEL"),
        Option(("--sigint-timeout",), "sigint", "how long the daemon may take to end", "TIMEOUT"),
        Option(("--sigterm-timeout",), "sigterm", "no effect", "TIMEOUT"),
    ],
    about="roscore starts the daemon, which is master, parameter server, rosout and world in one.",
)


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Start the daemon and stay until a signal comes or the daemon ends."""
    given = _PARSER.parse(argv)
    if given.words:
        _PARSER.error("roscore does not take arguments")
    idle = [option for dest, option in _WITHOUT_EFFECT.items() if getattr(given, dest) is not None]
    if idle:
        ctx.warn(f"{', '.join(idle)} {'has' if len(idle) == 1 else 'have'} no effect here")
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        _stay(_start(ctx))
    except KeyboardInterrupt:
        pass
    else:
        return output.write("[master] process has finished cleanly")
    return _stop(ctx, _STOP_LIMIT_S if given.sigint is None else float(given.sigint))


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def _start(ctx: Context) -> int:
    """The process id of a new daemon. Raises Failure when one runs already."""
    from slidectl import __version__
    from slidectl.daemon import lifecycle
    from slidectl.daemon.options import DaemonOptions

    uri = f"unix://{ctx.paths.socket_text}"
    if lifecycle.running(ctx.paths) is not None:
        raise _already(uri)
    output.write(f"... logging to {ctx.paths.log}\nPress Ctrl-C to interrupt\nstarted roslaunch server {uri}")
    pid, already = lifecycle.start(ctx.paths, DaemonOptions(child=True), ctx.wait_limit(_START_LIMIT_S))
    if already:
        raise _already(uri)
    parameters = _set_parameters(ctx, __version__)
    lines = [f"slidectl version {__version__}", "", "", "SUMMARY", "========", "", "PARAMETERS"]
    lines += [f" * {name}: {str(value).strip()}" for name, value in parameters.items()]
    lines += ["", "NODES", "", "auto-starting new master", f"process[master]: started with pid [{pid}]"]
    output.write("\n".join([*lines, f"ROS_MASTER_URI={uri}", "started core service [/rosout]"]))
    return pid


def _already(uri: str) -> Failure:
    return Failure(
        "RLException: roscore cannot run as another roscore/master is already running. \n"
        f"Please kill other roscore/master processes before relaunching.\nThe ROS_MASTER_URI is {uri}"
    )


def _set_parameters(ctx: Context, version: str) -> dict[str, Any]:
    """What a core sets; its texts end with a newline there."""
    from slidectl.cli.param import store

    parameters = {"/rosdistro": "noetic\n", "/rosversion": f"{version}\n"}
    store(ctx, parameters)
    return parameters


def _stay(pid: int) -> None:
    """Until the daemon has ended. Raises Failure when it has not ended by itself or by request."""
    process = os.pidfd_open(pid)
    try:
        select.select([process], [], [])
    finally:
        os.close(process)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if code:
        raise Failure(f"[master] process has died [pid {pid}, exit code {code}]")


def _stop(ctx: Context, limit: float) -> None:
    from slidectl.daemon import lifecycle

    output.write("[master] killing on exit\nshutting down processing monitor...")
    lifecycle.stop(ctx.paths, ctx.wait_limit(limit))
    output.write("... shutting down processing monitor complete\ndone")
