"""The services and topics of `/gazebo`, as gazebo_ros_api_plugin has them, on this world.

One file per subject. All of them answer `success: false` with the reason where Gazebo does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.simulation.gazebo import efforts, joints, links, models, running, spawning, states

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


def advertise(simulation: Simulation) -> None:
    """Provide all of them."""
    for subject in (spawning, models, links, joints, efforts, running, states):
        subject.advertise(simulation)
