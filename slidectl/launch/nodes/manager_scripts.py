"""controller_manager's scripts `controller_manager` and `controller_group` as nodes: done once, and gone.

What goes wrong ends the launch, where the scripts print it and leave with 0. Their lines are theirs to the letter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from slidectl import names
from slidectl.client.client import BEST_EFFORT
from slidectl.errors import Refused, UnknownName
from slidectl.launch.manager import NodeManager
from slidectl.launch.options import parse
from slidectl.launch.plan import Node, Plan
from slidectl.launch.task import Run, Task

_ALIASES = {"lc": "list", "lt": "list-types", "sp": "spawn", "kl": "kill", "reload": "reload-libraries"}
_NAMELESS = ("list", "list-types", "reload-libraries")
_NOT_RELOADED = "Failed to reload libraries. Do you still have controllers loaded?"

COMMANDS: dict[str, tuple[str, ...]] = {
    "load": ("load",), "unload": ("unload",), "start": ("start",), "stop": ("stop",),
    "spawn": ("load", "start"), "kill": ("stop", "unload"),
    "list": (), "list-types": (), "reload-libraries": (),
}  # fmt: skip
"""Command -> what is done with all controllers, one after the other."""


def is_command(word: str) -> bool:
    """Whether the script knows the command, by its name or by its alias."""
    return _ALIASES.get(word, word) in COMMANDS


class Operation(NamedTuple):
    """One call of the script, and the line that it prints when that is done and when it is not."""

    act: Callable[[], None]
    done: str
    failed: str


class ManagerScript(Task):
    """`controller_manager COMMAND [NAME...]`. With `goes_on` one operation that fails does not keep the next away."""

    family = "controllers"
    keeps_running = False

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        words = parse(node, {"--restore": 0})
        command, *self.controllers = words.rest or [""]
        self.command = _ALIASES.get(command, command)
        self.restore = words.has("--restore")
        self.goes_on = False
        if self.command not in COMMANDS:
            error = UnknownName("command", command, sorted(COMMANDS), "of controller_manager")
            message = error.message if command else "controller_manager needs a command in its args"
            raise node.place.error(f"{node.full_name}: {message}", error.hint)
        if not self.controllers and self.command not in _NAMELESS:
            raise node.place.error(f"{node.full_name}: {self.command} needs the names of controllers")

    @property
    def text(self) -> str:
        return f"controller_manager {self.command} {' '.join(self.controllers)}".rstrip()

    def start(self, run: Run) -> str | None:
        manager = NodeManager(run, self.node.namespace)
        if not manager.is_there():
            return manager.missing()
        for line in self._lines(manager):
            self.settled(run, line)
        failures: list[str] = []
        for operation in self._operations(manager):
            try:
                operation.act()
            except Refused as error:
                self.settled(run, operation.failed)
                failures.append(error.message)
                if not self.goes_on:
                    raise
            else:
                self.settled(run, operation.done)
        if failures:
            raise Refused("\n".join(failures))
        return None

    def _lines(self, manager: NodeManager) -> list[str]:
        """What the script prints before it does anything."""
        if self.command == "list":
            return _states(manager)
        if self.command == "list-types":
            return list(manager.types()["types"])
        return [f"Restore: {self.restore}"] if self.command == "reload-libraries" else []

    def _operations(self, manager: NodeManager) -> list[Operation]:
        if self.command == "reload-libraries":
            return self._reload(manager)
        return [_operation(manager, verb, name) for verb in COMMANDS[self.command] for name in self.controllers]

    def _reload(self, manager: NodeManager) -> list[Operation]:
        before = manager.states() if self.restore else {}
        running = [name for name, state in before.items() if state == "running"]
        operations = [Operation(manager.reload_libraries, "Successfully reloaded libraries", _NOT_RELOADED)]
        operations += [_operation(manager, "load", name) for name in before]
        if self.restore:

            def restart() -> None:
                if running:
                    manager.switch(running, (), BEST_EFFORT)

            operations.append(Operation(restart, "Controllers restored to original state", f"{running} not restarted"))
        return operations


def _operation(manager: NodeManager, verb: str, name: str) -> Operation:
    if verb == "load":
        return Operation(lambda: manager.load(name), f"Loaded {name!r}", f"Error when loading {name!r}")
    if verb == "unload":
        return Operation(
            lambda: manager.unload(name), f"Unloaded {name!r} successfully", f"Error when unloading {name!r}"
        )
    start, stop = ([name], []) if verb == "start" else ([], [name])
    failed = f"Error when starting {start} and stopping {stop}"
    done = f"{'Started' if start else 'Stopped'} {[name]} successfully"
    return Operation(lambda: manager.switch(start, stop), done, failed)


def _states(manager: NodeManager) -> list[str]:
    lines = []
    for controller in manager.controllers():
        interfaces = dict.fromkeys(claimed["hardware_interface"] for claimed in controller["claimed_resources"])
        lines.append(f"'{controller['name']}' - '{'+'.join(interfaces)}' ( {controller['state']} )")
    return lines or ["No controllers are loaded in mechanism control"]


class GroupScript(Task):
    """`controller_group list | spawn GROUP | switch GROUP`, with the groups of the parameter `controller_groups`."""

    family = "controllers"
    keeps_running = False

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        words = parse(node, {}).rest
        self.command = words[0] if words else ""
        self.group = words[1] if len(words) > 1 else ""
        if self.command not in ("list", "spawn", "switch") or (self.command != "list") != bool(self.group):
            raise node.place.error(
                f"{node.full_name}: controller_group does not understand {' '.join(words)!r}",
                "controller_group list, spawn GROUP or switch GROUP",
            )

    @property
    def text(self) -> str:
        return f"controller_group {self.command} {self.group}".rstrip()

    def start(self, run: Run) -> str | None:
        manager = NodeManager(run, self.node.namespace)
        if not manager.is_there():
            return manager.missing()
        groups = self._groups(run)
        if self.command == "list":
            self._list(run, groups)
            return None
        if not groups.get(self.group):
            raise UnknownName("controller group", self.group, sorted(groups), f"in {self._parameter}")
        wanted = groups[self.group]
        others = {name for group, members in groups.items() if group != self.group for name in members}
        self._bring_up(manager, wanted, others - set(wanted) if self.command == "switch" else set())
        self.settled(run, f"{', '.join(wanted)} running in {self.node.namespace}", controllers=wanted)
        return None

    @property
    def _parameter(self) -> str:
        return names.join(self.node.namespace, "controller_groups")

    def _groups(self, run: Run) -> dict[str, list[str]]:
        groups = run.parameter(self._parameter)
        if groups is None:
            raise Refused(f"the parameter {self._parameter} is not set", "it maps groups to lists of controllers")
        is_right = isinstance(groups, dict) and all(isinstance(members, list) for members in groups.values())
        if not is_right:
            raise Refused(f"the parameter {self._parameter} is no mapping of groups to lists of controllers")
        return {str(group): [str(name) for name in members] for group, members in groups.items()}

    def _list(self, run: Run, groups: dict[str, list[str]]) -> None:
        self.settled(run, f"Number of groups: {len(groups)}")
        for group in sorted(groups):
            self.settled(run, f"  {group}")
            for name in sorted(groups[group]):
                self.settled(run, f"      {name}")

    def _bring_up(self, manager: NodeManager, wanted: Sequence[str], unwanted: set[str]) -> None:
        """Load what is missing; then one strict switch."""
        states = manager.states()
        for name in wanted:
            if name not in states:
                manager.load(name)
        start = [name for name in wanted if states.get(name) != "running"]
        stop = [name for name, state in states.items() if state == "running" and name in unwanted]
        if start or stop:
            manager.switch(start, stop)
