"""Controller classes that users write: imported from a file or a module, and checked before an instance is made.

Errors name the user's file and line. This module registers nothing. Users' code runs within the context manager
`limit`, so that it cannot block the process; a process with waiting clients sets it.
"""

from __future__ import annotations

import os
import reprlib
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib import import_module
from math import isfinite
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from slidectl import file_reads
from slidectl.control import user_modules
from slidectl.control.controller_interface import Controller, ControllerBase, MultiInterfaceController
from slidectl.control.hardware_interface import JointHandle
from slidectl.errors import BadFile, Refused, SlidectlError, UnknownName, UsageError, listing

ControllerClass = type[ControllerBase]

PACKAGE = str(Path(__file__).parent.parent) + os.sep
_STANDARD_LIBRARY = os.path.dirname(os.__file__) + os.sep
_HOOKS: dict[str, tuple[str, ...]] = {
    "update": ("time_ns", "period_s"),
    "starting": ("time_ns",),
    "stopping": ("time_ns",),
    "waiting": ("time_ns",),
    "aborting": ("time_ns",),
    "init": ("interface", "node"),
    "init_in_root": ("interface", "root", "node"),
    "__init__": (),
}
"""The arguments of each hook, besides `self`."""
_RAISES_INTERRUPT = signal.default_int_handler


class CodeTimeout(BaseException):
    """`limit` ended users' code. Not an Exception, so that `except Exception` in that code does not catch it."""


limit: AbstractContextManager[None] = nullcontext()
"""Context manager that raises CodeTimeout in users' code. The daemon sets it, since its clients wait meanwhile."""


def is_of_a_user(cls: type) -> bool:
    """False for the classes of slidectl itself."""
    return not cls.__module__.startswith("slidectl.")


def is_fault(failure: BaseException) -> bool:
    """True for a fault of users' code, also for `sys.exit()` in it. False for Ctrl-C when it ends the process."""
    return not isinstance(failure, KeyboardInterrupt) or signal.getsignal(signal.SIGINT) is not _RAISES_INTERRUPT


class WrittenCommands:
    """The commands that a user's controller writes. They must be finite floats; the hardware does not check them."""

    def __init__(self, commands: Sequence[tuple[JointHandle, str]], file: str | None) -> None:
        """`commands`: each a handle and the name of an attribute that is a command. `file`: the file of the class."""
        self._commands = commands
        self._file = file
        self._kept = [0.0] * len(commands)

    def keep(self) -> None:
        """Save the commands before the controller writes new ones."""
        for place, (handle, attribute) in enumerate(self._commands):
            command = getattr(handle, attribute)
            if type(command) is float and isfinite(command):
                self._kept[place] = command

    def repair(self) -> str:
        """Replace each command that is not a finite number by the saved one. Returns the error text; empty: no error.

        Infinity is allowed when a limit of the joint clips it.
        """
        wrong = ""
        for place, (handle, attribute) in enumerate(self._commands):
            command = getattr(handle, attribute)
            try:
                if isfinite(min(max(command, handle.lowest), handle.highest) if attribute == "command" else command):
                    if type(command) is not float:  # a numpy scalar or an int
                        setattr(handle, attribute, float(command))
                    continue
            except Exception:  # the command may be of any class
                pass
            setattr(handle, attribute, self._kept[place])
            what = f"the {attribute.replace('_', ' ')} of joint {handle.name!r}"
            wrong = f"it set {what} to {reprlib.repr(command)}, which is no finite number ({self._file})"
        return wrong


class HookGuard(AbstractContextManager[None]):
    """Context of a hook of a user's class; may be entered in each cycle. What the hook raises becomes an Exception.

    With `commands`, it also raises Refused when one of them is not a finite number afterwards.
    """

    def __init__(self, commands: WrittenCommands | None = None) -> None:
        self.commands = commands

    def __enter__(self) -> None:
        if self.commands is not None:
            self.commands.keep()
        limit.__enter__()

    def __exit__(self, kind: type[BaseException] | None, failure: BaseException | None, *trace: Any) -> None:
        limit.__exit__(kind, failure, *trace)
        wrong = "" if self.commands is None else self.commands.repair()
        if failure is None and wrong:
            raise Refused(wrong)
        if failure is None or isinstance(failure, Exception):
            return
        if isinstance(failure, CodeTimeout):
            raise _too_long(failure) from None
        if is_fault(failure):
            raise Refused(raised(failure)) from None


