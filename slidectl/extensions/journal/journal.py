"""The journal: all external input of a world, each entry with the cycle after which it took effect, in one file.

This module writes and reads it; journal_replay.py runs the same world from it again. The writer is a host around that
of the world, so it hears of all that comes from outside. Each entry is a line of JSON that ends with a checksum. It is
written to the kernel at once, so it survives any end of the daemon. See docs/journal.md.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import platform
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, BinaryIO

import slidectl
from slidectl import input_files
from slidectl.control.node_handle import Message
from slidectl.control.user_modules import UserModule
from slidectl.daemon.options import DaemonOptions
from slidectl.description.meshes import BadMesh
from slidectl.description.sensors import Camera
from slidectl.effects import Effect
from slidectl.errors import BadFile, Refused, UsageError, cut, listing
from slidectl.names import OWN_NODE
from slidectl.paths import shown
from slidectl.physics import World
from slidectl.physics.hulls import Hull, Hulls, MeshSource, hull_of
from slidectl.rotations import Pose
from slidectl.simulation.clock import NEVER, SECOND
from slidectl.simulation.host import Host, HostWrapper
from slidectl.simulation.pending import Pending
from slidectl.writing import CannotWrite, hint, reason

if TYPE_CHECKING:
    from slidectl.daemon.session import Session
    from slidectl.simulation import Simulation

FORMAT = 1
LARGEST = 2**30
"""The most bytes of a journal that is replayed: its entries are in memory."""
_LONGEST_HEADER = 2**20
_LARGEST_HULL = 2**22
"""Bytes. A surface of the most pieces takes half of it."""
_LIBRARIES = ("mujoco", "numpy", "numba")
PICTURE = "sensor_msgs/Image"
_PROCESS_OPTIONS = ("child", "journal", "replay", "until")
"""Options of a daemon that do not describe its world."""
_LARGEST_WHOLE = 2**63


def _is_number(value: Any) -> bool:
    return type(value) is float or (type(value) is int and abs(value) < _LARGEST_WHOLE)


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_list(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and all(map(fits, value))


_OPTIONS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "rtf": (_is_number, "a number"),
    "paused": (_is_flag, "true or false"),
    "timestep": (_is_number, "a number"),
    "gravity": (_is_list(_is_number), "a list of numbers"),
    "ground": (_is_flag, "true or false"),
    "strict": (_is_flag, "true or false"),
    "engine": (_is_text, "a text"),
    "chosen": (_is_list(_is_text), "a list of texts"),
    "imports": (_is_list(_is_text), "a list of texts"),
}
"""For each option of a world: a check of its type, and the type in words."""
_SHUTDOWN = "/slidectl/shutdown"
_LINE = re.compile(rb'\{"cycle":(\d{1,20}),"client":(\d{1,20}),"line":(.*)\Z', re.DOTALL)
_CHECKSUM = re.compile(rb'(.*),"crc":"([0-9a-f]{8})"\}\Z', re.DOTALL)


class Journal(HostWrapper):
    """Writes the journal of one world, from before its first cycle on: a host that records what another one gives.

    Give it to the Simulation as its host; imported modules are a part of the journal.
    """

    def __init__(self, options: DaemonOptions, host: Host | None = None) -> None:
        """Create the file that the options name. `host` is that of a plain script by default.

        Raises Refused: the file exists, or it cannot be written.
        """
        super().__init__(host or Host())
        self.path = path = options.journal
        self.trouble = ""
        """The reason why writing has ended, else empty."""
        self._hint: str | None = None
        self._clients: dict[Session, int] = {}
        """The numbers of connected clients that have sent something."""
        self._clients_so_far = 0
        self._size = 0
        options.check_journal()
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise CannotWrite(path, error, "the journal") from None
        chosen = {name: value for name, value in asdict(options).items() if name not in _PROCESS_OPTIONS}
        self._write(_text({"slidectl_journal": FORMAT, **written_by(), "options": chosen}))
        if self.trouble:
            os.unlink(path)
            raise Refused(f"cannot write the journal {path}: {self.trouble}", self._hint)
        self.recorder = self
        self.limit.on_end.append(self._note_limit)
        self.reports.append(lambda: {"journal": shown(path), "journal_trouble": self.trouble})

    def attach(self, simulation: Simulation) -> None:
        super().attach(simulation)
        self._states = simulation.graph.timers.every(SECOND, self._note_state)

    def abandon(self) -> None:
        """Remove the file: the next start may use its name."""
        os.unlink(self.path)
        super().abandon()

    def close(self, why: str) -> None:
        """Write the end of the world, and close the file."""
        if self.simulation is not None:
            self._states.cancel()
            self._note_state(b',"end":%b' % json.dumps(why).encode())
        if not self.trouble:
            os.close(self._file)
        self.trouble = "it is closed"
        self.limit.on_end.remove(self._note_limit)
        super().close(why)

    # --- external input -----------------------------------------------------------------------------------------

    def record(self, session: Session, line: bytes, message: Message) -> None:
        """Record a line of a client, before it is handled."""
        if not self._matters(message):
            return
        number = self._clients.get(session)
        if number is None:
            self._clients_so_far += 1
            number = self._clients[session] = self._clients_so_far
            self._note("client", number, node=session.node)
        # Record the line as it came; but the file must be UTF-8.
        is_plain = line[:1] == b"{" and line[1:2] != b"\0"
        text = line.strip() if is_plain else json.dumps(message).encode()
        self._write(b'{"cycle":%d,"client":%d,"line":%b' % (self._cycle, number, text))

    def _matters(self, message: Message) -> bool:
        """True when the line can change the world."""
        operation, topic = message["op"], str(message.get("topic"))
        if operation in ("subscribe", "unsubscribe"):
            # Pictures: a camera skips some while it renders one for a client.
            topics = self.simulation.graph.topics if self.simulation is not None else None
            return PICTURE in (message.get("type"), topics and topics.exists(topic) and topics.type_of(topic))
        return operation != "set_level" and not (
            operation == "call_service" and self._only_reads(str(message.get("service")))
        )

    def _only_reads(self, service: str) -> bool:
        """True for a call that changes nothing, as its service has said, or only ends the run.

        Calls of clients' services matter: their answers are recorded.
        """
        services = self.simulation.graph.services if self.simulation is not None else None
        if services is None or not services.exists(service):
            return False
        if service == _SHUTDOWN:
            return True
        is_of_client = services.node_of(service) in {session.node for session in self._clients}
        return services.effects_of(service) == [Effect.READS] and not is_of_client

    def record_end(self, session: Session) -> None:
        """Record that a client has disconnected."""
        number = self._clients.pop(session, None)
        if number is not None:
            self._note("gone", number)

    def read(self, what: str, look: Callable[[], Any]) -> Any:
        found = super().read(what, look)
        self._note("read", what, found=found)
        return found

    def imported(self, module: UserModule) -> None:
        super().imported(module)
        self._note("module", module)

    def read_meshes(self, sources: Sequence[MeshSource]) -> Pending:
        return super().read_meshes(sources).converted(self._note_meshes)

    def render(self, world: World, camera: Camera, pose: Pose, seed: int) -> Pending:
        return super().render(world, camera, pose, seed).then(self._note_picture)

    def let_go(self, node: str) -> None:
        super().let_go(node)
        self._note("let_go", node)

    def _note_limit(self) -> None:
        """Record that users' code was ended by the limit of wall time."""
        self._note("limit", "")

    def _note_meshes(self, done: Pending) -> Hulls:
        """Record meshes at the time when the world gets them."""
        read: Hulls = done.result()
        self._note("meshes", [mesh_entry(source, hull) for source, hull in read.items()])
        return read

    # --- the file -----------------------------------------------------------------------------------------------

    @property
    def _cycle(self) -> int:
        return 0 if self.simulation is None else self.simulation.cycles

    def _note(self, kind: str, value: Any, **more: Any) -> None:
        self._write(_text({"cycle": self._cycle, kind: value, **more}))

    def _note_picture(self, done: Pending) -> None:
        """Record that the oldest requested picture is done."""
        self._note("picture", str(done.error or ""))

    def _note_state(self, more: bytes = b"") -> None:
        """Record the state of the world's joints and the efforts on them, to the bit."""
        assert self.simulation is not None
        numbers = binascii.b2a_base64(self.simulation.world.numbers(), newline=False)
        self._write(b'{"cycle":%d%b,"state":"%b"' % (self._cycle, more, numbers))

    def _write(self, entry: bytes) -> None:
        """Write one entry, whole or not at all. `entry` lacks its closing brace. After a failure nothing is written."""
        if self.trouble:
            return
        line = b'%b,"crc":"%08x"}\n' % (entry, zlib.crc32(entry))
        try:
            written = os.write(self._file, line)
            if written < len(line):
                os.write(self._file, line[written:])  # raises with the reason
            self._size += len(line)
        except OSError as error:
            self.trouble, self._hint = reason(error, self.path), hint(error, self.path)
            with suppress(OSError):
                os.ftruncate(self._file, self._size)
            os.close(self._file)
            if self.simulation is not None:
                text = f"the journal {self.path} ends at cycle {self._cycle}: {self.trouble}"
                self.simulation.graph.log("error", OWN_NODE, text)


