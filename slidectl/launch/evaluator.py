"""What `$(eval ...)` may compute: a small safe evaluator over the syntax tree, never Python's own.

Names are those that it is given and nothing else: no attributes but a few methods of text, no imports, no names with
two underscores. Work and sizes are kept within bounds, so that every expression comes to an end.
"""

from __future__ import annotations

import ast
import operator
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from slidectl.launch.functions import FUNCTIONS, METHODS, TAKE_KEYWORDS, WATCHED, check_length, formatted
from slidectl.operators import ARITHMETIC, COMPARISONS, MATH, MOST_BITS

LONGEST = 4000
MOST_STEPS = 100_000
"""Steps of the walk, plus one for each value in every list that it makes."""
_OTHER_METHODS: dict[type[Any], set[str]] = {
    dict: {"get", "items", "keys", "values"},
    list: {"count", "index"},
    tuple: {"count", "index"},
}


class ExpressionError(ValueError):
    """An expression that is not valid, or cannot be computed."""


def evaluate(text: str, names: Mapping[str, Any]) -> Any:
    """The value of an expression. It may use `names`, the math module's names, and those of functions.py.

    Raises:
        ExpressionError: with the reason, without the place.
    """
    if "__" in text:
        raise ExpressionError("may not contain double underscores")
    if len(text) > LONGEST:
        raise ExpressionError(f"is longer than {LONGEST} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's advice about what is written here is for nobody
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ExpressionError(f"is not valid: {getattr(error, 'msg', None) or error or 'too deep'}") from None
    try:
        return _Evaluation({**MATH, **FUNCTIONS, **names}).value(tree)
    except ExpressionError:
        raise
    except (ArithmeticError, ValueError, TypeError, LookupError, RecursionError) as error:
        raise ExpressionError(f"cannot be computed: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    return f"no key {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__


class _Evaluation:
    """One walk over a tree. Each kind of node has a method named after it; a kind without one is refused."""

    def __init__(self, names: dict[str, Any]) -> None:
        self.names = names
        self.steps = 0

    def value(self, node: ast.AST) -> Any:
        kind = type(node).__name__
        compute = getattr(self, f"_{kind.lower()}", None)
        if compute is None:
            raise ExpressionError(f"uses {kind}, which expressions here do not have")
        return self.charged(compute(node))

    def charged(self, value: Any) -> Any:
        """The value, counted with all that is in it, as often as it is in it: later steps may look at each."""
        pending = [value]
        while pending:
            self.steps += 1
            if self.steps > MOST_STEPS:
                raise ExpressionError(f"takes more than {MOST_STEPS} steps")
            item = _sized(pending.pop())
            if isinstance(item, dict):
                pending += [*item.keys(), *item.values()]
            elif isinstance(item, list | tuple | set | type({}.items()) | type({}.keys()) | type({}.values())):
                pending += item
        return value

    # --- values ---------------------------------------------------------------------------------------------------

    def _constant(self, node: ast.Constant) -> Any:
        if node.value is None or isinstance(node.value, bool | int | float | str):
            return node.value
        raise ExpressionError(f"{node.value!r} is neither a number nor text")

    def _name(self, node: ast.Name) -> Any:
        if node.id not in self.names:
            raise ExpressionError(f"there is no name {node.id!r}; {_known(self.names)}")
        return self.names[node.id]

    def _list(self, node: ast.List) -> list[Any]:
        return [self.value(element) for element in node.elts]

    def _tuple(self, node: ast.Tuple) -> tuple[Any, ...]:
        return tuple(self.value(element) for element in node.elts)

    def _set(self, node: ast.Set) -> set[Any]:
        return {self.value(element) for element in node.elts}

    def _dict(self, node: ast.Dict) -> dict[Any, Any]:
        if None in node.keys:
            raise ExpressionError("uses **, which expressions here do not have")
        return {self.value(key): self.value(value) for key, value in zip(node.keys, node.values, strict=True) if key}

    def _listcomp(self, node: ast.ListComp) -> list[Any]:
        return list(self._each(node.elt, node.generators))

    def _setcomp(self, node: ast.SetComp) -> set[Any]:
        return set(self._each(node.elt, node.generators))

    def _dictcomp(self, node: ast.DictComp) -> dict[Any, Any]:
        return dict(self._each(ast.Tuple([node.key, node.value], ast.Load()), node.generators))

    def _joinedstr(self, node: ast.JoinedStr) -> str:
        text = "".join(str(self.value(part)) for part in node.values)
        check_length(len(text))
        return text

    def _formattedvalue(self, node: ast.FormattedValue) -> str:
        value = self.value(node.value)
        if node.conversion >= 0:
            value = repr(value) if chr(node.conversion) == "r" else str(value)
        return formatted(value, self.value(node.format_spec) if node.format_spec else "")

    def _generatorexp(self, node: ast.GeneratorExp) -> list[Any]:
        return list(self._each(node.elt, node.generators))

    def _each(self, element: ast.expr, generators: list[ast.comprehension]) -> Iterator[Any]:
        if not generators:
            yield self.value(element)
            return
        generator, *rest = generators
        outer = self.names
        for item in list(self.value(generator.iter)):
            self.charged(item)
            self.names = {**outer, **_bound(generator.target, item)}
            if all(self.value(condition) for condition in generator.ifs):
                yield from self._each(element, rest)
        self.names = outer

    # --- operators ------------------------------------------------------------------------------------------------

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
            if not COMPARISONS[type(test)](left, right):
                return False
            left = right
        return True

    def _ifexp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    # --- calls, methods, elements ---------------------------------------------------------------------------------

    def _call(self, node: ast.Call) -> Any:
        if any(isinstance(argument, ast.Starred) for argument in node.args):
            raise ExpressionError("functions take plain arguments only")
        function = self._method(node.func) if isinstance(node.func, ast.Attribute) else self.value(node.func)
        if not callable(function):
            raise ExpressionError(f"{ast.unparse(node.func)} is no function")
        arguments = [self.value(argument) for argument in node.args]
        if function is map:
            return [arguments[0](*items) for items in zip(*arguments[1:], strict=False)]
        return function(*arguments, **self._keywords(node, function))

    def _keywords(self, node: ast.Call, function: Any) -> dict[str, Any]:
        if node.keywords and not any(function is known for known in TAKE_KEYWORDS):
            raise ExpressionError(f"{ast.unparse(node.func)} takes plain arguments only")
        given = {word.arg: self.value(word.value) for word in node.keywords if word.arg is not None}
        if len(given) < len(node.keywords):
            raise ExpressionError("uses **, which expressions here do not have")
        return given

    def _method(self, node: ast.Attribute) -> Callable[..., Any]:
        owner = self.value(node.value)
        known = METHODS if isinstance(owner, str) else _OTHER_METHODS.get(type(owner), set())
        if node.attr not in known:
            raise ExpressionError(f"{ast.unparse(node.value)} has no {node.attr!r} here")
        if isinstance(owner, str) and node.attr in WATCHED:
            return WATCHED[node.attr](owner)
        method: Callable[..., Any] = getattr(owner, node.attr)
        return method

    def _subscript(self, node: ast.Subscript) -> Any:
        owner = self.value(node.value)
        if not isinstance(node.slice, ast.Slice):
            return owner[self.value(node.slice)]
        bounds = (node.slice.lower, node.slice.upper, node.slice.step)
        return owner[slice(*[self.value(bound) if bound else None for bound in bounds])]


def _bound(target: ast.expr, item: Any) -> dict[str, Any]:
    """The names of a comprehension with what they stand for now."""
    if isinstance(target, ast.Name):
        return {target.id: item}
    if not isinstance(target, ast.Tuple | ast.List):
        raise ExpressionError("a comprehension here has names after `for`, and nothing else")
    pairs = zip(target.elts, list(item), strict=True)
    return {name: value for below, part in pairs for name, value in _bound(below, part).items()}


def _known(names: Mapping[str, Any]) -> str:
    own = sorted(name for name in names if name not in MATH and name not in FUNCTIONS)
    return f"there are {', '.join(own)}, and the names of the math module"


def _sized(value: Any) -> Any:
    """The value, if it has a size that one can go on with."""
    if isinstance(value, str):
        check_length(len(value))
    if isinstance(value, int) and value.bit_length() > MOST_BITS:
        raise ExpressionError("has a number that is too large")
    return value


def _product(left: Any, right: Any) -> Any:
    for count, text in ((left, right), (right, left)):
        if isinstance(count, int) and hasattr(text, "__len__"):
            check_length(count * len(text))
    return left * right


def _remainder(left: Any, right: Any) -> Any:
    """Also Python's `'%d' % 1`, with widths that fit on a line."""
    if isinstance(left, str):
        if re.search(r"[*]|\d{4}", left):
            raise ExpressionError("formats something with a width that is too large")
        check_length(left.count("%") * len(str(right)))
    return left % right


def _shifted(left: Any, right: Any) -> Any:
    if isinstance(left, int) and isinstance(right, int) and left.bit_length() + right > MOST_BITS:
        raise ExpressionError("has a number that is too large")
    return left << right


_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    **ARITHMETIC,
    ast.Mult: _product,
    ast.Mod: _remainder,
    ast.LShift: _shifted,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}
