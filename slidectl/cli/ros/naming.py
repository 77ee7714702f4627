"""Names on the command line of a ROS tool: ROS_NAMESPACE, private names, and remapping arguments; and waiting.

Exact, as there: the unique end of a name is not enough.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from time import monotonic

from slidectl import names
from slidectl.cli.context import Context

HOST = "localhost"
"""Where everything runs: on this machine, behind one socket."""

_REMAPPING = re.compile(r"[A-Za-z0-9_~/]+:=")
_NODE_ARGUMENT = re.compile(r"__(name|ns|log|ip|hostname|master):=")


def resolve(ctx: Context, name: str, tool: str) -> str:
    """The absolute name: below ROS_NAMESPACE (or `--ns`), and there below the tool's own name for `~private`."""
    namespace = os.environ.get("ROS_NAMESPACE") or ctx.namespace
    if name.startswith("~"):
        return names.join(names.join(namespace, tool), name[1:])
    return names.join(namespace, name)


def without_remappings(words: Sequence[str], payload_from: int | None = None) -> list[str]:
    """The words without `from:=to`, `_parameter:=value` and `__name:=name`.

    From the positional number `payload_from` on only `__name:=` and its like go: `a:=b` may be a text to publish.
    """
    return _parted(words, payload_from)[0]


def resolve_remapped(ctx: Context, name: str, tool: str, words: Sequence[str], payload_from: int | None = None) -> str:
    """`resolve`, and then as the last `from:=to` renames it: for a tool that publishes, as a node does."""
    full = resolve(ctx, name, tool)
    pairs = [word.split(":=", 1) for word in _parted(words, payload_from)[1] if not word.startswith("_")]
    renamed = {resolve(ctx, source, tool): resolve(ctx, target, tool) for source, target in pairs if target}
    return renamed.get(full, full)


def _parted(words: Sequence[str], payload_from: int | None) -> tuple[list[str], list[str]]:
    """The words for the tool, and those that rename."""
    kept: list[str] = []
    taken: list[str] = []
    positionals = 0
    for word in words:
        is_payload = payload_from is not None and positionals >= payload_from
        if (_NODE_ARGUMENT if is_payload else _REMAPPING).match(word):
            taken.append(word)
            continue
        positionals += not word.startswith("-")
        kept.append(word)
    return kept, taken


def pause(ctx: Context, seconds: float) -> None:
    """Wait, but notice at once when the daemon goes away."""
    deadline = monotonic() + seconds
    while (left := deadline - monotonic()) > 0:
        next(ctx.client.events(left), None)
