"""Which topic a name means, with its type, in two round trips: the list of topics, then the details of those that fit.

Only look-ups. What a name may leave out is said in slidectl.names.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl import names
from slidectl.cli.target import splits
from slidectl.errors import Refused, UnknownName, closest, listing

if TYPE_CHECKING:
    from slidectl.cli.context import Context
    from slidectl.cli.schema import Schema

PUBLISHERS = "publishers"
SUBSCRIBERS = "subscribers"
_VERBS = {PUBLISHERS: "publishes", SUBSCRIBERS: "subscribes to"}


class Unused(Refused):
    """A topic that exists, but nobody publishes it (or subscribes to it)."""

    def __init__(self, role: str, topic: str, used: Sequence[str], last_words: str = "") -> None:
        near = closest(topic, used)
        suggestion = f" Did you mean {near!r}?" if near else ""
        verb, plural = _VERBS[role], f"topics with {role}"
        hint = f"{plural}: {listing(used)}" + (f"\n{last_words}" if last_words else "")
        super().__init__(f"nobody {verb} {topic}.{suggestion}", hint)


class Target(NamedTuple):
    """A topic with its type, the field path behind it, what rosapi says of the type, and the nodes in the role."""

    topic: str
    type: str
    field: str
    typedefs: list[dict[str, Any]]
    users: list[str]

    @property
    def schema(self) -> Schema:
        from slidectl.cli.schema import from_typedefs

        return from_typedefs(self.typedefs)


def look_up(ctx: Context, text: str, role: str | None, *, with_field: bool = True, last_words: str = "") -> Target:
    """The topic that `text` means among those with `role` (None: any), and the field behind its name.

    `last_words` is a line for the error that says nobody has that role.

    Raises:
        UnknownName: no such topic. Unused: it exists, but has nobody in that role. AmbiguousName: several do.
    """
    types = ctx.client.topics()
    for name, field in splits(text) if with_field else [(text, "")]:
        near = fitting(name, types, ctx.namespace)
        if near:
            return _choose(ctx, name, field, {topic: types[topic] for topic in near}, role, last_words)
    having = _having(ctx, list(types), role)
    cuts = [name for name, _ in splits(text)] if with_field else []
    raise UnknownName("topic", next((name for name in cuts if closest(name, having)), text), having)


def fitting(name: str, known: Iterable[str], namespace: str) -> list[str]:
    """The known names that `name` may stand for: the exact one, and for a relative name all that end with it."""
    exact = names.join(namespace, name)
    ending = None if name.startswith("/") else "/" + name
    return sorted(n for n in known if n == exact or (ending is not None and n.endswith(ending)))


def _choose(ctx: Context, name: str, field: str, near: dict[str, str], role: str | None, last_words: str) -> Target:
    client = ctx.client
    asked = {kind: client.call_async("/rosapi/message_details", {"type": kind}) for kind in set(near.values())}
    users = users_of(ctx, near, role) if role is not None else {}
    typedefs = {kind: client.answer(call)["typedefs"] for kind, call in asked.items()}
    having = [topic for topic in near if role is None or users[topic]]
    if not having and role is not None:
        raise Unused(role, " or ".join(near), _having(ctx, list(client.topics()), role), last_words)
    topic = names.resolve(name, having, kind="topic", namespace=ctx.namespace)
    return Target(topic, near[topic], field, typedefs[near[topic]], users.get(topic, []))


def _having(ctx: Context, topics: Sequence[str], role: str | None) -> list[str]:
    if role is None:
        return list(topics)
    return [topic for topic, users in users_of(ctx, topics, role).items() if users]


def users_of(ctx: Context, topics: Iterable[str], role: str) -> dict[str, list[str]]:
    """Topic -> the nodes in that role, asked in one go."""
    calls = {topic: ctx.client.call_async(f"/rosapi/{role}", {"topic": topic}) for topic in topics}
    return {topic: list(ctx.client.answer(call)[role]) for topic, call in calls.items()}


def details(ctx: Context, type_name: str) -> list[dict[str, Any]]:
    """The typedefs of a message type. Raises Refused (with the daemon's words) for an unknown one."""
    return list(ctx.call("/rosapi/message_details", {"type": type_name})["typedefs"])
