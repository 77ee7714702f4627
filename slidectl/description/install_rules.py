"""Finds the files of a ROS 2 package that nobody built: what its installation puts under a path, by its build files.

In ROS 2 the folder of a package is `share/NAME` of an installation. The files there are those that CMakeLists.txt
installs (`install(DIRECTORY ...)`, `install(FILES ...)`, `ament_auto_package(INSTALL_TO_SHARE ...)`), or the
`data_files` of setup.py and setup.cfg. Their names may differ from those in the source folder.

Against: build files of others. They are read within bounds, and nothing of them runs: setup.py is read as a syntax
tree. A path with `..` that leads out of the package is not translated.
"""

from __future__ import annotations

import ast
import configparser
import os
import posixpath
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from itertools import islice
from pathlib import Path

from slidectl import input_files
from slidectl.description.packages import package_name, package_of, shown
from slidectl.errors import BadFile, listing

_MOST_BYTES = 64 << 10
"""The most bytes of a build file; larger ones are not read."""
_MOST_RULES = 300
"""The most rules of a build file, and the most values of a variable."""
_MOST_WORDS = 20_000
"""The most words of a CMakeLists.txt, those in loops counted each time."""
_MOST_READINGS = 3
"""The most ways to read a path with `..`."""
_LONGEST = 4096
"""The most characters of a text that variables make; no path is longer."""


@dataclass(frozen=True)
class InstallRule:
    """A file or folder of the source folder, and its place in `share/NAME`. Both are relative, and "" for the top."""

    place: str
    source: str
    origin: str
    """File and line."""
    names: str = ""
    """A pattern such as `*.xacro`: only the files in the folder `source` with such names."""

    def source_of(self, asked: str) -> str | None:
        """The source that is installed as `asked`, whether it exists or not; None: this rule does not say."""
        if self.names:
            folder, name = posixpath.split(asked)
            return _join(self.source, name) if folder == self.place and fnmatchcase(name, self.names) else None
        rest = _below(self.place, asked)
        return None if rest is None else _join(self.source, rest)

    def place_of(self, source: str) -> str | None:
        """Where the source is installed, if this is a rule of a folder; None: this rule does not say."""
        rest = None if self.names else _below(self.source, source)
        return None if rest is None else _join(self.place, rest)


def located(path: Path) -> Path:
    """The path if something is there; else the file or folder in source that is installed there; else the path."""
    if os.path.exists(path):
        return path
    return next((source for _, source in _translations(path) if os.path.exists(source)), path)


def remark(path: Path) -> str | None:
    """What the build files of its package say of a missing path, for a hint; None: nothing new."""
    tried = list(_translations(path))
    for rule, source in tried:
        if source != path:
            return f"{rule.origin} installs it from {shown(source)}, which is not there either"
    package = package_of(path)
    rules = _rules(package) if package is not None and not tried else []
    if package is None or not rules:
        return None
    places = sorted({rule.place.partition("/")[0] or "." for rule in rules})
    files = " and ".join(dict.fromkeys(rule.origin.partition(":")[0] for rule in rules))
    return f"the package {package_name(package)} does not install it; it installs by {files}: {listing(places)}"


def _translations(path: Path) -> Iterator[tuple[InstallRule, Path]]:
    """Each rule that installs something at `path`, and the path of its source, which may be missing."""
    package = package_of(path)
    if package is None:
        return
    inside = path.absolute().relative_to(package).as_posix()
    rules = _rules(package)
    readings = [inside]
    if ".." in inside.split("/"):
        # A path that begins in a source folder and leaves it means what is beside that folder after an installation.
        readings += [place for rule in rules if (place := rule.place_of(inside)) is not None]
    for asked in islice(dict.fromkeys(map(posixpath.normpath, readings)), _MOST_READINGS):
        for rule in rules if not _leaves(asked) else ():
            source = rule.source_of(asked)
            if source is not None:
                yield rule, package / source


def _rules(package: Path) -> list[InstallRule]:
    """The rules of a package's build files, in their order. Files that cannot be read have none."""
    name = package_name(package)
    found: list[InstallRule] = []
    for file, read in (("CMakeLists.txt", _of_cmake), ("setup.py", _of_setup_py), ("setup.cfg", _of_setup_cfg)):
        try:
            found += read(input_files.read_text(package / file, _MOST_BYTES), name)
        except BadFile:
            continue
    return found


