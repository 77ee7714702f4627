"""gazebo_ros's gazebo, gzserver and gzclient: the world is the daemon's, and these say how it is to be.

World files are read by world.py.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

from slidectl import paths
from slidectl.description.packages import is_file
from slidectl.errors import NotThere
from slidectl.launch.options import parse
from slidectl.launch.plan import Node, Plan
from slidectl.launch.task import HOOK_LIMIT_S, Run, Task
from slidectl.launch.world import WorldFile, WorldSettings, read

_OPTIONS = {
    "-u": 0, "--pause": 0, "-e": 1, "--physics": 1, "-s": 1, "--server-plugin": 1, "-g": 1, "--gui-plugin": 1,
    "--verbose": 0, "-r": 0, "--record": 0, "--record_path": 1, "-p": 1, "--play": 1, "--seed": 1, "--iters": 1,
    "--minimal_comms": 0, "--lockstep": 0, "-q": 0, "--profile": 1, "-o": 1,
}  # fmt: skip
_EMPTY = "the world is the empty one"
_QUIET = ("-u", "--pause", "-e", "--physics", "--verbose", "-q", "--minimal_comms", "--lockstep")


class Gazebo(Task):
    """The server, or the script that starts it with a window."""

    family = "world"

    def __init__(self, node: Node, plan: Plan) -> None:
        super().__init__(node, plan)
        words = parse(node, _OPTIONS)
        self.paused = words.has("-u") or words.has("--pause")
        self.world: WorldFile | None = None
        for option in words.given:
            if option not in _QUIET:
                plan.notice("ignored", node.place, node.full_name, f"Gazebo's option {option} has no effect")
        engine = words.one("-e") or words.one("--physics") or "ode"
        if engine != "ode":
            plan.notice("ignored", node.place, node.full_name, f"-e {engine} has no effect: the physics here is MuJoCo")
        if len(words.rest) > 1:
            raise node.place.error(f"{node.full_name}: one world file at most, not {' '.join(words.rest)}")
        for error in node.absent:
            plan.missing.note(error, _EMPTY)
        if words.rest:
            try:
                self.world = read(_find(node, words.rest[0]))
            except NotThere as error:
                plan.missing.note(error, _EMPTY)
            else:
                plan.notices += self.world.notices

    @property
    def text(self) -> str:
        return f"the world{', paused' if self.paused else ''}" + (
            f", as {self.world.file} has it" if self.world else ""
        )

    def settings(self, others: WorldSettings) -> WorldSettings:
        """What is asked for, over what others ask for."""
        asked = replace(others, paused=others.paused or self.paused)
        if self.world is None:
            return asked
        world = self.world
        return WorldSettings(
            asked.paused,
            world.timestep if world.timestep is not None else asked.timestep,
            world.gravity if world.gravity is not None else asked.gravity,
            world.speed if world.speed is not None else asked.speed,
            world.ground,
        )

    def start(self, run: Run) -> str | None:
        if not run.owns_daemon:
            self._adapt(run)
        status = run.call("/slidectl/status")
        pace = "as fast as possible" if status["speed"] == 0 else f"speed {status['speed']:g}"
        moving = "paused" if status["paused"] else pace
        self.settled(run, f"the world: step {status['timestep']:g} s, {moving}")
        return None

    def _adapt(self, run: Run) -> None:
        """A world that runs already takes on what it can."""
        asked = self.settings(WorldSettings())
        if asked.ground is False:
            self.warn(run, f"{self._file} has no ground plane, but the running world keeps its own")
        if asked.paused:
            run.call("/gazebo/pause_physics")
        asked = self._without_chosen(run, asked)
        if asked.timestep is None and asked.gravity is None and asked.speed is None:
            return
        physics = run.call("/gazebo/get_physics_properties")
        step = asked.timestep or physics["time_step"]
        rate = physics["max_update_rate"] * physics["time_step"] / step
        if asked.speed is not None:
            rate = 0.0 if math.isinf(asked.speed) else asked.speed / step
        gravity = dict(zip("xyz", asked.gravity, strict=True)) if asked.gravity else physics["gravity"]
        request = {"time_step": step, "max_update_rate": rate, "gravity": gravity}
        run.call("/gazebo/set_physics_properties", request)

    def _without_chosen(self, run: Run, asked: WorldSettings) -> WorldSettings:
        """What is left to ask for: an option of the daemon's, or `sim speed`, goes before the file."""
        chosen = run.call("/slidectl/status")["chosen"]
        kept = [name for name in chosen if getattr(asked, name) is not None]
        if kept:
            self.warn(run, f"{self._file} sets {' and '.join(kept)}; what was chosen for the running world stays")
        return WorldSettings(
            asked.paused,
            None if "timestep" in chosen else asked.timestep,
            None if "gravity" in chosen else asked.gravity,
            None if "speed" in chosen else asked.speed,
            asked.ground,
        )

    @property
    def _file(self) -> str:
        return self.world.file if self.world else ""

    def stop(self, run: Run) -> None:
        """Robots leave with the world that they were put into; that of somebody else stays without them."""
        if run.owns_daemon:
            return
        for name in reversed(run.spawned):
            if run.call("/gazebo/delete_model", {"model_name": name}, HOOK_LIMIT_S)["success"]:
                self.settled(run, f"{name}: deleted")
        run.spawned.clear()


class Window(Task):
    """gzclient: there is no window."""

    family = "notice"
    keeps_running = False

    @property
    def text(self) -> str:
        return "there is no window here; slidectl sim status, slidectl robots and slidectl echo show the world"

    def start(self, run: Run) -> str | None:
        self.settled(run, self.text)
        return None


def _find(node: Node, name: str) -> Path:
    """A world file: as it is written, in GAZEBO_RESOURCE_PATH, or Gazebo's empty one, which is shipped."""
    resources = [entry for entry in os.environ.get("GAZEBO_RESOURCE_PATH", "").split(os.pathsep) if entry]
    shipped = paths.share("launch") / "counterparts" / "gazebo_ros"
    places = [Path(name), *(Path(folder) / name for folder in resources), shipped / name]
    for path in places:
        if is_file(path):
            return path.absolute()
    looked = ", ".join(str(path.parent) for path in places)
    message = f"{node.full_name}: there is no world file {name}"
    raise node.place.absence(message, f"looked in: {looked}", f"world {name}")
