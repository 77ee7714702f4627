"""`slidectl service` at a real daemon."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator

import pytest
from cli_graph_world import World, slider_world
from daemon_fixture import send

MANAGER = "/slider/controller_manager"


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as made:
        yield made


def test_list_prints_sorted_names_below_a_namespace(world: World) -> None:
    names = world.slidectl.ok("service", "list").splitlines()
    assert names == sorted(names)
    assert {f"{MANAGER}/list_controllers", "/gazebo/spawn_urdf_model", "/rosapi/topics"} <= set(names)
    assert world.slidectl.ok("service", "list", f"{MANAGER}/list_controllers") == f"{MANAGER}/list_controllers\n"
    assert world.slidectl.ok("service", "list", "/nope") == ""


def test_list_n_prints_the_nodes_too(world: World) -> None:
    printed = world.slidectl.ok("service", "list", "-n", f"{MANAGER}/list_controllers")
    assert printed == f"{MANAGER}/list_controllers /gazebo\n"
    row = json.loads(world.slidectl.ok("service", "list", "-n", f"{MANAGER}/list_controllers", "--json"))
    assert row == {"service": f"{MANAGER}/list_controllers", "node": "/gazebo"}


def test_info_prints_the_four_lines_of_rosservice_and_the_effects(world: World) -> None:
    uri = f"unix://{world.daemon.paths.socket}"
    assert world.slidectl.ok("service", "info", "list_controllers") == (
        f"Node: /gazebo\nURI: {uri}\nType: controller_manager_msgs/ListControllers\nArgs: \nEffects: reads\n"
    )
    record = json.loads(world.slidectl.ok("service", "info", "load_controller", "--json"))
    assert record == {
        "service": f"{MANAGER}/load_controller", "node": "/gazebo", "uri": uri,
        "type": "controller_manager_msgs/LoadController", "args": ["name"], "effects": ["writes"],
    }  # fmt: skip


def test_type_args_uri_and_find(world: World) -> None:
    assert world.slidectl.ok("service", "type", "load_controller") == "controller_manager_msgs/LoadController\n"
    args = "start_controllers stop_controllers strictness start_asap timeout\n"
    assert world.slidectl.ok("service", "args", "switch_controller") == args
    assert world.slidectl.ok("service", "args", "list_controllers") == "\n"
    assert world.slidectl.ok("service", "args", "set_model_state").startswith(
        "model_state.model_name model_state.pose.position.x "
    )
    assert world.slidectl.ok("service", "uri", "load_controller") == f"unix://{world.daemon.paths.socket}\n"
    found = world.slidectl.ok("service", "find", "controller_manager_msgs/LoadController")
    assert found == f"{MANAGER}/load_controller\n"
    assert world.slidectl.ok("service", "find", "std_srvs/Nope") == ""


def test_call_prints_the_response_as_rosservice_does(world: World) -> None:
    printed = world.slidectl.ok("service", "call", f"{MANAGER}/list_controllers")
    assert printed.startswith(
        'controller: \n  - \n    name: "joint_state_controller"\n    state: "running"\n'
        '    type: "joint_state_controller/JointStateController"\n    claimed_resources: \n      - \n'
    )
    assert printed.endswith("        resources: \n          - joint1\n")


def test_call_as_json_is_one_object(world: World) -> None:
    record = json.loads(world.slidectl.ok("service", "call", "list_controllers", "--json"))
    assert [controller["state"] for controller in record["controller"]] == ["running", "running"]


@pytest.mark.parametrize(
    "values",
    [
        ["{start_controllers: ['joint1_position_controller'], stop_controllers: [], strictness: 1}"],
        ["[joint1_position_controller]", "[]", "1", "false", "0"],
        ['{"start_controllers": ["joint1_position_controller"], "strictness": 1}'],
    ],
)
def test_values_of_a_call_come_by_name_or_one_for_each_field(world: World, values: list[str]) -> None:
    assert world.slidectl.ok("service", "call", "switch_controller", *values) == "ok: True\n"


def test_the_tutorials_line_loads_a_controller(world: World) -> None:
    parameters = "{type: effort_controllers/JointEffortController, joint: joint1}"
    world.slidectl.ok("param", "set", "/slider/other_controller", parameters)
    printed = world.slidectl.ok("service", "call", f"{MANAGER}/load_controller", "name: 'other_controller'")
    assert printed == "ok: True\n"
    assert world.slidectl.ok("service", "call", "unload_controller", "other_controller") == "ok: True\n"


def test_a_false_ok_is_exit_code_1_with_the_reason_from_rosout(world: World) -> None:
    done = world.slidectl("service", "call", "load_controller", "nope")
    assert (done.returncode, done.stdout) == (1, "ok: False\n")
    assert f"error: {MANAGER}/load_controller answered ok: false" in done.stderr
    assert "/slider/nope/type" in done.stderr


def test_a_false_success_is_exit_code_1_with_its_message(world: World) -> None:
    done = world.slidectl("service", "call", "/gazebo/get_model_state", "model_name: nope")
    assert done.returncode == 1
    assert "success: False\n" in done.stdout
    assert "no robot 'nope'" in done.stderr


def test_stdin_gives_one_call_for_each_document(world: World) -> None:
    texts = "model_name: slider\n---\nmodel_name: nope\n"
    done = world.slidectl("service", "call", "/gazebo/get_model_state", "--stdin", "--json", stdin=texts)
    assert done.returncode == 1
    assert [json.loads(line)["success"] for line in done.stdout.splitlines()] == [True, False]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["call", "load_controler", "x"], 1, f"Did you mean '{MANAGER}/load_controller'?"),
        (["info", "nope"], 1, "no service 'nope'"),
        (["type", "/nope"], 1, "no service '/nope'"),
        (["args", "nope"], 1, "no service 'nope'"),
        (["uri", "nope"], 1, "no service 'nope'"),
        (["call", "load_controller"], 2, "the request has the fields: name"),
        (["call", "load_controller", "value: x"], 2, "no field 'value'"),
        (["call", "load_controller", "a", "b"], 2, "too many arguments: 2 given, 1 expected"),
        (["call", "load_controller", "5"], 2, "name must be text (string)"),
        (["call", "switch_controller", "[a]"], 2, "not enough arguments: 1 given, 5 expected"),
        (["call", "switch_controller", "{strictness: x}"], 2, "strictness must be"),
        (["call", "list_controllers", "1"], 2, "too many arguments"),
        (["call", "load_controller", "data: [1"], 2, "not valid YAML"),
        (["call", "load_controller", "x", "--stdin"], 2, "a VALUE and --stdin exclude each other"),
        (["call", "/slidectl/sleep", "1000", "--timeout", "0.3"], 4, "within 0.3 s"),
        (["call"], 2, "Missing argument"),
        (["bogus"], 2, "no command 'bogus'"),
    ],
)
def test_errors_say_what_is_wrong(world: World, words: list[str], code: int, said: str) -> None:
    done = world.slidectl("service", *words)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert done.stdout == ""


def test_a_name_that_two_robots_have_is_exit_code_2() -> None:
    with slider_world() as world:
        world.spawn("other")
        done = world.slidectl("service", "call", "list_controllers")
        assert done.returncode == 2
        assert f"{MANAGER}/list_controllers" in done.stderr
        assert "/other/controller_manager/list_controllers" in done.stderr
        world.slidectl.ok("service", "call", "other/controller_manager/list_controllers")


def take_call(world: World) -> None:
    """Return when the daemon has passed on a call of `/mine/slow`, which nobody answers."""
    assert any(event["op"] == "call_service" for event in world.client.events(30))


def test_ctrl_c_ends_a_waiting_call_with_exit_code_130(world: World) -> None:
    send(world.client, op="advertise_service", service="/mine/slow", type="std_srvs/Empty")
    world.client.flush()
    with world.running("service", "call", "/mine/slow") as process:
        take_call(world)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == 130
    send(world.client, op="unadvertise_service", service="/mine/slow")
    world.client.flush()


def test_a_daemon_that_dies_during_a_call_is_exit_code_3() -> None:
    with slider_world() as world:
        send(world.client, op="advertise_service", service="/mine/slow", type="std_srvs/Empty")
        world.client.flush()
        with world.running("service", "call", "/mine/slow") as process:
            take_call(world)
            assert world.daemon.pid is not None
            os.kill(world.daemon.pid, signal.SIGKILL)
            _, errors = process.communicate(timeout=20)
        assert process.returncode == 3
        assert "the daemon went away" in errors
