"""Runs xacro on a tree of elements, in a process of its own with limits. Only this file touches xacro's insides.

Against: a model that was sent. Its expressions may compute for ever, fill the memory, or try to run code: the limits of
the process end the first two, and slidectl.description.guarded_eval refuses the third.

xacro 2.1 has no public way to look packages up without ament, or to tell errors by line. So some names of its modules
are replaced, in that process alone:

* `parse` reads included files into nodes that know their lines, and `open` those of YAML: regular ones, within bounds,
  also at the places where an installation would put them;
* `warning`, `error`, `message`, `print_location` print; here warnings become notices, and no terminal codes are sent;
* `handle_macro_call` and `process_include` are wrapped: they leave out what does not exist;
* `safe_eval`, and `eval` of `substitution_args`, are those of guarded_eval;
* `_eval_find` of `substitution_args` looks packages up.

Where xacro is in the file is read off the frames of its functions, whose parameters hold the element at work.
pyproject.toml pins the versions for which this holds, and a test compares xacro's functions with the versions that were
reviewed.
"""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from traceback import walk_stack, walk_tb
from types import FrameType
from typing import Any, NoReturn
from xml.dom import minidom

import xacro
from xacro import substitution_args
from yaml import YAMLError

from slidectl import confined, input_files
from slidectl.confined import Limits
from slidectl.description import guarded_eval, install_rules, xml_tree, yaml_tree
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, UnknownPackage, shown
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Comment, Element
from slidectl.errors import BadFile, NoFileThere, NotThere, Refused, SlidectlError, listing

LIMITS = Limits(cpu_s=10, wall_s=60, new_bytes=1 << 30)
"""Of a run. A humanoid takes about a second."""
_MOST_RESULT = 256 << 20
"""The most bytes of a result: the elements with their files and lines."""

_PREFIX = "xacro:"
_NOWHERE = "/no-such-package/"
"""Replaces the folder of a missing package, so that the rest of the file is still read."""
_DOTTED = (xacro.NameSpace, xacro.YamlDictWrapper)
_AT_WORK = ("node", "elt", "tag")
"""The names of parameters of xacro's functions that hold the element at work."""
_XACRO = xacro.eval_all.__code__.co_filename

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
        BadFile: an error of xacro, with file and line; also a missing thing that xacro cannot do without, and a limit.
        Refused: no process can be started.
    """
    try:
        output = confined.run(_Run(root, path, arguments, packages, missing).output, LIMITS, _MOST_RESULT)
    except confined.EndedError as error:
        raise BadFile(f"cannot expand it: {error}", root.file) from None
    except OSError as error:
        raise Refused(f"no process can be started to run xacro: {error.strerror}") from None
    result = json.loads(output)
    sys.stderr.write("".join(f"{line}\n" for line in result["messages"]))
    packages.learn(result["packages"])
    missing.add(result["missing"])
    if (trouble := result["error"]) is not None:
        missing.refuse()  # something missing is the most frequent reason
        raise BadFile(*trouble)
    return _to_element(result["root"]), [Notice("ignored" if n[0] else "wrong", *n[1:]) for n in result["notices"]]


class _OutOfTime(BaseException):
    """The CPU time is used up. No `except Exception` of xacro catches it."""


class _Arguments(dict[str, str]):
    """The arguments for xacro. `declared` records the names that the file declares or uses."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.declared: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.declared.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.declared.add(name)
        return super().__getitem__(name)


