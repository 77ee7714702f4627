"""`rosparam`: get, set, load, dump, delete and list parameters, with rosparam's output.

Without a verb it prints the list of verbs and exits 0, as rosparam does.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from slidectl import names
from slidectl.cli import output, param
from slidectl.cli.context import Context
from slidectl.errors import BadFile, UsageError, closest
from slidectl.extensions.ros_commands.arguments import Failure, Parser, Tool, option, refusals, resolve
from slidectl.input_files import MOST_TEXT, near, read_bytes

_VERBOSE = option("-v", "print what is done", dest="verbose")
_INT32 = range(-(2**31), 2**31)
_DEEP = 2
"""Names with no more slashes than this get no hint: they are often new, and not mistyped."""
_NO_NAME = "invalid arguments. Please specify a parameter name"
_TOO_MANY = "too many arguments"


def _shown(ctx: Context, name: str) -> str:
    """The name as -v shows it."""
    return resolve(ctx, name, "rosparam")


def _full(ctx: Context, name: str) -> str:
    parts = _shown(ctx, name).split("/")
    return "/" + "/".join(part for part in parts if part)


def set_parameter(ctx: Context, argv: Sequence[str]) -> None:
    """Set a parameter to a YAML value, or with -t and -b to the content of a file."""
    parser = Parser(
        "rosparam",
        "rosparam set [options] parameter value",
        option("-t --textfile", "the text of a file as the value", "TEXT_FILE"),
        option("-b --binfile", "the bytes of a file as the value, in base64", "BINARY_FILE"),
        _VERBOSE,
    )
    given = parser.parse(argv, 1, missing=_NO_NAME)
    file = given.textfile or given.binfile
    if len(given.words) == 1 and file is None:
        parser.error("invalid arguments. Please specify a parameter value")
    if len(given.words) > (2 if file is None else 1):
        parser.error(_TOO_MANY)
    content = _typed(given.words[1]) if file is None else _content(parser, file, binary=given.textfile is None)
    full = names.check_parameter(_full(ctx, given.words[0]))
    meant = _mistyped(ctx, full)
    chosen = _store(ctx, content, full)
    if meant:
        ctx.warn(f"{full} is new; did you mean {meant}?")
    if given.verbose:
        if not isinstance(content, dict):
            chosen = {_shown(ctx, given.words[0]): content}
        output.write("\n".join(f"set parameter [{name}] to [{value}]" for name, value in chosen.items()))


def _typed(text: str) -> Any:
    try:
        return param.typed(text)
    except UsageError as error:
        if "is not text" not in error.message:
            raise Failure(f"ERROR: {error}") from None
        import yaml

        keys = "YAML dictionaries must have string keys. Invalid dictionary is:"
        raise Failure(f"ERROR: {keys}\n{yaml.safe_load(text)}") from None


def _content(parser: Parser, file: str, binary: bool) -> str:
    """The text of a file, or its bytes in base64, because parameters are JSON here."""
    if not os.path.isfile(file):
        parser.error(f"file '{file}' does not exist")
    try:
        content = read_bytes(file, MOST_TEXT, pipes=True)
    except BadFile as error:
        raise Failure(f"ERROR: {error}") from None
    if binary:
        from base64 import b64encode

        return b64encode(content).decode()
    return content.decode("utf-8", "replace")


def _store(ctx: Context, content: Any, full: str) -> dict[str, Any]:
    """Set a value; a mapping is merged. Returns the names and values that were set. Raises Failure when refused."""
    with refusals():
        chosen = param.settings(content, full)
        for name, value in chosen.items():
            _check_integers(name, value)
        param.store(ctx, chosen)
    return chosen


def _check_integers(name: str, value: Any) -> None:
    """Raise Failure for integers over 32 bits: XML-RPC in ROS, and so every node, cannot hold them."""
    for each in value if isinstance(value, list) else [value]:
        if isinstance(each, list):
            _check_integers(name, each)
        elif isinstance(each, int) and not isinstance(each, bool) and each not in _INT32:
            raise Failure(f"ERROR: parameter [{name}] cannot be {each}: integers have 32 bits; write {float(each)!r}")


def get(ctx: Context, argv: Sequence[str]) -> None:
    """Print a parameter as YAML."""
    pretty_option = option("-p", "pretty: text without quotes", dest="pretty")
    parser = Parser("rosparam", "rosparam get [options] parameter", pretty_option, _VERBOSE)
    given = parser.parse(argv, 1, 1, _NO_NAME, _TOO_MANY)
    full = _full(ctx, given.words[0])
    if given.verbose:
        output.write(f"getting parameter [{_shown(ctx, given.words[0])}]")
    value = _value(ctx, full)
    output.write(pretty(value) + "\n" if given.pretty and isinstance(value, str | dict) else printed(value))


def _value(ctx: Context, full: str) -> Any:
    """The value of a parameter. Raises Failure when it is not set. The root always exists."""
    if full != "/" and not ctx.call("/rosapi/has_param", {"name": full})["exists"]:
        raise Failure(f"ERROR: Parameter [{full}] is not set{_near(ctx, full)}")
    return param.get_value(ctx, full)


def printed(value: Any) -> str:
    """The value as rosparam writes it: YAML with one more line end, no `...` after a scalar."""
    text = param.dumped(value)
    return text.removesuffix("...\n") if text.endswith("\n...\n") else text + "\n"


def pretty(value: Any, indent: str = "") -> str:
    """The value for `get -p`: text unquoted, a mapping one name a line, multi-line texts as blocks, others as YAML."""
    if isinstance(value, str):
        return value
    if not isinstance(value, dict):
        return param.dumped(value).removesuffix("\n...\n").removesuffix("\n")
    return "\n".join(_named(key, value[key], indent) for key in sorted(value) if value[key] != {})


def _named(key: str, value: Any, indent: str) -> str:
    if isinstance(value, dict):
        return f"{indent}{key}:\n{pretty(value, indent + '  ')}"
    if isinstance(value, str) and "\n" in value:
        lines = "\n".join(f"{indent}  {line}" for line in value.split("\n"))
        return f"{indent}{key}: |\n{lines}"
    return f"{indent}{key}: {pretty(value)}"


def _mistyped(ctx: Context, full: str) -> str | None:
    """The parameter that a new name may mean: one deep in a namespace, whose name differs in one part."""
    if full.count("/") <= _DEEP or ctx.call("/rosapi/has_param", {"name": full})["exists"]:
        return None
    near = closest(full, ctx.names("parameter"))
    parts = (full.split("/"), near.split("/")) if near else ([], [])
    is_one = len(parts[0]) == len(parts[1]) and sum(map(str.__ne__, *parts)) == 1
    return near if is_one else None


def _near(ctx: Context, full: str) -> str:
    """A line with the nearest parameter to a name deep in a namespace; empty when there is none."""
    near = closest(full, ctx.names("parameter")) if full.count("/") > _DEEP else None
    return f"\ndid you mean {near}?" if near else ""


def delete(ctx: Context, argv: Sequence[str]) -> None:
    """Delete a parameter or a namespace."""
    parser = Parser("rosparam", "rosparam delete [options] parameter", _VERBOSE)
    given = parser.parse(argv, 1, 1, _NO_NAME, _TOO_MANY)
    full = _full(ctx, given.words[0])
    if full != "/" and not ctx.call("/rosapi/has_param", {"name": full})["exists"]:
        raise Failure(f"ERROR: parameter [{full}] is not set{_near(ctx, full)}")
    ctx.call("/rosapi/delete_param", {"name": full})
    if given.verbose:
        everything = f"parameter [{_shown(ctx, given.words[0])}]" if full != "/" else "ENTIRE parameter server"
        output.write(f"deleted {everything}")


def list_parameters(ctx: Context, argv: Sequence[str]) -> None:
    """Print the names below a namespace, without the namespace itself."""
    words = Parser("rosparam", "rosparam list [namespace]").parse(argv, most=1, extra=_TOO_MANY).words
    inside = _full(ctx, words[0]) if words else "/"
    known = ctx.names("parameter")
    output.write("\n".join(name for name in known if names.is_under(name, inside) and name != inside))


def load(ctx: Context, argv: Sequence[str]) -> None:
    """Set the parameters of a YAML file or of stdin, below a namespace."""
    from slidectl.typed_values import text_of

    parser = Parser("rosparam", "rosparam load [options] file [namespace]", _VERBOSE)
    given = parser.parse(argv, 1, 2, "invalid arguments. Please specify a file name or - for stdin", _TOO_MANY)
    file, namespace = (*given.words, None)[:2]
    if file != "-" and not os.path.isfile(file):
        raise Failure("\n".join(filter(None, [f"ERROR: file [{file}] does not exist", near(file)])))
    with refusals():
        text = text_of(file)
    if given.verbose:
        output.write(f"reading parameters from [{file}]")
    inside = _full(ctx, namespace or "")
    with refusals():
        tree = param.parameters_in(ctx, text, "stdin" if file == "-" else file, namespace is not None)
    if tree != {}:
        _store(ctx, tree, inside)
    if given.verbose:
        _show(tree, inside)


def _show(tree: Any, inside: str) -> None:
    """Print a line for each parameter; a tree that is a single value is printed alone."""
    from slidectl.client.spawning import leaves

    lines = [f"{name}={value}" for name, value in leaves(tree, inside)] if isinstance(tree, dict) else [str(tree)]
    for line in lines:
        output.write(line + "\n")


def dump(ctx: Context, argv: Sequence[str]) -> None:
    """Write all parameters, or those below a namespace, into a file or to stdout."""
    parser = Parser("rosparam", "rosparam dump [options] file [namespace]", _VERBOSE)
    given = parser.parse(argv, most=2, extra=_TOO_MANY)
    file, namespace = (*given.words, None, None)[:2]
    inside = "/" if namespace is None else _full(ctx, namespace)
    if given.verbose and file not in (None, "-"):
        output.write(f"dumping namespace [{namespace or inside}] to file [{file}]")
    value = _value(ctx, inside)
    if file is None or file == "-":
        return output.write(param.dumped(value))
    from slidectl.writing import reason, write_whole  # most commands write no file

    try:
        write_whole(file, param.dumped(value))
    except OSError as error:
        raise Failure(f"ERROR: cannot write [{file}]: {reason(error, file)}") from None
    if given.verbose:
        _show(value, inside)
    return None


rosparam = Tool(
    "rosparam",
    "rosparam gets and sets parameters.",
    {
        "set": (set_parameter, "set a parameter"),
        "get": (get, "print a parameter, or all below a namespace"),
        "load": (load, "set the parameters of a file"),
        "dump": (dump, "write parameters to a file"),
        "delete": (delete, "delete a parameter"),
        "list": (list_parameters, "list parameters"),
    },
    without=0,
    unknown=0,
)
