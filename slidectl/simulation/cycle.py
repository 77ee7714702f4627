"""One robot's part of a control cycle: read, update, limits and write, in the order of gazebo_ros_control.

The hot path of the whole program. Knows no physics engine and no clients; times are integer nanoseconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.duration import to_seconds

if TYPE_CHECKING:
    from slidectl.control.manager import ControllerManager
    from slidectl.control.robot_hw import RobotHW


class ControlCycle:
    """Calls the hardware and the controller manager of one robot as GazeboRosControlPlugin::Update does.

    Controllers run when `control_period_ns` has passed since they last did; the hardware is written in every cycle.
    """

    __slots__ = (
        "_last_update_ns",
        "_last_write_ns",
        "_period_ns",
        "_period_s",
        "_read",
        "_update",
        "_was_stopped",
        "_write",
        "_write_period_ns",
        "_write_period_s",
        "control_period_ns",
        "emergency_stop",
    )

    def __init__(self, hardware: RobotHW, manager: ControllerManager, control_period_ns: int) -> None:
        self._read = hardware.read
        self._update = manager.update
        self._write = hardware.write
        self.control_period_ns = control_period_ns
        self.emergency_stop = False
        self._was_stopped = False
        self.rewind(0)

    def rewind(self, time_ns: int) -> None:
        """The next cycle's periods are counted from this time."""
        self._last_update_ns = self._last_write_ns = time_ns
        self._period_ns = self._write_period_ns = 0
        self._period_s = self._write_period_s = 0.0

    def run(self, time_ns: int) -> None:
        """The cycle at `time_ns`, before the physics makes its step."""
        elapsed = time_ns - self._last_update_ns
        if elapsed >= self.control_period_ns:
            self._last_update_ns = time_ns
            if elapsed != self._period_ns:
                self._period_ns = elapsed
                self._period_s = to_seconds(elapsed)
            self._read(time_ns, self._period_s)
            if self.emergency_stop or self._was_stopped:
                self._update(time_ns, self._period_s, not self.emergency_stop)
                self._was_stopped = self.emergency_stop
            else:
                self._update(time_ns, self._period_s)
        elapsed = time_ns - self._last_write_ns
        self._last_write_ns = time_ns
        if elapsed != self._write_period_ns:
            self._write_period_ns = elapsed
            self._write_period_s = to_seconds(elapsed)
        self._write(time_ns, self._write_period_s)
