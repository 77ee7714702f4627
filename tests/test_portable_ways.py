"""The daemon, its clients and launches by the ways that other systems than Linux have too: see operating_system.py."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from daemon_fixture import running_daemon

from slidectl.operating_system import PORTABLE

ROOT = Path(__file__).parent.parent
TESTS = {
    "the wire": ["tests/daemon/test_daemon_wire.py", "tests/daemon/test_daemon_outbox.py"],
    "clients": [
        "tests/client/test_client_connection.py",
        "tests/client/test_client_delivery.py",
        "tests/daemon/test_daemon_graph_changes.py",
        "tests/daemon/test_daemon_long_lines.py",
    ],
    "life cycles": [
        "tests/daemon/test_daemon_lifecycle.py",
        "-k=(running or signal or stop or hangs or kill or private or foreground or two_starts) and not deleted",
        "tests/cli/test_cli_ros_core.py",
    ],
    "processes": [
        "tests/launch/test_launch_supervision.py",
        "tests/daemon/test_daemon_meshes.py",
        "tests/daemon/test_daemon_pictures.py::test_the_status_and_the_log_say_who_draws[software]",
        "tests/test_writing.py",
        "tests/test_input_files.py",
    ],
}


@pytest.mark.parametrize("what", TESTS)
def test_the_portable_ways_do_what_those_of_linux_do(what: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *TESTS[what]],
        cwd=ROOT, env={**os.environ, PORTABLE: "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def test_the_variable_reaches_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told by the name of a client's node, which has the process id that Linux alone tells."""
    for value, is_known in (("1", False), ("0", True)):
        monkeypatch.setenv(PORTABLE, value)
        with running_daemon(paused=True) as runtime, runtime.client() as client:
            client.advertise("/mine", "std_msgs/String")
            [node] = client.call("/rosapi/publishers", {"topic": "/mine"})["publishers"]
            assert node.startswith(f"/slidectl_{os.getpid() if is_known else 0}_")
