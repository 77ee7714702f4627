"""Reads launch files into a plan: each tag in the order of the file, depth first, as roslaunch does.

parameter_tags.py reads parameters; nodes/ defines how each node runs. Nothing is started here.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from slidectl import names
from slidectl.description import xml_tree
from slidectl.description.missing import Missing
from slidectl.description.models import read_file
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, NotThere, UnknownName, UsageError, closest
from slidectl.extensions.launch.files import LaunchFile
from slidectl.extensions.launch.parameter_tags import param, rosparam
from slidectl.extensions.launch.plan import Argument, LaunchPlan, Node, Remap
from slidectl.extensions.launch.substitution import absent_packages, plain
from slidectl.extensions.launch.tag import Launch, Parse, Scope, Tag, legal_names

NODE_ATTRIBUTES = (
    "pkg", "type", "name", "args", "ns", "output", "respawn", "respawn_delay", "required", "cwd", "launch-prefix",
    "machine", "clear_params",
)  # fmt: skip
HERE = ("localhost", "127.0.0.1", "::1")
ALL_HERE = "leave it out: all nodes run on this one"


def load(
    sources: Sequence[LaunchFile],
    arguments: Mapping[str, str],
    packages: Packages | None = None,
    *,
    run_commands: bool = True,
    arguments_only: bool = False,
    namespace: str = "/",
    parse: Parse = xml_tree.read,
    missing: Missing | None = None,
) -> LaunchPlan:
    """Read one or several launch files into a plan.

    Args:
        arguments: the `arg:=value` of the command line.
        run_commands: allow `<param command=...>` to run programs; our own xacro always may.
        namespace: the namespace of relative names in the files.
        arguments_only: read only the declared arguments; they may lack values.
        parse: makes the elements of a file's text; `check` passes one whose elements record what is read.
        missing: collects missing things, which are left out; without it they are errors.

    Raises BadFile: with file and line. UsageError: an argument that no file declares.
    """
    plan = LaunchPlan(missing=Missing() if missing is None else missing)
    places = (packages or Packages()).starting_at(Path.cwd())
    launch = Launch(places, run_commands=run_commands, parse=parse, plan=plan)
    declared: set[str] = set()
    for source in sources:
        scope = Scope(launch, source.path, namespace, dict(arguments), dict(arguments))
        scope.nesting = ((source.path, ()),)
        try:
            (_read_arguments if arguments_only else _read)(source, scope)
        except RecursionError:
            raise BadFile("groups and includes are nested too deeply", source.shown) from None
        except BadFile:
            plan.missing.refuse()  # something missing is the most frequent reason
            raise
        declared |= scope.everywhere
    if missing is None:
        plan.missing.refuse()
    for name in arguments:
        if name not in declared:
            plan.missing.refuse()
            error = UnknownName("argument", name, sorted(declared), f"in {', '.join(s.shown for s in sources)}")
            raise UsageError(error.message, error.hint)
    return plan


def _root(source: LaunchFile, scope: Scope) -> Tag:
    element = scope.launch.parse(source.text, source.shown)
    tag = Tag(element, scope)
    if element.tag != "launch":
        raise tag.error("the root of a launch file is <launch>")
    for below in element.walk():
        if below.tag == "launch" and below is not element:
            raise Tag(below, scope).error("a launch file has one <launch>, its root", "use <group> or <include>")
    return tag


def _read(source: LaunchFile, scope: Scope) -> None:
    scope.launch.plan.files.append(str(source.path))
    root = _root(source, scope)
    root.knows(["deprecated"], conditions=False)
    if (reason := root.element.get("deprecated")) is not None:
        root.notice("wrong", f"is deprecated: {reason}")
    _contents(root, _TAGS)


def _contents(parent: Tag, known: Mapping[str, Callable[[Tag], None]], whose: str = "") -> None:
    """Read the child tags. A tag that needs a missing thing is left out, and noted."""
    for tag in parent.children(known):
        try:
            if tag.applies:
                known[tag.name](tag)
        except NotThere as error:
            tag.plan.missing.note(error, f"the <{tag.name}>{whose} is left out")


# --- arguments -------------------------------------------------------------------------------------------------------


def _arg(tag: Tag) -> None:
    tag.knows(["name", "value", "default", "doc"])
    scope, name = tag.scope, tag.required("name")
    if name in scope.declared and not scope.lenient:
        raise tag.error(f"the argument {name!r} is declared twice")
    value, default = _value_or_default(tag)
    if value is not None and name in scope.given and not scope.lenient:
        raise tag.error(f"the argument {name!r} is constant and cannot be given", "use default= instead of value=")
    scope.declared.add(name)
    scope.everywhere.add(name)
    if value is None:
        if not scope.trail:
            tag.plan.arguments.setdefault(
                name, Argument(name, None if default is None else plain(default), tag.get("doc"))
            )
        value = scope.arguments.get(name, default)
    if value is None:
        raise _missing_argument(scope, name, tag)
    scope.arguments[name] = value


def _missing_argument(scope: Scope, name: str, tag: Tag) -> BadFile:
    """The error for a required argument without a value."""
    if scope.trail:
        hint = f'give it at the include: <arg name="{name}" value="..."/>'
        return tag.error(f"the included file requires the argument {name!r}", hint)
    near = closest(name, [given for given in scope.given if given not in scope.declared])
    hint = f"; was {near}:={scope.given[near]} meant to be that?" if near else ""
    return tag.error(f"the argument {name!r} is required", f"give {name}:=VALUE{hint}")


def _value_or_default(tag: Tag) -> tuple[str | None, str | None]:
    if tag.element.get("value") is not None and tag.element.get("default") is not None:
        raise tag.error("'value' and 'default' exclude each other", "a value is constant, a default can be overridden")
    for attribute in ("value", "default"):
        tag.note_absent(attribute)
    return tag.raw("value", keep_absent=True), tag.raw("default", keep_absent=True)


def _read_arguments(source: LaunchFile, scope: Scope) -> None:
    """Read only the arguments of the file, including those in groups; not those whose own condition is false."""
    scope.launch.plan.files.append(str(source.path))
    root = _root(source, scope)
    for element in _own_args(root.element):
        name, applies, default, doc = element.get("name"), True, element.get("default"), element.get("doc")
        if name is None or element.get("value") is not None:
            continue
        tag = Tag(element, scope)
        scope.everywhere.add(name)
        # An attribute that needs unknown values of other arguments stays as written.
        with suppress(BadFile):
            applies = tag.applies
        with suppress(BadFile):
            default = tag.get("default")
        with suppress(BadFile):
            doc = tag.get("doc")
        if applies:
            if name in scope.given or default is not None:
                scope.arguments[name] = scope.given.get(name, str(default))
            scope.launch.plan.arguments.setdefault(name, Argument(name, default, doc))


def _own_args(element: Element) -> Iterator[Element]:
    """The `<arg>` elements inside, without those of an include."""
    for child in element.children:
        if child.tag == "arg":
            yield child
        elif child.tag != "include":
            yield from _own_args(child)


# --- groups and includes ---------------------------------------------------------------------------------------------


def _group(tag: Tag) -> None:
    tag.knows(["ns", "clear_params"])
    _clear(tag, tag.namespace())
    _contents(Tag(tag.element, tag.scope.group(tag.namespace())), _TAGS)


def _clear(tag: Tag, namespace: str) -> None:
    if not tag.clears:
        return
    if not (tag.get("ns") or "").strip():
        raise tag.error("clear_params needs an ns: it deletes all parameters in there")
    tag.plan.clear.append((namespace, tag.place))


def _include(tag: Tag) -> None:
    tag.knows(["file", "ns", "clear_params", "pass_all_args"])
    lenient = tag.flag("pass_all_args")
    inner = tag.scope.group(tag.scope.namespace)
    given = dict(tag.scope.arguments) if lenient else {}
    own: dict[str, Tag] = {}
    for child in Tag(tag.element, inner).children(("arg", "env")):
        if child.applies and child.name == "env":
            _env(child)
        elif child.applies:
            name = child.required("name")
            if name in own and not lenient:
                raise child.error(f"the argument {name!r} is given twice")
            own[name] = child
            child.knows(["name", "value", "default", "doc"])
            value, default = _value_or_default(child)
            if value is None and default is None:
                raise child.error("the attribute 'value' is missing")
            if value is not None or name not in given:
                given[name] = str(default if value is None else value)
    source = _included(tag.required("file"), tag)
    tag.scope.launch.count_text(tag, source.text)
    _clear(tag, tag.namespace())
    scope = inner.including(source.path, tag, given, lenient)
    _read(source, scope)
    for name, child in own.items():
        if name not in scope.declared and not lenient:
            error = UnknownName("argument", name, sorted(scope.declared), f"in {source.shown}")
            raise child.error(error.message, error.hint)


def _included(path: str, tag: Tag) -> LaunchFile:
    """Read an included file, relative to the working folder."""
    found = Path(os.path.abspath(path))
    try:
        return LaunchFile(found, read_file(found), shown(found))
    except NotThere as error:
        beside = is_file(tag.scope.file.parent / path)
        hint = f'there is one beside this file: file="$(dirname)/{path}"' if beside else None
        raise tag.no_file(f"{path}: {error.reason}", hint, found) from None
    except BadFile as error:
        raise tag.error(f"{path}: {error.reason}") from None


# --- what applies to later nodes -------------------------------------------------------------------------------------


def _env(tag: Tag) -> None:
    tag.knows(["name", "value"])
    value = tag.get("value")
    if value is None:
        raise tag.error("the attribute 'value' is missing")
    name = tag.required("name")
    if "=" in name or "\0" in name + value:
        raise tag.error(f"{name!r} cannot be the name of an environment variable")
    tag.scope.environment = (*tag.scope.environment, (name, value))


def _remap(tag: Tag) -> None:
    """Add a remap; it replaces an earlier one for the same name."""
    tag.knows(["from", "to"])
    source, target = (_remapped(tag, attribute) for attribute in ("from", "to"))
    others = (remap for remap in tag.scope.remaps if remap.source != source)
    tag.scope.remaps = (*others, Remap(source, target, tag.place))


def _remapped(tag: Tag, attribute: str) -> str:
    name = tag.required(attribute)
    if not names.is_legal(re.sub("//+", "/", name).rstrip("/") or "/"):
        raise tag.error(f"{attribute}: {name!r} is not a legal name", legal_names(name))
    return name


# --- nodes -----------------------------------------------------------------------------------------------------------


def _node_tag(tag: Tag) -> None:
    """Add the node and its parameters to the plan."""
    tag.knows(NODE_ATTRIBUTES)
    made = _node(tag)
    for other in tag.plan.nodes:
        if other.full_name == made.full_name:
            hint = "give one of them another name, or $(anon NAME)"
            raise tag.error(f"duplicate node {made.full_name}; the first is at {other.place}", hint)
    inner = _filled(tag, made.namespace, made.full_name)
    made.remaps, made.environment = inner.remaps, inner.environment
    tag.plan.nodes.append(made)


def _test(tag: Tag) -> None:
    """Read a `<test>`: as in roslaunch, it starts nothing, but its parameters are set."""
    tag.knows([*NODE_ATTRIBUTES, "test-name", "time-limit", "retry"])
    tag.notice("ignored", "is for rostest: it is not run, its parameters are set, as roslaunch does")
    for attribute in ("pkg", "type", "test-name"):
        tag.required(attribute)
    namespace = tag.namespace()
    _filled(tag, namespace, names.join(namespace, _name(tag, tag.get("name") or tag.required("test-name"))))


def _filled(tag: Tag, namespace: str, full_name: str) -> Scope:
    """Read the tags inside a node: its parameters go into the plan, its remaps and environment into the returned scope.

    For one name a `<param>` overrides a `~` parameter from outside, and that overrides a `<rosparam>`, in any order.
    """
    inner = tag.scope.group(namespace)
    if tag.clears:
        tag.plan.clear.append((full_name, tag.place))
    settings = tag.plan.settings
    before = len(settings)
    known = {
        "param": lambda child: param(child, full_name),
        "rosparam": lambda child: rosparam(child, full_name),
        "remap": _remap,
        "env": _env,
    }
    _contents(Tag(tag.element, inner), known, f" of {full_name}")
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


def _node(tag: Tag) -> Node:
    name = _name(tag, tag.required("name"))
    if (chosen := tag.get("machine")) and chosen not in (*HERE, *tag.scope.launch.machines):
        raise tag.error(f"there is no machine {chosen!r}", ALL_HERE)
    words = tag.words("args", keep_absent=True)
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
        output=_one_of(tag, "output", "log", "screen"),
        respawn=respawn,
        respawn_delay_s=_seconds(tag, "respawn_delay"),
        required=required,
        cwd=_one_of(tag, "cwd", "node", "ROS_HOME", "ros_home"),
        launch_prefix=tag.words("launch-prefix"),
        file=str(tag.scope.file),
        absent=tuple(absent.values()),
    )


def _seconds(tag: Tag, attribute: str) -> float:
    text = tag.get(attribute)
    value = math.nan
    with suppress(ValueError):
        value = float("0" if text is None else text)
    if not 0.0 <= value < 1e9:
        raise tag.error(f"{attribute} is a number of seconds, 0 or more, not {text!r}")
    return value


def _one_of(tag: Tag, attribute: str, *known: str) -> str | None:
    value = tag.get(attribute)
    if value is not None and value not in known:
        raise tag.error(f"{attribute} is one of {', '.join(known)}, not {value!r}")
    return value


# --- what has no effect ----------------------------------------------------------------------------------------------


def _machine(tag: Tag) -> None:
    """Read a `<machine>`: names of this machine are recorded; others are errors."""
    tag.knows(["name", "address", "env-loader", "user", "password", "ssh-port", "timeout", "default"])
    name, address = tag.required("name"), tag.required("address")
    if address not in HERE and address != os.uname().nodename:
        raise tag.error(f"there are no other machines here (name={name!r}, address={address!r})", ALL_HERE)
    tag.scope.launch.machines.add(name)
    tag.notice("ignored", "is this machine, where all nodes run")


def _master(tag: Tag) -> None:
    tag.notice("ignored", "is obsolete and has no effect")


_TAGS: dict[str, Callable[[Tag], None]] = {
    "arg": _arg,
    "param": param,
    "rosparam": rosparam,
    "include": _include,
    "group": _group,
    "node": _node_tag,
    "remap": _remap,
    "env": _env,
    "test": _test,
    "machine": _machine,
    "master": _master,
}
