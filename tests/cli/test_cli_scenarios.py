"""`slidectl test`: what passes and what fails, what is said of it, and that nothing is left behind."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import ROOT, CommandLine
from lxml import etree
from waiting import eventually

Write = Callable[[str, str], Path]

SLIDER = """
world: {engine: plain}
setup:
  - spawn: slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
"""


def results(slidectl: CommandLine, *words: str) -> dict[str, dict[str, Any]]:
    """The results of a run as JSON, by the names of the cases."""
    done = slidectl("test", "--json", *words)
    assert done.returncode in (0, 1), done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    return {str(result["id"]).rpartition("::")[2]: result for result in found}


def test_cases_pass_with_their_variables_at_their_times_and_always_with_the_same_bits(
    slidectl: CommandLine, write: Write
) -> None:
    file = write("goals.yaml", SLIDER + """
tags: [slow]
vars: {tolerance: 0.02}
cases:
  - {goal: 0.2, name: up}
  - {goal: -0.2, tags: [low]}
steps:
  - {at: 0.5, pub: "command ${goal}"}
  - wait: {target: "joint_states/position[0]", near: "${goal}", tol: "${tolerance}", for: 0.25}
    within: 10
  - {at: 8, wait: "joint_states/position[0] --near ${goal} --tol ${tolerance}", within: 0.1}
  - sim pause
  - sim step: 0.5s
""")  # fmt: skip
    first = results(slidectl, str(file), "-n", "2")
    assert {name: result["verdict"] for name, result in first.items()} == {"up": "passed", "-0.2": "passed"}
    again = results(slidectl, str(file), "-n", "1")
    timeless = [{key: value for key, value in run["up"].items() if key != "wall_time"} for run in (first, again)]
    assert timeless[0] == timeless[1]
    assert 8.5 <= timeless[0]["sim_time"] <= 8.6
    assert slidectl.ok("test", str(file), "--list").split() == [f"{file}::up", f"{file}::-0.2"]
    assert slidectl.ok("test", str(file), "--list", "-k", "goals and not up").split() == [f"{file}::-0.2"]
    assert slidectl.ok("test", str(file), "--list", "--tag", "low").split() == [f"{file}::-0.2"]
    assert slidectl.ok("test", f"{file}::up", "--list").split() == [f"{file}::up"]
    unknown = slidectl("test", str(file), "--tag", "lwo")
    assert (unknown.returncode, "no case has the tag 'lwo'" in unknown.stderr) == (2, True)
    assert slidectl("test", str(file), "-k", "nothing").returncode == 2


def test_a_failure_says_what_was_expected_and_how_to_run_it_alone_and_leaves_a_recording(
    slidectl: CommandLine, write: Write, tmp_path: Path
) -> None:
    file = write("far.yaml", SLIDER + """
cases: [{name: far}, {name: known, xfail: it ends at 1 m}, {name: wrongly known, goal: 0.0, xfail: it never passes}]
vars: {goal: 1.5}
steps:
  - pub: command ${goal}
  - wait: joint_states/position[0] --near ${goal} --tol 0.1
    within: 0.5
teardown:
  - controller list
  - urdf: slider -o "${dir}/torn_down.urdf"
