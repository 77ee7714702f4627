"""How the gateway of ROS 2 starts, with which options, and what it says where it cannot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from daemon_fixture import Runtime, running_daemon
from ros2_environment import folder_of, free_domain
from ros2_node import running_node
from waiting import eventually

from slidectl.extensions.gateways.ros2.ros2_topics import _MOST_ECHOES, Echoes

FLOAT = "std_msgs/msg/Float64"


@pytest.fixture(scope="module")
def runtime() -> Iterator[Runtime]:
    with running_daemon(rtf=1.0) as one:
        yield one


def slidectl(runtime: Runtime, *words: str, programs: Path | None = None, **environment: str) -> tuple[int, str]:
    """Exit code and all output of slidectl, of this environment or of another one."""
    command = [str(programs / "python") if programs else sys.executable, "-m", "slidectl", *words]
    env = {**runtime.env, **environment}
    result = subprocess.run(command, env=env, capture_output=True, text=True, timeout=240)
    return result.returncode, result.stdout + result.stderr


@pytest.mark.skipif(find_spec("rclpy") is not None, reason="rclpy is installed here")
def test_without_rclpy_it_says_what_to_do(runtime: Runtime) -> None:
    code, text = slidectl(runtime, "gateway", "ros2", "start")
    assert code == 1
    assert "rclpy, ROS 2's client for Python, is not here" in text
    assert "source a ROS 2 first" in text
    assert "[ros2]" in text


def test_an_rclpy_for_another_python_is_named(runtime: Runtime, tmp_path: Path) -> None:
    package = tmp_path / "rclpy"
    (package / "impl").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "impl" / "__init__.py").touch()
    failure = 'raise ImportError("no module _rclpy_pybind11")\n'
    (package / "impl" / "implementation_singleton.py").write_text(failure, "utf-8")
    (package / "_rclpy_pybind11.cpython-399-x86_64-linux-gnu.so").touch()
    path = os.pathsep.join([str(tmp_path), runtime.env["PYTHONPATH"]])
    code, text = slidectl(runtime, "gateway", "ros2", "start", PYTHONPATH=path)
    ours = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert code == 1
    assert f"rclpy in {tmp_path} is for Python 3.99, and slidectl runs with Python {ours}" in text
    assert "python3.99 -m venv" in text


@pytest.mark.parametrize(
    ("words", "environment", "code", "part"),
    [
        (["gateway", "ros2", "--domain", "233"], {}, 2, "232"),
        (
            ["gateway", "ros2", "start"],
            {"ROS_DOMAIN_ID": "seven"},
            2,
            "ROS_DOMAIN_ID=seven is not a number from 0 to 232",
        ),
        (["daemon", "start", "--ros2", "500"], {}, 2, "232"),
    ],
)
def test_a_domain_that_is_none_is_refused(
    runtime: Runtime, words: list[str], environment: dict[str, str], code: int, part: str
) -> None:
    found, text = slidectl(runtime, *words, **environment)
    assert (found, part in text) == (code, True), text


def test_a_middleware_that_is_not_there_is_named(runtime: Runtime) -> None:
    programs = folder_of("kilted")
    code, text = slidectl(runtime, "gateway", "ros2", "start", programs=programs, RMW_IMPLEMENTATION="rmw_nothing_cpp")
    assert code == 1
    assert "RMW_IMPLEMENTATION is rmw_nothing_cpp: install it, or unset the variable" in text
    assert slidectl(runtime, "gateway", "ros2", "status", programs=programs)[0] == 1


def test_chosen_topics_and_reading_alone(runtime: Runtime) -> None:
    programs = folder_of("kilted")
    with free_domain() as domain, runtime.client() as client:
        client.spawn("slider", controllers="config/slider_control.yaml", start=["joint1_position_controller"])
        words = ["gateway", "ros2", "start", "--domain", str(domain), "--read-only", "--topics", "/slider/*"]
        code, text = slidectl(runtime, *words, programs=programs)
        assert code == 0, text
        assert f"ROS_DOMAIN_ID={domain} (rmw_fastrtps_cpp, this machine only)" in text
        try:
            with running_node(programs, "/reader", domain, runtime.env) as node:
                eventually(lambda: "/slider/joint1_position_controller" in node.nodes())
                assert "/clock" not in node.topics()
                assert "/gazebo/pause_physics" not in node.services()
                node.advertise("/slider/joint1_position_controller/command", FLOAT)
                node.advertise("/slider/mine", FLOAT)
                node.subscribe("/slider/seen", FLOAT)
                eventually(lambda: "/slider/seen" in client.topics())
                assert node.subscribers("/slider/joint1_position_controller/command") == 0
                assert "/slider/mine" not in client.topics()
        finally:
            slidectl(runtime, "gateway", "ros2", "stop", programs=programs)


def test_the_daemon_starts_it_in_a_domain(tmp_path: Path) -> None:
    programs, runtime = folder_of("kilted"), Runtime(tmp_path)
    with free_domain() as domain:
        try:
            code, text = slidectl(runtime, "daemon", "start", "--ros2", str(domain), "--json", programs=programs)
            assert code == 0, text
            started = [json.loads(line) for line in text.splitlines()]
            assert started[1]["kind"] == "ros2"
            assert started[1]["address"].startswith(f"ROS_DOMAIN_ID={domain} ")
            _, text = slidectl(runtime, "daemon", "start", "--ros2", str(domain), programs=programs)
            assert f"the ros2 gateway runs already, so domain {domain} had no effect" in text
        finally:
            slidectl(runtime, "daemon", "stop", programs=programs)
    assert not list(runtime.paths.folder.glob("gateway-ros2.lock"))


def test_echoes_are_expected_as_often_as_they_were_sent() -> None:
    echoes = Echoes()
    for _ in range(3 * _MOST_ECHOES):
        echoes.expect(1)
        assert echoes.came(1)
        assert not echoes.came(1)
    for key in range(2 * _MOST_ECHOES):
        echoes.expect(key)
    assert not echoes.came(_MOST_ECHOES - 1)
    assert all(echoes.came(key) for key in range(_MOST_ECHOES, 2 * _MOST_ECHOES))
    assert not echoes.are_expected
