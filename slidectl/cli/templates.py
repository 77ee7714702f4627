"""Values with expressions in them: texts that stand where a number is due, evaluated anew for each message.

The values come from a command line or a document and are not checked here; `fill` does that with what comes out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from slidectl.cli.schema import FLOATS, INTEGERS, Schema

_NOT_FINITE = r"(?i)[-+]?(nan|inf)\Z"
_CLOCK_WORDS = ("now", "auto")

Node = Callable[[int, float], Any]


class Template:
    """The values for a message of the schema's root type.

    `expressions` False reads only `nan` and `inf` as numbers, and leaves all other texts as they are.

    Raises:
        ExpressionError: a text where a number is due that is no expression in i and t.
    """

    def __init__(self, schema: Schema, values: Sequence[Any], expressions: bool = False) -> None:
        self._schema = schema
        self._expressions = expressions
        self._values = values
        self._nodes = self._whole(values)
        self.needs_clock = _mentions_clock(values)
        """True when a value is `now` or `auto`."""

    def at(self, index: int, seconds: float) -> Sequence[Any]:
        """The values for i = index and t = seconds. Raises EvaluationError."""
        return self._values if self._nodes is None else [node(index, seconds) for node in self._nodes]

    def _whole(self, values: Sequence[Any]) -> list[Node] | None:
        """A node for each value; None when all are constant."""
        root = self._schema.root
        fields = self._schema.fields(root)
        if len(values) == 1 and isinstance(values[0], Mapping):
            nodes = [self._message(root, values[0])]
        elif len(values) == 1 and len(fields) == 2 and fields[0].type == "std_msgs/MultiArrayLayout":
            nodes = [self._value(fields[1].type, True, values[0])]
        else:
            nodes = [self._value(f.type, f.array >= 0, v) for f, v in zip(fields, values, strict=False)]
        if len(nodes) != len(values) or not any(nodes):
            return None
        return [node or _constant(value) for node, value in zip(nodes, values, strict=True)]

    def _value(self, type_name: str, is_array: bool, value: Any) -> Node | None:
        if is_array:
            return self._several([(type_name, each) for each in value]) if isinstance(value, list) else None
        if type_name in FLOATS or type_name in INTEGERS or type_name == "bool":
            return self._number(type_name, value)
        return self._message(type_name, value)

    def _number(self, type_name: str, value: Any) -> Node | None:
        if not isinstance(value, str) or not (self._expressions or re.match(_NOT_FINITE, value.strip())):
            return None
        from slidectl.cli.expressions import Expression

        expression = Expression(value.lower() if re.match(_NOT_FINITE, value.strip()) else value, ("i", "t"))
        convert = _whole_number if type_name in INTEGERS else _itself
        return lambda index, seconds: convert(expression(i=index, t=seconds))

    def _message(self, type_name: str, value: Any) -> Node | None:
        fields = self._schema.fields(type_name)
        if isinstance(value, Mapping):
            return self._mapping({f.name: (f.type, f.array >= 0) for f in fields}, value)
        if isinstance(value, list) and len(value) == len(fields):
            nodes = [self._value(f.type, f.array >= 0, v) for f, v in zip(fields, value, strict=True)]
            return _list_node(nodes, value)
        return None

    def _mapping(self, kinds: Mapping[str, tuple[str, bool]], value: Mapping[str, Any]) -> Node | None:
        nodes = {name: self._value(*kinds[name], each) for name, each in value.items() if name in kinds}
        if not any(nodes.values()):
            return None
        return lambda index, seconds: {
            name: node(index, seconds) if (node := nodes.get(name)) else each for name, each in value.items()
        }

    def _several(self, elements: Sequence[tuple[str, Any]]) -> Node | None:
        return _list_node([self._value(kind, False, each) for kind, each in elements], [each for _, each in elements])


def _list_node(nodes: Sequence[Node | None], values: Sequence[Any]) -> Node | None:
    if not any(nodes):
        return None
    return lambda index, seconds: [
        node(index, seconds) if node else value for node, value in zip(nodes, values, strict=True)
    ]


def _constant(value: Any) -> Node:
    return lambda _index, _seconds: value


def _itself(value: Any) -> Any:
    return value


def _whole_number(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _mentions_clock(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(map(_mentions_clock, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_mentions_clock, value))
    return value in _CLOCK_WORDS
