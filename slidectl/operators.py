"""Python's operators by their place in a syntax tree, for languages that evaluate one themselves.

Powers are kept to a size that comes to an end. What else a language refuses is its own affair.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from typing import Any

MOST_BITS = 4096
"""Of a whole number."""
_TOO_COSTLY = {"factorial", "comb", "perm", "lcm", "prod", "isqrt"}

MATH: dict[str, Any] = {
    name: value for name, value in vars(math).items() if not name.startswith("_") and name not in _TOO_COSTLY
}
"""The names of the math module, without those whose work grows faster than their arguments."""


def power(base: Any, exponent: Any) -> Any:
    """`base ** exponent`. Raises OverflowError instead of making a number that takes long."""
    if isinstance(base, int) and isinstance(exponent, int) and base.bit_length() * exponent > MOST_BITS:
        raise OverflowError(f"{base} ** {exponent} is too large")
    return operator.pow(base, exponent)


ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Pow: power,
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
