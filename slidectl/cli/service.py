"""`slidectl service`: list, inspect and call services."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import click

from slidectl import names
from slidectl.cli import completion, output
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.cli.pub import message_of
from slidectl.command_steps import CommandStep
from slidectl.errors import Refused, UsageError
from slidectl.msgs.fill import field_paths
from slidectl.msgs.message_text import YamlForm
from slidectl.msgs.schema import Typedefs, from_typedefs
from slidectl.typed_values import check_quotes, documents_on_stdin, read

CALL_TIMEOUT_S = 60.0


@group(examples=["slidectl service list", "slidectl service call /gazebo/get_world_properties"])
def service() -> None:
    """List, inspect and call services."""


@service.command("list", examples=["slidectl service list /slider", "slidectl service list -n"])
@click.argument("namespace", required=False, shell_complete=completion.services)
@click.option("-n", "--nodes", is_flag=True, help="Also the nodes that provide them.")
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
    providers = ask_each(ctx, "/rosapi/service_node", known, "node")
    if ctx.format == "text" and known:
        return output.write("\n".join(f"{name} {providers[name]}" for name in known))
    return ctx.emit_rows([{"service": name, "node": providers[name]} for name in known], ["service", "node"])


@service.command("info", examples=["slidectl service info list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=completion.services)
@click.pass_obj
def info(ctx: Context, name: str) -> None:
    """Show the provider of a service, its URI, type, arguments and effects.

    The effects are reads, writes (of the world), files or code (that the caller names).

    JSON keys: service, node, uri, type, args, effects.
    """
    found = ctx.resolve("service", name)
    (node,), arguments = found["nodes"], argument_names(found["typedefs"])
    record = {"service": found["name"], "node": node, "uri": ctx.uri, "type": found["type"], "args": arguments}
    text = f"Node: {node}\nURI: {ctx.uri}\nType: {found['type']}\nArgs: {' '.join(arguments)}"
    ctx.emit({**record, "effects": found["effects"]}, f"{text}\nEffects: {' '.join(found['effects'])}")


@service.command("type", examples=["slidectl service type list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=completion.services)
@click.pass_obj
def type_(ctx: Context, name: str) -> None:
    """Print the type of a service.

    JSON keys: service, type.
    """
    found = ctx.resolve("service", name)
    ctx.emit({"service": found["name"], "type": found["type"]}, found["type"])


@service.command("args", examples=["slidectl service args switch_controller"])
@click.argument("name", metavar="SERVICE", shell_complete=completion.services)
@click.pass_obj
def args(ctx: Context, name: str) -> None:
    """Print the names of the fields of a request, nested ones as a.b.

    JSON keys: service, type, args.
    """
    found = ctx.resolve("service", name)
    arguments = argument_names(found["typedefs"])
    ctx.emit({"service": found["name"], "type": found["type"], "args": arguments}, " ".join(arguments) + "\n")


@service.command("uri", examples=["slidectl service uri list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=completion.services)
@click.pass_obj
def uri(ctx: Context, name: str) -> None:
    """Print where a service answers: the daemon's socket.

    JSON keys: service, uri.
    """
    full = ctx.resolve("service", name)["name"]
    ctx.emit({"service": full, "uri": ctx.uri}, ctx.uri)


@service.command("find", examples=["slidectl service find controller_manager_msgs/ListControllers"])
@click.argument("type_name", metavar="TYPE")
@click.pass_obj
def find(ctx: Context, type_name: str) -> None:
    """List the services of a type.

    JSON key: service.
    """
    found = sorted(ctx.call("/rosapi/services_for_type", {"type": type_name})["services"])
    ctx.emit_names(found, "service", f"no service has the type {type_name}")


# --- call -----------------------------------------------------------------------------------------------------------


@service.command(
    "call",
    step=CommandStep(may_add_controllers=True),
    examples=[
        "slidectl service call list_controllers",
        "slidectl service call load_controller \"name: 'joint1_position_controller'\"",
        "slidectl service call switch_controller '[joint1_position_controller]' '[]' 2 false 0",
    ],
)
@click.argument("name", metavar="SERVICE", shell_complete=completion.services)
@click.argument("given", nargs=-1, metavar="[VALUE]...")
@click.option("--stdin", is_flag=True, help="One call for each YAML document or JSON line on stdin.")
@click.pass_obj
def call(ctx: Context, name: str, given: tuple[str, ...], stdin: bool) -> None:
    """Call a service and print its response.

    VALUE is YAML: one mapping of fields ('{}' for the defaults), or one value for each field. Exits 1 when the call
    fails, or when the response has a field 'ok' or 'success' that is false, or a result of simulation_interfaces
    that is not RESULT_OK; the reasons go to stderr. It waits for a minute at most, or for --timeout. With --json it
    prints the response as one object.
    """
    found = ctx.resolve("service", name)
    full, parts = found["name"], found["typedefs"]
    fields = parts[0]["fieldnames"]
    check_quotes(given, fields)
    if given and stdin:
        raise UsageError("a VALUE and --stdin exclude each other")
    if not given and not stdin and fields:
        raise UsageError(
            f"no VALUE given for {full} ({found['type']})", f"the request has the fields: {', '.join(fields)}"
        )
    schema = from_typedefs(parts)
    requests: Iterable[Sequence[Any]] = [[read(word) if word else "" for word in given]]
    if stdin:
        requests = ([{} if document is None else document] for document in documents_on_stdin())
    refusals = []
    for values in requests:
        response, refusal = call_service(ctx, full, message_of(ctx, schema, values))
        ctx.emit(response, as_yaml(response, found["response_typedefs"]))
        warn_of_call(ctx, refusal)
        refusals += refusal
    if refusals:
        raise Refused("\n".join(refusals))


# --- shared with rosservice -----------------------------------------------------------------------------------------

_RESULT_OK = 1
"""RESULT_OK of simulation_interfaces/Result."""


def call_service(ctx: Context, full: str, request: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The response and, when it is a refusal (`ok` or `success` false, or a result but OK), its lines and reasons.

    Raises as Client.call; TimedOut after a minute.
    """
    response = ctx.call(full, request, timeout=ctx.wait_limit(CALL_TIMEOUT_S))
    verdict = next((f"{field}: false" for field in ("ok", "success") if response.get(field) is False), None)
    texts = [response.get(field) for field in ("message", "status_message")]
    result = response.get("result")
    if isinstance(result, dict) and result.keys() == {"result", "error_message"} and result["result"] != _RESULT_OK:
        verdict, texts = f"result {result['result']}", [result["error_message"]]
    if verdict is None:
        return response, []
    reasons = [str(text) for text in texts if text]
    reasons += [error for error in ctx.client.errors if error not in reasons]
    lines = [f"  {line}" for reason in reasons for line in reason.splitlines()]
    return response, [f"{full} answered {verdict}", *lines]


def warn_of_call(ctx: Context, refusal: Sequence[str]) -> None:
    """Print the reasons of the call that are not part of the refusal."""
    for reason in ctx.client.warnings if refusal else ctx.client.reasons:
        ctx.warn(reason)


def ask_each(ctx: Context, question: str, services: Iterable[str], key: str) -> dict[str, str]:
    """Service -> rosapi's answer about it. The requests are sent all together."""
    calls = {name: ctx.client.call_async(question, {"service": name}) for name in services}
    return {name: str(ctx.client.answer(call)[key]) for name, call in calls.items()}


def argument_names(request: Typedefs) -> list[str]:
    """The fields of a request, nested ones as `a.b`."""
    schema = from_typedefs(request)
    return field_paths(schema.fields, schema.root)


def as_yaml(message: dict[str, Any], parts: Typedefs) -> str:
    """A complete request or response as rosservice prints it, with its line end."""
    schema = from_typedefs(parts)
    return YamlForm(schema).printer(schema.root)(message) + "\n"
