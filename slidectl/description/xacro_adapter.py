"""Runs xacro on a tree of elements. Only this file touches the insides of the xacro package.

xacro 2.1 has no public way to report errors by line, to look packages up without ament, to compute expressions without
Python's `eval`, or to bound the work. So these names of its modules are replaced while a model is expanded:

* `eval_all`, `check_attrs`, `handle_macro_call`, `process_include` are wrapped: they record the element that xacro
  works on (for file and line of an error), count the steps, and leave out what does not exist;
* `parse` reads included files within bounds, into nodes that know their lines;
* `warning`, `error`, `message`, `print_location` print; here warnings become notices, and no terminal codes are sent;
* `safe_eval`, and `eval` in `substitution_args`, call Python's `eval`; here our evaluator does it, which is safe;
* `__builtins__`, `math`, `load_yaml` and `tokenize` are passed to expressions by `create_global_symbols`; ours are
  bounded;
* `_global_symbols`, `all_includes`, `substitution_args_context`, and `_eval_dict` and `_eval_find` of
  `substitution_args`, are the state of a run, which xacro keeps in modules: here each run has its own.

`resolve_macro`, `replace_node`, `init_stacks`, `filestack`, `XacroException`, `NameSpace`, the wrappers of YAML values
and `ConstructUnits` are used unchanged. pyproject.toml pins the versions for which this holds, and a test compares
xacro's functions with the versions that were reviewed.
"""

from __future__ import annotations

import builtins
import contextlib
import errno
import math
import os
import re
import sys
import time
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.dom import minidom

import xacro
from xacro import substitution_args

from slidectl import input_files
from slidectl.description import xml_tree
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, UnknownPackage, shown
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Comment, Element
from slidectl.errors import BadFile, NoFileThere, NotThere, Refused, SlidectlError, listing
from slidectl.expressions import FUNCTIONS, MATH, compute
from slidectl.operating_system import limit_new_memory, restore_memory_limit

MOST_MEMORY = 1 << 30
"""The most memory of a run on top of that of the process, bytes."""
MOST_STEPS = 30_000
"""The most elements that xacro works on; a humanoid takes about ten thousand."""
MOST_SECONDS = 30.0
"""The most time of a run, s of processor time, so that the limit does not depend on other load."""
MOST_YAML_VALUES = 50_000
_MOST_DIGITS = 400

_PREFIX = "xacro:"
_NOWHERE = "/no-such-package/"
"""Replaces the folder of a missing package, so that the rest of the file is still read."""
_WRAPPED = ("eval_all", "check_attrs", "handle_macro_call", "process_include")
_PLAIN = (bool, int, float, complex, str, bytes, list, tuple, dict, set, frozenset, type(None))
_DOTTED = (xacro.NameSpace, xacro.YamlDictWrapper)
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")

# The tags that xacro took without their prefix until ROS Kinetic, each with a mandatory attribute, which separates them
# from tags of other languages with the same names.
_BARE = {
    "macro": "name", "property": "name", "include": "filename", "if": "value", "unless": "value",
    "insert_block": "name",
}  # fmt: skip


def expand(
    root: Element, path: Path | None, arguments: Mapping[str, str], packages: Packages, missing: Missing
) -> tuple[Element, list[Notice]]:
    """Expand a tree. Returns the result and xacro's warnings. `path` is the file, for relative includes, or None.

    Missing packages and included files are noted in `missing` and left out, together with calls of macros that they may
    define.

    Raises:
        BadFile: an error of xacro, with file and line; also a missing thing that xacro cannot do without.
    """
    return _Run(root, path, arguments, packages, missing).expand()