class _Run:
    """One run, in a process of its own, where nothing needs to be put back."""

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
        self.notices: list[tuple[bool, str, str, str, int | None]] = []
        """True for a thing without effect, and the other fields of a Notice."""
        self.messages: list[str] = []

    def output(self) -> bytes:
        """Run xacro. Returns JSON: the expanded `root` or an `error`, and notices, messages and what is missing."""
        signal.signal(signal.SIGXCPU, _out_of_time)
        root: list[Any] | None = None
        error: BadFile | None = None
        try:
            document: Any = self.prefixed(self.root)
            self.replace_insides()
            xacro.init_stacks(str(self.path.absolute()) if self.path is not None else None)
            xacro.process_doc(document, mappings=self.arguments)
            root = _plain(document.documentElement)
        except (Exception, _OutOfTime) as reason:  # expressions of the file may raise any exception
            error = self.explained(reason)
        declared = self.arguments.declared
        for name in sorted(self.given.keys() - declared):
            text = f"the file has no such argument and it has no effect; arguments: {listing(declared)}"
            self.notices.append((True, f"{name}:=", text, self.root.file, None))
        result = {
            "root": root,
            "error": None if error is None else (error.reason, error.file, error.line, error.hint),
            "notices": self.notices,
            "messages": self.messages,
            "missing": self.missing.records(),
            "packages": self.packages.learned(),
        }
        return json.dumps(result).encode()

    # --- replacements of xacro's own functions ------------------------------------------------------------------------

    def replace_insides(self) -> None:
        """Replace names in xacro's modules by ours."""
        self.macro_call = xacro.handle_macro_call
        self.include = xacro.process_include
        own = ("parse", "warning", "error", "message", "print_location", "safe_eval")
        for name in ("handle_macro_call", "process_include", *own):
            setattr(xacro, name, getattr(self, name))
        xacro.open = _opened
        substitution_args.eval = self.eval_argument
        substitution_args._eval_find = substitution_args._eval_dict["find"] = self.find
        xacro.substitution_args_context["filename"] = str(self.path) if self.path is not None else None
        # Expressions get the functions that are replaced here. `vars`, and `type` of all things, lead to code.
        xacro._global_symbols = symbols = xacro.create_global_symbols()
        symbols["python"]["type"] = guarded_eval.type_of
        del symbols["python"]["vars"]

    def handle_macro_call(self, node: Any, macros: Any, symbols: Any) -> Any:
        if node.tagName in self.bare_macros:
            node.tagName = node.nodeName = f"{_PREFIX}{node.tagName}"
        name = node.tagName.removeprefix(_PREFIX)
        try:
            if self.lacks_macros and name not in (node.tagName, "call"):
                xacro.resolve_macro(name, macros, symbols)
        except KeyError:
            if self.missing.keeps_going:
                error = NotThere(f"no macro {name!r}", node.file, node.line, thing=f"macro {name}")
                self.missing.note(error, f"<{node.tagName}> is left out")
            xacro.replace_node(node, by=None)
            return True
        return self.macro_call(node, macros, symbols)

    def process_include(self, node: Any, macros: Any, symbols: Any, function: Any) -> None:
        """Include a file; a missing file is noted and left out."""
        depth = len(xacro.filestack)
        try:
            self.include(node, macros, symbols, function)
        except xacro.XacroException as error:
            file = error.exc.filename if isinstance(error.exc, FileNotFoundError) else None
            at_work, called = _raised_at(error)
            if file is None or at_work is None or at_work is not node:
                raise
            del xacro.filestack[depth:]
            text = f"no such file or directory: {file}"
            hint = install_rules.remark(Path(file))
            absent: NotThere = NoFileThere(text + called, node.file, node.line, hint, text)
            if file.startswith(_NOWHERE):
                absent = self.unknown[file.removeprefix(_NOWHERE).partition("/")[0]]
            self.missing.note(absent, "what it includes is left out")
            self.lacks_macros = True
            xacro.replace_node(node, by=None)

    def parse(self, text: Any, filename: str) -> minidom.Document:
        """Read an included file. For a missing file it raises XacroException, which optional includes catch."""
        assert text is None
        path = install_rules.located(Path(filename))
        try:
            content = input_files.read_bytes(path, xml_tree.MOST_BYTES)
        except NotThere as error:
            xacro.filestack.pop()
            absent = FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), filename)
            raise xacro.XacroException(f"{error.reason}: {filename}", exc=absent) from None
        return self.prefixed(xml_tree.read(content, shown(path)))

    def warning(self, *words: object, **_: object) -> None:
        node = _here()[0] or self.root
        self.notices.append((False, "xacro", _printable(words), node.file, node.line))

    def error(self, *words: object, **_: object) -> None:
        self.warning(*words)  # not an alias: xacro passes it to expressions under the function's own name

    def message(self, *words: object, **_: object) -> None:
        self.messages.append(_printable(words))

    def print_location(self) -> None:
        """Print nothing: the notice of a warning has its place."""

    def safe_eval(self, expression: str, symbols: Any, names: Any = None) -> Any:
        return guarded_eval.evaluate(expression, symbols, names, _DOTTED, {})

    def eval_argument(self, expression: str, symbols: Any, names: Any) -> Any:
        """Evaluate a `$(eval ...)`. `names` has arguments and functions; Python's own functions are added."""
        return guarded_eval.evaluate(expression, symbols, names, _DOTTED, guarded_eval.FUNCTIONS)

    def find(self, package: str) -> str:
        try:
            return str(self.packages.find(package))
        except UnknownPackage as error:
            node, called = _here()
            place = node or self.root
            text = error.message + called
            self.unknown[package] = NotThere(text, place.file, place.line, error.hint, f"package {package}")
            self.missing.note(self.unknown[package])
            return f"{_NOWHERE}{package}"

    # --- nodes and errors ---------------------------------------------------------------------------------------------

    def prefixed(self, root: Element) -> minidom.Document:
        """Convert a file to nodes. Tags without the prefix get it, with one notice."""
        bare = list(_bare(root))
        if bare:
            names = ", ".join(f"<{name}>" for name in sorted({element.tag for element in bare}))
            text = f"{names} without the prefix are read as <{_PREFIX}...>; xacro itself does so only until ROS Kinetic"
            self.notices.append((False, "xacro", text, root.file, bare[0].line))
        elif f"xmlns:{_PREFIX[:-1]}" not in root.attributes:
            used = next((element for element in root.walk() if element.tag.startswith(_PREFIX)), None)
            if used is not None:
                declared = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
                text = f"<{root.tag}> lacks {declared}, without which xacro itself does not read the file"
                self.notices.append((False, "xacro", text, root.file, root.line))
        for element in bare:
            if element.tag == "macro":
                self.bare_macros.add(element.attributes["name"].removeprefix(_PREFIX))
            element.tag = _PREFIX + element.tag
        document = minidom.Document()
        document.appendChild(_to_node(root, document))
        return document

    def explained(self, error: BaseException) -> BadFile:
        """Make an error from the first exception and the expressions around it, at the node that xacro works on."""
        node, called = _raised_at(error)
        place = node or self.root
        expressions: list[str] = []
        cause = error
        while isinstance(cause, xacro.XacroException) and isinstance(cause.exc, BaseException):
            expressions.extend([str(cause.suffix).strip()] if cause.suffix else [])
            cause = cause.exc
        if isinstance(cause, BadFile) and cause.line is not None:
            return cause
        if isinstance(cause, SlidectlError):
            return BadFile(cause.message + called, place.file, place.line, cause.hint)
        text = ", ".join([_clause(cause), *dict.fromkeys(expressions[::-1])]).replace("\n", " ")
        return BadFile(text + called, place.file, place.line)


