"""`slidectl topic`: list and inspect topics. Measuring, echo and pub have modules of their own."""

from __future__ import annotations

from typing import Any

import click

from slidectl import names
from slidectl.cli import completion, output
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.cli.echo import echo
from slidectl.cli.pub import pub
from slidectl.cli.topic_measure import bw, delay, hz
from slidectl.cli.topic_streams import PUBLISHERS, SUBSCRIBERS, usage_of_topic, usage_of_topics, users_of
from slidectl.errors import UsageError
from slidectl.msgs.field_path import select


@group(examples=["slidectl topic list -v", "slidectl topic info joint_states", "slidectl topic hz joint_states"])
def topic() -> None:
    """List, inspect and measure topics."""


for _verb in (hz, bw, delay, pub, echo):
    topic.add_command(_verb)


@topic.command("list", examples=["slidectl topic list", "slidectl topic list -v /slider", "slidectl topic list --json"])
@click.argument("namespace", required=False, shell_complete=completion.topics)
@click.option("-p", "published", is_flag=True, help="Only topics that somebody publishes.")
@click.option("-s", "subscribed", is_flag=True, help="Only topics that somebody subscribes to.")
@click.pass_obj
def list_topics(ctx: Context, namespace: str | None, published: bool, subscribed: bool) -> None:
    """List the topics, all or those below NAMESPACE.

    -v adds their types and the nodes that use them. JSON keys: topic, type; with -v also publishers, subscribers (node
    names).
    """
    if published and subscribed:
        raise UsageError("-p and -s exclude each other")
    types = ctx.client.topics()
    if namespace is not None:
        text = namespace.rstrip("/") or "/"
        inside = names.join(ctx.namespace, text)  # below `--ns`, else below the root
        inside = inside if any(names.is_under(name, inside) for name in types) else names.join("/", text)
        types = {name: kind for name, kind in types.items() if names.is_under(name, inside)}
    rows: list[dict[str, Any]] = [{"topic": name, "type": types[name]} for name in sorted(types)]
    columns = ["topic", "type"]
    if published or subscribed or ctx.verbose:
        for role in (PUBLISHERS, SUBSCRIBERS):
            users = users_of(ctx, types, role)
            rows = [{**row, role: users[row["topic"]]} for row in rows]
        rows = [r for r in rows if (r[PUBLISHERS] or not published) and (r[SUBSCRIBERS] or not subscribed)]
        columns += [PUBLISHERS, SUBSCRIBERS]
    if ctx.format != "text":
        ctx.emit_rows(rows, columns)
    elif ctx.verbose:
        by_topic = {role: {row["topic"]: row[role] for row in rows} for role in (PUBLISHERS, SUBSCRIBERS)}
        publishers = None if subscribed else by_topic[PUBLISHERS]
        subscribers = None if published else by_topic[SUBSCRIBERS]
        output.write(usage_of_topics({row["topic"]: row["type"] for row in rows}, publishers, subscribers))
    elif rows:
        ctx.emit_names([row["topic"] for row in rows], "topic")


@topic.command("info", examples=["slidectl topic info joint_states", "slidectl topic info command --json"])
@click.argument("name", metavar="TOPIC", shell_complete=completion.topics)
@click.pass_obj
def info(ctx: Context, name: str) -> None:
    """Show the type of a topic, and the nodes that publish and subscribe it.

    JSON keys: topic, type, publishers, subscribers (node names).
    """
    found = ctx.find_topic(name, None, with_field=False)
    publishers, subscribers = (users_of(ctx, [found.topic], role)[found.topic] for role in (PUBLISHERS, SUBSCRIBERS))
    record = {"topic": found.topic, "type": found.type, PUBLISHERS: publishers, SUBSCRIBERS: subscribers}
    ctx.emit(record, usage_of_topic(found.type, publishers, subscribers, ctx.uri))


@topic.command("type", examples=["slidectl topic type joint_states", "slidectl topic type 'joint_states/position[0]'"])
@click.argument("target", metavar="TOPIC[/FIELD[I]]", shell_complete=completion.topics)
@click.pass_obj
def type_(ctx: Context, target: str) -> None:
    """Print the type of a topic, or of a field of it.

    For a field: the topic's type, the path and the field's type. JSON keys: topic, type, and field, field_type.
    """
    found = ctx.find_topic(target, None)
    record = {"topic": found.topic, "type": found.type}
    if not found.field:
        return ctx.emit(record, found.type)
    selected = select(found.schema.fields, found.type, found.field)
    spelled = selected.type + "[]" * selected.depth
    return ctx.emit({**record, "field": found.field, "field_type": spelled}, f"{found.type} {found.field} {spelled}")


@topic.command("find", examples=["slidectl topic find sensor_msgs/JointState"])
@click.argument("type_name", metavar="TYPE")
@click.pass_obj
def find_topics(ctx: Context, type_name: str) -> None:
    """List the topics of a type.

    JSON key: topic.
    """
    found = sorted(ctx.call("/rosapi/topics_for_type", {"type": type_name})["topics"])
    ctx.emit_names(found, "topic", f"no topic has the type {type_name}")
