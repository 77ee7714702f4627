"""`slidectl ros NAME ...` and `slidectl ros-commands`: the ROS tools by name, and shell functions of their names.

A tool gets the words behind its name unchanged. This module knows only the names of the tools and their errors.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from io import TextIOWrapper
from shlex import quote
from typing import Any

import click

from slidectl.cli import output
from slidectl.cli.command_table import WINDOWS
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.command_steps import CommandStep, StepEffects
from slidectl.errors import NoDaemon, SlidectlError, UsageError, closest
from slidectl.operating_system import program_name

# Tool -> module in this package, which has a function of the tool's name. Its `PREFIX` begins error texts.
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
    "rosbag": "rosbag",
}
# Windows that tutorials open by a word of their own; each is answered, or run, as by rosrun.
PROGRAMS = {**WINDOWS, "gazebo": ("gazebo_ros", "gazebo")}
NAMES = (*TOOLS, *PROGRAMS)


def _complete(click_context: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    return [] if click_context.params.get("words") else [name for name in NAMES if name.startswith(incomplete)]


_NO_STEPS = ("roscore", "roslaunch", "rosrun")


def _step_effects(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:  # noqa: ARG001
    tool = parameters["words"][0]
    if tool in _NO_STEPS:
        raise UsageError(f"{tool} brings up a world, and a scenario has its own", "spawn what is needed")
    return StepEffects(may_add_controllers=True)


@command(
    step=CommandStep(effects=_step_effects),
    # All words behind the first one belong to the tool, also options.
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

    NAME is roslaunch, rostopic, rosservice, rosparam, rosrun, rosnode, rosmsg, rossrv, roscore or rosbag, or a window
    (rviz, rqt, rqt_plot, gazebo and so on), for which the commands that show the same are printed. ARGUMENTs, output
    and exit codes are those of the ROS command, except 0: success, 3: no daemon, 130: Ctrl-C. Options of slidectl go
    before NAME. 'slidectl ros-commands' prints shell functions of these names.
    """
    name, *argv = words
    if name not in NAMES:
        near = closest(name, NAMES)
        suggestion = f" Did you mean {near!r}?" if near else ""
        raise UsageError(f"no ROS command {name!r}.{suggestion}", f"there are: {', '.join(NAMES)}")
    if name in PROGRAMS:
        name, argv = "rosrun", [*PROGRAMS[name], *argv]
    run(ctx, name, argv)


def run(ctx: Context, name: str, argv: Sequence[str]) -> None:
    """Run one tool. An error is printed on stderr in the tool's words, and raises click's Exit with its code."""
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(errors="surrogateescape")  # the YAML reader refuses bytes that are not UTF-8
    module: Any = import_module(f"slidectl.extensions.ros_commands.{TOOLS[name]}")
    try:
        getattr(module, name)(ctx, list(argv))
    except SlidectlError as error:
        if ctx.verbose >= 2:
            raise
        from slidectl.extensions.ros_commands.arguments import Failure

        prefix = getattr(module, "PREFIX", "ERROR: ")
        if isinstance(error, Failure):
            prefix = ""
        elif isinstance(error, NoDaemon):
            prefix = "ERROR: Unable to communicate with master!\n"
        print(f"{prefix}{error}", file=sys.stderr, flush=True)
        raise click.exceptions.Exit(error.exit_code) from None


# --- shell functions --------------------------------------------------------------------------------------------------

SHELLS = ("bash", "zsh", "fish")
# Shells that read the functions of bash.
_LIKE_BASH = ("sh", "dash", "ash", "ksh", "mksh")


@command(
    "ros-commands",
    step=None,
    examples=['eval "$(slidectl ros-commands)"', "slidectl ros-commands --shell fish | source"],
)
@click.option(
    "--shell", type=click.Choice(SHELLS), help="For which shell; by default the one that calls this, else $SHELL."
)
@click.pass_obj
def ros_commands(ctx: Context, shell: str | None) -> None:
    """Print shell functions named as the ROS commands.

    With eval "$(slidectl ros-commands)" the lines of a ROS tutorial work in this shell, and in bash scripts that it
    starts. Each function calls 'slidectl ros NAME'; the daemon that --instance or --socket choose here is theirs.
    """
    prefix = " ".join(map(quote, program(ctx)))
    if (shell or _users_shell()) == "fish":
        output.write("\n".join(f"function {name}; {prefix} ros {name} $argv; end" for name in NAMES))
    else:
        functions = "\n".join(f'{name}() {{ _slidectl_ros {name} "$@"; }}' for name in NAMES)
        output.write(_POSIX.format(prefix=prefix, functions=functions, names=" ".join(NAMES)))


def _users_shell() -> str:
    """The shell that started this program, else that of $SHELL. Raises UsageError for a shell without functions."""
    caller = program_name(os.getppid())
    if caller in SHELLS or caller in _LIKE_BASH:
        return caller
    name = os.path.basename(os.environ.get("SHELL") or "bash")
    if name in SHELLS or name in _LIKE_BASH:
        return name
    raise UsageError(f"no functions for the shell {name!r} ($SHELL)", f"give --shell {' or '.join(SHELLS)}")


def program(ctx: Context) -> list[str]:
    """The command line before `ros`: the absolute path of this program, with the options of this call."""
    started = os.path.abspath(sys.argv[0])
    is_script = os.access(started, os.X_OK) and os.path.basename(started) == "slidectl"
    words = [started] if is_script else [sys.executable, "-m", "slidectl"]
    for option, value in (("--instance", ctx.instance), ("--socket", ctx.socket)):
        words += [option, os.path.abspath(value) if option == "--socket" else value] if value else []
    if ctx.namespace != "/":
        words += ["--ns", ctx.namespace]
    return words


# For bash, zsh and similar shells; bash exports functions to the scripts that it starts.
# A function in the background of a script runs in a subshell, whose id the script has as $!. Signals to the subshell
# must reach the command. Such a subshell ignores SIGQUIT, one in a pipe does not.
_POSIX = """\
_slidectl_ros() {{
  if ! _slidectl_is_job; then {prefix} ros "$@"; return; fi
  local child= code=0
  trap 'kill -INT "$child" 2>/dev/null' INT; trap 'kill -TERM "$child" 2>/dev/null' TERM
  {prefix} ros "$@" <&0 &
  child=$!
  while :; do wait "$child" && code=0 || code=$?; kill -0 "$child" 2>/dev/null || break; done
  trap - INT TERM
  return "$code"
}}
_slidectl_is_job() {{
  [ "${{BASHPID:-$$}}" != "$$" ] || [ "${{ZSH_SUBSHELL:-0}}" != 0 ] || return 1
  [ -r /proc/self/status ] || return 1
  local key value
  while read -r key value; do
    case $key:$value in SigIgn::*[4567cdef]) return 0 ;; esac
  done </proc/self/status
  return 1
}}
{functions}
if [ -n "${{BASH_VERSION:-}}" ]; then export -f _slidectl_ros _slidectl_is_job {names}; fi"""
