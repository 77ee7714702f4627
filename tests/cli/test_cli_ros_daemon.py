"""The ROS commands when the daemon goes away under them: at once, in one breath, with exit code 3."""

from __future__ import annotations

import os
import signal

import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon

# The command, and the stream and the line of it that say that it is at work.
STAYING = [
    ("rostopic echo -p /clock", "stdout", 1),
    ("rostopic echo /not/yet", "stderr", 1),
    ("rostopic hz /clock", "stdout", 1),
    ("rostopic hz /not/yet", "stderr", 1),
    ("rostopic bw /clock", "stdout", 1),
    ("rostopic pub -r 10 /t std_msgs/Float64 1.0", "stderr", 1),
    ("rostopic pub -l /t std_msgs/Float64 1.0", "stderr", 1),
    ("rosnode ping /gazebo", "stdout", 3),
    ("rosrun controller_manager spawner --no-timeout controller", "stdout", 1),
    ("rosrun tf2_ros static_transform_publisher 0 0 0 0 0 0 a b", "stdout", 1),
]


@pytest.mark.parametrize(("line", "stream", "lines"), STAYING, ids=[line for line, *_ in STAYING])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=["killed", "stopped"])
def test_a_command_notices_that_the_daemon_has_gone(line: str, stream: str, lines: int, number: int) -> None:
    with running_daemon() as daemon:
        staying = CommandLine(daemon.folder).start("ros", *line.split())
        assert all(getattr(staying, stream).readline() for _ in range(lines))
        assert daemon.pid is not None
        os.kill(daemon.pid, number)
        _, stderr = staying.communicate(timeout=30)
    assert staying.returncode == 3
    assert stderr.splitlines()[0] == "ERROR: Unable to communicate with master!"
    assert "the daemon went away" in stderr


def test_a_waiting_call_notices_it_too() -> None:
    with running_daemon() as daemon:
        calling = CommandLine(daemon.folder).start("ros", "rosservice", "call", "--wait", "/not/yet")
        with daemon.client() as client:
            while client.call("/slidectl/status")["connections"] < 2:
                assert calling.poll() is None
        assert daemon.stop() is not None
        assert calling.communicate(timeout=30)[1].startswith("ERROR: Unable to communicate with master!\n")
    assert calling.returncode == 3
