"""Types of simulated hardware that users write, by the names that `<robotSimType>` uses.

They come from modules (see `ControllerTypes.add_module`) and from the entry points of installed packages. This module
does not import the default type, which is in `physics/robot_hw.py` and is the base of all others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control import user_classes
from slidectl.control.hardware_interface import RobotHW
from slidectl.description.gazebo_tags import SIM_TYPES, installed_hardware
from slidectl.errors import BadFile, UnknownName

if TYPE_CHECKING:
    from types import ModuleType

    from slidectl.control.user_modules import UserCode


class HardwareTypes:
    """The types of hardware that one world knows."""

    def __init__(self, code: UserCode) -> None:
        self._code = code
        self._known: dict[str, type[RobotHW]] = {}

    def types(self) -> list[str]:
        """All types: the default one, the imported ones, and those of installed packages."""
        return [SIM_TYPES[0], *sorted({*self._known, *installed_hardware()})]

    def add_all(self, module: ModuleType, prefix: str) -> list[str]:
        """Register the hardware classes that a module defines, except those that begin with `_`.

        Returns their types: the prefix and the class name.
        """
        found = {
            f"{prefix}{name}": value
            for name, value in vars(module).items()
            if isinstance(value, type)
            and issubclass(value, RobotHW)
            and value.__module__ == module.__name__
            and not name.startswith("_")
        }
        self._known.update(found)
        return list(found)

    def check_known(self, type_name: str) -> None:
        """Raise UnknownName when there is no such type. Imports no code of the type."""
        if type_name not in (*SIM_TYPES, *self.types()):
            raise UnknownName("robotSimType", type_name, self.types())

    def find(self, type_name: str) -> type[RobotHW] | None:
        """The class of that type; None for the default type.

        Raises:
            UnknownName: there is no such type. BadFile: the code of the installed package fails or has no such class.
        """
        self.check_known(type_name)
        if type_name in SIM_TYPES:
            return None
        if type_name not in self._known:
            point = installed_hardware()[type_name]
            module = user_classes.import_named(self._code, point.module)
            cls = vars(module).get(point.attr)
            if not (isinstance(cls, type) and issubclass(cls, RobotHW)):
                raise BadFile(f"{point.attr} is no hardware of a robot", module.__file__ or point.module)
            self._known[type_name] = cls
        return self._known[type_name]
