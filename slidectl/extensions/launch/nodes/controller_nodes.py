"""The scripts of controller_manager as nodes: spawner, unspawner, controller_manager and controller_group.

The first two control controllers as long as the node runs. The other two act once; their errors end the launch, while
the real scripts print errors and exit with code 0. A controller without parameters is left out, as by the real scripts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from slidectl import names
from slidectl.client.manager import BEST_EFFORT, RUNNING, STARTED, Manager
from slidectl.description.packages import Packages, is_file
from slidectl.errors import NoDaemon, Refused, SlidectlError, UnknownName
from slidectl.extensions.launch.plan import LaunchPlan, Leaf, Node, leaves
from slidectl.extensions.launch.task import HOOK_LIMIT_S, Run, Task, parse

_SPAWNER_OPTIONS = {
    "--stopped": 0, "--wait-for": 1, "--namespace": 1, "--timeout": 1, "--no-timeout": 0, "--shutdown-timeout": 1,
}  # fmt: skip
_AGAIN_S = 3.0


class _NodeManager(Manager):
    """A controller manager whose errors are one line that names the request."""

    def __init__(self, run: Run, namespace: str, limit_s: float | None) -> None:
        super().__init__(run.client, namespace, run.console.warn, limit_s)

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        return Refused(f"cannot {what}: {'; '.join(reasons) or 'no reason was given'}")


class _ControllerTask(Task):
    """A script that uses the controller manager of its namespace. It waits until that exists."""

    family = "controllers"

    def __init__(self, node: Node, plan: LaunchPlan, options: Mapping[str, int] | None = None) -> None:
        super().__init__(node, plan)
        self.words = parse(node, options or {})
        self.namespace = self.manager_namespace = names.join(node.namespace, self.words.one("--namespace"))

    def manager(self, run: Run, limit_s: float | None = None) -> Manager:
        return _NodeManager(run, self.namespace, limit_s)

    def start(self, run: Run) -> str | None:
        manager = self.manager(run)
        if manager.is_there():
            return self.act(run, manager)
        elsewhere = ", ".join(f"{robot['name']} is in {robot['namespace']}" for robot in run.controlled_robots())
        return f"{manager.name} (no robot is in {self.namespace} yet{f'; {elsewhere}' if elsewhere else ''})"

    def act(self, run: Run, manager: Manager) -> str | None:
        """`start`, when the manager exists."""
        raise NotImplementedError

    def configured(self, run: Run, manager: Manager, controllers: Sequence[str]) -> list[str]:
        """The controllers that have parameters. The others are left out, as the scripts do, each with an error line.

        Raises UnknownName: one has none, in a launch that leaves nothing out.
        """
        known = manager.configured()
        found = []
        for name in controllers:
            if name in known or manager.is_configured(name):
                found.append(name)
                continue
            error = UnknownName("controller", name, known, f"in the parameters of {self.namespace}")
            if not run.plan.missing.keeps_going:
                raise error
            self.leave_out(run, f"the controller {name}", error)
            self.warn(run, f"{error.message}\nthe controller {name} is left out")
        return found


class Spawner(_ControllerTask):
    """`spawner [--stopped] [--wait-for TOPIC] [--namespace NS] [--timeout S | --no-timeout] NAME|FILE.yaml...`"""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan, _SPAWNER_OPTIONS)
        words = self.words
        if not words.rest:
            raise self.error("the spawner needs the names of controllers in its args")
        if words.has("--shutdown-timeout"):
            plan.notice("ignored", node.place, node.full_name, "--shutdown-timeout has no effect, as in ros_control")
        limit = words.number("--timeout", 30.0)
        self.patience_s = math.inf if words.has("--no-timeout") or limit <= 0 else limit
        self.topic = node.resolve(words.one("--wait-for")) if words.has("--wait-for") else None
        """The topic of --wait-for."""
        self.loaded: list[str] = []
        self.has_started = False
        self._subscription: Any = None
        self._absent: set[str] = set()
        """The controllers with missing types."""

    def find_missing(self, plan: LaunchPlan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:  # noqa: ARG002
        # The import of the controllers takes time, and most launches have no spawner.
        from slidectl.control import registry, ros2_names

        for name in self.words.rest:
            kind, place = parameters.get(names.join(self.namespace, f"{name}/type"), (None, None))
            if not isinstance(kind, str) or place is None:
                continue
            own = names.join(self.namespace, name) + "/"
            values = {full.removeprefix(own): value for full, (value, _) in parameters.items() if full.startswith(own)}
            try:
                for_ros2 = registry.is_of_ros2(kind, values, for_ros2=False)
                if not for_ros2:
                    ros2_names.refuse_others(kind, values)
                registry.common.find(kind)
            except (registry.UnknownType, ros2_names.NoCounterpart) as error:
                self._absent.add(name)
                message = f"controller {names.join(self.namespace, name)}: {error.message}"
                plan.missing.note(place.absence(message, error.hint, f"controller type {kind}"), "it is left out")

    @property
    def text(self) -> str:
        verb = "load" if self.words.has("--stopped") else "load and start"
        return f"{verb} {', '.join(self.words.rest)} in {self.namespace}"

    def act(self, run: Run, manager: Manager) -> str | None:
        if self.topic is not None and not self._is_true(run, self.topic):
            return f"true on {self.topic}"
        wanted = [name for name in self._controllers(run) if name not in self._absent]
        controllers = self.configured(run, manager, wanted)
        goes_on = run.plan.missing.leaves_failures_out
        for name in controllers:
            try:
                manager.load(name)
            except Refused as error:
                if not goes_on:
                    raise
                self.leave_out(run, f"the controller {name}", error)
            else:
                self.loaded.append(name)
        if self.loaded and not self.words.has("--stopped"):
            self.has_started = True
            if goes_on:
                self._start_some(run, manager)
            else:
                manager.start(self.loaded)
        if self.loaded:
            state = "loaded" if self.words.has("--stopped") else "running"
            self.settled(run, f"{', '.join(self.loaded)} {state} in {self.namespace}", controllers=self.loaded)
        return None

    def _start_some(self, run: Run, manager: Manager) -> None:
        """Start the controllers that can be started, and leave out the others."""
        reason = Refused("it did not start", "slidectl daemon logs says why")
        try:
            manager.make_ready(self.loaded, manager.states())
            manager.switch(self.loaded, (), BEST_EFFORT)
        except Refused as error:
            reason = error
        states = manager.states()
        for name in [name for name in self.loaded if states.get(name) not in STARTED]:
            self.leave_out(run, f"the controller {name}", reason)
            self.loaded.remove(name)
            _try(run, manager.unload, name)

    def goes_on_waiting(self, run: Run) -> bool:
        """True while it waits for its topic: like the real spawner it then waits on, with a warning."""
        if self._subscription is not None:
            self.warn(run, f"no true message on {self.topic} within {self.patience_s:g} s; it goes on waiting")
        return self._subscription is not None

    def _is_true(self, run: Run, topic: str) -> bool:
        """True when the latest message on the topic of --wait-for is true."""
        if self._subscription is None:
            self._subscription = run.client.subscribe(topic, "std_msgs/Bool")
        last = False
        while len(self._subscription):
            last = bool(self._subscription.get(0.0)["data"])
        return last

    def _controllers(self, run: Run) -> list[str]:
        """The names of controllers. A file is replaced by the names in it, and its content becomes parameters."""
        found: list[str] = []
        for word in self.words.rest:
            if not is_file(Path(word)):
                found.append(word)
                continue
            from slidectl.description import controllers_file

            tree = controllers_file.read(word)
            for name, value in leaves(self.node.namespace, tree, self.node.place):
                run.set_parameter(name, value)
            found += list(tree)
        return list(dict.fromkeys(found))

    def stop(self, run: Run) -> None:
        """Stop the running controllers at once, strictly as the real spawner; then unload them in reverse order."""
        manager = self.manager(run, HOOK_LIMIT_S)
        if not self.loaded or not manager.is_there():
            return
        states = {} if self.has_started else manager.states()
        running = [name for name in self.loaded if self.has_started or states.get(name) in RUNNING]
        if running:
            _try(run, manager.switch, (), running)
        unloaded = [name for name in reversed(self.loaded) if _try(run, manager.unload, name)]
        self.loaded.clear()
        self.settled(run, f"{', '.join(unloaded) or 'nothing'} stopped and unloaded", controllers=unloaded)


class Unspawner(_ControllerTask):
    """`unspawner NAME...`: stops the controllers now and whenever they run again; at the end it starts them."""

    needs_presence = True

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self.controllers = self.words.rest
        if not self.controllers:
            raise self.error("the unspawner needs the names of controllers in its args")
        self.inhibited: list[str] = []

    @property
    def text(self) -> str:
        return f"keep {', '.join(self.controllers)} stopped in {self.namespace}"

    def act(self, run: Run, manager: Manager) -> str | None:
        stopped = self._stop_running(manager)
        run.watch.later(_AGAIN_S, lambda: self._stop_again(run))
        self.settled(run, f"stopped {', '.join(stopped) or 'nothing: none of them runs'}", controllers=stopped)
        return None

    def _stop_running(self, manager: Manager) -> list[str]:
        states = manager.states()
        running = [name for name in self.controllers if states.get(name) in RUNNING]
        if running:
            manager.switch((), running, BEST_EFFORT)
            self.inhibited += [name for name in running if name not in self.inhibited]
        return running

    def _stop_again(self, run: Run) -> None:
        run.watch.later(_AGAIN_S, lambda: self._stop_again(run))
        manager = self.manager(run, HOOK_LIMIT_S)
        try:
            stopped = self._stop_running(manager) if manager.is_there() else []
        except NoDaemon:
            raise
        except SlidectlError as error:
            self.warn(run, error.message)
            return
        if stopped:
            self.settled(run, f"stopped {', '.join(stopped)} again", controllers=stopped)

    def stop(self, run: Run) -> None:
        manager = self.manager(run, HOOK_LIMIT_S)
        if self.inhibited and manager.is_there():
            _try(run, manager.switch, self.inhibited, (), BEST_EFFORT)
            self.settled(run, f"started {', '.join(self.inhibited)} again", controllers=self.inhibited)


def _try(run: Run, action: Callable[..., None], *arguments: Any) -> bool:
    """Do a step of a shutdown hook. An error is printed, so that the next step follows."""
    try:
        action(*arguments)
    except SlidectlError as error:
        run.console.warn(error.message)
        return False
    return True


# --- controller_manager and controller_group -------------------------------------------------------------------------

_ALIASES = {"lc": "list", "lt": "list-types", "sp": "spawn", "kl": "kill", "reload": "reload-libraries"}
_VERBS: dict[str, tuple[str, ...]] = {
    "load": ("load",), "unload": ("unload",), "start": ("start",), "stop": ("stop",),
    "spawn": ("load", "start"), "kill": ("stop", "unload"),
    "list": (), "list-types": (), "reload-libraries": (),
}  # fmt: skip
"""Maps a command to its steps; each step is done for all controllers before the next."""

_Operation = tuple[Callable[[], object], str, str]
"""One call of the script, and its output after success and after failure."""


def is_command(word: str) -> bool:
    """True for a command of the script controller_manager, or its alias."""
    return _ALIASES.get(word, word) in _VERBS


class ManagerScript(_ControllerTask):
    """`controller_manager COMMAND [NAME...]`. With `goes_on` a failed operation does not stop the others."""

    keeps_running = False

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan, {"--restore": 0})
        command, *self.controllers = self.words.rest or [""]
        self.command = _ALIASES.get(command, command)
        self.restore = self.words.has("--restore")
        self.loaded: list[str] = []
        self.goes_on = False
        if self.command not in _VERBS:
            error = UnknownName("command", command, sorted(_VERBS), "of controller_manager")
            raise self.error(error.message if command else "controller_manager needs a command in its args", error.hint)
        if not self.controllers and _VERBS[self.command]:
            raise self.error(f"{self.command} needs the names of controllers")

    @property
    def text(self) -> str:
        return f"controller_manager {self.command} {' '.join(self.controllers)}".rstrip()

    def act(self, run: Run, manager: Manager) -> str | None:
        if "load" in _VERBS[self.command] and not self.goes_on:
            self.controllers = self.configured(run, manager, self.controllers)
        for line in self._lines(manager):
            self.settled(run, line)
        failures: list[str] = []
        for action, done, failed in self._operations(manager):
            try:
                action()
            except Refused as error:
                self.settled(run, failed)
                failures.append(error.message)
                if not self.goes_on:
                    raise
            else:
                self.settled(run, done)
        states = manager.states()
        self.loaded = [name for name in self.controllers if name in states]
        if failures:
            raise Refused("\n".join(failures))
        return None

    def _lines(self, manager: Manager) -> list[str]:
        """The output of the script before any operation."""
        if self.command == "list":
            lines = []
            for one in manager.controllers():
                interfaces = dict.fromkeys(claimed["hardware_interface"] for claimed in one["claimed_resources"])
                lines.append(f"'{one['name']}' - '{'+'.join(interfaces)}' ( {one['state']} )")
            return lines or ["No controllers are loaded in mechanism control"]
        if self.command == "list-types":
            return list(manager.types()["types"])
        return [f"Restore: {self.restore}"] if self.command == "reload-libraries" else []

    def _operations(self, manager: Manager) -> list[_Operation]:
        if self.command != "reload-libraries":
            return [_operation(manager, verb, name) for verb in _VERBS[self.command] for name in self.controllers]
        before = manager.states() if self.restore else {}
        running = [name for name, state in before.items() if state in RUNNING]
        failed = "Failed to reload libraries. Do you still have controllers loaded?"
        operations: list[_Operation] = [(manager.reload_libraries, "Successfully reloaded libraries", failed)]
        operations += [_operation(manager, "load", name) for name in before]
        if self.restore:

            def restart() -> None:
                if running:
                    manager.switch(running, (), BEST_EFFORT)

            operations.append((restart, "Controllers restored to original state", f"{running} not restarted"))
        return operations


def _operation(manager: Manager, verb: str, name: str) -> _Operation:
    if verb == "load":
        return partial(manager.load, name), f"Loaded {name!r}", f"Error when loading {name!r}"
    if verb == "unload":
        return partial(manager.unload, name), f"Unloaded {name!r} successfully", f"Error when unloading {name!r}"
    start, stop = ([name], []) if verb == "start" else ([], [name])
    failed = f"Error when starting {start} and stopping {stop}"
    done = f"{'Started' if start else 'Stopped'} {[name]} successfully"
    return partial(manager.switch, start, stop), done, failed


class GroupScript(_ControllerTask):
    """`controller_group list | spawn GROUP | switch GROUP`, with the groups of the parameter `controller_groups`."""

    keeps_running = False

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = self.words.rest
        self.command, self.group = [*words, "", ""][:2]
        if self.command not in ("list", "spawn", "switch") or (self.command != "list") != bool(self.group):
            message = f"controller_group does not understand {' '.join(words)!r}"
            raise self.error(message, "controller_group list, spawn GROUP or switch GROUP")
        self._parameter = names.join(node.namespace, "controller_groups")

    @property
    def text(self) -> str:
        return f"controller_group {self.command} {self.group}".rstrip()

    def act(self, run: Run, manager: Manager) -> str | None:
        groups = self._groups(run)
        if self.command == "list":
            lines = [f"Number of groups: {len(groups)}"]
            for group in sorted(groups):
                lines += [f"  {group}", *(f"      {name}" for name in sorted(groups[group]))]
            for line in lines:
                self.settled(run, line)
            return None
        if not groups.get(self.group):
            raise UnknownName("controller group", self.group, sorted(groups), f"in {self._parameter}")
        wanted = groups[self.group]
        others = {name for group, members in groups.items() if group != self.group for name in members}
        unwanted = others - set(wanted) if self.command == "switch" else set()
        states = manager.states()
        stop = [name for name, state in states.items() if state in RUNNING and name in unwanted]
        manager.bring_up(wanted, stop=stop, states=states)
        self.settled(run, f"{', '.join(wanted)} running in {self.node.namespace}", controllers=wanted)
        return None

    def _groups(self, run: Run) -> dict[str, list[str]]:
        groups = run.parameter(self._parameter)
        if groups is None:
            raise Refused(f"the parameter {self._parameter} is not set", "it maps groups to lists of controllers")
        if not isinstance(groups, dict) or not all(isinstance(members, list) for members in groups.values()):
            raise Refused(f"the parameter {self._parameter} is not a mapping of groups to lists of controllers")
        return {str(group): [str(name) for name in members] for group, members in groups.items()}
