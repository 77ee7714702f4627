"""`slidectl service`: list, inspect and call services."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import click

from slidectl import names
from slidectl.cli import live, output
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.cli.topics import fitting
from slidectl.errors import Refused, UsageError

CALL_TIMEOUT_S = 60.0
_VERDICTS = ("ok", "success")
_REASONS = ("message", "status_message")


@group(examples=["slidectl service list", "slidectl service call /gazebo/get_world_properties"])
def service() -> None:
    """List, inspect and call services."""


@service.command("list", examples=["slidectl service list /slider", "slidectl service list -n"])
@click.argument("namespace", required=False, shell_complete=live.services)
@click.option("-n", "--nodes", is_flag=True, help="The nodes that provide them, too.")
@click.pass_obj
def list_services(ctx: Context, namespace: str | None, nodes: bool) -> None:
    """List the services, all or those below NAMESPACE.

    JSON keys: service, and with -n node.
    """
    known = ctx.names("service")
    if namespace is not None:
        inside = names.join(ctx.namespace, namespace.rstrip("/") or "/")
        known = [name for name in known if names.is_under(name, inside)]
    if not nodes:
        return ctx.emit_names(known, "service")
    providers = _ask_each(ctx, "/rosapi/service_node", known, "node")
    if ctx.format == "text" and known:
        return output.write("\n".join(f"{name} {providers[name]}" for name in known))
    return ctx.emit_rows([{"service": name, "node": providers[name]} for name in known], ["service", "node"])


def _ask_each(ctx: Context, question: str, services: Iterable[str], key: str) -> dict[str, str]:
    calls = {name: ctx.client.call_async(question, {"service": name}) for name in services}
    return {name: str(ctx.client.answer(call)[key]) for name, call in calls.items()}


@service.command("info", examples=["slidectl service info list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def info(ctx: Context, name: str) -> None:
    """Show who provides a service, where, its type and its arguments.

    JSON keys: service, node, uri, type, args.
    """
    full, kind = _typed(ctx, name)
    node = ctx.call("/rosapi/service_node", {"service": full})["node"]
    arguments = _arguments(_request_typedefs(ctx, kind))
    record = {"service": full, "node": node, "uri": _uri(ctx), "type": kind, "args": arguments}
    ctx.emit(record, f"Node: {node}\nURI: {_uri(ctx)}\nType: {kind}\nArgs: {' '.join(arguments)}")


@service.command("type", examples=["slidectl service type list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def type_(ctx: Context, name: str) -> None:
    """Print the type of a service.

    JSON keys: service, type.
    """
    full, kind = _typed(ctx, name)
    ctx.emit({"service": full, "type": kind}, kind)


@service.command("args", examples=["slidectl service args switch_controller"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def args(ctx: Context, name: str) -> None:
    """Print the names of the fields of a request, nested ones as a.b.

    JSON keys: service, type, args.
    """
    full, kind = _typed(ctx, name)
    arguments = _arguments(_request_typedefs(ctx, kind))
    ctx.emit({"service": full, "type": kind, "args": arguments}, " ".join(arguments) + "\n")


@service.command("uri", examples=["slidectl service uri list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def uri(ctx: Context, name: str) -> None:
    """Print where a service answers: the daemon's socket.

    JSON keys: service, uri.
    """
    full = ctx.resolve("service", name)
    ctx.emit({"service": full, "uri": _uri(ctx)}, _uri(ctx))


@service.command("find", examples=["slidectl service find controller_manager_msgs/ListControllers"])
@click.argument("type_name", metavar="TYPE")
@click.pass_obj
def find(ctx: Context, type_name: str) -> None:
    """List the services of a type.

    JSON key: service.
    """
    found = sorted(ctx.call("/rosapi/services_for_type", {"type": type_name})["services"])
    ctx.emit_names(found, "service", f"no service has the type {type_name}")


def _typed(ctx: Context, name: str) -> tuple[str, str]:
    """The full name of a service, and its type: two round trips. Raises UnknownName, AmbiguousName."""
    known = ctx.names("service")
    types = _ask_each(ctx, "/rosapi/service_type", fitting(name, known, ctx.namespace), "type")
    full = names.resolve(name, known, kind="service", namespace=ctx.namespace)
    return full, types[full]


def _uri(ctx: Context) -> str:
    return f"unix://{ctx.client.paths.socket}"


def _request_typedefs(ctx: Context, kind: str) -> list[dict[str, Any]]:
    return list(ctx.call("/rosapi/service_request_details", {"type": kind})["typedefs"])


def _typedefs(ctx: Context, kind: str) -> list[list[dict[str, Any]]]:
    """Those of the request and of the response, in one round trip."""
    asked = [
        ctx.client.call_async(f"/rosapi/service_{part}_details", {"type": kind}) for part in ("request", "response")
    ]
    return [list(ctx.client.answer(call)["typedefs"]) for call in asked]


def _arguments(typedefs: Sequence[dict[str, Any]]) -> list[str]:
    from slidectl.msgs.fill import field_paths, fields_from

    return field_paths(fields_from(typedefs), str(typedefs[0]["type"]))


# --- call -----------------------------------------------------------------------------------------------------------


@service.command(
    "call",
    examples=[
        "slidectl service call list_controllers",
        "slidectl service call load_controller \"name: 'joint1_position_controller'\"",
        "slidectl service call switch_controller '[joint1_position_controller]' '[]' 2 false 0",
    ],
)
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.argument("given", nargs=-1, metavar="[VALUE]...")
@click.option("--stdin", is_flag=True, help="One call for each YAML document or JSON line on stdin.")
@click.pass_obj
def call(ctx: Context, name: str, given: tuple[str, ...], stdin: bool) -> None:
    """Call a service and print its response.

    VALUE is YAML: one mapping of fields ('{}' for the defaults), or one value for each field. Exits 1 when the call
    fails, or when the response has a field 'ok' or 'success' that is false; the reasons on /rosout go to stderr. It
    waits for a minute at most, or for --timeout. With --json it prints the response as one object.
    """
    full, kind = _typed(ctx, name)
    request_types, response_types = _typedefs(ctx, kind)
    if not given and not stdin and request_types[0]["fieldnames"]:
        fields = ", ".join(request_types[0]["fieldnames"])
        raise UsageError(f"no VALUE given for {full} ({kind})", f"the request has the fields: {fields}")
    refusals = []
    for values in _requests(given, stdin):
        refusals += _call_once(ctx, full, _filled(ctx, request_types, values), response_types)
    if refusals:
        raise Refused("\n".join(refusals))


def _requests(given: Sequence[str], stdin: bool) -> Iterator[Sequence[Any]]:
    if stdin and given:
        raise UsageError("a VALUE beside --stdin: give one of them")
    if stdin:
        from slidectl.cli.documents import from_stdin

        yield from ([{} if document is None else document] for document in from_stdin())
        return
    from slidectl.cli.values import read

    yield [read(word) if word else "" for word in given]


def _filled(ctx: Context, typedefs: Sequence[dict[str, Any]], values: Sequence[Any]) -> dict[str, Any]:
    from slidectl.cli.schema import from_typedefs
    from slidectl.cli.templates import Template
    from slidectl.msgs.fill import fields_from, fill

    template = Template(from_typedefs(typedefs), values)
    now = None
    if template.needs_clock:
        time = ctx.call("/rosapi/get_time")["time"]
        now = (time["secs"], time["nsecs"])
    return fill(fields_from(typedefs), str(typedefs[0]["type"]), template.at(0, 0.0), now)


def _call_once(ctx: Context, full: str, request: dict[str, Any], typedefs: Sequence[dict[str, Any]]) -> list[str]:
    """Call and print the response. Lines that say why it was refused; none when it was not."""
    with ctx.client.rosout() as lines:
        response = ctx.call(full, request, ctx.wait_limit(CALL_TIMEOUT_S))
    ctx.emit(response, _as_yaml(response, typedefs))
    verdict = next((field for field in _VERDICTS if response.get(field) is False), None)
    if verdict is None:
        return []
    reasons = [str(response[field]) for field in _REASONS if response.get(field)]
    logged = [str(line["msg"]) for line in lines if line["msg"] not in reasons]
    indented = [f"  {line}" for reason in reasons + logged[-2:] for line in reason.splitlines()]
    return [f"{full} answered {verdict}: false", *indented]


def _as_yaml(response: dict[str, Any], typedefs: Sequence[dict[str, Any]]) -> str:
    from slidectl.cli.schema import from_typedefs
    from slidectl.cli.yamlform import YamlForm

    schema = from_typedefs(typedefs)
    return YamlForm(schema).printer(schema.root)(response) + "\n"
