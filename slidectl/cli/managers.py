"""Controller managers as the command line sees them: which exist, which one a name means, and their services.

Only service calls. The reasons of a refusal are the lines that the manager logs on /rosout meanwhile.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slidectl import names
from slidectl.cli.context import Context
from slidectl.errors import AmbiguousName, Refused, UnknownName, UsageError

STRICT = 2
BEST_EFFORT = 1
UNLOADED = "unloaded"
_LIST = "controller_manager/list_controllers"


class Manager:
    """The controller manager of one namespace."""

    def __init__(self, context: Context, namespace: str) -> None:
        self.context = context
        self.namespace = namespace

    def _ask(self, verb: str, **request: Any) -> dict[str, Any]:
        return self.context.call(names.join(self.namespace, f"controller_manager/{verb}"), request)

    def _act(self, what: str, verb: str, **request: Any) -> None:
        """Call; pass on what is logged meanwhile, as the reasons of a Refused when the answer is not ok."""
        with self.context.client.rosout() as lines:
            answer = self._ask(verb, **request)
        reasons = [str(line["msg"]) for line in lines]
        if not answer["ok"]:
            raise Refused("\n".join(reasons[-2:]) or f"cannot {what}, and no reason was logged")
        for reason in reasons:
            self.context.warn(reason)

    def controllers(self) -> list[dict[str, Any]]:
        """The loaded controllers, in load order (controller_manager_msgs/ControllerState)."""
        return list(self._ask("list_controllers")["controller"])

    def states(self) -> dict[str, str]:
        """Name -> state of the loaded controllers."""
        return {controller["name"]: controller["state"] for controller in self.controllers()}

    def configured(self) -> list[str]:
        """Controllers that have a `type` parameter here, loaded or not."""
        prefix = self.namespace.rstrip("/") + "/"
        inside = (n.removeprefix(prefix) for n in self.context.names("parameter") if n.startswith(prefix))
        return [n.removesuffix("/type") for n in inside if n.endswith("/type") and n.count("/") == 1]

    def type_parameter(self, name: str) -> str:
        """The type that the parameters give a controller; empty when they give none."""
        import json

        parameter = names.join(self.namespace, f"{name}/type")
        value = json.loads(self.context.call("/rosapi/get_param", {"name": parameter, "default": '""'})["value"])
        return str(value)

    def known(self) -> list[str]:
        """Controllers that are loaded or could be."""
        return sorted({*self.states(), *self.configured()})

    def types(self) -> dict[str, Any]:
        """`types` and `base_classes`, parallel lists."""
        return self._ask("list_controller_types")

    def load(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"load {name}", "load_controller", name=name)

    def unload(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"unload {name}", "unload_controller", name=name)

    def switch(self, start: Sequence[str], stop: Sequence[str], strictness: int = STRICT, asap: bool = False) -> None:
        """Stop and start in one cycle. Raises Refused with the reasons."""
        wishes = [f"{verb} {', '.join(wanted)}" for verb, wanted in (("stop", stop), ("start", start)) if wanted]
        self._act(
            " and ".join(wishes) or "switch",
            "switch_controller",
            start_controllers=list(start),
            stop_controllers=list(stop),
            strictness=strictness,
            start_asap=asap,
            timeout=self.context.timeout or 0.0,
        )


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
    return [known[context.namespace]] if context.namespace in known else every


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
            return UnknownName("controller", name, known, where)
    listed = "; ".join(f"{name} of {', '.join(sorted(found))}" for name, found in places.items())
    return UsageError(f"no controller manager has all of these: {listed}", "one command for each robot, please")


def _several(fitting: Sequence[Manager], controllers: Sequence[str]) -> Exception:
    spaces = [manager.namespace for manager in fitting]
    if not controllers:
        return AmbiguousName("controller manager", "", spaces)
    matches = [names.join(space, name) for name in controllers for space in spaces]
    return AmbiguousName("controller", " ".join(controllers), matches)
