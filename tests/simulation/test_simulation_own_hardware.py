"""Simulated hardware that users write: named by `robotSimType`, and what becomes of its faults."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from engine_scenes import add
from sim_robots import cart, switch

from slidectl.control import registry
from slidectl.description import gazebo_tags
from slidectl.entry_points import Part
from slidectl.errors import SlidectlError
from slidectl.simulation import Simulation
from slidectl.simulation.compiled.object_file import is_possible

HARDWARE = '''
from slidectl.control import RobotHW
from slidectl.physics import MujocoRobotHW

class Half(MujocoRobotHW):
    """Gives half of what is asked."""

    def write(self, time_ns, period_s):
        super().write(time_ns, period_s)
        self.set_joint_effort("joint1", self.joint_effort("joint1") / 2.0)

class Careless(MujocoRobotHW):
    def init(self, node):
        self.offset = float("unknown")

class Fragile(MujocoRobotHW):
    def read(self, time_ns, period_s):
        super().read(time_ns, period_s)
        if time_ns == 5_000_000:
            raise ValueError("the encoder is gone")

class Leaving(MujocoRobotHW):
    leaves = ""

    def leave(self, hook):
        if Leaving.leaves == hook:
            raise SystemExit(3)

    def write(self, time_ns, period_s):
        super().write(time_ns, period_s)
        self.leave("write")

    def reset(self):
        super().reset()
        self.leave("reset")

    def prepare_switch(self, start, stop):
        self.leave("prepare_switch")
        return True

    def do_switch(self, start, stop):
        self.leave("do_switch")

class Bare(RobotHW):
    pass
'''


def of(kind: str) -> str:
    return cart(f"<robotSimType>{kind}</robotSimType>")


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "odd_hw.py"
    path.write_text(HARDWARE)
    return str(path)


def test_hardware_of_a_module_drives_the_robots_that_name_it_beside_compiled_ones(file: str) -> None:
    simulation = Simulation(ground=False, imports=[file])
    push = {"push": {"type": "effort_controllers/JointEffortController", "joint": "joint1"}}
    for name, xml in (("cart", of("odd_hw/Half")), ("other", cart())):
        add(simulation, name, xml, push)
        simulation.step(2)
        simulation.publish(f"/{name}/push/command", {"data": 8.0})
    simulation.step(100)
    assert [simulation.world.joint_state(name, "joint1")[2] for name in ("cart", "other")] == [4.0, 8.0]


def test_hardware_of_an_installed_package_is_found_by_its_entry_point(
    file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(file).parent))
    points = {"odd/Half": Part(gazebo_tags.HARDWARE.group, "odd/Half", "odd_hw:Half", "odd-hardware", "1.0")}
    monkeypatch.setattr(registry, "installed_hardware", lambda: points)
    simulation = Simulation(ground=False)
    simulation.spawn(of("odd/Half"), "cart")
    assert type(simulation.robots.get("cart").hardware).__name__ == "Half"


def test_two_simulations_of_one_process_import_the_same_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "imported_twice.py").write_text(
        "from slidectl.control import Controller, EffortJointInterface\n\n\nclass Twice(Controller):\n"
        "    interface_type = EffortJointInterface\n\n    def update(self, time_ns, period_s):\n        pass\n"
    )
    for _ in range(2):
        simulation = Simulation(imports=["imported_twice"])
        assert "imported_twice/Twice" in simulation.types.types()
    assert "imported_twice/Twice" not in Simulation().types.types()


def test_a_module_with_nothing_but_a_base_for_hardware_has_none(tmp_path: Path) -> None:
    path = tmp_path / "base_hw.py"
    path.write_text("from slidectl.physics import MujocoRobotHW\n\nclass _Base(MujocoRobotHW):\n    pass\n")
    with pytest.raises(SlidectlError, match="it defines no controller and no hardware"):
        Simulation(imports=[str(path)])


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("odd_hw/Hlaf", "no robotSimType 'odd_hw/Hlaf'. Did you mean 'odd_hw/Half'?"),
        ("odd_hw/Careless", "robotSimType odd_hw/Careless: ValueError"),
        ("odd_hw/Bare", "odd_hw/Bare is not derived from slidectl.physics.MujocoRobotHW"),
    ],
)
def test_hardware_that_cannot_be_refuses_the_spawn_and_leaves_nothing(file: str, kind: str, why: str) -> None:
    simulation = Simulation(ground=False, imports=[file])
    with pytest.raises(SlidectlError) as error:
        simulation.spawn(of(kind), "cart")
    assert why in str(error.value)
    assert not list(simulation.robots)
    assert simulation.world.names() == []


@pytest.mark.parametrize(
    "engine",
    ["plain", pytest.param("compiled", marks=pytest.mark.skipif(not is_possible(), reason="numba is not installed"))],
)
def test_an_exception_in_a_cycle_holds_the_world_and_says_where(file: str, engine: str) -> None:
    simulation = Simulation(ground=False, imports=[file], engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    simulation.spawn(cart(), "other")
    simulation.driven = True
    simulation.spawn(of("odd_hw/Fragile"), "cart")
    simulation.resume()
    simulation.step(20)
    trouble = simulation.call("/slidectl/status")["trouble"]
    assert "Fragile.read: ValueError: the encoder is gone" in trouble
    assert "odd_hw.py:20" in trouble
    assert simulation.call("/slidectl/status")["paused"]
    assert simulation.cycles == 5
    simulation.delete("cart")
    simulation.resume()
    simulation.step(20)
    assert simulation.cycles == 25


def test_an_exit_in_a_hook_is_an_error_with_its_place_and_ends_nothing(file: str) -> None:
    simulation = Simulation(ground=False, imports=[file])
    robot = simulation.spawn(of("odd_hw/Leaving"), "cart")
    kind: Any = type(robot.hardware)
    simulation.parameters.set("/cart/push", {"type": "effort_controllers/JointEffortController", "joint": "joint1"})
    simulation.call("/cart/controller_manager/load_controller", {"name": "push"})
    for hook, state in (("prepare_switch", "initialized"), ("do_switch", "aborted")):
        kind.leaves = hook
        reasons: list[str] = []
        with simulation.graph.log.answering(reasons):
            assert not switch(simulation, start=["push"])
        assert re.search(r"hardware Leaving: SystemExit: 3 \(.*odd_hw.py:27\)", "".join(reasons))
        assert robot.manager.list()[0]["state"] == state
    for hook, act in (("reset", simulation.reset_world), ("write", simulation.step)):
        kind.leaves = hook
        with pytest.raises(SlidectlError, match=r"SystemExit: 3 \(.*odd_hw.py:27\)"):
            act()
    kind.leaves = ""
    assert switch(simulation, start=["push"])
    assert simulation.step(3) == 3
    kind.leaves = "do_switch"
    assert not switch(simulation, stop=["push"])
    assert robot.manager.list()[0]["state"] == "running"
