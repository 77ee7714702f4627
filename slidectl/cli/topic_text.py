"""What `rostopic list -v` and `rostopic info` print, for every command that prints it. Only text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slidectl.cli.topics import PUBLISHERS, SUBSCRIBERS

Users = Mapping[str, Sequence[str]]
"""Topic -> nodes."""


def usage_of_topics(types: Mapping[str, str], publishers: Users | None, subscribers: Users | None) -> str:
    """The two sections of `list -v`, topics in the order of `types`; None leaves a section out."""
    parts = []
    if publishers is not None:
        parts.append(_section("Published topics:", types, publishers, PUBLISHERS))
    if subscribers is not None:
        parts.append(_section("Subscribed topics:", types, subscribers, SUBSCRIBERS))
    return "\n" + "\n".join(parts) + "\n"


def _section(title: str, types: Mapping[str, str], users: Users, role: str) -> str:
    lines = [title]
    for topic, kind in types.items():
        count = len(users[topic])
        if count:
            lines.append(f" * {topic} [{kind}] {count} {role if count > 1 else role[:-1]}")
    return "\n".join(lines) + "\n"


def details(kind: str, publishers: Sequence[str], subscribers: Sequence[str], uri: str) -> str:
    """What `info` prints; `uri` is where the nodes answer."""
    blocks = [_nodes("Publishers", publishers, uri), _nodes("Subscribers", subscribers, uri)]
    return f"Type: {kind}\n\n" + "\n".join(blocks) + "\n\n"


def _nodes(title: str, nodes: Sequence[str], uri: str) -> str:
    return f"{title}: \n" + "".join(f" * {node} ({uri})\n" for node in nodes) if nodes else f"{title}: None\n"
