"""A file of controllers (YAML, as for rosparam load), and where in the parameter tree it belongs.

Reading is yaml_tree's; here is what a tree of controllers looks like, and how one file serves robots of any name.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from slidectl.description.models import read_file
from slidectl.description.parameter_trees import Tree, leaves, merge, nest
from slidectl.description.robot import Notice

ROS_2 = "ros__parameters"
"""What the parameters of a node are under in files of ROS 2."""


def read(path: str | Path, notices: list[Notice] | None = None) -> Tree:
    """The tree of parameters in a file; what is odd in it is appended to `notices`.

    Raises:
        BadFile: missing, not YAML, or with values that no parameter can have; names file and line.
    """
    from slidectl.description import yaml_tree

    replaced: list[str] = []
    text = read_file(Path(path), pipes=True)
    tree = plain(yaml_tree.read(text, str(path), notices), replaced)
    if notices is not None and replaced:
        lines = places(text, str(path))
        notices += [Notice("wrong", name, yaml_tree.REPLACED, *lines.get(name, (str(path), None))) for name in replaced]
    return tree


def places(text: bytes, file: str) -> dict[str, tuple[str, int | None]]:
    """File and line of every parameter of a file's text, by its path in the tree that `read` gives. Raises BadFile."""
    from slidectl.description import yaml_tree

    return {plain_path(name): (file, line) for name, line in yaml_tree.places(text, file).items()}


def plain(tree: Tree, replaced: list[str] | None = None) -> Tree:
    """The tree without ROS 2's `ros__parameters`, as `plain_path` places what is in it; else the same tree.

    What is a value and a namespace of values there is appended to `replaced`, by its path.
    """
    found: Tree = {}
    moved = False
    for path, value in leaves(tree, "/"):
        place = plain_path(path) or path  # one that says nothing but `ros__parameters: 5` stays
        moved = moved or place != path
        lost = merge(found, nest(place, value))
        if replaced is not None:
            replaced += lost
    return found if moved else tree


def plain_path(path: str) -> str:
    """Where a parameter of a path in a file of ROS 2 is in one of ROS 1.

    What is below `ros__parameters` of a node is directly below the node, and what a controller manager has there is
    beside it; dots part names.
    """
    node, mark, name = path.partition(f"/{ROS_2}")
    if not mark or name[:1] not in ("", "/"):
        return path
    return node.removesuffix("/controller_manager").removesuffix("/**") + name.replace(".", "/")


def retarget(tree: Tree, namespace: str) -> tuple[Tree, str | None]:
    """The tree to load at the root so that `namespace` has its controllers, and a notice when something was moved.

    A file that names the namespace is loaded as it stands. One that names another single one is moved. One that
    begins with the controllers themselves is put under the namespace.
    """
    target = "/" + namespace.strip("/")
    if not tree or (isinstance(at(tree, target), dict) and target != "/"):
        return tree, None
    if holds_controllers(tree):
        return nest(target, tree), None
    # Down from the root as long as there is but one way and no controllers.
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
    """What is at the names of `path` in a tree, or None."""
    branch = tree
    for name in path.strip("/").split("/"):
        branch = branch.get(name) if isinstance(branch, Mapping) else None
    return branch
