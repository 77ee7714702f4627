"""The note at the end of an expanded robot: where each of its elements was written, and which files its meshes are.

A processing instruction. With it the daemon, which only gets the expanded text, names the user's own file and line in
its messages and finds the meshes without package paths. The text of a robot carries it between our own programs only:
not every reader of URDF takes an instruction behind the root, and it holds paths of this machine. Whoever shows or
stores a robot splits it off first. Places and meshes are in the order of the elements in the text.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

TARGET = "slidectl-source"
_AT_END = re.compile(rf"<\?{TARGET} [^>]*\?>\s*\Z")

Place = tuple[str, int]


class Note(NamedTuple):
    """`places` of all elements; `meshes` are the files of `<mesh>` elements, by the element's number."""

    places: list[Place]
    meshes: dict[int, str]


def encode(places: Sequence[Place], meshes: Mapping[int, str]) -> str:
    """The whole instruction, `<?slidectl-source ...?>`, on one line."""
    files = list(dict.fromkeys(file for file, _ in places))
    runs: list[list[int]] = []
    for file, line in places:
        index = files.index(file)
        if not runs or runs[-1][0] != index:
            runs.append([index])
        runs[-1].append(line)
    note = {"files": files, "lines": runs, "meshes": list(meshes.items())}
    data = json.dumps(note, separators=(",", ":"))
    return f"<?{TARGET} {data.replace('>', chr(92) + 'u003e')}?>"


def decode(data: str) -> Note | None:
    """The note of an instruction's data, or None when it is no note of ours."""
    try:
        note = json.loads(data)
        places = [(str(note["files"][run[0]]), int(line)) for run in note["lines"] for line in run[1:]]
        return Note(places, {int(number): str(file) for number, file in note.get("meshes", ())})
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError):
        return None


def split(xml: str) -> tuple[str, str]:
    """The robot alone, and the instruction behind it (empty when there is none)."""
    # The last line alone is searched: a note may be long, and a text without one longer.
    start = xml.rfind(f"<?{TARGET} ")
    found = _AT_END.match(xml, start) if start >= 0 else None
    return (xml[:start], found.group().strip()) if found else (xml, "")


def join(xml: str, note: str) -> str:
    """The robot with the instruction behind it."""
    return f"{xml.rstrip()}\n{note}\n" if note else xml


def digest(xml: str) -> str:
    """What a robot's text is known by: the same for the text as it stands, printed into a pipe, or stripped."""
    return hashlib.sha256(split(xml)[0].strip().encode("utf-8", "surrogatepass")).hexdigest()
