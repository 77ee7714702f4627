"""controller_manager's scripts `controller_manager` and `controller_group` as nodes: done once, and gone.

What goes wrong ends the launch, where the scripts print it and leave with 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from slidectl import names
from slidectl.errors import Refused, UnknownName
from slidectl.launch.manager import BEST_EFFORT, Manager
from slidectl.launch.options import parse
from slidectl.launch.plan import Node, Plan
from slidectl.launch.task import Run, Task

_ALIASES = {"lc": "list", "lt": "list-types", "sp": "spawn", "kl": "kill", "reload": "reload-libraries"}
_NAMELESS = ("list", "list-types", "reload-libraries")


class ManagerScript(Task):
    """`controller_manager COMMAND [NAME...]`."""

    family = "controllers"
    keeps_running = False

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        words = parse(node, {"--restore": 0})
        command, *self.controllers = words.rest or [""]
        self.command = _ALIASES.get(command, command)
        self.restore = words.has("--restore")
        if self.command not in _COMMANDS:
            error = UnknownName("command", command, sorted(_COMMANDS), "of controller_manager")
            raise node.place.error(f"{node.full_name}: {error.message}", error.hint)
        if not self.controllers and self.command not in _NAMELESS:
            raise node.place.error(f"{node.full_name}: {self.command} needs the names of controllers")

    @property
    def text(self) -> str:
        return f"controller_manager {self.command} {' '.join(self.controllers)}".rstrip()

    def start(self, run: Run) -> str | None:
        manager = Manager(run, self.node.namespace)
        if not manager.is_there():
            return f"{manager.name} (no robot is in {self.node.namespace} yet)"
        for line in _COMMANDS[self.command](manager, self.controllers):
            self.settled(run, line)
        if self.command == "reload-libraries":
            self._reload(run, manager)
        return None

    def _reload(self, run: Run, manager: Manager) -> None:
        before = manager.states()
        manager.reload_libraries()
        self.settled(run, "Successfully reloaded libraries")
        if self.restore:
            for name in before:
                manager.load(name)
            running = [name for name, state in before.items() if state == "running"]
            if running:
                manager.switch(running, (), BEST_EFFORT)
            self.settled(run, "Controllers restored to original state")


def _load(manager: Manager, controllers: Sequence[str]) -> list[str]:
    for name in controllers:
        manager.load(name)
    return [f"Loaded {name!r}" for name in controllers]


def _unload(manager: Manager, controllers: Sequence[str]) -> list[str]:
    for name in controllers:
        manager.unload(name)
    return [f"Unloaded {name!r} successfully" for name in controllers]


def _start(manager: Manager, controllers: Sequence[str]) -> list[str]:
    for name in controllers:
        manager.switch([name], ())
    return [f"Started {[name]} successfully" for name in controllers]


def _stop(manager: Manager, controllers: Sequence[str]) -> list[str]:
    for name in controllers:
        manager.switch((), [name])
    return [f"Stopped {[name]} successfully" for name in controllers]


def _list(manager: Manager, _: Sequence[str]) -> list[str]:
    lines = []
    for controller in manager.controllers():
        interfaces = dict.fromkeys(claimed["hardware_interface"] for claimed in controller["claimed_resources"])
        lines.append(f"'{controller['name']}' - '{'+'.join(interfaces)}' ( {controller['state']} )")
    return lines or ["No controllers are loaded in mechanism control"]


_COMMANDS: dict[str, Callable[[Manager, Sequence[str]], list[str]]] = {
    "load": _load,
    "unload": _unload,
    "start": _start,
    "stop": _stop,
    "spawn": lambda manager, controllers: [*_load(manager, controllers), *_start(manager, controllers)],
    "kill": lambda manager, controllers: [*_stop(manager, controllers), *_unload(manager, controllers)],
    "list": _list,
    "list-types": lambda manager, _: manager.types(),
    "reload-libraries": lambda *_: [],
}


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
        manager = Manager(run, self.node.namespace)
        if not manager.is_there():
            return f"{manager.name} (no robot is in {self.node.namespace} yet)"
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

    def _bring_up(self, manager: Manager, wanted: Sequence[str], unwanted: set[str]) -> None:
        """Load what is missing; then one strict switch."""
        states = manager.states()
        for name in wanted:
            if name not in states:
                manager.load(name)
        start = [name for name in wanted if states.get(name) != "running"]
        stop = [name for name, state in states.items() if state == "running" and name in unwanted]
        if start or stop:
            manager.switch(start, stop)