""")  # fmt: skip
    kept, xml = tmp_path / "kept", tmp_path / "out.xml"
    done = slidectl("test", str(file), "--keep-failed", str(kept), "--junitxml", str(xml))
    assert done.returncode == 1
    said = done.stdout
    assert f"FAILED {file}::far" in said
    assert "was not near 1.5 (tolerance 0.1) within 0.5 s" in said
    assert "expected near 1.5 (tolerance 0.1); closest " in said
    assert f"{file}:10: steps: wait --within 0.5 'joint_states/position[0]' --near 1.5 --tol 0.1" in said
    assert f"slidectl test {file}::far" in said
    assert f"XPASSED {file}::wrongly known\n  it passed, but is a known failure: it never passes" in said
    assert said.rstrip().endswith("1 xfailed, 1 failed, 1 xpassed")
    assert (tmp_path / "torn_down.urdf").exists()
    [recording], [journal] = kept.glob("*far-*.mcap"), kept.glob("*far-*.journal")
    assert "/slider/joint_states" in slidectl.ok("bag", "info", str(recording))
    assert "are the same" in slidectl.ok("replay", str(journal), "--check")
    schema = etree.XMLSchema(etree.parse(ROOT / "tests" / "data" / "junit.xsd"))
    document = etree.parse(xml)
    schema.assertValid(document)
    suite = document.find("testsuite")
    assert suite is not None
    assert [suite.get(key) for key in ("tests", "failures", "skipped")] == ["3", "2", "1"]


def test_commands_that_are_to_fail_setups_limits_and_crashes(slidectl: CommandLine, write: Write) -> None:
    write("fails.yaml", SLIDER + "steps:\n  - {controller load: nothing, fails: no controller 'nothing'}")
    write("did_not.yaml", SLIDER + "steps:\n  - {controller list: , fails: true}")
    write("other.yaml", SLIDER + "steps:\n  - {controller load: nothing, fails: a joint}")
    write("setup.yaml", "world: {engine: plain}\nsetup: [delete nobody]\nsteps: [sim status]")
    write("sim.yaml", "world: {engine: plain}\nsim_timeout: 0.5\nsteps:\n  - wait: /clock/clock --above 3")
    write("late.yaml", "world: {engine: plain}\nsteps:\n  - sim step: 1s\n  - {at: 0.5, sim status: }")
    write("still.yaml", "world: {engine: plain, paused: true}\nsteps:\n  - wait: /clock/clock --above 3")
    write("wall.yaml", "world: {engine: plain}\ntimeout: 1\nsteps:\n  - sim step: 1000000s --timeout 1e9")
    write("never.yaml", SLIDER + "steps:\n  - {controller spawn: nothing --wait --timeout 4, within: 1}")
    write("nobody.yaml", SLIDER + "steps:\n  - {ros: rosservice call --wait /nothing, within: 1}")
    crash = write("crash.py", "import os\nos._exit(3)")
    write("crash.yaml", f"world: {{engine: plain, imports: [{crash}]}}\nsteps: [sim status]")
    found = results(slidectl, str(crash.parent), "-n", "2", "--sim-timeout", "1e8")
    told = {Path(name).stem: (result["verdict"], result["message"]) for name, result in found.items()}
    assert told["fails"] == ("passed", "")
    assert told["did_not"] == ("failed", "it should have failed")
    assert told["other"][1].startswith("it failed, but not with 'a joint': no controller 'nothing'")
    assert told["setup"][0] == "error"
    assert told["sim"][1].startswith("not done within the 0.5 s of the case of simulated time")
    assert told["late"] == ("failed", "it is 1 s already, and the step is at 0.5 s")
    assert "paused" in told["still"][1] + found[next(name for name in found if "still" in name)]["hint"]
    for name in ("never", "nobody"):
        result = next(one for case, one in found.items() if name in case)
        assert told[name][1].startswith("not done within 1 s of simulated time")
        assert result["sim_time"] == pytest.approx(1.0, abs=0.1)
    assert told["wall"] == ("error", "not done within 1 s of wall time")
    assert told["crash"] == ("error", "its process ended with exit code 3 and no result")


def test_every_slip_is_told_with_file_and_line_before_anything_runs(slidectl: CommandLine, write: Write) -> None:
    file = write("slips.yaml", """name: slips
vars: {goal: 1.0}
steps:
  - spwan: slider
  - spawn: slider --controlers x
  - pub: command ${gaol}
  - at: 3.0
  - {at: 2.0, pub: command 1}
  - wait: {target: a/b, nera: 1}
  - {pub: command 1, withn: 3}
  - sim stp: 3
  - spawn: slider --controllers config/slider_control.yaml --start joint1_positon_controller
  - wait: a --near x
  - daemon stop
  - {pub: command 1, at: soon}
  - sim status --instance other
  - spawn: slider --controllers types.yaml --start a
  - record: -a --detach
  - ros: roslaunch my_slider slider.launch
  - at:
