"""The robot as its hardware: interfaces by type, the conflict check, and the hooks that a real robot fills in.

Base of every hardware, simulated or fake. It knows no controllers, only what they claim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeVar

from slidectl.control.interfaces import ClaimedResources, ResourceManager

I = TypeVar("I", bound=ResourceManager[Any])  # noqa: E741 - the field's letter for an interface
AnyInterface = ResourceManager[Any]


class SwitchState(Enum):
    """How far the hardware is with a change of interfaces."""

    DONE = "done"
    ONGOING = "ongoing"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """A loaded controller as the hardware sees it."""

    name: str
    type: str
    claimed_resources: tuple[ClaimedResources, ...] = ()


@dataclass(frozen=True, slots=True)
class Conflict:
    """A resource that is claimed more than once, by these controllers (one may be named twice)."""

    resource: str
    controllers: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.resource} is claimed by {' and '.join(self.controllers)}"


class RobotHW:
    """Interfaces of a robot, its own and those of parts; `read` and `write` once a cycle."""

    def __init__(self) -> None:
        self._interfaces: dict[str, AnyInterface] = {}
        self._parts: list[RobotHW] = []
        self._combined: dict[str, tuple[int, AnyInterface]] = {}

    def register_interface(self, interface: AnyInterface) -> AnyInterface | None:
        """Put the interface under its type's name. Returns the one that it replaces, else None."""
        replaced = self._interfaces.get(interface.type_name)
        self._interfaces[interface.type_name] = interface
        return replaced

    def register_part(self, part: RobotHW) -> None:
        """Make the interfaces of another hardware visible through this one."""
        self._parts.append(part)

    def get(self, interface_type: type[I]) -> I | None:
        """The interface of that type; several parts' are combined into one; None when nobody has it."""
        sources = self._sources(interface_type)
        if len(sources) < 2:
            return sources[0] if sources else None
        count, whole = self._combined.get(interface_type.type_name, (0, None))
        if not isinstance(whole, interface_type) or count != len(sources):
            whole = interface_type.combined(sources)
            self._combined[interface_type.type_name] = (len(sources), whole)
        return whole

    def _sources(self, interface_type: type[I]) -> list[I]:
        own = self._interfaces.get(interface_type.type_name)
        found = [own] if isinstance(own, interface_type) else []
        nested = (part.get(interface_type) for part in self._parts)
        return found + [interface for interface in nested if interface is not None]

    def interface_names(self) -> list[str]:
        """The type names of all interfaces, alphabetical."""
        names = set(self._interfaces)
        for part in self._parts:
            names.update(part.interface_names())
        return sorted(names)

    def interface_resources(self, type_name: str) -> list[str]:
        """The names of the handles in the interface of that type name, alphabetical; empty when there is none."""
        own = self._interfaces.get(type_name)
        names = set(own.names()) if own is not None else set()
        for part in self._parts:
            names.update(part.interface_resources(type_name))
        return sorted(names)

    def check_for_conflict(self, infos: Sequence[ControllerInfo]) -> list[Conflict]:
        """Resources claimed more than once if these controllers ran together, over all interfaces."""
        claimants: dict[str, list[str]] = {}
        for info in infos:
            for claimed in info.claimed_resources:
                for resource in claimed.resources:
                    claimants.setdefault(resource, []).append(info.name)
        return [Conflict(name, tuple(who)) for name, who in sorted(claimants.items()) if len(who) > 1]

    def prepare_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> bool:  # noqa: ARG002
        """May these controllers start and stop together? False vetoes the switch."""
        return True

    def do_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> None:
        """Begin the change of interfaces, in the cycle of the switch."""

    def switch_result(self, info: ControllerInfo | None = None) -> SwitchState:  # noqa: ARG002
        """How far the change is, of one controller or as a whole."""
        return SwitchState.DONE

    def read(self, time_ns: int, period_s: float) -> None:
        """Take the state of all joints into their handles."""

    def write(self, time_ns: int, period_s: float) -> None:
        """Give the commands of all handles to the joints."""
