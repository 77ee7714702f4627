"""Expressions in values and over messages: `pub -r 'sin(t)'` in `i` and `t`, and `echo --filter` over a message `m`.

The evaluator is that of `slidectl.expressions`. Here stands which names there are, and what the fields of a
message are in it. Names and fields are checked before the first message.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from slidectl.errors import Refused, UnknownName, UsageError, closest
from slidectl.expressions import FUNCTIONS, MATH, evaluate, parsed
from slidectl.field_path import byte_values
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, TIMES, Field, Schema

_LONGEST = 4000
_MOST_STEPS = 10_000_000
"""More than a launch file may take: every element of an array of the message counts as one."""
_NOT_FINITE = re.compile(r"\s*[-+]?(nan|inf)\s*\Z", re.IGNORECASE)
_CLOCK_WORDS = ("now", "auto")
_TIME_PARTS = ("secs", "nsecs", "to_sec", "to_nsec")


class _Record:
    """Values that an expression reads as attributes; `show` makes of each what the expression sees."""

    def __init__(self, values: Mapping[str, Any], show: Callable[[str, Any], Any] = lambda _name, value: value) -> None:
        self._values = values
        self._show = show

    def __getitem__(self, name: str) -> Any:
        return self._show(name, self._values[name])


_NAMES = {**FUNCTIONS, **MATH, "math": _Record(MATH)}


class Expression:
    """A parsed expression in `variables`, the names of the math module and Python's plain functions.

    Raises:
        UsageError: it is no expression, or uses a name that there is not.
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
        """The value with these variables. Raises Refused when it cannot be computed."""
        try:
            return evaluate(self.tree, _NAMES | names, (_Record,), self._most_steps)
        except (ArithmeticError, ValueError, TypeError, LookupError, NameError, RecursionError) as error:
            raise Refused(f"cannot compute {self.text!r}: {error}") from None


class Filter:
    """An expression over a message `m` of the schema's root type; the fields that it names are checked at once.

    `more` are other names that it may use; the call gives their values.
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
        """What `m.a.b[0]` leads to; None when it is no field. Raises UsageError for one that there is not."""
        if isinstance(node, ast.Name) and node.id == "m":
            return Field("m", self._schema.root)
        if not isinstance(node, ast.Attribute | ast.Subscript):
            return None
        owner = self._field_of(node.value)
        if owner is None or (isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice)):
            return owner
        if isinstance(node, ast.Subscript):
            return Field(owner.name, owner.type)
        fields = self._schema.fields(owner.type) or [Field(n, "int32") for n in _TIME_PARTS if owner.type in TIMES]
        if not fields or owner.array >= 0:
            return None  # a method of a text or of a list
        for field in fields:
            if field.name == node.attr:
                return field
        missing = UnknownName("field", node.attr, [field.name for field in fields], f"in {owner.type}")
        raise UsageError(f"{self._expression.text!r}: {missing}")

    def _shown(self, value: Any, field: Field | None) -> Any:
        """Null is not a number, base64 is numbers, a time has rospy's `to_sec()` and `to_nsec()`."""
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


class Template:
    """The values for a message of the schema's root type, in which texts stand where a number is due.

    `expressions` False reads only `nan` and `inf` as numbers, and leaves all other texts as they are. No expression may
    take more than `most_steps`. Values are not checked here: `fill` does that with what comes out.

    Raises:
        UsageError: a text where a number is due that is no expression in i and t.
    """

    def __init__(
        self, schema: Schema, values: Sequence[Any], expressions: bool = False, most_steps: int = _MOST_STEPS
    ) -> None:
        self._schema = schema
        self._expressions = expressions
        self._most_steps = most_steps
        fields = schema.fields(schema.root)
        if len(values) == 1 and isinstance(values[0], Mapping):
            self._values = [self._parsed(values[0], schema.root, False)]
        elif len(values) == 1 and [field.type for field in fields[:1]] == ["std_msgs/MultiArrayLayout"]:
            self._values = [self._parsed(values[0], fields[1].type, True)]
        else:
            self._values = self._parsed(list(values), schema.root, False)
        self.needs_clock = _mentions_clock(values)
        """True when a value is `now` or `auto`."""

    def at(self, index: int, seconds: float) -> Sequence[Any]:
        """The values for i = index and t = seconds. Raises Refused."""
        return [_at(value, index, seconds) for value in self._values]

    def _parsed(self, value: Any, type_name: str, is_array: bool) -> Any:
        """The value with functions of i and t in the place of expressions."""
        if is_array:
            return [self._parsed(each, type_name, False) for each in value] if isinstance(value, list) else value
        fields = self._schema.fields(type_name)
        if isinstance(value, Mapping):
            kinds = {field.name: field for field in fields}
            return {
                name: self._parsed(each, kinds[name].type, kinds[name].array >= 0) if name in kinds else each
                for name, each in value.items()
            }
        if isinstance(value, list) and len(value) == len(fields):
            return [self._parsed(each, f.type, f.array >= 0) for each, f in zip(value, fields, strict=True)]
        is_number = type_name in FLOATS or type_name in INTEGER_RANGES or type_name == "bool"
        is_finite = not isinstance(value, str) or _NOT_FINITE.match(value) is None
        if not is_number or not isinstance(value, str) or (is_finite and not self._expressions):
            return value
        expression = Expression(value if is_finite else value.lower(), ("i", "t"), self._most_steps)
        return lambda i, t: _rounded(expression(i=i, t=t), type_name)


def _rounded(value: Any, type_name: str) -> Any:
    return int(value) if type_name in INTEGER_RANGES and isinstance(value, float) and value.is_integer() else value


def _at(value: Any, index: int, seconds: float) -> Any:
    if callable(value):
        return value(index, seconds)
    if isinstance(value, dict):
        return {name: _at(each, index, seconds) for name, each in value.items()}
    return [_at(each, index, seconds) for each in value] if isinstance(value, list) else value


def _mentions_clock(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(map(_mentions_clock, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_mentions_clock, value))
    return value in _CLOCK_WORDS
