"""A plan carried out: a daemon, parameters, nodes in order; then watched; then ended in reverse order.

Tasks say what each node does. After `shut_down` nothing that was started here is left.
"""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from slidectl.client import Client
from slidectl.description import source_note
from slidectl.description.packages import Packages
from slidectl.errors import NoDaemon, Refused, SlidectlError, UsageError
from slidectl.launch.nodes.controller_nodes import Spawner
from slidectl.launch.nodes.gazebo import Gazebo, WorldSettings
from slidectl.launch.nodes.programs import Process, reason
from slidectl.launch.nodes.spawn_model import SpawnModel
from slidectl.launch.plan import LaunchPlan, Leaf, Location, Node, RosparamCommand
from slidectl.launch.task import HOOK_LIMIT_S, Run, StepFailed, Task
from slidectl.writing import write_whole

# Nobody tells when a robot comes or a parameter is set, so look now and then.
_LOOK_AGAIN_S = 0.2
_LOOK_SELDOM_S = 0.5
_STATUS_EVERY_S = 1.0
_FIRST_MOMENT_S = 0.1
"""How long programs are watched before everything is said to run: what cannot work dies at once."""


class DaemonAccess(Protocol):
    """How to get at a daemon, and to get rid of it."""

    def begin(self, settings: WorldSettings) -> bool:
        """Begin to start a daemon with such a world, unless one runs already: then False."""

    def connect(self) -> tuple[Client, bool]:
        """Wait until it answers; the connection, and whether the daemon is the one that was begun here."""

    def stop(self) -> None:
        """Stop the one that was begun here; it need not answer yet."""


@dataclass
class _Waiting:
    """A task that could not start yet."""

    task: Task
    reason: str
    until: float
    told: bool = False