# --- where xacro is --------------------------------------------------------------------------------------------------


def _here() -> tuple[_Node | None, str]:
    """As _where, at this moment."""
    return _where(walk_stack(sys._getframe(1)))


def _raised_at(error: BaseException) -> tuple[_Node | None, str]:
    """As _where, at the moment when xacro raised the error."""
    return _where(reversed(list(walk_tb(error.__traceback__))))


def _where(frames: Iterable[tuple[FrameType, int]]) -> tuple[_Node | None, str]:
    """The element that xacro works on, and for a message where the macro around it was called. Innermost frame first.

    xacro does not tell it; the parameters of its functions do.
    """
    at_work: _Node | None = None
    for frame, _ in frames:
        if frame.f_code.co_filename != _XACRO:
            continue
        node = next((frame.f_locals[name] for name in _AT_WORK if name in frame.f_locals), None)
        if not isinstance(node, _Node):
            node = getattr(node, "parentNode", None)  # of a text
        if not isinstance(node, _Node):
            continue
        if at_work is None:
            at_work = node
        elif frame.f_code.co_name == "handle_macro_call" and node is not at_work:
            return at_work, f" (in macro {node.tagName.removeprefix(_PREFIX)!r}, called at {node.file}:{node.line})"
    return at_work, ""


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


def _plain(node: _Node) -> list[Any]:
    """The element for JSON: tag, attributes, file, line, and what is in it; a comment is in a list of its own."""
    plain = [node.tagName, dict(node.attributes.items()), node.file, node.line]
    for child in node.childNodes:
        if isinstance(child, _Node):
            plain.append(_plain(child))
        elif isinstance(child, minidom.Comment):
            plain.append([child.data])
        elif isinstance(child, minidom.Text):
            plain.append(child.data)
    return plain


def _to_element(plain: list[Any]) -> Element:
    tag, attributes, file, line, *content = plain
    element = Element(tag, attributes, file, line)
    for part in content:
        if isinstance(part, str):
            element.content.append(part)
        else:
            element.content.append(_to_element(part) if len(part) > 1 else Comment(part[0]))
    return element


def _bare(element: Element) -> Iterator[Element]:
    """Elements without the prefix. Inside `<gazebo>` tags of the same names have another meaning."""
    if _BARE.get(element.tag, "") in element.attributes:
        yield element
    for child in element.children if element.tag != "gazebo" else ():
        yield from _bare(child)


def _opened(name: str) -> io.StringIO:
    """The text of a YAML file, in the place of Python's `open`. Its errors name the file."""
    path = install_rules.located(Path(name))
    try:
        text = io.StringIO(input_files.read_text(path, yaml_tree.MOST_BYTES))
    except NotThere as error:
        error.hint = install_rules.remark(path) or error.hint
        raise
    text.name = shown(path)  # PyYAML looks for it
    return text


def _out_of_time(*_: object) -> NoReturn:
    signal.signal(signal.SIGXCPU, signal.SIG_IGN)  # the system repeats it each second
    raise _OutOfTime


def _printable(words: tuple[object, ...]) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in " ".join(map(str, words)))


def _clause(error: BaseException) -> str:
    if isinstance(error, RecursionError):
        return "macros, includes or expressions call themselves without end"
    if isinstance(error, MemoryError):
        return f"it takes more than {LIMITS.new_bytes >> 20} MiB of memory"
    if isinstance(error, _OutOfTime):
        return f"it takes more than {LIMITS.cpu_s} s to expand"
    if isinstance(error, substitution_args.ArgException):
        return f"argument {error.args[0]!r} has no value; give {error.args[0]}:=VALUE"
    if isinstance(error, OSError):
        return f"{str(error.strerror).lower()}: {error.filename}"
    if isinstance(error, SyntaxError):
        return str(error.msg)
    if isinstance(error, YAMLError):
        return f"not YAML: {' '.join(str(error).split())}"
    if isinstance(error, KeyError):
        return f"unknown key {error}"
    return str(error).strip() or type(error).__name__
