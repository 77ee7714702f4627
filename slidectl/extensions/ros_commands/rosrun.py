"""`rosrun PACKAGE EXECUTABLE`: run counterparts of ROS programs, and programs of the user's own packages.

A node runs as in `slidectl launch`, as a plan with one node, until it ends or Ctrl-C.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from slidectl import names
from slidectl.cli import output
from slidectl.cli.command_table import WINDOWS
from slidectl.cli.context import Context
from slidectl.cli.spawn import package_lookup, report_own_packages
from slidectl.errors import BadFile, Refused, SlidectlError, UsageError, closest
from slidectl.extensions.launch.commands.launch import LaunchDaemon, RunningDaemon, ros_master
from slidectl.extensions.launch.commands.launch_text import Terminal
from slidectl.extensions.launch.node_kinds import COUNTERPARTS, has_counterpart, tasks
from slidectl.extensions.launch.nodes.controller_nodes import ManagerScript, is_command
from slidectl.extensions.launch.nodes.left_out import LeftOut
from slidectl.extensions.launch.plan import LaunchPlan, Location, Node, Remap, Setting
from slidectl.extensions.ros_commands.arguments import Failure, Parser, option, without_remappings
from slidectl.extensions.ros_commands.command import program, run
from slidectl.typed_values import read
from slidectl.writing import reason, write_whole

_USAGE = """rosrun [--prefix cmd] [--debug] PACKAGE EXECUTABLE [ARGS]
  rosrun will locate PACKAGE and try to find an executable named EXECUTABLE in it,
  else the counterpart that slidectl provides, and run it with the given ARGS."""
_NOT_A_NAME = 1
_NO_PACKAGE = 2
_NO_EXECUTABLE = 3
_WRONG_COUNT = 255
_HELP = frozenset(("-h", "--help"))
_PLACE = Location("rosrun", None)
_ASSIGNMENT = re.compile(r"(?P<name>[A-Za-z0-9_~/]+):=(?P<value>.*)\Z", re.DOTALL)
_TOOLS = ("rostopic", "rosservice", "rosparam", "rosnode", "rosmsg", "rossrv", "roslaunch")
_STATIC_USAGE = """Publishes the transform from frame_id to child_frame_id until it ends. Metres, radians:
Usage: static_transform_publisher x y z yaw pitch roll frame_id child_frame_id{period}
or with a quaternion:
Usage: static_transform_publisher x y z qx qy qz qw frame_id child_frame_id{period}
"""
# The usage texts of nodes.
_USAGES = {
    ("controller_manager", "controller_manager"): """Usage: controller_manager <command> [name...]

Commands: load, unload, start, stop, spawn (or sp: load and start), kill (or kl: stop and unload),
          list (or lc), list-types (or lt), reload-libraries [--restore]
""",
    ("controller_manager", "unspawner"): """Usage: unspawner <name>...

Stops the controllers while it runs, and starts them again when it ends.
""",
    ("controller_manager", "spawner"): """usage: spawner [-h] [--stopped] [--wait-for TOPIC] [--namespace NS]
               [--timeout S] [--no-timeout] controllers [controllers ...]

Loads and starts controllers (their names, or YAML files), and stops and unloads them when it ends.
It waits 30 s for the controller manager, and with --wait-for until a true std_msgs/Bool arrives.
""",
    ("gazebo_ros", "spawn_model"): """usage: spawn_model [-h] -urdf (-param NAME | -file FILE) -model NAME
                   [-x X] [-y Y] [-z Z] [-R R] [-P P] [-Y Y] [-J JOINT POSITION]
                   [-robot_namespace NS] [-reference_frame FRAME] [-unpause]
                   [-wait MODEL] [-package_to_model] [-b]

