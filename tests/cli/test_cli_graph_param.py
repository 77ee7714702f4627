"""`slidectl param` at a real daemon: the semantics of rosparam."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from cli_graph_world import World, slider_world
from command_line import CommandLine
from daemon_fixture import running_daemon

from slidectl.errors import Refused

PID = "/slider/joint1_position_controller/pid"


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as made:
        yield made


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        ("1", "1\n"),
        ("1.5", "1.5\n"),
        ("-0.5", "-0.5\n"),
        ("1e-3", "0.001\n"),
        ("hello", "hello\n"),
        ("", "''\n"),
        ("true", "true\n"),
        ("off", "false\n"),
        ('"1"', "'1'\n"),
        ("deg(90)", "1.5707963267948966\n"),
        ("rad(pi/2)", "1.5707963267948966\n"),
        ("[1, 2.0, x]", "- 1\n- 2.0\n- x\n\n"),
        ("{p: 1.0, nested: {x: deg(180)}}", "nested:\n  x: 3.141592653589793\np: 1.0\n\n"),
    ],
)
def test_what_is_set_is_got_as_rosparam_prints_it(world: World, value: str, printed: str) -> None:
    world.slidectl.ok("param", "set", "/set/value", "0")
    assert world.slidectl.ok("param", "set", "/set/value", value) == ""
    assert world.slidectl.ok("param", "get", "/set/value") == printed


def test_a_mapping_is_merged_and_all_else_replaces(world: World) -> None:
    world.slidectl.ok("param", "set", "/merged", "{p: 1.0, i: 0.1, nested: {x: 2}}")
    world.slidectl.ok("param", "set", "/merged", "{d: 0.01, nested: {y: 3}}")
    assert json.loads(world.slidectl.ok("param", "get", "/merged", "--json"))["value"] == {
        "p": 1.0, "i": 0.1, "nested": {"x": 2, "y": 3}, "d": 0.01,
    }  # fmt: skip
    world.slidectl.ok("param", "set", "/merged", "1")
    assert world.slidectl.ok("param", "get", "/merged") == "1\n"
    world.slidectl.ok("param", "set", "/merged/b", "2")
    assert world.slidectl.ok("param", "get", "/merged") == "b: 2\n\n"


def test_a_gain_of_a_running_controller_is_found_by_the_end_of_its_name(world: World) -> None:
    done = world.slidectl("param", "set", "pid/p", "150")
    assert (done.returncode, done.stderr) == (0, f"set {PID}/p\n")
    assert float(world.slidectl.ok("param", "get", "joint1_position_controller/pid/p")) == 150.0
    state = json.loads(world.slidectl.ok("echo", "joint1_position_controller/state", "-n", "1", "--json"))
    assert state["p"] == 150.0


def test_a_relative_name_that_does_not_exist_is_set_in_the_namespace(world: World) -> None:
    world.slidectl.ok("--ns", "/left", "param", "set", "fresh_name", "1")
    assert world.slidectl.ok("param", "get", "/left/fresh_name") == "1\n"


def test_the_text_of_a_file_can_be_a_value(world: World, tmp_path: Path) -> None:
    (tmp_path / "text").write_text("data: 3.25\n")
    world.slidectl.ok("param", "set", "/text", "-t", str(tmp_path / "text"))
    assert world.slidectl.ok("param", "get", "/text") == "'data: 3.25\n\n  '\n"


def test_an_element_of_a_list_is_got_by_its_index(world: World) -> None:
    world.slidectl.ok("param", "set", "/numbers", "[1, [2, 3]]")
    assert world.slidectl.ok("param", "get", "/numbers[0]") == "1\n"
    assert world.slidectl.ok("param", "get", "/numbers[-1][0]") == "2\n"
    assert "has no element [5]: it has 2" in world.slidectl("param", "get", "/numbers[5]").stderr


def test_list_prints_the_leaves_below_a_namespace(world: World) -> None:
    world.slidectl.ok("param", "set", "/listed", "{b: 1, a: {x: 2}}")
    assert world.slidectl.ok("param", "list", "/listed") == "/listed/a/x\n/listed/b\n"
    assert world.slidectl.ok("param", "list", "/listed/b") == ""
    assert "/listed/b" in world.slidectl.ok("param", "list").splitlines()
    assert world.slidectl.ok("param", "list", "/listed/a", "--json") == '{"parameter": "/listed/a/x"}\n'


def test_delete_takes_a_parameter_or_a_namespace_away(world: World) -> None:
    world.slidectl.ok("param", "set", "/doomed", "{a: 1, b: {c: 2}}")
    assert world.slidectl.ok("param", "delete", "/doomed/b") == ""
    assert world.slidectl.ok("param", "get", "/doomed") == "a: 1\n\n"
    world.slidectl.ok("param", "delete", "/doomed")
    assert world.slidectl("param", "get", "/doomed").returncode == 1


def test_load_takes_all_documents_and_their_namespaces(world: World, tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        "controller:\n  type: position_controllers/JointPositionController\n  limits: [-0.5, 0.5]\n"
        "  offset: deg(45)\n---\nb: 2\n---\n_ns: inner\na: 1\n"
    )
    assert world.slidectl.ok("param", "load", str(file), "/loaded") == ""
    assert world.slidectl.ok("param", "get", "/loaded") == (
        "b: 2\ncontroller:\n  limits:\n  - -0.5\n  - 0.5\n  offset: 0.7853981633974483\n"
        "  type: position_controllers/JointPositionController\ninner:\n  a: 1\n\n"
    )


def test_load_reads_stdin_and_a_list_with_a_name(world: World) -> None:
    world.slidectl.ok("param", "set", "/piped/kept", "1")
    assert world.slidectl("param", "load", "-", "/piped", stdin="k: 1\n").returncode == 0
    assert world.slidectl.ok("param", "get", "/piped") == "k: 1\nkept: 1\n\n"
    assert world.slidectl("param", "load", "-", "/piped_list", stdin="[1, 2]\n").returncode == 0
    assert world.slidectl.ok("param", "get", "/piped_list") == "- 1\n- 2\n\n"


def test_load_says_when_there_is_nothing_to_load(world: World) -> None:
    done = world.slidectl("param", "load", "-", "/nothing", stdin="# nothing\n")
    assert (done.returncode, done.stderr) == (0, "stdin holds no parameters\n")


def test_load_warns_of_a_name_that_is_there_twice(world: World) -> None:
    done = world.slidectl("param", "load", "-", "/twice", stdin="a: 1\na: 2\n")
    assert done.returncode == 0
    assert "stdin:2: a is there twice" in done.stderr
    assert world.slidectl.ok("param", "get", "/twice/a") == "2\n"


def test_dump_writes_a_file_that_load_reads_back(world: World, tmp_path: Path) -> None:
    file = tmp_path / "dumped.yaml"
    world.slidectl.ok("param", "set", "/here/inner", "{a: 1, list: [1, {b: 2.5}], empty: {}}")
    assert world.slidectl.ok("param", "dump", str(file), "/here/inner") == ""
    before = world.slidectl.ok("param", "get", "/here")
    assert yaml.safe_load(file.read_text()) == {"here": {"inner": {"a": 1, "list": [1, {"b": 2.5}], "empty": {}}}}
    world.slidectl.ok("param", "delete", "/here")
    world.slidectl.ok("param", "load", str(file))
    assert world.slidectl.ok("param", "get", "/here") == before
    assert json.loads(world.slidectl.ok("param", "dump", "--json"))["here"] == yaml.safe_load(file.read_text())["here"]
    loaded = world.slidectl("param", "load", str(file), "/here/inner")  # as for a dump of rosparam
    assert (loaded.returncode, loaded.stderr) == (0, f"{file} names /here/inner itself; it is loaded there\n")
    assert world.slidectl.ok("param", "get", "/here") == before
    world.slidectl.ok("param", "load", str(file), "/again")
    assert world.slidectl.ok("param", "get", "/again/here") == before


def test_a_dump_of_gains_has_their_keys_from_the_root_and_only_what_was_set(tmp_path: Path) -> None:
    file = tmp_path / "tuned.yaml"
    pid = "/slider/joint1_position_controller/pid"
    config = {
        "joint1_position_controller": {
            "type": "effort_controllers/JointPositionController",
            "joint": "joint1",
            "pid": {"p": 100.0, "d": 10.0},
        }
    }
    given = tmp_path / "given.yaml"
    given.write_text(yaml.safe_dump({"slider": config}))
    with running_daemon() as daemon:
        slidectl = CommandLine(daemon.folder)
        slidectl.ok("spawn", "slider", "--controllers", str(given), "--start", "joint1_position_controller")
        assert yaml.safe_load(slidectl.ok("param", "dump")) == {"slider": config}  # no model and no use_sim_time either
        slidectl.ok("param", "set", f"{pid}/p", "150.0")
        slidectl.ok("param", "set", f"{pid}/antiwindup", "true")
        slidectl.ok("param", "dump", str(file), pid)
        tuned = {"p": 150.0, "d": 10.0, "antiwindup": True}
        assert yaml.safe_load(file.read_text()) == {"slider": {"joint1_position_controller": {"pid": tuned}}}
        whole = slidectl.ok("param", "get", "/slider/joint1_position_controller")
        slidectl.ok("controller", "unspawn", "joint1_position_controller")
        slidectl.ok("param", "delete", "/slider/joint1_position_controller")
        slidectl.ok("param", "load", str(given))
        slidectl.ok("param", "load", str(file))
        slidectl.ok("controller", "spawn", "joint1_position_controller")
        assert slidectl.ok("param", "get", "/slider/joint1_position_controller") == whole
        nothing = slidectl("param", "dump", "-", f"{pid}/i_clamp_max")
        assert (nothing.stdout, nothing.stderr) == ("{}\n", f"nothing was set at {pid}/i_clamp_max by a client\n")


@pytest.mark.parametrize("words", [("param", "dump"), ("ros", "rosparam", "dump")], ids=" ".join)
def test_a_dump_that_does_not_fit_leaves_what_was_there(world: World, tmp_path: Path, words: tuple[str, ...]) -> None:
    file = tmp_path / "slider.yaml"
    file.write_text("precious: 1\n")
    file.chmod(0o640)
    command = ["bash", "-c", 'ulimit -f 0; "$@"', "bash", *world.slidectl.argv(*words, str(file), PID)]
    done = subprocess.run(
        command,
        env=world.slidectl.environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert done.returncode in (1, 2)
    assert "File too large" in done.stderr
    assert file.read_text() == "precious: 1\n"
    assert [path.name for path in tmp_path.iterdir()] == ["slider.yaml"]
    world.slidectl.ok(*words, str(file), PID)
    assert "d: 10.0" in file.read_text()
    assert file.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["get", "/nope"], 1, "no parameter '/nope'"),
        (["get", "joint1_position_controler/pid/p"], 1, "Did you mean '" + PID + "/p'?"),
        (["delete", "/nope"], 1, "no parameter '/nope'"),
        (["dump", "-", "/nope"], 1, "no parameter '/nope'"),
        (["get", "type"], 2, "fits more than one parameter"),
        (["set", "/x", "null"], 2, "null is no value of a parameter"),
        (["set", "/x", "2020-01-01"], 2, "is a date to YAML"),
        (["set", "/x", "{1: 2}"], 2, "the key 1"),
        (["set", "/x", "a: [1"], 2, "not valid YAML"),
        (["set", "/x", ".inf"], 2, "parameters hold finite numbers"),
        (["set", "/x", "deg(banana)"], 2, "'deg(banana)' is not an angle: expected one number of degrees"),
        (["set", "/bad name", "1"], 2, "is not a legal name"),
        (["set", "/x"], 2, "give a VALUE or -t FILE"),
        (["set", "/x", "-t", "/no/file"], 2, "/no/file: no such file"),
        (["set"], 2, "Missing argument"),
        (["set", "/x", "1", "2"], 2, "unexpected extra argument"),
        (["load", "/no/file.yaml"], 2, "/no/file.yaml: no such file"),
        (["dump", "/no/folder/x.yaml"], 2, "cannot be written"),
        (["bogus"], 2, "no command 'bogus'"),
    ],
)
def test_errors_say_what_is_wrong(world: World, words: list[str], code: int, said: str) -> None:
    done = world.slidectl("param", *words)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("text", "said"),
    [("a: [1\n", "stdin:"), ("5\n", "stdin:1: expected names with values"), ("a: 2020-01-01\n", "stdin:1:")],
)
def test_a_broken_file_is_named_with_its_line_and_sets_nothing(world: World, text: str, said: str) -> None:
    done = world.slidectl("param", "load", "-", "/broken", stdin=text)
    assert done.returncode == 2
    assert said in done.stderr
    assert world.slidectl("param", "get", "/broken").returncode == 1


def test_a_negative_gain_and_one_without_effect_are_taken_with_a_warning(world: World) -> None:
    assert world.slidectl("param", "set", f"{PID}/d", "10.0").stderr == ""
    done = world.slidectl("param", "set", f"{PID}/i", "0.02")
    assert (done.returncode, done.stderr) == (0, f"warning: {PID}: i = 0.02 has no effect without i_clamp\n")
    done = world.slidectl("param", "set", f"{PID}/p", "-5")
    assert (done.returncode, done.stderr) == (0, f"warning: {PID}: p = -5.0 drives away from the set point\n")
    agrees(world)


def reported(world: World) -> dict[str, Any]:
    """The gains that the running controller has, as its own service tells them."""
    config = {"bools": [], "ints": [], "strs": [], "doubles": [], "groups": []}
    answer = world.client.call(f"{PID}/set_parameters", {"config": config})["config"]
    return {entry["name"]: entry["value"] for entry in [*answer["doubles"], *answer["bools"]]}


def agrees(world: World) -> None:
    """Asserts that the parameters say what the controller has, and the controller's state says it too."""
    gains = world.client.call("/rosapi/get_param", {"name": PID})["value"]
    held = json.loads(gains)
    assert {name: value for name, value in held.items() if name != "i_clamp"} == reported(world)
    assert held.get("i_clamp", held["i_clamp_max"]) == held["i_clamp_max"]
    state = world.client.subscribe("/slider/joint1_position_controller/state")
    with state:
        message = state.get()
    assert [message[name] for name in ("p", "i", "d", "i_clamp", "antiwindup")] == [
        held[name] for name in ("p", "i", "d", "i_clamp_max", "antiwindup")
    ]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("p", "abc", "must be a number, not the string 'abc'"),
        ("p", '"150"', "a number has no quotes"),
        ("p", "nan", "a number must be finite"),
        ("p", ".nan", "parameters hold finite numbers"),
        ("i_clamp", "wide", "must be a number"),
        ("antiwindup", "1", "must be true or false, not 1"),
    ],
)
def test_a_gain_that_the_controller_cannot_take_is_refused(world: World, name: str, value: str, said: str) -> None:
    before = world.slidectl.ok("param", "get", PID)
    done = world.slidectl("param", "set", f"{PID}/{name}", value)
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert world.slidectl.ok("param", "get", PID) == before
    agrees(world)


