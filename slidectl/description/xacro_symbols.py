"""What the expressions of a xacro file may name: all that xacro has but `vars`, as functions that do no harm.

xacro hands out Python's own functions, whose work may never end, and prints what a file says as it is. The names and
their spaces are those of xacro 2.1, whose direct names are deprecated here as there.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import xacro

from slidectl.description import xacro_yaml
from slidectl.expressions import FUNCTIONS, MATH, compute

_DIRECT = ("list", "dict", "map", "len", "str", "float", "int", "bool", "min", "max", "round")
_DEPRECATED = {"sorted": "python", "range": "python", "load_yaml": "xacro", "abs_filename": "xacro", "dotify": "xacro"}
_PLAIN = (bool, int, float, complex, str, bytes, list, tuple, dict, set, frozenset, type(None))
_DOTTED = (xacro.NameSpace, xacro.YamlDictWrapper)

Say = Callable[[str], object]


def evaluate(expression: str, names: Mapping[str, Any]) -> Any:
    """The value of an expression with these names and no others. Raises what `compute` raises."""
    return compute(expression, names, _DOTTED)


def symbols(warn: Say) -> dict[str, Any]:
    """xacro's global names. What a file warns of, and what it should not use directly, goes to `warn`."""
    found: dict[str, Any] = {**MATH, **{name: FUNCTIONS[name] for name in _DIRECT}}
    spaces = {"python": _python(), "math": MATH, "xacro": {**_xacro(warn), "load_yaml": _reader_of_yaml(found)}}
    for name, space in _DEPRECATED.items():
        found[name] = _deprecated(name, space, spaces[space][name], warn)
    for space, names in spaces.items():
        found[space] = xacro.NameSpace()
        dict.update(found[space], names)
    return found


def _python() -> dict[str, Any]:
    names = (*_DIRECT, "abs", "all", "any", "divmod", "enumerate", "filter", "isinstance", "ord", "range", "repr",
             "reversed", "set", "sorted", "sum", "tuple", "zip")  # fmt: skip
    more = {"complex": complex, "frozenset": frozenset, "hash": hash, "issubclass": issubclass, "slice": slice}
    return {**{name: FUNCTIONS[name] for name in names}, **more, "type": _type}


def _xacro(warn: Say) -> dict[str, Any]:
    return {
        "abs_filename": xacro.abs_filename_spec,
        "dotify": xacro.YamlDictWrapper,
        "arg": lambda name: xacro.substitution_args_context["arg"][name],
        "message": lambda *words, **_: _said(words, lambda text: print(text, file=sys.stderr)),
        "warning": lambda *words, **_: _said(words, warn),
        "error": lambda *words, **_: _said(words, warn),
        "print_location": lambda: "",
        "fatal": _fatal,
        "tokenize": _tokenize,
    }


def _reader_of_yaml(names: Mapping[str, Any]) -> Callable[[str], Any]:
    """`load_yaml`, which takes a name relative to the file that xacro reads. `names` are for numbers with units."""

    def load_yaml(filename: str) -> Any:
        path = xacro.abs_filename_spec(filename)
        xacro.all_includes.append(path)
        return xacro_yaml.load(Path(path), lambda text: float(evaluate(text, names)))

    return load_yaml


def _type(value: Any) -> type:
    """The type of a plain value: that of a function could make others."""
    if not issubclass(type(value), _PLAIN):
        raise TypeError("python.type() here is for numbers, texts, lists and mappings")
    return type(value)


def _said(words: tuple[Any, ...], say: Say) -> str:
    """As xacro's functions that print: the expression's value is an empty text. Nothing steers the terminal."""
    text = " ".join(map(str, words))
    say("".join(letter if letter.isprintable() else " " for letter in text))
    return ""


def _fatal(*words: Any) -> None:
    raise xacro.XacroException(" ".join(map(str, words)))


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """xacro's function of this name. `sep` is what stands between the brackets of a regular expression, and no more."""
    if "]" in sep[1:]:
        raise ValueError("']' can only be the first of the letters to part a text at")
    items = re.split(f"[{sep}]", text)
    return [item for item in items if item] if skip_empty else items


def _deprecated(name: str, space: str, function: Callable[..., Any], warn: Say) -> Callable[..., Any]:
    def warned(*values: Any, **named: Any) -> Any:
        warn(f"Using {name}() directly is deprecated. Use {space}.{name}() instead.")
        return function(*values, **named)

    return warned
