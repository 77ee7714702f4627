"""The message types of rosbags' ROS 1 store, as definitions of this house.

The only module that imports rosbags. Building its store takes some hundred milliseconds: import this one late.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from slidectl.msgs.parsing import Constant, Definition
from slidectl.msgs.schema import SCALAR, Field

_TIMES = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
# IDL knows no empty struct, so the store puts this field into one.
_FILLER = "structure_needs_at_least_one_member"


@cache
def _store() -> Any:
    return get_typestore(Stores.ROS1_NOETIC).fielddefs


@cache
def names() -> list[str]:
    """All of its `pkg/Type` names."""
    return [name.replace("/msg/", "/") for name in _store() if name not in _TIMES]


def definition_of(type_name: str) -> Definition | None:
    """The definition of `pkg/Type`, None when the store has none."""
    entry = _store().get(type_name.replace("/", "/msg/"))
    if entry is None:
        return None
    constants = tuple(Constant(name, kind, value) for name, kind, value in entry[0])
    fields = tuple(_field(name, node) for name, node in entry[1] if name != _FILLER)
    lines = [f"{c.type} {c.name}={c.value}" for c in constants] + [f"{f.type_text} {f.name}" for f in fields]
    texts = tuple(str(c.value) for c in constants)
    return Definition(type_name, fields, constants, texts, "".join(line + "\n" for line in lines))


def _field(name: str, node: Any) -> Field:
    kind, what = node
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        element, length = what
        return Field(name, _type(element), length)
    return Field(name, _type(node), SCALAR)


def _type(node: Any) -> str:
    kind, what = node
    if kind == Nodetype.BASE:
        return str(what[0])
    return _TIMES.get(what) or what.replace("/msg/", "/")
