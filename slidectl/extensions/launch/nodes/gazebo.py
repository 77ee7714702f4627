"""gazebo_ros's gazebo and gzserver: the daemon simulates the world; arguments and a world file (SDF) configure it.

Ground, gravity, step size, real-time factor and models of a world file count; everything else is reported. The
models are spawned before the following nodes start.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from slidectl import paths
from slidectl.client import spawning
from slidectl.description import sdf, xml_tree
from slidectl.description.element_values import text_numbers
from slidectl.description.models import read_file
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, NotThere
from slidectl.extensions.launch.plan import LaunchPlan, Leaf, Node
from slidectl.extensions.launch.task import HOOK_LIMIT_S, Run, Task, parse
from slidectl.rotations import Vector

_OPTIONS = {
    "-u": 0, "--pause": 0, "-e": 1, "--physics": 1, "-s": 1, "--server-plugin": 1, "-g": 1, "--gui-plugin": 1,
    "--verbose": 0, "-r": 0, "--record": 0, "--record_path": 1, "-p": 1, "--play": 1, "--seed": 1, "--iters": 1,
    "--minimal_comms": 0, "--lockstep": 0, "-q": 0, "--profile": 1, "-o": 1,
}  # fmt: skip
_MOST_NAMED = 8
_EMPTY = "the world is the empty one"
_WARN = 4
"""The level WARN of rosgraph_msgs/Log."""
_QUIET = ("-u", "--pause", "-e", "--physics", "--verbose", "-q", "--minimal_comms", "--lockstep")


@dataclass(frozen=True)
class WorldSettings:
    """`timestep` in s, `gravity` in m/s², `speed` as real-time factor (`inf`: as fast as possible). None: not set."""

    paused: bool = False
    timestep: float | None = None
    gravity: Vector | None = None
    speed: float | None = None
    ground: bool | None = None

    def over(self, others: WorldSettings) -> WorldSettings:
        """These settings, completed by `others`."""
        own = {name: value for name, value in vars(self).items() if value is not None}
        return replace(others, **{**own, "paused": self.paused or others.paused})


class Gazebo(Task):
    """The Gazebo server, or the script that starts it with a window."""

    family = "world"

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = parse(node, _OPTIONS)
        self.paused = words.has("-u") or words.has("--pause")
        self.world: WorldFile | None = None
        self.scene: sdf.Scene | None = None
        """The models of the world file; set by `find_missing`."""
        for option in words.given:
            if option not in _QUIET:
                plan.notice("ignored", node.place, node.full_name, f"Gazebo's option {option} has no effect")
        engine = words.one("-e") or words.one("--physics") or "ode"
        if engine != "ode":
            plan.notice("ignored", node.place, node.full_name, f"-e {engine} has no effect: the physics here is MuJoCo")
        if len(words.rest) > 1:
            raise self.error(f"one world file at most, not {' '.join(words.rest)}")
        for error in node.absent:
            plan.missing.note(error, _EMPTY)
        if words.rest and _is_of_gazebo_ros(Path(words.rest[0])):
            text = f"there is no world file {words.rest[0]}: {_EMPTY}, as in Gazebo"
            plan.notice("wrong", node.place, node.full_name, text)
        elif words.rest:
            try:
                self.path = _find(node, words.rest[0])
                self.world = read_world(self.path)
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
        """The settings of this node, completed by `others`."""
        asked = replace(self.world.settings if self.world else WorldSettings(), paused=self.paused)
        return asked.over(others)

    def find_missing(self, plan: LaunchPlan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:  # noqa: ARG002
        """Read the models of the world; models with missing files are left out."""
        if self.world is not None and self.scene is None:
            self.scene = sdf.read(self.path, packages, plan.missing)
            plan.notices += self.scene.notices

    def start(self, run: Run) -> str | None:
        if not run.owns_daemon:
            self._adapt(run)
        status = run.call("/slidectl/status")
        pace = "as fast as possible" if status["speed"] == 0 else f"speed {status['speed']:g}"
        moving = "paused" if status["paused"] and not (run.is_held and run.resumes) else pace
        self.settled(run, f"the world: step {status['timestep']:g} s, {moving}")
        if self.scene is not None and self.scene.models:
            self._spawn_models(run, self.scene.models)
        return None

    def afterwards(self, run: Run) -> None:
        """Print the warnings of the running world, as Gazebo does in its terminal."""

        def print_warning(published: dict[str, Any]) -> None:
            if published["msg"]["level"] >= _WARN:
                run.console.warn(str(published["msg"]["msg"]))

        run.client.subscribe("/rosout", "rosgraph_msgs/Log", take=print_warning)

    def _spawn_models(self, run: Run, models: list[sdf.SdfModel]) -> None:
        there = run.call("/slidectl/status")["robots"]
        named = [model.name for model in models]
        run.spawned += [name for name in named if name not in there]  # an interrupted call may have spawned them
        spawn = spawning.Spawn(run.client, spawning.scene_plan(models))
        for warning in spawn.apply()[1]:
            self.warn(run, warning.partition(" (--at")[0])
        few = ", ".join(named[:_MOST_NAMED]) + (f" and {len(named) - _MOST_NAMED} more" if named[_MOST_NAMED:] else "")
        plural = "" if len(named) == 1 else "s"
        self.settled(run, f"{len(named)} model{plural} of the world spawned: {few}", models=named)

    def _adapt(self, run: Run) -> None:
        """Apply the settings to a running world. Options of the daemon and `sim speed` have priority."""
        file = self.world.file if self.world else ""
        asked = self.settings(WorldSettings())
        if asked.ground is False:
            self.warn(run, f"{file} has no ground plane, but the running world keeps its own")
        if asked.paused:
            run.call("/gazebo/pause_physics")
        chosen = run.call("/slidectl/status")["chosen"]
        if kept := [name for name in chosen if getattr(asked, name) is not None]:
            self.warn(run, f"{file} sets {' and '.join(kept)}; what was chosen for the running world is kept")
            asked = WorldSettings(**{**vars(asked), **dict.fromkeys(kept)})
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

    def stop(self, run: Run) -> None:
        """Delete the spawned models, if the daemon was not started by this launch; else it ends with them."""
        if run.owns_daemon:
            return
        for name in reversed(run.spawned):
            if run.call("/gazebo/delete_model", {"model_name": name}, timeout=HOOK_LIMIT_S)["success"]:
                self.settled(run, f"{name}: deleted")
        run.spawned.clear()


def _is_of_gazebo_ros(path: Path) -> bool:
    """True for a world that a launch file supposes in gazebo_ros, and that is not there. Gazebo takes its empty one."""
    return not is_file(path) and path.parent == paths.share("launch") / "counterparts" / "gazebo_ros" / "worlds"


def _find(node: Node, name: str) -> Path:
    """Find a world file: by its path, in GAZEBO_RESOURCE_PATH, or among the shipped ones (Gazebo's empty world)."""
    resources = [entry for entry in os.environ.get("GAZEBO_RESOURCE_PATH", "").split(os.pathsep) if entry]
    shipped = paths.share("launch") / "counterparts" / "gazebo_ros"
    places = [Path(name), *(Path(folder) / name for folder in resources), shipped / name]
    for path in places:
        if is_file(path):
            return path.absolute()
    looked = ", ".join(str(path.parent) for path in places)
    message = f"{node.full_name}: there is no world file {name}"
    raise node.place.absence(message, f"looked in: {looked}", f"world {name}")


# --- world files -----------------------------------------------------------------------------------------------------


@dataclass
class WorldFile:
    """The settings in a world file, and notices about the rest."""

    file: str
    settings: WorldSettings = field(default_factory=lambda: WorldSettings(ground=False))
    notices: list[Notice] = field(default_factory=list)

    def set(self, **settings: Any) -> None:
        self.settings = replace(self.settings, **settings)

    def say(self, verdict: Verdict, element: Element, text: str) -> None:
        self.notices.append(Notice(verdict, element.title, text, element.file, element.line))


def read_world(path: Path) -> WorldFile:
    """Read a world file. Raises BadFile: missing, not XML, without a world, or with malformed numbers."""
    found = parse_world(read_file(path), shown(path))
    if found is None:
        raise BadFile("this is not a world file: it has no <sdf> with a <world> inside", shown(path))
    return found


def parse_world(text: bytes, file: str) -> WorldFile | None:
    """As read_world, for a text; None when it has no world."""
    root = xml_tree.read(text, file)
    worlds = root.find_all("world") if root.tag in ("sdf", "gazebo") else [root] if root.tag == "world" else []
    if not worlds:
        return None
    found = WorldFile(root.file)
    for element in worlds[0].children:
        _read_tag(element, found)
    return found


def _read_tag(element: Element, found: WorldFile) -> None:
    if element.tag == "gravity":
        found.set(gravity=_vector(element))
    elif element.tag == "physics":
        _read_physics(element, found)
    elif element.tag in ("model", "include"):  # sdf.py reads these, except the ground
        if sdf.is_ground(element):
            found.set(ground=True)
    elif element.tag == "plugin":
        found.say("wrong", element, "plugins of Gazebo have no effect")
    elif element.tag == "light":
        if element.get("name") != sdf.SUN:
            found.say("ignored", element, sdf.NO_LIGHT)
    elif element.tag not in ("name", "state"):  # sdf.py reads the poses of models in a state
        found.say("ignored", element, "has no effect: there is nothing like it here")


def _read_physics(physics: Element, found: WorldFile) -> None:
    factor: float | None = None
    rate: float | None = None
    for element in physics.children:
        if element.tag == "max_step_size":
            found.set(timestep=_number(element, above=0.0))
        elif element.tag == "real_time_factor":
            factor = _number(element, above=0.0)
        elif element.tag == "real_time_update_rate":
            rate = _number(element)
        elif element.tag == "gravity":
            found.set(gravity=_vector(element))
        else:
            found.say("ignored", element, "has no effect: the physics here is MuJoCo")
    speed = factor
    if rate is not None:  # in Gazebo the rate of updates counts; 0 is as fast as possible
        speed = math.inf if rate <= 0 else rate * (found.settings.timestep or 0.001)
    found.set(speed=speed)
    if factor is not None and speed is not None and not math.isclose(speed, factor, rel_tol=1e-6):
        text = f"real_time_update_rate overrides real_time_factor, as in Gazebo: the factor is {speed:g}"
        found.say("converted", physics, text)


def _number(element: Element, above: float = -math.inf) -> float:
    """Read a finite number above a bound. Raises BadFile."""
    [value] = text_numbers(element, 1, f"<{element.tag}>")
    if value <= above:
        raise element.error(f"<{element.tag}> is {value:g}; it must be above {above:g}")
    return value


def _vector(element: Element) -> Vector:
    x, y, z = text_numbers(element, 3, f"<{element.tag}>")
    return x, y, z
