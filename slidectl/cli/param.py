"""`slidectl param`: get, set, load and dump parameters, with the semantics of rosparam.

For all commands that set parameters: reads values from command-line words and from files, and writes them as YAML.
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from slidectl import names, typed_values
from slidectl.cli import completion, output
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.command_steps import CommandStep
from slidectl.errors import AmbiguousName, BadFile, Refused, UnknownName, UsageError, closest, listing

if TYPE_CHECKING:
    from slidectl.client.spawning import Tree

_INDEXED = re.compile(r"(?P<name>[^\[\]]+)(?P<indices>(\[-?\d+\])+)\Z")
_PLAIN_NUMBER = re.compile(r"-?\d+(\.\d+)?\Z")
_BEGINS_AS_LIST = re.compile(r"(\s*(#.*)?\n)*\s*(-\s|\[)")


@group(
    step=CommandStep(may_add_controllers=True),
    examples=["slidectl param get joint1_position_controller/pid", "slidectl param set pid/p 150"],
)
def param() -> None:
    """Get, set, load and dump parameters."""


def _resolved(ctx: Context, name: str) -> str:
    """The full name of a parameter or of a namespace of parameters. Raises UnknownName, AmbiguousName."""
    return str(ctx.resolve("parameter", name)["name"])


# --- list, get ------------------------------------------------------------------------------------------------------


@param.command("list", examples=["slidectl param list", "slidectl param list /slider/joint1_position_controller"])
@click.argument("namespace", required=False, shell_complete=completion.parameters)
@click.pass_obj
def list_parameters(ctx: Context, namespace: str | None) -> None:
    """List the parameters, all or those below NAMESPACE.

    JSON key: parameter.
    """
    inside = "/" if namespace is None else names.join(ctx.namespace, namespace.rstrip("/") or "/")
    below = [name for name in ctx.names("parameter") if names.is_under(name, inside) and name != inside]
    ctx.emit_names(below, "parameter", "" if namespace is None else f"no parameters below {inside}")


@param.command("get", examples=["slidectl param get joint1_position_controller/pid/p", "slidectl param get / --json"])
@click.argument("name", shell_complete=completion.parameters)
@click.option("--default", "fallback", metavar="VALUE", help="Print this when the parameter is not set.")
@click.pass_obj
def get(ctx: Context, name: str, fallback: str | None) -> None:
    """Print a parameter, or all below a namespace, as YAML.

    An element of a list is NAME[0]. JSON keys: parameter, value.
    """
    match = _INDEXED.match(name)
    try:
        full = _resolved(ctx, match["name"] if match else name)
        value = get_value(ctx, full)
    except UnknownName:
        if fallback is None:
            raise
        full, value, match = names.join(ctx.namespace, name), typed(fallback), None
    for index in map(int, re.findall(r"-?\d+", match["indices"]) if match else ()):
        if not isinstance(value, list):
            raise UsageError(f"{full} is not a list: it has no element [{index}]")
        if not -len(value) <= index < len(value):
            raise Refused(f"{full} has no element [{index}]: it has {len(value)}")
        value = value[index]
    ctx.emit({"parameter": full, "value": value}, as_rosparam(value))


def as_rosparam(value: Any) -> str:
    """The value as `rosparam get` prints it: YAML, an empty line after a mapping or a list, no `...` after a scalar."""
    text = dumped(value)
    return text + "\n" if isinstance(value, dict | list) else text.removesuffix("...\n")


# --- set, delete ----------------------------------------------------------------------------------------------------


@param.command(
    "set", examples=["slidectl param set joint1_position_controller/pid/p 150", "slidectl param set /limit 'deg(90)'"]
)
@click.argument("name", shell_complete=completion.parameters)
@click.argument("value", required=False)
@completion.file_option("-t", "--textfile", help="The text of a file as the value.")
@click.option(
    "--new", is_flag=True, help="Set a new parameter, even if nothing reads it or a short NAME means another one."
)
@click.pass_obj
def set_parameter(ctx: Context, name: str, value: str | None, textfile: str | None, new: bool) -> None:
    """Set a parameter.

    VALUE is YAML; deg(90) and rad(pi/2) are angles in radians, '' is an empty text. A mapping is merged into the
    present value, any other value replaces it. A short NAME means the one parameter with this end.

    A gain of a loaded controller takes effect at its next cycle; a value that the controller cannot use is refused.
    Below a loaded controller you can set only names that it reads; --new sets others. Elsewhere a line on stderr says
    when a parameter is new. JSON keys: parameter, value.
    """
    if (value is None) == (textfile is None):
        raise UsageError("give a VALUE or -t FILE")
    content = typed_values.text_of(textfile) if textfile is not None else typed(value or "")
    full = _name_to_set(ctx, name, new)
    created = store(ctx, settings(content, full), known_only=not new)
    if full != names.join(ctx.namespace, name):
        ctx.say(f"set {full}")
    if created and not new:  # suggest an existing parameter that the user may have meant
        others = [known for known in ctx.names("parameter") if known not in created]
        for made in created:
            near = closest(made, others) if names.parent(made) != "/" else None
            ctx.say(f"{made} is new" + (f"; did you mean {near}?" if near else ""))
    ctx.detail(f"set parameter [{full}] to [{content}]")
    ctx.emit({"parameter": full, "value": content}, "")


def _name_to_set(ctx: Context, name: str, new: bool) -> str:
    """The full name of an existing parameter, else of a new one in the namespace.

    Raises:
        AmbiguousName, BadName. UnknownName: the beginning of a short name is a namespace that exists elsewhere.
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
    """Full names that a short one may mean: `.../pid/P` for `pid/P` and each `.../pid`, when /pid does not exist."""
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


