"""A command that is not finite aborts its controller. The world and the other robots go on, on both engines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from engine_scenes import GAINS, KINDS, POSITION, add, arm, play
from sim_robots import states_of, switch

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

JOINTS = ["joint1", "joint2", "joint3"]
HUGE = 1e308
ENDLESS = {"p": HUGE, "d": HUGE}
WHEELS = {
    "type": "diff_drive_controller/DiffDriveController",
    "left_wheel": "joint1",
    "right_wheel": "joint2",
    "wheel_separation": 0.4,
    "wheel_radius": 0.001,
    "pose_covariance_diagonal": [0.001] * 6,
    "twist_covariance_diagonal": [0.001] * 6,
}
SERVO = {"type": POSITION, "joint": "joint1", "pid": GAINS}


def moved(*positions: float) -> dict[str, Any]:
    """A trajectory message that takes all joints to these positions within 20 ms."""
    time = {"secs": 0, "nsecs": 20_000_000}
    rest = [0.0] * len(positions)
    return {
        "joint_names": JOINTS,
        "points": [{"positions": positions, "velocities": rest, "accelerations": rest, "time_from_start": time}],
    }


def tell(topic: str, **message: Any) -> Callable[[Simulation], None]:
    """Publish a message to the controller."""
    return lambda simulation: simulation.publish(f"/a/bad/{topic}", message)


def with_gains(place: str, then: Callable[[Simulation], None]) -> Callable[[Simulation], None]:
    """Set gains whose sum overflows, then command a motion."""

    def act(simulation: Simulation) -> None:
        for name, value in ENDLESS.items():
            simulation.parameters.set(f"/a/bad/{place}/{name}", value)
        then(simulation)

    return act


CASES: dict[str, tuple[str, dict[str, Any], Callable[[Simulation], None]]] = {
    "one joint with a PID": ("Effort", SERVO, with_gains("pid", tell("command", data=2.4))),
    "a group with PIDs": (
        "Effort",
        {
            "type": "effort_controllers/JointGroupPositionController",
            "joints": JOINTS,
            **{joint: {"pid": GAINS} for joint in JOINTS},
        },
        with_gains("joint1/pid", tell("command", data=[2.4, 0.0, 0.0])),
    ),
    "a trajectory with PIDs": (
        "Effort",
        {
            "type": "effort_controllers/JointTrajectoryController",
            "joints": JOINTS,
            "gains": dict.fromkeys(JOINTS, GAINS),
        },
        with_gains("gains/joint1", tell("command", **moved(2.4, 0.0, 0.0))),
    ),
    "two wheels": ("Velocity", WHEELS, tell("cmd_vel", linear={"x": HUGE}, angular={"z": HUGE})),
}


@pytest.mark.parametrize(
    "engine",
    [
        "plain",
        pytest.param(
            "compiled", marks=pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
        ),
    ],
)
@pytest.mark.parametrize("case", CASES)
def test_only_the_controller_whose_command_is_not_finite_is_aborted(case: str, engine: str) -> None:
    interface, own, act = CASES[case]
    lines: list[str] = []

    def scene(simulation: Simulation) -> None:
        xml = arm(3 * ("continuous",) if interface == "Velocity" else KINDS, interface=interface)
        if interface == "Velocity":  # without limits, which would clip an infinite velocity
            xml = xml.replace('<limit effort="30" velocity="9"/>', "")
        add(simulation, "a", xml, {"bad": own})
        add(simulation, "b", arm(), {"good": SERVO})
        simulation.step(50)
        simulation.graph.log.sink = lambda _severity, _node, text, _time: lines.append(text)
        simulation.publish("/b/good/command", {"data": 0.3})
        act(simulation)
        simulation.step(3000)

    _, simulation = play(scene, engine)
    assert states_of(simulation, "/a") == {"bad": "aborted"}
    assert states_of(simulation, "/b") == {"good": "running"}
    failed = [line for line in lines if "controller 'bad' failed in update and is aborted" in line]
    assert len(failed) == 1
    assert "its command of joint 'joint" in failed[0]
    assert simulation.world.joint_state("b", "joint1")[0] == pytest.approx(0.3, abs=0.05)


def test_an_aborted_controller_starts_again_with_gains_that_can_be_added() -> None:
    interface, own, act = CASES["one joint with a PID"]
    simulation = Simulation(ground=False, engine="plain")
    add(simulation, "a", arm(interface=interface), {"bad": own})
    simulation.step(50)
    act(simulation)
    simulation.step(500)
    assert states_of(simulation, "/a") == {"bad": "aborted"}
    for name in ("p", "d"):
        simulation.parameters.set(f"/a/bad/pid/{name}", GAINS[name])
    assert switch(simulation, start=["bad"], namespace="/a")
    simulation.publish("/a/bad/command", {"data": 0.3})
    simulation.step(3000)
    assert states_of(simulation, "/a") == {"bad": "running"}
    assert simulation.world.joint_state("a", "joint1")[0] == pytest.approx(0.3, abs=0.05)
