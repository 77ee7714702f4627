"""A small safe evaluator over the syntax tree, never Python's own: `$(eval ...)` of launch files, `${...}` of xacro.

Names are those that it is given and nothing else: no attributes but a few methods, no imports, no names that begin
with two underscores. Work and sizes are kept within bounds, so that every expression comes to an end.
"""

from __future__ import annotations

import ast
import warnings
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from slidectl.operators import BINARY, COMPARISONS, UNARY, methods
from slidectl.operators.functions import formatted
from slidectl.operators.sizes import check_bits, check_length

MOST_STEPS = 100_000
"""Steps of the walk, plus one for each value in every list that it makes, and one for each 100 letters of texts."""
_COLLECTIONS: tuple[type[Any], ...] = (
    list,
    tuple,
    set,
    frozenset,
    type({}.items()),
    type({}.keys()),
    type({}.values()),
)


class ExpressionError(ValueError):
    """An expression that uses what there is not, or that takes too long. Its text is a clause without a subject."""


def compute(text: str, names: Mapping[str, Any], dotted: tuple[type[Any], ...] = ()) -> Any:
    """The value of an expression. It may use `names`; mappings of the types `dotted` give their values as attributes.

    Whatever `names` holds, expressions may call: it must be safe to call with anything.

    Raises:
        SyntaxError: it is not valid.
        ExpressionError: it uses what expressions here do not have, or takes too many steps.
        NameError: there is no such name. Else what Python's operators and the functions raise.
    """
    tree = _parsed(text)
    for node in ast.walk(tree):
        name = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "arg", None)
        if isinstance(name, str) and name.startswith("__"):
            raise ExpressionError(f"uses the invalid name {name!r}, with double underscores")
    return _Evaluation(names, dotted).value(tree)


def _parsed(text: str) -> ast.expr:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's advice about what is written here is for nobody
            return ast.parse(text.strip(), "<expression>", "eval").body
    except (RecursionError, MemoryError):
        raise SyntaxError("the expression is nested too deeply") from None
    except SyntaxError:
        raise
    except ValueError as error:  # letters that no source can have
        raise SyntaxError(str(error)) from None


