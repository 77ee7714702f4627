"""Programs as nodes: started as by roslaunch, their output shown, watched, respawned.

They are ended with SIGINT, later SIGTERM, then SIGKILL; each signal goes to the program and everything it has started.
`rostopic`, `rosservice` and `rosparam` are commands of slidectl, and so is the page in a browser.
"""

from __future__ import annotations

import errno
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

from slidectl import input_files
from slidectl.errors import Refused
from slidectl.extensions.launch.plan import LaunchPlan, Location, Node
from slidectl.extensions.launch.task import Run, Task
from slidectl.open_page import address_of
from slidectl.paths import with_package
from slidectl.supervision import Child

_RESPAWN_PAUSE_S = 0.1
"""The least time between two starts, as in roslaunch, which checks ten times a second."""
_SHORT_LIFE_S = 5.0
_FIRST_BACK_OFF_S = 1.0
_LONGEST_BACK_OFF_S = 30.0
"""The longest pause for a program that keeps ending soon after its start; the pause begins at 1 s and doubles."""
_LONGEST_FIRST_LINE = 256
_STOP_WAIT_S = 0.5
"""How long `stop` waits for the end of one process before the next one is stopped."""
_POLL_S = 0.1
"""The polling interval while waiting for a program's end, so that another Ctrl-C is noticed."""


