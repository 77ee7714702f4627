"""Finds the kind of a file (model, SDF, launch file, or controllers), by its suffix or by its content."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from slidectl.errors import BadFile

Kind = Literal["model", "scene", "launch", "controllers"]

_SUFFIXES: dict[str, Kind] = {
    ".xacro": "model", ".urdf": "model", ".launch": "launch", ".test": "launch", ".yaml": "controllers",
    ".yml": "controllers", ".sdf": "scene", ".world": "scene",
}  # fmt: skip
_ROOTS: dict[str, Kind] = {"robot": "model", "launch": "launch", "sdf": "scene"}
_ROOT = re.compile(rb"<([A-Za-z_][\w:.-]*)")
_SKIPPED = re.compile(rb"<!--.*?-->|<\?.*?\?>|<!DOCTYPE[^>]*>", re.DOTALL)


def of_name(name: str) -> Kind | None:
    """The kind of a file by its suffix; None when the suffix is not known."""
    return _SUFFIXES.get(Path(name).suffix.lower())


def of_text(text: bytes, file: str) -> Kind:
    """The kind of a text; `file` is its name in the error. Text that is not XML is taken for YAML.

    Raises:
        BadFile: XML that is neither a robot nor SDF nor a launch file.
    """
    start = text.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not start.startswith(b"<"):
        return "controllers"
    root = _ROOT.match(_SKIPPED.sub(b"", start).lstrip())
    tag = root.group(1).decode() if root else ""
    if tag in _ROOTS:
        return _ROOTS[tag]
    what = f"the outermost element is <{tag}>" if tag else "it is not XML"
    raise BadFile(f"{what}, expected <robot>, <launch> or <sdf>", file, 1)