""")  # fmt: skip
    types = write(
        "types.yaml", "slider:\n  a:\n    type: effort_controllers/JointPositonController\n    joint: joint1\n"
    )
    other = write("other.yaml", "stps: []\nworld: {gravty: 1, engine: fast}\nsteps:\n  - sim status\n")
    file.write_text(file.read_text("utf-8").replace("types.yaml", str(types)), "utf-8")
    done = slidectl("test", str(file), str(other), str(file.parent / "none.yaml"), "--check")
    assert (done.returncode, done.stdout) == (2, "")
    for line, text in {
        4: "no step 'spwan'. Did you mean 'spawn'?",
        5: "No such option '--controlers'. Did you mean '--controllers'?",
        6: "no variable 'gaol'. Did you mean ${goal}?",
        8: "2 s is in the past: an earlier step is at 3 s",
        9: "no option 'nera' of wait. Did you mean 'near'?",
        10: "no field 'withn' in a step. Did you mean 'within'?",
        11: "no command 'stp'. Did you mean 'slidectl sim step'?",
        12: "no controller 'joint1_positon_controller' in config/slider_control.yaml. Did you mean",
        13: "Invalid value for '--near': 'x' is not a valid float.",
        14: "no step 'daemon'.",
        15: "'at' is a time of 0 s or more, not soon",
        16: "a step acts in the world of its scenario",
        18: "--detach leaves a process behind",
        19: "roslaunch brings up a world, and a scenario has its own",
        20: "this step has no command; a step is one command",
    }.items():
        assert f"{file}:{line}: {text}" in done.stderr
    assert f"{types}:3: " in done.stderr
    assert f"{other}:1: no field 'stps' in a scenario. Did you mean 'steps'?" in done.stderr
    assert f"{other}:2: no field 'gravty' in a world. Did you mean 'gravity'?" in done.stderr
    assert f"{other}:2: 'engine' is auto, plain or compiled, not fast" in done.stderr
    assert f"{file.parent / 'none.yaml'}: no such file or directory" in done.stderr


def test_an_integer_that_is_larger_than_any_float_is_a_slip(slidectl: CommandLine, write: Write) -> None:
    file = write("large.yaml", f"timeout: 1{'0' * 400}\nsteps: [robots]\n")
    done = slidectl("test", str(file), "--check")
    assert done.returncode == 2
    assert f"{file}:1: 'timeout' is a number of seconds above 0, not 1000" in done.stderr
    write("large.yaml", f"steps:\n  - {{at: 1{'0' * 400}, robots: }}\n")
    assert f"{file}:2: 'at' is a time of 0 s or more, not 1000" in slidectl("test", str(file), "--check").stderr


def test_background_steps_go_on_meanwhile_and_end_with_the_case(slidectl: CommandLine, write: Write) -> None:
    file = write("background.yaml", SLIDER + """
steps:
  - {record: "/slider/joint_states -O ${tmp}/run.bag", background: true}
  - pub: {topic: command, values: 0.2*sin(2*pi*0.1*t), rate: 50}
    background: true
  - wait: joint_states/position[0] --above 0.02 --within 4
  - {at: 6, bag info: "${tmp}/run.bag"}
  - wait: joint_states/position[0] --below -0.02 --within 8
""")  # fmt: skip
    one, two = (results(slidectl, str(file))[str(file)] for _ in range(2))
    assert (one["verdict"], one["message"]) == ("passed", "")
    assert one["sim_time"] == two["sim_time"]


def test_ctrl_c_in_the_middle_of_many_reports_what_ran_and_leaves_nothing(
    slidectl: CommandLine, write: Write, tmp_path: Path
) -> None:
    cases = "\n".join(f"  - {{number: {number}, messages: {10 if number < 3 else 10**9}}}" for number in range(200))
    mark = tmp_path / "began"
    file = write("many.yaml", f"""
