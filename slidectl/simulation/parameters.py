"""The parameter tree: values by name, subtrees as dicts, search upwards, guards and watchers.

Guards are called before a change and may refuse it; watchers are called after it.

Semantics of the ROS parameter server, but stricter: names are checked, and null is not a value.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from slidectl import names
from slidectl.control.node_handle import MISSING, ParameterChange, ParameterJudge
from slidectl.errors import Refused, UnknownName, UsageError, quoted

Path = tuple[str, ...]
C = TypeVar("C")
DEEPEST = 64
"""The most levels of namespaces, mappings and lists above a value."""
LARGEST = 128 * 1024 * 1024
"""The most characters of all parameters together; each value counts as LEAST plus the characters of its text."""
LEAST = 80

_BLANK = re.compile(r"\s")
_PLAIN_KEY = re.compile(r"\w{1,100}\Z", re.ASCII)
_LARGE = 1 << 53


class UnknownParameter(UnknownName, KeyError):
    """A parameter that is not set."""


@dataclass(eq=False)
class Hook(Generic[C]):
    """One watcher or guard of one name."""

    path: Path
    callback: C
    is_open: bool = True


class Hooks(Generic[C]):
    """All watchers, or all guards, grouped by the first part of their names, so that many robots stay fast."""

    def __init__(self) -> None:
        self._groups: defaultdict[Path, dict[Hook[C], None]] = defaultdict(dict)

    def add(self, path: Path, callback: C) -> Callable[[], None]:
        """Call back for changes at `path`, below it or above it. Returns the function that ends this."""
        hook, first = Hook(path, callback), path[:1]
        self._groups[first][hook] = None

        def close() -> None:
            hook.is_open = False
            self._groups[first].pop(hook, None)

        return close

    def concerned(self, changed: list[Path]) -> Iterator[Hook[C]]:
        """The hooks that a change of these paths concerns. A hook that is closed meanwhile is skipped."""
        firsts = dict.fromkeys([(), *(path[:1] for path in changed)]) if all(changed) else self._groups.keys()
        near = [hook for first in firsts if first in self._groups for hook in self._groups[first]]
        for hook in near:
            if hook.is_open and any(_related(hook.path, path) for path in changed):
                yield hook


class Parameters:
    """The tree. Values are bool, int, float, str, lists and dicts of these; reads and writes copy them."""

    def __init__(self) -> None:
        self._root: dict[str, Any] = {}
        self._derived: set[Path] = set()
        """Parameters that a node of the simulation has set where no client had: defaults of gains, a robot's model."""
        self._names: list[str] | None = None
        """All names in order; None after a change. A client may ask for unknown names again and again."""
        self._counted = 0
        """The size of the tree at the last count, plus the size of all values set since."""
        self._watches: Hooks[Callable[[], None]] = Hooks()
        self._guards: Hooks[ParameterJudge] = Hooks()
        self.on_change: list[Callable[[list[str]], None]] = []
        """Called with the names of changed or deleted parameters, before the watchers."""

    def get(self, name: str, default: Any = MISSING) -> Any:
        """The value, a dict for a namespace. Raises UnknownParameter (a KeyError too) when unset without default."""
        found = self.view(name, default)
        return found if found is default else deepcopy(found)

    def view(self, name: str, default: Any = MISSING) -> Any:
        """The value as in `get`, but not copied: only for immediate reading. Raises as `get`."""
        found = self._find(_path(name))
        if found is not MISSING:
            return found
        if default is MISSING:
            raise UnknownParameter("parameter", name, self.names())
        return default

    def has(self, name: str) -> bool:
        """True when the parameter or one below it is set."""
        return self._find(_path(name)) is not MISSING

    def given(self, name: str) -> dict[str, Any]:
        """What clients have set at `name` or below it, as a tree from the root, which shares its lists with this one.

        Raises UnknownParameter when neither clients nor nodes have set anything there.
        """
        path = _path(name)
        value = self.view(name)
        tree: dict[str, Any] = {}
        for leaf, content in _leaves(value, path):
            if leaf and leaf not in self._derived:
                _assign(tree, leaf, content)
        return tree

    def derived(self) -> list[str]:
        """The names of the parameters that nodes have set where no client had, sorted."""
        return sorted("/" + "/".join(path) for path in self._derived)

    def set(self, name: str, value: Any, merge: bool = False, derived: bool = False) -> None:
        """Set a value. A mapping replaces the present one; with `merge` the keys that it does not have stay.

        With `derived` a node of the simulation sets it, not a client: `given` leaves it out, unless it changes a value.

        Raises:
            BadName: an invalid name or key. UsageError: a value that no parameter can have, or a root that is not a
            mapping. SlidectlError: a guard refused it.
        """
        path, checked = _settable(name, value)
        before = self._find(path)
        derives = derived and (before is MISSING or (path in self._derived and before == checked))
        self._set(list(_leaves(checked, path)) if merge else [(path, checked)])
        if derives:
            self._derived.update(leaf for leaf, _ in _leaves(checked, path))

    def set_all(self, values: Mapping[str, Any], known_only: bool = False) -> None:
        """Set several, all of them or none. Raises as `set`.

        With `known_only` the guards refuse names that no code reads.
        """
        self._set([_settable(name, value) for name, value in values.items()], known_only)

    def _set(self, leaves: list[tuple[Path, Any]], known_only: bool = False) -> None:
        self._judge(leaves, known_only=known_only)
        self._check_room(leaves)
        self._forget_derived([leaf for leaf, _ in leaves])
        for leaf, content in leaves:
            if leaf:
                _assign(self._root, leaf, content)
            else:
                self._root = content
        self._notify([leaf for leaf, _ in leaves])

    def tree(self) -> dict[str, Any]:
        """A copy of the whole tree. It shares its lists with the tree; they are never modified."""
        copy: dict[str, Any] = _copied(self._root)
        return copy

    def replace(self, tree: dict[str, Any], derived: Iterable[str], without: Iterable[str] = ()) -> None:
        """Replace the tree, without these names and without asking guards. Watchers of changed values are called.

        `derived` has the names that `derived` returned for this tree.

        Raises UsageError: a value that no parameter can have.
        """
        if without:
            tree = _copied(tree)
            for name in without:
                _assign(tree, _path(name), MISSING)
        self._derived = set(map(_path, derived))
        # As texts, since 1, 1.0 and true are three values.
        before, after = ({path: repr(value) for path, value in _leaves(root, ())} for root in (self._root, tree))
        changed = [path for path in dict.fromkeys((*before, *after)) if before.get(path) != after.get(path)]
        if not changed:
            return
        self._root = _settable("/", tree)[1]
        self._counted = _size(self._root)
        self._notify(changed)

    def delete(self, name: str) -> None:
        """Delete a parameter or a whole namespace.

        Raises UnknownParameter: it is not set. SlidectlError: a guard refused it.
        """
        path = _path(name)
        if self._find(path) is MISSING:
            raise UnknownParameter("parameter", name, self.names())
        self._judge([(path, MISSING)], deletes=True)
        self._forget_derived([path])
        deleted = path
        if not path:
            self._root = {}
        while path:  # namespaces that become empty go too, so that `has` does not see them
            del self._find(path[:-1])[path[-1]]
            path = path[:-1]
            if self._find(path):
                break
        self._notify([deleted])

    def names(self, namespace: str = "/") -> list[str]:
        """Absolute names of all values below `namespace`, sorted."""
        path = _path(namespace)
        if path or self._names is None:
            found = self._find(path)
            is_empty = found is MISSING or not (path or found)
            result = [] if is_empty else sorted("/" + "/".join(leaf) for leaf, _ in _leaves(found, path))
            if path:
                return result
            self._names = result
        return list(self._names)

    def search(self, namespace: str, name: str) -> str | None:
        """`name` in `namespace` or the nearest namespace above that has its first component, else None."""
        wanted = _path(name)
        if name.startswith("/"):
            return name if self.has(name) else None
        base = _path(namespace)
        for depth in range(len(base), -1, -1):
            if self._find((*base[:depth], *wanted[:1])) is not MISSING:
                return "/" + "/".join((*base[:depth], *wanted))
        return None

    def watch(self, name: str, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back once per call that sets or deletes the parameter, one below it or a namespace above it.

        Returns the function that ends this.
        """
        return self._watches.add(_path(name), callback)

    def guard(self, name: str, judge: ParameterJudge) -> Callable[[], None]:
        """Call `judge` once before each call that sets or deletes the parameter, one below it or a namespace above it.

        Returns the function that ends this.
        """
        return self._guards.add(_path(name), judge)

    def is_guarded(self, name: str) -> bool:
        """True when a guard is called before the parameter is set."""
        return any(True for _ in self._guards.concerned([_path(name)]))

    def _judge(self, leaves: list[tuple[Path, Any]], *, deletes: bool = False, known_only: bool = False) -> None:
        """Ask the guards. Raises the error of the first guard that refuses."""
        for guard in self._guards.concerned([leaf for leaf, _ in leaves]):
            before = self._find(guard.path)
            after = _copied(before)
            for leaf, content in leaves:
                after = _with(after, guard.path, leaf, content)
            guard.callback(ParameterChange(before, after, deletes, known_only))

    def _forget_derived(self, changed: list[Path]) -> None:
        """Take what is set or deleted now, and all below it or above it, for what clients have set."""
        # One look for each path and each part of it: a line may set a hundred thousand.
        firsts = {one[:1] for one in self._derived}
        near = [path for path in changed if path[:1] in firsts or not path]
        whole = set(near)
        above = {path[:depth] for path in near for depth in range(len(path))}
        self._derived -= {
            one for one in self._derived if one in above or any(one[:depth] in whole for depth in range(len(one) + 1))
        }

    def _find(self, path: Path) -> Any:
        node: Any = self._root
        for part in path:
            if not isinstance(node, dict) or part not in node:
                return MISSING
            node = node[part]
        return node

    def _check_room(self, leaves: list[tuple[Path, Any]]) -> None:
        """Raise Refused when the tree has no room for these. The exact size is computed only if needed."""
        growth = sum(_size(content) for _, content in leaves)
        if self._counted + growth > LARGEST:
            self._counted = _size(self._root)
            growth -= sum(_size(self._find(leaf)) for leaf, _ in leaves if self._find(leaf) is not MISSING)
            if self._counted + growth > LARGEST:
                raise Refused(f"all parameters together would be larger than {LARGEST} characters", "delete some")
        self._counted += growth

    def _notify(self, changed: list[Path]) -> None:
        """Call the watchers, all of them even if one fails; then raise the first failure."""
        self._names = None
        full = ["/" + "/".join(path) for path in changed]
        for callback in self.on_change:
            callback(full)
        failure: Exception | None = None
        for watch in self._watches.concerned(changed):
            try:
                watch.callback()
            except Exception as error:
                failure = failure or error
        if failure is not None:
            raise failure


def _copied(value: Any) -> Any:
    """A copy whose mappings may be written; lists are shared."""
    return {key: _copied(below) for key, below in value.items()} if isinstance(value, dict) else value


def _assign(tree: dict[str, Any], path: Path, value: Any) -> None:
    """Set the value at the path in the tree; MISSING removes it."""
    *above, last = path
    for part in above:
        below = tree.get(part)
        if not isinstance(below, dict):
            below = tree[part] = {}
        tree = below
    if value is MISSING:
        tree.pop(last, None)
    else:
        tree[last] = value


def _with(value: Any, place: Path, leaf: Path, content: Any) -> Any:
    """The value at `place` after `content` (MISSING: nothing) was set at `leaf`; `value` is the one before."""
    if not _related(place, leaf):
        return value
    if len(leaf) <= len(place):
        for part in place[len(leaf) :]:
            if not isinstance(content, dict):
                return content
            content = content.get(part, MISSING)
        return _copied(content)
    value = value if isinstance(value, dict) else {}
    _assign(value, leaf[len(place) :], _copied(content))
    return value


def _size(value: Any) -> int:
    """The size of a value as counted for LARGEST."""
    if isinstance(value, dict):
        return sum(len(key) + _size(below) for key, below in value.items())
    if isinstance(value, list):
        return LEAST * len(value) + sum(_size(item) for item in value if type(item) in (str, list, dict))
    return LEAST + (len(value) if isinstance(value, str) else 0)


def _settable(name: str, value: Any) -> tuple[Path, Any]:
    """The path and a checked copy of the value. Raises BadName, UsageError."""
    path = _path(names.check_parameter(name))
    checked = _checked(value, name, len(path))
    if not path and not isinstance(checked, dict):
        raise UsageError("the root of the parameters is a mapping", "give a name")
    return path, checked


def _path(name: str) -> Path:
    """Split a name. Raises TooLong first: a client may send a name of a million parts."""
    if len(name) > names.LONGEST:
        raise names.TooLong(name)
    return tuple(part for part in name.split("/") if part)


def _related(one: Path, other: Path) -> bool:
    shared = min(len(one), len(other))
    return one[:shared] == other[:shared]


def _leaves(value: Any, path: Path) -> Iterator[tuple[Path, Any]]:
    if isinstance(value, dict) and value:
        for key, below in value.items():
            yield from _leaves(below, (*path, key))
    else:
        yield path, value


def _checked(value: Any, where: str, depth: int) -> Any:
    """A checked copy, in which keys with slashes become nested mappings. The error of a bad value names its place."""
    if depth > DEEPEST:
        raise UsageError(f"parameter {where[:80]}... is nested deeper than {DEEPEST} levels")
    if isinstance(value, dict):
        return _checked_mapping(value, where, depth)
    if isinstance(value, list | tuple):
        return [
            item if _is_plain(item) else _checked(item, f"{where}[{index}]", depth + 1)
            for index, item in enumerate(value)
        ]
    if isinstance(value, str):
        return _checked_text(value, where)
    if isinstance(value, bool | int | float):
        try:
            if math.isfinite(value):
                return value
            shown = str(value)
        except OverflowError:
            shown = "an integer beyond 1e308"
        # JSON has finite numbers only, and no control law needs others.
        raise UsageError(f"parameter {where}: {shown} is not a finite number")
    kind = "null" if value is None else type(value).__name__
    raise UsageError(
        f"parameter {where}: {kind} is not a value", "a parameter is a bool, a number, a string, a list or a mapping"
    )


def _is_plain(value: Any) -> bool:
    """True for bools and numbers that need no further check. This is fast, for large lists."""
    kind = type(value)
    return kind is bool or (kind is float and value - value == 0.0) or (kind is int and -_LARGE < value < _LARGE)


def _checked_text(text: str, where: str) -> str:
    """The text. Refuses half of a surrogate pair: JSON can contain it, but it cannot be encoded."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UsageError(f"parameter {where}: {text[:40]!r} contains half of a surrogate pair") from None
    return text


def _checked_mapping(value: dict[Any, Any], where: str, depth: int) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, below in value.items():
        if isinstance(key, str) and _is_plain(below) and _PLAIN_KEY.match(key):
            result[key] = below
            continue
        if not isinstance(key, str) or not _path(key) or _BLANK.search(key):
            raise UsageError(f"parameter {where}: {quoted(str(key))} is not a name", "names are text without blanks")
        path = _path(_checked_text(key, where))
        content = _checked(below, f"{where.rstrip('/')}/{key.strip('/')}", depth + len(path))
        node = result
        for part in path[:-1]:
            node = node.setdefault(part, {})
        if isinstance(content, dict) and isinstance(node.get(path[-1]), dict):
            node[path[-1]] |= content
        else:
            node[path[-1]] = content
    return result
