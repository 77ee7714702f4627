"""A safe evaluator of Python expressions. It walks their syntax tree and never calls Python's own `eval`.

It evaluates `$(eval ...)` of launch files, `${...}` of xacro, sums in URDF and YAML, and expressions on the command
line. An expression can use only the names that are passed in: no attributes except a few methods, no imports, no
names that begin with two underscores. Steps and sizes are bounded, so that every expression ends.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import string
import warnings
from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

MOST_BITS = 4096
"""Limit of a whole number."""
MOST_LENGTH = 100_000
"""The most characters of a text, and items of a list."""
_WIDE = re.compile(r"\d{4}")


# --- bounds --------------------------------------------------------------------------------------------------------


class TooLargeError(ValueError):
    """The result of an operation would be too large."""


def check_bits(bits: int) -> None:
    """Raise TooLargeError when a whole number has more than MOST_BITS."""
    if bits > MOST_BITS:
        raise TooLargeError("a number is too large")


def check_length(count: int) -> None:
    """Raise TooLargeError when a text or list is longer than MOST_LENGTH."""
    if count > MOST_LENGTH:
        raise TooLargeError("a text or list is too long")


def check_widths(spec: str, star: bool = False) -> None:
    """Raise TooLargeError when a format has a width of four digits; with `star` also for a width given by `*`."""
    if _WIDE.search(spec) or (star and "*" in spec):
        raise TooLargeError("the width of something formatted is too large")


# --- numbers -------------------------------------------------------------------------------------------------------

_MOST_DIGITS = 300
_LARGEST_FACTORIAL = 500
"""Its factorial has 3768 bits and needs no check."""


def power(base: Any, exponent: Any) -> Any:
    """`base ** exponent`. Raises OverflowError when the result would have more than MOST_BITS."""
    if isinstance(base, int) and isinstance(exponent, int) and base.bit_length() * exponent > MOST_BITS:
        raise OverflowError(f"{base} ** {exponent} is too large")
    return base**exponent


def rounded(number: Any, ndigits: int | None = None) -> Any:
    """`round`. Raises TooLargeError for too many digits: for a whole number Python computes 10**digits."""
    if ndigits is not None and abs(ndigits) > _MOST_DIGITS:
        raise TooLargeError("it rounds to too many digits")
    return round(number, ndigits)


def factorial(number: int) -> int:
    """`math.factorial`. Raises TooLargeError."""
    _check_factors(number, _LARGEST_FACTORIAL, MOST_BITS)
    return math.factorial(number)


def comb(number: int, taken: int) -> int:
    """`math.comb`, which is less than 2**number. Raises TooLargeError."""
    _check_factors(number, MOST_BITS, taken)
    return math.comb(number, taken)


def perm(number: int, taken: int | None = None) -> int:
    """`math.perm`. Raises TooLargeError."""
    _check_factors(number, _LARGEST_FACTORIAL, MOST_BITS if taken is None else taken)
    return math.perm(number, taken)


def _check_factors(number: int, harmless: int, factors: int) -> None:
    """Raise TooLargeError for a product of `factors` factors up to `number`, unless `number` <= `harmless`."""
    if isinstance(number, int) and number > harmless and number.bit_length() * factors > MOST_BITS:
        raise TooLargeError(f"too many factors up to {number}")


def prod(values: Iterable[Any], start: Any = 1) -> Any:
    """`math.prod` of numbers. Raises TooLargeError; TypeError for values that are not numbers."""
    for value in values:
        if not isinstance(value, int | float):
            raise TypeError("prod() here multiplies numbers only")
        start = start * value
        if isinstance(start, int):
            check_bits(start.bit_length())
    return start


def lcm(*numbers: int) -> int:
    """`math.lcm`. Raises TooLargeError."""
    result = 1
    for number in numbers:
        result = math.lcm(result, number)
        check_bits(result.bit_length())
    return result


MATH: dict[str, Any] = {name: value for name, value in vars(math).items() if not name.startswith("_")}
"""The names of the math module."""
MATH.update(factorial=factorial, comb=comb, perm=perm, prod=prod, lcm=lcm)
MATH.pop("sumprod", None)  # new in Python 3.12; it also multiplies texts


# --- Python's own functions ----------------------------------------------------------------------------------------


def formatted(value: Any, spec: str = "") -> str:
    """`format`, with bounded widths. Raises TooLargeError, and what `format` raises."""
    check_widths(spec)
    return format(value, spec)


def _range(*bounds: int) -> list[int]:
    numbers = range(*bounds)
    check_length(len(numbers))
    return list(numbers)


def _sum(values: Iterable[Any], start: Any = 0) -> Any:
    found = list(values)
    if not all(isinstance(value, int | float) for value in (start, *found)):
        raise TypeError("sum() here adds numbers only")
    return sum(found, start)


def _map(function: Callable[..., Any], *values: Iterable[Any]) -> list[Any]:
    return [function(*items) for items in zip(*map(list, values), strict=False)]


def _filter(function: Callable[[Any], Any] | None, values: Iterable[Any]) -> list[Any]:
    return [value for value in list(values) if (value if function is None else function(value))]


FUNCTIONS: dict[str, Any] = {
    "abs": abs, "all": all, "any": any, "bin": bin, "bool": bool, "chr": chr, "dict": dict, "divmod": divmod,
    "enumerate": lambda values, start=0: list(enumerate(values, start)), "filter": _filter, "float": float,
    "format": formatted, "hex": hex, "int": int, "isinstance": isinstance, "len": len, "list": list, "map": _map,
    "max": max, "min": min, "oct": oct, "ord": ord, "range": _range, "repr": repr,
    "reversed": lambda values: list(reversed(values)), "round": rounded, "set": set, "sorted": sorted, "str": str,
    "sum": _sum, "tuple": tuple, "zip": lambda *values: list(zip(*values, strict=False)),
}  # fmt: skip


# --- methods -------------------------------------------------------------------------------------------------------


_LENGTH = "__len__"
"""The only name with double underscores that expressions may use: some models have `text.__len__()` for `len(text)`."""


def method_of(owner: Any, name: str) -> Callable[..., Any] | None:
    """The method of a value by its name; None when expressions may not use it."""
    if name == _LENGTH and isinstance(owner, str | list | tuple | dict | set):
        return owner.__len__
    if isinstance(owner, str) and name in _WATCHED:
        return _WATCHED[name](owner)
    if owner is str and (name in _WATCHED or name in _METHODS[str]):
        return lambda text, *values: _of_text(text, name)(*values)
    known = next((names for kind, names in _METHODS.items() if isinstance(owner, kind)), frozenset())
    return getattr(owner, name) if name in known else None


def _of_text(text: Any, name: str) -> Callable[..., Any]:
    """The method for `str.upper(text)`. Raises TypeError: not a text."""
    method = method_of(text, name) if isinstance(text, str) else None
    if method is None:
        raise TypeError(f"str.{name} is for texts")
    return method


def _replace(text: str) -> Callable[..., str]:
    def replace(old: str, new: str, count: int = -1) -> str:
        check_length(text.count(old) * len(new))
        return text.replace(old, new, count)

    return replace


def _join(text: str) -> Callable[[Any], str]:
    def join(parts: Any) -> str:
        parts = list(parts)
        check_length(sum(len(part) + len(text) for part in parts))
        return text.join(parts)

    return join


def _filled(method: str) -> Callable[[str], Callable[..., str]]:
    """The bounded form of a method whose first argument is a width, such as `ljust`."""

    def of(text: str) -> Callable[..., str]:
        def fill(width: int, *letter: str) -> str:
            check_length(width)
            return str(getattr(text, method)(width, *letter))

        return fill

    return of


def _format(text: str) -> Callable[..., str]:
    """`str.format`, but without access to attributes and elements of values: these could reach any object in Python."""

    def fill_in(*values: Any, **named: Any) -> str:
        for _, field, spec, _ in string.Formatter().parse(text):
            if field and not (field.isdecimal() or field.isidentifier()):
                raise ValueError(f"{{{field}}} is not the number or the name of a value")
            check_widths((spec or "").replace("{", "0000"))
        shown = [len(str(value)) for value in (*values, *named.values())]
        check_length(len(text) + text.count("{") * max(shown, default=0))
        return text.format(*values, **named)

    return fill_in


_WATCHED: dict[str, Callable[[str], Callable[..., str]]] = {
    "replace": _replace, "join": _join, "format": _format,
    **{method: _filled(method) for method in ("center", "ljust", "rjust", "zfill")},
}  # fmt: skip
_METHODS: dict[type[Any], frozenset[str]] = {
    str: frozenset({
        "capitalize", "casefold", "count", "endswith", "find", "index", "isalnum", "isalpha", "isascii", "isdecimal",
        "isdigit", "isidentifier", "islower", "isnumeric", "isprintable", "isspace", "istitle", "isupper", "lower",
        "lstrip", "partition", "removeprefix", "removesuffix", "rfind", "rindex", "rpartition", "rsplit", "rstrip",
        "split", "splitlines", "startswith", "strip", "swapcase", "title", "upper",
    }),
    dict: frozenset({"clear", "copy", "get", "items", "keys", "pop", "popitem", "setdefault", "update", "values"}),
    list: frozenset({
        "append", "clear", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse", "sort",
    }),
    tuple: frozenset({"count", "index"}),
    set: frozenset({
        "add", "clear", "copy", "difference", "discard", "intersection", "isdisjoint", "issubset", "issuperset", "pop",
        "remove", "symmetric_difference", "union", "update",
    }),
    frozenset: frozenset({
        "copy", "difference", "intersection", "isdisjoint", "issubset", "issuperset", "symmetric_difference", "union",
    }),
    float: frozenset({"is_integer"}),
}  # fmt: skip


# --- operators -----------------------------------------------------------------------------------------------------

_DIRECTIVE = re.compile(r"%[-#0 +.*\d]*")
"""The flags, the width and the precision of `'%5.2f'`."""


def _product(left: Any, right: Any) -> Any:
    for count, text in ((left, right), (right, left)):
        if isinstance(count, int) and hasattr(text, "__len__"):
            check_length(count * len(text))
    result = left * right
    if isinstance(result, int):
        check_bits(result.bit_length())
    return result


def _remainder(left: Any, right: Any) -> Any:
    """`left % right`, including Python's `'%d' % 1` with bounded widths."""
    if isinstance(left, bytes):
        raise TypeError("bytes cannot be formatted here")
    if isinstance(left, str):
        # After a `%(name)` the width is not easy to find: then no number of four digits may occur in the whole text.
        check_widths(left if "%(" in left else "".join(_DIRECTIVE.findall(left)), star=True)
        check_length(left.count("%") * len(str(right)))
    return left % right


