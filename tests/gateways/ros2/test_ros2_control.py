"""The real spawner, unspawner and hardware_spawner of ros2_control beside a robot of ROS 2 and one of ROS 1."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from message_packages import message_packages
from ros2_environment import DISTRIBUTIONS, ROOT, folder_of
from ros2_node import Ros2Node
from ros2_world import World, running_world
from waiting import eventually

HERE = Path(__file__).parent
CLIENTS, HARDWARE = HERE / "clients", HERE / "ros2_hardware.py"
MANAGER = "/arm/controller_manager"
STATES, POSITION = "joint_state_controller", "joint1_position_controller"
RUN = "import sys; from controller_manager.{0} import main; sys.exit(main())"


@pytest.fixture(scope="module", params=list(DISTRIBUTIONS))
def world(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """The slider, with its controllers running, and `arm`, the same robot as one of ROS 2, with none loaded."""
    programs, folder = folder_of(request.param), tmp_path_factory.mktemp("arm")
    text = (ROOT / "models" / "slider.xacro").read_text("utf-8")
    model = folder / "arm.xacro"
    model.write_text(text.replace("gazebo_ros_control/DefaultRobotHWSim", "ros2_hardware/Ros2Hardware"), "utf-8")
    controllers = folder / "arm.yaml"
    controllers.write_text((ROOT / "config" / "slider_control.yaml").read_text("utf-8").replace("slider:", "arm:"))
    with running_world(programs, message_packages(programs), imports=(str(HARDWARE),)) as one:
        one.env["ROS_HOME"] = str(folder)
        one.run("spawn", str(model), "-n", "arm", "--at", "3", "0", "0", "--controllers", str(controllers))
        yield one


@pytest.fixture(scope="module")
def node(world: World) -> Iterator[Ros2Node]:
    with world.node("/test/listener") as one:
        yield one


@pytest.fixture(autouse=True)
def _none_loaded(world: World) -> Iterator[None]:
    yield
    with world.client() as client:
        manager = client.controllers("/arm")
        manager.unspawn(*manager.states())


def start(world: World, program: str, *words: str) -> subprocess.Popen[str]:
    env = {**world.env, "PYTHONPATH": f"{CLIENTS}:{world.env['PYTHONPATH']}", "PYTHONUNBUFFERED": "1"}
    command = [str(world.programs / "python"), "-c", RUN.format(program), *words]
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def run(world: World, program: str, *words: str, manager: str = MANAGER, code: int = 0) -> str:
    """Run a program of ros2_control to its end. Returns its output."""
    process = start(world, program, *words, "-c", manager)
    text, _ = process.communicate(timeout=240)
    assert process.returncode == code, text
    return text


def states(world: World, robot: str = "/arm") -> dict[str, str]:
    with world.client() as client:
        return client.controllers(robot).states()


def call(node: Ros2Node, service: str, kind: str, **values: Any) -> Any:
    return node.call(f"{MANAGER}/{service}", f"controller_manager_msgs/srv/{kind}", values)


def test_the_spawner_loads_configures_and_activates(world: World) -> None:
    assert "Configured and activated" in run(world, "spawner", STATES)
    assert states(world) == {STATES: "active"}
    assert "already loaded" in run(world, "spawner", STATES, code=1)
    run(world, "spawner", POSITION, "--load-only")
    assert states(world)[POSITION] == "unconfigured"
    run(world, "spawner", POSITION, "--inactive")
    assert states(world)[POSITION] == "inactive"
    run(world, "unspawner", STATES)
    assert states(world) == {POSITION: "inactive"}


def test_the_spawner_activates_a_group_in_one_switch(world: World) -> None:
    assert "all the parsed controllers" in run(world, "spawner", STATES, POSITION, "--activate-as-group")
    assert states(world) == {STATES: "active", POSITION: "active"}


def test_a_spawner_that_is_refused_exits_with_1(world: World) -> None:
    assert "Failed loading controller" in run(world, "spawner", "nope", code=1)
    assert "parameter /arm/nope/type is not set" in world.log


def test_a_spawner_that_is_ended_unloads_its_controllers(world: World) -> None:
    process = start(world, "spawner", STATES, "--unload-on-kill", "-c", MANAGER)
    eventually(lambda: states(world) == {STATES: "active"})
    eventually(lambda: world.runtime.pid is not None)
    process.send_signal(signal.SIGINT)
    text, _ = process.communicate(timeout=240)
    assert process.returncode == 0, text
    assert states(world) == {}


def test_a_type_that_is_set_at_the_manager_is_that_of_the_controller(world: World, node: Ros2Node) -> None:
    value = {"type": 4, "string_value": "joint_state_broadcaster/JointStateBroadcaster"}
    request = {"parameters": [{"name": "extra_states.type", "value": value}]}
    answer = node.call(f"{MANAGER}/set_parameters", "rcl_interfaces/srv/SetParameters", request)
    assert answer["results"][0]["successful"]
    run(world, "spawner", "extra_states", "--inactive")
    assert states(world) == {"extra_states": "inactive"}
    names = ["extra_states.type"]
    answer = node.call(f"{MANAGER}/get_parameters", "rcl_interfaces/srv/GetParameters", {"names": names})
    assert answer["values"][0]["string_value"] == value["string_value"]


def test_a_file_of_parameters_needs_the_permission_to_read_files(world: World, tmp_path: Path) -> None:
    file = tmp_path / "more.yaml"
    file.write_text("""