def host_of(host: Host, options: DaemonOptions) -> Host:
    """The journal that the options of a daemon ask for, around its host. Raises as Journal."""
    return Journal(options, host)


def _text(entry: dict[str, Any]) -> bytes:
    """JSON without the closing brace."""
    return json.dumps(entry, separators=(",", ":"))[:-1].encode()


def written_by() -> dict[str, str]:
    """The versions on which the bits may depend."""
    versions = {"version": slidectl.__version__, "machine": platform.machine(), "python": platform.python_version()}
    for library in _LIBRARIES:
        with suppress(PackageNotFoundError):
            versions[library] = version(library)
    return versions


# --- reading ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contents:
    """The contents of a journal, up to its last whole entry."""

    path: str
    options: DaemonOptions
    written_by: dict[str, str]
    entries: list[dict[str, Any]]
    """In a client's entry, `line` is the received bytes."""
    is_cut: bool
    """True when the last entry is not whole."""


def read(path: str) -> Contents:
    """Read a journal.

    Raises:
        BadFile: not a regular file, larger than LARGEST, not a journal, of another format, damaged before its end, or
            with an invalid entry; it names the line.
    """
    with input_files.opened(path, LARGEST) as file:
        try:
            return _contents(path, file)
        except OSError as error:
            raise BadFile(f"cannot be read: {error.strerror}", path) from None


