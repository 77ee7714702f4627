"""The kinds of gateways: those of slidectl, and those that installed packages add."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slidectl.entry_points import Part, Registry
from slidectl.errors import Refused, UnknownName
from slidectl.paths import install_command

OURS: Mapping[str, str] = {
    "ros1": "slidectl.extensions.gateways.ros1.ros1_gateway:Ros1Gateway",
    "ros2": "slidectl.extensions.gateways.ros2.ros2_gateway:Ros2Gateway",
    "websocket": "slidectl.extensions.gateways.websocket.websocket_gateway:WebSocketGateway",
    "foxglove": "slidectl.extensions.gateways.foxglove.foxglove_gateway:FoxgloveGateway",
}
"""Kind -> `module:class`. The class has a dataclass `Options`; its constructor takes one."""
_WORDS = ("status",)
"""Further commands of `slidectl gateway`."""


class _NamesOfOurs:
    def __contains__(self, name: object) -> bool:
        return name in OURS or name in _WORDS


def _expected(found: Any) -> str:
    from slidectl.extensions.gateways.gateway import Gateway

    return "" if isinstance(found, type) and issubclass(found, Gateway) else "class derived from Gateway"


def _bad_name(name: str) -> str:
    is_word = name.isascii() and name.replace("-", "").replace("_", "").isalnum()
    return "" if is_word else "a name is of letters, digits, '-' and '_'"


GATEWAYS = Registry("slidectl.gateways", "gateway", _NamesOfOurs, _expected, _bad_name)


def find(kind: str) -> Part | None:
    """The gateway of an installed package; None for one of ours. Raises UnknownName, PartError."""
    part = None if kind in OURS else GATEWAYS.find(kind)
    if part is None and kind not in OURS:
        raise UnknownName("gateway", kind, [*OURS, *GATEWAYS.parts()])
    return part


def load(kind: str) -> Any:
    """The class of a gateway. Raises Refused: a library of one of ours is missing. Else as `find`, and PartError."""
    part = find(kind)
    gateway_class = _own_class(kind) if part is None else GATEWAYS.load(part)
    gateway_class.kind = kind
    return gateway_class


def _own_class(kind: str) -> Any:
    from importlib import import_module

    module, _, name = OURS[kind].partition(":")
    try:
        return getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("slidectl"):
            raise
        needed = f"the {kind} gateway needs the library {error.name}"
        raise Refused(needed, f"install it: {install_command(kind)}") from error
