"""A small evaluator of arithmetic, conditions and lists: expressions over messages, angles in YAML, `-k` of tests.

Against: a file or a page in a browser that somebody else wrote. An expression can use only the names that are passed
in, no attributes but fields and a few methods, and it ends: steps, whole numbers and lengths are bounded. It never
calls Python's `eval`. xacro and `$(eval ...)` of launch files have all of Python's expressions, by
slidectl.description.guarded_eval.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import reduce
from typing import Any

MOST_STEPS = 100_000
"""The most steps: one for each node, for each value in a list that is made, and for each 100 characters of text."""
_MOST_BITS = 4096
"""Limit of a whole number."""
_MOST_LENGTH = 100_000
"""The most characters of a text, and items of a list that an operator makes."""
_MOST_DIGITS = 300
_MOST_FACTORS = 500
"""Factorials up to this one are within the limit of a whole number."""


class ExpressionError(ValueError):
    """An expression uses something that is not allowed, or takes too long. The text is a clause without a subject."""


# --- functions and operators ------------------------------------------------------------------------------------------


def _checked(value: Any) -> Any:
    """The value. Raises ExpressionError: it is too large."""
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        raise ExpressionError("a number is too large")
    if isinstance(value, str) and len(value) > _MOST_LENGTH:
        raise ExpressionError("a text is too long")
    return value


def _product(left: Any, right: Any) -> Any:
    for count, items in ((left, right), (right, left)):
        if isinstance(count, int) and hasattr(items, "__len__") and count * len(items) > _MOST_LENGTH:
            raise ExpressionError("a text or list is too long")
    return _checked(left * right)


def _power(base: Any, exponent: Any) -> Any:
    if isinstance(base, int) and isinstance(exponent, int) and base.bit_length() * exponent > _MOST_BITS:
        raise OverflowError(f"{base} ** {exponent} is too large")
    return base**exponent


def _shifted(left: Any, right: Any) -> Any:
    if isinstance(left, int) and isinstance(right, int) and left.bit_length() + right > _MOST_BITS:
        raise ExpressionError("a number is too large")
    return left << right


def _remainder(left: Any, right: Any) -> Any:
    if isinstance(left, str | bytes):
        raise TypeError("% here is for numbers")
    return left % right


def _rounded(number: Any, ndigits: int | None = None) -> Any:
    if ndigits is not None and abs(ndigits) > _MOST_DIGITS:  # for a whole number Python computes 10**digits
        raise ExpressionError("it rounds to too many digits")
    return round(number, ndigits)


def _of_few(function: Callable[..., int]) -> Callable[..., int]:
    """A function of whole numbers with that many factors, for small numbers."""

    def bounded(number: int, *others: int) -> int:
        if isinstance(number, int) and number > _MOST_FACTORS:
            raise ExpressionError(f"too many factors up to {number}")
        return function(number, *others)

    return bounded


def _numbers(values: Iterable[Any]) -> list[Any]:
    found = list(values)
    if not all(isinstance(value, int | float) for value in found):
        raise TypeError("sums and products here are of numbers only")
    return found


def _range(*bounds: int) -> list[int]:
    numbers = range(*bounds)
    if len(numbers) > _MOST_LENGTH:
        raise ExpressionError("a text or list is too long")
    return list(numbers)


MATH: dict[str, Any] = {
    **{name: value for name, value in vars(math).items() if not name.startswith("_") and name != "sumprod"},
    **{name: _of_few(getattr(math, name)) for name in ("factorial", "comb", "perm")},
    "prod": lambda values, start=1: reduce(_product, _numbers(values), start),
    "lcm": lambda *values: reduce(lambda one, other: _checked(math.lcm(one, other)), values, 1),
}
"""The names of the math module."""
FUNCTIONS: dict[str, Any] = {
    "abs": abs, "all": all, "any": any, "bool": bool, "divmod": divmod, "float": float, "int": int, "len": len,
    "list": list, "max": max, "min": min, "range": _range, "round": _rounded, "sorted": sorted, "str": str,
    "sum": lambda values, start=0: sum(_numbers(values), start), "tuple": tuple,
    "enumerate": lambda values, start=0: list(enumerate(values, start)),
    "reversed": lambda values: list(reversed(values)), "zip": lambda *values: list(zip(*values, strict=False)),
}  # fmt: skip
"""Python's own functions."""
_METHODS: dict[type[Any], frozenset[str]] = {
    str: frozenset({
        "count", "endswith", "find", "index", "isalnum", "isalpha", "isdigit", "islower", "isspace", "isupper", "lower",
        "lstrip", "removeprefix", "removesuffix", "rfind", "rstrip", "split", "startswith", "strip", "upper",
    }),
    list: frozenset({"count", "index"}),
    tuple: frozenset({"count", "index"}),
    float: frozenset({"is_integer"}),
}  # fmt: skip
"""Methods, none of which makes something larger."""
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda left, right: _checked(left + right), ast.Sub: operator.sub, ast.Mult: _product,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: _remainder, ast.Pow: _power,
    ast.LShift: _shifted, ast.RShift: operator.rshift, ast.BitAnd: operator.and_, ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}  # fmt: skip
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Invert: operator.invert,
}  # fmt: skip
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt,
    ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda item, values: item in values, ast.NotIn: lambda item, values: item not in values,
}  # fmt: skip


