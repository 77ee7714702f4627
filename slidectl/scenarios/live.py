"""Cases in a live daemon, one after the other. It begins and ends with an empty world at time 0.

The daemon is paused, and goes on some cycles at a time while a step waits for something: so commands take effect at
the simulated times at which they do in a world of this process, up to those cycles, however long they are on the way.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from slidectl import paths
from slidectl.client import Client
from slidectl.client.lines import encode
from slidectl.client.link import SocketLink
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.scenarios.case_run import Stage
from slidectl.scenarios.scenario_file import Case
from slidectl.scenarios.stages import LOG_LINES
from slidectl.scenarios.step_commands import Commands

_ANSWER_S = 60.0
"""Wall seconds that the daemon may take for what needs no simulated time."""
_LOOK_EVERY_S = 0.02
_CYCLES = 10
"""That the world goes on before the next look: each look is a round trip."""
_LEVELS = {1: "debug", 2: "info", 4: "warn", 8: "error", 16: "fatal"}
_PAUSE, _RESUME = b'"/gazebo/pause_physics"', b'"/gazebo/unpause_physics"'


class Live:
    """One daemon for all cases, by its socket."""

    def __init__(self, socket: str) -> None:
        self._socket = socket

    def warm(self, cases: Sequence[Case], commands: Commands) -> None:  # noqa: ARG002
        """Raises NoDaemon, Refused: the daemon is no stage for these cases."""
        with Client(socket=self._socket) as client:
            status = client.call("/slidectl/status")
        if status["robots"]:
            raise Refused(
                f"the daemon holds robots: {', '.join(status['robots'])}",
                f"a scenario begins with an empty world: slidectl delete {' '.join(status['robots'])}, or another -i",
            )
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
            was_paused = keeper.call("/slidectl/status")["paused"]
            keeper.call("/gazebo/pause_physics")
            keeper.call("/gazebo/reset_simulation")
            if "gravity" in case.world:
                _set_gravity(keeper, case.world["gravity"])
            try:
                clock = _CycleClock(bool(case.world.get("paused")))
                link = _SteppedLink(paths.instance(None, self._socket), time.monotonic() + _ANSWER_S, clock)
                with Client(link=link, timeout=_ANSWER_S) as client:
                    yield _LiveStage(client, clock)
            finally:
                for robot in keeper.robots():
                    keeper.delete(robot["name"])
                for name in set(keeper.params.names()) - before:
                    with suppress(SlidectlError):  # it was below one that has gone
                        keeper.call("/rosapi/delete_param", {"name": name})
                keeper.call("/gazebo/reset_simulation")
                if not was_paused:
                    keeper.call("/gazebo/unpause_physics")


def _set_gravity(client: Client, gravity: Sequence[float]) -> None:
    physics = client.call("/gazebo/get_physics_properties")
    request = {key: physics[key] for key in ("time_step", "max_update_rate", "ode_config")}
    client.call("/gazebo/set_physics_properties", request | {"gravity": dict(zip("xyz", gravity, strict=True))})


class _CycleClock:
    """Simulated time that waits have used up, in s; `end_s` is when they end with TimedOut."""

    def __init__(self, is_paused: bool) -> None:
        self.now_s = 0.0
        self.end_s: float | None = None
        self.is_paused = is_paused
        """As the scenario has it: the daemon itself is always paused."""


class _SteppedLink(SocketLink):
    """A connection whose waits make the world go on, as long as nothing comes. Deadlines are on the cycles' clock."""

    def __init__(self, instance: paths.InstancePaths, deadline: float, clock: _CycleClock) -> None:
        super().__init__(instance, deadline)
        self._clock = clock
        self._serial = itertools.count()
        self._came: deque[dict[str, Any]] = deque()

    def monotonic(self) -> float:
        return self._clock.now_s

    def send(self, line: bytes, deadline: float) -> None:  # noqa: ARG002
        if _PAUSE in line or _RESUME in line:
            self._clock.is_paused = _PAUSE in line
            line = line.replace(_RESUME, _PAUSE)
        super().send(line, time.monotonic() + _ANSWER_S)

    def receive(self, deadline: float) -> dict[str, Any] | None:
        if not self._came:
            self._ask("/rosapi/get_time", {})  # what needs no simulated time has come before its answer
        while not self._came and self._clock.now_s < deadline:
            self._go_on(deadline)
        return self._came.popleft() if self._came else None

    def _go_on(self, deadline: float) -> None:
        clock = self._clock
        if clock.is_paused:
            clock.now_s = deadline
            return
        before_s = self._time_s()
        if clock.end_s is not None and before_s >= clock.end_s - 1e-9:
            raise TimedOut(f"the simulated time is up: {before_s:g} s")
        answer = self._ask("/slidectl/step", {"cycles": _CYCLES})
        if not answer["success"]:
            raise Refused(answer["message"])
        self._last_s = float(answer["time"])
        clock.now_s += max(0.0, self._last_s - before_s)

    _last_s: float | None = None

    def _time_s(self) -> float:
        if self._last_s is None:
            self._last_s = float(self._ask("/slidectl/status", {})["time"])
        return self._last_s

    def _ask(self, service: str, request: dict[str, Any]) -> dict[str, Any]:
        """Call a service. What comes before its answer is kept."""
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


