"""Message, service and action types: finding and parsing definitions, their text and md5 sum.

The files in `data` hold every type that slidectl itself uses. rosbags' type store has the other common ROS 1 types;
building it takes some hundred milliseconds, so it is imported only when one of those is needed. The grammar is one
field or constant per line (http://wiki.ros.org/msg).
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

from slidectl.errors import UnknownName
from slidectl.msgs.schema import FLOATS, INTEGER_RANGES, PRIMITIVES, SCALAR, Field

_DATA = os.path.join(os.path.dirname(__file__), "data")
# Type names also come from clients: only two plain words may become a path.
_LEGAL = re.compile(r"[A-Za-z]\w{0,99}/[A-Za-z]\w{0,99}", re.ASCII)
_LONGEST_SHOWN = 120
_RULE = "=" * 80
_LINE = re.compile(r"(?P<type>[\w/]+)(?P<array>\[\d*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?:=(?P<value>.*))?")
_SEPARATOR = re.compile(r"^---[ \t]*$", re.MULTILINE)
_ACTION_TEXTS = {
    "ActionGoal": "Header header\nactionlib_msgs/GoalID goal_id\n{stem}Goal goal\n",
    "ActionResult": "Header header\nactionlib_msgs/GoalStatus status\n{stem}Result result\n",
    "ActionFeedback": "Header header\nactionlib_msgs/GoalStatus status\n{stem}Feedback feedback\n",
    "Action": "{stem}ActionGoal action_goal\n{stem}ActionResult action_result\n{stem}ActionFeedback action_feedback\n",
}
"""The messages that actionlib generates from an action besides its goal, result and feedback."""
_ACTION_PARTS = (*_ACTION_TEXTS, "Goal", "Result", "Feedback")
_ROSBAGS_PACKAGES = {
    *("actionlib", "bond", "diagnostic_msgs", "nav_msgs"),
    *("sensor_msgs", "shape_msgs", "stereo_msgs", "visualization_msgs"),
}
"""The packages for which rosbags' store has more types. A misspelt name of another package does not load the store."""


class Constant(NamedTuple):
    """A constant of a message type; its value is a str, bool, int or float, according to its type."""

    name: str
    type: str
    value: str | bool | int | float


class Definition(NamedTuple):
    """A message type. `constant_texts` are the values as written: the md5 sum is computed from them."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]
    constant_texts: tuple[str, ...]
    text: str


class ServiceDefinition(NamedTuple):
    """A service type: the request and the response."""

    request: Definition
    response: Definition
    text: str


_definitions: dict[str, Definition] = {}
_services: dict[str, ServiceDefinition] = {}


# Reading definitions


def parse_message(text: str, name: str) -> Definition:
    """Parse the text of the `.msg` file of `pkg/Type`. Raises ValueError: a line is neither a field nor a constant."""
    package = name.partition("/")[0]
    fields: list[Field] = []
    constants: list[Constant] = []
    texts: list[str] = []
    for line in text.splitlines():
        bare = line.partition("#")[0].strip()
        if not bare:
            continue
        # A string constant takes all of its line, '#' included.
        match = _LINE.fullmatch(line.strip() if bare.startswith("string ") and "=" in bare else bare)
        if match is None:
            raise ValueError(f"neither a field nor a constant: {line!r}")
        type_name, array, value = _resolved(match["type"], package), match["array"], match["value"]
        if value is None:
            length = SCALAR if array is None else int(array[1:-1] or 0)
            fields.append(Field(match["name"], type_name, length))
        else:
            constants.append(Constant(match["name"], type_name, _constant_value(type_name, value.strip())))
            texts.append(value.strip())
    return Definition(name, tuple(fields), tuple(constants), tuple(texts), text)


def parse_service(text: str, name: str) -> ServiceDefinition:
    """Parse the text of a `.srv` file; the messages are `pkg/TypeRequest` and `pkg/TypeResponse`."""
    request, response = _split(text, 2, name)
    return ServiceDefinition(parse_message(request, f"{name}Request"), parse_message(response, f"{name}Response"), text)


def parse_action(text: str, name: str) -> dict[str, Definition]:
    """Parse the text of an `.action` file: the seven messages of the action, by full name."""
    goal, result, feedback = _split(text, 3, name)
    stem = name.partition("/")[2]
    texts = {part: body.format(stem=stem) for part, body in _ACTION_TEXTS.items()}
    texts |= {"Goal": goal, "Result": result, "Feedback": feedback}
    return {name + part: parse_message(body, name + part) for part, body in texts.items()}


def _split(text: str, parts: int, name: str) -> list[str]:
    bodies = [body.strip("\n") + "\n" if body.strip() else "" for body in _SEPARATOR.split(text)]
    if len(bodies) != parts:
        raise ValueError(f"{name}: {parts - 1} lines `---` expected, {len(bodies) - 1} found")
    return bodies


def _resolved(type_name: str, package: str) -> str:
    """The full name of a type used in a definition in `package`."""
    if type_name in PRIMITIVES or "/" in type_name:
        return type_name
    return "std_msgs/Header" if type_name == "Header" else f"{package}/{type_name}"


def _constant_value(type_name: str, text: str) -> str | bool | int | float:
    if type_name in INTEGER_RANGES:
        return int(text, 0)
    if type_name in FLOATS:
        return float(text)
    return text.lower() in ("true", "1") if type_name == "bool" else text


# Finding types


def definition_of(type_name: str) -> Definition:
    """The definition of `pkg/Type`. Raises UnknownName."""
    found = _find(type_name)
    if found is None:
        short = type_name[:_LONGEST_SHOWN]
        raise _unknown("message type", short, _names_to_compare(short))
    return found


def service_of(name: str) -> ServiceDefinition:
    """The service type `pkg/Type`. Raises UnknownName."""
    found = _find_service(name)
    if found is None:
        raise _unknown("service type", name[:_LONGEST_SHOWN], service_names())
    return found


def fields(type_name: str) -> tuple[Field, ...]:
    """The fields in order. Raises UnknownName."""
    return definition_of(type_name).fields


def constants(type_name: str) -> tuple[Constant, ...]:
    """The constants (name, type, value) in order. Raises UnknownName."""
    return definition_of(type_name).constants


def request_type(service: str) -> str:
    """The message type of a service's request, `pkg/TypeRequest`. Raises UnknownName."""
    return service_of(service).request.name