# --- the evaluator -------------------------------------------------------------------------------------------------


def parsed(text: str) -> ast.expr:
    """The syntax tree of an expression. Raises SyntaxError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the user cannot act on Python's warnings about this code
            return ast.parse(text.strip(), "<expression>", "eval").body
    except (RecursionError, MemoryError):
        raise SyntaxError("the expression is nested too deeply") from None
    except SyntaxError:
        raise
    except ValueError as error:  # characters that source code cannot contain
        raise SyntaxError(str(error)) from None


def evaluate(
    tree: ast.expr, names: Mapping[str, Any], dotted: tuple[type[Any], ...] = (), most_steps: float = MOST_STEPS
) -> Any:
    """The value of a parsed expression in `names`. Objects of the types `dotted` give their items as attributes.

    An expression may call everything in `names`, with any arguments: it must be safe to do so.

    Raises:
        ExpressionError: it uses what expressions here do not have, or takes too many steps.
        NameError: there is no such name. Also what Python's operators and the functions raise.
    """
    return _Evaluation(names, dotted, most_steps).value(tree)


class _Evaluation:
    """One walk over a syntax tree. The method for a kind of node has its name; a kind without one is refused."""

    def __init__(self, names: Mapping[str, Any], dotted: tuple[type[Any], ...], most_steps: float) -> None:
        self.names = names
        self.dotted = dotted
        self.most_steps = most_steps
        self.steps = 0

    def value(self, node: ast.AST) -> Any:
        return self.charged(self.uncharged(node))

    def uncharged(self, node: ast.AST) -> Any:
        """The value, without counting its size: for callers that use only one element of it."""
        kind = type(node).__name__
        compute = getattr(self, f"_{kind.lower()}", None)
        if compute is None:
            raise ExpressionError(f"uses {kind}, which expressions here do not have")
        return compute(node)

    def charged(self, value: Any) -> Any:
        """Return the value after counting all its parts, repeated ones again: later steps may visit each of them."""
        pending = [value]
        while pending:
            item = _checked(pending.pop())
            self.steps += 1 + (len(item) // 100 if isinstance(item, str) else 0)
            if self.steps > self.most_steps:
                raise ExpressionError(f"takes more than {self.most_steps} steps")
            if isinstance(item, list | tuple):
                pending += item
        return value

    def _constant(self, node: ast.Constant) -> Any:
        if node.value is None or isinstance(node.value, bool | int | float | str):
            return node.value
        raise ExpressionError(f"{node.value!r} is neither a number nor text")

    def _name(self, node: ast.Name) -> Any:
        try:
            return self.names[node.id]
        except KeyError:
            raise NameError(f"name {node.id!r} is not defined", name=node.id) from None

    def _list(self, node: ast.List) -> list[Any]:
        return [self.value(element) for element in node.elts]

    def _tuple(self, node: ast.Tuple) -> tuple[Any, ...]:
        return tuple(self.value(element) for element in node.elts)

    def _listcomp(self, node: ast.ListComp | ast.GeneratorExp) -> list[Any]:
        return list(self._each(node.elt, node.generators))

    _generatorexp = _listcomp

    def _each(self, element: ast.expr, generators: list[ast.comprehension]) -> Iterator[Any]:
        if not generators:
            yield self.value(element)
            return
        generator, *rest = generators
        outer = self.names
        for item in list(self.value(generator.iter)):
            self.charged(item)
            # The values of outer names may be computed on access.
            self.names = ChainMap(_bound(generator.target, item), outer)  # type: ignore[arg-type]  # never written to
            if all(self.value(condition) for condition in generator.ifs):
                yield from self._each(element, rest)
        self.names = outer

    def _binop(self, node: ast.BinOp) -> Any:
        apply = _BINARY.get(type(node.op))
        if apply is None:
            raise ExpressionError(f"uses {type(node.op).__name__}, which expressions here do not have")
        return apply(self.value(node.left), self.value(node.right))

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        return _UNARY[type(node.op)](self.value(node.operand))

    def _boolop(self, node: ast.BoolOp) -> Any:
        result = None
        for part in node.values:
            result = self.value(part)
            if bool(result) is isinstance(node.op, ast.Or):
                break
        return result

    def _compare(self, node: ast.Compare) -> bool:
        left = self.value(node.left)
        for test, term in zip(node.ops, node.comparators, strict=True):
            right = self.value(term)
            if not _COMPARISONS[type(test)](left, right):
                return False
            left = right
        return True

    def _ifexp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _call(self, node: ast.Call) -> Any:
        function = self.value(node.func)
        if not callable(function):
            raise ExpressionError(f"{ast.unparse(node.func)} is not a function")
        named = {word.arg: self.value(word.value) for word in node.keywords if word.arg is not None}
        if len(named) < len(node.keywords):
            raise ExpressionError("uses **, which expressions here do not have")
        return function(*[self.value(argument) for argument in node.args], **named)

    def _attribute(self, node: ast.Attribute) -> Any:
        owner = self.uncharged(node.value)
        if isinstance(owner, self.dotted):
            try:
                return owner[node.attr]
            except KeyError:
                raise NameError(f"name {node.attr!r} is not defined", name=node.attr) from None
        known = next((names for kind, names in _METHODS.items() if isinstance(owner, kind)), frozenset())
        if node.attr not in known:
            raise ExpressionError(f"{ast.unparse(node.value)} has no {node.attr!r} here")
        return getattr(self.charged(owner), node.attr)

    def _subscript(self, node: ast.Subscript) -> Any:
        owner = self.uncharged(node.value)
        if not isinstance(node.slice, ast.Slice):
            return owner[self.value(node.slice)]
        bounds = (node.slice.lower, node.slice.upper, node.slice.step)
        return owner[slice(*[self.value(bound) if bound else None for bound in bounds])]


def _bound(target: ast.expr, item: Any) -> dict[str, Any]:
    """The loop variables of a comprehension and their current values."""
    if isinstance(target, ast.Name):
        return {target.id: item}
    if not isinstance(target, ast.Tuple | ast.List):
        raise ExpressionError("only names may follow `for` in a comprehension")
    pairs = zip(target.elts, list(item), strict=True)
    return {name: value for below, part in pairs for name, value in _bound(below, part).items()}
