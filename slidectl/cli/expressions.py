"""A small safe evaluator: numbers, comparisons, names of the math module, and fields of a message.

An expression is parsed once into closures that know nothing but the names they were given. There are no attributes
of Python objects, no imports and no calls but those listed here; numbers are kept to a size that ends, as in all
languages of expressions here (operators/).
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from slidectl.cli.schema import BYTES, FLOATS, TIMES, Schema
from slidectl.cli.yamlform import byte_values
from slidectl.errors import Refused, UnknownName, UsageError, closest
from slidectl.operators import BINARY, COMPARISONS
from slidectl.operators.functions import FUNCTIONS
from slidectl.operators.mathematics import MATH

Names = Mapping[str, Any]
Compute = Callable[[Names], Any]

_LONGEST = 4000
_CONSTANTS: dict[str, Any] = {name: getattr(math, name) for name in ("pi", "e", "tau", "inf", "nan")}
_FUNCTIONS: dict[str, Callable[..., Any]] = {name: value for name, value in MATH.items() if callable(value)} | {
    name: FUNCTIONS[name]
    for name in ("abs", "min", "max", "round", "len", "int", "float", "bool", "sum", "any", "all", "str")
}
_TEXT_METHODS = ("startswith", "endswith", "lower", "upper", "strip", "find", "count", "isdigit")
_LIST_METHODS = ("index", "count")
_NO_OPERATORS = (ast.LShift, ast.RShift, ast.BitXor)


class ExpressionError(UsageError):
    """Text that is no expression, or uses what expressions do not have."""


class EvaluationError(Refused):
    """An expression that cannot be computed with these values."""


class _Kind(NamedTuple):
    """What is known of a value before it is computed: its type (None: unknown) and the lists around it."""

    type: str | None
    depth: int = 0


_ANYTHING = _Kind(None)


class Expression:
    """A parsed expression. It may use the names in `variables`; `m` is a message of the schema's root type.

    Raises:
        ExpressionError: it is not valid. UnknownName: a field of `m` that does not exist.
    """

    def __init__(self, text: str, variables: tuple[str, ...] = (), schema: Schema | None = None) -> None:
        self.text = text
        self._variables = variables
        self._schema = schema
        try:
            self._compute = self._compile(_parsed(text))[0]
        except RecursionError:
            raise ExpressionError(f"the expression {text[:40]!r}... is nested too deeply") from None

    def __call__(self, **names: Any) -> Any:
        """The value with these variables. Raises EvaluationError when it cannot be computed."""
        try:
            return self._compute(names)
        except (ArithmeticError, ValueError, TypeError, LookupError, RecursionError) as error:
            raise EvaluationError(f"cannot compute {self.text!r}: {error}") from None

    def _compile(self, node: ast.AST) -> tuple[Compute, _Kind]:
        compiler = getattr(self, f"_{type(node).__name__.lower()}", None)
        if compiler is None:
            raise self._refusal(f"there is no {type(node).__name__} in expressions", node)
        result: tuple[Compute, _Kind] = compiler(node)
        return result

    def _plain(self, node: ast.AST) -> Compute:
        return self._compile(node)[0]

    def _refusal(self, reason: str, node: ast.AST) -> ExpressionError:
        place = getattr(node, "col_offset", 0) + 1
        return ExpressionError(f"{self.text!r} is not a valid expression: {reason} (at character {place})")

    # --- leaves -------------------------------------------------------------------------------------------------

    def _constant(self, node: ast.Constant) -> tuple[Compute, _Kind]:
        value = node.value
        if not (value is None or isinstance(value, bool | int | float | str)):
            raise self._refusal(f"{value!r} is neither a number nor text", node)
        return lambda _names: value, _ANYTHING

    def _name(self, node: ast.Name) -> tuple[Compute, _Kind]:
        name = node.id
        if name in self._variables:
            root = self._schema.root if self._schema is not None and name == "m" else None
            return lambda names: names[name], _Kind(root)
        if name in _CONSTANTS:
            value = _CONSTANTS[name]
            return lambda _names: value, _ANYTHING
        if name in _FUNCTIONS:
            raise self._refusal(f"{name} is a function: write {name}(...)", node)
        near = closest(name, [*self._variables, *_CONSTANTS, *_FUNCTIONS])
        suggestion = f", did you mean {near!r}" if near else ""
        known = " and ".join([*self._variables, "the names of the math module"])
        raise self._refusal(f"no name {name!r} (there are {known}{suggestion})", node)

    def _list(self, node: ast.List | ast.Tuple) -> tuple[Compute, _Kind]:
        parts = [self._plain(element) for element in node.elts]
        return lambda names: [part(names) for part in parts], _ANYTHING

    _tuple = _list

    # --- operators ----------------------------------------------------------------------------------------------

    def _binop(self, node: ast.BinOp) -> tuple[Compute, _Kind]:
        apply = BINARY.get(type(node.op))
        if apply is None or isinstance(node.op, _NO_OPERATORS):
            raise self._refusal(f"there is no operator {type(node.op).__name__}", node)
        left, right = self._plain(node.left), self._plain(node.right)
        return lambda names: apply(_number(left(names)), _number(right(names))), _ANYTHING

    def _unaryop(self, node: ast.UnaryOp) -> tuple[Compute, _Kind]:
        operand = self._plain(node.operand)
        if isinstance(node.op, ast.Not):
            return lambda names: not operand(names), _ANYTHING
        if isinstance(node.op, ast.Invert):
            raise self._refusal("there is no operator ~", node)
        sign = -1 if isinstance(node.op, ast.USub) else 1
        return lambda names: sign * _number(operand(names)), _ANYTHING

    def _boolop(self, node: ast.BoolOp) -> tuple[Compute, _Kind]:
        parts = [self._plain(value) for value in node.values]
        combine = all if isinstance(node.op, ast.And) else any
        return lambda names: combine(part(names) for part in parts), _ANYTHING

    def _compare(self, node: ast.Compare) -> tuple[Compute, _Kind]:
        terms = [self._plain(term) for term in (node.left, *node.comparators)]
        tests = [COMPARISONS[type(op)] for op in node.ops]

        def compare(names: Names) -> bool:
            values = [term(names) for term in terms]
            return all(test(values[i], values[i + 1]) for i, test in enumerate(tests))

        return compare, _ANYTHING

    def _ifexp(self, node: ast.IfExp) -> tuple[Compute, _Kind]:
        test, body, otherwise = self._plain(node.test), self._plain(node.body), self._plain(node.orelse)
        return lambda names: body(names) if test(names) else otherwise(names), _ANYTHING

    # --- calls, fields, elements --------------------------------------------------------------------------------

    def _call(self, node: ast.Call) -> tuple[Compute, _Kind]:
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self._refusal("functions take plain arguments only", node)
        if isinstance(node.func, ast.Attribute) and node.func.attr in _TIME_METHODS and not node.args:
            inner, convert = self._plain(node.func.value), _TIME_METHODS[node.func.attr]
            return lambda names: convert(inner(names)), _ANYTHING
        arguments = [self._plain(argument) for argument in node.args]
        function = self._function(node.func)
        return lambda names: function(names)(*[argument(names) for argument in arguments]), _ANYTHING

    def _function(self, node: ast.expr) -> Callable[[Names], Callable[..., Any]]:
        """`sin` or `math.sin`, `abs` and its like; a method of a text or of a list."""
        name = _of_math(node) or (node.id if isinstance(node, ast.Name) else None)
        if name in _FUNCTIONS:
            return lambda _names: _FUNCTIONS[name]
        if isinstance(node, ast.Attribute) and node.attr in (*_TEXT_METHODS, *_LIST_METHODS) and name is None:
            inner, method = self._plain(node.value), node.attr
            return lambda names: _method(inner(names), method)
        raise self._refusal(f"there is no function {ast.unparse(node)!r}", node)

    def _attribute(self, node: ast.Attribute) -> tuple[Compute, _Kind]:
        if (constant := _of_math(node)) in _CONSTANTS:
            return lambda _names: _CONSTANTS[constant], _ANYTHING
        inner, kind = self._compile(node.value)
        name = node.attr
        if kind.type is None or kind.depth or self._schema is None:
            raise self._refusal(f"{ast.unparse(node.value)!r} has no field {name!r}", node)
        known = ["secs", "nsecs"] if kind.type in TIMES else [f.name for f in self._schema.fields(kind.type)]
        if name not in known:
            raise ExpressionError(f"{self.text!r}: {UnknownName('field', name, known, f'in {kind.type}')}")
        field = self._schema.field(kind.type, name)
        if field is None:
            return lambda names: inner(names)[name], _Kind("int32")
        convert = _converter(field.type, field.array >= 0)
        return lambda names: convert(inner(names)[name]), _Kind(field.type, int(field.array >= 0))

    def _subscript(self, node: ast.Subscript) -> tuple[Compute, _Kind]:
        inner, kind = self._compile(node.value)
        if kind.type is not None and kind.depth == 0 and kind.type != "string":
            raise self._refusal(f"{ast.unparse(node.value)!r} is no array", node)
        if isinstance(node.slice, ast.Slice):
            bounds = [self._plain(b) if b else _nothing for b in (node.slice.lower, node.slice.upper, node.slice.step)]
            return lambda names: inner(names)[slice(*[bound(names) for bound in bounds])], kind
        index = self._plain(node.slice)
        return lambda names: inner(names)[index(names)], _Kind(kind.type, max(kind.depth - 1, 0))


def _parsed(text: str) -> ast.expr:
    if len(text) > _LONGEST:
        raise ExpressionError(f"the expression is longer than {_LONGEST} characters")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or str(error) or "too deep"
        raise ExpressionError(f"{text!r} is not a valid expression: {reason}") from None


def _of_math(node: ast.expr) -> str | None:
    """`pi` of `math.pi`."""
    is_math = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "math"
    return node.attr if is_math and isinstance(node, ast.Attribute) else None


def _method(value: Any, name: str) -> Callable[..., Any]:
    methods = _TEXT_METHODS if isinstance(value, str) else _LIST_METHODS if isinstance(value, list) else ()
    if name not in methods:
        raise TypeError(f"{value!r} has no {name}()")
    function: Callable[..., Any] = getattr(value, name)
    return function


def _nothing(_names: Names) -> None:
    return None


def _number(value: Any) -> Any:
    if isinstance(value, int | float):
        return value
    raise TypeError(f"{value!r} is no number")


def _converter(type_name: str, is_array: bool) -> Callable[[Any], Any]:
    """From the wire's form to what a comparison wants: null is not a number, base64 is numbers."""
    if is_array and type_name in BYTES:
        return byte_values
    if type_name in FLOATS:
        return _floats if is_array else _float
    return _itself


def _itself(value: Any) -> Any:
    return value


def _float(value: float | None) -> float:
    return math.nan if value is None else value


def _floats(values: list[float | None]) -> list[float]:
    return [math.nan if value is None else value for value in values]


_TIME_METHODS: dict[str, Callable[[Mapping[str, int]], Any]] = {
    "to_sec": lambda time: time["secs"] + 1e-9 * time["nsecs"],
    "to_nsec": lambda time: time["secs"] * 10**9 + time["nsecs"],
}