def response_type(service: str) -> str:
    """The message type of a service's response, `pkg/TypeResponse`. Raises UnknownName."""
    return service_of(service).response.name


def exists(type_name: str) -> bool:
    """True when `pkg/Type` is a known message type."""
    return _find(type_name) is not None


def service_exists(name: str) -> bool:
    """True when `pkg/Type` is a known service type."""
    return _find_service(name) is not None


def type_names() -> list[str]:
    """All message types, including those of actions, but not requests and responses of services; sorted."""
    return sorted(_names_in_files() | set(rosbags_names()))


def service_names() -> list[str]:
    """All service types, sorted."""
    return sorted(_names("srv"))


def rosbags_names() -> list[str]:
    """The message types of rosbags' store."""
    times = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")  # primitives in ROS 1
    return [name.replace("/msg/", "/") for name in _rosbags_store().fielddefs if name not in times]


def _names_in_files() -> set[str]:
    return {*_names("msg"), *(stem + part for stem in _names("action") for part in _ACTION_PARTS)}


def _names(kind: str) -> Iterator[str]:
    for package in os.listdir(_DATA):
        folder = os.path.join(_DATA, package, kind)
        if os.path.isdir(folder):
            yield from (f"{package}/{file.removesuffix('.' + kind)}" for file in os.listdir(folder))


def _names_to_compare(type_name: str) -> list[str]:
    """The names for a spelling suggestion: without rosbags' store if the files are enough."""
    package = type_name.rpartition("/")[0]
    in_files = sorted(_names_in_files())
    has_siblings = any(name.startswith(f"{package}/") for name in in_files)
    return in_files if not package or (has_siblings and package not in _ROSBAGS_PACKAGES) else type_names()


def _unknown(kind: str, name: str, known: list[str]) -> UnknownName:
    """The error for an unknown name, with the names of the same package, else those of the same last word, else all."""
    package, _, word = name.rpartition("/")
    siblings = [other for other in known if package and other.startswith(f"{package}/")]
    return UnknownName(kind, name, siblings or [other for other in known if other.endswith(f"/{word}")] or known)


def _find(name: str) -> Definition | None:
    """The message type, from the first source that has it: a .msg, .srv or .action file, rosbags' store."""
    if name in _definitions or not _LEGAL.fullmatch(name):
        return _definitions.get(name)
    text = _read(name, "msg")
    if text is None and not _generated(name) and name.partition("/")[0] in _ROSBAGS_PACKAGES:
        text = rosbags_text(name)
    if text is not None:
        _definitions[name] = parse_message(text, name)
    return _definitions.get(name)


