"""Types of simulated hardware that users write, by the names that `<robotSimType>` gives them.

They come from modules (see `registry.add_module`) and from installed packages, by their entry points. The default one
is in `physics/robot_hw.py`, which is also the base of all others; it is not known here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control import user_classes
from slidectl.control.hardware_interface import RobotHW
from slidectl.description.gazebo_tags import SIM_TYPES, installed_hardware
from slidectl.errors import BadFile, UnknownName

if TYPE_CHECKING:
    from types import ModuleType

_known: dict[str, type[RobotHW]] = {}


def types() -> list[str]:
    """All types: the default, those that were imported, and those of installed packages."""
    return [SIM_TYPES[0], *sorted({*_known, *installed_hardware()})]


def add_all(module: ModuleType, prefix: str) -> list[str]:
    """Take in the hardware that a module defines: the prefix and the class name; but none that begins with `_`."""
    found = {
        f"{prefix}{name}": value
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, RobotHW)
        and value.__module__ == module.__name__
        and not name.startswith("_")
    }
    _known.update(found)
    return list(found)


def check_known(type_name: str) -> None:
    """Raises UnknownName, without any import of the type's code."""
    if type_name not in (*SIM_TYPES, *types()):
        raise UnknownName("robotSimType", type_name, types())


def find(type_name: str) -> type[RobotHW] | None:
    """The class of that type; None: the default is meant.

    Raises:
        UnknownName. BadFile: an installed package names it, and its code fails or has no such class.
    """
    check_known(type_name)
    if type_name in SIM_TYPES:
        return None
    if type_name not in _known:
        point = installed_hardware()[type_name]
        module = user_classes.import_named(point.module)
        cls = vars(module).get(point.attr)
        if not (isinstance(cls, type) and issubclass(cls, RobotHW)):
            raise BadFile(f"{point.attr} is no hardware of a robot", module.__file__ or point.module)
        _known[type_name] = cls
    return _known[type_name]