def _contents(path: str, file: BinaryIO) -> Contents:
    first = file.readline(_LONGEST_HEADER)
    if not first:
        raise BadFile("it is empty: the daemon ended before it wrote anything", path)
    is_journal = first.startswith(b'{"slidectl_journal"')
    if is_journal and not first.endswith(b"\n") and len(first) < _LONGEST_HEADER:
        raise BadFile("it is cut off in its first line", path)
    body = _checked(first) if is_journal else None
    if body is None:
        raise BadFile(
            "it is not a journal of slidectl", path, hint="one is written by: slidectl daemon start --journal FILE"
        )
    header = _json(body, path, 1)
    if header["slidectl_journal"] != FORMAT:
        text = f"it is of format {cut(str(header['slidectl_journal']), 60)}, written by slidectl {_version(header)}"
        raise BadFile(f"{text}; this is {slidectl.__version__}, which reads format {FORMAT}", path)
    options = _options(path, header)
    versions = {name: cut(str(header.get(name, "")), 60) for name in written_by()}
    entries: list[dict[str, Any]] = []
    damaged = 0
    """The number of the line that is not whole, 0 if all are."""
    for number, line in enumerate(file, 2):
        if damaged:
            hint = f"the entries before it can be replayed: head -n {damaged - 1} {path} > part.journal"
            raise BadFile("this entry is damaged: checksum mismatch", path, damaged, hint)
        body = _checked(line)
        if body is None or not line.endswith(b"\n"):
            damaged = number
        else:
            entries.append(_entry(body, path, number))
    return Contents(path, options, versions, entries, bool(damaged))