@pytest.mark.parametrize(
    ("service", "request_", "said"),
    [
        ("/rosapi/set_param", {"name": f"{PID}/p", "value": '"fast"'}, "must be a number"),
        ("/rosapi/set_param", {"name": f"{PID}/p", "value": "NaN"}, "no finite number"),
        ("/rosapi/set_param", {"name": f"{PID}/p", "value": "null"}, "null is no value"),
        ("/rosapi/set_param", {"name": PID, "value": "5"}, "is a namespace of parameters"),
        ("/rosapi/set_param", {"name": PID, "value": '{"p": "x", "i": 3}'}, "must be a number"),
        ("/slidectl/set_params", {"names": ["/x", f"{PID}/p"], "values": ["1", '"x"']}, "must be a number"),
        ("/slidectl/set_params", {"names": [f"{PID}/q"], "values": ["1"], "known_only": True}, "Did you mean"),
        ("/rosapi/delete_param", {"name": f"{PID}/d"}, "is a gain of a loaded controller"),
        (f"{PID}/set_parameters", {"config": {"doubles": [{"name": "q", "value": 1.0}]}}, "no double 'q'"),
    ],
)
def test_what_is_refused_over_the_wire_changes_nothing(
    world: World, service: str, request_: dict[str, Any], said: str
) -> None:
    before = world.client.call("/rosapi/get_param", {"name": "/slider"})
    with pytest.raises(Refused, match=said):
        world.client.call(service, request_)
    assert world.client.call("/rosapi/get_param", {"name": "/slider"}) == before
    assert world.client.call("/rosapi/has_param", {"name": "/x"}) == {"exists": False}
    agrees(world)


