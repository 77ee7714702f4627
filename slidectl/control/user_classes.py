"""Controller classes that users write: imported from a file or a module, and checked before an instance is made.

Errors name the user's file and line. This module registers nothing. Users' code runs within the limit of its world, so
that it cannot block a process with waiting clients.
"""

from __future__ import annotations

import os
import reprlib
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib import import_module
from math import inf, isfinite
from pathlib import Path
from traceback import walk_tb
from types import FunctionType, ModuleType
from typing import Any

from slidectl.control import user_modules
from slidectl.control.controller_interface import Controller, ControllerBase, MultiInterfaceController
from slidectl.control.hardware_interface import JointHandle, JointStateHandle
from slidectl.control.node_handle import NodeHandle
from slidectl.control.user_modules import UserCode
from slidectl.errors import BadFile, NotThere, Refused, SlidectlError, UnknownName, UsageError, listing
from slidectl.input_files import MOST_TEXT, read_bytes

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
    """The limit ended users' code. Not an Exception, so that `except Exception` in that code does not catch it."""


def is_of_a_user(cls: type) -> bool:
    """False for the classes of slidectl itself."""
    return not cls.__module__.startswith("slidectl.")


def is_fault(failure: BaseException) -> bool:
    """True for a fault of users' code, also for `sys.exit()` in it. False for Ctrl-C when it ends the process."""
    return not issubclass(type(failure), KeyboardInterrupt) or signal.getsignal(signal.SIGINT) is not _RAISES_INTERRUPT


class WatchedHandles:
    """The joint handles that a user's controller has got. Other code relies on floats in them, and on finite commands,
    which the hardware does not check. A state that is not finite may come from the hardware alone."""

    def __init__(
        self, handles: Sequence[JointStateHandle], commands: Sequence[tuple[JointHandle, str]], file: str | None
    ) -> None:
        """`commands`: each a handle and the name of an attribute that is a command. `file`: the file of the class."""
        states = [(handle, name) for handle in handles for name in ("position", "velocity", "effort")]
        self._attributes: list[tuple[JointStateHandle, str]] = [*states, *commands]
        self._file = file
        self._kept: list[float] = []

    def keep(self) -> None:
        """Save all values before the controller writes new ones."""
        self._kept = [getattr(handle, name) for handle, name in self._attributes]

    def repair(self) -> str:
        """Convert new numbers to float, and replace what is not a finite number by what was saved.

        Returns the error text, empty for none. Infinity is allowed when a limit of the joint clips it. Call it inside
        the limit: a value may be an object with code of the user's.
        """
        wrong = ""
        for position, (handle, name) in enumerate(self._attributes):
            value: Any = getattr(handle, name, None)
            if value is self._kept[position] or (type(value) is float and isfinite(value)):
                continue
            lowest, highest = -inf, inf
            if name == "command" and isinstance(handle, JointHandle):
                lowest, highest = handle.lowest, handle.highest
            try:
                is_number = isfinite(min(max(value, lowest), highest))
                if is_number:
                    setattr(handle, name, float(value))
            except BaseException as failure:  # a value may be of any class
                if not is_fault(failure):
                    raise
                is_number = False
            if not is_number:
                setattr(handle, name, self._kept[position])
                what = f"the {name.replace('_', ' ')} of joint {handle.name!r}"
                wrong = f"it set {what} to {_shown(value)}, which is not a finite number ({self._file})"
        return wrong


class HookGuard(AbstractContextManager[None]):
    """Context of a hook of a user's class; may be entered in each cycle. What the hook raises becomes an Exception.

    With `handles`, it also raises Refused when one of them has a wrong value afterwards. Code that the limit has ended
    is not entered again.
    """

    def __init__(self, cls: type, code: UserCode, handles: WatchedHandles | None = None) -> None:
        self._cls = cls
        self._code = code
        self.handles = handles

    def __enter__(self) -> None:
        code = self._code
        if user_modules.active is not code:  # another world of this process has run meanwhile
            code.activate()
        if self._cls in code.cut_off:
            raise Refused(
                f"{self._cls.__name__} is not called any more, because {code.cut_off[self._cls]}",
                "correct it, then: slidectl controller reload NAME, or controller load NAME --from FILE",
            )
        if self.handles is not None:
            self.handles.keep()
        code.limit.__enter__()

    def __exit__(self, kind: type[BaseException] | None, failure: BaseException | None, *trace: Any) -> None:
        wrong = ""
        try:
            if self.handles is not None:
                wrong = self.handles.repair()
        finally:
            self._code.limit.__exit__(kind, failure, *trace)
        if failure is None:
            if wrong:
                raise Refused(wrong)
            return
        if issubclass(type(failure), CodeTimeout):
            refusal = _too_long(failure)
            self._code.cut_off[self._cls] = refusal.message
            raise refusal from None
        if not issubclass(type(failure), Exception) or _is_users_own(failure):
            _raise_refused(failure)