Spawns a robot whose URDF is in a parameter or a file. Metres, radians. -J may be repeated;
-wait waits for another robot; with -b it keeps running, and deletes the robot when it ends.
""",
    ("tf", "static_transform_publisher"): _STATIC_USAGE.format(period=" period(milliseconds)"),
    ("tf2_ros", "static_transform_publisher"): _STATIC_USAGE.format(period=""),
}
# Programs that are neither a node nor a tool.
_PROGRAMS = (("tf", "tf_echo"), ("tf2_tools", "echo.py"), ("xacro", "xacro"), ("xacro", "xacro.py"))


def rosrun(ctx: Context, argv: Sequence[str]) -> None:
    """Run a counterpart, in this process unless there is a prefix; else replace this process by the user's program."""
    parser = Parser(
        "rosrun",
        _USAGE,
        option("--prefix", "command to run it with", "cmd"),
        option("-d --debug", "print the folders that are searched"),
    )
    parser.disable_interspersed_args()  # the words behind PACKAGE belong to the program
    given = parser.parse(argv)
    if given.words and given.words[0] in WINDOWS and len(given.words) == 1:
        given.words = list(WINDOWS[given.words[0]])  # a window, whose program is left out
    if len(given.words) < 2:
        return parser.print_help()
    package, executable, *words = given.words
    prefix = shlex.split(given.prefix or "")
    if executable.endswith("/"):
        output.write(f"Invalid filename:  {executable}")
        raise click.exceptions.Exit(_NOT_A_NAME)
    is_tool = package == executable and package in _TOOLS
    is_ours = is_tool or (package, executable) in _PROGRAMS or has_counterpart(package, executable)
    if not is_ours:
        return _execute([*prefix, str(_find(ctx, package, executable, bool(given.debug))), *words])
    if prefix:
        return _execute([*prefix, *program(ctx), "ros", "rosrun", package, executable, *words])
    if is_tool:
        return run(ctx, package, words)
    if package == "xacro":
        return _xacro(ctx, words)
    if (package, executable) in _PROGRAMS:
        from slidectl.extensions.ros_commands import tf_echo

        return tf_echo.tf_echo(ctx, words) if package == "tf" else tf_echo.echo_py(ctx, words)
    code = _code_of_usage(package, executable, without_remappings(words))
    if code is not None:
        output.write(_USAGES[package, executable])
        raise click.exceptions.Exit(code)
    return _run_node(ctx, package, executable, words)


def _code_of_usage(package: str, executable: str, words: Sequence[str]) -> int | None:
    """The exit code of a node that only prints its usage; None when the node runs."""
    if (package, executable) not in _USAGES:
        return None
    if executable == "controller_manager":
        return None if words and is_command(words[0]) else int(bool(words))
    if executable == "unspawner":
        return None if words and words[0] not in _HELP else 1
    if executable == "static_transform_publisher":
        return None if len(words) in ((9, 10) if package == "tf" else (8, 9)) else _WRONG_COUNT
    return None if _HELP.isdisjoint(words) else 0


# --- nodes ------------------------------------------------------------------------------------------------------------


class _OneNode(Terminal):
    """The console of a plan with one node: prints its steps without the node's name."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.is_live = False

    def step(self, event: str, text: str, **details: Any) -> None:
        if event == "node":
            output.write(text.removeprefix(f"{details['node']}: "))

    def warn(self, text: str) -> None:
        super().warn(text.removeprefix("rosrun: "))


def _plan(ctx: Context, package: str, kind: str, words: Sequence[str]) -> LaunchPlan:
    """A plan with one node and its private parameters (`_name:=value`). `__name` and `__ns` set the node's name."""
    given = {match["name"]: match["value"] for word in words if (match := _ASSIGNMENT.match(word))}
    namespace = given.pop("__ns", os.environ.get("ROS_NAMESPACE") or ctx.namespace)
    node = Node(package, kind, given.pop("__name", kind.partition(".")[0]), names.join("/", namespace), _PLACE)
    node.words = [word for word in words if not _ASSIGNMENT.match(word)]
    node.remaps = tuple(Remap(name, value, _PLACE) for name, value in given.items() if not name.startswith("_"))
    settings = [
        Setting(names.join(node.full_name, name[1:]), _PLACE, f"{name}:=", partial(read, value))
        for name, value in given.items()
        if re.match(r"_[^_]", name)
    ]
    return LaunchPlan(settings=settings, nodes=[node])


def _run_node(ctx: Context, package: str, kind: str, words: Sequence[str]) -> None:
    """Run the node; returns when it is done.

    Raises:
        BadFile: its arguments are invalid. StepFailed: it failed. NoDaemon.
    """
    from slidectl.extensions.launch.execution import Execution
    from slidectl.extensions.launch.task import Options, Run
    from slidectl.supervision import Interrupted, Interrupts

    plan, packages, master = _plan(ctx, package, kind, words), package_lookup(()), ros_master(ctx)
    try:
        made = tasks(plan, packages, has_master=bool(master))
    except SlidectlError as error:
        raise _plain(error) from None
    for task in made:
        if task.family == "notice":  # a launch goes on without such a node; here it is the only one
            assert isinstance(task, LeftOut)
            raise Refused(f"{package}/{kind} cannot be run here", "\n".join(task.why(ctx.paths)))
        if isinstance(task, ManagerScript):
            task.goes_on = True  # the script goes on after a failure where a launch ends
    # A Gazebo node starts a daemon; every other node needs one that runs.
    is_world = package == "gazebo_ros" and kind in ("gazebo", "gzserver", "debug", "perf")
    daemon = LaunchDaemon(ctx, child=True, wait=False) if is_world else RunningDaemon(ctx)
    with Interrupts() as interrupts:
        folder = str(ctx.paths.folder / "launch")
        environment = {"ROS_MASTER_URI": master} if master else {}
        run = Run(plan, packages, _OneNode(ctx), Options(), interrupts, folder, environment)
        session = Execution(run, made, daemon)
        try:
            with interrupts.raised():
                session.bring_up()
                session.watch()
        except Interrupted as interrupted:
            if interrupted.number == signal.SIGINT:
                raise KeyboardInterrupt from None
        except SlidectlError as error:
            plain = _plain(error)
            others = [robot["namespace"] for robot in run.controlled_robots()] if run.is_connected else []
            if made[0].manager_namespace is not None and "there was no" in plain.message and others:
                line = " ".join(["rosrun", package, kind, *words, f"__ns:={others[0]}"])
                plain.hint = f"type: {line}"
            raise plain from None
        finally:
            session.shut_down()


