"""What a world is asked to be: by a gazebo node's arguments, and by a world file (SDF).

Read here, applied elsewhere. Of an SDF file ground, light, gravity, length of a step and real-time factor count;
everything else in it is reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from slidectl.description import xml_tree
from slidectl.description.models import read_file
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile
from slidectl.launch.files import shown

Vector = tuple[float, float, float]

GROUND_PLANE = "ground_plane"
SUN = "sun"
_DRAWN = ("gui", "scene", "light", "audio", "road", "material")


@dataclass(frozen=True)
class WorldSettings:
    """`timestep` in s, `gravity` in m/s², `speed` as real-time factor (`inf`: as fast as it goes). None: not said."""

    paused: bool = False
    timestep: float | None = None
    gravity: Vector | None = None
    speed: float | None = None
    ground: bool | None = None


@dataclass
class WorldFile:
    """What a world file says, and what became of the rest of it."""

    file: str
    timestep: float | None = None
    gravity: Vector | None = None
    speed: float | None = None
    ground: bool = False
    ground_line: int | None = None
    notices: list[Notice] = field(default_factory=list)

    def say(self, verdict: str, element: Element, text: str) -> None:
        self.notices.append(Notice(verdict, element.title, text, element.file, element.line))  # type: ignore[arg-type]


def read(path: Path) -> WorldFile:
    """Raises BadFile: missing, not XML, no world in it, or numbers that are none."""
    root = xml_tree.read(read_file(path), shown(path))
    worlds = root.find_all("world") if root.tag in ("sdf", "gazebo") else [root] if root.tag == "world" else []
    if not worlds:
        raise root.error("this is no world file: it has no <sdf> with a <world> inside")
    found = WorldFile(root.file, ground_line=worlds[0].line)
    for element in worlds[0].children:
        _take(element, found)
    for extra in worlds[1:]:
        found.say("wrong", extra, "only the first world of a file is used")
    return found


def _take(element: Element, found: WorldFile) -> None:
    if element.tag == "gravity":
        found.gravity = _vector(element)
    elif element.tag == "physics":
        _take_physics(element, found)
    elif element.tag == "include":
        _take_include(element, found)
    elif element.tag == "model" and _is_ground(element):
        found.ground = True
    elif element.tag == "model":
        found.say("wrong", element, "models of a world file are not in this world; spawn them from URDF or xacro")
    elif element.tag == "plugin":
        found.say("wrong", element, "plugins of Gazebo have no effect")
    elif element.tag not in ("light", "name"):
        why = "nothing is drawn here" if element.tag in _DRAWN else "there is nothing like it here"
        found.say("ignored", element, f"has no effect: {why}")


def _take_include(element: Element, found: WorldFile) -> None:
    uri = element.find("uri")
    name = (uri.first_text if uri is not None else "").removeprefix("model://").strip("/")
    if name == GROUND_PLANE:
        found.ground = True
    elif name != SUN:
        found.say("wrong", element, f"the model {name!r} is not in this world; spawn it from URDF or xacro")


def _is_ground(model: Element) -> bool:
    """A static model that is called so, or whose only shape is a plane."""
    shapes = [shape for element in model.walk() if element.tag == "geometry" for shape in element.children]
    return model.get("name") == GROUND_PLANE or bool(shapes and all(shape.tag == "plane" for shape in shapes))


# --- physics ---------------------------------------------------------------------------------------------------------


def _take_physics(physics: Element, found: WorldFile) -> None:
    factor: float | None = None
    rate: float | None = None
    for element in physics.children:
        if element.tag == "max_step_size":
            found.timestep = _positive(element)
        elif element.tag == "real_time_factor":
            factor = _positive(element)
        elif element.tag == "real_time_update_rate":
            rate = _number(element)
        elif element.tag == "gravity":
            found.gravity = _vector(element)
        else:
            found.say("ignored", element, "has no effect: the physics here is MuJoCo")
    found.speed = _speed(factor, rate, found.timestep or 0.001)
    if factor is not None and found.speed is not None and not math.isclose(found.speed, factor, rel_tol=1e-6):
        text = f"real_time_update_rate goes before real_time_factor, as in Gazebo: the factor is {found.speed:g}"
        found.say("converted", physics, text)


def _speed(factor: float | None, rate: float | None, timestep: float) -> float | None:
    """Gazebo holds to the rate of updates; 0 is as fast as possible."""
    if rate is None:
        return factor
    return math.inf if rate <= 0 else rate * timestep


def _number(element: Element) -> float:
    try:
        value = float(element.first_text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _bad(element, "a number")
    return value


def _positive(element: Element) -> float:
    value = _number(element)
    if value <= 0:
        raise _bad(element, "a number above 0")
    return value


def _vector(element: Element) -> Vector:
    try:
        x, y, z = (float(word) for word in element.first_text.split())
    except ValueError:
        raise _bad(element, "three numbers") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise _bad(element, "three finite numbers")
    return x, y, z


def _bad(element: Element, expected: str) -> BadFile:
    return element.error(f"<{element.tag}> is {expected}, not {element.first_text!r}")
