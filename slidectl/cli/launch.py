"""`slidectl launch`: roslaunch's files. It parses the command line, prints what is asked for, and runs a session.

Reading files, and what nodes do, is slidectl.launch's.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion
from slidectl.cli.commands import command, positive_seconds
from slidectl.cli.context import Context
from slidectl.cli.spawn import tell_own_packages
from slidectl.errors import Refused, UsageError
from slidectl.names import join

if TYPE_CHECKING:
    from slidectl.description.packages import Packages
    from slidectl.launch.interrupts import Interrupts
    from slidectl.launch.plan import Plan
    from slidectl.launch.session import Session
    from slidectl.launch.task import Run, Task

_LISTINGS = ("nodes", "files", "dump_params", "ros_args", "args_of", "find_node", "dry_run")


def _launch_files(context: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Shipped launch files, then files."""
    from slidectl.launch.files import shipped

    fitting = [name for name in shipped() if name.startswith(incomplete)]
    return fitting or completion.files(context, param, incomplete)


@command(
    examples=[
        "slidectl launch my_slider slider.launch",
        "slidectl launch rrbot_gazebo rrbot_world.launch paused:=true",
        "slidectl launch slider --detach",
        "slidectl launch robot.launch --package my_robot=~/src/my_robot --dry-run",
    ]
)
@click.argument("words", nargs=-1, metavar="FILE | PACKAGE FILE | NAME [ARG:=VALUE]...", shell_complete=_launch_files)
@click.option("--dry-run", is_flag=True, help="Print the steps, and start nothing.")
@click.option("--nodes", is_flag=True, help="Print the names of the nodes.")
@click.option("--files", is_flag=True, help="Print the files that are used.")
@click.option("--dump-params", is_flag=True, help="Print all parameters as YAML.")
@click.option("--ros-args", is_flag=True, help="Print the arguments of the file.")
@click.option("--args", "args_of", metavar="NODE", help="Print the command line of a node.")
@click.option("--find-node", metavar="NODE", help="Print the file that defines a node.")
@click.option("--detach", is_flag=True, help="Return when everything runs, and leave it running.")
@click.option("--wait", is_flag=True, help="Wait for a daemon instead of starting one (60 s, or --timeout).")
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", help="Where a package is; may repeat.")
@click.option("--keep-going", is_flag=True, help="Leave out all that is not there, and list it at the end.")
@click.option("--strict", is_flag=True, help="Refuse impossible masses, inertias and shapes instead of mending them.")
@click.option("--skip-unknown", is_flag=True, help="Leave out nodes that can neither be done nor run here.")
@click.option("--no-commands", is_flag=True, help="Refuse <param command=...> that is not xacro.")
@click.option("--screen", "output_of_all", flag_value="screen", help="Show the output of all nodes.")
@click.option("--log", "output_of_all", flag_value="log", help="Write the output of all nodes into logs.")
@click.option("--required", is_flag=True, help="The launch ends when any process of it ends.")
@click.option("--pid", "pid_file", metavar="FILE", help="Write the process id into a file; removed at the end.")
@click.option(
    "--sigint-timeout", type=float, default=15.0, callback=positive_seconds, metavar="S",
    help="How long a process may take to end on SIGINT (15 s).",
)  # fmt: skip
@click.option(
    "--sigterm-timeout", type=float, default=2.0, callback=positive_seconds, metavar="S",
    help="How long it may take on SIGTERM (2 s).",
)  # fmt: skip
@click.pass_obj
def launch(ctx: Context, /, words: tuple[str, ...], packages: tuple[str, ...], **given: Any) -> None:
    """Run a launch file as roslaunch does.

    Starts a daemon when none runs, and then stops it at the end; Ctrl-C ends the nodes in reverse order, and so do
    SIGTERM and SIGHUP, with exit code 0. A step that fails ends the launch with 1 and names its file and line; a
    broken file is 2. Packages, files, programs and controllers that are not there end it before it starts, all in one
    list; with --keep-going they are left out, and it exits with 1 only when nothing is left to drive. Robots that a
    launch that fails has spawned, itself or by its programs, go again. NAME is a launch
    file that is shipped; - is standard input. JSON keys: event, text, and those of the event.
    """
    from slidectl.cli import launch_tell
    from slidectl.description.missing import Missing
    from slidectl.launch import files, kinds, loader, setup

    lookup = _packages(packages)
    names, arguments = _divided(words)
    _check_listings(given)
    sources = files.find(names, lookup)
    plan = loader.load(
        sources,
        arguments,
        lookup,
        run_commands=not given["no_commands"],
        arguments_only=given["ros_args"],
        namespace=join("/", os.environ.get("ROS_NAMESPACE", "").strip("/")),
        missing=Missing("all" if given["keep_going"] else "nodes" if given["skip_unknown"] else "nothing"),
    )
    if launch_tell.plan_only(ctx, plan, given):
        return
    tasks = kinds.tasks(plan, lookup, gather=True)
    if given["dry_run"] or plan.missing:  # where something is not there, a daemon is not begun before the rest is known
        setup.look_ahead(plan, tasks, lookup, run_commands=False)
    tell_own_packages(ctx, lookup)
    if given["dry_run"] or given["args_of"]:
        launch_tell.tasks(ctx, plan, tasks, given)
        return
    title = " ".join(source.shown for source in sources)
    _run(ctx, plan, tasks, lookup, title, given)


# --- the command line -----------------------------------------------------------------------------------------------


def _packages(given: Sequence[str]) -> Packages:
    from slidectl.description.packages import Packages

    pairs = {}
    for word in given:
        name, sign, path = word.partition("=")
        if not name or not sign or not path:
            raise UsageError(f"{word!r} is not NAME=PATH", "slidectl launch --package my_robot=~/src/my_robot ...")
        pairs[name] = path
    return Packages(pairs, Path.cwd())


