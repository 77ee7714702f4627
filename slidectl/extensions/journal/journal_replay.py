"""The replay of a journal: the same world again, without clients and as fast as possible, with the same bits.

Sessions get the recorded lines, each after the cycle in which it came; their answers are discarded. Results of file
reads, and their times, come from the journal.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

from slidectl import names
from slidectl.control.duration import from_seconds
from slidectl.control.user_modules import UserModule
from slidectl.daemon import time_limit
from slidectl.daemon.options import DaemonOptions
from slidectl.daemon.outbox import Outbox, Publications
from slidectl.daemon.session import Session
from slidectl.daemon.time_limit import TimeLimit
from slidectl.description.sensors import Camera
from slidectl.errors import BadFile, Refused, SlidectlError
from slidectl.extensions.journal import journal
from slidectl.extensions.journal.journal import Contents, invalid_entry, mesh_of
from slidectl.physics import World
from slidectl.physics.hulls import MeshSource
from slidectl.physics.rendering import PictureRequest, RenderProcess
from slidectl.rotations import Pose
from slidectl.simulation.clock import NEVER, SECOND
from slidectl.simulation.host import Host, HostWrapper
from slidectl.simulation.loop import FAILED
from slidectl.simulation.pending import Pending
from slidectl.simulation.simulation import Simulation

_UNREPEATABLE = "user code that reads the wall time, random numbers or other files is not repeatable"
_LONGEST_GAP_NS = 2 * SECOND
"""The most simulated time without an entry. There is one for each second, so that no number lets a replay run on."""
_CONSUMED_ENTRIES = frozenset(("limit", "module"))
"""Entries that are not handled as input, but consumed when the world reaches them."""


class ReplayDiffers(Refused):
    """The replay does not match the recorded run."""


class Replay(HostWrapper):
    """One replay. `differs` describes the first difference from a state in the journal; empty without one.

    It is the host of the world that it makes. Until the end of `run` it answers from the journal, then from the host
    that it is around.
    """

    simulation: Simulation

    def __init__(self, contents: Contents, until: float | None = None, host: Host | None = None) -> None:
        """The replay ends at the simulated time `until`, s; entries of the cycle of that time are included.

        `host` is that of the world afterwards, by default the one of a plain script.
        """
        super().__init__(host or Host())
        self.contents = contents
        self._is_over = False
        self.differs = ""
        self.states = 0
        """The number of compared states."""
        self.after_entry: Callable[[], None] = lambda: None
        """Called after each handled entry of the journal."""
        self._until_ns = NEVER if until is None else from_seconds(until)
        self._at = 0
        """Index of the entry that is being handled."""
        self.consumed = 0
        """The number of consumed entries of the journal: the index of the next."""
        self._limit = self.inner.limit if isinstance(self.inner.limit, TimeLimit) else TimeLimit()
        self._limit.on_end.append(self._consume_limit)
        self.limit = self._limit
        self._sessions: dict[int, Session] = {}
        self._last_client = 0
        self._meshes: list[tuple[set[MeshSource], Pending]] = []
        """Open requests for meshes."""
        self._own_renderer = RenderProcess()
        self._pictures: deque[tuple[Pending, PictureRequest]] = deque()
        self._state = -1, b""
        """The cycle of the last whole second, and the numbers of the world at that time."""
        self._unexpected: Callable[[str], None] = lambda _: None
        self.given = {}
        for number, entry in enumerate(contents.entries, 2):
            if "module" in entry:
                try:
                    module = UserModule(*entry["module"])
                    self.given[module.name] = module
                except TypeError as error:
                    raise invalid_entry(str(error), contents.path, number) from None
        self._set_limit()
        options = contents.options
        try:
            simulation = Simulation(**options.of_simulation(), host=self)
        except BaseException as error:
            self._end()
            if isinstance(error, SlidectlError) and getattr(error, "file", None) is None:  # a module is missing
                raise BadFile(error.message, contents.path, 1, hint=error.hint) from error
            raise
        simulation.driven = True
        simulation.run.paused = options.paused
        simulation.run.speed = options.rtf

    def _end(self) -> None:
        """Leave the world to the host that this one is around."""
        self._is_over = True
        self._own_renderer.close()
        self._limit.on_end.remove(self._consume_limit)
        self._limit.close()
        self._limit.most_s = time_limit.LIMIT_S if self._limit is self.inner.limit else math.inf
        self.given = {}

    def begin(self, publications: Publications, unexpected: Callable[[str], None]) -> Iterable[tuple[str, str]]:
        """Run, for a daemon that goes on with the final world."""
        simulation, path = self.simulation, self.contents.path
        simulation.engine.may_load = True
        self.run(unexpected, publications)
        simulation.pause()
        yield "info", f"replayed {path} up to {simulation.time_ns / SECOND:.3f} s; paused"
        for trouble in [self.differs, *other_versions(self.contents)]:
            if trouble:
                yield "warn", f"{path}: {trouble}"

    def run(
        self, unexpected: Callable[[str], None], publications: Publications | None = None, check: bool = False
    ) -> None:
        """Run to the end of the journal, or to the requested time. Then all clients are disconnected.

        `unexpected` logs the exception that is being handled; `publications` are those of a world that goes on. With
        `check` it ends at the first state that differs.

        Raises:
            ReplayDiffers: an entry does not fit this world; with `check` also a state that differs.
            Refused: the journal ends before the requested time.
        """
        self._publications, self._unexpected = publications or Publications(), unexpected
        states = self.simulation.graph.timers.every(SECOND, self._keep_state)
        try:
            is_there = self._run(check)
            for session in list(self._sessions.values()):
                session.closed()
        finally:
            states.cancel()
            self._end()
        now_ns = self.simulation.time_ns
        if not is_there and now_ns < self._until_ns < NEVER:
            raise Refused(f"the journal ends at {now_ns / SECOND:g} s, before {self._until_ns / SECOND:g} s")

    def _run(self, check: bool) -> bool:
        """Run the entries. Returns True when the requested time came before the end."""
        entries = self.contents.entries
        while True:
            self._at = self.consumed
            while self._at < len(entries) and not _CONSUMED_ENTRIES.isdisjoint(entries[self._at]):
                self._at += 1
            if self._at == len(entries):
                return False
            if not self._step_to(entries[self._at]["cycle"]):
                return True
            if self.consumed != self._at:
                self._fail("user code that took too long in the journal does not now")
            self._advance()
            try:
                self._carry_out(entries[self._at])
            except (TypeError, ValueError, LookupError, zlib.error) as error:
                raise invalid_entry(repr(error), self.contents.path, self._at + 2) from error
            self.after_entry()
            if self.differs and check:
                raise ReplayDiffers(self.differs, _UNREPEATABLE)

    def _step_to(self, cycle: int) -> bool:
        """Run the cycles up to that one. Returns False when the requested time comes first."""
        simulation, run = self.simulation, self.simulation.run
        if cycle - simulation.cycles > _LONGEST_GAP_NS // simulation.timestep_ns:
            text = f"its cycle {cycle} is more than 2 s after the cycle before it, {simulation.cycles}"
            raise invalid_entry(text, self.contents.path, self._at + 2)
        while (left := cycle - simulation.cycles) > 0:
            allowed = min(left, (self._until_ns - simulation.time_ns) // simulation.timestep_ns)
            if allowed <= 0:
                return False
            trouble, done = run.trouble, 0
            try:
                done = simulation.step(allowed)
            except Exception:
                self._unexpected(FAILED)
                run.hold(f"{FAILED}, see the log", FAILED)
            if not done or run.trouble != trouble:
                break
        if simulation.cycles > cycle:
            self._fail(f"the world is already at cycle {simulation.cycles}")
        if simulation.cycles != cycle:
            self._fail(f"the world is at cycle {simulation.cycles} now{run.trouble and f': {run.trouble}'}")
        return True

    def _carry_out(self, entry: dict[str, Any]) -> None:
        """Handle one entry, in its cycle. Its reads are the next entries, and are consumed meanwhile."""
        if "line" in entry:
            self._session(entry["client"]).handle(entry["line"])
        elif "client" in entry:
            if entry["client"] <= self._last_client:
                self._fail(f"there was a client {entry['client']} before")
            if not names.is_legal(entry["node"]):
                raise ValueError(f"{entry['node']!r} is not the name of a node")
            self._last_client = entry["client"]
            self._sessions[entry["client"]] = Session(
                _DiscardingReader(self._publications),
                self.simulation.graph,
                self._publications,
                self._unexpected,
                entry["node"],
                0,
            )
        elif "gone" in entry:
            self._session(entry["gone"]).closed()
            del self._sessions[entry["gone"]]
        elif "meshes" in entry:
            self._resolve_meshes(entry["meshes"])
        elif "let_go" in entry:
            lockstep = self.simulation.features["lockstep"]
            members = lockstep.members
            if entry["let_go"] not in members:
                self._fail(f"{entry['let_go']} is not in lock-step now")
            lockstep.let_go(members[entry["let_go"]])
        elif "picture" in entry:
            self._resolve_picture(entry["picture"])
        elif "state" in entry:
            self._compare(entry)
        else:
            self._fail("the world did not ask for the next entry of the journal")

    def _session(self, number: int) -> Session:
        if number not in self._sessions:
            self._fail(f"there is no client {number}")
        return self._sessions[number]

    def _advance(self) -> None:
        self.consumed += 1
        self._set_limit()

    def _set_limit(self) -> None:
        """Set the limit: users' code must end where it was ended in the run, and only there, on any machine."""
        while self._peek("module"):
            self.consumed += 1
        is_limited = self._peek("limit")
        self._limit.most_s = time_limit.LIMIT_S if is_limited else math.inf

    def _peek(self, kind: str) -> bool:
        entries = self.contents.entries
        return self.consumed < len(entries) and kind in entries[self.consumed]

    def _fail(self, why: str) -> NoReturn:
        cycle = self.contents.entries[self._at]["cycle"] if self.contents.entries else 0
        raise ReplayDiffers(f"{self.contents.path}:{self._at + 2}: in cycle {cycle}: {why}", _UNREPEATABLE)

    # --- external input -----------------------------------------------------------------------------------------

    def read(self, what: str, look: Callable[[], Any]) -> Any:
        if self._is_over or self.consumed == len(self.contents.entries):  # it may have been cut off before this read
            return super().read(what, look)
        entry = self.contents.entries[self.consumed]
        if entry.get("read") != what:
            self._fail(f"the world reads the {what} now, but did not in the journal")
        self._advance()
        return entry["found"]

    def read_meshes(self, sources: Sequence[MeshSource]) -> Pending:
        if self._is_over:
            return super().read_meshes(sources)
        pending = Pending()
        self._meshes.append((set(sources), pending))
        return pending

    def _resolve_meshes(self, entries: list[dict[str, Any]]) -> None:
        hulls = dict(map(mesh_of, entries))
        request = next((one for one in self._meshes if not one[1].done and one[0] == set(hulls)), None)
        if request is None:
            self._fail("nothing waits for these meshes now")
        self._meshes.remove(request)
        request[1].resolve(hulls)

    def render(self, world: World, camera: Camera, pose: Pose, seed: int) -> Pending:
        if self._is_over:
            return super().render(world, camera, pose, seed)
        pending = Pending()
        self._pictures.append((pending, self._own_renderer.request(world, camera, pose, seed)))
        return pending

    def _resolve_picture(self, error: str) -> None:
        """Resolve a picture, which is rendered only for users' code: there are no clients."""
        if not self._pictures:
            self._fail("no camera waits for a picture now")
        pending, request = self._pictures.popleft()
        topics, clients = self.simulation.graph.topics, {session.node for session in self._sessions.values()}
        pictures = (topic for topic, kind in topics.types().items() if kind == journal.PICTURE)
        if error:
            pending.reject(Refused(error))
        elif any(node not in clients for topic in pictures for node in topics.subscribers(topic)):
            self._own_renderer.start(request)
            pending.resolve(self._own_renderer.receive())
        else:
            pending.resolve("")

    def _consume_limit(self) -> None:
        if self._peek("limit"):
            self._advance()

    # --- the state ----------------------------------------------------------------------------------------------

    def _keep_state(self) -> None:
        self._state = self.simulation.cycles, self.simulation.world.numbers()

    def _compare(self, entry: dict[str, Any]) -> None:
        if "end" in entry:
            self._keep_state()
        self.states += 1
        cycle, here = self._state
        there = base64.b64decode(entry["state"])
        if self.differs or (cycle, here) == (entry["cycle"], there):
            return
        at = f"the state differs at {self.simulation.time_ns / SECOND:g} s (cycle {entry['cycle']})"
        if cycle != entry["cycle"] or len(here) != len(there):
            self.differs = f"{at}: there are {len(here) // 8} numbers now, and {len(there) // 8} in the journal"
            return
        names = self.simulation.world.number_names()
        pairs = list(zip(names, memoryview(here).cast("d"), memoryview(there).cast("d"), strict=True))
        # Compare the bits: -0.0 differs from 0.0, and NaN is equal to the same NaN.
        others = [pair for at, pair in enumerate(pairs) if here[8 * at : 8 * at + 8] != there[8 * at : 8 * at + 8]]
        name, now, then = others[0]
        more = f", and {len(others) - 1} numbers more" if others[1:] else ""
        self.differs = f"{at}: {name} is {now!r} now and {then!r} in the journal{more}"


class _DiscardingReader:
    """The reader of a client that is not connected."""

    unread = 0
    is_overfull = False
    node = "nobody"

    def __init__(self, publications: Publications) -> None:
        self.outbox = Outbox(lambda *_: b"", publications)

    def send(self, line: bytes) -> None:
        """Discard the line."""

    def check_end(self) -> None:
        """Do nothing: the journal has the time of the disconnect."""


def host_of(host: Host, options: DaemonOptions) -> Host:
    """The replay that the options of a daemon ask for, around its host. Raises as journal.read and Replay."""
    return Replay(journal.read(options.replay), options.until, host)


def other_versions(contents: Contents) -> list[str]:
    """Versions that differ from the recorded ones, as texts: the bits may depend on them."""
    here = journal.written_by()
    return [
        f"{name} {value or 'none'} then, {here.get(name, 'none')} now"
        for name, value in contents.written_by.items()
        if value != here.get(name, "")
    ]
