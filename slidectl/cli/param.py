"""`slidectl param`: get, set, load and dump parameters, with the semantics of rosparam."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import click

from slidectl import names
from slidectl.cli import live, output, parameters
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.errors import AmbiguousName, BadFile, Refused, UnknownName, UsageError, closest, listing
from slidectl.writing import write_whole

_INDEXED = re.compile(r"(?P<name>[^\[\]]+)(?P<indices>(\[-?\d+\])+)\Z")


@group(examples=["slidectl param get joint1_position_controller/pid", "slidectl param set pid/p 150"])
def param() -> None:
    """Get, set, load and dump parameters."""


def _resolved(ctx: Context, name: str) -> str:
    """The full name of a parameter or of a namespace of parameters. Raises UnknownName, AmbiguousName."""
    return str(ctx.resolve("parameter", name)["name"])


# --- list, get ------------------------------------------------------------------------------------------------------


@param.command("list", examples=["slidectl param list", "slidectl param list /slider/joint1_position_controller"])
@click.argument("namespace", required=False, shell_complete=live.parameters)
@click.pass_obj
def list_parameters(ctx: Context, namespace: str | None) -> None:
    """List the parameters, all or those below NAMESPACE.

    JSON key: parameter.
    """
    inside = "/" if namespace is None else names.join(ctx.namespace, namespace.rstrip("/") or "/")
    below = [name for name in ctx.names("parameter") if names.is_under(name, inside) and name != inside]
    ctx.emit_names(below, "parameter", "" if namespace is None else f"no parameters below {inside}")


@param.command("get", examples=["slidectl param get joint1_position_controller/pid/p", "slidectl param get / --json"])
@click.argument("name", shell_complete=live.parameters)
@click.option("--default", "fallback", metavar="VALUE", help="Print this when the parameter is not set.")
@click.pass_obj
def get(ctx: Context, name: str, fallback: str | None) -> None:
    """Print a parameter, or all below a namespace, as YAML.

    An element of a list is NAME[0]. JSON keys: parameter, value.
    """
    match = _INDEXED.match(name)
    try:
        full = _resolved(ctx, match["name"] if match else name)
        value = parameters.get(ctx, full)
    except UnknownName:
        if fallback is None:
            raise
        full, value, match = names.join(ctx.namespace, name), parameters.typed(fallback), None
    for index in re.findall(r"-?\d+", match["indices"]) if match else ():
        value = _element(full, value, int(index))
    ctx.emit({"parameter": full, "value": value}, as_rosparam(value))


def _element(full: str, value: Any, index: int) -> Any:
    if not isinstance(value, list):
        raise UsageError(f"{full} is no list: it has no element [{index}]")
    if not -len(value) <= index < len(value):
        raise Refused(f"{full} has no element [{index}]: it has {len(value)}")
    return value[index]


def as_rosparam(value: Any) -> str:
    """The value as `rosparam get` prints it: YAML, and an empty line after a mapping or a list."""
    text = parameters.dumped(value)
    return text + "\n" if isinstance(value, dict | list) else text.removesuffix("...\n")


# --- set, delete ----------------------------------------------------------------------------------------------------


@param.command(
    "set", examples=["slidectl param set joint1_position_controller/pid/p 150", "slidectl param set /limit 'deg(90)'"]
)
@click.argument("name", shell_complete=live.parameters)
@click.argument("value", required=False)
@click.option("-t", "--textfile", shell_complete=live.files, metavar="FILE", help="The text of a file as the value.")
@click.option("--new", is_flag=True, help="Set it although nobody reads it, or a short NAME says something else.")
@click.pass_obj
def set_parameter(ctx: Context, name: str, value: str | None, textfile: str | None, new: bool) -> None:
    """Set a parameter.

    VALUE is YAML; deg(90) and rad(pi/2) are angles in radians, '' is an empty text. A mapping is merged into what is
    there, all else replaces it. A short NAME means the parameter that ends so, if there is one.

    A gain of a loaded controller takes effect at its next cycle, and is refused when the controller cannot take it.
    Below a loaded controller only names that it reads can be set, unless with --new. Elsewhere a line on stderr says
    when the parameter is new. JSON keys: parameter, value.
    """
    from slidectl.cli.configuration import store
    from slidectl.cli.documents import text_of

    if (value is None) == (textfile is None):
        raise UsageError("give a VALUE or -t FILE")
    content = text_of(textfile) if textfile is not None else parameters.typed(value or "")
    full = _name_to_set(ctx, name, new)
    created = store(ctx, parameters.settings(content, full), known_only=not new)
    if full != names.join(ctx.namespace, name):
        ctx.say(f"set {full}")
    if created and not new:
        _say_new(ctx, created)
    ctx.detail(f"set parameter [{full}] to [{content}]")
    ctx.emit({"parameter": full, "value": content}, "")


def _name_to_set(ctx: Context, name: str, new: bool) -> str:
    """An existing parameter's full name, else a new one in the namespace.

    Raises:
        AmbiguousName, BadName. UnknownName: a short name whose beginning means a namespace that is elsewhere.
    """
    full = names.check_parameter(names.join(ctx.namespace, name))
    try:
        return _resolved(ctx, name)
    except UnknownName as unknown:
        elsewhere = [] if new or name.startswith("/") else _elsewhere(ctx, name, full)
        if elsewhere:
            below = f"below what is there, write the full name: {listing(elsewhere)}"
            unknown.hint = f"{unknown.hint}\n{below}\n--new makes {full}"
            raise
        return full


def _elsewhere(ctx: Context, name: str, full: str) -> list[str]:
    """`.../pid/P` for `pid/P`, for each `.../pid` that there is, when /pid is not there."""
    if "/" not in name.rstrip("/"):
        return []
    above, _, last = name.rstrip("/").rpartition("/")
    try:
        found = [_resolved(ctx, above)]
    except AmbiguousName as ambiguous:
        found = ambiguous.matches
    except UnknownName:
        found = _elsewhere(ctx, above, names.parent(full))
        return [names.join(each, last) for each in found]
    inner = [each for each in found if any(known.startswith(f"{each}/") for known in ctx.names("parameter"))]
    return [names.join(each, last) for each in inner if names.join(each, last) != full]


def _say_new(ctx: Context, created: Sequence[str]) -> None:
    """Say that parameters are new, and which one of those that were there may have been meant."""
    others = [name for name in ctx.names("parameter") if name not in created]
    for name in created:
        near = closest(name, others) if names.parent(name) != "/" else None
        ctx.say(f"{name} is new" + (f"; did you mean {near}?" if near else ""))


@param.command("delete", examples=["slidectl param delete /limit", "slidectl param delete /slider"])
@click.argument("name", shell_complete=live.parameters)
@click.pass_obj
def delete(ctx: Context, name: str) -> None:
    """Delete a parameter, or all below a namespace.

    JSON key: parameter.
    """
    full = _resolved(ctx, name)
    ctx.call("/rosapi/delete_param", {"name": full})
    ctx.detail(f"deleted parameter [{full}]")
    ctx.emit({"parameter": full}, "")


# --- load, dump -----------------------------------------------------------------------------------------------------


@param.command("load", examples=["slidectl param load config/slider_control.yaml", "slidectl param load - /slider"])
@click.argument("file", shell_complete=live.files)
@click.argument("namespace", required=False, shell_complete=live.parameters)
@click.pass_obj
def load(ctx: Context, file: str, namespace: str | None) -> None:
    """Set the parameters of a YAML file ('-' is stdin), below NAMESPACE if given.

    All documents of the file count; a key '_ns' puts a document into a namespace. Parameters that the file does not
    name stay. JSON keys: parameter, value; one line for each.
    """
    from slidectl.cli.configuration import store
    from slidectl.cli.documents import text_of
    from slidectl.client.spawning import leaves

    shown = "stdin" if file == "-" else file
    inside = names.check_parameter(names.join(ctx.namespace, (namespace or "").rstrip("/") or ctx.namespace))
    tree = parameters.tree(ctx, text_of(file), shown, namespace is not None)
    if tree == {}:
        ctx.say(f"{shown} holds no parameters")
    chosen = dict(leaves(tree, inside)) if isinstance(tree, dict) else {inside: tree}
    store(ctx, chosen)
    for name, value in chosen.items():
        ctx.detail(f"{name}={value}")
    if ctx.format != "text":
        ctx.emit_rows([{"parameter": n, "value": v} for n, v in chosen.items()], ["parameter", "value"])


@param.command("dump", examples=["slidectl param dump", "slidectl param dump slider.yaml /slider"])
@click.argument("file", required=False, shell_complete=live.files)
@click.argument("namespace", required=False, shell_complete=live.parameters)
@click.pass_obj
def dump(ctx: Context, file: str | None, namespace: str | None) -> None:
    """Write the parameters, all or those below NAMESPACE, as YAML with sorted keys, to FILE or to stdout.

    With --json it is one object.
    """
    value = parameters.get(ctx, "/" if namespace is None else _resolved(ctx, namespace))
    text = output.as_json(value) + "\n" if ctx.format == "json" else parameters.dumped(value)
    if file in (None, "-"):
        return output.write(text)
    try:
        write_whole(str(file), text)
    except OSError as error:
        raise BadFile(f"cannot be written: {error.strerror or error}", str(file)) from None
    return None
