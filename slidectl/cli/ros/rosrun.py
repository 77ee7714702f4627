"""`rosrun PACKAGE EXECUTABLE`: programs of ROS that have a counterpart here, and those of the user's own packages."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.failure import Failure
from slidectl.cli.spawn import tell_own_packages
from slidectl.errors import BadFile

if TYPE_CHECKING:
    from slidectl.description.packages import Packages

_USAGE = """Usage: rosrun [--prefix cmd] [--debug] PACKAGE EXECUTABLE [ARGS]
  rosrun will locate PACKAGE and try to find an executable named EXECUTABLE in it,
  else the counterpart that slidectl has of it, and run it with the given ARGS.
"""
_NO_PACKAGE = 2
_NO_EXECUTABLE = 3
_NOT_A_NAME = 1

# (package, executable) -> `module:function` in this package, which takes the Context and the words
_PROGRAMS = {
    ("controller_manager", "controller_manager"): "rosrun_scripts:controller_manager",
    ("controller_manager", "spawner"): "rosrun_scripts:spawner",
    ("controller_manager", "unspawner"): "rosrun_scripts:unspawner",
    ("gazebo_ros", "spawn_model"): "rosrun_scripts:spawn_model",
    ("tf", "tf_echo"): "tf_echo:tf_echo",
    ("tf", "tf_monitor"): "tf_monitor:tf_monitor",
    ("tf", "view_frames"): "tf_graph:view_frames",
    ("tf2_tools", "echo.py"): "tf_echo:echo_py",
    ("tf2_tools", "view_frames.py"): "tf_graph:view_frames_py",
    ("tf", "static_transform_publisher"): "rosrun_scripts:static_transform",
    ("tf2_ros", "static_transform_publisher"): "rosrun_scripts:static_transform_tf2",
    ("xacro", "xacro"): "rosrun_scripts:xacro",
    ("xacro", "xacro.py"): "rosrun_scripts:xacro",
}
_TOOLS = ("rostopic", "rosservice", "rosparam", "rosnode", "rosmsg", "rossrv", "roslaunch")


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Run a program."""
    words = list(argv)
    prefix: list[str] = []
    debug = False
    while words and words[0].startswith("-"):
        option = words.pop(0)
        if option == "--prefix" and words:
            prefix = shlex.split(words.pop(0))
        elif option.startswith("--prefix="):
            prefix = shlex.split(option.partition("=")[2])
        elif option in ("--debug", "-d"):
            debug = True
        else:
            words.clear()
    if len(words) < 2:
        return output.write(_USAGE)
    package, executable, *arguments = words
    if executable.endswith("/"):
        output.write(f"Invalid filename:  {executable}")
        raise click.exceptions.Exit(_NOT_A_NAME)
    return _run(ctx, package, executable, arguments, prefix, debug)


def _run(ctx: Context, package: str, executable: str, arguments: list[str], prefix: list[str], debug: bool) -> None:
    """A program of ours, in this process unless there is a prefix; else one of the user's in place of this process."""
    action = _ours(ctx, package, executable, arguments)
    if action is not None and not prefix:
        return action()
    if action is not None:
        itself = [sys.executable, "-m", "slidectl", *_options(ctx), "ros", "rosrun", package, executable]
        return _execute([*prefix, *itself, *arguments])
    path = _find(ctx, package, executable, debug)
    return _execute([*prefix, str(path), *arguments])


def _ours(ctx: Context, package: str, executable: str, arguments: list[str]) -> Callable[[], None] | None:
    """What runs a program that has a counterpart here."""
    place = _PROGRAMS.get((package, executable))
    if place is not None:
        module, _, function = place.partition(":")
        return lambda: getattr(import_module(f"slidectl.cli.ros.{module}"), function)(ctx, arguments)
    if package == executable and package in _TOOLS:
        from slidectl.cli.ros import command

        return lambda: command.run(ctx, package, arguments)
    from slidectl.launch.node_kinds import has_counterpart

    if not has_counterpart(package, executable):
        return None
    from slidectl.cli.ros import nodes

    return lambda: nodes.run(ctx, package, executable, arguments, packages())


def packages() -> Packages:
    """The lookup of packages, upwards from the working folder."""
    from slidectl.description.packages import Packages

    return Packages(start=Path.cwd())


def _options(ctx: Context) -> list[str]:
    """The options that pick the daemon."""
    pairs = (("--instance", ctx.instance), ("--socket", ctx.socket))
    return [word for option, value in pairs if value for word in (option, value)]


def _find(ctx: Context, package: str, executable: str, debug: bool) -> Path:
    """The user's program. Raises Failure: no such package (2), no such program in it (3)."""
    from slidectl.launch import node_kinds
    from slidectl.launch.plan import Location, Node

    lookup = packages()
    folders = list(lookup.candidates(package))
    here = sorted({name for known, name in _known() if known == package})
    if not folders and not here:
        known = sorted({name for name, _ in _known()} | set(lookup.names()))
        raise Failure(f"[rospack] Error: package '{package}' not found\nthere are: {' '.join(known)}", _NO_PACKAGE)
    if debug:
        output.write("\n".join(["[rosrun] Looking in:", *map(str, folders)]))
    node = Node(package, executable, executable, "/", Location("rosrun", None))
    try:
        path = node_kinds.find(node, lookup)
        tell_own_packages(ctx, lookup)
        return path
    except node_kinds.NeedsRos as error:
        reason = error.reason.partition(": ")[2]
        raise Failure(f"[rosrun] {reason}\n{(error.hint or '').partition(chr(10))[0]}") from None
    except BadFile as error:
        output.write(f"[rosrun] Couldn't find executable named {executable} below {folders[0] if folders else package}")
        programs = f"slidectl has of {package}: {', '.join(here)}" if here else (error.hint or "").partition("\n")[0]
        raise Failure(programs or error.message, _NO_EXECUTABLE) from None


def _known() -> list[tuple[str, str]]:
    """Package and executable of all that has a counterpart."""
    from slidectl.launch.node_kinds import COUNTERPARTS

    windows = [("rviz", "rviz"), ("rqt_gui", "rqt_gui"), ("rqt_plot", "rqt_plot")]
    return [*_PROGRAMS, *COUNTERPARTS, *((tool, tool) for tool in _TOOLS), *windows]


def _execute(command: list[str]) -> None:
    """Become the program. Raises Failure when it cannot be run."""
    sys.stdout.flush()
    sys.stderr.flush()
    try:
        os.execvp(command[0], command)
    except OSError as error:
        raise Failure(f"[rosrun] cannot run {command[0]}: {error.strerror}", 126) from None
