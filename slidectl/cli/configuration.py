"""Controllers' parameter files: YAML as `rosparam load` takes it, put under the namespace of the robot that it is for.

Reads files and sets parameters. What a parameter means is the controller's affair.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from slidectl import names
from slidectl.cli.context import Context
from slidectl.errors import BadFile, UsageError

Tree = dict[str, Any]


def read(file: str, namespaces: Sequence[str]) -> Tree:
    """The parameters of a file by full name, moved to the robot's namespace where the file is for another one.

    Args:
        namespaces: those of the robots that it may be for.

    Raises:
        BadFile: missing or no parameters. UsageError: broken YAML, or not clear which robot it is for.
    """
    path = _find(file)
    tree: Tree = {}
    for document in _documents(path):
        tree |= dict(leaves(placed(document, namespaces, str(path))))
    return tree


def _find(file: str) -> Path:
    """The file, else the shipped one of that name, so that the tutorials' lines work in any folder."""
    from slidectl.paths import share

    path = Path(file).expanduser()
    shipped = share("config") / path.name
    if not path.exists() and path.parent.name in ("", "config") and shipped.exists():
        return shipped
    return path


def _documents(path: Path) -> Iterator[Tree]:
    from slidectl.cli.values import read_documents

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(f"cannot be read: {getattr(error, 'strerror', None) or error}", str(path)) from None
    for value in read_documents(text, f"file {path}"):
        if isinstance(value, dict):
            yield value
        elif value is not None:
            raise BadFile(
                "holds no mapping of parameters", str(path), hint="a file begins with the namespace: `slider:`"
            )


def placed(tree: Tree, namespaces: Sequence[str], file: str) -> Tree:
    """The tree from the root on, in which the controllers are below one of the namespaces if that can be told.

    A file whose top key is one of the namespaces stays as it is. One with another single top key, or with controllers
    at the top, is meant for the one robot there is. All else stays as it is, as `rosparam load` has it.
    """
    if any(_below(tree, namespace) is not None for namespace in namespaces):
        return tree
    content = _controllers(tree)
    if content is None or not namespaces:
        return tree
    if len(namespaces) > 1:
        raise UsageError(f"{file} fits none of {', '.join(namespaces)} by its top key", "say which with --cm")
    return _wrapped(content, namespaces[0])


def _below(tree: Tree, namespace: str) -> Any:
    value: Any = tree
    for part in namespace.strip("/").split("/"):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _controllers(tree: Tree) -> Tree | None:
    """The mapping that holds the controllers: the tree itself, or what its only key holds."""
    if _holds_controllers(tree):
        return tree
    only = next(iter(tree.values())) if len(tree) == 1 else None
    return only if _holds_controllers(only) else None


def _holds_controllers(tree: Any) -> bool:
    """True when at least one member has a `type`, as every controller has."""
    members = tree.values() if isinstance(tree, Mapping) else ()
    return any(isinstance(member, Mapping) and isinstance(member.get("type"), str) for member in members)


def _wrapped(content: Tree, namespace: str) -> Tree:
    for part in reversed([part for part in namespace.split("/") if part]):
        content = {part: content}
    return content


def leaves(tree: Tree, namespace: str = "/") -> Iterator[tuple[str, Any]]:
    """Full name and value of every parameter in a tree. Lists and empty mappings are values."""
    for key, value in tree.items():
        name = names.check(names.join(namespace, key.strip("/")))
        if isinstance(value, dict) and value:
            yield from leaves(value, name)
        else:
            yield name, value


def store(ctx: Context, parameters: Tree) -> None:
    """Set them all; others that are there stay. Raises UsageError before the first when JSON cannot carry a value."""
    texts = {name: _as_json(name, value) for name, value in parameters.items()}
    calls = [ctx.client.call_async("/rosapi/set_param", {"name": n, "value": text}) for n, text in texts.items()]
    for call in calls:
        ctx.client.answer(call)


def _as_json(name: str, value: Any) -> str:
    try:
        return json.dumps(value, allow_nan=False)
    except ValueError:
        raise UsageError(f"parameter {name} cannot be set to {value}: parameters hold finite numbers") from None