def _rule(place: str, source: str, origin: str) -> InstallRule | None:
    """A rule of names as written; None for a path out of the package, and a pattern in the name of a folder."""
    place, source = posixpath.normpath(place), posixpath.normpath(source)
    names = ""
    if any(letter in source for letter in "*?["):
        source, names = posixpath.split(source)
        place = posixpath.dirname(place)
    if _leaves(place) or _leaves(source) or any(letter in source for letter in "*?["):
        return None
    return InstallRule("" if place == "." else place, "" if source == "." else source, origin, names)


def _in_share(destination: str, package: str) -> str | None:
    """The part of a destination below `share/NAME`; None when it is another folder."""
    return _below(f"share/{package}", posixpath.normpath(destination))


def _below(folder: str, path: str) -> str | None:
    """The rest of the path below the folder, "" for the folder itself; None when it is not below."""
    if folder in ("", path):
        return "" if folder == path else path
    return path.removeprefix(f"{folder}/") if path.startswith(f"{folder}/") else None


def _join(folder: str, rest: str) -> str:
    return f"{folder}/{rest}" if folder and rest else folder or rest


def _leaves(path: str) -> bool:
    """True for a normalised path out of the folder that it is relative to."""
    return path.startswith("/") or path.split("/", 1)[0] == ".."


# --- CMakeLists.txt ---------------------------------------------------------------------------------------------------

_TOKEN = re.compile(
    r"""(?P<blank>[\s;]+|\#[^\n]*)
    |"(?P<quoted>(?:[^"\\]|\\.)*)"
    |(?P<parenthesis>[()])
    |(?P<plain>(?:[^\s()"\#\\;]|\\.)+)""",
    re.DOTALL | re.VERBOSE,
)
_ESCAPED = re.compile(r"\\(\W)")
_VARIABLE = re.compile(r"\$\{([\w.+-]+)\}")
_ENDS_OF_NAMES = {
    "DESTINATION", "TYPE", "FILE_PERMISSIONS", "DIRECTORY_PERMISSIONS", "PERMISSIONS", "USE_SOURCE_PERMISSIONS",
    "OPTIONAL", "MESSAGE_NEVER", "CONFIGURATIONS", "COMPONENT", "EXCLUDE_FROM_ALL", "FILES_MATCHING", "PATTERN",
    "REGEX", "RENAME", "EXCLUDE",
}  # fmt: skip
"""Words that end the names of files and folders in `install(...)`."""
_AUTO = ("INSTALL_TO_SHARE", "INSTALL_TO_PATH", "USE_SCOPED_HEADER_INSTALL_DIR")
"""The keywords of `ament_auto_package(...)`."""


@dataclass(frozen=True)
class _Command:
    name: str
    words: list[tuple[str, bool]]
    """The words, each with True when it was quoted: then a variable in it is one word."""
    line: int


@lru_cache(maxsize=64)
def _of_cmake(text: str, package: str) -> list[InstallRule]:
    """The rules of a CMakeLists.txt. What is installed to other folders than `share/NAME` is left out."""
    reader = _Cmake(package)
    with suppress(RecursionError):  # loops in loops without end
        reader.run(_commands(text))
    return reader.found


