"""`rosservice`: list, inspect and call services. A response that says no is printed, and the exit code is 1."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from time import monotonic
from typing import Any

from slidectl import names
from slidectl.cli import output, service
from slidectl.cli.context import Context
from slidectl.cli.ros import genpy, yamltext
from slidectl.cli.ros.arguments import Option, Parser
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import pause, resolve, without_remappings
from slidectl.cli.ros.verbs import Tool, Verb
from slidectl.cli.service import argument_names, as_yaml, ask_each
from slidectl.cli.topics import Typedefs, from_typedefs
from slidectl.cli.values import check_quotes
from slidectl.errors import Refused, TimedOut

TOOL = Tool(
    "rosservice",
    "rosservice shows and calls services.",
    {
        "args": Verb("rosservice:args", "print the fields of a request"),
        "call": Verb("rosservice:call", "call a service"),
        "find": Verb("rosservice:find", "list services by type"),
        "info": Verb("rosservice:info", "show who provides a service, its type and arguments"),
        "list": Verb("rosservice:list_services", "list services"),
        "node": Verb("rosservice:node", ""),
        "type": Verb("rosservice:type_of", "print the type of a service"),
        "uri": Verb("rosservice:uri", "print where a service answers"),
    },
)
_FAILED = 2
_LOOK_AGAIN_S = 0.1


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb."""
    TOOL.run(ctx, argv)


# --- looking ----------------------------------------------------------------------------------------------------------


def list_services(ctx: Context, argv: Sequence[str]) -> None:
    """Names, with -n the nodes too; nothing at all when there are none."""
    option = Option(("-n", "--nodes"), "nodes", "with the nodes that provide them")
    parser = Parser("rosservice", "rosservice list [/namespace]", [option])
    given = parser.parse(without_remappings(argv))
    (namespace,) = parser.at_most(given, 1, "you may only specify one input namespace")
    inside = resolve(ctx, namespace, "rosservice").rstrip("/") or "/" if namespace else "/"
    known = [name for name in ctx.names("service") if names.is_under(name, inside)]
    if given.nodes:
        providers = ask_each(ctx, "/rosapi/service_node", known, "node")
        known = [f"{name} {providers[name]}" for name in known]
    if known:
        output.write("\n".join(known))


def _asked(ctx: Context, argv: Sequence[str], verb: str, missing: str) -> str:
    parser = Parser("rosservice", f"rosservice {verb} /service")
    complaints = missing, f"you may only specify one {'service' if verb == 'info' else 'input service'}"
    return resolve(ctx, parser.only_word(without_remappings(argv), *complaints), "rosservice")


def _type(ctx: Context, full: str) -> str:
    """The type of a service, empty when there is none of that name."""
    return str(ctx.call("/rosapi/service_type", {"service": full})["type"])


def info(ctx: Context, argv: Sequence[str]) -> None:
    """Node, URI, type and arguments."""
    full = _asked(ctx, argv, "info", "you must specify a service name")
    kind = _type(ctx, full)
    if not kind:
        raise Failure("ERROR: unknown service")
    node = _node(ctx, full)
    arguments = argument_names(service.typedefs(ctx, kind)[0])
    output.write(f"Node: {node}\nURI: {ctx.uri}\nType: {kind}\nArgs: {' '.join(arguments)}")


def type_of(ctx: Context, argv: Sequence[str]) -> None:
    """The type."""
    full = _asked(ctx, argv, "type", "service must be specified")
    output.write(_type(ctx, full) or _unknown(f"Unknown service [{full}]"))


def uri(ctx: Context, argv: Sequence[str]) -> None:
    """Where it answers."""
    full = _asked(ctx, argv, "uri", "service must be specified")
    output.write(ctx.uri if _type(ctx, full) else _unknown(f"Unknown service: {full}"))


def node(ctx: Context, argv: Sequence[str]) -> None:
    """Who provides it."""
    full = _asked(ctx, argv, "node", "service must be specified")
    output.write(_node(ctx, full) or _unknown(f"Unknown service: {full}"))


def _node(ctx: Context, full: str) -> str:
    return ask_each(ctx, "/rosapi/service_node", [full], "node")[full]


def _unknown(text: str) -> str:
    raise Failure(text)


def args(ctx: Context, argv: Sequence[str]) -> None:
    """The fields of the request in one line."""
    full = _asked(ctx, argv, "args", "service must be specified")
    output.write(" ".join(argument_names(service.typedefs(ctx, _available(ctx, full))[0])))


