"""`<param>` and `<rosparam>`: parameters by value, file, command or YAML, computed when the plan is carried out.

The command xacro runs in this process, with our own xacro. Any other command runs as the user's program without a
shell, as in roslaunch.
"""

from __future__ import annotations

import base64
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from slidectl import paths
from slidectl.description.missing import read_notes, to_environment
from slidectl.description.models import read_file, xacro_words
from slidectl.description.packages import is_file, shown
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, NotThere, SlidectlError, UsageError
from slidectl.extensions.launch.plan import RosparamCommand, Setting
from slidectl.extensions.launch.substitution import automatic, plain
from slidectl.extensions.launch.tag import Tag, boolean
from slidectl.input_files import near
from slidectl.supervision import run

TYPES = ("auto", "str", "string", "int", "double", "bool", "boolean", "yaml")
SOURCES = ("value", "textfile", "binfile", "command")
VERBS = ("load", "dump", "delete")


# --- param -----------------------------------------------------------------------------------------------------------


def param(tag: Tag, private: str | None = None) -> None:
    """Read a `<param>`; inside a node `private` is the node's own namespace."""
    tag.knows(["name", "type", *SOURCES])
    setting = _setting(tag, tag.required("name").strip())
    name = setting.name
    if private is None and name.startswith("~"):
        setting.name = name.lstrip("~/")
        others = (other for other in tag.scope.private if other.name != setting.name)
        tag.scope.private = (*others, setting)
        return
    setting.name = tag.within(private or tag.scope.namespace, name.lstrip("~/") if private else name)
    if setting.name == "/":
        raise tag.error("'/' is not a parameter name")
    tag.plan.settings.append(setting)


def _setting(tag: Tag, name: str) -> Setting:
    kind = (tag.element.get("type") or "auto").strip().lower()  # no substitution here
    if kind not in TYPES:
        raise tag.error(f"unknown type {kind!r}; known: {', '.join(TYPES)}")
    given = [source for source in SOURCES if tag.element.get(source) is not None]
    if len(given) != 1:
        found = f"not {len(given)} of them" if given else f"and none is there{tag.mistake(SOURCES)}"
        raise tag.error(f"{name} needs exactly one of {', '.join(SOURCES)}, {found}")
    [source] = given
    if source == "value":
        value = _converted(tag, (tag.get("value") or "").strip(), kind)
        return Setting(name, tag.place, source, lambda: value, is_whole=True)
    if source == "command":
        is_xacro, output = _command(tag)
        return Setting(name, tag.place, source, lambda: _converted(tag, output(), kind), not is_xacro, is_whole=True)
    path = tag.required(source)
    if source == "textfile":
        return Setting(name, tag.place, source, lambda: _converted(tag, _text(tag, path), kind), False, path, True)
    tag.notice("converted", "binary parameters are base64 text here")
    return Setting(
        name, tag.place, source, lambda: base64.b64encode(_bytes(tag, path)).decode("ascii"), False, path, True
    )


def _converted(tag: Tag, text: str, kind: str) -> Any:
    """Convert a text to a type of TYPES. Raises BadFile."""
    try:
        value = _value(text, kind, tag.place.file)
    except BadFile as error:
        raise tag.error(f"its value is {error.reason}") from None
    except ValueError as error:
        raise tag.error(f"its value is not of type {kind}: {error}") from None
    if isinstance(value, float) and not math.isfinite(value) and kind != "yaml":
        raise tag.error(f"its value is {value}, and parameters hold only finite numbers")
    if value is None:
        raise tag.error("its value is empty, and a parameter needs one")
    return value