class _Evaluation:
    """One walk over a tree. Each kind of node has a method named after it; a kind without one is refused."""

    def __init__(self, names: Mapping[str, Any], dotted: tuple[type[Any], ...]) -> None:
        self.names = names
        self.dotted = dotted
        self.steps = 0

    def value(self, node: ast.AST) -> Any:
        return self.charged(self.found(node))

    def found(self, node: ast.AST) -> Any:
        """The value, uncounted: for those of which nothing but an element is looked at."""
        kind = type(node).__name__
        compute = getattr(self, f"_{kind.lower()}", None)
        if compute is None:
            raise ExpressionError(f"uses {kind}, which expressions here do not have")
        return compute(node)

    def charged(self, value: Any) -> Any:
        """The value, counted with all that is in it, as often as it is in it: later steps may look at each."""
        pending = [value]
        while pending:
            item = pending.pop()
            self.steps += 1 + _weight(item)
            if self.steps > MOST_STEPS:
                raise ExpressionError(f"takes more than {MOST_STEPS} steps")
            if isinstance(item, dict):
                pending += [*dict.keys(item), *dict.values(item)]
            elif isinstance(item, _COLLECTIONS):
                pending += item
        return value

    # --- values ---------------------------------------------------------------------------------------------------

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
        return list(self._each_of(node.elts))

    def _tuple(self, node: ast.Tuple) -> tuple[Any, ...]:
        return tuple(self._each_of(node.elts))

    def _set(self, node: ast.Set) -> set[Any]:
        return set(self._each_of(node.elts))

    def _each_of(self, elements: list[ast.expr]) -> Iterator[Any]:
        """The values of a list of elements, arguments too, with what stars unpack."""
        for element in elements:
            if isinstance(element, ast.Starred):
                yield from list(self.value(element.value))
            else:
                yield self.value(element)

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
            self.names = _within(outer, _bound(generator.target, item))
            if all(self.value(condition) for condition in generator.ifs):
                yield from self._each(element, rest)
        self.names = outer

    def _lambda(self, node: ast.Lambda) -> Callable[..., Any]:
        spec, names = node.args, [argument.arg for argument in node.args.args]
        if spec.vararg or spec.kwarg or spec.kwonlyargs or spec.posonlyargs:
            raise ExpressionError("has a lambda with other than plain arguments")
        defaults = [self.value(default) for default in spec.defaults]
        outer = self.names

        def function(*values: Any, **named: Any) -> Any:
            given = dict(zip(names, values, strict=False)) | named
            if len(given) != len(values) + len(named) or not set(given) <= set(names):
                raise TypeError(f"a lambda takes {', '.join(names) or 'nothing'}, each once")
            given = dict(zip(names[len(names) - len(defaults) :], defaults, strict=True)) | given
            if len(given) < len(names):
                raise TypeError(f"a lambda takes {len(names)} arguments, not {len(values) + len(named)}")
            caller, self.names = self.names, _within(outer, given)
            try:
                return self.value(node.body)
            finally:
                self.names = caller

        return function

    # --- operators ------------------------------------------------------------------------------------------------

    def _binop(self, node: ast.BinOp) -> Any:
        apply = BINARY.get(type(node.op))
        if apply is None:
            raise ExpressionError(f"uses {type(node.op).__name__}, which expressions here do not have")
        return apply(self.value(node.left), self.value(node.right))

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        return UNARY[type(node.op)](self.value(node.operand))

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

    # --- calls, attributes, elements ------------------------------------------------------------------------------

    def _call(self, node: ast.Call) -> Any:
        function = self.value(node.func)
        if not callable(function):
            raise ExpressionError(f"{ast.unparse(node.func)} is no function")
        arguments = list(self._each_of(node.args))
        named: dict[str, Any] = {}
        for word in node.keywords:
            value = self.value(word.value)
            named.update(value if word.arg is None else {word.arg: value})
        return function(*arguments, **named)

    def _attribute(self, node: ast.Attribute) -> Any:
        owner = self.found(node.value)
        if isinstance(owner, self.dotted) and node.attr not in vars(dict):
            try:
                return owner[node.attr]
            except KeyError:
                raise NameError(f"name {node.attr!r} is not defined", name=node.attr) from None
        method = methods.find(owner, node.attr)
        if method is None:
            raise ExpressionError(f"{ast.unparse(node.value)} has no {node.attr!r} here")

        def call(*values: Any, **named: Any) -> Any:
            self.charged(owner)  # each time: the owner may have grown
            return method(*values, **named)

        return call

    def _subscript(self, node: ast.Subscript) -> Any:
        owner = self.found(node.value)
        if not isinstance(node.slice, ast.Slice):
            return owner[self.value(node.slice)]
        bounds = (node.slice.lower, node.slice.upper, node.slice.step)
        return owner[slice(*[self.value(bound) if bound else None for bound in bounds])]


def _within(outer: Mapping[str, Any], names: dict[str, Any]) -> Mapping[str, Any]:
    """The names, and behind them the outer ones, whose values may be found out only when they are asked for."""
    return ChainMap(names, outer)  # type: ignore[arg-type]  # nothing is ever set


def _bound(target: ast.expr, item: Any) -> dict[str, Any]:
    """The names of a comprehension with what they stand for now."""
    if isinstance(target, ast.Name):
        return {target.id: item}
    if not isinstance(target, ast.Tuple | ast.List):
        raise ExpressionError("a comprehension here has names after `for`, and nothing else")
    pairs = zip(target.elts, list(item), strict=True)
    return {name: value for below, part in pairs for name, value in _bound(below, part).items()}


def _weight(item: Any) -> int:
    """Steps for the size of a number or text. Raises TooLargeError when it is one that nobody can go on with."""
    if isinstance(item, int):
        check_bits(item.bit_length())
    elif isinstance(item, str | bytes):
        check_length(len(item))
        return len(item) // 100
    return 0
