"""The entries of a journal: which fields each kind has, and what may be in them. See docs/journal.md.

A checksum only says that an entry is as it was written, not who wrote it: a journal is sent around, and edited. So a
replay takes only entries that pass `check`, and is spared all other questions of types.
"""

from __future__ import annotations

import base64
import binascii
import math
import zlib
from collections.abc import Callable, Mapping
from typing import Any

from slidectl import names
from slidectl.description.meshes import BadMesh
from slidectl.errors import cut, listing
from slidectl.physics.hulls import Hull, MeshSource, hull_of
from slidectl.simulation.clock import NEVER

_LARGEST_HULL = 2**22
"""Bytes. A surface of the most pieces takes half of it."""
_LONGEST_SHOWN = 60
_NUMBER_BYTES = 8

Check = Callable[[Any], bool]


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < NEVER


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < math.inf


def _is_numbers(count: int) -> Check:
    return lambda value: isinstance(value, list) and len(value) == count and all(map(_is_number, value))


def _is_node(value: Any) -> bool:
    return isinstance(value, str) and names.is_legal(value)


def _is_state(value: Any) -> bool:
    try:
        return len(base64.b64decode(value, validate=True)) % _NUMBER_BYTES == 0
    except (TypeError, ValueError):
        return False


def _is_row(*checks: Check) -> Check:
    """A list with one value for each check."""
    return lambda value: (
        isinstance(value, list)
        and len(value) == len(checks)
        and all(check(item) for check, item in zip(checks, value, strict=True))
    )


def _is_list(check: Check) -> Check:
    return lambda value: isinstance(value, list) and all(map(check, value))


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def _is_mesh(value: Any) -> bool:
    if not isinstance(value, dict):
        return False
    try:
        mesh_of(value)
    except ValueError:
        return False
    return True


_POSE = _is_row(_is_numbers(3), _is_numbers(4))
_TEXT_AND_TROUBLE = _is_row(_is_text, _is_text)


def _is_parts_and_trouble(*checks: Check) -> Check:
    parts = _is_list(_is_row(*checks))
    return _is_row(lambda value: value is None or parts(value), _is_text)


READS: dict[str, Check] = {
    "code of ": _TEXT_AND_TROUBLE,
    "snapshot ": _TEXT_AND_TROUBLE,
    "writing of the snapshot ": _is_text,
    "place of the mesh ": _TEXT_AND_TROUBLE,
    "SDF of ": _is_parts_and_trouble(_is_text, _is_text, _POSE),
    "resource ": _is_parts_and_trouble(_is_text, _is_text, _POSE, _is_flag),
}
"""How a `read` begins, and what is `found` then."""

_KINDS: dict[str, tuple[Check, str]] = {
    "cycle": (_is_count, "a whole number from 0"),
    "client": (_is_count, "the number of a client"),
    "gone": (_is_count, "the number of a client"),
    "node": (_is_node, "the name of a node"),
    "line": (lambda value: isinstance(value, bytes), "a line of a client"),
    "read": (lambda value: _is_text(value) and value.startswith(tuple(READS)), "what the daemon reads of files"),
    "found": (lambda _: True, ""),
    "module": (_is_row(_is_text, _is_text, _is_text, _is_flag), "name, file and text of a module, true or false"),
    "meshes": (_is_list(_is_mesh), "meshes with path, scale and hull"),
    "picture": (_is_text, "a text"),
    "let_go": (_is_node, "the name of a node"),
    "limit": (_is_text, "a text"),
    "state": (_is_state, "64-bit floats in base64"),
    "end": (_is_text, "a text"),
}
"""The check of each field, and what it expects."""
_FIELDS = (
    {"client", "line"}, {"client", "node"}, {"gone"}, {"read", "found"}, {"module"}, {"meshes"}, {"picture"},
    {"let_go"}, {"limit"}, {"state"}, {"end", "state"},
)  # fmt: skip
"""The fields of each kind of entry beside `cycle`."""

OPTIONS: dict[str, tuple[Check, str]] = {
    "rtf": (lambda value: type(value) in (int, float), "a number"),
    "paused": (_is_flag, "true or false"),
    "timestep": (_is_number, "a number"),
    "gravity": (_is_numbers(3), "three numbers"),
    "ground": (_is_flag, "true or false"),
    "strict": (_is_flag, "true or false"),
    "engine": (_is_text, "a text"),
    "chosen": (_is_list(_is_text), "texts"),
    "imports": (_is_list(_is_text), "texts"),
}
"""The options of the world, in the first line."""


def check(entry: Mapping[str, Any]) -> None:
    """Raise ValueError with what is wrong with an entry."""
    if "cycle" not in entry:
        raise ValueError("it has no 'cycle'")
    fields = entry.keys() - {"cycle"}
    if fields not in _FIELDS:
        known = listing("+".join(sorted(one)) for one in _FIELDS)
        raise ValueError(f"no entry has the fields {listing(fields)}; entries: {known}")
    check_fields(entry, _KINDS)
    if "read" in entry:
        is_right = next(check for begin, check in READS.items() if entry["read"].startswith(begin))
        if not is_right(entry["found"]):
            raise ValueError("'found' is not what is found when the daemon reads that")


def check_fields(values: Mapping[str, Any], kinds: Mapping[str, tuple[Check, str]]) -> None:
    """Raise ValueError for a value that its check in `kinds` refuses."""
    for name, value in values.items():
        is_right, expected = kinds[name]
        if not is_right(value):
            raise ValueError(f"{name!r} is not {expected}, but {_shown(value)}")


def _shown(value: Any) -> str:
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    if isinstance(value, int) and abs(value) >= NEVER:
        return "a whole number that is too large"
    return cut(repr(value), _LONGEST_SHOWN)


def mesh_entry(source: MeshSource, hull: Hull | BadMesh) -> dict[str, Any]:
    """One of the `meshes` of an entry."""
    entry: dict[str, Any] = {"path": source.path, "scale": list(source.scale)}
    if source.is_surface:
        entry["surface"] = True
    if isinstance(hull, BadMesh):
        return {**entry, "bad": hull.reason}
    return {**entry, "name": hull.name, "hull": base64.b64encode(zlib.compress(hull.stl)).decode()}


def mesh_of(entry: Mapping[str, Any]) -> tuple[MeshSource, Hull | BadMesh]:
    """The mesh that `mesh_entry` has written. Raises ValueError: it has not."""
    path, scale = entry.get("path"), entry.get("scale")
    if not isinstance(path, str) or not _is_numbers(3)(scale):
        raise ValueError("a mesh has a path and a scale")
    assert scale is not None
    x, y, z = scale
    source = MeshSource(path, (x, y, z), entry.get("surface") is True)
    if isinstance(entry.get("bad"), str):
        return source, BadMesh(entry["bad"], path)
    try:
        expander = zlib.decompressobj()
        stl = expander.decompress(base64.b64decode(entry["hull"], validate=True), _LARGEST_HULL)
        hull = hull_of(stl)
        if not expander.eof or hull.name != entry["name"]:
            raise ValueError("a hull is cut off, too large, or has another name than its content")
    except (LookupError, TypeError, binascii.Error, zlib.error) as error:
        raise ValueError(f"a mesh has a hull: {error}") from None
    return source, hull