def _is_users_own(failure: BaseException) -> bool:
    """True for a SlidectlError of a user's class: its text may be anything."""
    if not issubclass(type(failure), SlidectlError):
        return False
    module = type.__dict__["__module__"].__get__(type(failure))  # a metaclass cannot hide it
    return type(module) is not str or not module.startswith("slidectl.")


def _raise_refused(failure: BaseException) -> None:
    """Raise Refused for a fault of users' code. Return when it is a Ctrl-C that ends the process."""
    if is_fault(failure):
        raise Refused(raised(failure)) from None


class CallbackGuard(HookGuard):
    """Context of a callback of a user's class: message, service call, goal or tick. Exceptions become Refused."""

    def __init__(self, cls: type, code: UserCode, node: NodeHandle) -> None:
        super().__init__(cls, code)
        self._node = node

    def __exit__(self, kind: type[BaseException] | None, failure: BaseException | None, *trace: Any) -> None:
        try:
            super().__exit__(kind, failure, *trace)
            if failure is not None and not issubclass(type(failure), SlidectlError):
                _raise_refused(failure)
        except Refused as refusal:  # the sender of a message gets no answer, so log it
            self._node.log("error", f"{self._node.namespace}: {described(refusal)}")
            raise


def watched(
    cls: ControllerClass, code: UserCode, handles: WatchedHandles | None = None
) -> AbstractContextManager[None]:
    """The context for the hooks of the class: a HookGuard if the class is a user's."""
    return HookGuard(cls, code, handles) if is_of_a_user(cls) else nullcontext()


@contextmanager
def watched_for(what: str, name: str, code: UserCode) -> Iterator[None]:
    """Context for users' code. Raises Refused, with `what`, `name`, file and line, when the code fails."""
    code.activate()
    try:
        with code.limit:
            yield
    except CodeTimeout as failure:
        raise _too_long(failure) from None
    except BaseException as failure:
        is_ours = issubclass(type(failure), SlidectlError) and not _is_users_own(failure)
        if is_ours or not is_fault(failure):
            raise
        raise Refused(f"{what} {name}: {raised(failure)}") from failure


def watched_hardware(hardware: object, code: UserCode) -> AbstractContextManager[None]:
    """The context for hooks of a robot's hardware except `read` and `write`: `watched_for` if the class is a user's."""
    cls = type(hardware)
    return watched_for("hardware", cls.__name__, code) if is_of_a_user(cls) else nullcontext()


def raised(failure: BaseException) -> str:
    """The exception of users' code as one line: class, text, file and line.

    Its class may be the user's too, so what its `__str__` and attributes do is not relied upon.
    """
    return f"{_type_name(failure)}: {_text_of(failure)}{_at(failure)}".replace("\n", " ")


def described(failure: Exception) -> str:
    """An error as one line: a SlidectlError as its text, others with their class, file and line."""
    if not issubclass(type(failure), SlidectlError):
        return raised(failure)
    text = _text_of(failure) if _is_users_own(failure) else str(failure)
    return "; ".join(line.rstrip(".") for line in text.splitlines())


def _text_of(failure: BaseException) -> str:
    """The text of an exception, also of one whose `__str__` fails or does not end."""
    try:
        with user_modules.active.limit:
            text = str(failure)
    except BaseException as another:
        if not is_fault(another):
            raise
        return f"(no text: its __str__ raised {_type_name(another)})"
    return str.__str__(text)  # an instance of a user's class of strings becomes a plain one


def _shown(value: object) -> str:
    """A value as text; its class when its `__repr__` fails."""
    try:
        with user_modules.active.limit:
            return str.__str__(reprlib.repr(value))
    except BaseException as failure:
        if not is_fault(failure):
            raise
        return f"an object of class {_type_name(value)}"


def _type_name(value: object) -> str:
    """The name of an object's class, which a metaclass cannot hide."""
    name: str = type.__dict__["__name__"].__get__(type(value))
    return name


