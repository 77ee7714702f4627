"""Bounds of what a model's expressions may take: powers that come to an end, and memory.

xacro hands expressions to Python, which computes `9**9**9` for hours without listening to Ctrl-C.
"""

from __future__ import annotations

import ast
import contextlib
import resource
from collections.abc import Iterator, Mapping
from typing import Any

from slidectl.operators import mathematics

MOST_MEMORY = 1 << 30
"""Bytes that a run may take on top of what the process has."""
_POWER = "**"
"""The name of our power inside an expression: one that no expression can write."""


class _Powers(ast.NodeTransformer):
    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Pow):
            return node
        call = ast.Call(ast.Name(_POWER, ast.Load()), [node.left, node.right], [])
        return ast.fix_missing_locations(ast.copy_location(call, node))


def evaluate(expression: str, globals: dict[str, Any], locals: Mapping[str, Any] | None = None) -> Any:
    """As Python's `eval` does. Raises what the expression raises, OverflowError for a power that is too large."""
    tree = _Powers().visit(ast.parse(expression.strip(), "<expression>", "eval"))
    dict.__setitem__(globals, _POWER, mathematics.power)
    return eval(compile(tree, "<expression>", "eval"), globals, locals)


def names_in(expression: str) -> tuple[str, ...]:
    """The names that it looks up, attributes too. Raises SyntaxError."""
    return compile(expression.strip(), "<expression>", "eval", dont_inherit=True).co_names


@contextlib.contextmanager
def bounded_memory() -> Iterator[None]:
    """Inside, more than MOST_MEMORY is a MemoryError. For the whole process: nothing else must run meanwhile."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = _address_space() + MOST_MEMORY
    if soft != resource.RLIM_INFINITY and soft <= limit:
        yield
        return
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _address_space() -> int:
    """Bytes that the process has now."""
    with open("/proc/self/statm", encoding="ascii") as statm:
        return int(statm.read().split()[0]) * resource.getpagesize()