def _checked(line: bytes) -> bytes | None:
    """The part of a line that its checksum is of; None when it is not whole."""
    match = _CHECKSUM.match(line.removesuffix(b"\n"))
    return None if match is None or zlib.crc32(match[1]) != int(match[2], 16) else match[1]


def _entry(body: bytes, path: str, number: int) -> dict[str, Any]:
    """The entry in a line. Raises BadFile unless its cycle is a number; the replay checks the other fields."""
    of_client = _LINE.match(body)
    if of_client is None:
        entry = _json(body, path, number)
    else:
        entry = {"cycle": int(of_client[1]), "client": int(of_client[2]), "line": of_client[3]}
    cycle = entry.get("cycle")
    if type(cycle) is not int or not 0 <= cycle < NEVER:
        raise invalid_entry("'cycle' is not the number of a cycle", path, number)
    return entry


def _json(body: bytes, path: str, number: int) -> dict[str, Any]:
    try:
        entry: dict[str, Any] = json.loads(body + b"}")
    except (RecursionError, ValueError) as error:
        raise invalid_entry(str(error), path, number) from None
    return entry


def invalid_entry(why: str, path: str, number: int) -> BadFile:
    """The error for an entry whose checksum is right, but whose content is not valid."""
    return BadFile(f"invalid entry: {why}", path, number)


def _options(path: str, header: dict[str, Any]) -> DaemonOptions:
    options = header.get("options")
    if not isinstance(options, dict):
        raise BadFile("it has no options of the world", path, 1)
    if unknown := options.keys() - _OPTIONS.keys():
        text = f"slidectl {_version(header)} wrote it with options that {slidectl.__version__} does not know"
        raise BadFile(f"{text}: {listing(unknown)}", path, 1)
    for name, value in options.items():
        fits, expected = _OPTIONS[name]
        if not fits(value):
            raise BadFile(f"its options are not valid: {name} must be {expected}", path, 1)
    try:
        return DaemonOptions.read(options)
    except UsageError as error:
        raise BadFile(f"its options are not valid: {error}", path, 1) from None


def _version(header: dict[str, Any]) -> str:
    return cut(str(header.get("version")), 60)


# --- meshes -----------------------------------------------------------------------------------------------------------


def mesh_entry(source: MeshSource, hull: Hull | BadMesh) -> dict[str, Any]:
    """One of the `meshes` of an entry."""
    entry: dict[str, Any] = {"path": source.path, "scale": list(source.scale)}
    if source.is_surface:
        entry["surface"] = True
    if isinstance(hull, BadMesh):
        return {**entry, "bad": hull.reason}
    return {**entry, "name": hull.name, "hull": base64.b64encode(zlib.compress(hull.stl)).decode()}


def mesh_of(entry: Mapping[str, Any]) -> tuple[MeshSource, Hull | BadMesh]:
    """The mesh in a `mesh_entry`. Raises ValueError, LookupError, TypeError, zlib.error: it is none."""
    x, y, z = map(float, entry["scale"])
    source = MeshSource(entry["path"], (x, y, z), entry.get("surface") is True)
    if "bad" in entry:
        return source, BadMesh(entry["bad"], source.path)
    hull = hull_of(zlib.decompressobj().decompress(base64.b64decode(entry["hull"]), _LARGEST_HULL))
    if hull.name != entry["name"]:
        raise ValueError(f"the hull of {source.path} is cut off, too large, or has another name than its content")
    return source, hull