def test_the_files_and_the_ros_tool_meet_the_same_refusal(world: World, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("pid: {p: 100.0, d: fast}\n")
    name = "/slider/joint1_position_controller"
    for words in (
        ["param", "load", str(tmp_path / "bad.yaml"), name],
        ["ros", "rosparam", "load", str(tmp_path / "bad.yaml"), name],
        ["ros", "rosparam", "set", f"{PID}/d", "fast"],
        ["ros", "rosparam", "delete", f"{PID}/d"],
        ["param", "delete", f"{PID}/d"],
    ):
        before = world.slidectl.ok("param", "get", PID)
        done = world.slidectl(*words)
        assert done.returncode == 1
        assert f"{PID}/d" in done.stderr
        assert world.slidectl.ok("param", "get", PID) == before
        agrees(world)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (f"{PID}/P", f"Did you mean '{PID}/p'?"),
        ("/slider/joint1_position_controller/pdi/p", f"Did you mean '{PID}/p'?"),
        ("pid/P", f"Did you mean '{PID}/p'?"),
        ("joint1_position_controller/jiont", "Did you mean '/slider/joint1_position_controller/joint'?"),
    ],
)
def test_a_slip_below_a_loaded_controller_is_an_error(world: World, name: str, said: str) -> None:
    before = world.slidectl.ok("param", "list")
    done = world.slidectl("param", "set", name, "5")
    assert done.returncode == 1
    assert said in done.stderr
    assert "--new" in done.stderr
    assert world.slidectl.ok("param", "list") == before


