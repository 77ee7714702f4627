"""`slidectl launch`: run roslaunch files. It parses the command line, prints the listings and runs the plan.

`slidectl.extensions.launch` reads the files and implements the nodes.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, positive_seconds
from slidectl.cli.context import DEFAULT_TIMEOUT_S, Context
from slidectl.cli.spawn import package_lookup, pairs, report_own_packages
from slidectl.client import Client
from slidectl.command_steps import CommandStep, StepEffects, check_not_detached
from slidectl.errors import Refused, SlidectlError, TimedOut, UsageError
from slidectl.names import join
from slidectl.paths import command as to_type
from slidectl.paths import install_command

if TYPE_CHECKING:
    from slidectl.cli.detached import Background
    from slidectl.daemon.lifecycle import DaemonStart
    from slidectl.description.packages import Packages
    from slidectl.extensions.launch.execution import DaemonAccess, Execution
    from slidectl.extensions.launch.nodes.gazebo import WorldSettings
    from slidectl.extensions.launch.plan import LaunchPlan
    from slidectl.extensions.launch.task import Task

START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0
WAIT_LIMIT_S = 60.0
_POLL_S = 0.05
_LISTINGS = ("nodes", "files", "dump_params", "ros_args", "args_of", "find_node", "dry_run")


def _launch_files(context: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Shipped launch files, then files."""
    from slidectl.extensions.launch.files import shipped

    fitting = [name for name in shipped() if name.startswith(incomplete)]
    return fitting or completion.files(context, param, incomplete)


