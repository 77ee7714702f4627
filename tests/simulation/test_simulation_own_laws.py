"""Users' controllers as machine code: the same bits as in the interpreter, and what cannot be compiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from engine_scenes import Scene, add, arm, play, usual
from sim_robots import STATES
from test_simulation_compiled_controllers import is_compiled

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

pytestmark = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")

LAW = '''
import math
from array import array
from slidectl.control import Columns, Compiled, Controller, EffortJointInterface, Member, Parts, law

STIFFNESS, DAMPING = 30.0, 2.5
WEIGHTS = (1.0, 0.5)


def stiff(error):
    return STIFFNESS * math.sin(error) + sum_of(error)


def sum_of(error):
    return WEIGHTS[0] * error + WEIGHTS[1] * abs(error)


@law
def pull(spring, joint):
    """The error decides."""
    spring.error = spring.set_point - joint.position
    joint.command = stiff(spring.error) - DAMPING * joint.velocity


@law
def update_springs(springs, tables, time_ns, period_s):
    """The update on rows."""
    for k in range(len(tables.members)):
        pull(tables.members[k], tables.joints[tables.members[k].joint])
    springs.updates += 1
    tables.numbers[springs.updates % 3] = time_ns * period_s
    return springs.updates % 7 == 0 and springs.wanted != 0


class Spring:
    def __init__(self):
        self.set_point, self.error = 0.3, 0.0


class Springs(Controller):
    interface_type = EffortJointInterface
    compiled = Compiled(update_springs, Columns(changing="updates", whole="updates"),
                        Columns(changing="error", fixed="set_point"))

    def init(self, interface, node):
        self.joints = [interface.get_handle(name) for name in ("joint1", "joint3")]
        self.springs = [Spring(), Spring()]
        self.updates = 0
        self.past = array("d", [0.0, 0.0, 0.0])
        self.told = node.advertise("told", "std_msgs/Float64")
        node.subscribe("command", "std_msgs/Float64", self.receive)

    def receive(self, message):
        self.springs[0].set_point = message["data"]

    def parts(self):
        return Parts((self.told,), members=list(map(Member, self.springs, self.joints)), numbers=self.past)

    def update(self, time_ns, period_s):
        for spring, joint in zip(self.springs, self.joints):
            pull(spring, joint)
        self.updates += 1
        self.past[self.updates % 3] = time_ns * period_s
        if self.updates % 7 == 0 and self.told.wanted:
            self.publish(time_ns, period_s)

    def publish(self, time_ns, period_s):
        self.told.publish({"data": self.springs[1].error + self.past[0]})
'''


def scene_of(path: Path) -> Scene:
    """A robot with that law, which is told a set point now and then."""

    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), {"states": {"type": STATES, "publish_rate": 80}})
        request = {"robot": "a", "name": "springs", "file": str(path), "class_name": "Springs"}
        assert simulation.call("/slidectl/load_controller_file", request)["ok"]
        simulation.call("/a/controller_manager/switch_controller", {"start_controllers": ["springs"], "strictness": 2})
        if str(simulation.engine) == "compiled":
            simulation.engine.complete()
        simulation.heard.listen("/a/springs/told")  # type: ignore[attr-defined]
        for value in (0.4, -0.2, 0.7):
            simulation.publish("/a/springs/command", {"data": value})
            simulation.step(300)

    return scene


def state(simulation: Simulation) -> str:
    listed = simulation.robots.get("a").manager.list()
    return next(entry["state"] for entry in listed if entry["name"] == "springs")


def test_a_law_of_a_user_gives_the_same_bits_as_machine_code(tmp_path: Path) -> None:
    path = tmp_path / "springs.py"
    path.write_text(LAW, encoding="utf-8")
    (plain, _), (compiled, simulation) = (play(scene_of(path), engine) for engine in ("plain", "compiled"))
    assert compiled == plain
    assert is_compiled(simulation, "a", "springs")


def test_an_edited_law_is_compiled_anew(tmp_path: Path) -> None:
    path = tmp_path / "springs.py"
    path.write_text(LAW, encoding="utf-8")
    edited = LAW.replace("WEIGHTS = (1.0, 0.5)", "WEIGHTS = (3.0, 0.5)")

    def scene(simulation: Simulation) -> None:
        path.write_text(LAW, encoding="utf-8")
        scene_of(path)(simulation)
        path.write_text(edited, encoding="utf-8")
        assert simulation.call("/slidectl/reload_controller", {"robot": "a", "name": "springs"})["ok"]
        if str(simulation.engine) == "compiled":
            simulation.engine.complete()
        simulation.step(300)

    (plain, _), (compiled, simulation) = (play(scene, engine) for engine in ("plain", "compiled"))
    assert compiled == plain
    assert is_compiled(simulation, "a", "springs")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("springs.updates % 7", "springs.updates // (400 - springs.updates)"),
        ("tables.numbers[springs.updates % 3]", "tables.numbers[springs.updates // 100]"),
    ],
)
def test_a_compiled_law_that_fails_aborts_its_controller_and_no_other(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "springs.py"
    path.write_text(LAW.replace(old, new, 1), encoding="utf-8")
    _, simulation = play(scene_of(path), "compiled")
    assert state(simulation) == "aborted"
    assert simulation.robots.get("a").manager.list()[0]["state"] == "running"


def changed_scene(folder: Path, old: str, new: str) -> tuple[Scene, list[str]]:
    """The scene with a text of the law's file replaced, and all that its log says."""
    path = folder / "springs.py"
    path.write_text(LAW.replace(old, new, 1), encoding="utf-8")
    said: list[str] = []

    def scene(simulation: Simulation) -> None:
        simulation.graph.log.sink = lambda *line: said.append(line[2])
        scene_of(path)(simulation)

    return scene, said


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("WEIGHTS = (1.0, 0.5)", "WEIGHTS = [1.0, 0.5]", "sum_of uses 'WEIGHTS', a list; a law uses numbers"),
        ("springs.updates += 1\n    tables", "springs.misspelt += 1\n    tables", "misspelt"),
        ("spring.error = ", "numbers = [spring.set_point]\n    numbers.append(2.0)\n    spring.error = ", "objects"),
    ],
)
def test_a_law_that_cannot_be_compiled_runs_in_the_interpreter_and_it_is_said(
    tmp_path: Path, old: str, new: str, text: str
) -> None:
    scene, said = changed_scene(tmp_path, old, new)
    _, simulation = play(scene, "compiled")
    assert not is_compiled(simulation, "a", "springs")
    (line,) = [line for line in said if "controllers with the law update_springs run in the interpreter" in line]
    assert text in line


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('array("d", ', 'array("f", ', "the numbers of its parts() are not a writable block of doubles"),
        ('array("d", [0.0, 0.0, 0.0])', "[0.0, 0.0, 0.0]", "a bytes-like object is required, not 'list'"),
        ("        return Parts(", "        raise ValueError('no parts')\n        return Parts(", "no parts"),
        ("        return Parts(", "        1 / (self.updates < 4)\n        return Parts(", "division"),
        ("return Parts((self.told,), members=list", "return Parts((self.told,), members=iter", "has no len()"),
        ("self.set_point, self.error = 0.3, 0.0", "self.set_point, self.error = 0.3, None", "error"),
    ],
)
def test_a_controller_whose_parts_cannot_be_used_runs_in_the_interpreter_and_it_is_said(
    tmp_path: Path, old: str, new: str, text: str
) -> None:
    scene, said = changed_scene(tmp_path, old, new)
    (plain, _), (compiled, simulation) = (play(scene, engine) for engine in ("plain", "compiled"))
    assert compiled == plain
    assert is_compiled(simulation, "a", "states")
    assert not is_compiled(simulation, "a", "springs")
    (line,) = [line for line in said if "controller 'springs' runs in the interpreter: " in line]
    assert text in line


