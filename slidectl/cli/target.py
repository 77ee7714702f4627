"""`TOPIC/field[i]` on the command line: the ways to cut it into a topic and a field.

Only text; which topic is meant is for topics, what the field means is for fieldpath and the daemon.
"""

from __future__ import annotations

from collections.abc import Iterator


def splits(text: str) -> Iterator[tuple[str, str]]:
    """All ways to cut the text into topic and field, the longest topic first; an index belongs to the field."""
    plain = text.partition("[")[0]
    end = len(text) if plain == text else plain.rfind("/")
    while end > 0:
        yield text[:end], text[end + 1 :]
        end = text.rfind("/", 0, end)
