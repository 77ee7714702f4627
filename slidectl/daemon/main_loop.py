"""The daemon: a simulation, a pacer, a server and one loop that turns between them.

No control and no physics here, and no operations of the wire: only who has its turn when.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import socket
import time
import traceback
from contextlib import suppress
from typing import Any

import slidectl
from slidectl.control import user_classes
from slidectl.control.node_handle import Message
from slidectl.daemon import journal
from slidectl.daemon.journal import Journal
from slidectl.daemon.journal_replay import Replay, other_versions
from slidectl.daemon.mesh_reader import MeshReader
from slidectl.daemon.options import Start
from slidectl.daemon.pacing import Pacer
from slidectl.daemon.picture_queue import PictureQueue
from slidectl.daemon.place import Place, TakenOver
from slidectl.daemon.server import Server
from slidectl.daemon.time_limit import TimeLimit
from slidectl.errors import SlidectlError
from slidectl.event_loop import READ, EventLoop
from slidectl.logfile import LogFile
from slidectl.names import OWN_NODE
from slidectl.paths import shown
from slidectl.simulation.clock import SECOND
from slidectl.simulation.loop import FAILED
from slidectl.simulation.simulation import Simulation
from slidectl.simulation.spawned_robots import SpawnedRobot

_TIDY_EVERY_S = 1.0
_LOOK_EVERY_S = 5.0
"""Between two looks whether the files by which this daemon is found are still there."""
_FIRST_COMMANDS_S = 1.0
"""Compiled code takes 50 ms to load: not while those who have started the daemon send their first commands."""
_YOUNG_OBJECTS = 2000
_PROPERTIES = {"rtf": "speed", "timestep": "timestep", "gravity": "gravity"}
"""The options that say how the world is, by their names in the status."""
_PR_SET_TIMERSLACK = 29


class Daemon:
    """Built when the lock is held and the socket is bound; `run` returns when it is stopped."""

    def __init__(self, start: Start, place: Place, listener: socket.socket, log: LogFile, began_s: float) -> None:
        self._start = start
        self._place = place
        self._place_trouble = ""
        self._next_look_s = time.monotonic() + _LOOK_EVERY_S
        self._log = log
        self._began_s = began_s
        self._stopping = ""
        self._next_tidy_s = 0.0
        self._given_up_s = 0.0
        self._kept_robots: frozenset[SpawnedRobot] = frozenset()
        self._most_kept_objects = 0
        options = start.options
        replay = Replay(journal.read(options.replay), options.until) if options.replay else None
        self._journal: Journal | None = None
        self.simulation = self._new_simulation() if replay is None else replay.simulation
        self.simulation.driven = True
        self.simulation.engine.may_load = False
        self.simulation.run.paused = options.paused
        self.simulation.run.speed = options.rtf
        self.simulation.chosen.update(_PROPERTIES[name] for name in options.chosen if name in _PROPERTIES)
        self.simulation.monitor = self._status
        graph = self.simulation.graph
        graph.log.sink = self._keep_line
        graph.services.advertise("/slidectl/shutdown", "slidectl/Shutdown", OWN_NODE, self._shut_down)
        self._loop = EventLoop()
        self._pacer = Pacer(self.simulation.loop, clients_wait=self._loop.is_ready)
        self._server = Server(listener, self._loop, graph, self._unexpected, self.simulation.run)
        self._mesh_reader = MeshReader(self._loop, self._unexpected)
        self._pictures = PictureQueue(self._loop, self.simulation.world)
        if replay is not None:
            self._replay(replay)
        self.simulation.read_meshes = self._mesh_reader.read
        self.simulation.render = self._pictures.render
        if self._journal is not None:
            self._journal.watch(self.simulation)
            self._server.journal = self._journal
        self._watch_signals()

    def _new_simulation(self) -> Simulation:
        options = self._start.options
        limit = user_classes.limit = TimeLimit()
        if options.journal:  # the files that are imported are its first entries
            self._journal = Journal(options)
            limit.on_end = self._journal.took_too_long
        try:
            return Simulation(options.timestep, options.gravity, options.ground, options.engine, options.imports)
        except SlidectlError:
            if self._journal is not None:  # the next start may have the name
                os.unlink(options.journal)
            raise

    def _replay(self, replay: Replay) -> None:
        """Begin with the world to which a journal leads."""
        self.simulation.engine.may_load = True
        replay.run(self._unexpected, self._server.publications)
        self.simulation.pause()
        user_classes.limit = TimeLimit()
        path = replay.contents.path
        self._log.write("info", f"replayed {path} up to {self.simulation.time_ns / SECOND:.3f} s; paused")
        for trouble in [replay.differs, *other_versions(replay.contents)]:
            if trouble:
                self._log.write("warn", f"{path}: {trouble}")

    def run(self) -> None:
        """Turn until stopped: the cycles that are due and what they published, then the sockets and what they asked."""
        with suppress(OSError, AttributeError):  # the kernel would round our waits up by 50 µs, for the sake of power
            ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
        self._log.write("info", f"slidectl {slidectl.__version__} answers on {shown(self._start.paths.socket_text)}")
        turn, server = self._pacer.turn, self._server
        fresh = server.publications.fresh
        while not self._stopping:
            try:
                wait_s = turn()
            except Exception:
                wait_s = self._hold()
            if server.with_output or server.with_messages or fresh:
                server.flush()
            if time.monotonic() >= self._next_tidy_s:
                self._tidy()
            self._loop.poll(server.wait(_TIDY_EVERY_S if wait_s is None else wait_s))
            if server.with_input:
                server.serve()
            if server.with_output or server.with_messages or fresh:
                server.flush()
        self._end()

    def _hold(self) -> float:
        """A fault of ours in a cycle holds the world and is told, instead of ending it."""
        self._unexpected(FAILED)
        self.simulation.run.hold(f"{FAILED}, see the log", FAILED)
        self.simulation.graph.log("fatal", OWN_NODE, f"{FAILED}; the simulation is paused, see the log")
        return 0.0

    def _tidy(self) -> None:
        """Now and then: collect garbage (the process runs without the collector, which would choose any moment)."""
        now = time.monotonic()
        self._next_tidy_s = now + _TIDY_EVERY_S
        self.simulation.engine.may_load = now - self._began_s > _FIRST_COMMANDS_S
        self._collect_garbage()
        self._server.tidy()
        if now >= self._next_look_s:
            self._next_look_s = now + _LOOK_EVERY_S
            self._look_after_place()
        given_up = self._pacer.given_up_s
        if given_up > max(self._given_up_s + 1.0, 2.0 * self._given_up_s):  # ever rarer, or it would fill the log
            self._given_up_s = given_up
            self._log.write("warn", f"slower than asked: {given_up:.0f} s of wall time given up so far")

    def _look_after_place(self) -> None:
        """What cleaners of temporary folders have deleted is made again; where another daemon is now, this one ends."""
        try:
            gone, listener = self._place.mend()
        except TakenOver as error:
            self._stopping = f"stopped: {error.message}"
            return
        except (SlidectlError, OSError) as error:  # it may be deleted while it is made again
            if str(error) != self._place_trouble:
                self._log.write("error", f"nobody can find this daemon any more: {error}")
            self._place_trouble = str(error)
            return
        self._place_trouble = ""
        if listener is not None:
            self._server.listen_on(listener)
        if gone:
            self._log.reopen()
            self._log.write("warn", f"somebody deleted {' and '.join(gone)}; made again")

    def _collect_garbage(self) -> None:
        """What stays is not looked through: with a hundred robots that would hold up the world for 20 ms.

        All is looked through when a robot has gone, or when twice as much stays as the last time.
        """
        robots = frozenset(self.simulation.robots)
        deleted, added = self._kept_robots - robots, robots - self._kept_robots
        self._kept_robots = robots
        if added:
            self._most_kept_objects = max(self._most_kept_objects, 2 * gc.get_freeze_count())
        elif gc.get_count()[0] > _YOUNG_OBJECTS:
            gc.collect()
        elif not deleted:
            return
        gc.freeze()
        if deleted or gc.get_freeze_count() > self._most_kept_objects:
            gc.unfreeze()
            gc.collect()
            gc.freeze()
            self._most_kept_objects = 2 * gc.get_freeze_count()

    # --- ends ---------------------------------------------------------------------------------------------------

    def _watch_signals(self) -> None:
        """Signals arrive as bytes in a pipe, so that they too are served between two cycles. Until now they waited."""
        self._signals, write_end = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT, *([signal.SIGHUP] if self._start.foreground else [])):
            signal.signal(number, lambda *_: None)
        self._loop.watch(self._signals, READ, self._take_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGTERM, signal.SIGINT))

    def _take_signal(self, _: int) -> None:
        for number in os.read(self._signals, 64):
            if number != signal.SIGALRM:  # that of TimeLimit, which was taken when it came
                self._stopping = f"stopped by {signal.Signals(number).name}"

    def _shut_down(self, _: Message) -> Message:
        self._stopping = "asked to stop"
        return {"success": True, "message": f"process {os.getpid()} stops"}

    def _end(self) -> None:
        self._log.write("info", self._stopping)
        if self._journal is not None:
            self._journal.close(self._stopping)
        self._mesh_reader.close()
        self._pictures.close()
        self._server.close(f"the daemon was {self._stopping}")
        self._loop.close()

    # --- what is told -------------------------------------------------------------------------------------------

    def _keep_line(self, severity: str, node: str, text: str, time_ns: int) -> None:
        self._log.write(severity, f"[{time_ns * 1e-9:.3f}] {node}: {text}")

    def _unexpected(self, what: str) -> None:
        self._log.write("fatal", f"{what}\n{traceback.format_exc()}")

    def _status(self) -> dict[str, Any]:
        """The daemon's part of /slidectl/status."""
        return {
            "version": slidectl.__version__,
            "pid": os.getpid(),
            "instance": shown(self._start.paths.name),
            "connections": len(self._server.connections),
            "memory": _resident_bytes(),
            "uptime": time.monotonic() - self._began_s,
            "log": shown(str(self._start.paths.log)),
            "journal": "" if self._journal is None else shown(self._journal.path),
            "journal_trouble": "" if self._journal is None else self._journal.trouble,
            **self._pacer.report(),
        }


def _resident_bytes() -> int:
    with open("/proc/self/statm", encoding="ascii") as statm:
        return int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