def _value(text: str, kind: str, file: str) -> Any:
    """Convert a text to a type. Raises ValueError: not possible. BadFile: not YAML."""
    if kind == "auto":
        return automatic(text)
    if kind in ("int", "double"):
        try:
            return int(text) if kind == "int" else float(text)
        except ValueError:
            raise ValueError(repr(text)) from None
    if kind in ("bool", "boolean"):
        if (value := boolean(text)) is None:
            raise ValueError(f"{text!r} is neither true nor false")
        return value
    if kind == "yaml":
        from slidectl.description.yaml_tree import read_value  # its import takes as long as all of this package

        return read_value(text, file)
    return text


def _bytes(tag: Tag, path: str) -> bytes:
    try:
        return read_file(Path(path))
    except NotThere as error:
        raise tag.no_file(f"{path}: {error.reason}", error.hint, Path(path)) from None
    except BadFile as error:
        raise tag.error(f"{path}: {error.reason}") from None


def _text(tag: Tag, path: str) -> str:
    try:
        return _bytes(tag, path).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise tag.error(f"{path} is not text: {error.reason} at byte {error.start}") from None


# --- command ---------------------------------------------------------------------------------------------------------

_XACRO = ("xacro", "xacro.py")
_PYTHON = re.compile(r"python[\d.]*\Z")
_XACRO_FLAGS = ("--inorder", "-i", "-q", "-v", "--check-order", "--xacro-ns", "--debug")


def _command(tag: Tag) -> tuple[bool, Callable[[], str]]:
    """True if the command is xacro, and a function that returns its output. Raises BadFile for errors known before."""
    given = tag.words("command")
    if not given:
        raise tag.error("the attribute 'command' is empty")
    before = _before_xacro(given)
    if before is not None:
        file, arguments = _xacro_arguments(tag, given[before:])
        return True, lambda: _expand(tag, file, arguments)
    if not tag.scope.launch.run_commands:
        raise tag.error(f"runs the program {given[0]!r}", "that is refused by --no-commands")
    return False, lambda: _run(tag, given)


def _expand(tag: Tag, file: Path, arguments: dict[str, str]) -> str:
    from slidectl import description

    try:
        document = description.load(file, arguments, tag.scope.packages, missing=tag.plan.missing)
    except BadFile:
        raise
    except SlidectlError as error:
        raise tag.error(error.message, error.hint) from None

    def placed(notice: Notice) -> Notice:
        """A notice about an argument of the command gets the place of the command."""
        text = f"{notice.text} (of {shown(file)})"
        here = replace(notice, text=text, file=tag.place.file, line=tag.place.line)
        return here if notice.line is None else notice

    tag.plan.notices += map(placed, document.report)
    return document.xml


def _run(tag: Tag, command: list[str]) -> str:
    hint = f"command: {' '.join(command)}"
    with tempfile.NamedTemporaryFile("r", encoding="utf-8", prefix="slidectl-") as notes:
        try:
            code, output = run(command, _environment(tag, notes.name), MOST_BYTES)
        except OverflowError as error:
            raise tag.error(f"the command prints {error}", hint) from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise tag.error(f"cannot run {command[0]!r}: {reason}", hint) from None
        read_notes(tag.plan.missing, notes.read())
    if code:
        tag.plan.missing.refuse()  # something missing is the most frequent reason
        raise tag.error(f"the command ended with code {code}", hint)
    try:
        return output.decode("utf-8")
    except UnicodeDecodeError:
        raise tag.error("the command's output is not text", hint) from None


def _environment(tag: Tag, notes: str) -> dict[str, str]:
    """The environment of a command, which may run xacro: that is ours, leaves out what this launch does, and notes it.

    `notes` is the file for that. The shipped xacro script finds slidectl by SLIDECTL_PYTHON.
    """
    folder = str(paths.share("launch") / "counterparts" / "xacro")
    path = os.pathsep.join([folder, os.environ.get("PATH", os.defpath)])
    return {**os.environ, "PATH": path, "SLIDECTL_PYTHON": sys.executable, **to_environment(tag.plan.missing, notes)}