class Process(Task):
    """A node that is a child process."""

    family = "process"
    needs_presence = True
    _serial: ClassVar[int] = 0

    def __init__(self, node: Node, plan: LaunchPlan, program: Sequence[str]) -> None:
        super().__init__(node, plan)
        self.executable = [*node.launch_prefix, *program]
        self.child: Child | None = None
        self.on_end: Callable[[Process, int], None] | None = None
        """Called when it has ended and is not respawned; set by the execution."""
        self.ending = False
        """True when it is being ended, so that its end is not reported and it is not respawned."""
        self._label = node.full_name.lstrip("/")
        self.sessions: set[int] = set()
        """Its session ids, one for each start."""
        self.started_at = 0.0
        """Last start on the monotonic clock, s."""
        self._short_lives = 0
        """How many times in a row it ended soon after its start."""
        self._last_code: int | None = None

    @property
    def command(self) -> list[str]:
        """The whole command line, with remaps and name in the form of ROS programs."""
        remaps = [f"{remap.source}:={remap.target}" for remap in self.node.remaps]
        return [*self.executable, *self.node.words, *remaps, f"__name:={self.node.name}"]

    def _to_run(self, log: Path) -> list[str]:
        """The command line, with the log that programs of ROS write."""
        return [*self.command, f"__log:={log}"]

    @property
    def text(self) -> str:
        return f"run {shlex.join(self.command)}"

    def start(self, run: Run) -> str | None:
        self._begin(run)
        return None

    def _begin(self, run: Run) -> None:
        Process._serial += 1
        folder = os.environ.get("ROS_LOG_DIR") or run.folder
        os.makedirs(folder, mode=0o700, exist_ok=True)
        path = os.path.join(folder, f"{self._label.replace('/', '-')}-{Process._serial}")
        log = subprocess.PIPE
        if (run.options.output or self.node.output) == "log":
            self.settled(run, f"its standard output goes to {path}-stdout.log", log=f"{path}-stdout.log")
            log = os.open(f"{path}-stdout.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        try:
            with run.interrupts.held():
                self.child = Child(
                    self._to_run(Path(f"{path}.log")),
                    run.watch,
                    lambda stream, line: run.console.output(self._label, stream, line),
                    lambda code: self._ended(run, code),
                    self._folder(),
                    self._environment(run),
                    log,
                )
        except OSError as error:
            missing = str(error.filename or self.command[0])
            hint = f"command: {shlex.join(self.command)}"
            raise Refused(f"cannot run {missing}: {_why(error, missing)}", hint) from None
        finally:
            if log != subprocess.PIPE:
                os.close(log)
        self.started_at = time.monotonic()
        self.sessions.add(self.child.pid)  # a child is the leader of its own session
        self.settled(run, f"started, process {self.child.pid}", pid=self.child.pid)

    def _folder(self) -> str | None:
        """The working folder: with `cwd="node"` that of the executable, else ROS_HOME if it exists, else None."""
        if self.node.cwd == "node":
            return str(Path(self.executable[0]).absolute().parent)
        home = os.environ.get("ROS_HOME") or os.path.expanduser("~/.ros")
        return home if os.path.isdir(home) else None

    def _environment(self, run: Run) -> dict[str, str]:
        """Our environment, the namespace, variables for the daemon, those of the launch file. Python is unbuffered."""
        ours = {"PYTHONUNBUFFERED": "1", **os.environ, "ROS_NAMESPACE": self.node.namespace}
        if self.node.namespace == "/":
            del ours["ROS_NAMESPACE"]
        return {**ours, **run.environment, **dict(self.node.environment)}

    # --- its end ------------------------------------------------------------------------------------------------

    def _ended(self, run: Run, code: int) -> None:
        if self.ending:
            return
        self._last_code = code
        if code:
            self.warn(run, f"died: {reason(code)}")
        else:
            self.settled(run, "finished")
        if self.node.respawn:
            run.watch.later(self._respawn_pause(run), lambda: self._again(run))
        elif self.on_end is not None:
            self.on_end(self, code)

    def _respawn_pause(self, run: Run) -> float:
        """The time until the next start, s: the node's delay, or longer if it keeps ending soon after its start."""
        lived = time.monotonic() - self.started_at
        self._short_lives = self._short_lives + 1 if lived < _SHORT_LIFE_S else 0
        asked = max(0.0, self.node.respawn_delay_s, _RESPAWN_PAUSE_S - lived)
        if self._short_lives < 2:
            return asked
        back_off = min(_LONGEST_BACK_OFF_S, _FIRST_BACK_OFF_S * 2.0 ** min(self._short_lives - 2, 10))
        if back_off > asked:
            times = f"ended {self._short_lives} times in a row within {_SHORT_LIFE_S:g} s of its start"
            self.warn(run, f"{times}: it is started again in {back_off:g} s instead of at once")
        return max(asked, back_off)

    def _again(self, run: Run) -> None:
        if self.ending or self.child is None:
            return
        with run.interrupts.held():
            self.child.release()
            self.child = None
        try:
            self._begin(run)
        except Refused as error:
            self.warn(run, f"{error.message}; it is not started again")
            if self.on_end is not None:
                self.on_end(self, 1)

    @property
    def code(self) -> int | None:
        """The exit code of a program that has ended, negative for a signal; None while it runs.

        If it ended soon after its start and was respawned, it is the code of that end.
        """
        if self.child is not None and self.child.code is not None:
            return self.child.code
        return self._last_code if self._short_lives else None

    @property
    def is_alive(self) -> bool:
        return self.child is not None and self.child.code is None

    def stop(self, run: Run) -> None:
        """Send SIGINT and wait for a short time; `finish` does the rest."""
        self.ending = True
        if self.is_alive and self.child is not None:
            self.child.signal(signal.SIGINT)
            _until(run, lambda: not self.is_alive, _STOP_WAIT_S)

    def finish(self, run: Run, deadline_s: float, number: int) -> None:
        """Wait until the deadline on the monotonic clock. If the process still runs, warn and send the signal."""
        _until(run, lambda: not self.is_alive, deadline_s - time.monotonic())
        if self.is_alive and self.child is not None:
            self.warn(run, f"does not end; sending {signal.Signals(number).name}")
            self.child.signal(number)

    def release(self) -> None:
        """Kill what is left of it."""
        if self.child is not None:
            self.child.release()
            self.child = None


def _why(error: OSError, program: str) -> str:
    """The system's error text; if the interpreter of a script is missing, also the script's first line."""
    if error.errno not in (errno.ENOENT, errno.ENOEXEC, errno.EACCES) or not os.path.isfile(program):
        return str(error.strerror)
    with input_files.opened(program) as file:
        first = file.readline(_LONGEST_FIRST_LINE).rstrip(b"\n").decode("utf-8", "backslashreplace")
    if not first.startswith("#!"):
        return f"{error.strerror}; a script begins with a line such as #!/usr/bin/env python3"
    return f"{error.strerror}: its first line names a program that does not exist: {first!r}"


def reason(code: int) -> str:
    """How a process ended, as text."""
    return f"by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _until(run: Run, condition: Callable[[], bool], seconds: float) -> None:
    """Run the event loop until the condition holds or the time is over, or a second signal arrives."""
    deadline = time.monotonic() + seconds
    while not condition() and (left := deadline - time.monotonic()) > 0 and len(run.interrupts.received) < 2:
        run.watch.turn(min(left, _POLL_S))


_HOW_OFTEN = re.compile(r"-1|--once|-r.*|--rate(=.*)?|-f.*|--file(=.*)?", re.DOTALL)
"""Options of rostopic pub for rate and number."""


class ToolProcess(Process):
    """A tool of ROS. It starts after all other nodes, so that the nodes it uses are running."""

    family = "tool"
    comes_last = True

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        # -P: a user's file with the name of a library must not be imported instead of it.
        super().__init__(node, plan, [sys.executable, "-P", "-m", "slidectl", "ros", node.type])

    @property
    def command(self) -> list[str]:
        words = self.node.words
        if self.node.type != "rostopic":
            return [*self.executable, *words]
        # Remaps go before the topic: after it `a:=b` may be a text to publish.
        options = [f"{remap.source}:={remap.target}" for remap in self.node.remaps]
        # Latched, so that later nodes get the message, as with roslaunch. A shell command does not latch by default.
        if words[:1] == ["pub"] and not any(map(_HOW_OFTEN.fullmatch, words)):
            options.insert(0, "-l")
        return [*self.executable, *words[:1], *options, *words[1:]]

    @property
    def text(self) -> str:
        return f"run {' '.join([self.node.type, *self.node.words])}"

    def _environment(self, run: Run) -> dict[str, str]:
        return with_package(super()._environment(run))


class OpenPage(Process):
    """`slidectl view` for `--view` and `gui:=true`. When the page is open already, its address is shown."""

    def __init__(self, plan: LaunchPlan, why: str) -> None:
        node = Node("slidectl", "view", "page", "/", Location(why, None), output="screen")
        super().__init__(node, plan, [sys.executable, "-P", "-m", "slidectl", "--quiet", "view"])
        self._is_open_already = False

    @property
    def text(self) -> str:
        return "open the page: slidectl view"

    @property
    def keeps_running(self) -> bool:  # type: ignore[override]
        return not self._is_open_already

    def start(self, run: Run) -> str | None:
        address = address_of(run.client.paths)
        if self.child is None and address is None:
            self._begin(run)
        elif self.child is None:
            self._is_open_already = True
            self.settled(run, f"the page is open already: {address}", url=address)
            return None
        elif not self.is_alive:
            return None
        elif address is not None:
            self.settled(run, f"the page is open: {address}", url=address)
            return None
        return "the page"

    def _to_run(self, log: Path) -> list[str]:  # noqa: ARG002 - it has no log
        return list(self.executable)

    def _environment(self, run: Run) -> dict[str, str]:
        return with_package(super()._environment(run))
