"""Files of controllers (YAML, as for rosparam load), and their place in the parameter tree.

yaml_tree reads the text. This module knows how a tree of controllers looks, and uses one file for robots of any name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isnan
from pathlib import Path

from slidectl.description.models import read_file
from slidectl.description.parameter_trees import Tree, leaves, merge, nest
from slidectl.description.robot import Notice

_ANY_NAMESPACE = re.compile(r"^/*\*\*?/")
"""The begin of `/**/NAME`: the node of that name in any namespace."""
ROS_2 = "ros__parameters"
"""The key that holds the parameters of a node in files of ROS 2."""


def read(path: str | Path, notices: list[Notice] | None = None, text: bytes | None = None) -> Tree:
    """The tree of parameters in a file, which holds `text` if that was read already; doubtful things are appended to
    `notices`.

    Raises BadFile: missing, not YAML, or with values that no parameter can have; names file and line.
    """
    from slidectl.description import yaml_tree

    replaced: list[str] = []
    text = read_file(Path(path), pipes=True) if text is None else text
    tree = plain(yaml_tree.read(text, str(path), notices), replaced)
    if notices is not None and replaced:
        lines = places(text, str(path))
        notices += [Notice("wrong", name, yaml_tree.REPLACED, *lines.get(name, (str(path), None))) for name in replaced]
    return tree


def places(text: bytes, file: str) -> dict[str, tuple[str, int | None]]:
    """File and line of every parameter in a text, by its path in the tree that `read` returns. Raises BadFile."""
    from slidectl.description import yaml_tree

    return {plain_path(name): (file, line) for name, line in yaml_tree.places(text, file).items()}


def plain(tree: Tree, replaced: list[str] | None = None) -> Tree:
    """The tree without ROS 2's `ros__parameters`, its parameters moved to `plain_path`; else the same tree.

    The paths of values that are also namespaces of values then are appended to `replaced`.
    """
    found: Tree = {}
    moved = False
    for path, value in leaves(tree, "/"):
        place = plain_path(path) or path  # `ros__parameters: 5` alone stays
        moved = moved or place != path
        if place != path and isinstance(value, float) and isnan(value):
            continue  # in ROS 2 this says that the parameter is not set
        lost = merge(found, nest(place, value))
        if replaced is not None:
            replaced += lost
    return found if moved else tree


def plain_path(path: str) -> str:
    """The path in a file of ROS 1 for a parameter's path in a file of ROS 2.

    Parameters below `ros__parameters` of a node move directly below the node, those of a controller manager beside it.
    Dots in names become slashes.
    """
    node, mark, name = path.partition(f"/{ROS_2}")
    if not mark or name[:1] not in ("", "/"):
        return path
    node = _ANY_NAMESPACE.sub("/", node)
    return node.removesuffix("/controller_manager").removesuffix("/**") + name.replace(".", "/")


def retarget(tree: Tree, namespace: str) -> tuple[Tree, str | None]:
    """The tree to load at the root so that `namespace` has its controllers; and a remark for the user, or None.

    A file that names the namespace is loaded as it is. If it names one other namespace, its controllers are moved. If
    it begins with the controllers themselves, they are put under the namespace.
    """
    target = "/" + namespace.strip("/")
    if not tree or (isinstance(at(tree, target), dict) and target != "/"):
        return tree, None
    if holds_controllers(tree):
        return nest(target, tree), None
    # Go down from the root while there is a single key and there are no controllers.
    written, controllers = "", tree
    while isinstance(controllers, dict) and len(controllers) == 1 and not holds_controllers(controllers):
        ((name, controllers),) = controllers.items()
        written += f"/{name}"
    if written == target:
        return tree, None
    if holds_controllers(controllers):
        return nest(target, controllers), f"the file's controllers are for {written}; they are loaded under {target}"
    return tree, f"no controllers for {target} in the file; it is loaded as it stands"


def holds_controllers(tree: object) -> bool:
    """True when a mapping has children that look like controllers: mappings with a `type`."""
    if not isinstance(tree, Mapping):
        return False
    return any(isinstance(child, Mapping) and isinstance(child.get("type"), str) for child in tree.values())


def at(tree: object, path: str) -> object:
    """The value at `path` in a tree, or None."""
    branch = tree
    for name in path.strip("/").split("/"):
        branch = branch.get(name) if isinstance(branch, Mapping) else None
    return branch