class Execution:
    """One launch, from `bring_up` over `watch` to `shut_down`, which must come, whatever happened before."""

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
        self._found: set[tuple[str, int]] = set()
        """Robots that were there before, with the sessions of those who asked for them."""

    # --- up -------------------------------------------------------------------------------------------------------

    def bring_up(self) -> None:
        """Returns when everything runs.

        Raises:
            BadFile: a value of the files cannot be had. StepFailed. NoDaemon. Interrupted.
        """
        run = self.run
        settings = WorldSettings()
        for task in self.tasks:
            if isinstance(task, Gazebo):
                settings = task.settings(settings)
        with run.interrupts.held():
            self._began_daemon = self.daemon.begin(settings)
        run.parameters = look_ahead(run.plan, self.tasks, run.packages)  # takes as long as a daemon's start
        client, run.owns_daemon = self.daemon.connect()
        run.connect(client)
        run.watch.listen(client, lambda: None)
        if not run.owns_daemon:
            self._found = set(self._robots())
        _prepare(run, run.parameters)
        self._start_nodes()
        # Take in which programs have died meanwhile, and give those that have just begun a moment to do so.
        deadline = max((task.started_at + _FIRST_MOMENT_S for task in self._processes()), default=0.0)
        self._turn(0.0)
        while not self._over and (left := deadline - time.monotonic()) > 0:
            self._turn(left)
        self._judge_required()
        self._check_left()
        self.is_up = True

    def _start_nodes(self) -> None:
        for task in (task for task in self.tasks if not task.comes_last):
            self._start(task)
        self._wait_for_all()
        for task in (task for task in self.tasks if task.comes_last):
            self._start(task)
        for task in self._running():
            task.afterwards(self.run)
        for entry in self._waiting:
            entry.task.settled(self.run, f"waits for {entry.reason}")

    def _processes(self) -> list[Process]:
        return [task for task in self.begun if isinstance(task, Process)]

    @property
    def nodes(self) -> int:
        """How many nodes were begun, and neither left out nor have died."""
        return sum(task not in self.run.left_out and task not in self.died for task in self.begun)

    @property
    def died(self) -> dict[Process, int]:
        """The programs that have died and do not run now, with their exit codes; some may be started again."""
        return {task: code for task in self._processes() if (code := task.code)}

    def _start(self, task: Task) -> None:
        if isinstance(task, Process):
            task.on_end = self._process_ended
        self.begun.append(task)
        why = self._attempt(task)
        if why is not None:
            self._waiting.append(_Waiting(task, why, self.run.client.monotonic() + task.patience_s))
        elif self._waiting:
            self._look_again()

    def _attempt(self, task: Task) -> str | None:
        """Raises StepFailed, naming the step; a daemon that went away is no fault of the step."""
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
        """A task that could not be done ends the launch, or is left out where that keeps going. Raises StepFailed."""
        if not self.run.plan.missing.keeps_going:
            raise error if isinstance(error, StepFailed) else StepFailed(task, error) from None
        task.leave_out(self.run, "the node", error)
        self.run.left_out.append(task)

    def _look_again(self) -> None:
        """Start what can be started now. A task that now waits for something else says so."""
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
                    entry.told = entry.told and why == entry.reason
                    entry.reason = why

    def _wait_for_all(self) -> None:
        while essential := [entry for entry in self._waiting if not entry.task.waits_lightly]:
            for entry in essential:
                if not entry.told:
                    entry.told = True
                    entry.task.settled(self.run, f"waits for {entry.reason}")
                if self._waits_in_vain(entry):
                    self._waiting.remove(entry)
                    self._fail(entry.task, Refused(f"there is no {_bare(entry.reason)}"))
                elif self.run.client.monotonic() >= entry.until:
                    if not entry.task.goes_on_waiting(self.run):
                        limit = f"within {entry.task.patience_s:g} s"
                        self._waiting.remove(entry)
                        self._fail(entry.task, Refused(f"there was no {_bare(entry.reason)} {limit}"))
                    entry.until = math.inf
            self._turn(_LOOK_AGAIN_S)
            if self._over:
                return
            self._look_again()

    def _waits_in_vain(self, entry: _Waiting) -> bool:
        """Whether it waits for the robot of a node that was left out, and nobody else here could spawn one."""
        if isinstance(entry.task, SpawnModel):
            awaited = entry.task.words.one("-wait")
            return any(isinstance(task, SpawnModel) and task.model == awaited for task in self.run.left_out)
        nodes = [task.node for task in self.tasks if task not in self.run.left_out]
        could_come = any(isinstance(task, Process) for task in self.begun) or any(map(_spawns, nodes))
        return isinstance(entry.task, Spawner) and not could_come and any(map(_spawns, self.run.plan.nodes))

    def _check_left(self) -> None:
        """Raise Refused when so much was left out that nothing is there to drive."""
        missing = self.run.plan.missing
        if not missing.keeps_going or not missing or any(isinstance(task, Process) for task in self._running()):
            return
        spawners = [task for task in self.tasks if isinstance(task, Spawner)]
        if spawners:
            is_left = any(task.loaded for task in spawners)
        elif any(map(_spawns, self.run.plan.nodes)):
            is_left = any(isinstance(task, SpawnModel) and task.model in self.run.spawned for task in self.tasks)
        else:
            is_left = any(task not in self.run.left_out for task in self.begun)
        if not is_left:
            raise Refused("nothing is left to drive", "\n".join(["left out:", *missing.lines()]))

    # --- running --------------------------------------------------------------------------------------------------

    def watch(self) -> None:
        """Returns when there is nothing left to watch, or a required node has finished.

        Raises:
            Refused: a required node died; or all have ended, and some of them badly. NoDaemon. Interrupted.
        """
        if self.run.console.is_live:
            self._show_status()
        while not self._over and self.stays:
            self._turn(_LOOK_SELDOM_S if self._waiting else None)
            if self._waiting:
                self._look_again()
        self.judge()

    def _turn(self, most_s: float | None) -> None:
        """Handle what has arrived, and wait for more. Raises NoDaemon, Interrupted."""
        self.run.interrupts.check()
        self._take_in()
        self.run.watch.turn(most_s)
        self._take_in()

    def _take_in(self) -> None:
        """Give the messages that have come to the tasks that subscribe to them."""
        for _ in self.run.client.events(0.0):
            pass

    @property
    def stays(self) -> bool:
        """Whether there is something to watch. A daemon of one's own is something to stay for."""
        return self.run.owns_daemon or bool(self._running()) or bool(self._waiting)

    def _running(self) -> list[Task]:
        waiting = [entry.task for entry in self._waiting]
        gone = (*self._ended, *self.run.left_out, *waiting)
        return [task for task in self.begun if task.keeps_running and task not in gone]

    def _is_required(self, task: Task) -> bool:
        if task.family == "notice":  # a window that there never was cannot be closed
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
        """Raise Refused when a node has ended badly so far."""
        self._judge_required()
        died = {task: code for task in self.begun if isinstance(task, Process) and (code := self._ended.get(task))}
        if died:
            names = ", ".join(f"{task.node.full_name} ({reason(code)})" for task, code in died.items())
            raise Refused(f"these nodes died: {names}")

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
        """End what was begun, the last first, and the daemon if it was begun here.

        Outside of a block in which signals are raised: they only hurry it.
        """
        run = self.run
        run.console.closing()
        run.failed = run.failed or not self.is_up
        processes = self._processes()
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

    def _robots(self) -> list[tuple[str, int]]:
        """Those in the world, each with the session id of the process that asked for it."""
        return [(robot["name"], robot["process_session"]) for robot in self.run.robots(HOOK_LIMIT_S)]

    def _delete_robots_of(self, processes: Sequence[Process]) -> None:
        """Delete what programs of this launch have spawned. A program in a session that it made itself is not known.

        The id of a session may have belonged to another one before: hence robots that were found here stay.
        """
        owners = {number: process for process in processes for number in process.sessions}
        if not owners:
            return
        try:
            for name, number in self._robots():
                if number in owners and (name, number) not in self._found:
                    self.run.call("/gazebo/delete_model", {"model_name": name}, HOOK_LIMIT_S)
                    owners[number].settled(self.run, f"{name}: deleted")
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
        for seconds, number in (
            (options.sigint_timeout_s, signal.SIGTERM),
            (options.sigterm_timeout_s, signal.SIGKILL),
        ):
            deadline += seconds
            for process in reversed(processes):
                process.finish(self.run, deadline, number)
        for process in reversed(processes):
            process.release()


