"""Controller managers as the command line sees them: which exist, which one a name means, and their services.

Only service calls. The reasons of a refusal come with its answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slidectl import names
from slidectl.cli.context import Context
from slidectl.client.manager import ManagerServices
from slidectl.errors import AmbiguousName, Refused, UnknownName, UsageError, listing

UNLOADED = "unloaded"
_LIST = "controller_manager/list_controllers"


class Manager(ManagerServices):
    """The controller manager of one namespace."""

    def __init__(self, context: Context, namespace: str) -> None:
        super().__init__(namespace)
        self.context = context
        self.timeout_s = context.timeout or 0.0

    def ask(self, verb: str, **request: Any) -> dict[str, Any]:
        return self.context.call(names.join(self.namespace, f"controller_manager/{verb}"), request)

    def act(self, verb: str, **request: Any) -> tuple[bool, list[str]]:
        return self.ask(verb, **request)["ok"], self.context.client.reasons

    def warn(self, text: str) -> None:
        self.context.warn(text)

    def type_parameter(self, name: str) -> str:
        """The type that the parameters give a controller; empty when they give none."""
        import json

        parameter = names.join(self.namespace, f"{name}/type")
        value = json.loads(self.context.call("/rosapi/get_param", {"name": parameter, "default": '""'})["value"])
        return str(value)

    def parameters(self) -> Sequence[str]:
        return self.context.names("parameter")

    def known(self) -> list[str]:
        """Controllers that are loaded or could be."""
        return sorted({*self.states(), *self.configured()})


def managers(context: Context) -> list[Manager]:
    """All controller managers, by namespace."""
    request = {"type": "controller_manager_msgs/ListControllers"}
    services = context.call("/rosapi/services_for_type", request)["services"]
    found = sorted(name.removesuffix(_LIST).rstrip("/") or "/" for name in services if name.endswith("/" + _LIST))
    return [Manager(context, namespace) for namespace in found]


def chosen(context: Context, wanted: str | None) -> list[Manager]:
    """The managers that the options leave: that of `--cm`, else that of `--ns`, else all. Raises UnknownName."""
    every = managers(context)
    known = {manager.namespace: manager for manager in every}
    if wanted is not None:
        name = wanted.rstrip("/").removesuffix("controller_manager").rstrip("/") or "/"
        full = names.resolve(name, known, kind="controller manager", namespace=context.namespace)
        return [known[full]]
    below_root = context.namespace != "/"  # which is also what `--ns` is when nobody gave it
    return [known[context.namespace]] if below_root and context.namespace in known else every


def owner(context: Context, wanted: str | None, controllers: Sequence[str]) -> tuple[Manager, list[str]]:
    """The one manager that the controllers belong to, and their names in it.

    A name may be full (`/slider/joint1_position_controller`). Raises AmbiguousName (2) when several managers know the
    names, UnknownName (1) when none does, UsageError when no single manager has them all.
    """
    candidates = chosen(context, wanted)
    if not candidates:
        raise Refused("no robot with controllers in the world", "spawn one: slidectl spawn slider")
    places = {name: _places(candidates, name) for name in controllers}
    fitting = [m for m in candidates if all(m.namespace in found for found in places.values())]
    if not fitting:
        raise _nowhere(candidates, places)
    if len(fitting) > 1:
        raise _several(fitting, controllers)
    manager = fitting[0]
    return manager, [places[name][manager.namespace] for name in controllers]


def owner_of_some(context: Context, wanted: str | None, controllers: Sequence[str]) -> tuple[Manager, list[str]]:
    """As `owner`, but it is enough when the manager knows some of them, or is the only one: for best effort."""
    candidates = chosen(context, wanted)
    known = [name for name in controllers if _places(candidates, name)]
    manager, _ = owner(context, wanted, known)
    return manager, [name.removeprefix(manager.namespace.rstrip("/") + "/") for name in controllers]


def next_step(context: Context, topic: str) -> str | None:
    """The command that is missing before a controller takes messages on `topic`; None when none is."""
    controller = names.parent(names.join("/", topic)).strip("/").rpartition("/")[2]
    found = managers(context)
    idle = {}
    for manager in found:
        states, configured = manager.states(), manager.configured()
        waiting = [name for name in configured if name not in states]
        if controller in waiting:
            return f"{controller} is not loaded; load and start it: slidectl controller spawn {controller}"
        if waiting:
            idle[manager.namespace] = waiting
        elif not states and not configured:
            idle[manager.namespace] = []
    if topic.rpartition("/")[2] != "command":
        return None
    if not found:
        return "no robot with controllers is in the world; spawn one: slidectl spawn slider"
    for namespace, waiting in idle.items():
        if waiting:
            return f"not loaded in {namespace}: {listing(waiting)}; load and start: slidectl controller spawn NAME"
        return f"{namespace} has no controllers yet; load their configuration: slidectl controller config FILE.yaml"
    return None


def _places(candidates: Sequence[Manager], name: str) -> dict[str, str]:
    """Namespace of each manager that knows the controller -> its name there."""
    found = {}
    for manager in candidates:
        local = name.removeprefix(manager.namespace.rstrip("/") + "/")
        if not local.startswith("/") and local in manager.known():
            found[manager.namespace] = local
    return found


def _nowhere(candidates: Sequence[Manager], places: dict[str, dict[str, str]]) -> Exception:
    for name, found in places.items():
        if not found:
            known = sorted({known for manager in candidates for known in manager.known()})
            where = f"in {candidates[0].namespace}" if len(candidates) == 1 else ""
            error = UnknownName("controller", name, known, where)
            error.hint = f"{error.hint}\nload its configuration first: slidectl controller config FILE.yaml"
            return error
    listed = "; ".join(f"{name} of {', '.join(sorted(found))}" for name, found in places.items())
    return UsageError(f"no controller manager has all of these: {listed}", "one command for each robot, please")


def _several(fitting: Sequence[Manager], controllers: Sequence[str]) -> Exception:
    spaces = [manager.namespace for manager in fitting]
    if not controllers:
        return AmbiguousName("controller manager", "", spaces)
    matches = [names.join(space, name) for name in controllers for space in spaces]
    return AmbiguousName("controller", " ".join(controllers), matches)
