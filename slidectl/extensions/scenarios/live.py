"""Runs cases in a live daemon, one after the other. The world is empty, at time 0, before and after each.

The daemon stands still, except while a step waits: then it runs to the cycle in which the result comes. So commands
take effect at the same simulated times as in a world of this process, whatever their latency.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, ClassVar

from slidectl import paths
from slidectl.client import Client
from slidectl.client.link import SocketLink
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.extensions.scenarios.background import BackgroundStep
from slidectl.extensions.scenarios.case_run import Stage
from slidectl.extensions.scenarios.scenario_file import Case
from slidectl.extensions.scenarios.stages import LOG_LINES
from slidectl.extensions.scenarios.step_commands import Commands
from slidectl.wire.json_lines import encode

_ANSWER_S = 60.0
"""Wall seconds for an answer that needs no simulated time."""
_LONGEST_SLICE = 10_000
"""The most cycles of one slice, after which messages are checked: each check is a round trip."""
_CYCLES = 10
"""As _LONGEST_SLICE, when messages with callbacks do not end a slice, or programs run by wall time."""
_LEVELS = {1: "debug", 2: "info", 4: "warn", 8: "error", 16: "fatal"}


class Live:
    """Runs all cases in one daemon, found by its socket."""

    has_journals: ClassVar[bool] = False

    def __init__(self, socket: str) -> None:
        self._socket = socket
        self._holder: Client | None = None

    def warm(self, commands: Commands, cases: Sequence[Case]) -> None:
        """Do nothing: the daemon has the world."""

    def hold(self, cases: Sequence[Case]) -> None:
        """Stop the daemon's own cycles until this process ends. Raises NoDaemon, Refused: cases cannot run in it."""
        client = self._holder = Client(socket=self._socket)
        client.call("/slidectl/step", {"news": True})
        status = client.call("/slidectl/status")
        if len(status["holders"]) > 1:
            raise Refused("another 'slidectl test' runs in this daemon", "wait for its end, or use another daemon: -i")
        _check_empty(status)
        for case in cases:
            wanted = case.world.get("timestep", status["timestep"])
            if abs(wanted - status["timestep"]) > 1e-12:
                raise Refused(
                    f"{case.id} needs a time step of {wanted:g} s, and the daemon has {status['timestep']:g} s",
                    f"slidectl daemon start --timestep {wanted:g}",
                )

    @contextmanager
    def of(self, case: Case, journal: str = "") -> Iterator[Stage]:  # noqa: ARG002
        with Client(socket=self._socket) as keeper:
            before = set(keeper.params.names())
            faults, snapshots = _names(keeper.faults()), _names(keeper.snapshots())
            status = keeper.call("/slidectl/status")
            _check_empty(status)
            was_paused = status["paused"]
            keeper.call("/gazebo/pause_physics")
            keeper.call("/gazebo/reset_simulation")
            physics = keeper.call("/gazebo/get_physics_properties")
            if "gravity" in case.world:
                _set_physics(keeper, physics | {"gravity": dict(zip("xyz", case.world["gravity"], strict=True))})
            try:
                status = keeper.call("/slidectl/status")
                pace = status["speed"] if any(step.starts_programs for step in case.steps) else 0.0
                clock = _CycleClock(status["timestep"], pace)
                link = _SteppedLink(paths.instance(None, self._socket), time.monotonic() + _ANSWER_S, clock)
                with Client(link=link, timeout=_ANSWER_S) as client:
                    link.hold()
                    if not case.world.get("paused"):
                        keeper.call("/gazebo/unpause_physics")
                    yield _LiveStage(client, clock)
            finally:
                keeper.call("/gazebo/pause_physics")
                for robot in keeper.robots():
                    keeper.delete(robot["name"])
                if new := _names(keeper.faults()) - faults:
                    keeper.remove_faults(*new)
                if new := _names(keeper.snapshots()) - snapshots:
                    keeper.call("/slidectl/delete_snapshots", {"names": list(new)})
                for name in set(keeper.params.names()) - before:
                    with suppress(SlidectlError):  # it was deleted together with one above it
                        keeper.call("/rosapi/delete_param", {"name": name})
                _set_physics(keeper, physics)  # world files of launches change it too
                keeper.call("/gazebo/reset_simulation")
                if not was_paused:
                    keeper.call("/gazebo/unpause_physics")


