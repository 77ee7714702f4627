"""Robots whose state is no number any more: they are held at rest, and the others go on as if nothing had been."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from slidectl.client import spawning
from slidectl.physics import Diverged
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")


def world_of(engine: str, names: tuple[str, ...], strict: bool = False) -> Simulation:
    """RRBot is `bad`, the others are carts on their wheels, whose contacts pass wrong numbers on; after 300 cycles."""
    simulation = Simulation(engine=engine, strict=strict)
    if engine == "compiled":
        simulation.engine.complete()
    for number, name in enumerate(names):
        add(simulation, name, 5.0 * number)
    simulation.step(300)
    return simulation


def add(simulation: Simulation, name: str, at_m: float) -> None:
    document = spawning.document("rrbot" if name == "bad" else "cart", {}, name)
    simulation.spawn(document.xml, name, f"/{name}", ((0.0, at_m, 0.1), (0.0, 0.0, 0.0, 1.0)))


def state(simulation: Simulation, robot: str) -> bytes:
    body = simulation.world.robot(robot)
    data = simulation.world.data
    return bytes(data.qpos[body.coordinates].tobytes() + data.qvel[body.dofs].tobytes())


def blow_up(simulation: Simulation, robot: str, effort: float) -> None:
    joint = next(iter(simulation.world.robot(robot).joints))
    simulation.call(
        "/gazebo/apply_joint_effort",
        {"joint_name": f"{robot}::{joint}", "effort": effort, "duration": {"secs": -1, "nsecs": 0}},
    )


@pytest.mark.parametrize("engine", ["plain", pytest.param("compiled", marks=needs_numba)])
@pytest.mark.parametrize("effort", [1e9, 1e30, 1e150, 1e300, -1e300])
def test_the_others_go_on_with_the_same_bits(engine: str, effort: float) -> None:
    whole, with_a_bad_one = world_of(engine, ("bad", "good")), world_of(engine, ("bad", "good"))
    blow_up(with_a_bad_one, "bad", effort)
    for _ in range(20):
        assert whole.step(50) == with_a_bad_one.step(50) == 50
        assert state(whole, "good") == state(with_a_bad_one, "good")
    assert with_a_bad_one.call("/slidectl/status")["frozen"] == ["bad"]
    assert with_a_bad_one.call("/slidectl/status")["trouble"] == ""
    held = state(with_a_bad_one, "bad")
    with_a_bad_one.step(100)
    assert state(with_a_bad_one, "bad") == held
    assert all(math.isfinite(number) for number in with_a_bad_one.world.data.qpos)
    robots = {one["name"]: one["frozen"] for one in with_a_bad_one.call("/slidectl/list_robots")["robots"]}
    assert robots == {"bad": True, "good": False}


@needs_numba
def test_both_engines_freeze_in_the_same_cycle_at_the_same_place() -> None:
    ends = []
    for engine in ("plain", "compiled"):
        simulation = world_of(engine, ("bad", "good"))
        blow_up(simulation, "bad", 1e12)
        simulation.step(333)
        ends.append((state(simulation, "bad"), state(simulation, "good")))
    assert ends[0] == ends[1]


def test_the_log_names_it_once() -> None:
    simulation = world_of("plain", ("bad", "good"))
    lines: list[str] = []
    simulation.graph.log.sink = lambda severity, _node, text, _time: lines.append(f"{severity} {text}")
    blow_up(simulation, "bad", 1e20)
    simulation.step(1000)
    text = "the simulation of robot 'bad' diverged: its state is not finite or huge; it is frozen, and the others go on"
    assert [line for line in lines if "diverged" in line] == [f"fatal {text}"]


def test_a_reset_brings_it_back_and_a_deletion_takes_it_out() -> None:
    fresh, simulation = world_of("plain", ("bad", "good")), world_of("plain", ("bad", "good"))
    blow_up(simulation, "bad", 1e20)
    simulation.step(100)
    for one in (fresh, simulation):
        one.reset_simulation()
        one.step(200)
    assert simulation.world.frozen == []
    assert state(fresh, "bad") == state(simulation, "bad")
    blow_up(simulation, "bad", 1e20)
    simulation.step(100)
    simulation.delete("bad")
    assert simulation.world.frozen == []
    assert simulation.step(100) == 100


def test_another_robot_may_come_while_one_is_frozen() -> None:
    simulation = world_of("plain", ("bad", "good"))
    blow_up(simulation, "bad", 1e20)
    simulation.step(100)
    held = state(simulation, "bad")
    add(simulation, "new", 20.0)
    assert simulation.step(100) == 100
    assert (simulation.world.frozen, state(simulation, "bad")) == (["bad"], held)


def test_a_snapshot_of_before_brings_it_back_and_one_of_after_holds_it(tmp_path: Path) -> None:
    simulation = world_of("plain", ("bad", "good"))
    simulation.call("/slidectl/save", {"name": "before"})
    blow_up(simulation, "bad", 1e20)
    simulation.step(100)
    simulation.call("/slidectl/save", {"name": "after", "file": str(tmp_path / "after")})
    held = state(simulation, "bad")
    simulation.call("/slidectl/load", {"name": "before"})
    assert simulation.world.frozen == []
    simulation.step(100)
    simulation.call("/slidectl/load", {"file": str(tmp_path / "after")})
    assert simulation.world.frozen == ["bad"]
    simulation.step(100)
    assert state(simulation, "bad") == held


def test_a_strict_world_stops(tmp_path: Path) -> None:  # noqa: ARG001
    simulation = world_of("plain", ("bad", "good"), strict=True)
    blow_up(simulation, "bad", 1e20)
    with pytest.raises(Diverged, match="'bad'"):
        simulation.step(1000)
    assert simulation.world.frozen == []