world: {{engine: plain}}
cases:
{cases}
steps:
  - urdf: slider -o {mark}_${{number}}
  - {{echo: "/clock -n ${{messages}}"}}
""")  # fmt: skip
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    xml = tmp_path / "out.xml"
    process = slidectl.start("test", str(file), "-n", "2", "--json", "--junitxml", str(xml), TMPDIR=str(temporary))
    try:
        eventually(Path(f"{mark}_3").exists, "the fourth case did not begin")
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    ran = [json.loads(line) for line in out.splitlines()]
    assert 2 <= len(ran) < 200
    assert ran[0]["verdict"] == "passed"
    assert [result["message"] for result in ran if result["verdict"] == "error"] in (
        ["interrupted"],
        2 * ["interrupted"],
    )
    assert etree.parse(xml).find("testsuite").get("tests") == "200"
    assert os.listdir(temporary) == []


def test_a_live_daemon_gives_the_same_bits_and_is_left_as_it_was(
    world: CommandLine, write: Write, tmp_path: Path
) -> None:
    file = write("live.yaml", SLIDER + """
cases: [{goal: 0.2, rate: 50}, {goal: 1.5, rate: 20}]
steps:
  - {at: 0.5, pub: {topic: command, values: "${goal} * (1 - exp(-t))", rate: "${rate}"}, background: true}
  - wait: joint_states/position[0] --near ${goal} --tol 0.1 --for 0.1
    within: 4
  - sim pause
  - sim step: 20
  - sim save: mine
""")  # fmt: skip
    launched = write("launched.yaml", "setup:\n  - launch: rrbot_gazebo rrbot_world.launch\nsteps:\n"
                     "  - launch: rrbot_control rrbot_control.launch\n  - {at: 0.3, controller list: }\n")  # fmt: skip
    stepped = write("stepped.yaml", SLIDER + """
steps:
  - sim pause
  - pub: {topic: command, values: 0.2*sin(2*pi*0.1*t), rate: 50}
    background: true
  - sim step: 1s
  - at: 1.5
  - {sim step: 1s, background: true}
  - wait: joint_states/position[0] --above 0.1 --within 5
""")  # fmt: skip
    files = (str(file), str(launched), str(stepped))
    golden = ("--baseline", str(tmp_path / "golden"))
    alone = results(world, *files, *golden, "--update-baseline")
    live = results(world, *files, "--daemon", *golden)
    for name, result in alone.items():
        for key in ("verdict", "step", "message", "sim_time"):
            assert live[name][key] == result[key]
    assert [result["verdict"] for result in alone.values()] == ["passed", "failed", "passed", "passed"]
    with world.client() as client:
        status = client.call("/slidectl/status")
        assert (status["robots"], status["paused"], status["time"]) == ([], True, 0.0)
        assert not [name for name in client.params.names() if name.startswith("/slider")]
        assert client.snapshots() == []
        client.spawn("rrbot")
    refused = world("test", str(file), "--daemon")
    assert refused.returncode == 1
    assert "the daemon holds robots: rrbot" in refused.stderr
    world.ok("delete", "rrbot")
    with world.client() as other:
        other.call("/slidectl/step", {"news": True})  # as another test does
        refused = world("test", str(file), "--daemon")
    assert (refused.returncode, refused.stderr.splitlines()[0]) == (
        1,
        "error: another 'slidectl test' runs in this daemon",
    )


def test_a_launch_is_a_step_that_ends_with_the_case(slidectl: CommandLine, write: Write) -> None:
    tools = write("tools.launch", """<launch>
  <node pkg="topic_tools" type="relay" name="relay" args="/wish /slider/joint1_position_controller/command"/>
  <node pkg="tf" type="static_transform_publisher" name="camera" args="0 0 1 0 0 0 world camera 100"/>
