"""`slidectl ros-commands`: shell functions named as the ROS commands, for `eval`. Only text; it asks no daemon."""

from __future__ import annotations

import os
import sys
from shlex import quote

import click

from slidectl.cli import output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.ros.command import TOOLS
from slidectl.errors import UsageError

SHELLS = ("bash", "zsh", "fish")
# Shells that read the functions of bash.
_LIKE_BASH = ("sh", "dash", "ash", "ksh", "mksh")


@command(
    "ros-commands",
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
    prefix = " ".join(map(quote, _program(ctx)))
    output.write(_fish(prefix) if (shell or _that_calls() or _of_the_user()) == "fish" else _posix(prefix))


def _that_calls() -> str | None:
    """The shell that has started this program, which need not be that of $SHELL; None when it was no shell."""
    try:
        with open(f"/proc/{os.getppid()}/comm", encoding="utf-8") as file:
            name = file.read().strip()
    except (OSError, UnicodeDecodeError):
        return None
    return name if name in SHELLS or name in _LIKE_BASH else None


def _of_the_user() -> str:
    """`bash`, `zsh` or `fish` by $SHELL. Raises UsageError for a shell that has no such functions."""
    name = os.path.basename(os.environ.get("SHELL") or "bash")
    if name in SHELLS or name in _LIKE_BASH:
        return name
    raise UsageError(f"no functions for the shell {name!r} ($SHELL)", f"give --shell {' or '.join(SHELLS)}")


def _program(ctx: Context) -> list[str]:
    """The command line before `ros`: this program, from wherever it was started, with the options of this call."""
    started = os.path.abspath(sys.argv[0])
    is_script = os.access(started, os.X_OK) and os.path.basename(started) == "slidectl"
    words = [started] if is_script else [sys.executable, "-m", "slidectl"]
    for option, value in (("--instance", ctx.instance), ("--socket", ctx.socket)):
        words += [option, os.path.abspath(value) if option == "--socket" else value] if value else []
    if ctx.namespace != "/":
        words += ["--ns", ctx.namespace]
    return words


# A function that runs in the background of a script is a shell of its own, which the script knows by $!. What is sent
# to it must reach the command. Shells ignore SIGQUIT in such a shell, which tells it from one in a pipe.
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


def _posix(prefix: str) -> str:
    """bash, zsh and their kin. bash exports functions to the scripts that it starts."""
    functions = "\n".join(f'{name}() {{ _slidectl_ros {name} "$@"; }}' for name in TOOLS)
    return _POSIX.format(prefix=prefix, functions=functions, names=" ".join(TOOLS))


def _fish(prefix: str) -> str:
    return "\n".join(f"function {name}; {prefix} ros {name} $argv; end" for name in TOOLS)
