"""Graph names: what is legal, how a relative one becomes absolute, and how a short one finds its full name.

ROS's naming rules, plus the rule of the command line that the unique end of a name is enough.
Standard library only.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from slidectl.errors import AmbiguousName, BadName, UnknownName

OWN_NODE = "/slidectl"
"""The node, and the namespace, of what ROS and Gazebo have not."""
LONGEST = 1000
"""Characters of a name, with all that stands above it. What is longer is an error or an attack."""

_LEGAL = r"(?a)(?!.*//)(?!.+/\Z)[A-Za-z/~][\w/]*\Z"
_COMPONENT = r"(?a)[A-Za-z]\w*\Z"
_PARAMETER = r"(?=.)/?(?:[^\s\x00-\x1f\x7f/~][^\s\x00-\x1f\x7f/]*(?:/(?!\Z)|\Z))*\Z"


def is_legal(name: str) -> bool:
    """True for a legal graph name (no double or trailing slash; `/` alone is the root; not longer than LONGEST)."""
    return len(name) <= LONGEST and bool(re.match(_LEGAL, name))


def is_component(name: str) -> bool:
    """True for what is one part of a graph name: a letter, then letters, digits and '_'."""
    return len(name) <= LONGEST and bool(re.match(_COMPONENT, name))


def check(name: str) -> str:
    """The name itself. Raises BadName when it is not legal."""
    if not is_legal(name):
        raise TooLong(name) if len(name) > LONGEST else BadName(name)
    return name


class TooLong(BadName):
    """A name of more characters than any name may have."""

    def __init__(self, name: str) -> None:
        super().__init__(name, f"name: it has {len(name)} characters, and {LONGEST} is the most")


def check_absolute(name: str, kind: str) -> str:
    """The name itself: that of a topic or a service. Raises BadName unless it begins with a slash, and is not all."""
    if not check(name).startswith("/") or name == "/":
        hint = "that is the root of all names" if name == "/" else f"write /{name}"
        raise BadName(name, f"name of a {kind}: it begins with '/', and more follows", hint)
    return name


def check_parameter(name: str) -> str:
    """The name itself. Raises BadName when no parameter can have it: they may be `joint-1.2`, but hold no blanks."""
    if len(name) > LONGEST:
        raise TooLong(name)
    if not re.match(_PARAMETER, name):
        raise BadName(name, "name of a parameter: parts without blanks, with a '/' between and no '~' in front")
    return name


def check_robot(name: str) -> str:
    """The name itself. Raises BadName unless it can be a robot's: one component of a name."""
    if len(name) > LONGEST:
        raise TooLong(name)
    if not is_component(name):
        raise BadName(name, "name of a robot: a letter, then letters, digits and '_'", "give it another name (-n NAME)")
    return name


def join(namespace: str, name: str) -> str:
    """`name` under `namespace`, absolute; an absolute name stays as it is."""
    if name.startswith("/"):
        return name
    return "/" + "/".join(part for part in (namespace.strip("/"), name.strip("/")) if part)


def parent(name: str) -> str:
    """The namespace that holds `name`; the root's is the root."""
    return name.rpartition("/")[0] or "/"


def is_under(name: str, namespace: str) -> bool:
    """True when `name` is `namespace` or lies below it, on whole components."""
    base = namespace.rstrip("/")
    return not base or name == base or name.startswith(base + "/")


def cut_from_field(text: str) -> Iterator[tuple[str, str]]:
    """All ways to cut `TOPIC/field[i]` into topic and field, the longest topic first; an index belongs to the field."""
    plain = text.partition("[")[0]
    end = len(text) if plain == text else plain.rfind("/")
    while end > 0:
        yield text[:end], text[end + 1 :]
        end = text.rfind("/", 0, end)


def resolve(name: str, known: Iterable[str], *, kind: str, namespace: str = "/") -> str:
    """The full name that `name` means: exact if absolute, else under `namespace`, else the unique end of a known name.

    Raises:
        UnknownName: nothing fits. AmbiguousName: several do.
    """
    names = set(known)
    exact = join(namespace, name)
    if exact in names:
        return exact
    if name.startswith("/"):
        raise UnknownName(kind, name, sorted(names))
    matches = sorted(n for n in names if n.endswith("/" + name))
    if not matches:
        raise UnknownName(kind, name, sorted(names))
    inside = [n for n in matches if is_under(n, namespace)] if namespace.strip("/") else []
    matches = inside if len(matches) > 1 and inside else matches
    if len(matches) > 1:
        raise AmbiguousName(kind, name, matches)
    return matches[0]