def test_new_sets_what_the_controller_does_not_read(world: World) -> None:
    name = "/slider/joint1_position_controller/note"
    done = world.slidectl("param", "set", name, "mine", "--new")
    assert done.returncode == 0
    assert "the controller does not read it" in done.stderr
    assert world.slidectl.ok("param", "get", name) == "mine\n"
    world.slidectl.ok("param", "delete", name)
    done = world.slidectl("param", "set", "pid", "{p: 110, kd: 3}", "--new")
    assert (done.returncode, f"set {PID}\n" in done.stderr) == (0, True)
    assert world.slidectl.ok("param", "get", f"{PID}/kd") == "3\n"
    assert reported(world)["p"] == 110.0
    world.slidectl.ok("param", "delete", f"{PID}/kd")
    assert world.slidectl("param", "set", "pid/Q", "1", "--new").returncode == 0
    assert world.slidectl.ok("param", "get", "/pid/Q") == "1\n"
    world.slidectl.ok("param", "delete", "/pid")


def test_a_parameter_that_the_controller_reads_is_not_called_new(world: World) -> None:
    done = world.slidectl("param", "set", f"{PID}/i_clamp", "2")
    assert (done.returncode, done.stderr) == (0, "")
    assert reported(world)["i_clamp_max"] == 2.0
    world.slidectl.ok("param", "set", PID, "{i_clamp: 0}")
    world.slidectl.ok("param", "delete", f"{PID}/i_clamp")