def _before_xacro(command: list[str]) -> int | None:
    """The number of words before xacro's arguments: xacro itself, possibly with python or rosrun; None: not xacro."""
    program = os.path.basename(command[0])
    if program in _XACRO:
        return 1
    if _PYTHON.match(program) and os.path.basename("".join(command[1:2])) in _XACRO:
        return 2
    return 3 if program == "rosrun" and command[1:2] == ["xacro"] and "".join(command[2:3]) in _XACRO else None


def _xacro_arguments(tag: Tag, command: list[str]) -> tuple[Path, dict[str, str]]:
    """The model's file, and the arguments for it."""
    try:
        arguments, others = xacro_words(command)
    except UsageError as error:
        raise tag.error(error.message, error.hint) from None
    if empty := [word for word in command if word.strip().endswith(":=")]:
        tag.notice("ignored", f"{', '.join(empty)} has no value: the model's default is used, as by xacro itself")
    files = []
    for word in others:
        if not word.startswith("-"):
            files.append(word)
        elif word not in _XACRO_FLAGS and not word.startswith("--verbosity"):
            raise tag.error(f"xacro's option {word!r} is not understood here", f"these are: {', '.join(_XACRO_FLAGS)}")
    if len(files) != 1:
        raise tag.error(f"xacro takes one file, not {len(files)}: {' '.join(command)}")
    path = Path(files[0])
    if not is_file(path):
        raise tag.no_file(f"xacro: no such file: {path}", near(str(path)), path)
    return path, arguments


# --- rosparam --------------------------------------------------------------------------------------------------------


def rosparam(tag: Tag, private: str | None = None) -> None:
    """Read a `<rosparam>`; inside a node `private` is the node's own namespace."""
    tag.knows(["command", "file", "param", "ns", "subst_value"])
    verb = tag.get("command") or "load"
    if verb not in VERBS:
        raise tag.error(f"unknown command {verb!r}; known: {', '.join(VERBS)}")
    namespace = private or tag.scope.namespace
    for part in (tag.get("ns"), tag.get("param")):
        namespace = tag.within(namespace, part) if part else namespace
    if verb == "load":
        _load(tag, namespace)
    elif verb == "delete":
        if namespace == "/":
            raise tag.error("delete needs a param or an ns: this would delete all parameters there are")
        if tag.element.get("file") is not None:
            raise tag.error("delete takes no file", "param= and ns= say what is deleted")
        tag.plan.commands.append(RosparamCommand("delete", namespace, "", tag.place))
    else:
        tag.plan.commands.append(RosparamCommand("dump", namespace, tag.required("file"), tag.place))


def _load(tag: Tag, name: str) -> None:
    file = tag.get("file")
    if file == "":
        raise tag.error("the attribute 'file' is empty", "leave it out when the parameters are in the tag itself")
    if file and tag.element.text.strip():
        tag.notice("wrong", "has a file and a text: the text is ignored")
    substitution = tag.scope.substitution if tag.flag("subst_value") else None

    def compute() -> Any:
        text = _text(tag, file) if file else tag.element.text
        text = text if substitution is None else plain(tag.substituted(text, substitution))
        return _yaml(tag, text if file else "\n" * (tag.element.line - 1) + text, file, name)

    tag.plan.settings.append(Setting(name, tag.place, "file" if file else "yaml", compute, source=file or ""))


def _yaml(tag: Tag, text: str, file: str | None, name: str) -> Any:
    """The tree or the single value; None when there is none."""
    from slidectl.description import yaml_tree  # its import takes as long as all of this package

    value = yaml_tree.read_rosparam(text, shown(file) if file else tag.place.file, tag.plan.notices)
    if value is not None and not isinstance(value, dict) and (name == "/" or not tag.get("param")):
        raise tag.error(yaml_tree.NO_MAPPING, "a list or a single value needs param=NAME")
    if value is None or value == {}:
        tag.notice("wrong", "holds no parameters")
    return value
