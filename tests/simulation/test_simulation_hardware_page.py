"""The table of docs/hardware.md of what joints do when nobody moves them is what they do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from engine_scenes import add, arm, switch

from slidectl.control import Controller, NodeHandle
from slidectl.control.hardware_interface import COMMAND_INTERFACES
from slidectl.control.registry import controller
from slidectl.description import interfaces
from slidectl.simulation import Simulation

PAGE = Path(__file__).parent.parent.parent / "docs" / "hardware.md"
HEADER = "| after | effort | velocity | position, also with velocity |\n"
COLUMNS = {"Effort": 0, "Velocity": 1, "Position": 2, "PosVel": 2, "PosVelAcc": 2}
"""Interfaces, and the columns of the table after the first."""
COMMANDS = {"Effort": 2.0, "Velocity": 0.3, "Position": 0.4, "PosVel": 0.4, "PosVelAcc": 0.4}


def table() -> dict[str, list[str]]:
    """The cells of each row by its first one."""
    text = PAGE.read_text(encoding="utf-8").partition(HEADER)[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[1:]]
    return {first: cells for first, *cells in rows}


def forwarding(interface: Any) -> type[Any]:
    """A controller as the shipped ones that forward commands, with a topic on which a message makes it fail."""

    class Forwarding(Controller[Any]):
        interface_type = interface
        is_broken = False

        def init(self, handles: Any, node: NodeHandle) -> None:
            self.joint = handles.get_handle("joint1")
            self.set_point = 0.0
            node.subscribe("command", "std_msgs/Float64", self.take)
            node.subscribe("break", "std_msgs/Float64", lambda _: setattr(self, "is_broken", True))

        def take(self, message: dict[str, Any]) -> None:
            self.set_point = message["data"]

        def starting(self, time_ns: int) -> None:  # noqa: ARG002
            self.set_point = self.joint.position if interface.declared.quantity == "position" else 0.0

        def update(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002
            if self.is_broken:
                raise ZeroDivisionError("a fault of the user's")
            self.joint.command = self.set_point

    return Forwarding


for declared in interfaces.ALL:
    controller(f"page/{declared.name}")(forwarding(COMMAND_INTERFACES[declared]))


def rest(simulation: Simulation, command: str) -> bool:
    request = {"robot": "a", "controllers": ["drive"], "command": command}
    switch(simulation, "a", stop=["drive"])
    simulation.step(2)
    return bool(simulation.call("/slidectl/rest_joints", request)["success"])


def estop(simulation: Simulation, stop: bool) -> None:
    assert simulation.call("/slidectl/estop", {"stop": stop})["success"]
    simulation.step(5)


def stop(simulation: Simulation) -> None:
    switch(simulation, "a", stop=["drive"])


def unload(simulation: Simulation) -> None:
    stop(simulation)
    simulation.step(2)
    assert simulation.call("/a/controller_manager/unload_controller", {"name": "drive"})["ok"]


def fail(simulation: Simulation) -> None:
    simulation.publish("/a/drive/break", {"data": 1.0})
    simulation.step(1)
    [loaded] = simulation.call("/a/controller_manager/list_controllers")["controller"]
    assert loaded["state"] == "aborted"


def release(simulation: Simulation) -> None:
    estop(simulation, True)
    estop(simulation, False)


BROKEN = "an exception in the controller"
EVENTS: dict[str, Callable[[Simulation], bool | None]] = {
    "a controller stops": stop,
    "a controller stops, `--zero`": lambda simulation: rest(simulation, "zero"),
    "a controller stops, `--hold`": lambda simulation: rest(simulation, "hold"),
    "a controller is stopped and unloaded": unload,
    BROKEN: fail,
    "estop": lambda simulation: estop(simulation, True),
    "estop and its release": release,
    "a reset of the world": lambda simulation: simulation.reset_world(),
}
SPAWN = "the spawn, before any controller"


def seen(simulation: Simulation, interface: str, there: float) -> set[str]:
    """All that can be said of what the joint does now, with a word of the table."""
    position, _, _ = simulation.world.joint_state("a", "joint1")
    simulation.step(100)
    later, velocity, effort = simulation.world.joint_state("a", "joint1")
    says = {
        "free": interface == "Effort" and effort == 0.0,
        "keeps the effort": interface == "Effort" and effort == pytest.approx(COMMANDS["Effort"]),
        "stands still": abs(later - position) < 1e-3 and abs(velocity) < 1e-3,
        "keeps the velocity": velocity == pytest.approx(COMMANDS["Velocity"], abs=0.01),
        "stays there": abs(later - there) < 3e-3,
        "goes to 0": abs(later) < 3e-3,
    }
    return {text for text, is_so in says.items() if is_so}


@pytest.mark.parametrize("gains", [{}, {"p": 4000.0, "d": 60.0}], ids=["without gains", "with gains"])
@pytest.mark.parametrize("interface", COLUMNS)
@pytest.mark.parametrize("event", [SPAWN, *EVENTS])
def test_a_joint_does_what_the_table_says(event: str, interface: str, gains: dict[str, float]) -> None:
    expected = table()[event][COLUMNS[interface]]
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), ground=False, engine="plain")
    if gains:
        own = gains if interface != "Velocity" else {"p": 200.0}
        simulation.parameters.set("/a/gazebo_ros_control/pid_gains/joint1", own)
    xml = arm(("revolute",), interface=interface).replace('effort="30"', 'effort="3000"')
    if event == SPAWN:
        simulation.spawn(xml, "a")
        simulation.step(10)
        assert expected in seen(simulation, interface, 0.0)
        return
    kind = f"page/{interface}JointInterface"
    if event != BROKEN and interface in ("Effort", "Velocity", "Position"):
        kind = f"{interface.lower()}_controllers/Joint{interface}Controller"
    add(simulation, "a", xml, {"drive": {"type": kind, "joint": "joint1"}})
    simulation.step(2)
    simulation.publish("/a/drive/command", {"data": COMMANDS[interface]})
    simulation.step(600)
    there = simulation.world.joint_state("a", "joint1")[0]
    done = EVENTS[event](simulation)
    assert (done is False) == (expected == "refused")
    if done is not False:
        simulation.step(20)
        assert expected in seen(simulation, interface, there)


def test_the_table_has_just_these_rows_and_words() -> None:
    rows = table()
    assert list(rows) == [SPAWN, *EVENTS]
    words = {cell for cells in rows.values() for cell in cells}
    assert words == {
        "free",
        "keeps the effort",
        "stands still",
        "keeps the velocity",
        "stays there",
        "goes to 0",
        "refused",
    }