def _check_empty(status: Mapping[str, Any]) -> None:
    """Raise Refused when the world has robots: they would be deleted with those of the case."""
    if status["robots"]:
        raise Refused(
            f"the daemon holds robots: {', '.join(status['robots'])}",
            f"a scenario begins with an empty world: slidectl delete {' '.join(status['robots'])}, or another -i",
        )


def _names(listed: Sequence[Mapping[str, Any]]) -> set[str]:
    return {one["name"] for one in listed}


def _set_physics(client: Client, physics: Mapping[str, Any]) -> None:
    request = {key: physics[key] for key in ("time_step", "max_update_rate", "gravity", "ode_config")}
    client.call("/gazebo/set_physics_properties", request)


class _CycleClock:
    """The simulated time that waits have used up, in s; at `end_s` waits end with TimedOut.

    `waiting` has the links with a callback, which is called when something is received or at a time of this clock.
    """

    def __init__(self, timestep_s: float, pace: float) -> None:
        self.now_s = 0.0
        self.end_s: float | None = None
        self.timestep_s = timestep_s
        self.waiting: dict[_SteppedLink, tuple[Callable[[], object], float]] = {}
        self.has_callbacks = False
        self._pace = pace
        """Simulated seconds per wall second, if programs take part; 0: as fast as possible."""
        self._ahead_since_s = time.monotonic()

    def call_due(self, asker: _SteppedLink) -> bool:
        """Call the due callbacks, except that of `asker`. Returns True if any was due."""
        ready = [link for link in list(self.waiting) if link is not asker and link.is_ready(self.waiting[link][1])]
        for link in ready:
            if link in self.waiting:  # an earlier callback may have ended it
                self.waiting[link][0]()
        return bool(ready)

    def cycles(self, deadline: float) -> int:
        """The number of cycles before the next check for messages."""
        most = _CYCLES if self.has_callbacks or self._pace else _LONGEST_SLICE
        left_s = min([deadline, *(due_s for _, due_s in self.waiting.values())]) - self.now_s
        return most if left_s >= most * self.timestep_s else max(1, math.ceil(left_s / self.timestep_s))

    def went_on(self, cycles: int) -> None:
        """Advance by this number of cycles; if programs take part, wait for the wall time too."""
        self.now_s += cycles * self.timestep_s
        if self._pace:
            self._ahead_since_s = max(self._ahead_since_s + cycles * self.timestep_s / self._pace, time.monotonic())
            time.sleep(self._ahead_since_s - time.monotonic() if self._ahead_since_s > time.monotonic() else 0.0)


