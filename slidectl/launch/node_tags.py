"""`<node>` with what is inside it, and what `<remap>` and `<env>` say.

What a node does when it runs is the affair of nodes/.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import replace

from slidectl import names
from slidectl.errors import NotThere
from slidectl.launch import parameter_tags
from slidectl.launch.plan import Node, Remap
from slidectl.launch.scope import Scope, absent_packages
from slidectl.launch.tag import Tag

ATTRIBUTES = (
    "pkg", "type", "name", "args", "ns", "output", "respawn", "respawn_delay", "required", "cwd", "launch-prefix",
    "machine", "clear_params",
)  # fmt: skip
OUTPUTS = ("log", "screen")
NOT_FOR_TESTS = ("output", "respawn", "respawn_delay")
HERE = ("localhost", "127.0.0.1", "::1")
ALL_HERE = "leave it out: all nodes run on this one"
FOLDERS = ("node", "ROS_HOME", "ros_home")


def node(tag: Tag) -> None:
    """Add the node to the plan, and its parameters."""
    tag.knows(ATTRIBUTES)
    made = _node(tag)
    for other in tag.plan.nodes:
        if other.full_name == made.full_name:
            hint = "give one of them another name, or $(anon NAME)"
            raise tag.error(f"there is a node {made.full_name} already, at {other.place}", hint)
    inner = _filled(tag, made.namespace, made.full_name)
    made.remaps, made.environment = inner.remaps, inner.environment
    tag.plan.nodes.append(made)


def test(tag: Tag) -> None:
    """`<test>` is for rostest and starts nothing; its parameters are set all the same, as roslaunch does it."""
    tag.knows([*(name for name in ATTRIBUTES if name not in NOT_FOR_TESTS), "test-name", "time-limit", "retry"])
    tag.notice("ignored", "is for rostest: it is not run, its parameters are set, as roslaunch does")
    for attribute in NOT_FOR_TESTS:
        if tag.element.get(attribute) is not None:
            raise tag.error(f"a test has no {attribute!r}")
    for attribute in ("pkg", "type", "test-name"):
        tag.required(attribute)
    if not _fits(tag.get("time-limit"), float, least=1e-9) or not _fits(tag.get("retry"), int):
        raise tag.error("time-limit is a number of seconds, retry a whole number")
    namespace = tag.namespace()
    _filled(tag, namespace, names.join(namespace, _name(tag, tag.get("name") or tag.required("test-name"))))


def _fits(text: str | None, kind: type[float], least: float = -math.inf) -> bool:
    try:
        return not text or kind(text) >= least
    except ValueError:
        return False


def _filled(tag: Tag, namespace: str, full_name: str) -> Scope:
    """What a node has inside: its parameters go into the plan; remaps and environment are those of the scope.

    Of one name a `<param>` counts, wherever it stands, then one of the surroundings with `~`, then a `<rosparam>`.
    """
    inner = tag.scope.group(namespace)
    if tag.clears:
        tag.plan.clear.append((full_name, tag.place))
    settings = tag.plan.settings
    before = len(settings)
    _inside(Tag(tag.element, inner), inner, full_name)
    own = settings[before:]
    settings[before:] = [
        *(setting for setting in own if not setting.is_whole),
        *(replace(setting, name=tag.within(full_name, setting.name)) for setting in tag.scope.private),
        *(setting for setting in own if setting.is_whole),
    ]
    return inner


def _name(tag: Tag, name: str) -> str:
    if "/" in name:
        raise tag.error(f"the name {name!r} of a node cannot hold a namespace", "use ns=")
    if not names.is_legal(name) or name.startswith("~"):
        raise tag.error(f"{name!r} cannot be the name of a node", "names are letters, digits and '_', a letter first")
    return name


def machine(tag: Tag) -> None:
    """`<machine>`: one that is this machine is known by its name; others cannot be reached."""
    tag.knows(["name", "address", "env-loader", "user", "password", "ssh-port", "timeout", "default"])
    name, address = tag.required("name"), tag.required("address")
    if address not in HERE and address != os.uname().nodename:
        raise tag.error(f"there are no other machines here (name={name!r}, address={address!r})", ALL_HERE)
    tag.scope.launch.machines.add(name)
    tag.notice("ignored", "is this machine, where all nodes run")


def _node(tag: Tag) -> Node:
    name = _name(tag, tag.required("name"))
    if (chosen := tag.get("machine")) and chosen not in (*HERE, *tag.scope.launch.machines):
        raise tag.error(f"there is no machine {chosen!r}", ALL_HERE)
    words = tag.words("args", hands_on=True)
    absent = {package: tag.absence_of(package) for word in words for package in absent_packages(word)}
    respawn, required = tag.flag("respawn"), tag.flag("required")
    if respawn and required:
        raise tag.error("respawn and required exclude each other")
    return Node(
        package=tag.required("pkg"),
        type=tag.required("type"),
        name=name,
        namespace=tag.namespace(),
        place=tag.place,
        words=[word for word in words if not absent_packages(word)],
        output=_one_of(tag, "output", OUTPUTS),
        respawn=respawn,
        respawn_delay_s=tag.number("respawn_delay", 0.0),
        required=required,
        cwd=_one_of(tag, "cwd", FOLDERS),
        launch_prefix=tag.words("launch-prefix"),
        file=str(tag.scope.file),
        absent=tuple(absent.values()),
    )


def _one_of(tag: Tag, attribute: str, known: tuple[str, ...]) -> str | None:
    value = tag.get(attribute)
    if value is not None and value not in known:
        raise tag.error(f"{attribute} is one of {', '.join(known)}, not {value!r}")
    return value


def _inside(tag: Tag, scope: Scope, full_name: str) -> None:
    for child in tag.children(("param", "rosparam", "remap", "env")):
        try:
            if child.applies:
                _one_inside(child, scope, full_name)
        except NotThere as error:
            tag.plan.missing.note(error, f"the <{child.name}> of {full_name} is left out")


def _one_inside(child: Tag, scope: Scope, full_name: str) -> None:
    if child.name == "param":
        parameter_tags.param(child, full_name)
    elif child.name == "rosparam":
        parameter_tags.rosparam(child, full_name)
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
    if not names.is_legal(re.sub("//+", "/", name).rstrip("/") or "/"):
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