class _Arguments(dict[str, str]):
    """The arguments for xacro; records which names were used or declared."""

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
    """One run. `here` is the node that xacro works on, `calls` the macro calls around it."""

    def __init__(
        self, root: Element, path: Path | None, arguments: Mapping[str, str], packages: Packages, missing: Missing
    ) -> None:
        self.root = root
        self.path = path
        self.given = arguments
        self.packages = packages
        self.missing = missing
        self.arguments = _Arguments(arguments)
        self.unknown: dict[str, NotThere] = {}
        """The packages that do not exist."""
        self.lacks_macros = False
        """True when an include was left out: unknown macros may have been defined there."""
        self.bare_macros: set[str] = set()
        self.notices: list[Notice] = []
        self.calls: list[_Node] = []
        self.steps = 0
        self.began_s = time.process_time()
        self.document = self.prefixed(root)
        self.top: Any = self.document.documentElement
        self.here: Any = self.top

    def expand(self) -> tuple[Element, list[Notice]]:
        try:
            with self.replaced_insides(), contextlib.redirect_stdout(sys.stderr), _bounded_memory():
                xacro.init_stacks(str(self.path.absolute()) if self.path is not None else None)
                xacro.process_doc(self.document, mappings=self.arguments)
        except Exception as error:  # expressions of the file may raise any exception
            self.missing.refuse()  # something missing is the most frequent reason
            raise self.explained(error) from (None if isinstance(error, SlidectlError) else error)
        declared = listing(self.arguments.asked)
        for name in self.given.keys() - self.arguments.asked:
            text = f"the file has no such argument and it has no effect; arguments: {declared}"
            self.notices.append(Notice("ignored", f"{name}:=", text, self.root.file, None))
        return _to_element(self.top), self.notices

    # --- replacements of xacro's own functions ------------------------------------------------------------------------

    @contextlib.contextmanager
    def replaced_insides(self) -> Iterator[None]:
        """Replace names in xacro's modules by ours until the end of the block."""
        self.original = {name: getattr(xacro, name) for name in _WRAPPED}
        own = (*_WRAPPED, "parse", "warning", "error", "message", "print_location", "safe_eval", "load_yaml")
        state = {
            "tokenize": _tokenize,
            "all_includes": [],
            "substitution_args_context": {"filename": str(self.path) if self.path is not None else None},
        }
        # Some functions of Python's math module may take forever.
        names = {name: value for name, value in substitution_args._eval_dict.items() if name not in vars(math)}
        evaluation = {
            "eval": self.eval_argument,
            "_eval_find": self.find,
            "_eval_dict": {**names, **MATH, "find": self.find},
        }
        with (
            _replaced(xacro, {**state, **{name: getattr(self, name) for name in own}}),
            _replaced(substitution_args, evaluation),
        ):
            # xacro passes these to expressions; its own code does not call them.
            taken = {**vars(builtins), **FUNCTIONS, "type": _type}
            with _replaced(xacro, {"__builtins__": taken, "math": SimpleNamespace(**MATH)}):
                self.symbols = xacro.create_global_symbols()
            del self.symbols["python"]["vars"]
            xacro._global_symbols = self.symbols
            yield

    def eval_all(self, node: Any, macros: Any, symbols: Any) -> None:
        before, self.here = self.here, node
        self.steps += 1
        too_much = f"unfolds to more than {MOST_STEPS} elements" if self.steps > MOST_STEPS else None
        if time.process_time() - self.began_s > MOST_SECONDS:
            too_much = f"takes more than {MOST_SECONDS:g} s to expand"
        if too_much:
            raise Refused(too_much, "do macros call each other many times over?")
        self.original["eval_all"](node, macros, symbols)
        self.here = before

    def check_attrs(self, node: Any, required: list[str], optional: list[str]) -> Any:
        self.here = node
        return self.original["check_attrs"](node, required, optional)

    def handle_macro_call(self, node: Any, macros: Any, symbols: Any) -> Any:
        if node.tagName in self.bare_macros:
            node.tagName = node.nodeName = f"{_PREFIX}{node.tagName}"
        if not node.tagName.startswith(_PREFIX):
            return False
        before, self.here = self.here, node
        name = node.tagName.removeprefix(_PREFIX)
        if self.lacks_macros and name != "call" and _is_unknown(name, macros, symbols):
            if self.missing.keeps_going:
                error = NotThere(f"no macro {name!r}", node.file, node.line, thing=f"macro {name}")
                self.missing.note(error, f"<{node.tagName}> is left out")
            xacro.replace_node(node, by=None)
            result: Any = True
        else:
            self.calls.append(node)
            result = self.original["handle_macro_call"](node, macros, symbols)
            self.calls.pop()
        self.here = before
        return result

    def process_include(self, node: Any, macros: Any, symbols: Any, function: Any) -> None:
        """Include a file; a missing file is noted and left out."""
        before, depth = self.here, len(xacro.filestack)
        try:
            self.original["process_include"](node, macros, symbols, function)
        except xacro.XacroException as error:
            file = error.exc.filename if isinstance(error.exc, FileNotFoundError) else None
            if file is None or self.here is not node:
                raise
            del xacro.filestack[depth:]
            text = f"no such file or directory: {file}"
            absent: NotThere = NoFileThere(text + self.called(), node.file, node.line, thing=text)
            if file.startswith(_NOWHERE):
                absent = self.unknown[file.removeprefix(_NOWHERE).partition("/")[0]]
            self.missing.note(absent, "what it includes is left out")
            self.lacks_macros = True
            xacro.replace_node(node, by=None)
        self.here = before

    def parse(self, text: Any, filename: str) -> minidom.Document:
        """Read an included file. For a missing file it raises XacroException, which optional includes catch."""
        assert text is None
        try:
            content = input_files.read_bytes(filename, xml_tree.MOST_BYTES)
        except NotThere as error:
            xacro.filestack.pop()
            absent = FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), filename)
            raise xacro.XacroException(f"{error.reason}: {filename}", exc=absent) from None
        return self.prefixed(xml_tree.read(content, shown(Path(filename))))

    def warning(self, *words: object, **_: object) -> None:
        self.notices.append(Notice("wrong", "xacro", _printable(words), self.here.file, self.here.line))

    def error(self, *words: object, **_: object) -> None:
        self.warning(*words)  # not an alias: xacro passes it to expressions under the function's own name

    def message(self, *words: object, **_: object) -> None:
        print(_printable(words), file=sys.stderr)

    def print_location(self) -> None:
        """Print nothing: the notice of a warning has its place."""

    def safe_eval(self, expression: str, names: Mapping[str, Any], _locals: object = None) -> Any:
        return compute(expression, names, _DOTTED)

    def eval_argument(self, expression: str, _globals: object, names: Any) -> Any:
        """Evaluate a `$(eval ...)`. `names` has arguments and functions; Python's own functions are added."""
        return compute(expression, ChainMap(names, FUNCTIONS), _DOTTED)

    def find(self, package: str) -> str:
        try:
            return str(self.packages.find(package))
        except UnknownPackage as error:
            place = self.here.file, self.here.line
            self.unknown[package] = NotThere(error.message + self.called(), *place, error.hint, f"package {package}")
            self.missing.note(self.unknown[package])
            return f"{_NOWHERE}{package}"

    def load_yaml(self, filename: str) -> Any:
        """The values of a YAML file, with dotted access and units (`!degrees 90`). `filename` may be relative.

        PyYAML expands nested aliases and merges until the memory is full, so values are counted first.
        """
        import yaml

        from slidectl.description import yaml_tree

        path = Path(xacro.abs_filename_spec(filename))

        class Loader(yaml.SafeLoader):
            """The loader of one file: xacro adds the units to PyYAML's own class, which others use too."""

        for unit in xacro.ConstructUnits:
            Loader.add_constructor(unit.value.tag, self.unit_reader(unit.value.conversion_constant))
        nodes = yaml_tree.documents(input_files.read_bytes(path, yaml_tree.MOST_BYTES), shown(path), Loader)
        if not nodes:
            return None
        if len(nodes) > 1:
            raise BadFile("a second document, where there can be only one", shown(path), nodes[1].start_mark.line + 1)
        _check_size(nodes[0], shown(path))
        try:
            return xacro.YamlListWrapper.wrap(Loader("").construct_document(nodes[0]))
        except yaml.YAMLError as error:
            raise BadFile(f"not YAML: {' '.join(str(error).split())}", shown(path)) from None
        except RecursionError:
            raise BadFile("is nested too deeply", shown(path)) from None

    def unit_reader(self, factor: float) -> Any:
        return lambda loader, node: factor * float(compute(str(loader.construct_scalar(node)), self.symbols, _DOTTED))

    # --- nodes and errors ---------------------------------------------------------------------------------------------

    def prefixed(self, root: Element) -> minidom.Document:
        """Convert a file to nodes. Tags without the prefix get it, with one notice."""
        bare = list(_bare(root))
        if bare:
            names = ", ".join(f"<{name}>" for name in sorted({element.tag for element in bare}))
            text = (
                f"{names} without the prefix are taken as <{_PREFIX}...>; xacro itself does so only until ROS Kinetic"
            )
            self.notices.append(Notice("wrong", "xacro", text, root.file, bare[0].line))
        elif f"xmlns:{_PREFIX[:-1]}" not in root.attributes:
            used = next((element for element in root.walk() if element.tag.startswith(_PREFIX)), None)
            if used is not None:
                declared = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
                text = f"<{root.tag}> lacks {declared}, without which xacro itself does not read the file"
                self.notices.append(Notice("wrong", "xacro", text, root.file, root.line))
        for element in bare:
            if element.tag == "macro":
                self.bare_macros.add(element.attributes["name"].removeprefix(_PREFIX))
            element.tag = _PREFIX + element.tag
        document = minidom.Document()
        document.appendChild(_to_node(root, document))
        return document

    def explained(self, error: Exception) -> BadFile:
        """Make an error from the first exception and the expressions around it, at the node that xacro works on."""
        expressions: list[str] = []
        cause: BaseException = error
        while isinstance(cause, xacro.XacroException) and isinstance(cause.exc, BaseException):
            expressions.extend([str(cause.suffix).strip()] if cause.suffix else [])
            cause = cause.exc
        if isinstance(cause, BadFile) and cause.line is not None:
            return cause
        place = self.here.file, self.here.line
        if isinstance(cause, SlidectlError):
            return BadFile(cause.message + self.called(), *place, cause.hint)
        text = ", ".join([_clause(cause), *dict.fromkeys(expressions[::-1])]).replace("\n", " ")
        return BadFile(text + self.called(), *place)

    def called(self) -> str:
        """Where the innermost failing macro was called, for a message."""
        outer = [call for call in self.calls if call is not self.here]
        if not outer:
            return ""
        call = outer[-1]
        return f" (in macro {call.tagName.removeprefix(_PREFIX)!r}, called at {call.file}:{call.line})"