@pytest.mark.parametrize("trouble", [FileNotFoundError("no such file"), RuntimeError("it is not what it should be")])
def test_a_law_whose_code_is_gone_or_broken_runs_in_the_interpreter_and_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trouble: Exception
) -> None:
    path = tmp_path / "springs.py"
    path.write_text(LAW.replace("DAMPING = 30.0, 2.5", f"DAMPING = 30.0, {uuid4().int % 10**6 / 10**6}"))  # a new law
    said: list[str] = []
    loaded = object_file.loaded

    def load(place: Path, names: list[str]) -> Any:
        if place.name.startswith("law-"):
            raise trouble
        return loaded(place, names)

    def scene(simulation: Simulation) -> None:
        simulation.graph.log.sink = lambda *line: said.append(line[2])
        scene_of(path)(simulation)

    monkeypatch.setattr(object_file, "loaded", load)
    plain, _ = play(scene, "plain")
    for _ in ("when it has been compiled", "when it was compiled before"):
        said.clear()
        compiled, simulation = play(scene, "compiled")
        assert compiled == plain
        assert not is_compiled(simulation, "a", "springs")
        assert f"controllers with the law update_springs run in the interpreter: {trouble}" in said


def test_other_laws_are_what_they_were_when_a_file_takes_the_type_of_a_built_in_controller(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text("""
from slidectl.control import Controller, EffortJointInterface, controller

@controller("diff_drive_controller/DiffDriveController")
class Mine(Controller):
    interface_type = EffortJointInterface

    def init(self, interface, node):
        self.joint = interface.get_handle("joint3")

    def update(self, time_ns, period_s):
        self.joint.command = self.joint.position
""")

    def scene(simulation: Simulation) -> None:
        simulation.types.add_module(str(path))
        controllers = usual() | {"three": {"type": "diff_drive_controller/DiffDriveController"}}
        add(simulation, "a", arm(), controllers)
        simulation.step(100)

    (plain, _), (compiled, simulation) = (play(scene, engine) for engine in ("plain", "compiled"))
    assert compiled == plain
    assert is_compiled(simulation, "a", "one")
    assert not is_compiled(simulation, "a", "three")
