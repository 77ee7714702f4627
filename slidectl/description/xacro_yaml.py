"""`xacro.load_yaml`: a YAML file as values with dotted access, units (`!degrees 90`) included, within bounds.

PyYAML itself follows aliases of aliases, and merges of merges, until memory is gone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import xacro
import yaml

from slidectl.description.models import read_regular
from slidectl.description.packages import shown
from slidectl.description.yaml_tree import MOST_BYTES
from slidectl.errors import BadFile

MOST_VALUES = 50_000
_MOST_DIGITS = 400
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")

Number = Callable[[str], float]


def load(path: Path, number: Number) -> Any:
    """The values of a file. `number` computes the text of one that has a unit.

    Raises:
        OSError: it cannot be read. BadFile: no regular file, not YAML, or too large. What `number` raises.
    """
    content = read_regular(path, MOST_BYTES)
    if len(content) > MOST_BYTES:
        raise BadFile(f"is larger than {MOST_BYTES >> 20} MiB", shown(path))
    try:
        loader = _loader(number)(content)
        node = loader.get_single_node()
        if node is None:
            return None
        _check_size(node, shown(path))
        return xacro.YamlListWrapper.wrap(loader.construct_document(node))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = " ".join(part for part in (error.context, error.problem) if part)
        raise BadFile(f"not YAML: {problem}", shown(path), mark.line + 1 if mark else None) from None
    except yaml.YAMLError as error:
        raise BadFile(f"not YAML: {' '.join(str(error).split())}", shown(path)) from None
    except RecursionError:
        raise BadFile("is nested too deeply", shown(path)) from None


def _loader(number: Number) -> type[yaml.SafeLoader]:
    """PyYAML's safe loader that also knows units, without touching the one that others use, as xacro does."""

    class Loader(yaml.SafeLoader):
        """Of one file."""

    for unit in xacro.ConstructUnits:
        Loader.add_constructor(unit.value.tag, _constructor(unit.value.conversion_constant, number))
    return Loader


def _constructor(factor: float, number: Number) -> Callable[[yaml.SafeLoader, yaml.ScalarNode], float]:
    return lambda loader, node: factor * number(str(loader.construct_scalar(node)))


def _check_size(root: yaml.Node, file: str) -> None:
    """Raises BadFile for more values than anybody needs, counted as often as aliases repeat them, and long numbers."""
    count = 0
    pending = [root]
    while pending:
        node = pending.pop()
        count += 1
        line = node.start_mark.line + 1
        if count > MOST_VALUES:
            raise BadFile(f"more than {MOST_VALUES} values, counting what aliases repeat", file, line)
        if isinstance(node, yaml.MappingNode):
            pending += [each for pair in node.value for each in pair]
        elif isinstance(node, yaml.SequenceNode):
            pending += node.value
        elif node.tag in _NUMBERS and len(node.value) > _MOST_DIGITS:
            raise BadFile(f"a number of more than {_MOST_DIGITS} digits", file, line)
