"""Python's operators by their place in a syntax tree, for the languages here that evaluate one themselves.

`$(eval)` of launch files, `${}` of xacro and the expressions of the command line take what they have in common from
this room, so that all of them keep numbers, texts and lists to a size that comes to an end. What else a language
refuses is its own affair. The room knows no files and no places.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable
from typing import Any

from slidectl.operators.mathematics import power
from slidectl.operators.sizes import check_bits, check_length, check_widths

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
    """Also Python's `'%d' % 1`, with widths that fit on a line."""
    if isinstance(left, bytes):
        raise TypeError("bytes cannot be formatted here")
    if isinstance(left, str):
        # What follows a name in brackets is not found so easily: then there may be no such digits anywhere.
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