</launch>""")  # fmt: skip
    file = write("launched.yaml", f"""
world: {{engine: plain}}
setup:
  - launch: my_slider slider.launch
steps:
  - launch: {tools}
  - {{pub: {{topic: /wish, type: std_msgs/Float64, values: 0.3, rate: 10, allow-unheard: true}}, background: true}}
  - tf echo: world camera -n 1
  - wait: joint_states/position[0] --above 0.05
    within: 3
teardown:
  - {{delete: slider, fails: slider}}  # it went with the launch that made the world
""")  # fmt: skip
    one, two = (results(slidectl, str(file))[str(file)] for _ in range(2))
    assert (one["verdict"], one["message"], one["sim_time"]) == ("passed", "", two["sim_time"])


def test_slips_of_launches_are_told_before_anything_runs_and_programs_need_a_daemon(
    world: CommandLine, write: Write, tmp_path: Path
) -> None:
    program = write("drive", f"""#!{sys.executable}
import sys
sys.path.insert(0, {str(ROOT)!r})
from slidectl import Client
with Client() as client:
    client.publish("/slider/joint1_position_controller/command", {{"data": 0.3}})
    for message in client.subscribe("/slider/joint_states"):
        if message["position"][0] > 0.1:
            sys.exit(3)
""")  # fmt: skip
    program.chmod(0o755)
    write("package.xml", "<package><name>mine</name></package>")
    launch = write("drive.launch", '<launch>\n<node pkg="mine" type="drive" name="drive"/></launch>')
    file = write("driven.yaml", f"""
setup: [launch my_slider slider.launch]
steps:
  - launch: {launch} --package mine={tmp_path}
  - wait: joint_states/position[0] --above 0.15
    within: 20
""")  # fmt: skip
    other = write("slips.yaml", "steps:\n  - launch: my_slidr slider.launch\n  - launch: slider --detach\n")
    done = world("test", str(file), str(other), "--check")
    assert done.returncode == 2
    assert f"{file}:4: {launch}:2: /drive: mine/drive is a program of its own, which needs a daemon" in done.stderr
    assert "slidectl test --daemon" in done.stderr
    assert f"{other}:2: " in done.stderr
    assert f"{other}:3: --detach leaves a process behind" in done.stderr
    result = results(world, str(file), "--daemon")[str(file)]
    assert (result["verdict"], result["message"]) == ("failed", "these nodes died: /drive (exit code 3)")


def test_the_printed_schema_takes_the_examples_and_no_slips(slidectl: CommandLine) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json.loads(slidectl.ok("test", "--schema")))
    examples = sorted((ROOT / "examples" / "scenarios").glob("*.yaml"))
    assert examples
    for file in examples:
        validator.validate(yaml.safe_load(file.read_text("utf-8")))
    for mistake in ({"steps": [{"spwan": "slider"}]}, {"stps": []}, {"steps": [{"wait": {"target": "a", "nera": 1}}]}):
        assert not validator.is_valid(mistake)


def test_maxfail_stops_at_so_many_failures(slidectl: CommandLine, write: Write) -> None:
    file = write("all_fail.yaml", """
world: {engine: plain}
cases: [{n: 1}, {n: 2}, {n: 3}, {n: 4}]
steps: [delete nobody]
""")  # fmt: skip
    done = slidectl("test", str(file), "-n", "1", "--maxfail", "2")
    assert done.returncode == 1
    assert done.stdout.rstrip().endswith("2 failed, 2 not run")


def test_on_a_terminal_a_bar_shows_how_far_it_is(slidectl: CommandLine, write: Write) -> None:
    file = write("short.yaml", "world: {engine: plain}\nsteps:\n  - sim step: 5")
    shown = slidectl.on_a_terminal("test", str(file)).decode()
    assert "1/1" in shown
    assert "1 passed" in shown