@param.command("delete", examples=["slidectl param delete /limit", "slidectl param delete /slider"])
@click.argument("name", shell_complete=completion.parameters)
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
@click.argument("file", shell_complete=completion.files)
@click.argument("namespace", required=False, shell_complete=completion.parameters)
@click.pass_obj
def load(ctx: Context, file: str, namespace: str | None) -> None:
    """Set the parameters of a YAML file ('-' is stdin), below NAMESPACE if given.

    All documents of the file count; a key '_ns' puts a document into a namespace. Parameters that the file does not
    name stay. A file that has NAMESPACE itself as its top keys, as a dump has, is loaded where it says. JSON keys:
    parameter, value; one line for each.
    """
    from slidectl.client.spawning import leaves

    shown = "stdin" if file == "-" else file
    inside = names.check_parameter(names.join(ctx.namespace, (namespace or "").rstrip("/") or ctx.namespace))
    tree = parameters_in(ctx, typed_values.text_of(file), shown, namespace is not None)
    if tree == {}:
        ctx.say(f"{shown} holds no parameters")
    elif namespace is not None and _names_all_of(tree, inside):
        ctx.say(f"{shown} names {inside} itself; it is loaded there")
        inside = "/"
    chosen = dict(leaves(tree, inside)) if isinstance(tree, dict) else {inside: tree}
    store(ctx, chosen)
    for name, value in chosen.items():
        ctx.detail(f"{name}={value}")
    if ctx.format != "text":
        ctx.emit_rows([{"parameter": n, "value": v} for n, v in chosen.items()], ["parameter", "value"])


def _names_all_of(tree: Any, namespace: str) -> bool:
    """True when the only key on each level of the tree is the next part of the namespace, which is not the root."""
    parts = [part for part in namespace.split("/") if part]
    for part in parts:
        if not isinstance(tree, dict) or list(tree) != [part]:
            return False
        tree = tree[part]
    return bool(parts) and isinstance(tree, dict)