def _shifted(left: Any, right: Any) -> Any:
    if isinstance(left, int) and isinstance(right, int):
        check_bits(left.bit_length() + right)
    return left << right


BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: _product,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: _remainder,
    ast.Pow: power,
    ast.LShift: _shifted,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}
COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda item, values: item in values,
    ast.NotIn: lambda item, values: item not in values,
}


# --- the evaluator -------------------------------------------------------------------------------------------------

MOST_STEPS = 100_000
"""The most steps: one for each node, for each value in a list that is made, and for each 100 characters of text."""
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
    """An expression uses something that is not allowed, or takes too long. The text is a clause without a subject."""


def compute(text: str, names: Mapping[str, Any], dotted: tuple[type[Any], ...] = ()) -> Any:
    """The value of an expression. It may use `names`; mappings of the types `dotted` give their values as attributes.

    An expression may call everything in `names`, with any arguments: it must be safe to do so.

    Raises:
        SyntaxError: it is not valid.
        ExpressionError: it uses what expressions here do not have, or takes too many steps.
        NameError: there is no such name. Also what Python's operators and the functions raise.
    """
    tree = parsed(text)
    for node in ast.walk(tree):
        name = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "arg", None)
        if isinstance(name, str) and name.startswith("__") and name != _LENGTH:
            raise ExpressionError(f"uses the invalid name {name!r}, with double underscores")
    return evaluate(tree, names, dotted)


