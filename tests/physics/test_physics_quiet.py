"""Trouble in the engine is an error with a name, never a line on the console or a file in the folder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from physics_robots import arm, at, block, one_joint, state_of

from slidectl.physics import Diverged, EngineError, World, pop_warnings

REPOSITORY = Path(__file__).resolve().parents[2]

RUNAWAY = """
from physics_robots import one_joint
from slidectl.physics import Diverged, World, pop_warnings
world = World()
world.attach(one_joint(), "one")
world.data.qfrc_applied[:] = float("inf")
for _ in range(10):
    world.step()
try:
    world.check()
except Diverged as error:
    assert error.robot == "one"
    assert any("unstable" in warning for warning in pop_warnings())
else:
    raise SystemExit("not seen")
"""


def test_a_runaway_prints_nothing_and_writes_no_file(tmp_path: Path) -> None:
    path = f"{REPOSITORY}:{Path(__file__).parent}"
    done = subprocess.run(
        [sys.executable, "-c", RUNAWAY], cwd=tmp_path, env={"PYTHONPATH": path}, capture_output=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e12])
def test_the_robot_that_diverged_is_named_and_the_others_go_on(value: float) -> None:
    world = World()
    world.attach(one_joint(), "sane")
    world.attach(one_joint(), "mad")
    world.check()
    place = world.robot("mad").place("joint1")
    world.data.qvel[place.dof] = value
    for _ in range(3):
        world.step()
    with pytest.raises(Diverged, match="the simulation of robot 'mad' diverged"):
        world.check()
    alone = World()
    alone.attach(one_joint(), "sane")
    for _ in range(3):
        alone.step()
    assert state_of(world, "sane") == state_of(alone, "sane")


def test_a_reset_brings_a_diverged_robot_back() -> None:
    world = World()
    world.attach(arm(2, reach=1.0), "arm")
    world.data.qvel[:] = float("nan")
    for _ in range(3):
        world.step()
    world.reset()
    for _ in range(100):
        world.step()
    world.check()
    fresh = World()
    fresh.attach(arm(2, reach=1.0), "arm")
    for _ in range(100):
        fresh.step()
    assert state_of(world, "arm") == state_of(fresh, "arm")
    pop_warnings()


def test_more_contacts_than_the_engine_can_hold_are_an_error_that_a_reset_survives() -> None:
    world = World(ground=False)
    world.attach(block(), "alone", at(50.0, 0.0, 0.0))
    for number in range(40):
        world.attach(arm(3), f"arm{number}")
    for _ in range(2):
        try:
            world.step()
        except EngineError:
            world.reset()
        else:
            pytest.skip("this version of MuJoCo has the memory for it")
    for number in range(40):
        world.detach(f"arm{number}")
    for _ in range(100):
        world.step()
    assert world.link_pose("alone", "base")[0][2] == pytest.approx(-0.05, abs=0.01)
