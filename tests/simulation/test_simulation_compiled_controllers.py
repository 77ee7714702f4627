"""Controllers of several joints, compiled: the same bits as the interpreter in the midst of what happens to a robot."""

from __future__ import annotations

from random import Random

import pytest
from engine_scenes import GAINS, Scene, add, arm, play, switch
from sim_robots import STATES

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

pytestmark = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")

JOINTS = ["joint1", "joint2", "joint3"]


def is_compiled(simulation: Simulation, robot: str, name: str) -> bool:
    """Does machine code update that controller now?"""
    simulation.step(20)
    cycles = simulation.engine.compiled
    assert cycles is not None
    rows = cycles._rows_of[simulation.robots.get(robot)]
    updates = [update.__self__ for update in rows.updates]  # type: ignore[attr-defined]
    position = updates.index(simulation.robots.get(robot).manager.get(name))
    return rows.fits() and position not in rows.interpreted


def assert_same(scene: Scene) -> Simulation:
    """Play it on both, stepped by a script and driven. Returns the compiled one."""
    for driven in (False, True):
        (plain, _), (compiled, simulation) = (play(scene, engine, driven) for engine in ("plain", "compiled"))
        assert compiled == plain
    return simulation


GROUPS = {
    "effort_controllers/JointGroupPositionController": {joint: {"pid": GAINS} for joint in JOINTS},
    "effort_controllers/JointGroupEffortController": {},
    "velocity_controllers/JointGroupVelocityController": {},
    "position_controllers/JointGroupPositionController": {},
}


@pytest.mark.parametrize("kind", GROUPS)
def test_a_group_of_joints(kind: str) -> None:
    def scene(simulation: Simulation) -> None:
        dice = Random(kind)
        own = {"type": kind, "joints": ["joint2", "joint3", "joint1"], **GROUPS[kind]}
        interface = kind.partition("_")[0].title()
        add(simulation, "a", arm(interface=interface), {"states": {"type": STATES, "publish_rate": 80}, "group": own})
        simulation.heard.listen("/a/joint_states")  # type: ignore[attr-defined]
        for k in range(12):
            simulation.publish("/a/group/command", {"data": [dice.uniform(-1.5, 1.5) for _ in JOINTS]})
            simulation.step(dice.choice((3, 60, 200)))
            if k == 6:
                switch(simulation, "a", stop=["group"])
                switch(simulation, "a", start=["group"])

    simulation = assert_same(scene)
    assert is_compiled(simulation, "a", "group")


def test_a_pid_that_publishes_each_step_leaves_its_group_to_the_interpreter() -> None:
    own = {"type": "effort_controllers/JointGroupPositionController", "joints": JOINTS}
    pids = {joint: {"pid": {**GAINS, "publish_state": joint == "joint2"}} for joint in JOINTS}

    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), {"group": {**own, **pids}})
        simulation.heard.listen("/a/group/joint2/pid/state")  # type: ignore[attr-defined]
        simulation.step(200)

    assert_same(scene)