def watched(cls: ControllerClass, commands: WrittenCommands | None = None) -> AbstractContextManager[None]:
    """The context for the hooks of the class: a HookGuard if the class is a user's."""
    return HookGuard(commands) if is_of_a_user(cls) else nullcontext()


@contextmanager
def watched_for(what: str, name: str) -> Iterator[None]:
    """Context for users' code. Raises Refused, with `what`, `name`, file and line, when the code fails."""
    try:
        with limit:
            yield
    except SlidectlError:
        raise
    except CodeTimeout as failure:
        raise _too_long(failure) from None
    except BaseException as failure:
        if not is_fault(failure):
            raise
        raise Refused(f"{what} {name}: {raised(failure)}") from failure


def watched_hardware(hardware: object) -> AbstractContextManager[None]:
    """The context for hooks of a robot's hardware except `read` and `write`: `watched_for` if the class is a user's."""
    cls = type(hardware)
    return watched_for("hardware", cls.__name__) if is_of_a_user(cls) else nullcontext()


def raised(failure: BaseException) -> str:
    """The exception of users' code as one line: class, text, file and line."""
    place = place_of(failure)
    return f"{type(failure).__name__}: {failure}{f' ({place[0]}:{place[1]})' if place else ''}".replace("\n", " ")


def _too_long(failure: CodeTimeout) -> Refused:
    place = place_of(failure)
    return Refused(f"{failure}{f' ({place[0]}:{place[1]})' if place else ''}", "look for a loop without an end there")


def place_of(failure: BaseException) -> tuple[str, int] | None:
    """File and line of the innermost frame of users' code, else of the innermost frame; None: unknown."""
    frames = [(frame.filename, frame.lineno or 0) for frame in traceback.extract_tb(failure.__traceback__)]
    outside = [frame for frame in frames if not _is_library(frame[0])]
    return next(reversed(outside or frames), None)


def _is_library(file: str) -> bool:
    return file.startswith((PACKAGE, "<")) or (file.startswith(_STANDARD_LIBRARY) and "site-packages" not in file)


# -- files and modules -------------------------------------------------------------------------------------------------


def run_file(file: str, name: str = "") -> ModuleType:
    """Import the file anew and return its module. Its code can import modules of its folder.

    Without `name`, the module's name is the path, since two files may have the same stem. The bytes are compiled here,
    not by Python's importer: its cache compares size and whole seconds, and a file may be edited twice in a second.

    Raises:
        BadFile: there is no such file, or its code fails (file, line). Refused: it took too long.
    """
    path = Path(file)
    source, why = file_reads.read(f"code of {file}", lambda: _source(path))
    if why:
        raise BadFile(why, file)
    try:
        code = compile(source.encode("utf-8", "surrogateescape"), file, "exec", dont_inherit=True)
    except SyntaxError as error:
        text = f": {error.text.strip()}" if error.text else ""
        raise BadFile(f"{error.msg}{text}", file, error.lineno) from None
    except ValueError as error:
        raise BadFile(f"cannot be read: {error}", file) from None
    name = name or file
    module = ModuleType(name)
    module.__file__ = file
    before = sys.modules.get(name)
    module.__package__ = getattr(before, "__package__", None)  # for its relative imports
    sys.modules[name] = module  # dataclasses look up the module of their class
    sys.path.insert(0, str(path.parent))
    user_modules.watch(name, is_file=True)
    try:
        with _importing(file), limit:
            exec(code, vars(module))
    except BaseException:
        del sys.modules[name]
        if before is not None:
            sys.modules[name] = before
        raise
    finally:
        if str(path.parent) in sys.path:
            sys.path.remove(str(path.parent))
    return module


def _source(path: Path) -> tuple[str, str]:
    """(the text of a file, with bytes that are not UTF-8 as surrogates; the error, empty if there is none)."""
    try:
        return path.read_bytes().decode("utf-8", "surrogateescape"), ""
    except FileNotFoundError:
        return "", "no such file"
    except (OSError, ValueError) as error:
        return "", f"cannot be read: {getattr(error, 'strerror', None) or error}"


def import_named(name: str) -> ModuleType:
    """The module of that dotted name, or `run_file` of a name that ends with `.py`.

    Raises:
        BadFile: it cannot be found, or its code fails. Refused: it took too long.
    """
    if name.endswith(".py"):
        return run_file(name)
    user_modules.watch(name, is_file=False)
    with _importing(name), limit:
        return import_module(name)


