"""Where cases run: in a world of this process without sockets, or in a live daemon; and how one is run there.

Both begin with an empty world at time 0, and end with nothing of the case left.
"""

from __future__ import annotations

import os
import re
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from slidectl import paths
from slidectl.client import Client
from slidectl.client.link import SocketLink
from slidectl.errors import Refused, SlidectlError
from slidectl.scenarios.case_run import BAD, ERROR, CaseResult, Stage, run_case
from slidectl.scenarios.scenario_file import Case, Step
from slidectl.scenarios.step_commands import Commands

LOG_LINES = 20
_LOOK_EVERY_S = 0.1
_WARM_CYCLES = 64
_LEVELS = {1: "debug", 2: "info", 4: "warn", 8: "error", 16: "fatal"}


class Stages(Protocol):
    """Makes a stage for each case."""

    is_repeatable: bool
    """Whether a case that is run again gives the same bits."""

    def warm(self, cases: Sequence[Case]) -> None:
        """Load what all cases need, before processes for them are made."""

    def of(self, case: Case) -> AbstractContextManager[Stage]:
        """The stage of a case. Raises SlidectlError: it cannot begin."""


class CaseRuns:
    """Runs cases with these commands, for workers. `keep` is the folder for recordings of those that fail."""

    def __init__(self, commands: Commands, stages: Stages, sim_timeout: float, keep: str | None) -> None:
        self._commands = commands
        self._stages = stages
        self._sim_timeout = sim_timeout
        self._keep = keep

    def run(self, case: Case, temporary: str) -> CaseResult:
        """In a process of its own: what commands print goes into a file in the case's folder."""
        _print_into(os.path.join(temporary, "output"))
        records = self._keep is not None and not self._stages.is_repeatable
        result = self._try(case, temporary, self._record(case) if records else None)
        if self._keep is None:
            return result
        if result.verdict in BAD and not records:
            self._try(case, temporary, self._record(case))  # the same bits once more, recorded
        for file in self._files(case):
            if result.verdict in BAD:
                result.kept.append(str(file))
            else:
                file.unlink()
        return result

    def _try(self, case: Case, temporary: str, first: Step | None) -> CaseResult:
        steps = case.steps if first is None else (first, *case.steps)
        folder = tempfile.mkdtemp(dir=temporary)  # empty, whatever an earlier try has left
        try:
            with self._stages.of(case) as stage:
                return run_case(case, self._commands, stage, self._sim_timeout, folder, steps)
        except SlidectlError as error:
            return CaseResult(case.id, ERROR, message=error.message, hint=error.hint or "")

    def _stem(self, case: Case) -> Path:
        assert self._keep is not None
        return Path(self._keep) / re.sub(r"[^\w.=-]+", "_", case.id.removesuffix(".yaml"))

    def _files(self, case: Case) -> list[Path]:
        stem = self._stem(case)
        return sorted(file for file in stem.parent.glob("*") if file.stem == stem.name and file.suffix in _RECORDINGS)

    def _record(self, case: Case) -> Step:
        stem = self._stem(case)
        stem.parent.mkdir(parents=True, exist_ok=True)
        for old in self._files(case):
            old.unlink()
        return Step(("record", "-a", "-x", _LEFT_OUT, "-O", f"{stem}{_suffix()}"), 0, "setup", background=True)


_LEFT_OUT = "/clock|/gazebo/(link|model)_states"
"""What comes in every cycle: the frames on /tf say the same."""
_RECORDINGS = (".mcap", ".bag")


def _suffix() -> str:
    """Of a recording: MCAP where its library is there."""
    from importlib.util import find_spec

    return _RECORDINGS[0] if find_spec("mcap") else _RECORDINGS[1]