def _generated(name: str) -> bool:
    """Load the service or action file that the type is part of. True when the type is known then."""
    for part in ("Request", "Response"):
        if name.endswith(part):
            _find_service(name.removesuffix(part))
    for part in _ACTION_PARTS:
        stem = name.removesuffix(part)
        text = _read(stem, "action") if stem != name else None
        if text is not None:
            _definitions.update(parse_action(text, stem))
    return name in _definitions


def _find_service(name: str) -> ServiceDefinition | None:
    if name not in _services and _LEGAL.fullmatch(name):
        text = _read(name, "srv")
        if text is not None:
            service = _services[name] = parse_service(text, name)
            _definitions[service.request.name] = service.request
            _definitions[service.response.name] = service.response
    return _services.get(name)


def _read(name: str, kind: str) -> str | None:
    package, _, word = name.partition("/")
    try:
        with open(os.path.join(_DATA, package, kind, f"{word}.{kind}"), encoding="utf-8") as file:
            return file.read()
    except FileNotFoundError:
        return None


@cache
def _rosbags_store() -> Any:
    from rosbags.typesys import Stores, get_typestore  # imported on use: see the top of this file

    return get_typestore(Stores.ROS1_NOETIC)


def rosbags_text(name: str) -> str | None:
    """The text of a type's `.msg` file in rosbags' store; None if it is not there."""
    full = name.replace("/", "/msg/")
    if full not in _rosbags_store().fielddefs:
        return None
    text: str = _rosbags_store().generate_msgdef(full)[0]  # the types used in it follow
    return text.partition(_RULE)[0]


# Types as text, and their md5 sums: as `rosmsg` and `rossrv` print them


def definition(type_name: str) -> str:
    """The text of the type's `.msg` file. Raises UnknownName."""
    return definition_of(type_name).text


@cache
def full_definition(type_name: str) -> str:
    """The text of the type and of all types used in it, as in recordings and ROS connection headers.

    Raises UnknownName.
    """
    texts = {name: definition(name).rstrip("\n") for name in _parts(type_name, {})}
    first, *rest = texts
    return "\n\n".join([texts[first], *(f"{_RULE}\nMSG: {name}\n{texts[name]}" for name in rest)]) + "\n"


def _parts(type_name: str, found: dict[str, None]) -> Iterator[str]:
    if type_name not in found:
        found[type_name] = None
        yield type_name
        for field in fields(type_name):
            if field.type not in PRIMITIVES:
                yield from _parts(field.type, found)


def service_definition(name: str) -> str:
    """The text of the service's `.srv` file. Raises UnknownName."""
    return service_of(name).text


@cache
def md5(type_name: str) -> str:
    """The md5 sum that ROS 1 peers compare, 32 hexadecimal digits. Raises UnknownName."""
    return _digest(_md5_text(definition_of(type_name), md5))


def md5_of(type_name: str, definitions: Callable[[str], Definition]) -> str:
    """The md5 sum of a type whose definitions come from `definitions`, which may raise."""
    return _digest(_md5_text(definitions(type_name), lambda inner: md5_of(inner, definitions)))


@cache
def service_md5(name: str) -> str:
    """The md5 sum of a service. Raises UnknownName."""
    service = service_of(name)
    return _digest(_md5_text(service.request, md5) + _md5_text(service.response, md5))


def show(type_name: str) -> str:
    """The type with its nested types, indented by two spaces per level, constants as NAME=value; no final newline."""
    return "\n".join(_lines(definition_of(type_name), ""))


def show_service(name: str) -> str:
    """Request, `---`, response, each as `show` prints it."""
    service = service_of(name)
    return "\n".join([*_lines(service.request, ""), "---", *_lines(service.response, "")])


def _digest(text: str) -> str:
    import hashlib  # imported on use: OpenSSL loads slower than all else that `slidectl pub` needs

    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def _constant_lines(of: Definition) -> list[str]:
    return [f"{c.type} {c.name}={text}" for c, text in zip(of.constants, of.constant_texts, strict=True)]


def _md5_text(of: Definition, md5_of_type: Callable[[str], str]) -> str:
    """genmsg's `compute_md5_text`: without comments, constants first, nested types replaced by their own sum."""
    fields = [f"{f.type_text if f.type in PRIMITIVES else md5_of_type(f.type)} {f.name}" for f in of.fields]
    return "\n".join(_constant_lines(of) + fields)


def _lines(of: Definition, indent: str) -> list[str]:
    lines = [indent + line for line in _constant_lines(of)]
    for field in of.fields:
        lines.append(f"{indent}{field.type_text} {field.name}")
        if field.type not in PRIMITIVES:
            lines += _lines(definition_of(field.type), indent + "  ")
    return lines
