"""`slidectl controller` with a real daemon. Its world is shared by the tests, so each cleans up."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine

STATES = "joint_state_controller"
POSITION = "joint1_position_controller"


@pytest.fixture(autouse=True)
def _empty_again(world: CommandLine) -> Iterator[None]:
    yield
    for record in map(json.loads, world.ok("controller", "list", "--json").splitlines()):
        world("controller", "unspawn", record["name"], "--cm", record["manager"])
    names = [json.loads(line)["name"] for line in world.ok("robots", "--json").splitlines()]
    if names:
        world.ok("delete", *names)
    with world.client() as client:
        for top in {name.split("/")[1] for name in client.call("/rosapi/get_param_names")["names"]}:
            client.call("/rosapi/delete_param", {"name": f"/{top}"})


@pytest.fixture
def slider(world: CommandLine) -> CommandLine:
    """A world with one slider whose controllers are configured, not loaded."""
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml")
    return world


@pytest.fixture
def rrbot(world: CommandLine) -> CommandLine:
    """A world with RRBot, its controllers configured."""
    world.ok("spawn", "rrbot", "--controllers", "config/rrbot_control.yaml")
    return world


def states(world: CommandLine, *words: str) -> dict[str, str]:
    """`manager name` -> state, of every controller that is listed."""
    records = map(json.loads, world.ok("controller", "list", "--json", *words).splitlines())
    return {f"{record['manager']} {record['name']}": record["state"] for record in records}


def test_spawn_loads_and_starts(slider: CommandLine) -> None:
    text = slider.ok("controller", "spawn", STATES, POSITION)
    assert text == f"{STATES}: running (was unloaded)\n{POSITION}: running (was unloaded)\n"
    assert states(slider) == {f"/slider {STATES}": "running", f"/slider {POSITION}": "running"}


def test_spawn_of_what_runs_already_says_so_and_is_success(slider: CommandLine) -> None:
    slider.ok("controller", "spawn", STATES)
    assert slider.ok("controller", "spawn", STATES) == f"{STATES}: running already\n"
    record = json.loads(slider.ok("controller", "spawn", STATES, "--json"))
    assert record == {"manager": "/slider", "name": STATES, "state": "running", "before": "running"}


def test_the_steps_of_a_life_one_by_one(slider: CommandLine) -> None:
    for verb, state in (("load", "initialized"), ("start", "running"), ("stop", "stopped"), ("start", "running")):
        assert slider.ok("controller", verb, POSITION).startswith(f"{POSITION}: {state} (was ")
    slider.ok("controller", "stop", POSITION)
    assert slider.ok("controller", "unload", POSITION) == f"{POSITION}: unloaded (was stopped)\n"
    assert states(slider) == {}


def test_unspawn_stops_and_unloads(slider: CommandLine) -> None:
    slider.ok("controller", "spawn", STATES, POSITION)
    slider.ok("controller", "unspawn", STATES, POSITION)
    assert states(slider) == {}
    assert slider.ok("controller", "unspawn", POSITION) == f"{POSITION}: unloaded already\n"


def test_a_refusal_says_why_and_keeps_what_was(slider: CommandLine) -> None:
    slider.ok("controller", "spawn", POSITION)
    for words, reason in (
        (("start", POSITION), "running already"),
        (("unload", POSITION), "stop it first"),
        (("load", POSITION), "already"),
        (("stop", STATES), STATES),
    ):
        done = slider("controller", *words)
        assert (done.returncode, done.stdout) == (1, ""), words
        assert reason in done.stderr
        assert len(done.stderr.splitlines()) <= 3
    assert states(slider) == {f"/slider {POSITION}": "running"}


def test_a_joint_that_is_claimed_is_not_given_twice(slider: CommandLine, tmp_path: Path) -> None:
    second = tmp_path / "second.yaml"
    second.write_text("second: {type: effort_controllers/JointEffortController, joint: joint1}\n")
    slider.ok("controller", "config", str(second))
    slider.ok("controller", "spawn", POSITION)
    slider.ok("controller", "load", "second")
    done = slider("controller", "start", "second")
    assert done.returncode == 1
    assert "joint1" in done.stderr
    slider.ok("controller", "switch", "--stop", POSITION, "--start", "second")
    assert states(slider) == {f"/slider {POSITION}": "stopped", "/slider second": "running"}


def test_switch_takes_names_until_the_next_option(rrbot: CommandLine) -> None:
    both = ("joint1_position_controller", "joint2_position_controller")
    rrbot.ok("controller", "load", STATES, *both)
    rrbot.ok("controller", "switch", "--start", STATES, "--start", *both, "--strict")
    assert set(states(rrbot).values()) == {"running"}
    rrbot.ok("controller", "switch", "--stop", *both, "--cm", "/rrbot")
    assert list(states(rrbot).values()) == ["running", "stopped", "stopped"]


def test_a_strict_switch_does_all_or_nothing_and_a_lenient_one_what_goes(slider: CommandLine) -> None:
    slider.ok("controller", "load", STATES, POSITION)
    slider.ok("controller", "start", STATES)
    assert slider("controller", "switch", "--start", STATES, POSITION).returncode == 1
    assert states(slider)[f"/slider {POSITION}"] == "initialized"
    slider.ok("controller", "switch", "--best-effort", "--start", STATES, POSITION)
    assert states(slider)[f"/slider {POSITION}"] == "running"


def test_an_unknown_controller_is_an_error_that_suggests_the_closest(slider: CommandLine) -> None:
    for verb in ("load", "start", "stop", "unload", "spawn", "unspawn"):
        done = slider("controller", verb, "joint1_postion_controller")
        assert (done.returncode, done.stdout) == (1, "")
        assert f"Did you mean '{POSITION}'?" in done.stderr


def test_a_controller_that_cannot_be_loaded_says_why_and_nothing_is_started(
    slider: CommandLine, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(
        "a: {type: no/Such}\nb: {type: effort_controllers/JointPositionController, joint: joint9, pid: {p: 1}}\n"
    )
    slider.ok("controller", "config", str(bad))
    done = slider("controller", "spawn", "a", "b", POSITION)
    assert done.returncode == 1
    assert "no/Such" in done.stderr
    assert "joint9" in done.stderr
    assert states(slider) == {f"/slider {POSITION}": "initialized"}


def test_without_a_robot_there_is_no_controller(world: CommandLine) -> None:
    done = world("controller", "spawn", STATES)
    assert done.returncode == 1
    assert "slidectl spawn slider" in done.stderr
    assert world.ok("controller", "list") == ""
    assert world("controller", "list", "--cm", "/slider").returncode == 1


def test_the_same_name_in_two_robots_needs_to_be_told_apart(slider: CommandLine) -> None:
    slider.ok("spawn", "slider", "-n", "left", "--controllers", "config/slider_control.yaml")
    done = slider("controller", "spawn", STATES)
    assert done.returncode == 2
    assert "/left/joint_state_controller, /slider/joint_state_controller" in done.stderr
    slider.ok("controller", "spawn", STATES, "--cm", "/left")
    slider.ok("controller", "spawn", f"/slider/{STATES}")
    slider.ok("--ns", "left", "controller", "spawn", POSITION)
    slider.ok("controller", "spawn", POSITION, "--cm", "slider/controller_manager")
    assert len(states(slider)) == 4
    assert list(states(slider, "--cm", "left")) == [f"/left {STATES}", f"/left {POSITION}"]


def test_a_name_that_only_one_robot_knows_needs_no_more(slider: CommandLine, rrbot: CommandLine) -> None:
    slider.ok("controller", "spawn", "joint2_position_controller")
    assert states(rrbot) == {"/rrbot joint2_position_controller": "running"}
    done = slider("controller", "spawn", "/slider/joint1_position_controller", "joint2_position_controller")
    assert done.returncode == 2
    assert "no controller manager has all of these" in done.stderr


def test_list_shows_claims_with_v_and_unloaded_ones_with_all(slider: CommandLine) -> None:
    slider.ok("controller", "spawn", POSITION)
    header, row = slider.ok("controller", "list").splitlines()
    assert header.split() == ["MANAGER", "NAME", "STATE", "TYPE"]
    assert row.split() == ["/slider", POSITION, "running", "effort_controllers/JointPositionController"]
    assert "EffortJointInterface: joint1" in slider.ok("controller", "list", "-v")
    assert states(slider, "--all") == {f"/slider {POSITION}": "running", f"/slider {STATES}": "unloaded"}
    record = json.loads(slider.ok("controller", "list", "--json"))
    assert list(record) == ["manager", "name", "state", "type", "claimed_resources"]
    assert record["claimed_resources"] == [
        {"hardware_interface": "hardware_interface::EffortJointInterface", "resources": ["joint1"]}
    ]


def test_types_are_listed(slider: CommandLine) -> None:
    assert "effort_controllers/JointPositionController" in slider.ok("controller", "types").splitlines()
    record = json.loads(slider.ok("controller", "types", "--json").splitlines()[0])
    assert list(record) == ["type", "base_class"]


@pytest.mark.parametrize("text", ["slider: [1, 2", "- 1\n- 2\n", "a: {type: x/Y, p: .inf}\n", "1: {type: x}\n"])
def test_a_file_that_holds_no_parameters_is_refused(slider: CommandLine, tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    done = slider("controller", "config", str(file))
    assert (done.returncode, done.stdout) == (2, "")


def test_spawn_can_wait_for_the_robot(world: CommandLine) -> None:
    waiting = world.start("controller", "spawn", STATES, "--wait", "--timeout", "30")
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml")
    stdout, stderr = waiting.communicate(timeout=60)
    assert waiting.returncode == 0, stderr
    assert stdout == f"{STATES}: running (was unloaded)\n"


def test_waiting_for_a_robot_that_does_not_come_times_out(world: CommandLine) -> None:
    done = world("controller", "spawn", STATES, "--wait", "--timeout", "0.3")
    assert (done.returncode, done.stdout) == (4, "")
    assert "no robot" in done.stderr


def test_a_robot_in_the_root_namespace_does_not_hide_the_others(slider: CommandLine) -> None:
    slider.ok("spawn", "slider", "namespace:=/", "-n", "bare", "--at", "3", "0", "0")
    root = {"/joint_state_controller/type": '"joint_state_controller/JointStateController"'}
    with slider.client() as client:
        for name, value in {**root, "/joint_state_controller/publish_rate": "50"}.items():
            client.call("/rosapi/set_param", {"name": name, "value": value})
    slider.ok("controller", "spawn", STATES, "--cm", "/")
    slider.ok("controller", "spawn", STATES, "--cm", "/slider")
    assert states(slider) == {f"/ {STATES}": "running", f"/slider {STATES}": "running"}
    assert states(slider, "--cm", "/") == {f"/ {STATES}": "running"}


def test_best_effort_goes_on_without_the_names_that_are_unknown(slider: CommandLine) -> None:
    slider.ok("controller", "load", STATES)
    done = slider("controller", "switch", "--best-effort", "--start", "nobody", STATES, "--stop", "nothing")
    assert (done.returncode, done.stdout) == (0, f"{STATES}: running (was initialized)\n")
    assert "warning: no controller 'nobody' to start; the rest of the request goes on\n" in done.stderr
    assert "warning: no controller 'nothing' to stop; the rest of the request goes on\n" in done.stderr
    done = slider("controller", "switch", "--best-effort", "--start", "nobody")
    assert (done.returncode, done.stdout) == (0, "")
    assert slider("controller", "switch", "--start", "nobody").returncode == 1


@pytest.mark.parametrize(("strictness", "said"), [(7, "strictness 7 is neither"), (-1, "strictness -1 is neither")])
def test_an_odd_strictness_is_best_effort_and_says_so(slider: CommandLine, strictness: int, said: str) -> None:
    slider.ok("controller", "load", STATES)
    request = f"{{start_controllers: [nobody, {STATES}], strictness: {strictness}}}"
    done = slider("service", "call", "switch_controller", request)
    assert (done.returncode, done.stdout) == (0, "ok: True\n")
    assert f"warning: {said} BEST_EFFORT (1) nor STRICT (2); BEST_EFFORT is used\n" in done.stderr
    record = json.loads(slider.ok("controller", "list", "--json"))
    assert (record["name"], record["state"]) == (STATES, "running")


def test_without_a_configuration_every_way_to_a_controller_says_what_comes_first(world: CommandLine) -> None:
    world.ok("spawn", "slider")
    for words in (
        ["controller", "spawn", POSITION],
        ["controller", "load", POSITION],
        ["service", "call", "load_controller", f"name: {POSITION}"],
        ["pub", "command", "1.0"],
        ["pub", f"/slider/{POSITION}/command", "std_msgs/Float64", "data: 1.0"],
    ):
        done = world(*words)
        assert done.returncode == 1
        assert "slidectl controller config FILE.yaml" in done.stderr, words


def test_a_message_for_a_controller_that_is_not_loaded_says_how_to_load_it(slider: CommandLine) -> None:
    done = slider("pub", f"{POSITION}/command", "1.0")
    assert done.returncode == 1
    assert f"load and start it: slidectl controller spawn {POSITION}" in done.stderr
    assert "slidectl controller spawn NAME" in slider("pub", "command", "1.0").stderr


def test_names_that_a_controller_does_not_know_are_told_wherever_it_is_configured(
    world: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "gains.yaml"
    path.write_text(
        f"slider:\n  {POSITION}:\n    type: effort_controllers/JointPositionController\n    joint: joint1\n"
        "    pid: {p: 100.0, kd: 10.0}\n"
    )
    remark = f"/slider/{POSITION}/pid/kd: is unknown to the controller and has no effect; did you mean 'pid/d'?"
    assert f"{path}:5: ignored" not in world("check", str(path)).stderr
    assert remark in world("check", str(path)).stdout
    assert f"warning: {path}:5: {remark}" in world("spawn", "slider", "--controllers", str(path)).stderr
    assert f"warning: {path}:5: {remark}" in world("controller", "config", str(path)).stderr
    assert f"warning: {remark}" in world("controller", "load", POSITION).stderr
    world.ok("controller", "unload", POSITION)
    done = world("controller", "spawn", POSITION)
    assert (done.returncode, f"warning: {remark}" in done.stderr) == (0, True)


def test_a_refused_load_tells_its_warnings_and_the_error_apart(slider: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(
        "slider: {bad: {type: effort_controllers/JointPositionController, joint: elbow, pid: {p: 1.0, i: 0.1, d: 0.0}}}"
    )
    slider.ok("controller", "config", str(file))
    warning = "warning: /slider/bad/pid: i = 0.1 has no effect without i_clamp\n"
    done = slider("controller", "load", "bad")
    assert done.returncode == 1
    assert done.stderr.startswith(warning + "error: cannot load controller 'bad': no joint 'elbow' in")
    called = slider("service", "call", "/slider/controller_manager/load_controller", "bad")
    assert called.returncode == 1
    assert called.stderr.startswith(warning + "error: /slider/controller_manager/load_controller answered ok: false")
    assert "cannot load controller 'bad': no joint 'elbow'" in called.stderr


def test_a_configured_controller_that_is_not_loaded_is_told_how_to_be(slider: CommandLine) -> None:
    done = slider("controller", "switch", "--start", POSITION)
    assert done.returncode == 1
    assert f"controller '{POSITION}' is not loaded" in done.stderr
    assert f"slidectl controller spawn {POSITION}" in done.stderr


def test_a_wrong_interface_is_answered_with_those_that_the_joint_has(world: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(
        '<robot name="two"><link name="world"/>'
        + "".join(
            f'<link name="{link}"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
            f'</inertial></link><joint name="{joint}" type="continuous"><parent link="world"/><child link="{link}"/>'
            "</joint>"
            for link, joint in (("a", "driven"), ("b", "loose"))
        )
        + '<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="driven">'
        "<hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>"
        '<actuator name="m"/></transmission></robot>'
    )
    controllers = {
        "driven": "velocity_controllers/JointVelocityController",
        "loose": "effort_controllers/JointEffortController",
    }
    text = "".join(f"  {joint}_c: {{type: {kind}, joint: {joint}}}\n" for joint, kind in controllers.items())
    (tmp_path / "two.yaml").write_text(f"two:\n{text}")
    world.ok("spawn", str(tmp_path / "two.urdf"), "--controllers", str(tmp_path / "two.yaml"))
    assert "'driven' has EffortJointInterface" in world("controller", "spawn", "driven_c").stderr
    assert "joint 'loose' has no <transmission> in the model" in world("controller", "spawn", "loose_c").stderr


def test_a_spawn_whose_controller_does_not_start_says_how_to_go_on(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("slider:\n  c: {type: effort_controllers/JointEffortController, joint: joint9}\n")
    done = world("spawn", "slider", "--controllers", str(file), "--start", "c")
    assert done.returncode == 1
    assert "the model has no joint 'joint9'; it has: joint1" in done.stderr
    assert f"slidectl controller config {file} --cm /slider; slidectl controller spawn c --cm /slider" in done.stderr
    file.write_text("slider:\n  c: {type: effort_controllers/JointEffortController, joint: joint1}\n")
    world.ok("controller", "config", str(file), "--cm", "/slider")
    world.ok("controller", "spawn", "c", "--cm", "/slider")
