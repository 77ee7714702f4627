"""Controllers by type name: the decorator that registers a class, and the loader that makes instances.

Every module of `controllers/` is imported when types are first asked for; that is all it takes to add a family.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Protocol, TypeVar

from slidectl.control.controller_interface import Compiled, ControllerBase
from slidectl.errors import UnknownName

C = TypeVar("C", bound=type[ControllerBase])

BASE_CLASS = "controller_interface::ControllerBase"
_ELSEWHERE = {
    "AckermannSteeringController", "ForceTorqueSensorController", "FourWheelSteeringController",
    "ImuSensorController",
}  # fmt: skip
_known: dict[str, type[ControllerBase]] = {}


class UnknownType(UnknownName):
    """No controller is registered under that type."""

    def __init__(self, type_name: str, known: Sequence[str]) -> None:
        super().__init__("controller type", type_name, known)
        if type_name.rpartition("/")[2] in _ELSEWHERE:  # no slip of the pen: a similar name is no help
            self.message = f"the controller type {type_name!r} of ros_controllers is not among those of slidectl"


class ControllerLoader(Protocol):
    """A source of controllers. A manager asks its loaders in turn."""

    base_class: str

    def types(self) -> list[str]:
        """The types that it can make."""

    def create(self, type_name: str) -> ControllerBase:
        """A fresh controller of one of these types."""

    def reload(self) -> None:
        """Look for controllers anew."""


class RegistryLoader:
    """The controllers that are registered here."""

    base_class = BASE_CLASS

    def types(self) -> list[str]:
        """All registered types."""
        return types()

    def create(self, type_name: str) -> ControllerBase:
        """A fresh controller of that type. Raises UnknownType."""
        return create(type_name)

    def reload(self) -> None:
        """Nothing to do: registered classes stay."""


def controller(*type_names: str) -> Callable[[C], C]:
    """Class decorator: register the class under these types. A type that is taken goes to the newer class."""

    def register(cls: C) -> C:
        for type_name in type_names:
            _known[type_name] = cls
        return cls

    return register


def types() -> list[str]:
    """All registered types, alphabetical."""
    _import_shipped()
    return sorted(_known)


def find(type_name: str) -> type[ControllerBase]:
    """The class of that type. Raises UnknownType."""
    _import_shipped()
    cls = _known.get(type_name)
    if cls is None:
        raise UnknownType(type_name, types())
    return cls


def create(type_name: str) -> ControllerBase:
    """A fresh controller of that type. Raises UnknownType."""
    return find(type_name)()


def compiled_forms() -> dict[type[ControllerBase], Compiled]:
    """The classes that declare how they run compiled, with that declaration, by name: the same order in any process."""
    _import_shipped()
    classes = {cls for registered in _known.values() for cls in registered.__mro__ if issubclass(cls, ControllerBase)}
    by_name = sorted(classes, key=lambda cls: f"{cls.__module__}.{cls.__qualname__}")
    return {cls: form for cls in by_name if (form := vars(cls).get("compiled")) is not None}


@cache
def _import_shipped() -> None:
    package = import_module("slidectl.control.controllers")
    for module in iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")
