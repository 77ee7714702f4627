"""Runs xacro on a tree of elements: arguments, `$(find)` by our lookup, errors with file and line, warnings as notices.

xacro keeps its state in module variables, looks packages up through ament and hands expressions to Python; all of
these are lent for one run and given back. Expressions are computed by our own evaluator, which runs nobody's code, and
on the side of who owns the file, never in the daemon.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.dom import minidom

import xacro
from xacro import substitution_args

from slidectl.description import bounds, models, xacro_prefix, xacro_symbols, xml_tree
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, UnknownPackage, shown
from slidectl.description.robot import Notice
from slidectl.description.xacro_dom import LocatedElement, to_document, to_element
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, NotThere, SlidectlError, listing
from slidectl.expressions import FUNCTIONS, MATH

_NOWHERE = "/no-such-package/"
"""Stands for the folder of a package that is not there, so that the rest of the file is read, too."""


_REPLACED = ("eval_all", "check_attrs", "handle_macro_call", "process_include")


def expand(
    root: Element, path: Path | None, arguments: Mapping[str, str], packages: Packages, missing: Missing
) -> tuple[Element, list[Notice]]:
    """The expanded tree and xacro's warnings. `path` is the file, for relative includes; None for a text without one.

    Packages and included files that are not there are noted in `missing`, and left out, with the macros that they
    would have brought.

    Raises:
        BadFile: whatever xacro does not accept, with file and line; what is not there, where xacro needs it.
    """
    return _Run(root, path, arguments, packages, missing).expand()


class _Arguments(dict[str, str]):
    """xacro's arguments; remembers which names were asked for or declared."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.asked: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


