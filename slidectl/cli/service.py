"""`slidectl service`: list, inspect and call services."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import click

from slidectl import names
from slidectl.cli import live, output, servicecall
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.cli.servicecall import argument_names, ask_each
from slidectl.errors import Refused, UsageError


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
    providers = ask_each(ctx, "/rosapi/service_node", known, "node")
    if ctx.format == "text" and known:
        return output.write("\n".join(f"{name} {providers[name]}" for name in known))
    return ctx.emit_rows([{"service": name, "node": providers[name]} for name in known], ["service", "node"])


@service.command("info", examples=["slidectl service info list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def info(ctx: Context, name: str) -> None:
    """Show who provides a service, where, its type and its arguments.

    JSON keys: service, node, uri, type, args.
    """
    found = ctx.resolve("service", name)
    full, kind, (node,) = found["name"], found["type"], found["nodes"]
    arguments = argument_names(found["typedefs"])
    record = {"service": full, "node": node, "uri": ctx.uri, "type": kind, "args": arguments}
    ctx.emit(record, f"Node: {node}\nURI: {ctx.uri}\nType: {kind}\nArgs: {' '.join(arguments)}")


@service.command("type", examples=["slidectl service type list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def type_(ctx: Context, name: str) -> None:
    """Print the type of a service.

    JSON keys: service, type.
    """
    found = ctx.resolve("service", name)
    ctx.emit({"service": found["name"], "type": found["type"]}, found["type"])


@service.command("args", examples=["slidectl service args switch_controller"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
@click.pass_obj
def args(ctx: Context, name: str) -> None:
    """Print the names of the fields of a request, nested ones as a.b.

    JSON keys: service, type, args.
    """
    found = ctx.resolve("service", name)
    arguments = argument_names(found["typedefs"])
    ctx.emit({"service": found["name"], "type": found["type"], "args": arguments}, " ".join(arguments) + "\n")


@service.command("uri", examples=["slidectl service uri list_controllers"])
@click.argument("name", metavar="SERVICE", shell_complete=live.services)
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
    fails, or when the response has a field 'ok' or 'success' that is false; the reasons go to stderr. It
    waits for a minute at most, or for --timeout. With --json it prints the response as one object.
    """
    found = ctx.resolve("service", name)
    full, kind = found["name"], found["type"]
    forms = servicecall.forms(found)
    if len(given) > 1:
        from slidectl.cli.values import check_quotes

        check_quotes(given, forms.request[0]["fieldnames"])
    if not given and not stdin and forms.request[0]["fieldnames"]:
        fields = ", ".join(forms.request[0]["fieldnames"])
        raise UsageError(f"no VALUE given for {full} ({kind})", f"the request has the fields: {fields}")
    refusals = []
    for values in _requests(given, stdin):
        answer = servicecall.call(ctx, full, _filled(ctx, forms, values))
        ctx.emit(answer.response, forms.printer(answer.response))
        for reason in [] if answer.refusal else answer.reasons:
            ctx.warn(reason)
        refusals += answer.refusal
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


def _filled(ctx: Context, forms: servicecall.Forms, values: Sequence[Any]) -> dict[str, Any]:
    from slidectl.cli.values import is_numeric
    from slidectl.msgs.fill import fill

    kind = str(forms.request[0]["type"])
    if is_numeric(list(values)):
        return fill(forms.fields_of, kind, values)
    from slidectl.cli.schema import from_typedefs
    from slidectl.cli.templates import Template

    template = Template(from_typedefs(forms.request), values)
    now = None
    if template.needs_clock:
        time = ctx.call("/rosapi/get_time")["time"]
        now = (time["secs"], time["nsecs"])
    return fill(forms.fields_of, kind, template.at(0, 0.0), now)
