"""The expressions of the command line: `pub -r 'sin(t)'` in `i` and `t`, and `echo --filter` over a message `m`.

The evaluator is that of `slidectl.expressions`. Here stands which part of it a command line may use, and the fields of
a message: names and fields are checked before the first message, with the place and the closest name.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from slidectl.cli.schema import BYTES, FLOATS, TIMES, Schema
from slidectl.cli.yamlform import byte_values
from slidectl.errors import Refused, UnknownName, UsageError, closest
from slidectl.expressions import FUNCTIONS, MATH, evaluate, parsed

_LONGEST = 4000
_CONSTANTS: dict[str, Any] = {name: getattr(math, name) for name in ("pi", "e", "tau", "inf", "nan")}
_FUNCTIONS: dict[str, Callable[..., Any]] = {name: value for name, value in MATH.items() if callable(value)} | {
    name: FUNCTIONS[name]
    for name in ("abs", "min", "max", "round", "len", "int", "float", "bool", "sum", "any", "all", "str")
}
_METHODS = frozenset(
    ("startswith", "endswith", "lower", "upper", "strip", "find", "count", "isdigit", "index", "to_sec", "to_nsec")
)
_OPERATIONS = (
    ast.Constant, ast.List, ast.Tuple, ast.UnaryOp, ast.BoolOp, ast.BinOp, ast.Compare, ast.IfExp, ast.Call, ast.Slice,
)  # fmt: skip
_NO_OPERATORS = {ast.LShift: "LShift", ast.RShift: "RShift", ast.BitXor: "BitXor", ast.MatMult: "MatMult"}


class ExpressionError(UsageError):
    """Text that is no expression, or uses what expressions do not have."""


class EvaluationError(Refused):
    """An expression that cannot be computed with these values."""


class Fields:
    """A message on the wire as an expression sees it, by field: null is not a number, base64 is numbers."""

    __slots__ = ("_message", "_schema", "_type")

    def __init__(self, message: Mapping[str, Any], type_name: str, schema: Schema) -> None:
        self._message = message
        self._type = type_name
        self._schema = schema

    def __getitem__(self, name: str) -> Any:
        value = self._message[name]
        field = self._schema.field(self._type, name)
        return value if field is None else self._shown(value, field.type, field.array >= 0)

    def _shown(self, value: Any, type_name: str, is_array: bool) -> Any:
        if is_array:
            if type_name in BYTES:
                return byte_values(value)
            return [self._shown(each, type_name, False) for each in value]
        if type_name in FLOATS:
            return math.nan if value is None else value
        if type_name in TIMES:
            return Time(value)
        return Fields(value, type_name, self._schema) if isinstance(value, Mapping) else value


class Time:
    """A time or duration of a message, with rospy's `to_sec()` and `to_nsec()`."""

    __slots__ = ("_time",)

    def __init__(self, time: Mapping[str, int]) -> None:
        self._time = time

    def __getitem__(self, name: str) -> Any:
        secs, nsecs = self._time["secs"], self._time["nsecs"]
        known = {"to_sec": lambda: secs + 1e-9 * nsecs, "to_nsec": lambda: secs * 10**9 + nsecs}
        return known.get(name) or self._time[name]


class _Math:
    """`math`, whose names are its attributes."""

    def __getitem__(self, name: str) -> Any:
        return MATH[name]


class Expression:
    """A parsed expression. It may use the names in `variables`; `m` is a message of the schema's root type.

    Raises:
        ExpressionError: it is not valid. UnknownName: a field of `m` that does not exist.
    """

    def __init__(self, text: str, variables: tuple[str, ...] = (), schema: Schema | None = None) -> None:
        if len(text) > _LONGEST:
            raise ExpressionError(f"the expression is longer than {_LONGEST} characters")
        self.text = text
        self._schema = schema
        try:
            self._tree = parsed(text)
            _Check(text, variables, schema).kind_of(self._tree)
        except SyntaxError as error:
            raise ExpressionError(f"{text!r} is not a valid expression: {error.msg}") from None
        except RecursionError:
            raise ExpressionError(f"the expression {text[:40]!r}... is nested too deeply") from None

    def __call__(self, **names: Any) -> Any:
        """The value with these variables. Raises EvaluationError when it cannot be computed."""
        if self._schema is not None and "m" in names:
            names["m"] = Fields(names["m"], self._schema.root, self._schema)
        try:
            # Lists are those of the message, and there are no loops: no step needs to be counted.
            return evaluate(self._tree, _NAMES | names, (Fields, Time, _Math), math.inf)
        except (ArithmeticError, ValueError, TypeError, LookupError, NameError, RecursionError) as error:
            raise EvaluationError(f"cannot compute {self.text!r}: {error}") from None