@param.command("dump", examples=["slidectl param dump", "slidectl param dump slider.yaml /slider"])
@click.argument("file", required=False, shell_complete=completion.files)
@click.argument("namespace", required=False, shell_complete=completion.parameters)
@click.pass_obj
def dump(ctx: Context, file: str | None, namespace: str | None) -> None:
    """Write the parameters that were set, all or below NAMESPACE, as sorted YAML, to FILE or to stdout.

    The keys begin at the root, so that 'param load FILE', 'controller config FILE' and 'spawn --controllers FILE' take
    the file. Parameters that the simulation adds itself are left out: gains that were not given, the model of a spawned
    robot. 'param get NAMESPACE' prints all. With --json it is one object.
    """
    full = "/" if namespace is None else _resolved(ctx, namespace)
    value = json.loads(ctx.call("/slidectl/given_params", {"name": full})["value"])
    if not value:
        ctx.say(f"nothing was set {'' if full == '/' else f'at {full} '}by a client")
    text = output.as_json(value) + "\n" if ctx.format == "json" else dumped(value)
    if file is None or file == "-":
        output.write(text)
    else:
        output.save(file, text)


# --- values ---------------------------------------------------------------------------------------------------------


def get_value(ctx: Context, full: str) -> Any:
    """The value, a dict for a namespace. Raises Refused when it is not set."""
    return json.loads(ctx.call("/rosapi/get_param", {"name": full})["value"])


def typed(text: str) -> Any:
    """The value of a command-line word: YAML, angles converted to radians, '' for no text. Raises UsageError."""
    if "deg" not in text and "rad" not in text:
        return "" if text == "" else typed_values.read(text)
    from slidectl.description import angles

    return (
        typed_values.read_yaml(text, typed_values.shown(text), angles=True)
        if angles.may_be_in(text)
        else typed_values.read(text)
    )


def parameters_in(ctx: Context, text: str, file: str, may_be_list: bool) -> Any:
    """The parameters in a text: a mapping or, with `may_be_list`, also a list or a text. Raises BadFile."""
    from slidectl.description import yaml_tree

    if may_be_list and _BEGINS_AS_LIST.match(text) and not text.startswith("---"):
        return yaml_tree.read_value(text, file)
    notices: list[Any] = []
    try:
        content = yaml_tree.read(text, file, notices, rooted=True)
    except BadFile:
        with suppress(BadFile):  # a dump of one text parameter is only that text
            bare = yaml_tree.read_value(text, file) if may_be_list else None
            if isinstance(bare, str):
                return bare
        raise
    for notice in notices:
        ctx.warn(f"{notice.file}:{notice.line}: {notice.subject} {notice.text}")
    return content


def dumped(value: Any) -> str:
    """The value as PyYAML writes it in block style, keys sorted. Common scalars are written without loading it."""
    text = _scalar(value)
    if text is not None:
        return f"{text}\n...\n"
    import yaml

    from slidectl.description import angles

    dumper: Any = type("Dumper", (yaml.SafeDumper,), {})
    angles.add_to(dumper)
    return str(yaml.dump(value, Dumper=dumper, default_flow_style=False))


def _scalar(value: Any) -> str | None:
    """The text of a scalar that needs no quotes and has Python's notation; None for any other value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        from slidectl.msgs.message_text import is_plain

        return value if is_plain(value) else None
    if isinstance(value, int | float) and _PLAIN_NUMBER.match(repr(value)):
        return repr(value)
    return None


def settings(content: Any, full: str) -> dict[str, Any]:
    """Full name -> value to set, for a value at `full`. A mapping is split into its leaves, so that it is merged.

    Raises UsageError for null, which no parameter can be.
    """
    from slidectl.client.spawning import leaves

    if content is None:
        raise UsageError("a parameter cannot be null", f"slidectl param delete {full}")
    return dict(leaves(content, full)) if isinstance(content, dict) and content else {full: content}


def store(ctx: Context, parameters: Tree, known_only: bool = False) -> list[str]:
    """Set all parameters, or none; other parameters stay. Answers of controllers are printed as warnings.

    Args:
        known_only: a name below a loaded controller that it does not read is an error.

    Returns:
        The names that were not set before, without those below a loaded controller, which has checked them.

    Raises:
        Refused: a loaded controller cannot take a value. UsageError: JSON cannot carry a value.
    """
    created = ctx.client.params.set_all(parameters, known_only)
    for reason in ctx.client.reasons:
        ctx.warn(reason)
    return created
