"""`<param>` and `<rosparam>`: parameters by value, file, command or YAML, computed when the plan is carried out.

Running a command is commands.py's affair.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

from slidectl.description.models import read_file
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, NotThere
from slidectl.launch import commands
from slidectl.launch.files import shown
from slidectl.launch.plan import RosparamCommand, Setting
from slidectl.launch.protected import plain
from slidectl.launch.scope import absent_packages
from slidectl.launch.substitution import Substitution, SubstitutionError
from slidectl.launch.tag import Tag
from slidectl.launch.typed import TYPES, convert

SOURCES = ("value", "textfile", "binfile", "command")
VERBS = ("load", "dump", "delete")


def param(tag: Tag, private: str | None = None) -> None:
    """A `<param>`; inside a node `private` is the node's own namespace."""
    setting = _setting(tag)
    name = setting.name
    if private is None and name.startswith("~"):
        setting.name = name.lstrip("~/")
        others = (other for other in tag.scope.private if other.name != setting.name)
        tag.scope.private = (*others, setting)
        return
    setting.name = tag.within(private or tag.scope.namespace, name.lstrip("~/") if private else name)
    if setting.name == "/":
        raise tag.error("'/' is no name for a value")
    tag.plan.settings.append(setting)


def _setting(tag: Tag) -> Setting:
    tag.knows(["name", "type", *SOURCES])
    name = tag.required("name").strip()
    kind = (tag.element.get("type") or "auto").strip().lower()  # nothing is put in there
    if kind not in TYPES:
        raise tag.error(f"the type {kind!r} is none of {', '.join(TYPES)}")
    given = [source for source in SOURCES if tag.element.get(source) is not None]
    if len(given) != 1:
        found = f"not {len(given)} of them" if given else f"and none is there{tag.slip(SOURCES)}"
        raise tag.error(f"{name} needs exactly one of {', '.join(SOURCES)}, {found}")
    compute, runs = _source(tag, given[0], kind)
    file = tag.required(given[0]) if given[0] in ("textfile", "binfile") else ""
    return Setting(name, tag.place, given[0], compute, runs, source=file, is_whole=True)


def _source(tag: Tag, source: str, kind: str) -> tuple[Callable[[], Any], bool]:
    """What computes the value, and whether that runs a program."""
    angles = tag.scope.launch.knows_angles
    if source == "value":
        value = _converted(tag, (tag.get("value") or "").strip(), kind, angles)
        return lambda: value, False
    if source == "command":
        command = commands.Command(tag)
        return lambda: _converted(tag, command.output(), kind, angles), not command.is_xacro
    path = tag.required(source)
    if source == "binfile":
        tag.notice("converted", "binary parameters are base64 text here")
        return lambda: base64.b64encode(_bytes(tag, path)).decode("ascii"), False
    return lambda: _converted(tag, _text(tag, path), kind, angles), False


def _converted(tag: Tag, text: str, kind: str, angles: bool) -> Any:
    try:
        value = convert(text, kind, tag.place.file, angles)
    except BadFile as error:
        raise tag.error(f"its value is {error.reason}") from None
    except ValueError as error:
        raise tag.error(f"its value is no {'parameter' if kind == 'auto' else kind}: {error}") from None
    if value is None:
        raise tag.error("its value is nothing, which no parameter can be")
    return value


def _bytes(tag: Tag, path: str) -> bytes:
    try:
        content = read_file(Path(path))
    except NotThere as error:
        raise tag.absence(f"{path}: {error.reason}", thing=f"file {path}") from None
    except BadFile as error:
        raise tag.error(f"{path}: {error.reason}") from None
    if len(content) > MOST_BYTES:
        raise tag.error(f"{path}: is larger than {MOST_BYTES >> 20} MiB")
    return content


def _text(tag: Tag, path: str) -> str:
    try:
        return _bytes(tag, path).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise tag.error(f"{path} is no text: {error.reason} at byte {error.start}") from None


# --- rosparam ---------------------------------------------------------------------------------------------------------


def rosparam(tag: Tag, private: str | None = None) -> None:
    """A `<rosparam>`; inside a node `private` is the node's own namespace."""
    tag.knows(["command", "file", "param", "ns", "subst_value"])
    verb = tag.get("command") or "load"
    if verb not in VERBS:
        raise tag.error(f"the command {verb!r} is none of {', '.join(VERBS)}")
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
    if file and tag.text.strip():
        tag.notice("wrong", "has a file and a text: the text has no effect")
    substitution = tag.scope.substitution if tag.flag("subst_value") else None
    tag.scope.launch.knows_angles = True

    def compute() -> Any:
        text = _text(tag, file) if file else tag.text
        text = text if substitution is None else _substituted(tag, text, substitution)
        return _yaml(tag, text if file else "\n" * (tag.element.line - 1) + text, file, name)

    tag.plan.settings.append(Setting(name, tag.place, "file" if file else "yaml", compute, source=file or ""))


def _substituted(tag: Tag, text: str, substitution: Substitution) -> str:
    try:
        found = substitution.resolve(text)
    except SubstitutionError as error:
        raise tag.error(error.message, error.hint) from None
    tag.scope.launch.count_text(tag, found)
    for package in absent_packages(found):
        raise tag.absence_of(package)
    return plain(found)


def _yaml(tag: Tag, text: str, file: str | None, name: str) -> Any:
    """The tree or the single value; None when there is nothing."""
    from slidectl.description import yaml_tree  # takes as long to import as all of this room

    value = yaml_tree.read_rosparam(text, shown(file) if file else tag.place.file, tag.plan.notices)
    if value is not None and not isinstance(value, dict) and (name == "/" or not tag.get("param")):
        raise tag.error(yaml_tree.NO_MAPPING, "a list or a single value needs param=NAME")
    if value is None or value == {}:
        tag.notice("wrong", "holds no parameters")
    return value