def test_a_short_name_of_what_is_not_set_yet_leads_to_the_full_one(world: World) -> None:
    done = world.slidectl("param", "set", "pid/i_clamp", "2")
    assert done.returncode == 1
    assert f"below what is there, write the full name: {PID}/i_clamp\n--new makes /pid/i_clamp\n" in done.stderr


def test_elsewhere_a_new_parameter_says_that_it_is_new(world: World) -> None:
    wrong = "/slider/joint1_position_controler/pid/p"
    done = world.slidectl("param", "set", wrong, "5")
    assert (done.returncode, done.stderr) == (0, f"{wrong} is new; did you mean {PID}/p?\n")
    assert world.slidectl("param", "set", wrong, "6").stderr == ""
    world.slidectl.ok("param", "delete", "/slider/joint1_position_controler")
    assert world.slidectl("param", "set", "/fresh", "5").stderr == "/fresh is new\n"


def test_what_a_controller_reads_only_when_it_is_loaded_says_so(world: World) -> None:
    done = world.slidectl("param", "set", "/slider/joint_state_controller/publish_rate", "20")
    assert done.returncode == 0
    assert "counts when the controller is loaded again" in done.stderr
    world.slidectl.ok("param", "set", "/slider/joint_state_controller/publish_rate", "50")
