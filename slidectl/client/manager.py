"""The services of a controller manager by name. Those who use it say how a call is made and where reasons go.

Only service calls: nothing here waits, looks for a manager or prints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slidectl.errors import Refused

STRICT = 2
BEST_EFFORT = 1


class ManagerServices:
    """The controller manager of one namespace. Children say how to `ask` and how to hear of `reasons`."""

    timeout_s = 0.0
    """Longest simulated time that a switch may take; 0: no limit."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace

    def ask(self, verb: str, **request: Any) -> dict[str, Any]:
        """Call a service of the manager."""
        raise NotImplementedError

    def act(self, verb: str, **request: Any) -> tuple[bool, list[str]]:
        """Call one that answers `ok`: that, and the reasons that came with the answer."""
        raise NotImplementedError

    def warn(self, text: str) -> None:
        """Say a reason of something that went well."""
        raise NotImplementedError

    def parameters(self) -> Sequence[str]:
        """The names of all parameters."""
        raise NotImplementedError

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        """The error when the manager said no."""
        return Refused("\n".join(reasons[-2:]) or f"cannot {what}, and no reason was given")

    def _act(self, what: str, verb: str, **request: Any) -> None:
        ok, reasons = self.act(verb, **request)
        if not ok:
            raise self.refusal(what, reasons)
        for reason in reasons:
            self.warn(reason)

    def controllers(self) -> list[dict[str, Any]]:
        """The loaded controllers, in load order (controller_manager_msgs/ControllerState)."""
        return list(self.ask("list_controllers")["controller"])

    def states(self) -> dict[str, str]:
        """Name -> state of the loaded controllers."""
        return {controller["name"]: controller["state"] for controller in self.controllers()}

    def types(self) -> dict[str, Any]:
        """`types` and `base_classes`, parallel lists."""
        return self.ask("list_controller_types")

    def configured(self) -> list[str]:
        """Controllers that have a `type` parameter here, loaded or not."""
        prefix = self.namespace.rstrip("/") + "/"
        inside = (name.removeprefix(prefix) for name in self.parameters() if name.startswith(prefix))
        return [name.removesuffix("/type") for name in inside if name.endswith("/type") and name.count("/") == 1]

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
            timeout=self.timeout_s,
        )

    def reload_libraries(self) -> None:
        """Raises Refused when controllers are in the way."""
        self._act("reload the libraries", "reload_controller_libraries", force_kill=True)
