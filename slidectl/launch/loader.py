"""Launch files into a plan: each tag in the order of the file, depth first, as roslaunch reads them.

The tags that make up the file's shape are here; parameters and nodes have modules of their own. Nothing is started
and nothing but files is read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from slidectl.description import xml_tree
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages
from slidectl.errors import BadFile, NotThere, UnknownName, UsageError
from slidectl.launch import node_tags, parameter_tags
from slidectl.launch.files import Source, read
from slidectl.launch.plan import Argument, Plan
from slidectl.launch.protected import plain
from slidectl.launch.scope import Launch, Parse, Scope, missing_argument
from slidectl.launch.tag import Tag


def load(
    sources: Sequence[Source],
    arguments: Mapping[str, str],
    packages: Packages | None = None,
    *,
    run_commands: bool = True,
    arguments_only: bool = False,
    namespace: str = "/",
    parse: Parse = xml_tree.read,
    missing: Missing | None = None,
) -> Plan:
    """The plan of one or several launch files.

    Args:
        arguments: the `arg:=value` of the command line.
        run_commands: whether `<param command=...>` may run programs; our own xacro always may.
        namespace: where the files' relative names are.
        arguments_only: find out which arguments there are, and be content when they have no values.
        parse: makes elements of the text of a file; `check` gives one whose elements note what is read of them.
        missing: takes in what the files name and is not there, which is left out; without it that is an error.

    Raises:
        BadFile: with file and line. UsageError: an argument that no file declares.
    """
    plan = Plan(missing=Missing() if missing is None else missing)
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
            plan.missing.refuse()  # the reason, more often than not
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


def _root(source: Source, scope: Scope) -> Tag:
    element = scope.launch.parse(source.text, source.shown)
    tag = Tag(element, scope)
    if element.tag != "launch":
        raise tag.error("the root of a launch file is <launch>")
    for below in element.walk():
        if below.tag == "launch" and below is not element:
            raise Tag(below, scope).error("a launch file has one <launch>, its root", "use <group> or <include>")
    return tag


def _read(source: Source, scope: Scope) -> None:
    scope.launch.plan.files.append(str(source.path))
    root = _root(source, scope)
    root.knows(["deprecated"], conditions=False)
    if (reason := root.element.get("deprecated")) is not None:
        root.notice("wrong", f"is deprecated: {reason}")
    _contents(root)


def _contents(parent: Tag) -> None:
    for tag in parent.children(_TAGS):
        try:
            if tag.applies:
                _TAGS[tag.name](tag)
        except NotThere as error:
            tag.plan.missing.note(error, f"the <{tag.name}> is left out")


# --- arguments ------------------------------------------------------------------------------------------------------


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
        raise missing_argument(scope, name, tag)
    scope.arguments[name] = value


def _value_or_default(tag: Tag) -> tuple[str | None, str | None]:
    if tag.element.get("value") is not None and tag.element.get("default") is not None:
        raise tag.error("'value' and 'default' exclude each other", "a value is constant, a default can be overridden")
    for attribute in ("value", "default"):
        tag.note_absent(attribute)
    return tag.raw("value", hands_on=True), tag.raw("default", hands_on=True)


def _read_arguments(source: Source, scope: Scope) -> None:
    """Only the args of the file, in groups too, but for those whose own condition is known to be false."""
    scope.launch.plan.files.append(str(source.path))
    root = _root(source, scope)
    for element in root.element.walk():
        if element.tag != "arg" or element.get("name") is None or element.get("value") is not None:
            continue
        tag = Tag(element, scope)
        name = str(element.get("name"))
        scope.everywhere.add(name)
        if not _may_apply(tag):
            continue
        default = _as_far_as_known(tag, "default")
        if name in scope.given or default is not None:
            scope.arguments[name] = scope.given.get(name, str(default))
        scope.launch.plan.arguments.setdefault(name, Argument(name, default, _as_far_as_known(tag, "doc")))
    included = {id(arg) for element in root.element.walk() if element.tag == "include" for arg in element.children}
    inside = {str(arg.get("name")) for arg in root.element.walk() if arg.tag == "arg" and id(arg) in included}
    own = {str(arg.get("name")) for arg in root.element.walk() if arg.tag == "arg" and id(arg) not in included}
    for name in inside - own:
        scope.launch.plan.arguments.pop(name, None)


def _may_apply(tag: Tag) -> bool:
    try:
        return tag.applies
    except BadFile:
        return True


def _as_far_as_known(tag: Tag, attribute: str) -> str | None:
    """The attribute, as it is written when it cannot be worked out without the values of others."""
    try:
        return tag.get(attribute)
    except BadFile:
        return tag.element.get(attribute)


# --- groups and includes ---------------------------------------------------------------------------------------------


def _group(tag: Tag) -> None:
    tag.knows(["ns", "clear_params"])
    _clear(tag, tag.namespace())
    _contents(Tag(tag.element, tag.scope.group(tag.namespace())))


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
            value, default = _passed(child)
            if value is not None or name not in given:
                given[name] = str(default if value is None else value)
    source = read(tag.required("file"), tag)
    _clear(tag, tag.namespace())
    scope = inner.including(source.path, tag, given, lenient)
    _read(source, scope)
    for name, child in own.items():
        if name not in scope.declared and not lenient:
            error = UnknownName("argument", name, sorted(scope.declared), f"in {source.shown}")
            raise child.error(error.message, error.hint)


def _passed(child: Tag) -> tuple[str | None, str | None]:
    """Value and default of an arg in an include: a default does not count where all args are passed on, with this one.

    Raises:
        BadFile: it has neither.
    """
    child.knows(["name", "value", "default", "doc"])
    value, default = _value_or_default(child)
    if value is None and default is None:
        raise child.error("the attribute 'value' is missing")
    return value, default


# --- what applies to later nodes -------------------------------------------------------------------------------------


def _env(tag: Tag) -> None:
    tag.scope.environment = (*tag.scope.environment, node_tags.environment_of(tag))


def _remap(tag: Tag) -> None:
    tag.scope.remaps = node_tags.with_remap(tag.scope.remaps, tag)


# --- what has no effect ----------------------------------------------------------------------------------------------


def _master(tag: Tag) -> None:
    tag.notice("ignored", "is obsolete and has no effect")


_TAGS: dict[str, Callable[[Tag], None]] = {
    "arg": _arg,
    "param": parameter_tags.param,
    "rosparam": parameter_tags.rosparam,
    "include": _include,
    "group": _group,
    "node": node_tags.node,
    "remap": _remap,
    "env": _env,
    "test": node_tags.test,
    "machine": node_tags.machine,
    "master": _master,
}
