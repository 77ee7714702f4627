"""Hardware interfaces: handles by name, and the claims that controllers lay on them.

Rules of ros_control's ResourceManager. An interface holds handles of one kind; those of command interfaces
are claimed by whoever gets them. Nothing here moves a joint.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Generic, Protocol, Self, TypeVar

from slidectl.control.handles import JointHandle, JointStateHandle
from slidectl.errors import UnknownName


class Handle(Protocol):
    """Anything with a name can be a resource."""

    name: str


H = TypeVar("H", bound=Handle)


class UnknownResource(UnknownName):
    """An interface has no handle of that name."""


@dataclass(frozen=True, slots=True)
class ClaimedResources:
    """What one controller claims through one interface: names, sorted."""

    hardware_interface: str
    resources: tuple[str, ...] = ()


class ResourceManager(Generic[H]):
    """Handles of one interface by name. Subclasses give the type name and whether getting a handle claims it."""

    type_name: ClassVar[str] = ""
    kind: ClassVar[str] = "joint"
    """What a resource is called in messages."""
    claims: ClassVar[bool] = False

    def __init__(self, handles: Iterable[H] = ()) -> None:
        self._handles: dict[str, H] = {}
        self._claimed: set[str] = set()
        for handle in handles:
            self.register_handle(handle)

    def register_handle(self, handle: H) -> H | None:
        """Put the handle under its name. Returns the one that it replaces, else None."""
        replaced = self._handles.get(handle.name)
        self._handles[handle.name] = handle
        return replaced

    def names(self) -> list[str]:
        """The names of all handles, alphabetical."""
        return sorted(self._handles)

    def get_handle(self, name: str) -> H:
        """The handle of that name; a claiming interface notes the claim.

        Raises:
            UnknownResource: there is none; then nothing is claimed.
        """
        handle = self._handles.get(name)
        if handle is None:
            raise UnknownResource(self.kind, name, self.names(), f"in {self.type_name}")
        if self.claims:
            self._claimed.add(name)
        return handle

    def take_claims(self) -> tuple[str, ...]:
        """The names claimed since the last call, alphabetical; the record is then empty."""
        claimed = tuple(sorted(self._claimed))
        self._claimed.clear()
        return claimed

    @classmethod
    def combined(cls, sources: Iterable[Self]) -> Self:
        """One interface with the handles of several; of two of one name the last stays."""
        whole = cls()
        for source in sources:
            for handle in source._handles.values():
                whole.register_handle(handle)
        return whole


class JointStateInterface(ResourceManager[JointStateHandle]):
    """Position, velocity and effort of joints, to read only."""

    type_name = "hardware_interface::JointStateInterface"


class JointCommandInterface(ResourceManager[JointHandle]):
    """Joints that take one command. Not registered itself: its children say what the command is."""

    claims = True


class EffortJointInterface(JointCommandInterface):
    """Commands in N or N·m."""

    type_name = "hardware_interface::EffortJointInterface"


class VelocityJointInterface(JointCommandInterface):
    """Commands in m/s or rad/s."""

    type_name = "hardware_interface::VelocityJointInterface"


class PositionJointInterface(JointCommandInterface):
    """Commands in m or rad."""

    type_name = "hardware_interface::PositionJointInterface"
