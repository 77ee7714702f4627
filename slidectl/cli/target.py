"""`TOPIC/field[i]` on the command line: which part is the topic, and which topic that is.

Only names; what the field means is for fieldpath and the daemon.
"""

from __future__ import annotations

from collections.abc import Iterator

from slidectl.cli.context import Context
from slidectl.errors import UnknownName, closest


def find(ctx: Context, text: str, role: str | None = "publishers") -> tuple[str, str]:
    """The full name of the topic, and the field below it (`position[0]`, `pose/position/x`, or empty).

    The longest beginning that is a topic counts. `role` leaves only topics that have `publishers` or `subscribers`.
    Raises UnknownName (1), which suggests the closest topic, or AmbiguousName (2).
    """
    known = ctx.client.topics()
    for name, field in splits(text):
        if any(topic == name or topic.endswith("/" + name.lstrip("/")) for topic in known):
            return ctx.client.resolve_topic(name, role, ctx.namespace), field
    near = next((name for name, _ in splits(text) if closest(name, known)), text)
    raise UnknownName("topic", near, sorted(known))


def splits(text: str) -> Iterator[tuple[str, str]]:
    """All ways to cut the text into topic and field, the longest topic first; an index belongs to the field."""
    plain = text.partition("[")[0]
    end = len(text) if plain == text else plain.rfind("/")
    while end > 0:
        yield text[:end], text[end + 1 :]
        end = text.rfind("/", 0, end)
