"""A launch on the command line: what it says on a terminal or in a pipe, its daemon, and the way into the background.

The work is done by slidectl.launch; this is its mouth and its hands.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NoReturn

from slidectl.cli import detached, output
from slidectl.cli.context import DEFAULT_TIMEOUT_S, Context, paint
from slidectl.client import Client
from slidectl.client.link import command
from slidectl.errors import EXIT_DONE, Refused, TimedOut
from slidectl.launch.interrupts import SIGNALS
from slidectl.paths import InstancePaths, make_private

if TYPE_CHECKING:
    from slidectl.daemon.lifecycle import Beginning
    from slidectl.launch.world import WorldSettings

START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0
WAIT_LIMIT_S = 60.0
_LOOK_EVERY_S = 0.05
_CLEAR = "\r\x1b[K"
# What the child process of a detached launch tells its parent.
_ALONE = b"a"
_RUNS = b"r"


class Terminal:
    """What a run says: a line for each step; on a terminal also one at the bottom that changes."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.verbose = context.verbose
        both = output.is_terminal(sys.stdout) and output.is_terminal(sys.stderr)
        self.is_live = both and context.format == "text" and not context.quiet
        self._status = ""
        self._unheard = False
        self._closing = False

    def step(self, event: str, text: str, **details: Any) -> None:
        self._under_status(lambda: self.context.done({"event": event, "text": text, **details}, text))

    def warn(self, text: str) -> None:
        self._under_status(lambda: self.context.warn(text))

    def output(self, node: str, stream: str, line: str) -> None:
        if self.context.format != "text":
            record = {"event": "output", "node": node, "stream": stream, "line": line}
            self._under_status(lambda: self.context.emit(record))
        elif stream == "stdout":
            self._under_status(lambda: output.write(f"[{node}] {line}"))
        else:
            self._under_status(lambda: print(f"[{node}] {line}", file=sys.stderr, flush=True))

    def status(self, text: str) -> None:
        if self.is_live and (text or self._status):
            self._status = text[: max(10, output.terminal_width() - 1)]
            self._say(lambda: self._draw(self._status))

    def closing(self) -> None:
        self._closing = True
        self.status("")

    def _under_status(self, action: Callable[[], None]) -> None:
        """Say it above the status."""

        def say() -> None:
            if self._status:
                self._draw("")
            action()
            if self._status:
                self._draw(self._status)

        self._say(say)

    def _say(self, action: Callable[[], None]) -> None:
        """A reader, terminal or disk that takes no more ends the launch once. What ends a launch needs no audience."""
        if self._unheard:
            return
        try:
            action()
        except (output.ClosedPipe, Refused, OSError) as error:
            self._unheard = True
            if self._closing:
                return
            if isinstance(error, BrokenPipeError):
                raise output.ClosedPipe from None
            raise

    def _draw(self, text: str) -> None:
        sys.stderr.write(_CLEAR + (paint(text, "cyan") if text else ""))
        sys.stderr.flush()


