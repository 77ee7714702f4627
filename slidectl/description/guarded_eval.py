"""Python's `eval` for the expressions of xacro, with a guard on names and attributes.

Against: a model that was sent, whose expressions run code. xacro's own guard looks at the names of the outermost code
alone, gives `$(eval ...)` all of Python's functions, and does not know that frames, formats and `vars` lead to every
object of Python. What an expression may cost is not bounded here: slidectl.confined bounds the process.
"""

from __future__ import annotations

import ast
import builtins
import importlib
import string
import warnings
from collections.abc import Callable, Mapping
from typing import Any

FUNCTIONS = {
    name: getattr(builtins, name)
    for name in (
        "abs", "all", "any", "bin", "bool", "chr", "complex", "dict", "divmod", "enumerate", "filter", "float",
        "format", "frozenset", "hex", "int", "isinstance", "issubclass", "len", "list", "map", "max", "min", "oct",
        "ord", "pow", "range", "repr", "reversed", "round", "set", "slice", "sorted", "str", "sum", "tuple", "zip",
    )
}  # fmt: skip
"""Python's functions that compute values and do nothing else."""
_PLAIN = (bool, int, float, complex, str, bytes, list, tuple, dict, set, frozenset, type(None))
_LENGTH = "__len__"
"""The only name with double underscores that expressions may use: some models have `text.__len__()` for `len(text)`."""
_GUARDED = frozenset({
    "format", "format_map", "mro",
    "ag_await", "ag_code", "ag_frame", "co_code", "co_consts", "cr_await", "cr_code", "cr_frame", "cr_origin",
    "f_back", "f_builtins", "f_code", "f_globals", "f_locals", "f_trace", "gi_code", "gi_frame", "gi_yieldfrom",
    "tb_frame", "tb_next", "with_traceback",
})  # fmt: skip
"""Attributes that lead to the insides of Python, without double underscores. A key of YAML may have such a name."""
_OF_NAMESPACES = frozenset({"depth", "parent", "recursive", "root", "top", "unevaluated"})
"""Attributes of xacro's namespaces, and names that a property in a namespace may have."""
_GUARD = "__attribute__"
"""The name of the function in place of these attributes. Expressions cannot name it."""


def evaluate(text: str, symbols: Any, names: Any, dotted: tuple[type[Any], ...], functions: Mapping[str, Any]) -> Any:
    """The value of an expression, by Python's `eval(text, symbols, names)`.

    Args:
        symbols: a dict; `__builtins__` in it is set.
        names: looked up before `symbols`, or None.
        dotted: classes whose attributes are values of the user: any name may follow their dot.
        functions: take the place of Python's own functions.

    Raises:
        SyntaxError: it is not valid. NameError: it uses a name or an attribute that leads to code. Also what it raises.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the user cannot act on Python's warnings about this code
        tree = _Guard().visit(ast.parse(str.strip(text), "<expression>", "eval"))
        code = compile(ast.fix_missing_locations(tree), "<expression>", "eval")
    symbols.update(__builtins__={**functions, _GUARD: _attributes(dotted), "__import__": _import})
    return eval(code, symbols, names)


def _import(name: str, *_: Any) -> Any:
    """For Python itself, from 3.12 on: it computes with very large numbers in a module. Expressions cannot name this.

    Raises ImportError: it is another module.
    """
    if name != "_pylong":
        raise ImportError(f"expressions here import nothing, and not {name!r}")
    return importlib.import_module(name)


def type_of(value: Any) -> type:
    """`type`, for a plain value; other types could construct new types. Raises TypeError."""
    if not issubclass(type(value), _PLAIN):
        raise TypeError("python.type() here is for numbers, texts, lists and mappings")
    return type(value)


class _Guard(ast.NodeTransformer):
    """Refuses names with double underscores, and puts a function in the place of attributes that need a look."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        for name in (getattr(node, "id", None), getattr(node, "attr", None), getattr(node, "arg", None)):
            if isinstance(name, str) and name.startswith("__") and not (name == _LENGTH and hasattr(node, "attr")):
                raise NameError(f"uses the invalid name {name!r}, with double underscores")
        return super().generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        if node.attr not in _GUARDED | _OF_NAMESPACES:
            return node
        return ast.Call(ast.Name(_GUARD, ast.Load()), [node.value, ast.Constant(node.attr)], [])


def _attributes(dotted: tuple[type[Any], ...]) -> Callable[[Any, str], Any]:
    def attribute(owner: Any, name: str) -> Any:
        """The attribute of a value, when it does not lead to the insides of Python."""
        value: Any = owner
        if isinstance(owner, dotted):
            return value[name]
        if name == "format" and isinstance(owner, str):
            return lambda *values, **named: _plain_format(owner).format(*values, **named)
        if name == "format" and owner is str:
            return lambda text, *values, **named: _plain_format(text).format(*values, **named)
        raise NameError(f"uses {name!r}, which expressions here do not have")

    return attribute


def _plain_format(text: str) -> str:
    """A format that uses values, and no attributes or elements of them: these could reach any object of Python.

    Raises ValueError.
    """
    fields = [text]
    for form in fields:
        for _, field, spec, _ in string.Formatter().parse(form):
            if field and not (field.isdecimal() or field.isidentifier()):
                raise ValueError(f"{{{field}}} is not the number or the name of a value")
            fields += [spec] if spec else []
    return text