def _print_into(path: str) -> None:
    """Standard output and error of this process go into a file, and its input is empty."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.dup2(empty, 0)


# --- in this process ------------------------------------------------------------------------------------------------


class InProcess:
    """A new world for each case."""

    is_repeatable = True

    def warm(self, cases: Sequence[Case]) -> None:
        """Compile and load the engine, and run a robot for some cycles."""
        from slidectl.client import spawning
        from slidectl.simulation.compiled import object_file
        from slidectl.simulation.simulation import Simulation

        engines = {case.world.get("engine", "auto") for case in cases}
        simulation = Simulation()
        if object_file.is_possible() and engines != {"plain"}:
            with suppress(Refused):  # cases say so themselves, where they need it
                simulation.engine.complete()
        simulation.spawn(spawning.document("slider", {}, None).xml, "slider")
        simulation.step(_WARM_CYCLES)

    @contextmanager
    def of(self, case: Case) -> Iterator[Stage]:
        from slidectl.control import user_classes
        from slidectl.daemon.time_limit import TimeLimit
        from slidectl.simulation.simulation import Simulation

        wanted = dict(case.world)
        paused = wanted.pop("paused", False)
        if "gravity" in wanted:
            wanted["gravity"] = tuple(wanted["gravity"])
        user_classes.limit = TimeLimit()
        stage = _WorldStage(Simulation(**wanted))
        stage.world.simulation.run.paused = paused
        yield stage


class _WorldStage(Stage):
    def __init__(self, simulation: Any) -> None:
        from slidectl.daemon.in_process import InProcessWorld

        self.world = InProcessWorld(simulation)
        self.client = self.world.client()

    def now_s(self) -> float:
        return self.world.simulation.graph.clock.seconds

    def limit(self, seconds: float | None) -> None:
        now_ns = self.world.simulation.time_ns
        self.world.end_ns = None if seconds is None else now_ns + max(0, round(seconds * 1e9))

    def begin(self, run: Callable[[Client], None]) -> Any:
        from slidectl.scenarios.background import BackgroundStep

        return BackgroundStep(self.world, run, self.client.timeout)

    def log(self) -> list[str]:
        return list(self.world.log)[-LOG_LINES:]


# --- in a daemon ----------------------------------------------------------------------------------------------------


class Live:
    """One daemon for all cases, by its socket. After each it is as it was: no robots, time 0."""

    is_repeatable = False

    def __init__(self, socket: str) -> None:
        self._socket = socket

    def warm(self, cases: Sequence[Case]) -> None:
        """Raises NoDaemon, Refused: the daemon is no stage for these cases."""
        with Client(socket=self._socket) as client:
            status = client.call("/slidectl/status")
            if status["robots"]:
                raise Refused(
                    f"the daemon holds robots: {', '.join(status['robots'])}",
                    "scenarios begin with an empty world: give another daemon with -i, or slidectl delete them",
                )
            for case in cases:
                wanted = case.world.get("timestep", status["timestep"])
                if abs(wanted - status["timestep"]) > 1e-12:
                    raise Refused(
                        f"{case.id} needs a time step of {wanted:g} s, and the daemon has {status['timestep']:g} s",
                        f"slidectl daemon start --timestep {wanted:g}",
                    )

    @contextmanager
    def of(self, case: Case) -> Iterator[Stage]:
        link = _EndableLink(paths.instance(None, self._socket), time.monotonic() + 10.0)
        with Client(link=link) as client:
            before = set(client.params.names())
            was_paused = client.call("/slidectl/status")["paused"]
            client.call("/gazebo/reset_simulation")
            client.call("/gazebo/pause_physics" if case.world.get("paused") else "/gazebo/unpause_physics")
            if "gravity" in case.world:
                _set_gravity(client, case.world["gravity"])
            try:
                yield _LiveStage(client)
            finally:
                for robot in client.robots():
                    client.delete(robot["name"])
                for name in set(client.params.names()) - before:
                    with suppress(SlidectlError):
                        client.call("/rosapi/delete_param", {"name": name})
                client.call("/gazebo/reset_simulation")
                if was_paused:
                    client.call("/gazebo/pause_physics")


def _set_gravity(client: Client, gravity: Sequence[float]) -> None:
    physics = client.call("/gazebo/get_physics_properties")
    request = {key: physics[key] for key in ("time_step", "max_update_rate", "ode_config")}
    client.call("/gazebo/set_physics_properties", request | {"gravity": dict(zip("xyz", gravity, strict=True))})


class _LiveStage(Stage):
    def __init__(self, client: Client) -> None:
        self.client = client
        self._lines: deque[str] = deque(maxlen=LOG_LINES)
        client.subscribe("/rosout", "rosgraph_msgs/Log", take=self._take)

    def _take(self, published: dict[str, Any]) -> None:
        line, stamp = published["msg"], published["msg"]["header"]["stamp"]
        level = _LEVELS.get(line["level"], str(line["level"]))
        self._lines.append(f"{level:<5} [{stamp['secs'] + stamp['nsecs'] * 1e-9:.3f}] {line['name']}: {line['msg']}")

    def now_s(self) -> float:
        return float(self.client.call("/slidectl/status")["time"])

    def begin(self, run: Callable[[Client], None]) -> Any:
        return _BackgroundThread(self.client, run)

    def log(self) -> list[str]:
        return list(self._lines)


class _BackgroundThread:
    """Runs beside the case, and ends as by Ctrl-C."""

    def __init__(self, client: Client, run: Callable[[Client], None]) -> None:
        self._link = _EndableLink(client.paths, time.monotonic() + client.timeout)
        own = Client(link=self._link, timeout=client.timeout)
        self._thread = threading.Thread(target=run, args=(own,), daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Interrupt it, and wait for that."""
        self._link.is_ending = True
        self._thread.join()
        self._link.close()


class _EndableLink(SocketLink):
    """Raises KeyboardInterrupt once, in a wait, when it is to end."""

    is_ending = False
    _has_ended = False

    def receive(self, deadline: float) -> dict[str, Any] | None:
        while True:
            if self.is_ending and not self._has_ended:
                self._has_ended = True
                raise KeyboardInterrupt
            message = super().receive(min(deadline, time.monotonic() + _LOOK_EVERY_S))
            if message is not None or time.monotonic() >= deadline:
                return message
