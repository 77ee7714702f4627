"""The source note at the end of an expanded robot: file and line of each element, and the files of its meshes.

It is a processing instruction. With it the daemon, which gets only the expanded text, names the user's file and line in
messages and finds meshes without package paths. Only slidectl's own programs exchange it: some readers of URDF reject
an instruction after the root, and it has paths of this machine. Split it off before a robot is shown or stored. Places
and meshes are in the order of the elements in the text.
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
    """`places` has file and line of each element; `meshes` the files of `<mesh>` elements, by the element's number.

    `folder` is the absolute folder of the model's file, empty for a text.
    """

    places: list[Place]
    meshes: dict[int, str]
    folder: str


def encode(places: Sequence[Place], meshes: Mapping[int, str], folder: str) -> str:
    """The instruction `<?slidectl-source ...?>` on one line."""
    files = list(dict.fromkeys(file for file, _ in places))
    runs: list[list[int]] = []
    for file, line in places:
        index = files.index(file)
        if not runs or runs[-1][0] != index:
            runs.append([index])
        runs[-1].append(line)
    note = {"files": files, "lines": runs, "meshes": list(meshes.items()), "folder": folder}
    data = json.dumps(note, separators=(",", ":"))
    return f"<?{TARGET} {data.replace('>', chr(92) + 'u003e')}?>"


def decode(data: str) -> Note | None:
    """Decode the data of an instruction; None when it is not a valid note."""
    try:
        note = json.loads(data)
        places = [(str(note["files"][run[0]]), int(line)) for run in note["lines"] for line in run[1:]]
        meshes = {int(number): str(file) for number, file in note.get("meshes", ())}
        return Note(places, meshes, str(note.get("folder", "")))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError):
        return None


def split(xml: str) -> tuple[str, str]:
    """The robot without the note, and the note (empty when there is none)."""
    # Only the last line is searched, because both the note and the text may be long.
    start = xml.rfind(f"<?{TARGET} ")
    found = _AT_END.match(xml, start) if start >= 0 else None
    return (xml[:start], found.group().strip()) if found else (xml, "")


def join(xml: str, note: str) -> str:
    """The robot followed by the note."""
    return f"{xml.rstrip()}\n{note}\n" if note else xml


def digest(xml: str) -> str:
    """A checksum of the robot's text, the same with and without the note and outer blanks."""
    return hashlib.sha256(split(xml)[0].strip().encode("utf-8", "surrogatepass")).hexdigest()