@contextmanager
def _importing(what: str) -> Iterator[None]:
    """Turn exceptions of an import of users' code, SystemExit too, into errors with file and line."""
    try:
        yield
    except CodeTimeout as failure:
        raise _too_long(failure) from None
    except BaseException as failure:
        if not is_fault(failure):
            raise
        file, line = place_of(failure) or (what, 0)
        if isinstance(failure, SyntaxError) and failure.filename:
            file, line = failure.filename, failure.lineno or 0
        elif isinstance(failure, ModuleNotFoundError) and failure.name == what:
            raise BadFile(f"no module {what!r} is installed, nor is there a file {what}.py here") from None
        raise BadFile(f"{type(failure).__name__}: {failure}", file, line or None) from None


# -- classes -----------------------------------------------------------------------------------------------------------


def classes_of(module: ModuleType) -> dict[str, ControllerClass]:
    """The controllers that a module defines, by name, except names that begin with `_` and classes without `update`."""
    return {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, ControllerBase)
        and value.__module__ == module.__name__
        and value.update is not ControllerBase.update
        and not name.startswith("_")
    }


def chosen_class(module: ModuleType, class_name: str) -> ControllerClass:
    """The class of that name. An empty name means the only controller of the module.

    Raises:
        UnknownName: there is no such class. UsageError: the name is empty and the module does not have exactly one
        controller. BadFile: it is not a controller.
    """
    file = str(module.__file__)
    known = classes_of(module)
    if not class_name:
        if len(known) != 1:
            hint = f"say which: {file}:{next(iter(known))}" if known else "a controller is a class with an `update`"
            raise UsageError(f"{file} has {len(known)} controllers: {listing(known)}", hint)
        return next(iter(known.values()))
    found = vars(module).get(class_name)
    if found is None:
        raise UnknownName("controller class", class_name, list(known), f"in {file}")
    check_class(found, class_name, file)
    cls: ControllerClass = found
    return cls


def check_class(cls: object, name: str, file: str | None = None) -> None:
    """Raise BadFile when it is not a controller, or when a hook does not accept the arguments of `_HOOKS`."""
    import inspect

    if not isinstance(cls, type) or not issubclass(cls, ControllerBase):
        line = _line(cls) if isinstance(cls, type | FunctionType) else None
        hint = f"class {name}(slidectl.control.Controller): ..."
        raise BadFile(f"{name} is no controller: it is not derived from slidectl.control.Controller", file, line, hint)
    if cls.update is ControllerBase.update:
        raise BadFile(f"{name} has no update", file, _line(cls), "def update(self, time_ns, period_s): ...")
    if issubclass(cls, Controller) and not hasattr(cls, "interface_type"):
        hint = "interface_type = slidectl.control.EffortJointInterface, say"
        raise BadFile(f"{name} does not say on which interface it is", file, _line(cls), hint)
    for hook, wanted in _HOOKS.items():
        function = inspect.getattr_static(cls, hook, None)
        if not isinstance(function, FunctionType) or function.__code__.co_filename.startswith(PACKAGE):
            continue
        if hook == "init" and issubclass(cls, MultiInterfaceController):
            wanted = ("hw", "node")
        try:
            inspect.signature(function).bind("self", *wanted)
        except TypeError:
            written = f"def {hook}({', '.join(('self', *wanted))})"
            line = function.__code__.co_firstlineno
            has = inspect.signature(function).replace(return_annotation=inspect.Signature.empty)
            taken = str(has.replace(parameters=[p.replace(annotation=p.empty) for p in has.parameters.values()]))
            text = f"{name}.{hook} has a wrong signature: {taken} takes no call with {', '.join(wanted) or 'nothing'}"
            raise BadFile(text, function.__code__.co_filename, line, f"{written}: ...") from None


def made(cls: ControllerClass) -> ControllerBase:
    """A new instance. Raises BadFile when its `__init__` does not call that of the base."""
    with watched(cls):
        controller = cls()
    if not hasattr(controller, "state"):
        raise BadFile(f"{cls.__name__}.__init__ does not call super().__init__()", file_of(cls), _line(cls))
    return controller


def file_of(cls: type) -> str | None:
    """The file of the class's module; None when it has none."""
    return getattr(sys.modules.get(cls.__module__), "__file__", None)


def _line(written: type | FunctionType) -> int | None:
    """The line where a class or a function begins; None when its source is not available."""
    import inspect
    import linecache

    linecache.checkcache()  # the file may have been edited
    try:
        return inspect.getsourcelines(written)[1]
    except (OSError, TypeError):
        return None
