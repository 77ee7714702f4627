"""Which parameter a name in a file means, among those that somebody declares.

Only names: `extra_joints[2]/name` is `extra_joints[]/name`, and any name may stand for `<joint>`. No values here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from slidectl.control.params import LIST, Parameter
from slidectl.errors import closest

_INDEX = re.compile(r"\[\d+\]")
_ANY = "<joint>"


class Declared:
    """The parameters of one controller, or of one place that hardware reads."""

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self.all = tuple(parameters)
        self._patterns = [(parameter.name.split("/"), parameter) for parameter in self.all]

    def find(self, name: str) -> Parameter | None:
        """The parameter of that name."""
        parts = _parts(name)
        return next((parameter for pattern, parameter in self._patterns if _fits(pattern, parts)), None)

    def has_below(self, name: str) -> bool:
        """Whether some parameter lies below that name."""
        parts = _parts(name)
        return any(len(pattern) > len(parts) and _fits(pattern[: len(parts)], parts) for pattern, _ in self._patterns)

    def closest(self, name: str) -> str | None:
        """The parameter whose name is nearest to one that is none of them."""
        return closest("/".join(_parts(name)), [parameter.name for parameter in self.all])

    def names(self) -> list[str]:
        """All names, in the order of declaration."""
        return [parameter.name for parameter in self.all]

    def leaves(self, tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
        """The values in a tree, as deep as parameters are declared; what is unknown stays whole."""
        for key, value in tree.items():
            name = f"{above}{key}"
            if isinstance(value, Mapping) and self.has_below(name):
                yield from self.leaves(value, f"{name}/")
            else:
                yield name, value
                yield from self._entries(name, value)

    def _entries(self, name: str, value: Any) -> Iterator[tuple[str, Any]]:
        """What is in the mappings of a list of them."""
        parameter = self.find(name)
        if parameter is None or parameter.kind is not LIST or not isinstance(value, list):
            return
        for index, entry in enumerate(value):
            if isinstance(entry, Mapping):
                yield from self.leaves(entry, f"{name}[{index}]/")

    def strays(self, name: str, value: Any) -> list[int]:
        """Which entries of a list of mappings are none."""
        parameter = self.find(name)
        if parameter is None or parameter.kind is not LIST or not self.has_below(f"{name}[0]"):
            return []
        entries = value if isinstance(value, list) else []
        return [index for index, entry in enumerate(entries) if not isinstance(entry, Mapping)]

    def missing(self, tree: Mapping[str, Any]) -> Iterator[tuple[str, Parameter]]:
        """The required ones that a tree lacks, by the name that they would have; in optional parts that exist only."""
        given = dict(self.leaves(tree))
        for parameter in self.all:
            if parameter.required:
                yield from ((name, parameter) for name in _places(parameter.name, tree) if name not in given)


def _parts(name: str) -> list[str]:
    return _INDEX.sub("[]", name).split("/")


def _fits(pattern: list[str], parts: list[str]) -> bool:
    return len(pattern) == len(parts) and all(want in (_ANY, part) for want, part in zip(pattern, parts, strict=True))


def _places(name: str, tree: Mapping[str, Any]) -> Iterator[str]:
    """Where a required parameter is expected: once, or in each entry of its list, or below each name that is there."""
    for sign in ("[]/", f"{_ANY}/"):
        above, found, below = name.partition(sign)
        if found:
            yield from (f"{place}/{below}" for place in _inner(above, sign, tree))
            return
    yield name


def _inner(above: str, sign: str, tree: Mapping[str, Any]) -> Iterator[str]:
    branch: Any = tree
    for part in above.strip("/").split("/"):
        branch = branch.get(part) if isinstance(branch, Mapping) else None
    if sign == "[]/" and isinstance(branch, list):
        yield from (f"{above}[{index}]" for index, entry in enumerate(branch) if isinstance(entry, Mapping))
    elif isinstance(branch, Mapping):
        yield from (f"{above}{name}" for name, value in branch.items() if isinstance(value, Mapping))
