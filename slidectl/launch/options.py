"""The `args` of nodes taken apart: options as the ROS scripts know them, with their values, and the other words.

A mistake is an error at the node's place. No meaning of any option here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from slidectl.errors import closest
from slidectl.launch.plan import Node


@dataclass
class Words:
    """Options by name, each with its values every time that it was given, and what is left."""

    node: Node
    given: dict[str, list[list[str]]] = field(default_factory=dict)
    rest: list[str] = field(default_factory=list)

    def has(self, option: str) -> bool:
        return option in self.given

    def one(self, option: str, default: str = "") -> str:
        """The value of an option that has one; of several the last."""
        return self.given[option][-1][0] if option in self.given else default

    def number(self, option: str, default: float) -> float:
        """The same as a finite number. Raises BadFile."""
        return number(self.node, option, self.one(option)) if option in self.given else default


def number(node: Node, what: str, text: str) -> float:
    """A finite number. Raises BadFile at the node."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise node.place.error(f"{node.full_name}: {what} is a number, not {text!r}")
    return value


def parse(node: Node, known: Mapping[str, int]) -> Words:
    """The words of a node. `known` says how many values each option takes; names come with their dashes.

    Raises:
        BadFile: an unknown option, or values missing.
    """
    words = Words(node)
    pending = [word for word in node.words if not _is_remap(word)]
    while pending:
        word = pending.pop(0)
        name, sign, value = word.partition("=")
        if not word.startswith("-") or word == "-" or _is_number(word):
            words.rest.append(word)
            continue
        name = _whole_name(node, name, list(known))
        values = [value] if sign else []
        while len(values) < known[name] and pending:
            values.append(pending.pop(0))
        if len(values) != known[name]:
            count = f"{known[name]} value{'' if known[name] == 1 else 's'}"
            raise node.place.error(f"{node.full_name}: {name} takes {count}, not {len(values)}")
        words.given.setdefault(name, []).append(values)
    return words


def _is_remap(word: str) -> bool:
    """`from:=to`, which ROS takes out before a script sees its arguments."""
    name, sign, _ = word.partition(":=")
    return bool(sign) and bool(name) and not word.startswith("-") and " " not in name


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _whole_name(node: Node, name: str, known: Sequence[str]) -> str:
    """The option that is meant: its name may be cut short as long as no other begins so, as argparse has it."""
    meant = [name] if name in known else [option for option in known if option.startswith(name)]
    if len(meant) == 1:
        return meant[0]
    if meant:
        raise node.place.error(f"{node.full_name}: {name} may mean {' or '.join(meant)}")
    raise _unknown(node, name, known)


def _unknown(node: Node, name: str, known: Sequence[str]) -> Exception:
    near = closest(name, known)
    suggestion = f"; did you mean {near}?" if near else ""
    return node.place.error(
        f"{node.full_name}: {node.kind} has no option {name!r} here{suggestion}",
        f"options: {', '.join(known)}" if known else "it takes no options",
    )