def _spawns(node: Node) -> bool:
    """Whether a node puts a robot into the world."""
    return node.package == "gazebo_ros" and node.type.removesuffix(".py") == "spawn_model"


def _bare(reason: str) -> str:
    """What a task waits for, to stand behind "no"."""
    return reason.removeprefix("the ").removeprefix("a ")


# --- before the first node -------------------------------------------------------------------------------------------


def look_ahead(
    plan: LaunchPlan, tasks: Sequence[Task], packages: Packages, run_commands: bool = True
) -> Mapping[str, Leaf]:
    """The parameters of a plan, after everything was noted that it needs and is not there, as far as files tell.

    Raises:
        NotThere: all of that, unless the launch goes on without it. BadFile: a value cannot be had.
    """
    parameters = plan.parameters(gather=True, run_commands=run_commands)
    for task in tasks:
        task.look_ahead(plan, packages, parameters)
    plan.missing.refuse()
    return parameters


def _prepare(run: Run, parameters: Mapping[str, Leaf]) -> None:
    """Raises Refused with the place of what cannot be done."""
    _tell_notices(run)
    for command in run.plan.commands:
        _carry_out(run, command)
    for namespace, place in run.plan.clear:
        if run.call("/rosapi/has_param", {"name": namespace})["exists"]:
            _delete(run, namespace, place)
    _set(run, parameters)
    if parameters:
        plural = "" if len(parameters) == 1 else "s"
        run.console.step("parameters", f"{len(parameters)} parameter{plural} set", count=len(parameters))


def _tell_notices(run: Run) -> None:
    """What the files say that is wrong in full, the rest counted unless `-v`."""
    quiet = 0
    for notice in run.plan.notices:
        if notice.verdict == "wrong" or run.console.verbose:
            run.console.warn(str(notice))
        else:
            quiet += 1
    if quiet:
        things = "one thing" if quiet == 1 else f"{quiet} things"
        run.console.step("notices", f"{things} in the files without effect, -v shows more", count=quiet)


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
        write_whole(command.file, text)
    except OSError as error:
        raise Refused(f"{command.place}: <rosparam>: cannot write {command.file}: {error.strerror}") from None


def _delete(run: Run, name: str, place: Location) -> None:
    try:
        run.call("/rosapi/delete_param", {"name": name})
    except SlidectlError as error:
        raise Refused(f"{place}: {error.message}", error.hint) from None


def _set(run: Run, parameters: Mapping[str, Leaf]) -> None:
    """All in one go: the requests first, then the answers."""
    calls = [(name, place, _begin(run, name, value, place)) for name, (value, place) in parameters.items()]
    for name, place, call in calls:
        try:
            run.client.answer(call)
        except Refused as error:
            raise Refused(f"{place}: parameter {name}: {error.message}", error.hint) from None


def _begin(run: Run, name: str, value: object, place: Location) -> str:
    """The id of the call. Of a robot's description the daemon keeps beside it where its elements were written."""
    if isinstance(value, str):
        value, note = source_note.split(value)
        if note:
            run.client.call_async("/slidectl/sources", {"digest": source_note.digest(value), "note": note})
    try:
        text = json.dumps(value, allow_nan=False)
        return run.client.call_async("/rosapi/set_param", {"name": name, "value": text})
    except ValueError:
        raise place.error(f"parameter {name}: {value} is no finite number, and parameters hold no others") from None
    except UsageError as error:  # too long for a line
        raise place.error(f"parameter {name}: {error.message}") from None