class _Node(minidom.Element):
    """A minidom element with file and line of its tag. Clones keep them: macros are expanded by cloning."""

    def __init__(self, tag: str, file: str, line: int) -> None:
        super().__init__(tag)
        self.file = file
        self.line = line

    def cloneNode(self, deep: bool) -> _Node:  # noqa: N802 (the DOM's name)
        clone = _Node(self.tagName, self.file, self.line)
        clone.ownerDocument = self.ownerDocument
        for name, value in self.attributes.items():
            _set(clone, name, value)
        for child in self.childNodes if deep else ():
            copied: Any = child.cloneNode(deep)
            clone.appendChild(copied)
        return clone


def _set(node: minidom.Element, name: str, value: str) -> None:
    """Set an attribute. minidom would confuse `xacro:name` with `name` without the namespace."""
    prefix, colon, _ = name.partition(":")
    if colon:
        node.setAttributeNS(prefix, name, value)
    else:
        node.setAttribute(name, value)


def _to_node(element: Element, document: minidom.Document) -> _Node:
    node = _Node(element.tag, element.file, element.line)
    node.ownerDocument = document
    for name, value in element.attributes.items():
        _set(node, name, value)
    for part in element.content:
        if isinstance(part, Element):
            node.appendChild(_to_node(part, document))
        elif isinstance(part, Comment):
            node.appendChild(document.createComment(part))
        else:
            node.appendChild(document.createTextNode(part))
    return node


