"""`<node>` with what is inside it, and what `<remap>` and `<env>` say.

What a node does when it runs is the affair of nodes/.
"""

from __future__ import annotations

from dataclasses import replace

from slidectl import names
from slidectl.launch import parameter_tags
from slidectl.launch.plan import Node, Remap
from slidectl.launch.scope import Scope
from slidectl.launch.tag import Tag

ATTRIBUTES = (
    "pkg", "type", "name", "args", "ns", "output", "respawn", "respawn_delay", "required", "cwd", "launch-prefix",
    "machine", "clear_params",
)  # fmt: skip
OUTPUTS = ("log", "screen")
FOLDERS = ("node", "ROS_HOME")


def node(tag: Tag) -> None:
    """Add the node to the plan, and its parameters."""
    tag.knows(ATTRIBUTES)
    made = _node(tag)
    for other in tag.plan.nodes:
        if other.full_name == made.full_name:
            hint = "give one of them another name, or $(anon NAME)"
            raise tag.error(f"there is a node {made.full_name} already, at {other.place}", hint)
    inner = tag.scope.group(made.namespace)
    if tag.boolean("clear_params"):
        tag.plan.clear.append((made.full_name, tag.place))
    tag.plan.settings += [
        replace(setting, name=tag.within(made.full_name, setting.name)) for setting in tag.scope.private
    ]
    _inside(Tag(tag.element, inner), inner, made)
    made.remaps, made.environment = inner.remaps, inner.environment
    tag.plan.nodes.append(made)


def _node(tag: Tag) -> Node:
    name = tag.required("name")
    if "/" in name:
        raise tag.error(f"the name {name!r} of a node cannot hold a namespace", "use ns=")
    if not names.is_legal(name) or name.startswith("~"):
        raise tag.error(f"{name!r} cannot be the name of a node", "names are letters, digits and '_', a letter first")
    if tag.get("machine"):
        raise tag.error("there are no other machines here", "leave out machine=: all nodes run on this one")
    respawn, required = tag.boolean("respawn"), tag.boolean("required")
    if respawn and required:
        raise tag.error("respawn and required exclude each other")
    return Node(
        package=tag.required("pkg"),
        type=tag.required("type"),
        name=name,
        namespace=tag.namespace(),
        place=tag.place,
        words=tag.words("args"),
        output=_one_of(tag, "output", OUTPUTS),
        respawn=respawn,
        respawn_delay_s=tag.number("respawn_delay", 0.0),
        required=required,
        cwd=_one_of(tag, "cwd", FOLDERS),
        launch_prefix=tag.words("launch-prefix"),
        file=str(tag.scope.file),
    )


def _one_of(tag: Tag, attribute: str, known: tuple[str, ...]) -> str | None:
    value = (tag.get(attribute) or "").strip()
    by_lower_case = {name.lower(): name for name in known}
    if value and value.lower() not in by_lower_case:
        raise tag.error(f"{attribute} is one of {', '.join(known)}, not {value!r}")
    return by_lower_case.get(value.lower())


def _inside(tag: Tag, scope: Scope, made: Node) -> None:
    for child in tag.children(("param", "rosparam", "remap", "env")):
        if not child.applies:
            continue
        if child.name == "param":
            parameter_tags.param(child, made.full_name)
        elif child.name == "rosparam":
            parameter_tags.rosparam(child, made.full_name)
        elif child.name == "remap":
            scope.remaps = with_remap(scope.remaps, child)
        else:
            scope.environment = (*scope.environment, environment_of(child))


def with_remap(remaps: tuple[Remap, ...], tag: Tag) -> tuple[Remap, ...]:
    """The remaps with what a `<remap>` says: of several for one name the last counts. Raises BadFile."""
    tag.knows(["from", "to"])
    source, target = _remapped(tag, "from"), _remapped(tag, "to")
    return (*(remap for remap in remaps if remap.source != source), Remap(source, target, tag.place))


def _remapped(tag: Tag, attribute: str) -> str:
    name = tag.required(attribute)
    if not names.is_legal(name):
        raise tag.error(f"{attribute}: {name!r} is not a legal name", "names are letters, digits, '_' and '/'")
    return name


def environment_of(tag: Tag) -> tuple[str, str]:
    """What an `<env>` says."""
    tag.knows(["name", "value"])
    value = tag.get("value")
    if value is None:
        raise tag.error("the attribute 'value' is missing")
    name = tag.required("name")
    if "=" in name or "\0" in name + value:
        raise tag.error(f"{name!r} cannot be the name of an environment variable")
    return name, value
