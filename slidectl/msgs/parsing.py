"""Definitions from text: `.msg`, `.srv` and `.action` files of ROS 1.

The grammar is one field or constant a line (http://wiki.ros.org/msg). An action becomes the seven messages
that actionlib generates from it. Reads no files and resolves no nested types.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from slidectl.msgs.schema import FLOATS, INTEGER_RANGES, PRIMITIVES, SCALAR, VARIABLE, Field

_LINE = re.compile(r"(?P<type>[\w/]+)(?P<array>\[\d*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?:=(?P<value>.*))?")
_SEPARATOR = re.compile(r"^---[ \t]*$", re.MULTILINE)

_GOAL = "Header header\nactionlib_msgs/GoalID goal_id\n{stem}Goal goal\n"
_RESULT = "Header header\nactionlib_msgs/GoalStatus status\n{stem}Result result\n"
_FEEDBACK = "Header header\nactionlib_msgs/GoalStatus status\n{stem}Feedback feedback\n"
_ACTION = "{stem}ActionGoal action_goal\n{stem}ActionResult action_result\n{stem}ActionFeedback action_feedback\n"


class Constant(NamedTuple):
    """A named value of a type. Its value is a str, bool, int or float, after its type."""

    name: str
    type: str
    value: str | bool | int | float


class Definition(NamedTuple):
    """A message type. `constant_texts` has the values as they were written: the md5 sum is taken over those."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]
    constant_texts: tuple[str, ...]
    text: str


class Service(NamedTuple):
    """A service type: what is asked and what is answered."""

    name: str
    request: Definition
    response: Definition
    text: str


def parse_message(text: str, name: str) -> Definition:
    """The definition of `pkg/Type` from the text of its `.msg` file. Raises ValueError for a line that is neither."""
    package = name.partition("/")[0]
    fields: list[Field] = []
    constants: list[Constant] = []
    texts: list[str] = []
    for line in text.splitlines():
        entry = _parse_line(line, package)
        if isinstance(entry, Field):
            fields.append(entry)
        elif entry:
            constants.append(entry[0])
            texts.append(entry[1])
    return Definition(name, tuple(fields), tuple(constants), tuple(texts), text)


def parse_service(text: str, name: str) -> Service:
    """The service `pkg/Type` from the text of its `.srv` file; its messages are `pkg/TypeRequest` and `...Response`."""
    request, response = _split(text, 2, name)
    return Service(name, parse_message(request, f"{name}Request"), parse_message(response, f"{name}Response"), text)


def parse_action(text: str, name: str) -> dict[str, Definition]:
    """The seven messages of the action `pkg/Type`, by full name."""
    goal, result, feedback = _split(text, 3, name)
    stem = name.partition("/")[2]
    texts = {
        f"{name}Goal": goal,
        f"{name}Result": result,
        f"{name}Feedback": feedback,
        f"{name}ActionGoal": _GOAL.format(stem=stem),
        f"{name}ActionResult": _RESULT.format(stem=stem),
        f"{name}ActionFeedback": _FEEDBACK.format(stem=stem),
        f"{name}Action": _ACTION.format(stem=stem),
    }
    return {full: parse_message(body, full) for full, body in texts.items()}


def _split(text: str, parts: int, name: str) -> list[str]:
    bodies = [body.strip("\n") + "\n" if body.strip() else "" for body in _SEPARATOR.split(text)]
    if len(bodies) != parts:
        raise ValueError(f"{name}: {parts - 1} lines `---` expected, {len(bodies) - 1} found")
    return bodies


def _parse_line(line: str, package: str) -> Field | tuple[Constant, str] | None:
    bare = line.partition("#")[0].strip()
    if not bare:
        return None
    # A string constant takes all of its line, '#' included.
    match = _LINE.fullmatch(line.strip() if bare.startswith("string ") and "=" in bare else bare)
    if match is None:
        raise ValueError(f"not a field nor a constant: {line!r}")
    type_name, name, value = resolve(match["type"], package), match["name"], match["value"]
    if value is None:
        return Field(name, type_name, _array(match["array"]))
    return Constant(name, type_name, _value(type_name, value.strip())), value.strip()


def resolve(type_name: str, package: str) -> str:
    """The full name of a type that a definition in `package` names."""
    if type_name in PRIMITIVES or "/" in type_name:
        return type_name
    return "std_msgs/Header" if type_name == "Header" else f"{package}/{type_name}"


def _array(text: str | None) -> int:
    if text is None:
        return SCALAR
    return int(text[1:-1]) if text != "[]" else VARIABLE


def _value(type_name: str, text: str) -> str | bool | int | float:
    if type_name in INTEGER_RANGES:
        return int(text, 0)
    if type_name in FLOATS:
        return float(text)
    return text.lower() in ("true", "1") if type_name == "bool" else text
