"""Reads YAML 1.1 text into a tree of parameters, as rosparam does, with file and line in every error.

`deg(90)` and `rad(pi/2)` become radians. Values that no parameter can have (null, a date, a key that is not text) are
refused; text that looks like another type gives a notice. The bounds are against: a file that was sent, whose aliases
unfold without end or which is nested too deeply for Python. This module imports yaml: import it lazily.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from slidectl.description.angles import DEGREES, RADIANS, add_to, angle
from slidectl.description.parameter_trees import Tree, merge, nest
from slidectl.description.robot import Notice
from slidectl.errors import BadFile

Pair = tuple[yaml.Node, yaml.Node]

MOST_BYTES = 2 * 2**20
MOST_VALUES = 200_000
DEEPEST = 60
NO_MAPPING = "expected names with values, as `name: value`"

REPLACED = "is a value, and a namespace of values too: the last one counts"
"""The notice for a path that `merge` returns."""
_LOOKS_LIKE_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)[eE][+-]?\d+|[+-]?(inf|nan)", re.IGNORECASE)
_MERGE = "tag:yaml.org,2002:merge"
_PLAIN = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")
_KINDS = {"null": "nothing", "timestamp": "a date", "binary": "binary"}


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with angles; a subclass, so that other users of PyYAML are not affected."""


add_to(_Loader)
_NO_BLANK = re.compile(r"\s*(?:- )?([A-Za-z_]\w*):([^\s/].*)")
"""A line with a name and a value without a blank between them; not `http://`."""


def read(text: str | bytes, file: str, notices: list[Notice] | None = None, *, rooted: bool = False) -> Tree:
    """The parameters of all documents in `text`; later documents override earlier ones. `file` is its name in messages.

    `rooted`: keep the leading slash of a name, which means that it is not relative to the namespace.

    Raises:
        BadFile: not YAML, not a mapping of names, or a value that no parameter can have.
    """
    return _Reader(file, notices if notices is not None else [], rooted=rooted).read(text)


def read_value(text: str, file: str) -> Any:
    """Read one value of any shape, as `rosparam set` does; empty text is None."""
    reader = _Reader(file, [])
    nodes = reader.nodes(text)
    if len(nodes) > 1:
        raise reader.error(nodes[1], "expected one value")
    return reader.value(nodes[0], 1) if nodes else None


def read_rosparam(text: str, file: str, notices: list[Notice]) -> Any:
    """Read the content of a `<rosparam>` in a launch file: one value of any shape; empty text and null are None.

    The leading slash of a name is kept, which means that it is not relative; `_ns` has no special meaning.
    """
    reader = _Reader(file, notices, rooted=True)
    nodes = documents(text, file)
    if len(nodes) > 1:
        raise reader.error(nodes[1], "a second document, where there can be only one")
    return reader.value(nodes[0], 1) if nodes and not _is_empty(nodes[0]) else None


def places(text: str | bytes, file: str) -> dict[str, int]:
    """The line of every value by its path, as `/slider/joint1_position_controller/pid/p` or `/a/extra_joints[0]/name`.

    For a name that is written twice it is the last line, as the last value counts.

    Raises:
        BadFile: not YAML.
    """
    reader = _Reader(file, [])
    found: dict[str, int] = {}
    for node in reader.nodes(text):
        reader.place(node, _namespace(node), found, 1)
    return found


def documents(text: str | bytes, file: str, loader: type[yaml.SafeLoader] = _Loader) -> list[yaml.Node]:
    """The nodes of all documents. The size is bounded, as reading takes seconds per MiB. Raises BadFile."""
    if len(text) > MOST_BYTES:
        raise BadFile(f"is larger than {MOST_BYTES // 2**20} MiB", file)
    try:
        return [node for node in yaml.compose_all(text, loader) if node is not None]
    except yaml.MarkedYAMLError as error:
        if is_too_deep(error):
            raise BadFile("is nested too deeply", file) from None
        mark = error.problem_mark or error.context_mark
        problem = " ".join(part for part in (error.context, error.problem) if part)
        raise BadFile(f"not YAML: {problem}", file, mark.line + 1 if mark else None, _advice(error, text)) from None
    except (yaml.YAMLError, ValueError) as error:
        raise BadFile(f"not YAML: {_problem(error)}", file) from None
    except RecursionError:
        raise BadFile("is nested too deeply", file) from None


