"""Types of controllers and of simulated hardware by name: the decorator for controllers, and those that a world knows.

Every module of `controllers/` is imported at the first query of types, so a new family needs only a new module. Users'
classes come from files, from modules, and from the entry points of installed packages; they are those of one world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Any, TypeVar

from slidectl.control import ros2_names, user_classes, user_modules
from slidectl.control.controller_interface import Compiled, ControllerBase
from slidectl.control.hardware_interface import RobotHW
from slidectl.control.user_classes import ControllerClass
from slidectl.control.user_modules import UserCode
from slidectl.description.gazebo_tags import SIM_TYPES, installed_hardware
from slidectl.entry_points import Registry
from slidectl.errors import BadFile, Refused, UnknownName

C = TypeVar("C", bound=type[ControllerBase])

BASE_CLASS = "controller_interface::ControllerBase"
BASE_CLASS_OF_ROS2 = "controller_interface::ControllerInterface"
_shared: dict[str, ControllerClass] = {}
"""The types that all worlds know: shipped ones, and those that a script registers by itself."""
_of_ros2: dict[str, ControllerClass] = {}
"""The shipped types that behave as in ros2_controllers. Some have the name of one of ros_controllers."""
_importing: list[dict[str, ControllerClass]] = []
"""The types of the worlds that are importing users' code, the innermost last."""


def _shipped() -> set[str]:
    _import_shipped()
    return {*_of_ros2, *(name for name, cls in _shared.items() if not user_classes.is_of_a_user(cls))}


def _expected(found: Any) -> str:
    is_controller = isinstance(found, type) and issubclass(found, ControllerBase)
    return "" if is_controller else "class derived from slidectl.control.Controller"


INSTALLED = Registry("slidectl.controllers", "controller type", _shipped, _expected)
"""The types that installed packages name. They are looked up only when a type is unknown."""


class UnknownType(UnknownName):
    """No controller is registered under that type."""

    def __init__(self, type_name: str, known: Sequence[str]) -> None:
        super().__init__("controller type", type_name, known)


def controller(*type_names: str) -> Callable[[C], C]:
    """Class decorator: register the class under these types. It replaces a class that has the type.

    A class in a module that a world imports is known to that world, any other one to all worlds.
    """

    def register(cls: C) -> C:
        table = _shared
        if user_classes.is_of_a_user(cls):
            _import_shipped()
            table = _importing[-1] if _importing else _shared
        for type_name in type_names:
            table[type_name] = cls
        return cls

    return register


def ros2_controller(*type_names: str) -> Callable[[C], C]:
    """Class decorator of the shipped controllers that behave as in ros2_controllers: register the class under these.

    Where ros_controllers have a type of the same name, the robot decides (see ControllerTypes.find).
    """

    def register(cls: C) -> C:
        _of_ros2.update(dict.fromkeys(type_names, cls))
        return cls

    return register


def is_of_ros2(type_name: str, parameters: Mapping[str, Any], for_ros2: bool) -> bool:
    """True when the shipped class of ros2_controllers is meant: the robot is of ROS 2, no other class has this type, or
    the parameters, nested or by full names, are those of ROS 2."""
    _import_shipped()
    if type_name not in _of_ros2:
        return False
    return for_ros2 or type_name not in _shared or ros2_names.has_parameters_of(type_name, parameters)


class HardwareTypes:
    """The types of simulated hardware that one world knows, by the names that `<robotSimType>` uses.

    The default type is in `physics/robot_hw.py`, and is the base of all others.
    """

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
                raise BadFile(f"{point.attr} is not hardware of a robot", module.__file__ or point.module)
            self._known[type_name] = cls
        return self._known[type_name]


