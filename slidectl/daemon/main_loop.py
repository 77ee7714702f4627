"""The daemon: a simulation, a pacer, a server, and one loop that runs them in turn.

It contains no control, no physics and no operations of the wire protocol: only the order of work.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import time
import traceback
from typing import Any

import slidectl
from slidectl.control.node_handle import Message
from slidectl.daemon.daemon_host import DaemonHost, wrapped
from slidectl.daemon.instance_files import InstanceFiles, InstanceInUse
from slidectl.daemon.options import Start
from slidectl.daemon.pacing import Pacer
from slidectl.daemon.server import Server
from slidectl.errors import SlidectlError
from slidectl.event_loop import READ, EventLoop
from slidectl.logfile import LogFile
from slidectl.names import OWN_NODE
from slidectl.operating_system import resident_bytes, set_timer_slack
from slidectl.paths import shown
from slidectl.simulation.loop import FAILED
from slidectl.simulation.simulation import Simulation
from slidectl.simulation.spawned_robots import SpawnedRobot

_TIDY_EVERY_S = 1.0
_LOOK_EVERY_S = 5.0
"""Time between two checks that the files by which clients find this daemon still exist."""
_FIRST_COMMANDS_S = 1.0
"""Compiled code takes 50 ms to load: not in this time, in which the first commands come."""
_YOUNG_OBJECTS = 2000
_PROPERTIES = {"rtf": "speed", "timestep": "timestep", "gravity": "gravity"}
"""The options that describe the world, with their names in the status."""


class Daemon:
    """Created when the lock is held and the socket is bound; `run` returns when it is stopped."""

    def __init__(
        self, start: Start, place: InstanceFiles, listener: socket.socket, log: LogFile, began_s: float
    ) -> None:
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
        self._loop = EventLoop()
        self._host = wrapped(DaemonHost(self._loop, log, self._unexpected), options)
        self.simulation = self._host.simulation or self._new_simulation()
        self.simulation.driven = True
        self.simulation.engine.may_load = False
        self.simulation.run.paused = options.paused
        self.simulation.run.speed = options.rtf
        self.simulation.chosen.update(_PROPERTIES[name] for name in options.chosen if name in _PROPERTIES)
        self._host.reports.append(self._status)
        graph = self.simulation.graph
        self.simulation.features.log_broken()
        graph.services.advertise("/slidectl/shutdown", "slidectl/Shutdown", OWN_NODE, self._shut_down)
        self._pacer = Pacer(self.simulation.loop, clients_wait=self._loop.is_ready)
        self._server = Server(listener, self._loop, graph, self._unexpected, self.simulation.run)
        for severity, text in self._host.begin(self._server.publications, self._unexpected):
            log.write(severity, text)
        self._server.recorder = self._host.recorder
        self._watch_signals()

    def _new_simulation(self) -> Simulation:
        try:
            return Simulation(**self._start.options.of_simulation(), host=self._host)
        except SlidectlError:
            self._host.abandon()
            raise

    def run(self) -> None:
        """Loop until stopped: run due cycles, send what they published, then serve the sockets and send answers."""
        set_timer_slack(1)  # otherwise the kernel delays our waits by 50 µs to save power
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
        """Hold the world and log, after an internal error in a cycle, instead of ending the daemon."""
        self._unexpected(FAILED)
        self.simulation.run.hold(f"{FAILED}, see the log", FAILED)
        self.simulation.graph.log("fatal", OWN_NODE, f"{FAILED}; the simulation is paused, see the log")
        return 0.0

    def _tidy(self) -> None:
        """Do regular work, such as collecting garbage: the automatic collector is off, as it could run at any time."""
        now = time.monotonic()
        self._next_tidy_s = now + _TIDY_EVERY_S
        self.simulation.engine.may_load = now - self._began_s > _FIRST_COMMANDS_S
        self._collect_garbage()
        self._server.tidy()
        if now >= self._next_look_s:
            self._next_look_s = now + _LOOK_EVERY_S
            self._repair_files()
        given_up = self._pacer.given_up_s
        if given_up > max(self._given_up_s + 1.0, 2.0 * self._given_up_s):  # less and less often, to keep the log short
            self._given_up_s = given_up
            self._log.write("warn", f"slower than requested: {given_up:.0f} s of wall time lost so far")

    def _repair_files(self) -> None:
        """Create deleted files again (cleaners of temporary folders delete them); end if another daemon replaced us."""
        try:
            gone, listener = self._place.repair()
        except InstanceInUse as error:
            self._stopping = f"stopped: {error.message}"
            return
        except (SlidectlError, OSError) as error:  # it may be deleted while it is created again
            if str(error) != self._place_trouble:
                self._log.write("error", f"clients cannot find this daemon any more: {error}")
            self._place_trouble = str(error)
            return
        self._place_trouble = ""
        if listener is not None:
            self._server.listen_on(listener)
        if gone:
            self._log.reopen()
            self._log.write("warn", f"deleted by another program, created again: {' and '.join(gone)}")

    def _collect_garbage(self) -> None:
        """Collect garbage. Lasting objects are not scanned: with 100 robots this would block the world for 20 ms.

        All objects are scanned when a robot was deleted, or when there are twice as many as at the last full scan.
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

    # --- end of the daemon --------------------------------------------------------------------------------------

    def _watch_signals(self) -> None:
        """Receive signals as bytes in a pipe, to handle them between two cycles. Until now they were blocked."""
        self._signals, write_end = os.pipe()
        for end in (self._signals, write_end):
            os.set_blocking(end, False)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT, *([signal.SIGHUP] if self._start.foreground else [])):
            signal.signal(number, lambda *_: None)
        self._loop.watch(self._signals, READ, self._read_signals)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGTERM, signal.SIGINT))

    def _read_signals(self, _: int) -> None:
        for number in os.read(self._signals, 64):
            if number != signal.SIGALRM:  # that of TimeLimit, which has its own handler
                self._stopping = f"stopped by {signal.Signals(number).name}"

    def _shut_down(self, _: Message) -> Message:
        self._stopping = "asked to stop"
        return {"success": True, "message": f"process {os.getpid()} stops"}

    def _end(self) -> None:
        self._log.write("info", self._stopping)
        self._host.close(self._stopping)
        self._server.close(f"the daemon was {self._stopping}")
        self._loop.close()

    # --- log and status -----------------------------------------------------------------------------------------

    def _unexpected(self, what: str) -> None:
        self._log.write("fatal", f"{what}\n{traceback.format_exc()}")

    def _status(self) -> dict[str, Any]:
        """The daemon's part of /slidectl/status."""
        return {
            "version": slidectl.__version__,
            "pid": os.getpid(),
            "instance": shown(self._start.paths.name),
            "connections": len(self._server.connections),
            "memory": resident_bytes(),
            "uptime": time.monotonic() - self._began_s,
            "log": shown(str(self._start.paths.log)),
            **self._pacer.report(),
        }