def _plain(error: SlidectlError) -> SlidectlError:
    """The error without its location: the plan has one node and no file."""
    error.message = re.sub(r"^rosrun: (node \S+ \(\S+\): |\S+: )?", "", error.message)
    return error


# --- programs ---------------------------------------------------------------------------------------------------------


def _xacro(ctx: Context, argv: Sequence[str]) -> None:
    """Print the expanded model, or write it into the file of `-o`. Raises as `description.load`, mostly BadFile."""
    from slidectl import description
    from slidectl.description.missing import from_environment, write_notes
    from slidectl.description.models import xacro_words

    parser = Parser(
        "xacro",
        "rosrun xacro xacro [-o FILE] MODEL.xacro [name:=value...]",
        option("-o", "write the URDF into a file", "FILE", dest="file"),
        option("-i --inorder --xacro-ns --check-order --debug -q -v", "no effect", dest="idle"),
    )
    given = parser.parse(argv)
    arguments, models = xacro_words(given.words)
    if len(models) != 1:
        raise UsageError(f"xacro takes one file, not {len(models)}", parser.get_usage().strip())
    lookup = package_lookup(())
    missing = from_environment()  # in a command of a launch file, whose launch decides what is left out
    try:
        document = description.load(models[0], arguments, lookup, missing=missing)
    finally:
        if missing is not None:
            write_notes(missing)
    report_own_packages(ctx, lookup)
    for notice in document.report:
        ctx.warn(str(notice))
    if given.file is None:
        return output.write(document.urdf)
    try:
        return write_whole(given.file, document.urdf)
    except OSError as error:
        raise Failure(f"ERROR: cannot write {given.file}: {reason(error, given.file)}") from None


def _find(ctx: Context, package: str, executable: str, debug: bool) -> Path:
    """The path of the user's program. Raises Failure: no such package (2), no such program in it (3)."""
    from slidectl.extensions.launch import node_kinds

    lookup = package_lookup(())
    folders = lookup.candidates(package)
    ours = [*_PROGRAMS, *_USAGES, *COUNTERPARTS, *((tool, tool) for tool in _TOOLS), *WINDOWS.values()]
    here = sorted({name for known, name in ours if known == package})
    if not folders and not here:
        known = sorted({name for name, _ in ours} | set(lookup.names()))
        meant = closest(package, known)
        ways = f"did you mean {meant}?" if meant else "ROS_PACKAGE_PATH names the folders of your own packages"
        text = f"[rospack] Error: package '{package}' not found\n{ways}\navailable: {' '.join(known)}"
        raise Failure(text, _NO_PACKAGE)
    if debug:
        output.write("\n".join(["[rosrun] Looking in:", *map(str, folders)]))
    try:
        path = node_kinds.find(Node(package, executable, executable, "/", _PLACE), lookup)
    except node_kinds.NeedsRos as error:
        reason = error.reason.partition(": ")[2]
        raise Failure(f"[rosrun] {reason}\n{(error.hint or '').partition(chr(10))[0]}") from None
    except BadFile as error:
        output.write(f"[rosrun] Couldn't find executable named {executable} below {folders[0] if folders else package}")
        meant = closest(executable, here)
        suggestion = f"did you mean {meant}? " if meant else ""
        programs = (
            f"{suggestion}slidectl provides for {package}: {', '.join(here)}"
            if here
            else (error.hint or "").partition("\n")[0]
        )
        raise Failure(programs or error.message, _NO_EXECUTABLE) from None
    report_own_packages(ctx, lookup)
    return path


def _execute(command: list[str]) -> None:
    """Replace this process by the program. Raises Failure when it cannot be run."""
    sys.stdout.flush()
    sys.stderr.flush()
    try:
        os.execvp(command[0], command)
    except OSError as error:
        raise Failure(f"[rosrun] cannot run {command[0]}: {error.strerror}", 126) from None
