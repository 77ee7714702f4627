"""The note at the end of an expanded robot that says where each of its elements was written.

A processing instruction, which every XML reader skips. With it the daemon, which only gets the expanded text, names
the user's own file and line in its messages. Places are those of all elements in the order of the text.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

TARGET = "slidectl-source"

Places = list[tuple[str, int]]


def encode(places: Sequence[tuple[str, int]]) -> str:
    """The whole instruction, `<?slidectl-source ...?>`, on one line."""
    files = list(dict.fromkeys(file for file, _ in places))
    runs: list[list[int]] = []
    for file, line in places:
        index = files.index(file)
        if not runs or runs[-1][0] != index:
            runs.append([index])
        runs[-1].append(line)
    data = json.dumps({"files": files, "lines": runs}, separators=(",", ":"))
    return f"<?{TARGET} {data.replace('>', chr(92) + 'u003e')}?>"


def decode(data: str) -> Places | None:
    """The places of a note's data, or None when it is no note of ours."""
    try:
        note = json.loads(data)
        return [(str(note["files"][run[0]]), int(line)) for run in note["lines"] for line in run[1:]]
    except (ValueError, LookupError, TypeError, RecursionError, OverflowError):
        return None
