"""`roslaunch`: its options, handed to `slidectl launch`, which does the work.

An option of roslaunch's that means nothing here is accepted; one that asks for ports or threads is said to have no
effect. Those of `slidectl launch` are understood, too.
"""

from __future__ import annotations

from collections.abc import Sequence

from slidectl.cli.context import Context
from slidectl.cli.ros.arguments import Arguments, Option, Parser
from slidectl.cli.ros.failure import Failure
from slidectl.errors import BadFile, SlidectlError, UnknownName

PREFIX = "RLException: "

_USAGE = """roslaunch [options] [package] <filename> [arg_name:=value...]
       roslaunch [options] <filename> [<filename>...] [arg_name:=value...]

If <filename> is a single dash ('-'), launch XML is read from standard input."""
# dest -> option of `slidectl launch`
_FLAGS = {
    "nodes": "--nodes", "files": "--files", "dump_params": "--dump-params", "ros_args": "--ros-args",
    "screen": "--screen", "log": "--log", "required": "--required", "wait": "--wait", "dry_run": "--dry-run",
    "detach": "--detach", "skip_unknown": "--skip-unknown", "keep_going": "--keep-going",
    "no_commands": "--no-commands",
}  # fmt: skip
_VALUES = {
    "args": "--args", "find_node": "--find-node", "pid": "--pid", "sigint_timeout": "--sigint-timeout",
    "sigterm_timeout": "--sigterm-timeout", "package": "--package",
}  # fmt: skip
_WITHOUT_EFFECT = {
    "port": "-p", "core": "--core", "workers": "-w", "socket_timeout": "-t", "logger_level": "--master-logger-level",
}  # fmt: skip
_PLACES = ("package", "launch file", "shipped launch file")
_EXCLUSIVE = ("nodes", "find_node", "args", "ros_args")

_PARSER = Parser(
    "roslaunch",
    _USAGE,
    [
        Option(("--files",), "files", "print the files that are used"),
        Option(("--args",), "args", "print the command line of a node", "NODE_NAME"),
        Option(("--nodes",), "nodes", "print the names of the nodes"),
        Option(("--find-node",), "find_node", "print the file that a node is written in", "NODE_NAME"),
        Option(("--dump-params",), "dump_params", "print all parameters as YAML"),
        Option(("--ros-args",), "ros_args", "print the arguments of the file"),
        Option(("--screen",), "screen", "show what all nodes print"),
        Option(("--log",), "log", "what all nodes print goes into logs"),
        Option(("--required",), "required", "the end of any node is the end of all"),
        Option(("--local",), "local", "no effect: everything is local"),
        Option(("--wait",), "wait", "wait for a daemon instead of starting one"),
        Option(("-p", "--port"), "port", "no effect: there are no ports", "PORT"),
        Option(("--core",), "core", "no effect: the daemon is all cores"),
        Option(("-w", "--numworkers"), "workers", "no effect: there is one thread", "NUM_WORKERS"),
        Option(("-t", "--timeout"), "socket_timeout", "no effect: there are no ports", "TIMEOUT"),
        Option(("--master-logger-level",), "logger_level", "no effect", "LEVEL"),
        Option(("--pid",), "pid", "write the process id into a file", "PID_FN"),
        Option(("--no-summary",), "no_summary", "no effect: there is no summary"),
        Option(("--skip-log-check",), "skip_log_check", "no effect: the log does not grow without end"),
        Option(("--disable-title",), "disable_title", "no effect: the terminal's title stays"),
        Option(("-v",), "verbose", "say more"),
        Option(("--sigint-timeout",), "sigint_timeout", "how long nodes may take to end on SIGINT (15)", "TIMEOUT"),
        Option(("--sigterm-timeout",), "sigterm_timeout", "how long they may take on SIGTERM (2)", "TIMEOUT"),
        Option(("--dry-run",), "dry_run", "print the steps, and start nothing"),
        Option(("--detach",), "detach", "return when everything runs"),
        Option(("--package",), "package", "where a package is", "NAME=PATH"),
        Option(("--keep-going",), "keep_going", "leave out all that is not there, and list it at the end"),
        Option(("--skip-unknown",), "skip_unknown", "leave out nodes that can neither be done nor run here"),
        Option(("--no-commands",), "no_commands", "refuse <param command=...> that is not xacro"),
    ],
)


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Launch, or print what is asked for. Raises what `slidectl launch` raises."""
    from slidectl.cli.launch import launch

    given = _PARSER.parse(argv)
    _check(ctx, given)
    words = [option for dest, option in _FLAGS.items() if getattr(given, dest)]
    values = {option: getattr(given, dest) for dest, option in _VALUES.items()}
    words += [f"{option}={value}" for option, value in values.items() if value is not None]
    ctx.verbose += bool(given.verbose)
    with launch.make_context("roslaunch", [*words, "--", *given.words], obj=ctx) as click_context:
        try:
            launch.invoke(click_context)
        except (UnknownName, BadFile) as error:
            raise _in_its_words(error, [word for word in given.words if ":=" not in word]) from None


def _in_its_words(error: UnknownName | BadFile, names: Sequence[str]) -> SlidectlError:
    """A launch file that is not there is refused with roslaunch's own line; what else there is stands below it."""
    if isinstance(error, UnknownName):
        is_missing = error.kind in _PLACES and error.name in names
    else:
        is_missing = error.file in names and error.reason == "no such launch file"
    if not is_missing:
        return error
    if len(names) == 2:
        text = f"[{names[1]}] is neither a launch file in package [{names[0]}] nor is [{names[0]}] a launch file name"
    else:
        text = f"[{names[0]}] is not a launch file name"
    return Failure(f"{PREFIX}{text}\n{error}")


def _check(ctx: Context, given: Arguments) -> None:
    """Usage errors in roslaunch's words, and remarks on options without effect."""
    if sum(bool(getattr(given, dest)) for dest in _EXCLUSIVE) > 1:
        _PARSER.error("only one of [--nodes, --find-node, --args --ros-args] may be specified")
    if not [word for word in given.words if ":=" not in word]:
        _PARSER.error("you must specify at least one input file")
    if given.words.count("-") > 1:
        _PARSER.error("Only a single instance of the dash ('-') may be specified.")
    idle = [option for dest, option in _WITHOUT_EFFECT.items() if getattr(given, dest)]
    if idle:
        ctx.warn(f"{', '.join(idle)} {'has' if len(idle) == 1 else 'have'} no effect here")