hold:
  ros__parameters: {type: effort_controllers/JointPositionController, joint: joint1, pid.p: 50.0}
""")
    text = run(world, "spawner", "hold", "-p", str(file), code=1)
    assert 'Could not set controller param "params_file"' in text
    world.run("gateway", "ros2", "stop")
    try:
        world.run("gateway", "ros2", "start", "--allow", "files")
        run(world, "spawner", "hold", "-p", str(file))
    finally:
        world.run("gateway", "ros2", "stop")
        world.run("gateway", "ros2", "start")
    assert states(world) == {"hold": "active"}
    with world.client() as client:
        assert client.params.get("/arm/hold/pid/p") == 50.0


def test_the_lists_have_what_ros2_control_shows(world: World, node: Ros2Node) -> None:
    run(world, "spawner", STATES, POSITION, "--inactive")
    run(world, "spawner", "--controller-manager-timeout", "60", POSITION, code=0)
    listed = {one["name"]: one for one in call(node, "list_controllers", "ListControllers")["controller"]}
    assert {name: one["state"] for name, one in listed.items()} == {STATES: "inactive", POSITION: "active"}
    one = listed[POSITION]
    assert one["claimed_interfaces"] == one["required_command_interfaces"] == ["joint1/effort"]
    assert "joint1/position" in one["required_state_interfaces"]
    assert one["update_rate"] == 1000
    [component] = call(node, "list_hardware_components", "ListHardwareComponents")["component"]
    assert component["state"] == {"id": 3, "label": "active"}
    found = call(node, "list_hardware_interfaces", "ListHardwareInterfaces")
    assert found["command_interfaces"] == [
        {"name": "joint1/effort", "data_type": "double", "is_available": True, "is_claimed": True}]  # fmt: skip
    assert "active" in run(world, "hardware_spawner", component["name"], "--activate")
    assert not call(node, "set_hardware_component_state", "SetHardwareComponentState", name=component["name"],
                    target_state={"id": 2})["ok"]  # fmt: skip
    assert call(node, "reload_controller_libraries", "ReloadControllerLibraries", force_kill=True)["ok"]
    assert states(world) == {}


def test_a_switch_answers_as_in_ros2_control(world: World, node: Ros2Node) -> None:
    def switch(*names: str, strictness: int) -> Any:
        return call(node, "switch_controller", "SwitchController", activate_controllers=list(names),
                    strictness=strictness)  # fmt: skip

    run(world, "spawner", POSITION, "--load-only")
    refused = switch(POSITION, strictness=2)
    assert not refused["ok"]
    assert f"slidectl controller configure {POSITION}" in refused["message"]
    assert switch(POSITION, strictness=1)["ok"]
    assert states(world) == {POSITION: "unconfigured"}
    assert call(node, "configure_controller", "ConfigureController", name=POSITION)["ok"]
    assert switch("nope", POSITION, strictness=1)["ok"]
    assert not call(node, "cleanup_controller", "CleanupController", name=POSITION)["ok"]


def test_activity_reaches_who_comes_later(world: World) -> None:
    run(world, "spawner", STATES)
    with world.node("/late") as late:
        late.subscribe(f"{MANAGER}/activity", "controller_manager_msgs/msg/ControllerManagerActivity", "transient")
        active = [{"name": STATES, "state": {"id": 3, "label": "active"}}]
        message = late.gets(f"{MANAGER}/activity", lambda one: one["controllers"] == active)
    assert message["hardware_components"][0]["state"]["label"] == "active"


def test_a_manager_has_each_service_once(node: Ros2Node) -> None:
    own = {"load_controller", "unload_controller", "switch_controller", "list_controllers", "list_controller_types",
           "reload_controller_libraries", "configure_controller"}  # fmt: skip
    more = {"cleanup_controller", "list_hardware_components", "list_hardware_interfaces",
            "set_hardware_component_state"}  # fmt: skip

    def offered(manager: str) -> set[str]:
        names = {name.removeprefix(f"{manager}/") for name in node.services() if name.startswith(f"{manager}/")}
        return {name for name in names if "parameter" not in name}

    eventually(lambda: offered(MANAGER) == own | more)
    eventually(lambda: offered("/slider/controller_manager") == own)


def test_the_spawner_and_the_unspawner_finish_beside_a_robot_of_ros_1(world: World) -> None:
    manager = "/slider/controller_manager"
    assert "Failed to configure" in run(world, "spawner", POSITION, manager=manager, code=1)  # it is running
    run(world, "unspawner", POSITION, manager=manager)
    assert POSITION not in states(world, "/slider")
    run(world, "spawner", POSITION, manager=manager)
    assert states(world, "/slider")[POSITION] == "running"