def _to_element(node: _Node) -> Element:
    element = Element(node.tagName, dict(node.attributes.items()), node.file, node.line)
    for child in node.childNodes:
        if isinstance(child, _Node):
            element.content.append(_to_element(child))
        elif isinstance(child, minidom.Comment):
            element.content.append(Comment(child.data))
        elif isinstance(child, minidom.Text):
            element.content.append(child.data)
    return element


def _bare(element: Element) -> Iterator[Element]:
    """Elements without the prefix. Inside `<gazebo>` tags of the same names have another meaning."""
    if _BARE.get(element.tag, "") in element.attributes:
        yield element
    for child in element.children if element.tag != "gazebo" else ():
        yield from _bare(child)


def _is_unknown(name: str, macros: Any, symbols: Any) -> bool:
    try:
        xacro.resolve_macro(name, macros, symbols)
    except KeyError:
        return True
    return False


@contextlib.contextmanager
def _replaced(module: ModuleType, names: Mapping[str, Any]) -> Iterator[None]:
    """Replace names of a module; at the end of the block all its names are restored."""
    before = dict(vars(module))
    vars(module).update(names)
    try:
        yield
    finally:
        for name in vars(module).keys() - before.keys():
            delattr(module, name)
        vars(module).update(before)


@contextlib.contextmanager
def _bounded_memory() -> Iterator[None]:
    """Limit new memory to MOST_MEMORY inside the block. The limit holds for the whole process: nothing else may run."""
    before = limit_new_memory(MOST_MEMORY)
    try:
        yield
    finally:
        restore_memory_limit(before)


