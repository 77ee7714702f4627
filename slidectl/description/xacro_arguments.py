"""Which arguments a xacro file declares, read without evaluating anything.

Includes are followed when their name needs nothing but `$(find)`; a name made of properties is left out.
"""

from __future__ import annotations

import re
from pathlib import Path

from slidectl.description import xml_tree
from slidectl.description.models import read_file
from slidectl.description.packages import Packages, shown
from slidectl.description.xml_tree import Element
from slidectl.errors import SlidectlError

_FIND = re.compile(r"\$\(find\s+([^\s)]+)\s*\)")


def declared(root: Element, base: Path, packages: Packages) -> dict[str, Element]:
    """The `<xacro:arg>` by name, in the order of the file; the first one of a name counts, as for xacro."""
    found: dict[str, Element] = {}
    _collect(root, base, packages, found, set())
    return found


def trees(root: Element, base: Path, packages: Packages) -> list[Element] | None:
    """The file and all that it includes, as they are written; None when it cannot be told what it includes."""
    found = [root]
    places = [base]
    seen: set[Path] = set()
    for tree, folder in zip(found, places, strict=False):  # both grow on the way
        for element in (element for element in tree.walk() if element.tag == "xacro:include"):
            path = _included(element.get("filename") or "$", folder, packages)
            if path is None:
                return None
            if path not in seen:
                seen.add(path)
                try:
                    found.append(xml_tree.read(read_file(path), shown(path)))
                except (OSError, SlidectlError):
                    return None
                places.append(path.parent)
    return found


def _collect(root: Element, base: Path, packages: Packages, found: dict[str, Element], seen: set[Path]) -> None:
    for element in root.walk():
        if element.tag == "xacro:arg" and (name := element.get("name")):
            found.setdefault(name, element)
        elif element.tag == "xacro:include" and (filename := element.get("filename")):
            path = _included(filename, base, packages)
            if path is not None and path not in seen:
                seen.add(path)
                _follow(path, packages, found, seen)


def _follow(path: Path, packages: Packages, found: dict[str, Element], seen: set[Path]) -> None:
    try:
        root = xml_tree.read(read_file(path), shown(path))
    except (OSError, SlidectlError):
        return  # running xacro will name the fault at the include
    _collect(root, path.parent, packages, found, seen)


def _included(filename: str, base: Path, packages: Packages) -> Path | None:
    try:
        name = _FIND.sub(lambda match: str(packages.find(match.group(1))), filename)
    except SlidectlError:
        return None
    return None if "$" in name else base / name