class _LiveStage(Stage):
    def __init__(self, client: Client, clock: _CycleClock) -> None:
        self.client = client
        self._clock = clock
        self._lines: deque[str] = deque(maxlen=LOG_LINES)
        client.subscribe("/rosout", "rosgraph_msgs/Log", take=self._take)

    def _take(self, published: dict[str, Any]) -> None:
        line, stamp = published["msg"], published["msg"]["header"]["stamp"]
        level = _LEVELS.get(line["level"], str(line["level"]))
        self._lines.append(f"{level:<5} [{stamp['secs'] + stamp['nsecs'] * 1e-9:.3f}] {line['name']}: {line['msg']}")

    def now_s(self) -> float:
        return float(self.client.call("/slidectl/status")["time"])

    def limit(self, seconds: float | None) -> None:
        self._clock.end_s = None if seconds is None else self.now_s() + max(0.0, seconds)

    def begin(self, run: Callable[[Client], None]) -> Any:
        return _BackgroundThread(self.client, self._clock, run)

    def log(self) -> list[str]:
        with suppress(SlidectlError):
            self.client.flush()  # takes in what has come
        return list(self._lines)


class _BackgroundThread:
    """Runs beside the case, and ends as by Ctrl-C."""

    def __init__(self, client: Client, clock: _CycleClock, run: Callable[[Client], None]) -> None:
        self._link = _FollowingLink(client.paths, time.monotonic() + _ANSWER_S, clock)
        own = Client(link=self._link, timeout=client.timeout)
        self._thread = threading.Thread(target=run, args=(own,), daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Interrupt it, and wait for that."""
        self._link.is_ending = True
        self._thread.join()
        self._link.close()


class _FollowingLink(SocketLink):
    """Waits while others make the world go on. Raises KeyboardInterrupt, once, when it is to end."""

    def __init__(self, instance: paths.InstancePaths, deadline: float, clock: _CycleClock) -> None:
        super().__init__(instance, deadline)
        self._clock = clock
        self.is_ending = False
        self._has_ended = False

    def monotonic(self) -> float:
        return self._clock.now_s

    def send(self, line: bytes, deadline: float) -> None:  # noqa: ARG002
        super().send(line, time.monotonic() + _ANSWER_S)

    def receive(self, deadline: float) -> dict[str, Any] | None:
        while True:
            if self.is_ending and not self._has_ended:
                self._has_ended = True
                raise KeyboardInterrupt
            message = super().receive(time.monotonic() + _LOOK_EVERY_S)
            if message is not None or self._clock.now_s >= deadline:
                return message