def _step_effects(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:
    """Check the files of a launch. Raises SlidectlError when nodes are programs, which need a daemon, and none runs."""
    from slidectl.extensions.launch import execution, node_kinds
    from slidectl.extensions.launch.nodes.programs import Process

    check_not_detached(parameters, has_daemon)
    try:
        plan, lookup, _ = load_plan(parameters["words"], parameters["packages"], parameters)
        tasks = node_kinds.tasks(plan, lookup, gather=True)
        execution.find_missing(plan, tasks, lookup, run_commands=False)
    except SlidectlError as refusal:
        return StepEffects(may_add_controllers=True, refusal=refusal)
    programs = [task for task in tasks if isinstance(task, Process)]
    if programs and not has_daemon:
        text = f"{programs[0].node.kind} is a program of its own, which needs a daemon"
        raise programs[0].error(text, "slidectl test --daemon runs the scenario in a daemon")
    return StepEffects(starts_programs=bool(programs), may_add_controllers=True)


@command(
    step=CommandStep(stays=True, effects=_step_effects),
    examples=[
        "slidectl launch my_slider slider.launch",
        "slidectl launch rrbot_gazebo rrbot_world.launch paused:=true",
        "slidectl launch slider --detach",
        "slidectl launch slider gui:=true",
        "slidectl launch robot.launch --package my_robot=~/src/my_robot --dry-run",
    ],
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
@click.option("--view", is_flag=True, help="Open the page in a browser, until the launch ends; as gui:=true does.")
@click.option("--wait", is_flag=True, help="Wait for a daemon instead of starting one (60 s, or --timeout).")
@click.option(
    "--package", "packages", multiple=True, metavar="NAME=PATH", help="The folder of a package; may be repeated."
)
@click.option("--keep-going", is_flag=True, help="Also leave out missing files and nodes that fail.")
@click.option(
    "--strict",
    is_flag=True,
    help="Refuse missing things, and impossible masses, inertias and shapes, instead of going on.",
)
@click.option("--skip-unknown", is_flag=True, help="With --strict: leave out missing nodes all the same.")
@click.option("--no-commands", is_flag=True, help="Refuse <param command=...> that is not xacro.")
@click.option("--screen", "output_of_all", flag_value="screen", help="Show the output of all nodes.")
@click.option("--log", "output_of_all", flag_value="log", help="Write the output of all nodes into logs.")
@click.option("--required", is_flag=True, help="The launch ends when any process of it ends.")
@click.option("--pid", "pid_file", metavar="FILE", help="Write the process id to a file, and remove it at the end.")
@click.option("--sigint-timeout", type=float, default=15.0, callback=positive_seconds, metavar="S",
              help="How long a process may take to end on SIGINT, s of wall time (15).")  # fmt: skip
@click.option("--sigterm-timeout", type=float, default=2.0, callback=positive_seconds, metavar="S",
              help="How long it may take on SIGTERM, s of wall time (2).")  # fmt: skip
@click.pass_obj
def launch(ctx: Context, /, words: tuple[str, ...], packages: tuple[str, ...], **given: Any) -> None:
    """Run a launch file as roslaunch does.

    Starts a daemon when none runs, and stops it at the end. Ctrl-C, SIGTERM and SIGHUP end the nodes in reverse order,
    the latter two with exit code 0. A failed step ends the launch with exit code 1 and names its file and line; a
    broken file ends it with 2. Missing packages, programs and controllers are left out, as roslaunch does with nodes,
    and listed at the start, and again when everything else runs. It exits with 1 when no robot, or none of its
    controllers, came up. A required node, and a file that is read, must exist. --strict refuses everything that is
    missing before anything starts. gui:=true opens the page of 'slidectl view' if the file then asks for a window of
    Gazebo, RViz or rqt; --view does with any file. Robots that a failed launch has spawned, itself or by its programs,
    are deleted. NAME is a shipped launch file; - is standard input. JSON keys: event, text, and those of the event.
    """
    from slidectl import open_page
    from slidectl.daemon import lifecycle
    from slidectl.extensions.launch import execution, node_kinds
    from slidectl.extensions.launch.commands import launch_text

    listings = ["--" + name.replace("_of", "").replace("_", "-") for name in _LISTINGS if given[name]]
    if len(listings) > 1:
        raise UsageError(f"{' and '.join(listings)} exclude each other")
    plan, lookup, title = load_plan(words, packages, given)
    if launch_text.print_plan(ctx, plan, given):
        return
    master = ros_master(ctx)
    plan.missing.world_decides = ctx.up is not None or given["wait"] or lifecycle.running(ctx.paths) is not None
    tasks = node_kinds.tasks(plan, lookup, gather=True, has_master=bool(master))
    opens_page = given["view"] or wants_window(words, tasks)
    if opens_page:
        from slidectl.extensions.launch.nodes.programs import OpenPage

        tasks.append(OpenPage(plan, "--view" if given["view"] else "gui:=true"))
    if given["dry_run"] or plan.missing:  # find everything that is missing before a daemon is started
        execution.find_missing(plan, tasks, lookup, run_commands=False)
    report_own_packages(ctx, lookup)
    if given["dry_run"] or given["args_of"]:
        launch_text.print_tasks(ctx, plan, tasks, given["args_of"])
        return
    if opens_page and not open_page.has_page():
        raise Refused("the page needs the library viser", f"install it: {install_command('view')}")
    _run(ctx, plan, tasks, lookup, title, {**given, "view": opens_page}, master)


def wants_window(words: Sequence[str], tasks: Sequence[Task]) -> bool:
    """True when the command line says gui:=true of a launch with a window of Gazebo, RViz or rqt in it.

    A window that a launch file asks for by itself is none: most do, and then nobody may sit before a screen.
    """
    from slidectl.extensions.launch.nodes.left_out import Viewer, Window

    values = [word.partition(":=")[2].strip().lower() for word in words if word.startswith("gui:=")]
    return values[-1:] in (["true"], ["1"]) and any(isinstance(task, Viewer | Window) for task in tasks)


def ros_master(ctx: Context) -> str:
    """The ROS master URI of the daemon's ros1 gateway; empty when the gateway does not run."""
    from slidectl.extensions.gateways import process

    gateway = process.find(ctx.paths if ctx.up is None else ctx.client.paths, "ros1")
    return "" if gateway is None else gateway.address


def load_plan(
    words: Sequence[str], packages: Sequence[str], given: Mapping[str, Any]
) -> tuple[LaunchPlan, Packages, str]:
    """The plan for the words of a launch, the lookup of its packages, and its title. Raises SlidectlError."""
    from slidectl.description.missing import TO_GO_ON, AllowedMissing, Missing
    from slidectl.extensions.launch import files, loader

    lookup = package_lookup(packages, "launch")
    names = [word for word in words if ":=" not in word]
    given_arguments = pairs([word for word in words if ":=" in word], ":=", "launch")
    arguments = {name: value.strip() for name, value in given_arguments.items()}
    sources = files.find(names, lookup)
    namespace = join("/", os.environ.get("ROS_NAMESPACE", "").strip("/"))
    if given["strict"] and given["keep_going"]:
        raise UsageError("--strict and --keep-going exclude each other")
    forgiven: AllowedMissing = "all" if given["keep_going"] else "all but files"
    if given["strict"]:
        forgiven = "nodes" if given["skip_unknown"] else "nothing"
    missing = Missing(forgiven, "without --strict it is left out" if given["strict"] else TO_GO_ON)
    plan = loader.load(
        sources, arguments, lookup, run_commands=not given["no_commands"], arguments_only=given["ros_args"],
        namespace=namespace, missing=missing,
    )  # fmt: skip
    return plan, lookup, " ".join(source.shown for source in sources)


# --- running ---------------------------------------------------------------------------------------------------------


class LaunchDaemon:
    """The daemon of this command line, for a launch. With `child`, a daemon started here ends with this process."""

    def __init__(self, context: Context, child: bool, wait: bool) -> None:
        self.context = context
        self.child = child
        self.must_run = wait
        self._beginning: DaemonStart | None = None

    def begin(self, settings: WorldSettings) -> bool:
        from slidectl.daemon import lifecycle

        if self.must_run:
            return False
        from slidectl.daemon.options import DaemonOptions

        paths = self.context.paths
        runs_already = lifecycle.running(paths) is not None
        named = {name: getattr(settings, name) for name in ("timestep", "gravity", "ground")} | {"rtf": settings.speed}
        given = {name: value for name, value in named.items() if value is not None}
        options = DaemonOptions(**given, paused=settings.paused, child=self.child)
        self._beginning = lifecycle.DaemonStart(paths, options)
        return not runs_already

    def connect(self) -> tuple[Client, bool]:
        if self.must_run:
            self._wait_for_one()
        is_ours = False
        if self._beginning is not None:
            pid, already = self._beginning.wait(self.context.wait_limit(START_LIMIT_S))
            is_ours = not already
            if is_ours:
                self.context.detail(f"daemon {self.context.paths.name}: started, process {pid}")
            else:
                self._beginning = None
        limit = self.context.wait_limit(DEFAULT_TIMEOUT_S)
        return Client(socket=self.context.paths.socket_text, timeout=limit), is_ours

    def _wait_for_one(self) -> None:
        """Wait for a daemon, for `--wait`. It polls, because a daemon's start is not announced."""
        from slidectl.daemon import lifecycle

        paths, limit = self.context.paths, self.context.wait_limit(WAIT_LIMIT_S)
        deadline = time.monotonic() + limit
        if lifecycle.running(paths) is None:
            self.context.say("no daemon runs yet: waiting for one")
        while lifecycle.running(paths) is None:
            if time.monotonic() >= deadline:
                raise TimedOut(f"no daemon within {limit:g} s", "start it with: " + to_type(paths, "daemon start"))
            select.select([], [], [], _POLL_S)
        # A daemon holds the lock before it answers; `start` waits for the answer.
        lifecycle.start(paths, timeout=max(1.0, deadline - time.monotonic()))

    def stop(self) -> None:
        from slidectl.daemon import lifecycle

        if self._beginning is not None:
            self._beginning.abandon()
            lifecycle.stop(self.context.paths, STOP_LIMIT_S)
            self.context.detail(f"daemon {self.context.paths.name}: stopped")


class RunningDaemon:
    """A daemon, or the world of a scenario, that exists before the launch and continues after it."""

    def __init__(self, context: Context) -> None:
        self.context = context

    def begin(self, settings: WorldSettings) -> bool:  # noqa: ARG002 - the node sets up the world that is there
        return False

    def connect(self) -> tuple[Client, bool]:
        return self.context.client, False

    def stop(self) -> None:
        """Do nothing: the daemon is not ours."""


def _run(
    ctx: Context, plan: LaunchPlan, tasks: Sequence[Task], packages: Packages, title: str, given: dict[str, Any],
    master: str,
) -> None:  # fmt: skip
    from slidectl.cli.detached import Background, pid_file
    from slidectl.extensions.launch.commands.launch_text import Terminal
    from slidectl.extensions.launch.execution import Execution
    from slidectl.extensions.launch.task import Options, Run
    from slidectl.supervision import Interrupts, WorldWatch

    background = None
    if given["detach"] and any(task.needs_presence for task in tasks):
        background = Background(ctx.paths, "launch")
        background.fork()
    paths = ctx.paths if ctx.up is None else ctx.client.paths
    # For the programs of nodes: slidectl commands in them use the same daemon and the same installation of slidectl.
    environment = {
        "SLIDECTL_PYTHON": sys.executable,
        "SLIDECTL_SOCKET": paths.socket_text if paths.prefix else "",
        "SLIDECTL_INSTANCE": "" if paths.prefix else paths.name,
        **({"ROS_MASTER_URI": master} if master else {}),
    }
    options = Options(
        given["output_of_all"], given["required"], given["strict"], given["sigint_timeout"], given["sigterm_timeout"]
    )
    with Interrupts() as interrupts, pid_file(given["pid_file"]):
        run = Run(plan, packages, Terminal(ctx), options, interrupts, str(paths.folder / "launch"), environment)
        run.has_page = given["view"]
        daemon: DaemonAccess = LaunchDaemon(ctx, child=not given["detach"], wait=given["wait"])
        if ctx.up is not None:
            daemon, run.watch = RunningDaemon(ctx), WorldWatch(ctx.client)
        _drive(ctx, Execution(run, tasks, daemon), title, given["detach"], background)


def _drive(ctx: Context, execution: Execution, title: str, detach: bool, background: Background | None) -> None:
    """Bring the launch up, watch it, shut it down. A detached launch that needs no process is left running."""
    from slidectl.supervision import Interrupted

    leave = False
    try:
        with execution.run.interrupts.raised():
            execution.bring_up()
            _report_running(execution, title, detach, background)
            if ctx.up is not None:
                ctx.up()
            if background is not None:
                background.everything_runs()
            leave = detach and background is None
            if not leave:
                execution.watch()
    except Interrupted as interrupted:
        if interrupted.number == signal.SIGINT:
            raise KeyboardInterrupt from None  # exit code 130
        if not execution.is_up:
            raise Refused(f"ended by {signal.Signals(interrupted.number).name} before everything ran") from None
        execution.judge()
    except KeyboardInterrupt:  # this ends a scenario, which fails when a node has failed
        execution.judge()
        raise
    finally:
        if leave:
            execution.run.client.close()
        else:
            execution.shut_down()
            if execution.run.interrupts.received:
                execution.run.interrupts.ignore()  # a further interrupt must not cut off the last messages


def _report_running(execution: Execution, title: str, detach: bool, background: Background | None) -> None:
    from slidectl.extensions.launch.nodes.programs import reason

    run = execution.run
    status = run.call("/slidectl/status")
    controllers = status["controllers_running"]
    died = {task.node.full_name: reason(code) for task, code in execution.died.items()}
    missing = execution.lacks
    how = f"runs without {output.count(len(missing), 'thing')}, listed below" if missing else "everything runs"
    if died:
        how = f"these nodes died: {', '.join(f'{name} ({why})' for name, why in died.items())}; the rest runs"
    end = "Ctrl-C ends it" if execution.stays else "nothing is left to watch, so the launch ends"
    if detach:
        end = "slidectl daemon stop ends it" if run.owns_daemon or background is None else f"kill {os.getpid()} ends it"
        end += "" if background is None else f"; its log is {background.log}"
    what = f"{output.count(execution.nodes, 'node')}, {output.count(controllers, 'controller')} running"
    run.console.step(
        "running", f"{title}: {how} ({what}); {end}", files=run.plan.files, nodes=execution.nodes,
        controllers_running=controllers, died=died,
    )  # fmt: skip
    if missing:
        run.console.step("left_out", "\n".join(["left out:", *missing]), things=missing)
    if status["paused"]:
        resume = to_type(run.client.paths, "sim resume")
        run.console.step("paused", f"the world is paused; {resume} lets it go on", command=resume)