def is_too_deep(error: yaml.YAMLError) -> bool:
    """True when the reader refuses the depth of a text. Some releases of it do, in others Python's stack ends first."""
    return "maximum nesting depth" in str(error)


def _namespace(document: yaml.Node) -> str:
    """The namespace of a document, which its `_ns` sets, as a path."""
    pairs = document.value if isinstance(document, yaml.MappingNode) else []
    written = next((str(value.value) for key, value in pairs if _text(key) == "_ns"), "")
    return "".join(f"/{name}" for name in written.split("/") if name)


class MergedPairs:
    """The keys and values of the mappings of one file, with those that `<<` merges into them."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.flat: dict[int, list[Pair]] = {}

    def of(self, node: yaml.MappingNode) -> list[Pair]:
        """Keys and values including merged ones; those of the mapping itself override merged ones.

        PyYAML's own flattening is exponential in the depth of nested merges; this one reads each mapping once.
        """
        if id(node) not in self.flat:
            own = [(key, value) for key, value in node.value if key.tag != _MERGE]
            self.flat[id(node)] = own
            if len(own) < len(node.value):
                merged = [pair for key, value in node.value if key.tag == _MERGE for pair in self._merged(value)]
                taken = {_text(key) for key, _ in own}
                more = {_text(key): (key, value) for key, value in reversed(merged) if _text(key) not in taken}
                self.flat[id(node)] = [*own, *more.values()]
        return self.flat[id(node)]

    def _merged(self, node: yaml.Node) -> list[Pair]:
        """The pairs of one `<<`: of a mapping, or of a list of mappings, of which earlier ones override later ones."""
        sources: list[Any] = node.value if isinstance(node, yaml.SequenceNode) else [node]
        for source in sources:
            if not isinstance(source, yaml.MappingNode):
                raise BadFile("`<<` merges mappings only", self.file, _line(source))
        return [pair for source in sources for pair in self.of(source)]


class _Reader:
    def __init__(self, file: str, notices: list[Notice], *, rooted: bool = False) -> None:
        self.file = file
        self.notices = notices
        self.rooted = rooted
        self.count = 0
        self.loader = _Loader("")
        self.pairs = MergedPairs(file).of

    def read(self, text: str | bytes) -> Tree:
        tree: Tree = {}
        for node in self.nodes(text):
            if not isinstance(node, yaml.MappingNode):
                raise self.error(node, NO_MAPPING)
            document = self.mapping(node, 1)
            namespace = document.pop("_ns", "")
            merge(tree, self.nested(str(namespace), document))
        return tree

    def nodes(self, text: str | bytes) -> list[yaml.Node]:
        """The documents that are not empty."""
        return [node for node in documents(text, self.file) if not _is_empty(node)]

    def error(self, node: yaml.Node, message: str, hint: str | None = None) -> BadFile:
        return BadFile(message, self.file, _line(node), hint)

    def value(self, node: yaml.Node, depth: int) -> Any:
        self.count += 1
        if self.count > MOST_VALUES or depth > DEEPEST:
            what = f"more than {MOST_VALUES} values" if depth <= DEEPEST else f"nested deeper than {DEEPEST}"
            raise self.error(node, f"{what}, counting what aliases repeat")
        if not isinstance(node, yaml.ScalarNode) and node.tag not in _PLAIN:
            raise self.error(node, f"a list or mapping cannot be {node.tag}")
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, depth)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(child, depth + 1) for child in node.value]
        assert isinstance(node, yaml.ScalarNode)
        return self.scalar(node)

    def mapping(self, node: yaml.MappingNode, depth: int) -> Tree:
        values: Tree = {}
        seen: dict[str, int] = {}
        for key_node, value_node in self.pairs(node):
            key = self.key(key_node)
            if key in seen:
                self.notice(key_node, key, f"is there twice, in line {seen[key]} too; the last one counts")
            seen[key] = _line(key_node)
            if _is_empty(value_node):
                raise self.error(key_node, f"{key!r} has no value", _missing(key))
            value = self.value(value_node, depth + 1)
            if not key.strip("/") and not isinstance(value, dict):
                raise self.error(key_node, f"{key!r} is no name for a value")
            values[key] = value
        tree: Tree = {}
        for key, value in values.items():
            for path in merge(tree, self.nested(key, value)):
                self.notices.append(Notice("wrong", path.removeprefix("/"), REPLACED, self.file, seen[key]))
        return tree

    def nested(self, key: str, value: Any) -> Tree:
        """The value as a tree below the names in its key."""
        tree: Tree = nest(key, value)
        if self.rooted and key.startswith("/"):
            tree = {f"/{name.lstrip('/')}": below for name, below in tree.items()}
        return tree

    def place(self, node: yaml.Node, path: str, found: dict[str, int], depth: int) -> None:
        """Record the lines of everything below `node`, within the bounds for values."""
        self.count += 1
        if self.count > MOST_VALUES or depth > DEEPEST:
            return
        if isinstance(node, yaml.SequenceNode):
            for index, child in enumerate(node.value):
                found[f"{path}[{index}]"] = _line(child)
                self.place(child, f"{path}[{index}]", found, depth + 1)
        elif isinstance(node, yaml.MappingNode):
            for key, value in self.pairs(node):
                below = path
                for name in (part for part in _text(key).split("/") if part):
                    below += f"/{name}"
                    found[below] = _line(key)
                self.place(value, below, found, depth + 1)

    def key(self, node: yaml.Node) -> str:
        if not isinstance(node, yaml.ScalarNode) or node.tag != "tag:yaml.org,2002:str":
            text = node.value if isinstance(node, yaml.ScalarNode) else "a list or mapping"
            raise self.error(node, f"{text} is no name: names are text", f'quote it: "{text}"')
        return str(node.value)

    def scalar(self, node: yaml.ScalarNode) -> Any:
        if node.tag in (DEGREES, RADIANS):
            return self.angle(node)
        try:
            value = self.loader.construct_object(node)
        except (yaml.YAMLError, ValueError, OverflowError) as error:
            raise self.error(node, f"{node.value!r} cannot be read: {_problem(error)}") from None
        if not isinstance(value, bool | int | float | str):
            kind = _KINDS.get(node.tag.rpartition(":")[2], node.tag)
            raise self.error(node, f"{node.value!r} is {kind}, which no parameter can be", "quote it to mean text")
        if isinstance(value, str) and node.style is None and _LOOKS_LIKE_NUMBER.fullmatch(value):
            self.notice(node, value, "is text in YAML 1.1, not a number; write 1.0e-3 or 1.0e+3, .inf, .nan")
        return value

    def angle(self, node: yaml.ScalarNode) -> float:
        try:
            return angle(node.value, node.tag)
        except (ValueError, ArithmeticError, RecursionError) as error:
            raise self.error(node, f"{node.value.strip()!r} is not an angle: {error}") from None

    def notice(self, node: yaml.Node, subject: str, text: str) -> None:
        self.notices.append(Notice("wrong", subject, text, self.file, _line(node)))


def _is_empty(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:null"


def _advice(error: yaml.MarkedYAMLError, text: str | bytes) -> str | None:
    """A hint about frequent mistakes."""
    problem = str(error.problem)
    if "could not find expected ':'" in problem:
        # The parser notices a name without a value one line later, at the next colon.
        shown = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
        last = error.problem_mark.line if error.problem_mark else 0
        for line in reversed(shown.splitlines()[: last + 1]):
            if found := _NO_BLANK.fullmatch(line):
                return f"a blank follows the colon: {found[1]}: {found[2]}"
    if "'\\t'" in problem:
        return "a tab is no blank in YAML: use spaces"
    if "expected <block end>" in problem or "mapping values are not allowed" in problem:
        return "names that belong together begin in the same column, and a blank follows each colon"
    return None


def _missing(key: str) -> str:
    if ":" in key:
        return f"a blank follows the colon: {key.replace(':', ': ', 1)}"
    return "write one, indent what belongs to it, or leave the name out"


def _text(key: yaml.Node) -> str:
    return str(key.value) if isinstance(key, yaml.ScalarNode) else f"#{id(key)}"


def _problem(error: Exception) -> str:
    """The reason of an error, without its position."""
    return str(getattr(error, "problem", None) or " ".join(str(error).split()))


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1
