"""The shipped car drives as its commands say, and its odometry tells where it is in the world."""

from __future__ import annotations

from math import atan2, cos, pi, sin
from pathlib import Path
from typing import Any

import pytest
import yaml

from slidectl import Simulation, description

CONFIG = Path(__file__).parent.parent.parent / "config" / "car_control.yaml"
SECONDS = 4.0


class Car:
    """The car in a world of its own."""

    def __init__(self) -> None:
        self.simulation = Simulation()
        self.simulation.spawn(description.load("car").xml, "car")
        tree = yaml.safe_load(CONFIG.read_text())
        for name, value in tree["car"].items():
            self.simulation.parameters.set(f"/car/{name}", value)
        manager = "/car/controller_manager"
        assert self.simulation.call(f"{manager}/load_controller", {"name": "base_controller"})["ok"]
        start = {"start_controllers": ["base_controller"], "strictness": 2}
        assert self.simulation.call(f"{manager}/switch_controller", start)["ok"]
        self.odom: dict[str, Any] = {}
        self.simulation.subscribe("/car/base_controller/odom", self.odom.update)

    def drive(self, topic: str, command: dict[str, Any]) -> None:
        for _ in range(round(SECONDS / 0.1)):
            self.simulation.publish(f"/car/base_controller/{topic}", command)
            self.simulation.step(100)

    def place(self) -> tuple[float, float, float]:
        """In the world: x, y, heading."""
        return _place(self.simulation.call("/gazebo/get_model_state", {"model_name": "car"})["pose"])


def _place(pose: dict[str, Any]) -> tuple[float, float, float]:
    position, turn = pose["position"], pose["orientation"]
    return position["x"], position["y"], 2 * atan2(turn["z"], turn["w"])


@pytest.mark.parametrize(
    ("topic", "command", "place"),
    [
        ("cmd_vel", {"linear": {"x": 0.5}, "angular": {"z": 0.4}}, (1.25 * sin(1.6), 1.25 * (1 - cos(1.6)), 1.6)),
        (
            "cmd_four_wheel_steering",
            {"speed": 0.5, "front_steering_angle": pi / 4, "rear_steering_angle": pi / 4},
            (2.0 * cos(pi / 4), 2.0 * sin(pi / 4), 0.0),
        ),
    ],
)
def test_the_car_goes_where_it_is_driven_and_knows_it(topic: str, command: dict, place: tuple) -> None:
    car = Car()
    car.drive(topic, command)
    # It takes half a second to get to its speed, and meanwhile it loses 0.125 m, or turns less.
    assert car.place() == pytest.approx(place, abs=0.2)
    assert _place(car.odom["pose"]["pose"]) == pytest.approx(car.place(), abs=0.03)


def test_after_a_reset_the_car_stands_where_it_was_spawned_and_knows_it() -> None:
    car = Car()
    car.drive("cmd_vel", {"linear": {"x": 0.5}, "angular": {"z": 0.4}})
    car.simulation.call("/gazebo/reset_simulation")
    car.simulation.step(600)
    assert car.place() == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert _place(car.odom["pose"]["pose"]) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