class _Run:
    """One run. `here` is the node that xacro looks at, `calls` the macro calls that it is in."""

    def __init__(
        self, root: Element, path: Path | None, arguments: Mapping[str, str], packages: Packages, missing: Missing
    ) -> None:
        self.root = root
        self.missing = missing
        self.lacks_macros = False
        """Whether an include is left out, so that macros may be unknown for it."""
        self.path = path
        self.given = arguments
        self.arguments = _Arguments(arguments)
        self.packages = packages
        self.unknown: dict[str, NotThere] = {}
        """The packages that are not there."""
        self.bare_macros: set[str] = set()
        self.notices: list[Notice] = xacro_prefix.give(root, self.bare_macros)
        self.document = to_document(root)
        self.top: Any = self.document.documentElement
        self.here: Any = self.top
        self.calls: list[LocatedElement] = []
        self.steps = bounds.Steps()

    def expand(self) -> tuple[Element, list[Notice]]:
        try:
            with self.lent_xacro(), contextlib.redirect_stdout(sys.stderr), bounds.bounded_memory():
                xacro.init_stacks(str(self.path.absolute()) if self.path is not None else None)
                xacro.process_doc(self.document, mappings=self.arguments)
        except SlidectlError as error:
            self.missing.refuse()
            raise self.placed(error) from None
        except Exception as error:  # expressions of the file may raise anything at all
            self.missing.refuse()  # what xacro stumbles over is most often the lack of it
            raise self.explained(error) from error
        self.note_unused_arguments()
        return to_element(self.top), self.notices

    @contextlib.contextmanager
    def lent_xacro(self) -> Iterator[None]:
        """xacro with our functions in the place of its own, until the end of the block."""
        original_names = substitution_args._eval_dict.copy()
        replaced = [
            *((xacro, name, getattr(self, name)) for name in _REPLACED),
            (xacro, "parse", self.parse),
            (xacro, "warning", self.warning),
            (xacro, "print_location", lambda: None),
            (xacro, "safe_eval", _evaluated),
            (xacro, "_global_symbols", xacro_symbols.symbols(self.warning)),
            (substitution_args, "_eval_find", self.find),
        ]
        self.original = {name: getattr(module, name) for module, name, _ in replaced}
        try:
            for module, name, function in replaced:
                setattr(module, name, function)
            substitution_args.eval = _argument_evaluated  # in the place of Python's, which that module calls
            for name in vars(math):  # of which some never end
                substitution_args._eval_dict.pop(name, None)
            substitution_args._eval_dict.update(MATH, find=self.find)
            xacro.substitution_args_context["filename"] = str(self.path) if self.path is not None else None
            yield
        finally:
            for module, name, _ in replaced:
                setattr(module, name, self.original[name])
            vars(substitution_args).pop("eval", None)
            substitution_args._eval_dict.clear()
            substitution_args._eval_dict.update(original_names)
            xacro.substitution_args_context.clear()
            xacro.all_includes.clear()

    def eval_all(self, node: Any, macros: Any, symbols: Any) -> None:
        before = self.here
        self.here = node
        self.steps.take()
        self.original["eval_all"](node, macros, symbols)
        self.here = before

    def check_attrs(self, node: Any, required: list[str], optional: list[str]) -> Any:
        self.here = node
        return self.original["check_attrs"](node, required, optional)

    def handle_macro_call(self, node: Any, macros: Any, symbols: Any) -> Any:
        if node.tagName in self.bare_macros:
            node.tagName = node.nodeName = f"{xacro_prefix.PREFIX}{node.tagName}"
        if not node.tagName.startswith(xacro_prefix.PREFIX):
            return False
        before = self.here
        self.here = node
        if self.lacks_macros and self.is_unknown(node.tagName, macros, symbols):
            if self.missing.keeps_going:
                name = node.tagName.removeprefix(xacro_prefix.PREFIX)
                error = NotThere(f"no macro {name!r}", node.file, node.line, thing=f"macro {name}")
                self.missing.note(error, f"<{node.tagName}> is left out")
            xacro.replace_node(node, by=None)
            self.here = before
            return True
        self.calls.append(node)
        result = self.original["handle_macro_call"](node, macros, symbols)
        self.calls.pop()
        self.here = before
        return result

    def is_unknown(self, tag: str, macros: Any, symbols: Any) -> bool:
        """Whether a call means no macro that there is."""
        name = tag.removeprefix(xacro_prefix.PREFIX)
        try:
            if name != "call":
                xacro.resolve_macro(name, macros, symbols)
        except KeyError:
            return True
        return False

    def process_include(self, node: Any, macros: Any, symbols: Any, function: Any) -> None:
        """An include; one whose file is not there is noted and left out."""
        before, depth = self.here, len(xacro.filestack)
        try:
            self.original["process_include"](node, macros, symbols, function)
        except xacro.XacroException as error:
            file = error.exc.filename if isinstance(error.exc, FileNotFoundError) else None
            if file is None or self.here is not node:
                raise
            del xacro.filestack[depth:]
            loss = "what it includes is left out"
            if file.startswith(_NOWHERE):
                name = file.removeprefix(_NOWHERE).partition("/")[0]
                self.missing.note(self.unknown[name], loss)
            else:
                text = f"no such file or directory: {file}"
                self.missing.note(NotThere(text + self.called(), node.file, node.line, thing=text), loss)
            self.lacks_macros = True
            xacro.replace_node(node, by=None)
        self.here = before

    def parse(self, text: Any, filename: str) -> minidom.Document:
        """Reads an included file; a missing one is xacro's own exception, which optional includes catch."""
        assert text is None
        try:
            content = models.read_regular(Path(filename), xml_tree.MOST_BYTES)
        except OSError as error:
            xacro.filestack.pop()
            raise xacro.XacroException(f"{error.strerror}: {filename}", exc=error) from None
        root = xml_tree.read(content, shown(Path(filename)))
        self.notices += xacro_prefix.give(root, self.bare_macros)
        return to_document(root)

    def warning(self, *words: object, **_: object) -> None:
        text = " ".join(map(str, words)).replace("\n", " ")
        self.notices.append(Notice("wrong", "xacro", text, self.here.file, self.here.line))

    def find(self, package: str) -> str:
        try:
            return str(self.packages.find(package))
        except UnknownPackage as error:
            place = self.here.file, self.here.line
            self.unknown[package] = NotThere(error.message + self.called(), *place, error.hint, f"package {package}")
            self.missing.note(self.unknown[package])
            return f"{_NOWHERE}{package}"

    def note_unused_arguments(self) -> None:
        declared = listing(self.arguments.asked)
        for name in self.given:
            if name not in self.arguments.asked:
                text = f"the file has no such argument and it has no effect; arguments: {declared}"
                self.notices.append(Notice("ignored", f"{name}:=", text, self.root.file, None))

    def error(self, message: str, hint: str | None = None) -> BadFile:
        return BadFile(message + self.called(), self.here.file, self.here.line, hint)

    def explained(self, error: Exception) -> BadFile:
        """Why xacro stopped: what was raised first, and in which expressions."""
        expressions: list[str] = []
        cause: BaseException = error
        while isinstance(cause, xacro.XacroException) and isinstance(cause.exc, BaseException):
            expressions.extend([str(cause.suffix).strip()] if cause.suffix else [])
            cause = cause.exc
        if isinstance(cause, SlidectlError):
            return self.placed(cause)
        return self.error(", ".join([_clause(cause), *dict.fromkeys(expressions[::-1])]).replace("\n", " "))

    def called(self) -> str:
        """Where the innermost macro that fails was called."""
        outer = [call for call in self.calls if call is not self.here]
        if not outer:
            return ""
        call = outer[-1]
        return f" (in macro {call.tagName.removeprefix('xacro:')!r}, called at {call.file}:{call.line})"

    def placed(self, error: SlidectlError) -> BadFile:
        """An error of ours, at the place where xacro met it unless it has one of its own."""
        if isinstance(error, BadFile) and error.line is not None:
            return error
        return self.error(error.message, error.hint)


def _evaluated(expression: str, symbols: Mapping[str, Any], _locals: object = None) -> Any:
    """In the place of xacro's safe_eval, which lets Python compute."""
    return xacro_symbols.evaluate(expression, symbols)


def _argument_evaluated(expression: str, _globals: object, names: Any) -> Any:
    """A `$(eval ...)`. `names` gives arguments and functions, and behind them are Python's own functions."""
    return xacro_symbols.evaluate(expression, ChainMap(names, FUNCTIONS))


def _clause(error: BaseException) -> str:
    if isinstance(error, RecursionError):
        return "macros, includes or expressions call themselves without end"
    if isinstance(error, MemoryError):
        return f"it takes more than {bounds.MOST_MEMORY >> 30} GiB of memory"
    if isinstance(error, substitution_args.ArgException):
        return f"argument {error.args[0]!r} has no value; give {error.args[0]}:=VALUE"
    if isinstance(error, OSError):
        return f"{str(error.strerror).lower()}: {error.filename}"
    if isinstance(error, SyntaxError):
        return str(error.msg)
    if isinstance(error, KeyError):
        return f"unknown key {error}"
    return str(error).strip() or type(error).__name__