class _Cmake:
    """Carries out the commands of a CMakeLists.txt that say what is installed. Conditions all count as true."""

    def __init__(self, package: str) -> None:
        self.package = package
        self.found: list[InstallRule] = []
        self.left = _MOST_WORDS
        own_folders = ("CMAKE_CURRENT_SOURCE_DIR", "CMAKE_SOURCE_DIR", "PROJECT_SOURCE_DIR", "CMAKE_CURRENT_LIST_DIR")
        self.variables: dict[str, list[str]] = {
            "PROJECT_NAME": [package], "CMAKE_PROJECT_NAME": [package], f"{package}_SOURCE_DIR": ["."],
            "CMAKE_INSTALL_PREFIX": ["."], "CMAKE_INSTALL_DATADIR": ["share"], "CMAKE_INSTALL_DATAROOTDIR": ["share"],
            "CATKIN_PACKAGE_SHARE_DESTINATION": [f"share/{package}"], **{name: ["."] for name in own_folders},
        }  # fmt: skip

    def run(self, commands: list[_Command]) -> None:
        index = 0
        while index < len(commands) and self.left > 0:
            command = commands[index]
            index += 1
            self.left -= 1 + len(command.words)
            if command.name == "foreach":
                end = _end_of_loop(commands, index)
                if words := self.values(command):
                    self.repeat(words, commands[index:end])
                index = end
            else:
                self.take(command, self.values(command))

    def repeat(self, words: list[str], body: list[_Command]) -> None:
        """Carry out `foreach(NAME items)`, `foreach(NAME IN ITEMS items)` and `foreach(NAME IN LISTS names)`."""
        items: list[str]
        if words[1:3] == ["IN", "LISTS"]:
            items = [item for name in words[3:] for item in self.variables.get(name, [])]
        else:
            items = words[3:] if words[1:3] == ["IN", "ITEMS"] else words[1:]
        for item in items:
            self.variables[words[0]] = [item]
            self.run(body)

    def take(self, command: _Command, words: list[str]) -> None:
        if command.name == "set" and words:
            self.variables[words[0]] = words[1:]
        elif command.name == "file" and words[:1] == ["GLOB"] and len(words) > 1:
            self.variables[words[1]] = words[2:]  # patterns stay patterns, which rules understand
        elif command.name == "install" and words[:1] in (["DIRECTORY"], ["FILES"], ["PROGRAMS"]):
            self.install(words, command.line)
        elif command.name == "ament_auto_package" and "INSTALL_TO_SHARE" in words:
            folders = _until(words[words.index("INSTALL_TO_SHARE") + 1 :], _AUTO)
            self.add(folders, f"share/{self.package}", True, None, command.line)

    def install(self, words: list[str], line: int) -> None:
        if "DESTINATION" in words[:-1]:
            renamed = words[words.index("RENAME") + 1] if "RENAME" in words[:-1] else None
            names, destination = _until(words[1:], _ENDS_OF_NAMES), words[words.index("DESTINATION") + 1]
            self.add(names, destination, words[0] == "DIRECTORY", renamed, line)

    def add(self, names: list[str], destination: str, are_folders: bool, renamed: str | None, line: int) -> None:
        """Add rules. As in CMake, a folder with a slash at its end is installed without its own name."""
        place = _in_share(destination, self.package)
        if place is None:
            return
        for name in names:
            base = "" if are_folders and name.endswith("/") else posixpath.basename(name)
            rule = _rule(posixpath.join(place, renamed or base), name, f"CMakeLists.txt:{line}") if name else None
            # A name with a variable that is unknown here says nothing.
            if rule is not None and "$" not in name and len(self.found) < _MOST_RULES:
                self.found.append(rule)

    def values(self, command: _Command) -> list[str]:
        """The words of a command with the values of variables. A variable that is alone gives all its values."""
        found: list[str] = []
        for word, is_quoted in command.words:
            alone = None if is_quoted else _VARIABLE.fullmatch(word)
            found += self.variables.get(alone[1], [word]) if alone else [self.text(word[:_LONGEST])]
            if len(found) > _MOST_RULES:
                break
        return found

    def text(self, word: str) -> str:
        """A text with the values of the variables in it. Those with no value or several stay as they are."""

        def value(match: re.Match[str]) -> str:
            values = self.variables.get(match[1], [])
            return values[0] if len(values) == 1 and len(values[0]) < _LONGEST // 16 else match[0]

        return _VARIABLE.sub(value, word)[:_LONGEST]


def _commands(text: str) -> list[_Command]:
    """The commands of a CMakeLists.txt, `name(words)`. Parentheses inside are left out; what is no command ends it."""
    found: list[_Command] = []
    words: list[tuple[str, bool]] = []
    name, begun, depth, line, position = "", 1, 0, 1, 0
    while (token := _TOKEN.match(text, position)) is not None:
        if text.startswith("#[[", position) and (end := text.find("]]", position)) >= 0:
            line, position = line + text.count("\n", position, end), end + 2  # a comment of several lines
            continue
        here = line
        line += text.count("\n", position, token.end())
        position = token.end()
        word = token["plain"] if token["plain"] is not None else token["quoted"]
        if word is not None and depth:
            words.append((_ESCAPED.sub(r"\1", word), token["plain"] is None))
        elif word is not None:
            name, begun = word.lower(), here
        elif token["parenthesis"] == "(":
            depth += 1
        elif token["parenthesis"] and depth:
            depth -= 1
            if depth == 0:
                found.append(_Command(name, words, begun))
                words = []
    return found


def _end_of_loop(commands: list[_Command], begin: int) -> int:
    depth = 1
    for index in range(begin, len(commands)):
        depth += {"foreach": 1, "endforeach": -1}.get(commands[index].name, 0)
        if depth == 0:
            return index
    return len(commands)


def _until(words: list[str], ends: Iterable[str]) -> list[str]:
    """The words before the first of `ends`."""
    index = next((index for index, word in enumerate(words) if word in ends), len(words))
    return words[:index]