_NAMES = {**_FUNCTIONS, **_CONSTANTS, "math": _Math()}


class _Kind(NamedTuple):
    """What is known of a value before it is computed: its type (None: unknown) and the lists around it."""

    type: str | None
    depth: int = 0


_ANYTHING = _Kind(None)


class _Check:
    """One look at a tree before it is evaluated. Raises ExpressionError with the place."""

    def __init__(self, text: str, variables: tuple[str, ...], schema: Schema | None) -> None:
        self._text = text
        self._variables = variables
        self._schema = schema

    def kind_of(self, node: ast.AST) -> _Kind:
        if isinstance(node, ast.Name):
            return self._name(node)
        if isinstance(node, ast.Attribute):
            return self._attribute(node)
        if isinstance(node, ast.Subscript):
            return self._subscript(node)
        if not isinstance(node, _OPERATIONS):
            raise self._refusal(f"there is no {type(node).__name__} in expressions", node)
        if isinstance(node, ast.Constant) and not isinstance(node.value, bool | int | float | str | None):
            raise self._refusal(f"{node.value!r} is neither a number nor text", node)
        if isinstance(node, ast.BinOp) and type(node.op) in _NO_OPERATORS:
            raise self._refusal(f"there is no operator {_NO_OPERATORS[type(node.op)]}", node)
        if isinstance(node, ast.BinOp) and any(_is_text(side) for side in (node.left, node.right)):
            raise self._refusal("a text is no number", node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Invert):
            raise self._refusal("there is no operator ~", node)
        if isinstance(node, ast.Call):
            self._function(node)
        for part in ast.iter_child_nodes(node):
            if isinstance(part, ast.expr) and not (isinstance(node, ast.Call) and part is node.func):
                self.kind_of(part)
        return _ANYTHING

    def _name(self, node: ast.Name) -> _Kind:
        name = node.id
        if name in self._variables:
            return _Kind(self._schema.root if self._schema is not None and name == "m" else None)
        if name in _CONSTANTS:
            return _ANYTHING
        if name in _FUNCTIONS:
            raise self._refusal(f"{name} is a function: write {name}(...)", node)
        near = closest(name, [*self._variables, *_CONSTANTS, *_FUNCTIONS])
        suggestion = f", did you mean {near!r}" if near else ""
        known = " and ".join([*self._variables, "the names of the math module"])
        raise self._refusal(f"no name {name!r} (there are {known}{suggestion})", node)

    def _function(self, call: ast.Call) -> None:
        """`sin` or `math.sin`, `abs` and its like; a method of a text, of a list or of a time."""
        if call.keywords or any(isinstance(argument, ast.Starred) for argument in call.args):
            raise self._refusal("functions take plain arguments only", call)
        node = call.func
        if isinstance(node, ast.Attribute) and _of_math(node) is None and node.attr in _METHODS:
            self.kind_of(node.value)
        elif (_of_math(node) or (node.id if isinstance(node, ast.Name) else None)) not in _FUNCTIONS:
            raise self._refusal(f"there is no function {ast.unparse(node)!r}", node)

    def _attribute(self, node: ast.Attribute) -> _Kind:
        if _of_math(node) in _CONSTANTS:
            return _ANYTHING
        kind, name = self.kind_of(node.value), node.attr
        if kind.type is None or kind.depth or self._schema is None:
            raise self._refusal(f"{ast.unparse(node.value)!r} has no field {name!r}", node)
        known = ["secs", "nsecs"] if kind.type in TIMES else [f.name for f in self._schema.fields(kind.type)]
        if name not in known:
            raise ExpressionError(f"{self._text!r}: {UnknownName('field', name, known, f'in {kind.type}')}")
        field = self._schema.field(kind.type, name)
        return _Kind("int32") if field is None else _Kind(field.type, int(field.array >= 0))

    def _subscript(self, node: ast.Subscript) -> _Kind:
        kind = self.kind_of(node.value)
        if kind.type is not None and kind.depth == 0 and kind.type != "string":
            raise self._refusal(f"{ast.unparse(node.value)!r} is no array", node)
        self.kind_of(node.slice)
        return kind if isinstance(node.slice, ast.Slice) else _Kind(kind.type, max(kind.depth - 1, 0))

    def _refusal(self, reason: str, node: ast.AST) -> ExpressionError:
        place = getattr(node, "col_offset", 0) + 1
        return ExpressionError(f"{self._text!r} is not a valid expression: {reason} (at character {place})")


def _of_math(node: ast.expr) -> str | None:
    """`pi` of `math.pi`."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "math":
        return node.attr
    return None


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
