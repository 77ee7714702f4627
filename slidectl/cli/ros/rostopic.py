"""`rostopic`: its verbs, and those of them that only look: list, info, type and find."""

from __future__ import annotations

from collections.abc import Sequence

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.arguments import Arguments, Option, Parser
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import HOST, resolve, without_remappings
from slidectl.cli.ros.verbs import Tool, Verb
from slidectl.cli.topics import PUBLISHERS, SUBSCRIBERS, look_up, usage_of_topic, usage_of_topics, users_of
from slidectl.errors import UnknownName

TOOL = Tool(
    "rostopic",
    "rostopic shows topics, and publishes and measures messages.",
    {
        "bw": Verb("topic_rates:bw", "measure how many bytes come"),
        "delay": Verb("topic_rates:delay", "measure how late messages come, by their headers"),
        "echo": Verb("topic_echo:echo", "print messages"),
        "find": Verb("rostopic:find", "list topics by type"),
        "hz": Verb("topic_rates:hz", "measure how often messages come"),
        "info": Verb("rostopic:info", "show who publishes and who subscribes"),
        "list": Verb("rostopic:list_topics", "list topics"),
        "pub": Verb("topic_pub:pub", "publish messages"),
        "type": Verb("rostopic:type_of", "print the type of a topic or of a field"),
    },
)


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb."""
    TOOL.run(ctx, argv)


def list_topics(ctx: Context, argv: Sequence[str]) -> None:
    """Names, or with -v types and how many use them."""
    parser = Parser(
        "rostopic",
        "rostopic list [/namespace]",
        [
            Option(("-b", "--bag"), "bag", "the topics of a bag", "BAGFILE"),
            Option(("-v", "--verbose"), "verbose", "types, and how many use them"),
            Option(("-p",), "published", "only those that somebody publishes"),
            Option(("-s",), "subscribed", "only those that somebody subscribes to"),
            Option(("--host",), "host", "below the name of the machine"),
        ],
    )
    given = parser.parse(without_remappings(argv))
    (namespace,) = parser.at_most(given, 1, "you may only specify one input topic")
    if given.published and given.subscribed:
        parser.error("you may only specify one of -p, -s")
    if namespace is not None:
        namespace = resolve(ctx, namespace, "rostopic").rstrip("/") or "/"
    if given.bag:
        from slidectl.cli.ros import bag

        return bag.list_topics(given.bag, namespace)
    types = ctx.client.topics()
    chosen = [name for name in sorted(types) if namespace is None or names.is_under(name, namespace)]
    users = {role: users_of(ctx, chosen, role) for role in _asked(given)}
    if given.verbose:
        shown_types = {name: types[name] for name in chosen}
        return output.write(usage_of_topics(shown_types, users.get(PUBLISHERS), users.get(SUBSCRIBERS)))
    shown = [name for name in chosen if all(found[name] for found in users.values())]
    return output.write("\n".join([f"Host [{HOST}]:", *(f"  {n}" for n in shown)] if given.host else shown))


def _asked(given: Arguments) -> list[str]:
    """The roles that matter: that of -p or -s, for -v both."""
    if given.published or given.subscribed:
        return [PUBLISHERS if given.published else SUBSCRIBERS]
    return [PUBLISHERS, SUBSCRIBERS] if given.verbose else []


def info(ctx: Context, argv: Sequence[str]) -> None:
    """Type, publishers, subscribers."""
    parser = Parser("rostopic", "rostopic info /topic")
    complaints = "you must specify a topic name", "you may only specify one topic name"
    full = resolve(ctx, parser.only_word(without_remappings(argv), *complaints), "rostopic")
    kind = ctx.client.topics().get(full)
    if kind is None:
        raise Failure(f"ERROR: Unknown topic {full}")
    publishers, subscribers = (users_of(ctx, [full], role)[full] for role in (PUBLISHERS, SUBSCRIBERS))
    output.write(usage_of_topic(kind, publishers, subscribers, ctx.uri))


def type_of(ctx: Context, argv: Sequence[str]) -> None:
    """The type of a topic; for a field the topic's type, the path, and the field's type."""
    parser = Parser("rostopic", "rostopic type [-h] topic_or_field", modern=True)
    complaints = (
        "rostopic type: error: the following arguments are required: topic_or_field",
        "rostopic type: error: unrecognized arguments: {}",
    )
    full = resolve(ctx, parser.only_word(without_remappings(argv), *complaints), "rostopic")
    unknown = Failure(f"unknown topic type [{full}]")
    try:
        found = look_up(ctx, full, None)
        if not found.field:
            return output.write(found.type)
        from slidectl.field_path import select

        selected = select(found.schema.fields, found.type, found.field)
    except UnknownName:
        raise unknown from None
    return output.write(f"{found.type} {found.field} {selected.type}{'[]' * selected.depth}")


def find(ctx: Context, argv: Sequence[str]) -> None:
    """The topics of a type."""
    parser = Parser("rostopic", "rostopic find msg-type")
    complaints = "please specify a message type", "you may only specify one message type"
    kind = parser.only_word(without_remappings(argv), *complaints)
    output.write("\n".join(ctx.call("/rosapi/topics_for_type", {"type": kind})["topics"]))