# --- setup.py and setup.cfg -------------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def _of_setup_py(text: str, package: str) -> list[InstallRule]:
    """The rules of `data_files` in a setup.py; what is not a constant, a list, a path or a pattern is left out."""
    try:
        return _SetupPy(package).rules(ast.parse(text))
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # not Python, or nested without end
        return []


class _SetupPy:
    """Evaluates the constants and paths of a setup.py. None stands for a value that is unknown."""

    def __init__(self, package: str) -> None:
        self.package = package
        self.names: dict[str, object] = {}

    def rules(self, tree: ast.Module) -> list[InstallRule]:
        found: list[InstallRule] = []
        for statement in tree.body:
            if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
                self.names[statement.targets[0].id] = self.value(statement.value)
            elif isinstance(statement, ast.AugAssign) and isinstance(statement.target, ast.Name):
                self.names[statement.target.id] = self.sum(self.names.get(statement.target.id), statement.value)
            elif isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
                call = statement.value
                self.append(call)
                files = [word.value for word in call.keywords if word.arg == "data_files"]
                if _called(call) == "setup" and files:
                    found += self.of_list(self.value(files[0]), call.lineno)
        return found[:_MOST_RULES]

    def of_list(self, files: object, line: int) -> Iterator[InstallRule]:
        for pair in files if isinstance(files, list) else ():
            if not isinstance(pair, list) or len(pair) != 2 or not isinstance(pair[0], str):
                continue
            place = _in_share(pair[0], self.package)
            for name in pair[1] if place is not None and isinstance(pair[1], list) else ():
                if isinstance(name, str):
                    rule = _rule(posixpath.join(place or "", posixpath.basename(name)), name, f"setup.py:{line}")
                    yield from [rule] if rule is not None else []

    def append(self, call: ast.Call) -> None:
        """Carry out `NAME.append(item)` and `NAME.extend(items)`."""
        if isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name) and len(call.args) == 1:
            name, known = call.func.value.id, self.names.get(call.func.value.id)
            item = self.value(call.args[0])
            added = {"append": [item], "extend": item}.get(call.func.attr)
            if isinstance(known, list) and isinstance(added, list):
                self.names[name] = [*known, *added][:_MOST_RULES]

    def value(self, node: ast.expr) -> object:
        if isinstance(node, ast.Constant):
            return node.value if isinstance(node.value, str) and len(node.value) <= _LONGEST else None
        if isinstance(node, ast.Name):
            return self.names.get(node.id)
        if isinstance(node, (ast.List, ast.Tuple)):
            return [self.value(element) for element in node.elts[:_MOST_RULES]]
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return self.sum(self.value(node.left), node.right)
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.FormattedValue) else part for part in node.values]
            return _text([self.value(part) for part in parts], "")
        if isinstance(node, ast.Call):
            values = [self.value(argument) for argument in node.args]
            if _called(node) == "join":
                return _text(values, "/")
            if _called(node) in ("glob", "iglob") and len(values) == 1:
                return [values[0]]  # patterns stay patterns, which rules understand
        return None

    def sum(self, left: object, added: ast.expr) -> object:
        right = self.value(added)
        if isinstance(left, list) and isinstance(right, list):
            return [*left, *right][:_MOST_RULES]
        return _text([left, right], "")


def _called(call: ast.Call) -> str:
    function = call.func
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _text(parts: list[object], between: str) -> str | None:
    """The texts joined; None when one of them is unknown, or the result is too long."""
    texts = [part for part in parts if isinstance(part, str)]
    if len(texts) != len(parts) or sum(map(len, texts)) > _LONGEST:
        return None
    return between.join(texts)


@lru_cache(maxsize=64)
def _of_setup_cfg(text: str, package: str) -> list[InstallRule]:
    """The rules of the section `options.data_files`: in each line `DESTINATION = FILES`, FILES one a line or by commas.

    Source: setuptools' documentation of declarative configuration.
    """
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(text)
    except configparser.Error:
        return []
    section = parser["options.data_files"] if parser.has_section("options.data_files") else {}
    found = []
    for destination, files in section.items():
        place = _in_share(destination, package)
        for name in re.split(r"[,\n]", files or "") if place is not None else ():
            if name.strip():
                base = posixpath.basename(name.strip())
                found.append(_rule(posixpath.join(place or "", base), name.strip(), "setup.cfg"))
    return [rule for rule in found if rule is not None][:_MOST_RULES]