def _divided(words: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """What names files, and the `arg:=value`."""
    names, arguments = [], {}
    for word in words:
        name, sign, value = word.partition(":=")
        if sign and not name:
            raise UsageError(f"{word!r} is not ARG:=VALUE")
        if sign:
            arguments[name] = value.strip()
        else:
            names.append(word)
    return names, arguments


def _check_listings(given: dict[str, Any]) -> None:
    asked = ["--" + name.replace("_of", "").replace("_", "-") for name in _LISTINGS if given[name]]
    if len(asked) > 1:
        raise UsageError(f"{' and '.join(asked)} exclude each other")


# --- running --------------------------------------------------------------------------------------------------------


def _run(
    ctx: Context, plan: Plan, tasks: Sequence[Task], packages: Packages, title: str, given: dict[str, Any]
) -> None:
    from slidectl.cli.launch_run import Background
    from slidectl.launch.interrupts import Interrupted, Interrupts

    background = None
    stays = any(task.needs_presence for task in tasks)
    if given["detach"] and stays:
        background = Background(ctx.paths)
        background.fork()
    try:
        with Interrupts() as interrupts:
            session = _session(ctx, plan, tasks, packages, interrupts, given)
            _PidFile(given["pid_file"]).around(lambda: _drive(session, title, given["detach"], background))
    except Interrupted as interrupted:  # before there was anything to end
        _interrupted(interrupted.number, was_up=False)


def _session(
    ctx: Context,
    plan: Plan,
    tasks: Sequence[Task],
    packages: Packages,
    interrupts: Interrupts,
    given: dict[str, Any],
) -> Session:
    from slidectl.cli.launch_run import Daemon, Terminal
    from slidectl.launch.session import Session
    from slidectl.launch.task import Options, Run
    from slidectl.launch.watch import Watch

    options = Options(
        given["output_of_all"],
        given["required"],
        given["strict"],
        given["sigint_timeout"],
        given["sigterm_timeout"],
    )
    folder = str(ctx.paths.folder / "launch")
    run: Run = Run(plan, packages, Terminal(ctx), options, Watch(), interrupts, folder, _way_to_daemon(ctx))
    return Session(run, tasks, Daemon(ctx, child=not given["detach"], wait=given["wait"]))


def _way_to_daemon(ctx: Context) -> dict[str, str]:
    """For the programs of nodes, so that commands of this kind in them reach the same daemon, by the same slidectl."""
    paths = ctx.paths
    return {
        "SLIDECTL_PYTHON": sys.executable,
        "SLIDECTL_SOCKET": paths.socket_text if paths.prefix else "",
        "SLIDECTL_INSTANCE": "" if paths.prefix else paths.name,
    }


class _PidFile:
    """`--pid FILE`."""

    def __init__(self, path: str | None) -> None:
        self.path = path

    def around(self, action: Any) -> None:
        """Do it while the file is there. Raises Refused when it cannot be written."""
        if self.path is None:
            action()
            return
        try:
            Path(self.path).write_text(f"{os.getpid()}\n", encoding="ascii")
        except OSError as error:
            raise Refused(f"cannot write {self.path}: {error.strerror}") from None
        try:
            action()
        finally:
            Path(self.path).unlink(missing_ok=True)


def _drive(session: Session, title: str, detach: bool, background: Any) -> None:
    """Up, watched, down. A detached launch that needs nobody to stay is left as it is."""
    from slidectl.launch.interrupts import Interrupted

    leave = False
    try:
        session.bring_up()
        _tell_running(session, title, detach, background)
        leave = detach and background is None
        if background is not None:
            background.everything_runs()
        if not leave:
            session.watch()
    except Interrupted as interrupted:
        _interrupted(interrupted.number, session.is_up)
        session.check()
    finally:
        if leave:
            session.run.client.close()
        else:
            _end(session)


def _end(session: Session) -> None:
    """Also when a signal comes just before they are held: only one is ever raised."""
    from slidectl.launch.interrupts import Interrupted

    try:
        session.shut_down()
    except Interrupted:
        session.shut_down()
    if session.run.interrupts.received:
        session.run.interrupts.ignore()  # a further one would only spoil the last words


def _interrupted(number: int, was_up: bool) -> None:
    """Ctrl-C is 130 always; a polite end of what ran is none to complain about."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    if not was_up:
        raise Refused(f"ended by {signal.Signals(number).name} before everything ran")


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _tell_running(session: Session, title: str, detach: bool, background: Any) -> None:
    from slidectl.launch.nodes.process import reason

    run = session.run
    status = run.call("/slidectl/status")
    died = {task.node.full_name: reason(code) for task, code in session.died.items()}
    nodes = len(session.begun) - len(died)
    what = f"{_count(nodes, 'node')}, {_count(status['controllers_running'], 'controller')} running"
    how = f"these nodes died: {', '.join(f'{name} ({why})' for name, why in died.items())}; the rest runs"
    end = "Ctrl-C ends it" if session.stays else "nothing is left to watch, so the launch ends"
    if detach:
        end = "slidectl daemon stop ends it" if run.owns_daemon or background is None else f"kill {os.getpid()} ends it"
        end += "" if background is None else f"; its log is {background.log}"
    missing = run.plan.missing.lines()
    runs = f"runs without {_count(len(missing), 'thing')}, listed below" if missing else "everything runs"
    run.console.step(
        "running", f"{title}: {how if died else runs} ({what}); {end}", files=run.plan.files, nodes=nodes,
        controllers_running=status["controllers_running"], died=died,
    )  # fmt: skip
    if missing:
        run.console.step("left_out", "\n".join(["left out:", *missing]), things=missing)
