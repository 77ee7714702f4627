"""One robot's part of a control cycle: read, update, limits and write, in the order of gazebo_ros_control.

The hot path of the whole program. Knows no physics engine and no clients; times are integer nanoseconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.duration import to_seconds
from slidectl.control.laws import law

if TYPE_CHECKING:
    from slidectl.control.controller_manager import ControllerManager
    from slidectl.control.hardware_interface import RobotHW


@law
def control_is_due(cycle: ControlCycle, time_ns: int) -> bool:
    """Do the controllers run in the cycle at this time? Then `period_s` is what has passed since they last did."""
    elapsed = time_ns - cycle.last_update_ns
    if elapsed < cycle.control_period_ns:
        return False
    cycle.last_update_ns = time_ns
    if elapsed != cycle.period_ns:
        cycle.period_ns = elapsed
        cycle.period_s = to_seconds(elapsed)
    return True


@law
def begin_to_write(cycle: ControlCycle, time_ns: int) -> float:
    """The seconds since the hardware was last written."""
    elapsed = time_ns - cycle.last_write_ns
    cycle.last_write_ns = time_ns
    if elapsed != cycle.write_period_ns:
        cycle.write_period_ns = elapsed
        cycle.write_period_s = to_seconds(elapsed)
    return cycle.write_period_s


class ControlCycle:
    """Calls the hardware and the controller manager of one robot as GazeboRosControlPlugin::Update does.

    Controllers run when `control_period_ns` has passed since they last did; the hardware is written in every cycle.
    """

    __slots__ = (
        "_read",
        "_update",
        "_was_stopped",
        "_write",
        "control_period_ns",
        "emergency_stop",
        "last_update_ns",
        "last_write_ns",
        "period_ns",
        "period_s",
        "write_period_ns",
        "write_period_s",
    )

    def __init__(self, hardware: RobotHW, manager: ControllerManager, control_period_ns: int, time_ns: int) -> None:
        """`time_ns` is now. Counted from 0, the first period of a newcomer would be the whole time of the world."""
        self._read = hardware.read
        self._update = manager.update
        self._write = hardware.write
        self.control_period_ns = control_period_ns
        self.emergency_stop = False
        self._was_stopped = False
        self.rewind(time_ns)

    @property
    def is_stopped(self) -> bool:
        """True while controllers feel an emergency stop, or its end."""
        return self.emergency_stop or self._was_stopped

    def rewind(self, time_ns: int) -> None:
        """The next cycle's periods are counted from this time."""
        self.last_update_ns = self.last_write_ns = time_ns
        self.period_ns = self.write_period_ns = 0
        self.period_s = self.write_period_s = 0.0

    def run(self, time_ns: int) -> None:
        """The cycle at `time_ns`, before the physics makes its step."""
        if control_is_due(self, time_ns):
            self._read(time_ns, self.period_s)
            if self.emergency_stop or self._was_stopped:
                self._update(time_ns, self.period_s, not self.emergency_stop)
                self._was_stopped = self.emergency_stop
            else:
                self._update(time_ns, self.period_s)
        self.write(time_ns)

    def write(self, time_ns: int) -> None:
        """The end of the cycle at `time_ns`: limits and commands."""
        self._write(time_ns, begin_to_write(self, time_ns))
