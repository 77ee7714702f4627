"""Controller managers as the command line sees them: which exist, which one a name means, what became of a change."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from slidectl import names
from slidectl.cli.context import Context
from slidectl.client.client import UNLOADED, Manager
from slidectl.errors import (
    AmbiguousName,
    Refused,
    SlidectlError,
    TimedOut,
    UnknownName,
    UsageError,
    listing,
)

WAIT_S = 30.0
_LOOK_AGAIN_S = 0.2
_LIST = "controller_manager/list_controllers"


def manager_in(context: Context, namespace: str) -> Manager:
    """The controller manager of a namespace; what it warns of goes to stderr."""
    return Manager(context.client, namespace, context.warn, timeout_s=context.timeout or 0.0)


def managers(context: Context) -> list[Manager]:
    """All controller managers, by namespace."""
    request = {"type": "controller_manager_msgs/ListControllers"}
    services = context.call("/rosapi/services_for_type", request)["services"]
    found = sorted(name.removesuffix(_LIST).rstrip("/") or "/" for name in services if name.endswith("/" + _LIST))
    return [manager_in(context, namespace) for namespace in found]


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
    places = _places(candidates, controllers)
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
    known = [name for name, found in _places(candidates, controllers).items() if found]
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


def _places(candidates: Sequence[Manager], controllers: Sequence[str]) -> dict[str, dict[str, str]]:
    """Controller -> namespace of each manager that knows it -> its name there."""
    known = {manager.namespace: manager.known() for manager in candidates} if controllers else {}
    places: dict[str, dict[str, str]] = {name: {} for name in controllers}
    for name, found in places.items():
        for namespace, inside in known.items():
            local = name.removeprefix(namespace.rstrip("/") + "/")
            if not local.startswith("/") and local in inside:
                found[namespace] = local
    return places


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


# --- for the commands that change controllers -----------------------------------------------------------------------


def wait_for_owner(context: Context, manager: str | None, controllers: Sequence[str]) -> None:
    """Return when a controller manager knows all the controllers.

    Looks again whenever something is logged (every spawn is), and now and then: parameters are not logged.
    Raises TimedOut with what is missing.
    """
    from time import monotonic

    limit = context.wait_limit(WAIT_S)
    deadline = monotonic() + limit
    with context.client.subscribe("/rosout") as lines:
        while (missing := _missing(context, manager, controllers)) is not None:
            if monotonic() >= deadline:
                raise TimedOut(f"still so after {limit:g} s: {missing.message}", missing.hint)
            with suppress(TimedOut):
                lines.get(min(_LOOK_AGAIN_S, max(0.0, deadline - monotonic())))


def _missing(context: Context, manager: str | None, controllers: Sequence[str]) -> SlidectlError | None:
    """Why the controllers have no owner yet; a wrong command line is raised at once."""
    try:
        owner(context, manager, controllers)
    except (Refused, UnknownName) as error:
        return error
    return None


class Report:
    """Says for each controller what it was and what it is, also when the action between failed half way."""

    def __init__(self, context: Context, manager: Manager, controllers: Sequence[str]) -> None:
        self.context = context
        self.manager = manager
        self.names = list(dict.fromkeys(controllers))
        self.before: dict[str, str] = {}

    def __enter__(self) -> Report:
        self.before = self.manager.states()
        return self

    def __exit__(self, _type: object, error: BaseException | None, _trace: object) -> None:
        if error is not None and not isinstance(error, Refused):
            return
        after = self.manager.states()
        for name in self.names:
            was, state = self.before.get(name, UNLOADED), after.get(name, UNLOADED)
            if error is None or was != state:
                self._tell(name, was, state)

    def _tell(self, name: str, was: str, state: str) -> None:
        record = {"manager": self.manager.namespace, "name": name, "state": state, "before": was}
        self.context.done(record, f"{name}: {state}" + (" already" if was == state else f" (was {was})"))
