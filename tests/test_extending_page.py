"""The examples of docs/extending.md work as the page says."""

from __future__ import annotations

import math
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from daemon_fixture import running_daemon
from installed_package import WORKSHOP
from pip_installed import install

from slidectl import Simulation, description
from slidectl.simulation.compiled import object_file

ROOT = Path(__file__).parent.parent
PARTS = ("commands", "udp_gateway", "clearance_sensor", "still_step")
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def example(section: str, file: Path) -> Path:
    """The Python text of a section of the page, written to a file."""
    [text] = [part for part in (ROOT / "docs" / "extending.md").read_text(encoding="utf-8").split("\n## ")
              if part.startswith(f"{section}\n")]  # fmt: skip
    file.write_text("\n".join(BLOCK.findall(text)), encoding="utf-8")
    return file


@pytest.mark.parametrize("file", ["pyproject.toml", *(f"slidectl_workshop/{name}.py" for name in PARTS)])
def test_the_page_shows_the_package_of_the_examples(file: str) -> None:
    """Which tests/cli/test_cli_installed_packages.py uses."""
    text = (WORKSHOP / file).read_text(encoding="utf-8")
    assert text in (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")


@pytest.fixture
def laws(tmp_path: Path) -> Path:
    return example("A controller of your own", tmp_path / "my_laws.py")


def sliding(name: str, file: Path, class_name: str, engine: str = "auto") -> Simulation:
    """The slider, driven by a class of a file."""
    simulation = Simulation(engine=engine)
    simulation.spawn(description.load("slider").xml, "slider")
    simulation.parameters.set(f"/slider/{name}/joint", "joint1")
    request = {"robot": "slider", "name": name, "file": str(file), "class_name": class_name}
    assert simulation.call("/slidectl/load_controller_file", request)["ok"]
    switch = {"start_controllers": [name], "strictness": 2}
    assert simulation.call("/slider/controller_manager/switch_controller", switch)["ok"]
    if engine == "compiled":
        simulation.engine.complete()
    simulation.publish(f"/slider/{name}/command", {"data": 0.5})
    return simulation


def position(simulation: Simulation) -> float:
    [robot] = simulation.call("/slidectl/list_robots")["robots"]
    [found] = [joint["position"] for joint in robot["joints"] if joint["name"] == "joint1"]
    return float(found)


def test_the_controller_moves_the_slider_to_its_set_point(laws: Path) -> None:
    simulation = sliding("spring", laws, "Spring")
    simulation.step(5000)
    assert abs(position(simulation) - 0.5) < 0.05


def test_a_class_that_holds_a_file_says_itself_what_a_snapshot_saves(laws: Path) -> None:
    file = example("The state of a class of your own", laws.with_name("my_logging.py"))
    file.write_text(file.read_text(encoding="utf-8").replace("/tmp/", f"{laws.parent}/"), encoding="utf-8")
    simulation = sliding("spring", file, "LoggingSpring")
    simulation.step(1000)
    simulation.save("here")
    here = position(simulation)
    simulation.publish("/slider/spring/command", {"data": -0.5})
    simulation.step(4000)
    simulation.load("here")
    assert position(simulation) == here
    simulation.step(4000)
    assert abs(position(simulation) - 0.5) < 0.05


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_the_compiled_controller_gives_the_same_bits(tmp_path: Path) -> None:
    file = example("Machine code for a controller of your own", tmp_path / "my_laws.py")
    plain, compiled = (sliding("spring", file, "QuickSpring", engine) for engine in ("plain", "compiled"))
    for simulation in (plain, compiled):
        simulation.step(5000)
    assert position(plain) == position(compiled)
    assert abs(position(plain) - 0.5) < 0.05
    times = compiled.call("/slidectl/update_times", {"robot": "slider"})["controllers"]
    assert [one["compiled"] for one in times] == [True]


def test_the_service_holds_the_slider_where_it_is(laws: Path) -> None:
    file = example("A service of your own", laws.with_name("my_services.py"))
    simulation = sliding("held_spring", file, "HeldSpring")
    simulation.step(1000)
    answer = simulation.call("/slider/held_spring/hold")
    here = position(simulation)
    assert answer == {"success": True, "message": f"holds {here:.3f} m"}
    simulation.step(5000)
    assert abs(position(simulation) - here) < 0.05 < abs(here - 0.5)


def test_the_gateway_hands_commands_on_and_sends_positions_back(laws: Path) -> None:
    file = example("A gateway of your own", laws.with_name("udp_gateway.py"))
    with running_daemon(rtf=10.0) as daemon, daemon.environment(), daemon.client() as client:
        client.spawn("slider", controllers=ROOT / "config" / "slider_control.yaml", start=["joint_state_controller"])
        client.params.set_all({"/slider/spring/joint": "joint1"})
        client.controllers("/slider").load_file("spring", str(laws))
        client.controllers("/slider").start(["spring"])
        words = [sys.executable, str(file), "0", "/slider/spring/command", "/slider/joint_states"]
        with subprocess.Popen(words, env=daemon.env, stdout=subprocess.PIPE, text=True) as gateway:
            assert gateway.stdout is not None
            port = int(gateway.stdout.readline())
            with socket.socket(type=socket.SOCK_DGRAM) as udp:
                udp.settimeout(30)
                udp.connect(("127.0.0.1", port))
                udp.send(b"far")
                assert udp.recv(1000) == b"error: could not convert string to float: b'far'"
                udp.send(b"0.5")
                while abs(float(udp.recv(1000)) - 0.5) > 0.05:
                    pass
            gateway.terminate()


def test_the_hardware_lets_efforts_follow_with_its_time_constant(tmp_path: Path) -> None:
    file = example("A robot hardware of your own", tmp_path / "my_hardware.py")
    simulation = Simulation(imports=[str(file)])
    xml = description.load("slider").xml.replace("gazebo_ros_control/DefaultRobotHWSim", "my_hardware/SlowMotors")
    effort = {"type": "effort_controllers/JointEffortController", "joint": "joint1"}
    simulation.parameters.set("/slider", {"motor_time_constant": 0.1, "push": effort})
    simulation.spawn(xml, "slider")
    assert simulation.call("/slider/controller_manager/load_controller", {"name": "push"})["ok"]
    switch = {"start_controllers": ["push"], "strictness": 2}
    assert simulation.call("/slider/controller_manager/switch_controller", switch)["ok"]
    simulation.publish("/slider/push/command", {"data": 10.0})
    for seconds in (0.1, 0.2):
        simulation.step(100)
        effort = simulation.world.joint_state("slider", "joint1")[2]
        assert abs(effort - 10.0 * (1.0 - math.exp(-seconds / 0.1))) < 0.1
    simulation.reset_world()
    simulation.step(1)
    assert simulation.world.joint_state("slider", "joint1")[2] < 0.2


def test_the_page_shows_the_feature_that_is_among_the_examples() -> None:
    [text] = [part for part in (ROOT / "docs" / "extending.md").read_text(encoding="utf-8").split("\n## ")
              if part.startswith("A feature of your own\n")]  # fmt: skip
    for kind, name in (("toml", "pyproject.toml"), ("python", "spawn_counter.py")):
        shown = re.findall(rf"^```{kind}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        assert shown == [(ROOT / "examples" / "spawn_counter" / name).read_text(encoding="utf-8")]


def test_a_world_has_the_feature_of_an_installed_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(ROOT / "examples" / "spawn_counter", tmp_path / "site")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    with running_daemon() as daemon, daemon.environment(), daemon.client() as client:
        client.spawn("slider")
        assert client.subscribe("/slidectl/spawn_counter/count").get()["data"] == 1
        answer = client.call("/slidectl/spawn_counter/forget")
        assert answer == {"success": True, "message": "1 spawns forgotten"}
