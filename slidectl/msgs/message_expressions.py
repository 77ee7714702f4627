"""Expressions in values and over messages: `pub -r 'sin(t)'` in `i` and `t`, and `echo --filter` over a message `m`.

`slidectl.expressions` evaluates them. This module defines the names and how message fields appear in an expression.
Names and fields are checked before the first message.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

from slidectl.errors import Refused, UnknownName, UsageError, closest
from slidectl.expressions import FUNCTIONS, MATH, evaluate, parsed
from slidectl.msgs.field_path import byte_values
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, TIMES, Field, Schema

# Against: a scenario that was sent. The page in a browser has a lower bound on steps.
_LONGEST = 4000
_MOST_STEPS = 10_000_000
"""Higher than for launch files: every array element of the message counts as a step."""
_NOT_FINITE = re.compile(r"\s*[-+]?(nan|inf)\s*\Z", re.IGNORECASE)
_TIMES = {name: (*parts, Field("to_sec", ""), Field("to_nsec", "")) for name, parts in TIMES.items()}
"""What a time has here: its parts, and the functions of rospy."""


class _Record:
    """Values that an expression reads as attributes; `show` converts each for the expression."""

    def __init__(self, values: Mapping[str, Any], show: Callable[[str, Any], Any] = lambda _name, value: value) -> None:
        self._values = values
        self._show = show

    def __getitem__(self, name: str) -> Any:
        return self._show(name, self._values[name])


_NAMES = {**FUNCTIONS, **MATH, "math": _Record(MATH)}


class Expression:
    """A parsed expression in `variables`, the names of the math module and Python's plain functions.

    Raises:
        UsageError: it is no expression, or uses an unknown name.
    """

    def __init__(self, text: str, variables: Sequence[str], most_steps: int = _MOST_STEPS) -> None:
        if len(text) > _LONGEST:
            raise UsageError(f"the expression is longer than {_LONGEST} characters")
        self.text = text
        self._most_steps = most_steps
        try:
            self.tree = parsed(text)
        except SyntaxError as error:
            raise UsageError(f"{text!r} is not a valid expression: {error.msg}") from None
        uses = [node for node in ast.walk(self.tree) if isinstance(node, ast.Name | ast.arg)]
        bound = {
            n.arg if isinstance(n, ast.arg) else n.id for n in uses if not isinstance(getattr(n, "ctx", 0), ast.Load)
        }
        for node in uses:
            if isinstance(node, ast.Name) and node.id not in {*variables, *_NAMES, *bound}:
                near = closest(node.id, [*variables, *_NAMES])
                known = f"there are {', '.join(variables)} and the names of the math module"
                reason = f"no name {node.id!r} ({known}" + (f", did you mean {near!r}?)" if near else ")")
                raise UsageError(f"{text!r} is not a valid expression: {reason}")

    def __call__(self, **names: Any) -> Any:
        """The value with these variables. Raises Refused: it cannot be computed."""
        try:
            return evaluate(self.tree, _NAMES | names, (_Record,), self._most_steps)
        except (ArithmeticError, ValueError, TypeError, LookupError, NameError, RecursionError) as error:
            raise Refused(f"cannot compute {self.text!r}: {error}") from None


class Filter:
    """An expression over a message `m` of the schema's root type; its field names are checked on construction.

    `more` are further variables; a call gives their values.
    """

    def __init__(self, text: str, schema: Schema, more: Sequence[str] = ()) -> None:
        self._expression = Expression(text, ("m", *more))
        self._schema = schema
        for node in ast.walk(self._expression.tree):
            if isinstance(node, ast.Attribute):
                self._field_of(node)

    def __call__(self, message: Mapping[str, Any], **more: Any) -> bool:
        """True when the condition holds. Raises Refused."""
        return bool(self._expression(m=self._shown(message, Field("m", self._schema.root)), **more))

    def _field_of(self, node: ast.AST) -> Field | None:
        """The field that `m.a.b[0]` refers to; None when it is no field. Raises UsageError: no such field."""
        if isinstance(node, ast.Name) and node.id == "m":
            return Field("m", self._schema.root)
        if not isinstance(node, ast.Attribute | ast.Subscript):
            return None
        owner = self._field_of(node.value)
        if owner is None or (isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice)):
            return owner
        if isinstance(node, ast.Subscript):
            return Field(owner.name, owner.type)
        fields = self._schema.fields(owner.type) or _TIMES.get(owner.type)
        if not fields or owner.array >= 0:
            return None  # a method of a text or of a list
        for field in fields:
            if field.name == node.attr:
                return field
        missing = UnknownName("field", node.attr, [field.name for field in fields], f"in {owner.type}")
        raise UsageError(f"{self._expression.text!r}: {missing}")

    def _shown(self, value: Any, field: Field | None) -> Any:
        """The value for the expression: null is nan, base64 is numbers, times have rospy's `to_sec()`, `to_nsec()`."""
        if field is None or (field.array >= 0 and field.type in BYTES):
            return value if field is None else byte_values(value)
        if field.array >= 0:
            return [self._shown(each, Field(field.name, field.type)) for each in value]
        if field.type in FLOATS:
            return math.nan if value is None else value
        if field.type in TIMES:
            secs, nsecs = value["secs"], value["nsecs"]
            moments = {"to_sec": lambda: secs + 1e-9 * nsecs, "to_nsec": lambda: secs * 10**9 + nsecs}
            return _Record({**value, **moments})
        if not isinstance(value, Mapping):
            return value
        return _Record(value, lambda name, inner: self._shown(inner, self._schema.field(field.type, name)))


def number_converter(
    index: int, seconds: float, expressions: bool = True, most_steps: int = _MOST_STEPS
) -> Callable[[str, str], Any]:
    """A converter of texts to numbers for `fill`: `nan` and `inf`, and any expression in i = index and t = seconds.

    It takes a text and the expected type, and returns other texts unchanged. It raises UsageError: a text is no
    expression. Refused: it cannot be computed.

    Args:
        expressions: False leaves expressions unchanged.
        most_steps: the limit of each evaluation.
    """

    def number(text: str, type_name: str) -> Any:
        is_finite = _NOT_FINITE.match(text) is None
        if is_finite and not expressions:
            return text
        value = _in_i_and_t(text if is_finite else text.lower(), most_steps)(i=index, t=seconds)
        is_whole = type_name in INTEGER_RANGES and isinstance(value, float) and value.is_integer()
        return int(value) if is_whole else value

    return number


@lru_cache(1000)
def _in_i_and_t(text: str, most_steps: int) -> Expression:
    return Expression(text, ("i", "t"), most_steps)
