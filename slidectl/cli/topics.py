"""Which topic a name means, with its type: the daemon says it (`/slidectl/resolve`). Only look-ups."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from slidectl.cli.context import Context
    from slidectl.cli.schema import Schema

PUBLISHERS = "publishers"
SUBSCRIBERS = "subscribers"


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


def look_up(ctx: Context, text: str, role: str | None, *, with_field: bool = True) -> Target:
    """The topic that `text` means among those with `role` (None: any), and the field behind its name.

    Raises:
        UnknownName: no such topic. Unused: it exists, but has nobody in that role. AmbiguousName: several do.
    """
    found = ctx.resolve("topic", text, role=role or "", with_field=with_field)
    return Target(found["name"], found["type"], found["field"], found["typedefs"], found["nodes"])


def users_of(ctx: Context, topics: Iterable[str], role: str) -> dict[str, list[str]]:
    """Topic -> the nodes in that role, asked in one go."""
    calls = {topic: ctx.client.call_async(f"/rosapi/{role}", {"topic": topic}) for topic in topics}
    return {topic: list(ctx.client.answer(call)[role]) for topic, call in calls.items()}


def details(ctx: Context, type_name: str) -> list[dict[str, Any]]:
    """The typedefs of a message type. Raises Refused (with the daemon's words) for an unknown one."""
    return list(ctx.call("/rosapi/message_details", {"type": type_name})["typedefs"])
