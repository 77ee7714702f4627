"""controller_manager's spawner and unspawner: controllers come and go with the node.

The spawner waits for the controller manager, loads, starts in one switch, and at the end stops and unloads in reverse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slidectl import names
from slidectl.client.client import BEST_EFFORT, STARTED
from slidectl.description.packages import Packages, is_file
from slidectl.errors import NoDaemon, Refused, SlidectlError, UnknownName
from slidectl.launch.manager import NodeManager
from slidectl.launch.options import parse
from slidectl.launch.plan import Leaf, Node, Place, Plan, leaves
from slidectl.launch.task import HOOK_LIMIT_S, Run, Task

_OPTIONS = {
    "--stopped": 0, "--wait-for": 1, "--namespace": 1, "--timeout": 1, "--no-timeout": 0, "--shutdown-timeout": 1,
}  # fmt: skip
_AGAIN_S = 3.0


class Spawner(Task):
    """`spawner [--stopped] [--wait-for TOPIC] [--namespace NS] [--timeout S | --no-timeout] NAME|FILE.yaml...`"""

    family = "controllers"

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        self.words = words = parse(node, _OPTIONS)
        if not words.rest:
            raise node.place.error(f"{node.full_name}: the spawner needs the names of controllers in its args")
        if words.has("--shutdown-timeout"):
            plan.notice("ignored", node.place, node.full_name, "--shutdown-timeout has no effect, as in ros_control")
        limit = words.number("--timeout", 30.0)
        self.patience_s = math.inf if words.has("--no-timeout") or limit <= 0 else limit
        self.namespace = names.join(node.namespace, words.one("--namespace"))
        self.loaded: list[str] = []
        self.has_started = False
        self._gate: Any = None
        self._absent: set[str] = set()
        """Controllers of types that are not there."""

    def look_ahead(self, plan: Plan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:  # noqa: ARG002
        for name in self.words.rest:
            kind, place = parameters.get(names.join(self.namespace, f"{name}/type"), (None, None))
            if isinstance(kind, str) and place is not None:
                self._look_for_type(plan, name, kind, place)

    def _look_for_type(self, plan: Plan, name: str, kind: str, place: Place) -> None:
        from slidectl.control import registry  # the controllers are many modules, and most launches have no spawner

        try:
            registry.find(kind)
        except registry.UnknownType as error:
            self._absent.add(name)
            message = f"controller {names.join(self.namespace, name)}: {error.message}"
            plan.missing.note(place.absence(message, error.hint, f"controller type {kind}"), "it is left out")

    @property
    def text(self) -> str:
        verb = "load" if self.words.has("--stopped") else "load and start"
        return f"{verb} {', '.join(self.words.rest)} in {self.namespace}"

    def start(self, run: Run) -> str | None:
        manager = NodeManager(run, self.namespace)
        if not manager.is_there():
            return manager.missing()
        if self.words.has("--wait-for") and not self._is_open(run):
            return f"true on {self.node.resolve(self.words.one('--wait-for'))}"
        controllers = [name for name in self._controllers(run) if name not in self._absent]
        goes_on = run.plan.missing.keeps_going
        known = manager.configured()
        if not goes_on:
            self._check_known(known, controllers)
        for name in controllers:
            try:
                self._check_known(known, [name])
                manager.load(name)
            except (Refused, UnknownName) as error:
                if not goes_on:
                    raise
                self.leave_out(run, f"the controller {name}", error)
            else:
                self.loaded.append(name)
        if self.loaded and not self.words.has("--stopped"):
            self.has_started = True
            self._switch(run, manager, goes_on)
        if self.loaded:
            self._report(run, manager)
        return None

    def _switch(self, run: Run, manager: NodeManager, goes_on: bool) -> None:
        """Start all of them; with `goes_on` those that can be started."""
        if not goes_on:
            manager.switch(self.loaded, ())
            return
        reason = Refused("it did not start", "slidectl daemon logs says why")
        try:
            manager.switch(self.loaded, (), BEST_EFFORT)
        except Refused as error:
            reason = error
        states = manager.states()
        for name in [name for name in self.loaded if states.get(name) not in STARTED]:
            self.leave_out(run, f"the controller {name}", reason)
            self.loaded.remove(name)
            _try(run, lambda name=name: manager.unload(name))

    def goes_on_waiting(self, run: Run) -> bool:
        """Only the controller manager must come in time; for its topic the real one waits on, with a warning."""
        if self._gate is not None:
            topic = self.node.resolve(self.words.one("--wait-for"))
            self.warn(run, f"nothing true came on {topic} within {self.patience_s:g} s; it is waited for")
        return self._gate is not None

    def _is_open(self, run: Run) -> bool:
        """Whether the last that came on the topic of --wait-for was true."""
        if self._gate is None:
            self._gate = run.client.subscribe(self.node.resolve(self.words.one("--wait-for")), "std_msgs/Bool")
        last = False
        while len(self._gate):
            last = bool(self._gate.get(0.0)["data"])
        return last

    def _controllers(self, run: Run) -> list[str]:
        """The names, with those of files in the place of the files; what is in the files becomes parameters."""
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

    def _check_known(self, known: list[str], controllers: list[str]) -> None:
        """A name without parameters is a slip more often than not: say which there are."""
        for name in controllers:
            if name not in known:
                raise UnknownName("controller", name, known, f"in the parameters of {self.namespace}")

    def _report(self, run: Run, manager: NodeManager) -> None:
        states = manager.states()
        wanted = ("initialized",) if self.words.has("--stopped") else STARTED
        failed = [f"{name} is {states.get(name, 'gone')}" for name in self.loaded if states.get(name) not in wanted]
        if failed:
            raise Refused(f"did not start: {', '.join(failed)}", "slidectl daemon logs says why")
        state = "loaded" if self.words.has("--stopped") else "running"
        self.settled(run, f"{', '.join(self.loaded)} {state} in {self.namespace}", controllers=self.loaded)

    def stop(self, run: Run) -> None:
        """Stop what was started at once, as strictly as the real one; then unload what can be, the last first."""
        manager = NodeManager(run, self.namespace, HOOK_LIMIT_S)
        if not self.loaded or not manager.is_there():
            return
        run.heard()
        gone = []
        states = {} if self.has_started else manager.states()
        running = [name for name in self.loaded if self.has_started or states.get(name) == "running"]
        if running:
            _try(run, lambda: manager.switch((), running))
        for name in reversed(self.loaded):
            if _try(run, lambda name=name: manager.unload(name)):
                gone.append(name)
        self.loaded.clear()
        self.settled(run, f"{', '.join(gone) or 'nothing'} stopped and unloaded", controllers=gone)


class Unspawner(Task):
    """`unspawner NAME...`: they are stopped now and whenever they run again; at the end they are started."""

    family = "controllers"
    needs_presence = True

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        self.controllers = parse(node, {}).rest
        if not self.controllers:
            raise node.place.error(f"{node.full_name}: the unspawner needs the names of controllers in its args")
        self.inhibited: list[str] = []

    @property
    def text(self) -> str:
        return f"keep {', '.join(self.controllers)} stopped in {self.node.namespace}"

    def start(self, run: Run) -> str | None:
        manager = NodeManager(run, self.node.namespace)
        if not manager.is_there():
            return manager.missing()
        stopped = self._look(run)
        run.watch.later(_AGAIN_S, lambda: self._look_again(run))
        self.settled(run, f"stopped {', '.join(stopped) or 'nothing: none of them runs'}", controllers=stopped)
        return None

    def _look(self, run: Run) -> list[str]:
        manager = NodeManager(run, self.node.namespace, HOOK_LIMIT_S)
        states = manager.states()
        running = [name for name in self.controllers if states.get(name) == "running"]
        if running:
            manager.switch((), running, BEST_EFFORT)
            self.inhibited += [name for name in running if name not in self.inhibited]
        return running

    def _look_again(self, run: Run) -> None:
        run.watch.later(_AGAIN_S, lambda: self._look_again(run))
        try:
            stopped = self._look(run) if NodeManager(run, self.node.namespace, HOOK_LIMIT_S).is_there() else []
        except NoDaemon:
            raise
        except SlidectlError as error:
            self.warn(run, error.message)
            return
        if stopped:
            self.settled(run, f"stopped {', '.join(stopped)} again", controllers=stopped)

    def stop(self, run: Run) -> None:
        manager = NodeManager(run, self.node.namespace, HOOK_LIMIT_S)
        if self.inhibited and manager.is_there():
            run.heard()
            _try(run, lambda: manager.switch(self.inhibited, (), BEST_EFFORT))
            self.settled(run, f"started {', '.join(self.inhibited)} again", controllers=self.inhibited)


def _try(run: Run, action: Any) -> bool:
    """A step of a shutdown hook: what goes wrong is said, and the next one is tried."""
    try:
        action()
    except SlidectlError as error:
        run.console.warn(error.message)
        return False
    return True
