"""Carries out a plan: daemon, parameters, nodes in order; then watches it; then ends it in reverse order.

Tasks know what to do for each node. After `shut_down` nothing that was started here is left.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from slidectl import writing
from slidectl.client import Client
from slidectl.description import source_note
from slidectl.description.packages import Packages
from slidectl.description.report import bounded
from slidectl.errors import NoDaemon, Refused, SlidectlError, UsageError
from slidectl.extensions.launch.nodes.controller_nodes import ManagerScript, Spawner
from slidectl.extensions.launch.nodes.gazebo import Gazebo, WorldSettings
from slidectl.extensions.launch.nodes.left_out import LeftOut
from slidectl.extensions.launch.nodes.programs import Process, reason
from slidectl.extensions.launch.nodes.spawn_model import SpawnModel
from slidectl.extensions.launch.plan import LaunchPlan, Leaf, Location, Node, RosparamCommand
from slidectl.extensions.launch.task import HOOK_LIMIT_S, Run, StepFailed, Task

# There is no event for a new robot or parameter, so waiting tasks are tried again periodically.
_RETRY_S = 0.2
_RETRY_SELDOM_S = 0.5
_STATUS_EVERY_S = 1.0
_FIRST_MOMENT_S = 0.1
"""How long programs are watched before the launch counts as up: broken programs usually end at once."""


_LOADING = {"load", "lc", "spawn", "sp"}
"""The commands of the script controller_manager that load controllers, and their short forms."""


class DaemonAccess(Protocol):
    """Starts, finds and stops a daemon."""

    def begin(self, settings: WorldSettings) -> bool:
        """Begin to start a daemon with these settings. Returns False when one is running already."""

    def connect(self) -> tuple[Client, bool]:
        """Wait until the daemon answers. Returns a connection, and True if `begin` has started this daemon."""

    def stop(self) -> None:
        """Stop the daemon that `begin` has started; it may not answer yet."""


@dataclass
class _Waiting:
    """A task that cannot start yet."""

    task: Task
    reason: str
    until: float
    reported: bool = False
    waits_on: bool = False
    """True when its time has passed and it waits on, as the real script does: the launch counts as up without it."""


class Execution:
    """One launch. Call `bring_up`, then `watch`, and always `shut_down` at the end, also after an error."""

    def __init__(self, run: Run, tasks: Sequence[Task], daemon: DaemonAccess) -> None:
        self.run = run
        self.tasks = list(tasks)
        run.tasks = self.tasks
        self.daemon = daemon
        self.begun: list[Task] = []
        self.is_up = False
        self._began_daemon = False
        self._lost_daemon = False
        self._waiting: list[_Waiting] = []
        self._ended: dict[Process, int] = {}
        self._over = False

    # --- up -------------------------------------------------------------------------------------------------------

    def bring_up(self) -> None:
        """Start everything. Returns when everything runs.

        Raises BadFile: a value in the files cannot be computed. StepFailed. NoDaemon. Interrupted.
        """
        run = self.run
        settings = WorldSettings()
        for task in self.tasks:
            if isinstance(task, Gazebo):
                settings = task.settings(settings)
        holds = any(isinstance(task, Spawner | ManagerScript) for task in self.tasks)
        run.resumes = not settings.paused
        with run.interrupts.held():
            self._began_daemon = self.daemon.begin(replace(settings, paused=True) if holds else settings)
        run.parameters = find_missing(run.plan, self.tasks, run.packages)  # done while the daemon starts
        if lines := run.plan.missing.lines():
            run.console.warn("\n".join(["left out because missing (--strict refuses them):", *lines]))
        client, run.owns_daemon = self.daemon.connect()
        run.connect(client)
        run.watch.listen(client, lambda: None)
        run.is_held = holds and run.owns_daemon
        _prepare(run, run.parameters)
        self._start_nodes()
        # Notice programs that have ended meanwhile, and watch those that have just started for a moment.
        deadline = max((task.started_at + _FIRST_MOMENT_S for task in self._processes), default=0.0)
        self._turn(0.0)
        while not self._over and (left := deadline - time.monotonic()) > 0:
            self._turn(left)
        self._judge_required()
        self._check_left()
        self.is_up = True

    def _start_nodes(self) -> None:
        for task in (task for task in self.tasks if not task.comes_last):
            self._start(task)
        self._retry_waiting()
        if self.run.is_held:  # what still waits may wait for what happens in the world
            self.run.is_held = False
            if self.run.resumes:
                self.run.resume()
        self._wait_for_all()
        for task in (task for task in self.tasks if task.comes_last):
            self._start(task)
        for task in self._running():
            task.afterwards(self.run)
        for entry in self._waiting:
            entry.task.settled(self.run, f"waits for {entry.reason}")

    @property
    def _processes(self) -> list[Process]:
        return [task for task in self.begun if isinstance(task, Process)]

    @property
    def nodes(self) -> int:
        """The number of nodes that were started, without those left out or dead."""
        return sum(task not in self.run.left_out and task not in self.died for task in self.begun)

    @property
    def died(self) -> dict[Process, int]:
        """The programs that have died and do not run now, with their exit codes. Some may be respawned."""
        return {task: code for task in self._processes if (code := task.code)}

    def _start(self, task: Task) -> None:
        if isinstance(task, Process):
            task.on_end = self._process_ended
        self.begun.append(task)
        why = self._attempt(task)
        if why is not None:
            self._waiting.append(_Waiting(task, why, self.run.client.monotonic() + task.patience_s))
        elif self._waiting:
            self._retry_waiting()

    def _attempt(self, task: Task) -> str | None:
        """Start a task. Returns what it waits for, or None. Raises StepFailed, or NoDaemon, which is not its fault."""
        try:
            why = task.start(self.run)
        except NoDaemon:
            raise
        except SlidectlError as error:
            self._fail(task, error)
            return None
        if why is None and not task.keeps_running:
            self._over = self._over or self._is_required(task)
        return why

    def _fail(self, task: Task, error: SlidectlError) -> None:
        """Raise StepFailed for a task that failed, or leave it out if the launch keeps going."""
        if not self.run.plan.missing.leaves_failures_out or self._is_required(task):
            raise error if isinstance(error, StepFailed) else StepFailed(task, error) from None
        task.leave_out(self.run, "the node", error)
        self.run.left_out.append(task)

    def _retry_waiting(self) -> None:
        """Start the waiting tasks that can start now. Update what the others wait for."""
        progress = True
        while progress:
            progress = False
            for entry in list(self._waiting):
                why = self._attempt(entry.task)
                if why is None:
                    self._waiting.remove(entry)
                    progress = True
                    if self.is_up:
                        entry.task.afterwards(self.run)
                else:
                    entry.reported = entry.reported and why == entry.reason
                    entry.reason = why

    def _wait_for_all(self) -> None:
        while essential := [entry for entry in self._waiting if not entry.task.waits_lightly and not entry.waits_on]:
            for entry in essential:
                if not entry.reported:
                    entry.reported = True
                    entry.task.settled(self.run, f"waits for {entry.reason}")
                thing = entry.reason.removeprefix("the ").removeprefix("a ")
                if self._waits_in_vain(entry):
                    self._waiting.remove(entry)
                    self._fail(entry.task, Refused(f"there is no {thing}"))
                elif self.run.client.monotonic() >= entry.until:
                    if not entry.task.goes_on_waiting(self.run):
                        self._waiting.remove(entry)
                        self._fail(entry.task, Refused(f"there was no {thing} within {entry.task.patience_s:g} s"))
                    entry.waits_on = True
            self._turn(_RETRY_S)
            if self._over:
                return
            self._retry_waiting()

    def _waits_in_vain(self, entry: _Waiting) -> bool:
        """True when it waits for the robot of a node that was left out, and no other node can spawn that robot."""
        if isinstance(entry.task, SpawnModel):
            awaited = entry.task.words.one("-wait")
            return any(isinstance(task, SpawnModel) and task.model == awaited for task in self.run.left_out)
        nodes = [task.node for task in self.tasks if task not in self.run.left_out]
        could_come = bool(self._processes) or any(map(_spawns, nodes))
        return isinstance(entry.task, Spawner) and not could_come and any(map(_spawns, self.run.plan.nodes))

    def _check_left(self) -> None:
        """Raise Refused when something was left out and no robot, or none of its controllers, came up."""
        loaders = [task for task in self.tasks if isinstance(task, Spawner | ManagerScript)]
        if not self.run.plan.missing.lines() or any(isinstance(entry.task, Spawner) for entry in self._waiting):
            return
        spawns = [node for node in self.run.plan.nodes if _spawns(node)]
        if spawns:
            robots = [node for node in spawns if "-sdf" not in node.words] or spawns
            came = [task.node for task in self.tasks if isinstance(task, SpawnModel) and task.model in self.run.spawned]
            has_robot = any(node in robots for node in came)
        else:
            has_robot = any(task not in self.run.left_out and task.family != "notice" for task in self.begun)
        names_controllers = any(map(_starts_controllers, self.run.plan.nodes))
        if not has_robot or (names_controllers and not any(task.loaded for task in loaders)):
            what = "no controller of it runs" if has_robot else "nothing is left to drive"
            raise Refused(what, "\n".join(["left out:", *self.lacks]))

    @property
    def lacks(self) -> list[str]:
        """What the launch names and does not run, each on one line: what is not there, and windows of ROS."""
        windows = [task for task in self.begun if isinstance(task, LeftOut) and task.is_missed]
        paths = self.run.client.paths
        why = ((one.node, "; ".join(one.why(paths))) for one in windows)
        lines = (f"{node.place}: node {node.full_name} ({node.kind}): {text}" for node, text in why)
        return [*self.run.plan.missing.lines(), *lines]

    # --- running --------------------------------------------------------------------------------------------------

    def watch(self) -> None:
        """Watch the launch. Returns when nothing is left to watch, or a required node has finished.

        Raises Refused: a required node died; or all nodes have ended, some with an error. NoDaemon. Interrupted.
        """
        if self.run.console.is_live:
            self._show_status()
        while not self._over and self.stays:
            self._turn(_RETRY_SELDOM_S if self._waiting else None)
            if self._waiting:
                self._retry_waiting()
        self.judge()

    def _turn(self, most_s: float | None) -> None:
        """Pass received messages to the tasks that subscribe to them, and wait. Raises NoDaemon, Interrupted."""
        self.run.interrupts.check()
        list(self.run.client.events(0.0))
        self.run.watch.turn(most_s)
        list(self.run.client.events(0.0))

    @property
    def stays(self) -> bool:
        """True while there is something to watch; a daemon started by this launch counts."""
        return self.run.owns_daemon or bool(self._running()) or bool(self._waiting)

    def _running(self) -> list[Task]:
        waiting = [entry.task for entry in self._waiting]
        idle = (*self._ended, *self.run.left_out, *waiting)
        return [task for task in self.begun if task.keeps_running and task not in idle]

    def _is_required(self, task: Task) -> bool:
        if task.family == "notice":  # a viewer that was left out cannot be closed
            return False
        return task.node.required or (self.run.options.all_required and isinstance(task, Process))

    def _process_ended(self, task: Process, code: int) -> None:
        self._ended[task] = code
        if self._is_required(task):
            self._over = True
            self.run.console.step(
                "required", f"{task.node.full_name} is required: the launch ends", node=task.node.full_name
            )

    def judge(self) -> None:
        """Raise Refused when a node has ended with an error so far."""
        self._judge_required()
        codes = ((task, self._ended.get(task)) for task in self._processes)
        died = [f"{task.node.full_name} ({reason(code)})" for task, code in codes if code]
        if died:
            raise Refused(f"these nodes died: {', '.join(died)}")

    def _judge_required(self) -> None:
        """Raise StepFailed when a required node has died."""
        for task, code in self._ended.items():
            if code and self._is_required(task):
                self.run.failed = True
                raise StepFailed(task, Refused(f"it is required, and it died: {reason(code)}"))

    def _show_status(self) -> None:
        status = self.run.call("/slidectl/status")
        pace = "paused" if status["paused"] else f"speed {status['speed_reached']:.2f}"
        self.run.console.status(
            f"time {status['time']:.1f} s, {pace}, robots: {' '.join(status['robots']) or 'none'},"
            f" {status['controllers_running']} of {status['controllers']} controllers run, {len(self._running())} nodes"
        )
        self.run.watch.later(_STATUS_EVERY_S, self._show_status)

    # --- down -----------------------------------------------------------------------------------------------------

    def shut_down(self) -> None:
        """End what was started, in reverse order, and the daemon if it was started here.

        Must not be called in a block in which signals are raised: here they only shorten the waits.
        """
        run = self.run
        run.console.closing()
        run.failed = run.failed or not self.is_up
        processes = self._processes
        for process in processes:
            process.ending = True
        for task in reversed(self.begun):
            self._stop(task)
        self._escalate(processes)
        if run.failed and run.is_connected and not run.owns_daemon and not self._lost_daemon:
            self._delete_robots_of(processes)
        if run.is_connected:
            run.client.close()
        if self._began_daemon or run.owns_daemon:
            try:
                self.daemon.stop()
            except SlidectlError as error:
                run.console.warn(str(error))

    def _delete_robots_of(self, processes: Sequence[Process]) -> None:
        """Delete robots that programs of this launch have spawned. A program in a session of its own is not found."""
        owners = {number: process for process in processes for number in process.sessions}
        if not owners:
            return
        try:
            for robot in self.run.robots(HOOK_LIMIT_S):
                if (process := owners.get(robot["process_session"])) is not None:
                    self.run.call("/gazebo/delete_model", {"model_name": robot["name"]}, timeout=HOOK_LIMIT_S)
                    process.settled(self.run, f"{robot['name']}: deleted")
        except NoDaemon:
            self._lost_daemon = True
        except SlidectlError as error:
            self.run.console.warn(f"robots of programs of this launch may have stayed: {error.message}")

    def _stop(self, task: Task) -> None:
        if not isinstance(task, Process) and (self._lost_daemon or not self.run.is_connected):
            return
        try:
            task.stop(self.run)
        except NoDaemon:
            self._lost_daemon = True
        except SlidectlError as error:
            task.warn(self.run, f"at its end: {error.message}")

    def _escalate(self, processes: Sequence[Process]) -> None:
        options = self.run.options
        deadline = time.monotonic()
        timeouts = ((options.sigint_timeout_s, signal.SIGTERM), (options.sigterm_timeout_s, signal.SIGKILL))
        for seconds, number in timeouts:
            deadline += seconds
            for process in reversed(processes):
                process.finish(self.run, deadline, number)
        for process in reversed(processes):
            process.release()


def _spawns(node: Node) -> bool:
    """True when a node spawns a robot."""
    # A blank is a slip: the node is left out, and what waits for its robot waits in vain.
    package, kind = (name.replace(" ", "_") for name in (node.package, node.type))
    return package == "gazebo_ros" and kind.removesuffix(".py") == "spawn_model"


def _starts_controllers(node: Node) -> bool:
    """True when a node loads controllers, and starts them unless it says --stopped."""
    kind = node.type.removesuffix(".py")
    loads = kind == "spawner" or (kind == "controller_manager" and bool(_LOADING.intersection(node.words)))
    return node.package == "controller_manager" and loads


# --- before the nodes start ------------------------------------------------------------------------------------------


def find_missing(
    plan: LaunchPlan, tasks: Sequence[Task], packages: Packages, run_commands: bool = True
) -> Mapping[str, Leaf]:
    """The parameters of a plan. Before, everything missing that the files can tell is noted.

    Raises NotThere: all that is missing, unless the launch leaves it out. BadFile: a value cannot be computed.
    """
    parameters = plan.parameters(gather=True, run_commands=run_commands)
    for task in tasks:
        task.find_missing(plan, packages, parameters)
    plan.missing.refuse()
    return parameters


def _prepare(run: Run, parameters: Mapping[str, Leaf]) -> None:
    """Report the notices of the plan, carry out its commands and set its parameters. Raises Refused.

    Of the notices those with the verdict "wrong" are printed, with `-v` all of them; the others are counted.
    """
    quiet = 0
    for notice in bounded(run.plan.notices):
        if notice.verdict == "wrong" or run.console.verbose:
            run.console.warn(str(notice))
        else:
            quiet += 1
    if quiet:
        things = "one thing" if quiet == 1 else f"{quiet} things"
        run.console.step("notices", f"{things} in the files without effect, -v shows more", count=quiet)
    for command in run.plan.commands:
        _carry_out(run, command)
    for namespace, place in run.plan.clear:
        if run.call("/rosapi/has_param", {"name": namespace})["exists"]:
            _delete(run, namespace, place)
    # First all requests are sent, then the answers are read.
    calls = [(name, place, _begin(run, name, value, place)) for name, (value, place) in parameters.items()]
    for name, place, call in calls:
        try:
            run.client.answer(call)
        except Refused as error:
            raise Refused(f"{place}: parameter {name}: {error.message}", error.hint) from None
    if parameters:
        plural = "" if len(parameters) == 1 else "s"
        run.console.step("parameters", f"{len(parameters)} parameter{plural} set", count=len(parameters))


def _carry_out(run: Run, command: RosparamCommand) -> None:
    if not run.call("/rosapi/has_param", {"name": command.name})["exists"]:
        run.console.warn(
            f"{command.place}: <rosparam>: {command.name} is not set, so there is nothing to {command.verb}"
        )
        if command.verb == "delete":
            return
    if command.verb == "delete":
        _delete(run, command.name, command.place)
        return
    import yaml

    text = yaml.safe_dump(run.parameter(command.name) or {}, allow_unicode=True, default_flow_style=False)
    try:
        writing.write_whole(command.file, text)
    except OSError as error:
        text = f"{command.place}: <rosparam>: cannot write {command.file}: {writing.reason(error, command.file)}"
        raise Refused(text, writing.hint(error, command.file)) from None


def _delete(run: Run, name: str, place: Location) -> None:
    try:
        run.call("/rosapi/delete_param", {"name": name})
    except SlidectlError as error:
        raise Refused(f"{place}: {error.message}", error.hint) from None


def _begin(run: Run, name: str, value: object, place: Location) -> str:
    """Send the request for a parameter; returns the id of the call. The source note of a robot is sent separately."""
    if isinstance(value, str):
        value, note = source_note.split(value)
        if note:
            run.client.call_async("/slidectl/sources", {"digest": source_note.digest(value), "note": note})
    try:
        text = json.dumps(value, allow_nan=False)
        return run.client.call_async("/rosapi/set_param", {"name": name, "value": text})
    except ValueError:
        raise place.error(f"parameter {name}: {value} is not finite, and parameters hold only finite numbers") from None
    except UsageError as error:  # the request is longer than a line may be
        raise place.error(f"parameter {name}: {error.message}") from None
