"""`rosservice`: list, inspect and call services. A response that refuses is printed, and the exit code is 1."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.service import argument_names, as_yaml, ask_each, call_service, warn_of_call
from slidectl.errors import EXIT_REFUSED, Refused, TimedOut, UnknownName, closest
from slidectl.extensions.ros_commands import genpy
from slidectl.extensions.ros_commands.arguments import Failure, Parser, Tool, below, option, resolve, without_remappings
from slidectl.msgs.schema import Typedefs
from slidectl.typed_values import check_quotes

if TYPE_CHECKING:
    from slidectl.msgs.typed import ResolveResponseMsg

_FAILED = 2
_NOT_AVAILABLE = "ERROR: Service [{}] is not available."
_LOOK_AGAIN_S = 0.1


def list_services(ctx: Context, argv: Sequence[str]) -> None:
    """Print the names, with -n also the nodes; nothing when there are none."""
    parser = Parser(
        "rosservice", "rosservice list [/namespace]", option("-n --nodes", "with the nodes that provide them")
    )
    given = parser.parse(without_remappings(argv), most=1, extra="you may only specify one input namespace")
    known = below(ctx, ctx.names("service"), given.words[0] if given.words else None, "rosservice")
    if given.nodes:
        providers = ask_each(ctx, "/rosapi/service_node", known, "node")
        known = [f"{name} {providers[name]}" for name in known]
    if known:
        output.write("\n".join(known))


def _find(ctx: Context, full: str) -> ResolveResponseMsg | None:
    """Name, type, typedefs and node of a service (slidectl/Resolve), None when it does not exist."""
    try:
        return ctx.resolve("service", full)
    except UnknownName:
        return None


def _service(
    ctx: Context,
    argv: Sequence[str],
    verb: str,
    unknown: str,
    code: int = EXIT_REFUSED,
    missing: str = "service must be specified",
) -> ResolveResponseMsg:
    """The service named on the command line. Raises Failure with `unknown` and `code` when it does not exist."""
    parser = Parser("rosservice", f"rosservice {verb} /service")
    extra = f"you may only specify one {'service' if verb == 'info' else 'input service'}"
    full = resolve(ctx, parser.parse(without_remappings(argv), 1, 1, missing, extra).words[0], "rosservice")
    found = _find(ctx, full)
    if found is None:
        raise Failure(unknown.format(full) + _near(ctx, full), code)
    return found


def _near(ctx: Context, full: str) -> str:
    """A line with the service that is nearest in spelling; empty when there is none."""
    known = ctx.names("service")
    end = "/".join(full.split("/")[-2:])
    near = closest(full, known) or next((name for name in known if name.endswith(f"/{end}")), None)
    return f"\ndid you mean {near}?" if near else ""


def info(ctx: Context, argv: Sequence[str]) -> None:
    """Print node, URI, type and arguments of a service."""
    found = _service(ctx, argv, "info", "ERROR: unknown service", missing="you must specify a service name")
    arguments = " ".join(argument_names(found["typedefs"]))
    output.write(f"Node: {found['nodes'][0]}\nURI: {ctx.uri}\nType: {found['type']}\nArgs: {arguments}")


def node(ctx: Context, argv: Sequence[str]) -> None:
    """Print the node that provides a service."""
    output.write(_service(ctx, argv, "node", "Unknown service: {}")["nodes"][0])


def type_of(ctx: Context, argv: Sequence[str]) -> None:
    """Print the type of a service."""
    output.write(_service(ctx, argv, "type", "Unknown service [{}]")["type"])


def uri(ctx: Context, argv: Sequence[str]) -> None:
    """Print the URI of a service."""
    _service(ctx, argv, "uri", "Unknown service: {}")
    output.write(ctx.uri)


def args(ctx: Context, argv: Sequence[str]) -> None:
    """Print the fields of the request in one line."""
    output.write(" ".join(argument_names(_service(ctx, argv, "args", _NOT_AVAILABLE, _FAILED)["typedefs"])))


def find(ctx: Context, argv: Sequence[str]) -> None:
    """Print the services of a type."""
    complaints = "please specify a message type", "you may only specify one message type"
    given = Parser("rosservice", "rosservice find msg-type").parse(without_remappings(argv), 1, 1, *complaints)
    output.write("\n".join(ctx.call("/rosapi/services_for_type", {"type": given.words[0]})["services"]))


def call(ctx: Context, argv: Sequence[str]) -> None:
    """Call once with the words as request, or once for each document on stdin."""
    parser = Parser(
        "rosservice",
        "rosservice call /service [args...]",
        option("-v", "print the request, too", dest="verbose"),
        option("--wait", "wait until the service exists"),
    )
    given = parser.parse(without_remappings(argv, payload_from=1), 1, missing="service must be specified")
    name, *words = given.words
    check_quotes(words)
    try:
        values = [genpy.read(word) if word else "" for word in words]
    except genpy.NotYaml as error:
        parser.error(f"Argument error: {error}")
    full = resolve(ctx, name, "rosservice")
    found = _awaited(ctx, full) if given.wait else _find(ctx, full)
    if found is None:
        raise Failure(_NOT_AVAILABLE.format(full) + _near(ctx, full), _FAILED)
    request, response = found["typedefs"], found["response_typedefs"]
    check_quotes(words, request[0]["fieldnames"])
    from_stdin = not values and bool(request[0]["fieldnames"])
    if from_stdin and sys.stdin.isatty():
        parser.error("Please specify service arguments")
    refusals: list[str] = []
    for each in _documents() if from_stdin else [values]:
        message = _filled(ctx, found["type"], request, each)
        if given.verbose:
            output.write(f"{genpy.as_yaml(request, message)}\n---")
        refusals += _call_once(ctx, full, message, response)
    if refusals:
        raise Failure("\n".join(["ERROR: " + refusals[0], *refusals[1:]]))


def _awaited(ctx: Context, full: str) -> ResolveResponseMsg:
    """Wait until a node provides the service. Raises TimedOut after `--timeout`; without it there is no limit."""
    limit = ctx.wait_limit(float("inf"))
    deadline = ctx.client.monotonic() + limit
    while (found := _find(ctx, full)) is None:
        if ctx.client.monotonic() >= deadline:
            raise TimedOut(f"no node provided {full} within {limit:g} s")
        ctx.pause(_LOOK_AGAIN_S)
    return found


def _documents() -> Iterator[Sequence[Any]]:
    """The documents on stdin."""
    try:
        yield from genpy.documents(sys.stdin)
    except genpy.NotYaml as error:
        raise Failure(f"Invalid YAML: {error}") from None


def _filled(ctx: Context, kind: str, request: Typedefs, values: Sequence[Any]) -> dict[str, Any]:
    try:
        return genpy.filled(ctx, request, values)
    except genpy.WrongStructure as error:
        given = "".join(f" * {value} (type {type(value).__name__})\n" for value in values)
        raise Failure(
            f"ERROR: Incompatible arguments to call service:\n{error}\nProvided arguments are:\n{given}\n"
            f"Service arguments are: [{' '.join(argument_names(request))}]",
            _FAILED,
        ) from None
    except genpy.WrongType as error:
        from slidectl import msgs

        raise Failure(
            "ERROR: Unable to send request. One of the fields has an incorrect type:\n"
            f"  {error}\n\nsrv file:\n{msgs.show_service(kind).strip()}",
            _FAILED,
        ) from None


def _call_once(ctx: Context, full: str, request: dict[str, Any], response: Typedefs) -> list[str]:
    """Call and print the response. Returns the lines of a refusal. Raises Failure (2) when the call fails."""
    try:
        answer, refusal = call_service(ctx, full, request)
    except Refused as error:
        first, *rest = str(error).splitlines()
        text = repr(f"error processing request: {first}".encode())
        raise Failure("\n".join([f"ERROR: service [{full}] responded with an error: {text}", *rest]), _FAILED) from None
    output.write(as_yaml(answer, response))
    warn_of_call(ctx, refusal)
    return refusal


rosservice = Tool(
    "rosservice",
    "rosservice shows and calls services.",
    {
        "args": (args, "print the fields of a request"),
        "call": (call, "call a service"),
        "find": (find, "list services by type"),
        "info": (info, "show node, type and arguments of a service"),
        "list": (list_services, "list services"),
        "node": (node, ""),
        "type": (type_of, "print the type of a service"),
        "uri": (uri, "print the URI of a service"),
    },
)