def _too_long(failure: BaseException) -> Refused:
    return Refused(f"{_text_of(failure)}{_at(failure)}", "look for a loop without an end there")


def _at(failure: BaseException) -> str:
    place = place_of(failure)
    return f" ({place[0]}:{place[1]})" if place else ""


def place_of(failure: BaseException) -> tuple[str, int] | None:
    """File and line of the innermost frame of users' code, else of the innermost frame; None: unknown."""
    trace = BaseException.__dict__["__traceback__"].__get__(failure)  # a user's class cannot hide it
    frames = [(frame.f_code.co_filename, line or 0) for frame, line in walk_tb(trace)]
    outside = [place for place in frames if not _is_library(place[0])]
    return next(reversed(outside or frames), None)


def _is_library(file: str) -> bool:
    return file.startswith((PACKAGE, "<")) or (file.startswith(_STANDARD_LIBRARY) and "site-packages" not in file)


# -- files and modules -------------------------------------------------------------------------------------------------


def run_file(users: UserCode, file: str, name: str = "") -> ModuleType:
    """Import the file again for a world, and return its module. Its code can import modules of its folder.

    Without `name`, the module's name is the path, since two files may have the same stem. The bytes are compiled here,
    not by Python's importer: its cache compares size and whole seconds, and a file may be edited twice in a second.

    Raises:
        BadFile: there is no such file, or its code fails (file, line). Refused: it took too long.
    """
    path = Path(file)
    source, why = users.host.read(f"code of {file}", lambda: _source(path))
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
    users.activate()
    module = ModuleType(name)
    module.__file__ = file
    before = sys.modules.get(name)
    module.__package__ = getattr(before, "__package__", None)  # for its relative imports
    sys.modules[name] = module  # dataclasses look up the module of their class
    sys.path.insert(0, str(path.parent))
    users.watch(name, is_file=True)
    try:
        with _importing(file), users.limit:
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
        return read_bytes(path, MOST_TEXT).decode("utf-8", "surrogateescape"), ""
    except NotThere:
        return "", "no such file"
    except BadFile as error:
        return "", f"cannot be read: {error.reason}"


def import_named(users: UserCode, name: str) -> ModuleType:
    """The module of that dotted name for a world, or `run_file` of a name that ends with `.py`.

    Raises:
        BadFile: it cannot be found, or its code fails. Refused: it took too long.
    """
    if name.endswith(".py"):
        return run_file(users, name)
    users.activate()
    users.watch(name, is_file=False)
    with _importing(name), users.limit:
        return import_module(name)


@contextmanager
def _importing(what: str) -> Iterator[None]:
    """Turn whatever an import of users' code raises into errors with file and line."""
    try:
        yield
    except CodeTimeout as failure:
        raise _too_long(failure) from None
    except SyntaxError as failure:
        file, line = place_of(failure) or (what, 0)
        if failure.filename:
            file, line = failure.filename, failure.lineno or 0
        raise BadFile(f"{_type_name(failure)}: {_text_of(failure)}", file, line or None) from None
    except BaseException as failure:
        if not is_fault(failure):
            raise
        if issubclass(type(failure), ModuleNotFoundError) and getattr(failure, "name", "") == what:
            raise BadFile(f"no module {what!r} is installed, nor is there a file {what}.py here") from None
        file, line = place_of(failure) or (what, 0)
        raise BadFile(f"{_type_name(failure)}: {_text_of(failure)}", file, line or None) from None


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
            hint = f"name one: {file}:{next(iter(known))}" if known else "a controller is a class with an `update`"
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
        raise BadFile(
            f"{name} is not a controller: it is not derived from slidectl.control.Controller", file, line, hint
        )
    if cls.update is ControllerBase.update:
        raise BadFile(f"{name} has no update", file, _line(cls), "def update(self, time_ns, period_s): ...")
    if issubclass(cls, Controller) and not hasattr(cls, "interface_type"):
        hint = "for example: interface_type = slidectl.control.EffortJointInterface"
        raise BadFile(f"{name} has no interface_type", file, _line(cls), hint)
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
            has = ", ".join(inspect.signature(function).parameters)
            text = (
                f"{name}.{hook} has a wrong signature: ({has}), but it is called with {', '.join(wanted) or 'nothing'}"
            )
            raise BadFile(text, function.__code__.co_filename, line, f"{written}: ...") from None


def made(cls: ControllerClass, code: UserCode) -> ControllerBase:
    """A new instance. Raises BadFile when its `__init__` does not call that of the base."""
    with watched(cls, code):
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