class _SteppedLink(SocketLink):
    """A connection whose waits run the world until something is received. Deadlines are in time of the cycle clock."""

    def __init__(self, instance: paths.InstancePaths, deadline: float, clock: _CycleClock) -> None:
        super().__init__(instance, deadline)
        self.clock = clock
        self._serial = itertools.count()
        self._came: deque[dict[str, Any]] = deque()
        self._world_s = 0.0
        """Simulated time of the world at the last check, s."""

    def another(self, deadline: float) -> _SteppedLink:  # noqa: ARG002 - the deadline is not in machine time
        return _SteppedLink(self.paths, time.monotonic() + _ANSWER_S, self.clock)

    def monotonic(self) -> float:
        return self.clock.now_s

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """Set or remove a function to call between two slices when something was received."""
        if action is None:
            self.clock.waiting.pop(self, None)
        else:
            self.clock.waiting[self] = action, math.inf
            self.clock.has_callbacks = True
        return True

    def is_ready(self, due_s: float) -> bool:
        """True when something was received, or the time is due."""
        self.fetch()
        return bool(self._came) or due_s <= self.clock.now_s

    def send(self, line: bytes, deadline: float) -> None:  # noqa: ARG002 - the deadline is not in machine time
        super().send(line, time.monotonic() + _ANSWER_S)

    def receive(self, deadline: float) -> dict[str, Any] | None:
        if not self._came:
            self.fetch()
        while not self._came and self.clock.now_s < deadline:
            self.go_on(deadline)
        return self._came.popleft() if self._came else None

    def fetch(self) -> None:
        """Store the messages so far: the daemon sends them before its answer."""
        time = self._ask("/rosapi/get_time", {})["time"]
        self._world_s = time["secs"] + time["nsecs"] * 1e-9

    def go_on(self, deadline: float) -> None:
        """Let due callbacks run; if there are none, run the world to the earliest deadline."""
        clock = self.clock
        if clock.call_due(self):
            self.fetch()
            return
        cycles = clock.cycles(deadline)
        if clock.end_s is not None:
            left = round((clock.end_s - self._world_s) / clock.timestep_s)
            if left <= 0:
                raise TimedOut(f"the simulated time is up: {self._world_s:g} s")
            cycles = min(cycles, left)
        answer = self._ask("/slidectl/step", {"cycles": cycles, "news": True})
        if not answer["success"]:
            raise Refused(answer["message"])
        done = round((float(answer["time"]) - self._world_s) / clock.timestep_s)
        self._world_s = float(answer["time"])
        if done or self._came:
            clock.went_on(done)
        else:  # it is paused, so nothing can be received until the deadline
            clock.now_s = min([deadline, *(due_s for _, due_s in clock.waiting.values())])

    def hold(self) -> None:
        """From now on the world runs only while this connection or another one of the case waits."""
        self._ask("/slidectl/step", {"news": True})

    def _ask(self, service: str, request: dict[str, Any]) -> dict[str, Any]:
        """Call a service. Messages received before its answer are stored."""
        call_id = f"stage:{next(self._serial)}"
        super().send(
            encode({"op": "call_service", "id": call_id, "service": service, "args": request}),
            time.monotonic() + _ANSWER_S,
        )
        while (message := super().receive(time.monotonic() + _ANSWER_S)) is not None:
            if message.get("id") == call_id:
                return dict(message["values"])
            self._came.append(message)
        raise NoDaemon(f"the daemon does not answer within {_ANSWER_S:g} s")

    def close(self) -> None:
        self.clock.waiting.pop(self, None)
        super().close()


class _BackgroundLink(_SteppedLink):
    """A stepped link that lets the other steps run while it waits."""

    def __init__(self, clock: _CycleClock, instance: paths.InstancePaths, step: BackgroundStep) -> None:
        super().__init__(instance, time.monotonic() + _ANSWER_S, clock)
        self._step = step

    def call_back(self, action: Callable[[], object] | None) -> bool:  # noqa: ARG002
        """Do nothing: the step runs anyway when something is received."""
        return True

    def switch_when_due(self, switch: Callable[[], None], due_s: float) -> None:
        """Set `switch` to be called when something is received, or at a time of its clock."""
        self.clock.waiting[self] = switch, due_s

    def leave(self) -> None:
        """Cancel the call of `switch`."""
        self.clock.waiting.pop(self, None)

    def go_on(self, deadline: float) -> None:
        if self._step.is_ending:
            super().go_on(deadline)
        else:
            self._step.wait(deadline)
            self.fetch()


class _LiveStage(Stage):
    def __init__(self, client: Client, clock: _CycleClock) -> None:
        self.client = client
        self._clock = clock
        self._lines: deque[str] = deque(maxlen=LOG_LINES)
        client.subscribe("/rosout", "rosgraph_msgs/Log", take=self._add_line)

    def _add_line(self, published: dict[str, Any]) -> None:
        line, stamp = published["msg"], published["msg"]["header"]["stamp"]
        level = _LEVELS.get(line["level"], str(line["level"]))
        self._lines.append(f"{level:<5} [{stamp['secs'] + stamp['nsecs'] * 1e-9:.3f}] {line['name']}: {line['msg']}")

    def now_s(self) -> float:
        return float(self.client.call("/slidectl/status")["time"])

    def limit(self, seconds: float | None) -> None:
        self._clock.end_s = None if seconds is None else self.now_s() + max(0.0, seconds)

    def begin(self, run: Callable[[Client], None]) -> Any:
        return BackgroundStep(partial(_BackgroundLink, self._clock, self.client.paths), run, self.client.timeout)

    def log(self) -> list[str]:
        with suppress(SlidectlError):
            self.client.flush()  # handles received messages
        return list(self._lines)