def evaluate(
    tree: ast.expr, names: Mapping[str, Any], dotted: tuple[type[Any], ...] = (), most_steps: float = MOST_STEPS
) -> Any:
    """The value of a parsed expression whose names are already checked. Raises as `compute` does."""
    return _Evaluation(names, dotted, most_steps).value(tree)


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


class _Evaluation:
    """One walk over a syntax tree. The method for a kind of node has its name; a kind without one is refused."""

    def __init__(self, names: Mapping[str, Any], dotted: tuple[type[Any], ...], most_steps: float) -> None:
        self.names = names
        self.dotted = dotted
        self.most_steps = most_steps
        self.steps = 0

    def value(self, node: ast.AST) -> Any:
        return self.charged(self.found(node))

    def found(self, node: ast.AST) -> Any:
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
            item = pending.pop()
            self.steps += 1 + _weight(item)
            if self.steps > self.most_steps:
                raise ExpressionError(f"takes more than {self.most_steps} steps")
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
        """The values of elements or arguments; starred ones are unpacked."""
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
        if isinstance(owner, self.dotted) and not (isinstance(owner, dict) and node.attr in vars(dict)):
            try:
                return owner[node.attr]
            except KeyError:
                raise NameError(f"name {node.attr!r} is not defined", name=node.attr) from None
        method = method_of(owner, node.attr)
        if method is None:
            raise ExpressionError(f"{ast.unparse(node.value)} has no {node.attr!r} here")

        def call(*values: Any, **named: Any) -> Any:
            self.charged(owner)  # at each call: the owner may have grown since
            return method(*values, **named)

        return call

    def _subscript(self, node: ast.Subscript) -> Any:
        owner = self.found(node.value)
        if not isinstance(node.slice, ast.Slice):
            return owner[self.value(node.slice)]
        bounds = (node.slice.lower, node.slice.upper, node.slice.step)
        return owner[slice(*[self.value(bound) if bound else None for bound in bounds])]


def _within(outer: Mapping[str, Any], names: dict[str, Any]) -> Mapping[str, Any]:
    """The names, and after them the outer names. The values of outer names may be computed on access."""
    return ChainMap(names, outer)  # type: ignore[arg-type]  # the maps are never written to


def _bound(target: ast.expr, item: Any) -> dict[str, Any]:
    """The loop variables of a comprehension and their current values."""
    if isinstance(target, ast.Name):
        return {target.id: item}
    if not isinstance(target, ast.Tuple | ast.List):
        raise ExpressionError("a comprehension here has names after `for`, and nothing else")
    pairs = zip(target.elts, list(item), strict=True)
    return {name: value for below, part in pairs for name, value in _bound(below, part).items()}


def _weight(item: Any) -> int:
    """The steps that the size of a number or text counts for. Raises TooLargeError when it is too large."""
    if isinstance(item, int):
        check_bits(item.bit_length())
    elif isinstance(item, str | bytes):
        check_length(len(item))
        return len(item) // 100
    return 0