def find(ctx: Context, argv: Sequence[str]) -> None:
    """The services of a type."""
    parser = Parser("rosservice", "rosservice find msg-type")
    complaints = "please specify a message type", "you may only specify one message type"
    kind = parser.only_word(without_remappings(argv), *complaints)
    output.write("\n".join(ctx.call("/rosapi/services_for_type", {"type": kind})["services"]))


# --- calling ----------------------------------------------------------------------------------------------------------

_CALL = Parser(
    "rosservice",
    "rosservice call /service [args...]",
    [
        Option(("-v",), "verbose", "print the request, too"),
        Option(("--wait",), "wait", "wait until somebody provides the service"),
    ],
)


def call(ctx: Context, argv: Sequence[str]) -> None:
    """Call once with the words as request, or once for each document on stdin."""
    given = _CALL.parse(without_remappings(argv, payload_from=1))
    if not given.words:
        _CALL.error("service must be specified")
    check_quotes(given.words[1:])
    values = [_value(word) for word in given.words[1:]]
    full = resolve(ctx, given.words[0], "rosservice")
    kind = _awaited(ctx, full) if given.wait else _available(ctx, full)
    request, response = service.typedefs(ctx, kind)
    check_quotes(given.words[1:], request[0]["fieldnames"])
    refusals: list[str] = []
    for each in _requests(values, bool(request[0]["fieldnames"])):
        message = _filled(ctx, kind, request, each)
        if given.verbose:
            output.write(f"{_printed(message, request)}---")
        refusals += _call_once(ctx, full, message, response)
    if refusals:
        raise Failure("\n".join(["ERROR: " + refusals[0], *refusals[1:]]))


def _value(word: str) -> Any:
    try:
        return yamltext.read(word) if word else ""
    except yamltext.NotYaml as error:
        return _CALL.error(f"Argument error: {error}")


def _available(ctx: Context, full: str) -> str:
    """The type of a service. Raises Failure (2) when there is none of that name."""
    kind = _type(ctx, full)
    if not kind:
        raise Failure(f"ERROR: Service [{full}] is not available.", _FAILED)
    return kind


def _awaited(ctx: Context, full: str) -> str:
    """The type of a service, as soon as somebody provides it. Raises TimedOut after `--timeout`, else never."""
    limit = ctx.wait_limit(float("inf"))
    deadline = monotonic() + limit
    while not (kind := _type(ctx, full)):
        if monotonic() >= deadline:
            raise TimedOut(f"nobody provided {full} within {limit:g} s")
        pause(ctx, _LOOK_AGAIN_S)
    return kind


def _requests(values: Sequence[Any], has_fields: bool) -> Iterator[Sequence[Any]]:
    """The values of the command line, else the documents on stdin."""
    if values or not has_fields:
        yield values
        return
    if sys.stdin.isatty():
        _CALL.error("Please specify service arguments")
    try:
        for document in yamltext.documents(sys.stdin):
            yield document if isinstance(document, list) else [document]
    except yamltext.NotYaml as error:
        raise Failure(f"Invalid YAML: {error}") from None


def _filled(ctx: Context, kind: str, request: Typedefs, values: Sequence[Any]) -> dict[str, Any]:
    try:
        return genpy.filled(ctx, request, values)
    except genpy.Misfit as error:
        given = "".join(f" * {value} (type {type(value).__name__})\n" for value in values)
        raise Failure(
            f"ERROR: Incompatible arguments to call service:\n{error}\nProvided arguments are:\n{given}\n"
            f"Service arguments are: [{genpy.paths(request)}]",
            _FAILED,
        ) from None
    except genpy.WrongType as error:
        from slidectl import msgs

        raise Failure(
            "ERROR: Unable to send request. One of the fields has an incorrect type:\n"
            f"  {error}\n\nsrv file:\n{msgs.show_service(kind).strip()}",
            _FAILED,
        ) from None


def _printed(message: dict[str, Any], request: Typedefs) -> str:
    schema = from_typedefs(request)
    return as_yaml(genpy.complete(schema, schema.root, message), request)


def _call_once(ctx: Context, full: str, request: dict[str, Any], response: Typedefs) -> list[str]:
    """Call and print the response. The lines that say so when it says no. Raises Failure (2) when the call fails."""
    try:
        answer = service.call_service(ctx, full, request)
    except Refused as error:
        first, *rest = str(error).splitlines()
        text = repr(f"error processing request: {first}".encode())
        raise Failure("\n".join([f"ERROR: service [{full}] responded with an error: {text}", *rest]), _FAILED) from None
    output.write(as_yaml(answer.response, response))
    if not answer.refusal:
        for line in answer.reasons:
            ctx.warn(line)
    return answer.refusal
