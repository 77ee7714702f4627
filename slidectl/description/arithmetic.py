"""Small sums in texts, as `pi/2` in an angle.

Numbers, `pi`, the four operations, powers and brackets; nothing else is ever evaluated.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable

_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def arithmetic(text: str) -> float:
    """A number made of numbers, `pi`, `+ - * / **` and brackets; nothing else is evaluated.

    Raises:
        ValueError: anything else in it. ArithmeticError: no finite result.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, MemoryError) as error:
        raise ValueError("expected an expression of numbers and pi") from error
    value = _evaluate(tree.body)
    if not math.isfinite(value):
        raise OverflowError("the result is not finite")
    return value


def _evaluate(node: ast.expr) -> float:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name) and node.id == "pi":
        return math.pi
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _evaluate(node.operand)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        value = _OPERATORS[type(node.op)](_evaluate(node.left), _evaluate(node.right))
        if isinstance(value, float):  # a negative number to a broken power is complex
            return value
    raise ValueError("expected an expression of numbers and pi")
