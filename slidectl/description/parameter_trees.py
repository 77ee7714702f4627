"""Trees of parameters: nested mappings. Slashes separate the names of a path; lists and empty mappings are values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

Tree = dict[str, Any]
"""Values are bool, int, float, str, and lists and mappings of these."""


def nest(path: str, value: Any) -> Any:
    """Put `value` below the names of `path`; for an empty path return the value itself."""
    for name in reversed([part for part in path.split("/") if part]):
        value = {name: value}
    return value


def merge(tree: Tree, more: Tree) -> list[str]:
    """Put `more` into `tree`: mappings are merged, anything else replaces what is there.

    Returns the paths, as `/a/b`, at which a mapping has replaced a value, or a value a mapping.
    """
    replaced = []
    for key, value in more.items():
        there = tree.get(key)
        if isinstance(value, dict) and isinstance(there, dict):
            replaced += [f"/{key}{below}" for below in merge(there, value)]
            continue
        if key in tree and isinstance(value, dict) != isinstance(there, dict):
            replaced.append(f"/{key}")
        tree[key] = value
    return replaced


def leaves(tree: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of every parameter in a tree; `above` is put before each path."""
    for key, value in tree.items() if isinstance(tree, dict) else ():
        if isinstance(value, dict) and value:
            yield from leaves(value, f"{above}{key}/")
        else:
            yield f"{above}{key}", value