class ControllerTypes:
    """The types of controllers and of hardware that one world knows."""

    def __init__(self, code: UserCode) -> None:
        """`code` is the users' code of the world."""
        self.code = code
        self.hardware = HardwareTypes(code)
        self._own: dict[str, ControllerClass] = {}
        """The types that this world has imported. They hide those that all worlds know."""
        self._registered: set[str] = set()
        """Modules that were added. They may be added again without an error."""

    def types(self) -> list[str]:
        """All registered types and those of installed packages, alphabetical."""
        return sorted({*self._known(), *INSTALLED.parts()})

    def types_of_ros2(self) -> list[str]:
        """The types that behave as in ros2_controllers, and those of users, alphabetical."""
        users = [name for name, cls in self._known().items() if user_classes.is_of_a_user(cls)]
        return sorted({*_of_ros2, *users, *INSTALLED.parts()})

    def find(self, type_name: str, *, for_ros2: bool = False) -> ControllerClass:
        """The class of that type. `for_ros2`: of two shipped classes with this type, the one of ros2_controllers.

        Raises:
            UnknownType: no class has this type. BadFile: the code of the installed package that names it fails.
            PartError: several packages claim it.
        """
        cls = self._known(for_ros2=for_ros2).get(type_name)
        if cls is None:
            point = INSTALLED.find(type_name)
            if point is None:
                raise UnknownType(type_name, self.types())
            with self._all_or_nothing():
                module = user_classes.import_named(self.code, point.module)
                cls = self._own[type_name] = user_classes.chosen_class(module, point.attr)
        return cls

    def create(self, type_name: str, *, for_ros2: bool = False) -> ControllerBase:
        """A fresh controller of that type. Arguments and errors as of `find`."""
        return user_classes.made(self.find(type_name, for_ros2=for_ros2), self.code)

    def add_file(self, file: str, class_name: str) -> str:
        """Import the file again and register its controllers. Returns the type of the class of that name, `STEM/CLASS`.

        An empty name means the only controller in it. All or nothing. Raises as `user_classes.run_file` and
        `user_classes.chosen_class`.
        """
        with self._all_or_nothing():
            module = user_classes.run_file(self.code, file)
            cls = user_classes.chosen_class(module, class_name)
            self._register_all(module)
        return _type_in(module, cls.__name__)

    def add_module(self, name: str) -> list[str]:
        """Import a module, or a file that ends with `.py`, and register its controllers and hardware.

        Returns their types. All or nothing. Raises as `user_classes.import_named`, and BadFile: it has none of either,
        or a broken controller.
        """
        was_registered = name in self._registered
        with self._all_or_nothing() as before:
            module = user_classes.import_named(self.code, name)
            for class_name, cls in user_classes.classes_of(module).items():
                user_classes.check_class(cls, class_name, module.__file__)
            self._register_all(module)
        added = [type_name for type_name, cls in self._known().items() if before.get(type_name) is not cls]
        added += self.hardware.add_all(module, _type_in(module, ""))
        if not added and not was_registered:
            raise BadFile("it defines no controller and no hardware", module.__file__ or name)
        self._registered.add(name)
        return added

    def renewed(self, cls: ControllerClass) -> ControllerClass:
        """Import the class's edited file again. All types of the class then mean the new class, which is returned.

        Raises:
            Refused: the class is not a user's, or not from a file. Else as `add_file`. The types are then unchanged.
        """
        if not user_classes.is_of_a_user(cls):
            raise Refused("it is a controller of slidectl itself; only those of users are reloaded")
        self.code.activate()
        file = user_classes.file_of(cls)
        if file is None:
            raise Refused(f"{cls.__name__} was not read from a file")
        with self._all_or_nothing():
            module = user_classes.run_file(self.code, file, cls.__module__)
            new = user_classes.chosen_class(module, cls.__name__)
            self._register_all(module)
        self.restore(new)
        return new

    def restore(self, cls: ControllerClass) -> None:
        """Register this class under all types of a class with the same module and name."""
        for type_name, registered in self._known().items():
            if (registered.__module__, registered.__name__) == (cls.__module__, cls.__name__):
                self._own[type_name] = cls

    def _known(self, *, for_ros2: bool = False) -> dict[str, ControllerClass]:
        """The registered classes by type. A user's class hides a shipped one."""
        _import_shipped()
        users = {name: cls for name, cls in _shared.items() if user_classes.is_of_a_user(cls)}
        shipped = {**_shared, **_of_ros2} if for_ros2 else {**_of_ros2, **_shared}
        return {**shipped, **users, **self._own}

    def _register_all(self, module: ModuleType) -> None:
        for class_name, cls in user_classes.classes_of(module).items():
            self._own[_type_in(module, class_name)] = cls

    @contextmanager
    def _all_or_nothing(self) -> Iterator[dict[str, ControllerClass]]:
        """Context in which a module is imported and registered. An exception restores the types. Yields all before."""
        before, own = self._known(), dict(self._own)
        _importing.append(self._own)
        try:
            yield before
        except BaseException:
            self._own.clear()
            self._own.update(own)
            raise
        finally:
            _importing.pop()


common = ControllerTypes(user_modules.active)
"""The types of a process without a world, such as `slidectl check`."""


def compiled_forms() -> dict[ControllerClass, Compiled]:
    """The shipped classes with a compiled form of their own. The order is by name, the same in any process."""
    return {cls: form for cls in _import_shipped() if (form := vars(cls).get("compiled")) is not None}


def _type_in(module: ModuleType, class_name: str) -> str:
    name = module.__name__
    return f"{Path(name).stem if name.endswith('.py') else name.rpartition('.')[2]}/{class_name}"


@cache
def _import_shipped() -> tuple[ControllerClass, ...]:
    """Register the shipped controllers. Returns their classes and base classes."""
    package = import_module("slidectl.control.controllers")
    for module in iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")
    classes = {
        cls
        for each in (*_shared.values(), *_of_ros2.values())
        for cls in each.__mro__
        if issubclass(cls, ControllerBase)
    }
    return tuple(sorted(classes, key=lambda cls: f"{cls.__module__}.{cls.__qualname__}"))