def _check_size(root: Any, file: str) -> None:
    """Raise BadFile for too many values, counting what aliases repeat, and for long numbers."""
    count = 0
    pending = [root]
    while pending:
        node = pending.pop()
        count += 1
        if count > MOST_YAML_VALUES:
            text = f"more than {MOST_YAML_VALUES} values, counting what aliases repeat"
            raise BadFile(text, file, node.start_mark.line + 1)
        if node.id == "mapping":
            pending += [each for pair in node.value for each in pair]
        elif node.id == "sequence":
            pending += node.value
        elif node.tag in _NUMBERS and len(node.value) > _MOST_DIGITS:
            raise BadFile(f"a number of more than {_MOST_DIGITS} digits", file, node.start_mark.line + 1)


def _type(value: Any) -> type:
    """The type of a plain value; other types could construct new types."""
    if not issubclass(type(value), _PLAIN):
        raise TypeError("python.type() here is for numbers, texts, lists and mappings")
    return type(value)


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """xacro's function `tokenize`. `sep` may only be a set of characters, not another regular expression."""
    if "]" in sep[1:]:
        raise ValueError("']' can only be the first of the letters to part a text at")
    items = re.split(f"[{sep}]", text)
    return [item for item in items if item] if skip_empty else items


def _printable(words: tuple[object, ...]) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in " ".join(map(str, words)))


def _clause(error: BaseException) -> str:
    if isinstance(error, RecursionError):
        return "macros, includes or expressions call themselves without end"
    if isinstance(error, MemoryError):
        return f"it takes more than {MOST_MEMORY >> 30} GiB of memory"
    if isinstance(error, substitution_args.ArgException):
        return f"argument {error.args[0]!r} has no value; give {error.args[0]}:=VALUE"
    if isinstance(error, OSError):
        return f"{str(error.strerror).lower()}: {error.filename}"
    if isinstance(error, SyntaxError):
        return str(error.msg)
    if isinstance(error, KeyError):
        return f"unknown key {error}"
    return str(error).strip() or type(error).__name__
