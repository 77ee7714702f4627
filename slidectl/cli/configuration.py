"""Controllers' parameter files: found, put under the namespace of the robot that they are for, and set as parameters.

What a file may hold is for description.controllers_file, what a parameter means for the controller.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.cli.context import Context
from slidectl.client.spawning import Tree, find, leaves, placements
from slidectl.errors import UsageError

if TYPE_CHECKING:
    from slidectl.description.robot import Notice


def read(ctx: Context, file: str, namespaces: Sequence[str]) -> Tree:
    """The parameters of a file by full name, moved to the robot's namespace where the file is for another one.

    Args:
        namespaces: those of the robots that it may be for.

    Raises:
        BadFile: missing, or no parameters. UsageError: not clear which robot it is for.
    """
    from slidectl.description import controllers_file

    path = find(file)
    notices: list[Notice] = []
    tree = controllers_file.read(path, notices)
    for notice in notices:
        ctx.warn(str(notice))
    _warn_unknown(ctx, tree, path)
    return dict(leaves(_placed(ctx, tree, namespaces, str(path))))


def _warn_unknown(ctx: Context, tree: Tree, path: Path) -> None:
    """Names in a file that no controller knows, such as `kd` for a gain, as `check` tells them."""
    from slidectl.check.controllers import ParameterFile, unknown
    from slidectl.check.findings import Findings
    from slidectl.description import yaml_tree
    from slidectl.description.models import read_file

    places = {name: (str(path), line) for name, line in yaml_tree.places(read_file(path), str(path)).items()}
    for notice in unknown(tree, ParameterFile(str(path), places, Findings())):
        ctx.warn(str(notice))


def warn_unknown(ctx: Context, namespace: str, controllers: Sequence[str]) -> None:
    """The same for the parameters that the daemon has for some controllers of a namespace."""
    from slidectl.check.controllers import ParameterFile, unknown
    from slidectl.check.findings import Findings

    for name in dict.fromkeys(controllers):
        request = {"name": names.join(namespace, name), "default": "null"}
        tree = json.loads(ctx.call("/rosapi/get_param", request)["value"])
        for part in reversed(name.split("/")):
            tree = {part: tree}
        for notice in unknown(tree, ParameterFile("", {}, Findings(), namespace)):
            ctx.warn(f"{notice.subject}: {notice.text}")


def _placed(ctx: Context, tree: Tree, namespaces: Sequence[str], file: str) -> Tree:
    """The tree from the root on. Where no robot can be told it stays as it is, as `rosparam load` has it."""
    placed, remark, moved = placements(tree, namespaces)
    if moved and len(namespaces) > 1:
        raise UsageError(f"{file} fits none of {', '.join(namespaces)} by its top key", "say which with --cm")
    if remark:
        (ctx.detail if moved else ctx.warn)(f"{file}: {remark}")
    return placed


def store(ctx: Context, parameters: Tree, known_only: bool = False) -> list[str]:
    """Set them all, or none; others that are there stay. What controllers say to it is a warning.

    Args:
        known_only: a name below a loaded controller that it does not read is an error.

    Returns:
        The names that were not set before, without those below a loaded controller: the controller has judged these.

    Raises:
        Refused: a loaded controller cannot take a value. UsageError: JSON cannot carry a value.
    """
    texts = [_as_json(name, value) for name, value in parameters.items()]
    request = {"names": list(parameters), "values": texts, "known_only": known_only}
    answer = ctx.call("/slidectl/set_params", request)
    for reason in ctx.client.reasons:
        ctx.warn(reason)
    return [name for name in answer["created"] if name not in answer["guarded"]]


def _as_json(name: str, value: Any) -> str:
    try:
        return json.dumps(value, allow_nan=False)
    except ValueError:
        raise UsageError(f"parameter {name} cannot be set to {value}: parameters hold finite numbers") from None