class Daemon:
    """The door of a launch to the daemon of this command line. With `child`, one that is begun here dies with us."""

    def __init__(self, context: Context, child: bool, wait: bool) -> None:
        self.context = context
        self.child = child
        self.must_run = wait
        self._beginning: Beginning | None = None

    def begin(self, settings: WorldSettings) -> bool:
        from slidectl.daemon import lifecycle

        if self.must_run:
            return False
        from slidectl.daemon.options import DaemonOptions

        paths = self.context.paths
        runs_already = lifecycle.running(paths) is not None

        usual = DaemonOptions()
        options = DaemonOptions(
            rtf=usual.rtf if settings.speed is None else settings.speed,
            paused=settings.paused,
            timestep=usual.timestep if settings.timestep is None else settings.timestep,
            gravity=usual.gravity if settings.gravity is None else settings.gravity,
            ground=usual.ground if settings.ground is None else settings.ground,
            child=self.child,
        )
        self._beginning = lifecycle.Beginning(paths, options)
        return not runs_already

    def connect(self) -> tuple[Client, bool]:
        if self.must_run:
            self._wait_for_one()
        is_ours = False
        if self._beginning is not None:
            pid, already = self._beginning.wait(self.context.wait_limit(START_LIMIT_S))
            is_ours = not already
            if is_ours:
                self.context.detail(f"daemon {self.context.paths.name}: started, process {pid}")
            else:
                self._beginning = None
        limit = self.context.wait_limit(DEFAULT_TIMEOUT_S)
        return Client(socket=self.context.paths.socket_text, timeout=limit), is_ours

    def _wait_for_one(self) -> None:
        """`--wait`: nobody tells of a daemon that begins, so look now and then."""
        from slidectl.daemon import lifecycle

        limit = self.context.wait_limit(WAIT_LIMIT_S)
        deadline = time.monotonic() + limit
        if lifecycle.running(self.context.paths) is None:
            self.context.say("no daemon runs yet: waiting for one")
        while lifecycle.running(self.context.paths) is None:
            if time.monotonic() >= deadline:
                hint = "start it with: " + command(self.context.paths, "daemon start")
                raise TimedOut(f"no daemon within {limit:g} s", hint)
            select.select([], [], [], _LOOK_EVERY_S)
        # It holds the lock before it answers; a start waits for the answer.
        lifecycle.start(self.context.paths, timeout=max(1.0, deadline - time.monotonic()))

    def stop(self) -> None:
        from slidectl.daemon import lifecycle

        if self._beginning is not None:
            self._beginning.abandon()
            lifecycle.stop(self.context.paths, STOP_LIMIT_S)
            self.context.detail(f"daemon {self.context.paths.name}: stopped")


class Background:
    """The launch goes on in a child process; this one waits until everything runs, and leaves.

    Raises:
        Refused: the folder for its log is not private.
    """

    def __init__(self, paths: InstancePaths) -> None:
        make_private(paths.folder)
        self.log = str(detached.log_of(paths, os.getpid()))
        self._paths = paths
        self._read, self._write = os.pipe()

    def fork(self) -> None:
        """Returns in the child. The parent ends as the child says: with 0 when everything runs, else with its code.

        A signal reaches the child once, by the parent: what a terminal sends goes to both only until the child has
        left the terminal's group, and what came to the child until then is dropped before the parent passes it on.

        Raises:
            Refused: the child was killed. In the parent.
        """
        sys.stdout.flush()
        sys.stderr.flush()
        held = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        child = os.fork()
        if child == 0:
            os.close(self._read)
            os.setsid()
            while signal.sigtimedwait(SIGNALS, 0) is not None:
                pass
            os.write(self._write, _ALONE)
        else:
            os.close(self._write)
            self._pass_on_signals(child)
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
        if child != 0:
            self._follow(child)

    def _pass_on_signals(self, child: int) -> None:
        """Once the child is alone. When it has ended there is nobody to pass them on to."""
        process = os.pidfd_open(child)

        def pass_on(number: int, _frame: object) -> None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(process, number)

        os.read(self._read, len(_ALONE))
        for number in SIGNALS:
            signal.signal(number, pass_on)

    def _follow(self, child: int) -> NoReturn:
        from slidectl.cli import leave

        if os.read(self._read, len(_RUNS)):
            leave(EXIT_DONE)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code < 0:
            raise Refused(
                f"the launch was ended by {signal.Signals(-code).name} before everything ran",
                "a daemon that it started may still run; stop it with: " + command(self._paths, "daemon stop"),
            )
        leave(code)

    def everything_runs(self) -> None:
        """Let the parent go; from now on the launch is nobody's child, and writes into its log."""
        log = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        detached.hold(log)
        null = os.open(os.devnull, os.O_RDONLY)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for source, target in ((null, 0), (log, 1), (log, 2)):
            os.dup2(source, target)
        os.write(self._write, _RUNS)
        os.close(self._write)
