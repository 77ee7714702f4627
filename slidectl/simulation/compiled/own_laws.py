"""The code of laws: that of our forms is part of the cycle's file; a user's law is compiled when a robot needs it.

A user's law is compiled in a process of its own, from its bytecode, that of the functions that it calls, and the
constants. So it may come from any file, module or script, and is compiled again when one of these changes. The
interpreter runs its controller until then, and always when the law cannot be compiled.
"""

from __future__ import annotations

import dis
import marshal
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import IO, Any, NamedTuple

from slidectl.control.controller_interface import Compiled
from slidectl.control.registry import compiled_forms
from slidectl.errors import Refused
from slidectl.simulation.compiled import guard, object_file

MARSHAL_VERSION = 2
"""The version without references: these depend on other objects of the process, and one law must give one text."""
_OURS = "slidectl."


class LawCode:
    """The addresses of the code of all forms."""

    def __init__(self, ours: list[int], warn: Callable[[str], None]) -> None:
        """`ours` are the addresses for our forms, in their order; `warn` logs why a law cannot be compiled."""
        self._addresses = dict(zip(compiled_forms().values(), ours, strict=True))
        self._warn = warn
        self._engines: list[Any] = []
        """The owners of the memory of the code."""
        self.compiling: list[Compilation] = []
        self.changes = 0
        """Counts the laws whose code was loaded."""

    def address(self, form: Compiled) -> int:
        """The address of the code of the form's law; 0: there is none, or not yet."""
        found = self._addresses.get(form)
        if found is None:
            found = self._addresses[form] = 0
            try:
                content = describe(form)
                place = object_file.law_place(content)
                if place.exists():
                    return self._load(form, place)
                self.compiling.append(_begin(form, content, place))
            except (Refused, OSError, RuntimeError) as trouble:
                self._give_up(form, trouble)
        return found

    def load_finished(self, wait: bool = False) -> None:
        """Load the code of laws whose compilation has ended."""
        for one in [one for one in self.compiling if wait or one.process.poll() is not None]:
            self.compiling.remove(one)
            try:
                if one.process.wait() != 0:
                    one.report.seek(0)
                    raise Refused(one.report.read().strip() or "the compiler was ended")
                self._load(one.form, one.place)
                self.changes += 1
            except (Refused, OSError, RuntimeError) as trouble:
                self._give_up(one.form, trouble)

    def _load(self, form: Compiled, place: Path) -> int:
        engine, (address,) = object_file.loaded(place, [guard.law(0)])
        self._engines.append(engine)
        self._addresses[form] = address
        return address

    def _give_up(self, form: Compiled, trouble: Exception) -> None:
        reason = "; ".join(str(trouble).splitlines())
        self._warn(f"controllers with the law {form.update.__qualname__} run in the interpreter: {reason}")


class Compilation(NamedTuple):
    """The process that compiles a law, the file of its errors, and the path of the result."""

    form: Compiled
    process: subprocess.Popen[bytes]
    report: IO[str]
    place: Path


def _begin(form: Compiled, content: bytes, place: Path) -> Compilation:
    object_file.prepare()
    report = tempfile.TemporaryFile("w+")  # noqa: SIM115 - read when the process has ended
    with tempfile.TemporaryFile() as source:
        source.write(content)
        source.seek(0)
        return Compilation(form, object_file.start_compiler(place.name, source=source, report=report), report, place)


# The description of a law: written in this process, read in the compiler's.


def describe(form: Compiled) -> bytes:
    """The columns of the form, and the functions of its law. Raises Refused: something in it cannot be compiled."""
    functions: dict[str, Any] = {}
    law = _describe_function(form.update, functions)
    columns = [(list(one.names), one.kinds) for one in (form.row, form.members)]
    return marshal.dumps((columns, law, functions), MARSHAL_VERSION)


def _describe_function(function: Any, functions: dict[str, Any]) -> str:
    name = f"{function.__module__}.{function.__qualname__}"
    if name in functions:
        return name
    if function.__closure__:
        raise Refused(f"{function.__qualname__} uses variables of the function around it", "use those of the module")
    code: CodeType = function.__code__
    functions[name] = None  # a function may call itself
    used = {one.argval for one in dis.get_instructions(code) if one.opname == "LOAD_GLOBAL"}
    space = {key: _describe_value(key, function, functions) for key in sorted(used) if key in function.__globals__}
    functions[name] = (marshal.dumps(code, MARSHAL_VERSION), list(function.__defaults__ or ()), space)
    return name


def _describe_value(key: str, function: Any, functions: dict[str, Any]) -> tuple[str, Any]:
    value = function.__globals__[key]
    if isinstance(value, FunctionType):
        is_ours = value.__module__.startswith(_OURS)
        if is_ours:
            return "ours", (value.__module__, value.__qualname__)
        return "function", _describe_function(value, functions)
    if isinstance(value, ModuleType):
        return "module", value.__name__
    if isinstance(value, bool | int | float):
        return "value", value if isinstance(value, bool) else float(value) if isinstance(value, float) else int(value)
    if isinstance(value, tuple) and all(type(item) in (bool, int, float) for item in value):
        return "value", value
    raise Refused(
        f"{function.__qualname__} uses {key!r}, a {type(value).__name__}",
        "a law uses numbers, tuples of numbers, functions of math, and other functions like it",
    )


def rebuild(content: bytes) -> tuple[list[tuple[list[str], str]], Callable[..., int], list[Callable[..., Any]]]:
    """The columns, the law, and all functions that are not ours, from a description."""
    from importlib import import_module

    columns, law, functions = marshal.loads(content)
    made = {
        name: FunctionType(marshal.loads(code), {}, name.rpartition(".")[2], tuple(defaults))
        for name, (code, defaults, _) in functions.items()
    }
    for name, (_, _, space) in functions.items():
        for key, (kind, value) in space.items():
            if kind == "ours":
                value = getattr(import_module(value[0]), value[1])
            elif kind == "function":
                value = made[value]
            elif kind == "module":
                value = import_module(value)
            made[name].__globals__[key] = value
    return columns, made[law], list(made.values())
