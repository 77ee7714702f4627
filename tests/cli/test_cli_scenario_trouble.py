"""`slidectl test` where something goes wrong: files of all kinds, limits, paths that cannot be written, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import ROOT, CommandLine
from lxml import etree
from waiting import eventually

from slidectl.errors import BadFile
from slidectl.extensions.scenarios import scenario_file
from slidectl.extensions.scenarios.commands.step_runner import StepRunner

Write = Callable[[str, str], Path]

PLAIN = "world: {engine: plain}\n"


def results(slidectl: CommandLine, *words: str) -> dict[str, dict[str, Any]]:
    """The results of a run as JSON, by the names of the files or cases."""
    done = slidectl("test", "--json", *words)
    assert done.returncode in (0, 1), done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    return {Path(result["id"].rpartition("::")[2]).stem: result for result in found}


def test_only_controllers_that_a_spawn_starts_from_files_alone_are_judged(slidectl: CommandLine, write: Write) -> None:
    position = "{type: effort_controllers/JointPositionController, joint: joint1, pid: {p: 100.0, d: 10.0}}"
    nested = write("nested", f"robots: {{slider: {{c: {position}}}}}")
    typo = write("typo", f"slider: {{c: {position}, d: {{type: effort_controllers/Nothing}}}}")
    own = "cartpole --controllers config/cartpole_control.yaml --start joint_state_controller lqr"
    spawn = f"spawn: slider --controllers {typo} --start"
    valid = write("valid.yaml", "").parent / "valid"
    valid.mkdir()
    for name, text in {
        "own": f"world: {{imports: [{ROOT}/examples/cartpole.py]}}\nsteps: [spawn: {own}]",
        "nested": f"steps: [spawn: 'slider namespace:=/robots/slider --controllers {nested} --start c']",
        "typo": f"steps: [{spawn} c]",
        "earlier": f"steps: [param load: {nested} --ns /slider, {{param set: /slider/e/type x}}, {spawn} e]",
        "fails": f"steps: [{{{spawn} d, fails: no controller type}}]",
    }.items():
        (valid / f"{name}.yaml").write_text(text, "utf-8")
    slidectl.ok("test", str(valid), "--check")
    ran = results(slidectl, *(str(valid / f"{name}.yaml") for name in ("own", "nested", "typo")))
    assert [(name, run["verdict"], run["message"]) for name, run in ran.items() if run["verdict"] != "passed"] == []
    wrong = write("wrong.yaml", f"steps:\n  - {spawn} d\n  - {spawn} e\n  - {spawn} c\n")
    said = slidectl("test", str(wrong), "--check").stderr
    assert f"{wrong}:2: {typo}:1: /slider/d/type: no controller type 'effort_controllers/Nothing'" in said
    assert f"{wrong}:3: no controller 'e' in {typo}." in said
    assert f"{wrong}:4" not in said


@pytest.mark.parametrize(
    ("step", "said"),
    [
        ("sim step: 0.5parsec", ["'0.5parsec' is not a number of steps"]),
        ("wait: joint_states/position[0]", ["give exactly one of --near, --above, --below and --equals"]),
        ("assert: joint1", ["no condition"]),
        ("assert: joint1 --overshoot '<5%'", ["--overshoot is measured over a time"]),
        ("fault add: joint1 --kind nokind", ["no kind of fault 'nokind'."]),
        ("fault add: joint1 --kind sensor-noise", ["sensor-noise needs sd"]),
        ("fault add: joint1 --kind joint-stuck --from 5 --to 3", ["a fault from 5 s to 3 s never acts"]),
        ("spawn: slidr", ["no shipped model 'slidr'"]),
        ("spawn: none/robot.urdf", ["none/robot.urdf: no such file"]),
        ("record: '-a -O ${tmp}/x.txt'", ["/x.txt is neither a .bag nor a .mcap file"]),
        *(
            (f"controller {verb}", ["no controller 'wheel' in config/slider_control.yaml."])
            for verb in ("start: wheel", "stop: wheel", "load: wheel", "unload: /slider/wheel", "switch: --start wheel")
        ),
        ("{wait: {target: a/b, nera: 1, tol: }, wihtin: 3}", ["'wihtin'", "'nera' of wait", "'tol' of wait has no"]),
        ("{wait: a/b --naer 3, wihtin: 3, at: soon}", ["'at' is a time", "'wihtin'", "No such option '--naer'"]),
    ],
)
def test_what_no_world_would_take_is_a_slip_unless_the_step_is_to_fail(
    slidectl: CommandLine, write: Write, step: str, said: list[str]
) -> None:
    spawn = "spawn: slider --controllers config/slider_control.yaml"
    file = write("slip.yaml", f"cases: [{{name: a}}, {{name: b}}]\nsteps:\n  - {spawn}\n  - {step}\n")
    done = slidectl("test", str(file), "--check")
    assert (done.returncode, done.stdout) == (2, "")
    mistakes = [line for line in done.stderr.removeprefix("error: ").splitlines() if line.startswith(f"{file}:")]
    assert all(
        mistake.startswith(f"{file}:4: ") and part in mistake for mistake, part in zip(mistakes, said, strict=True)
    )


def test_nothing_is_a_slip_that_an_earlier_step_may_have_made_right(slidectl: CommandLine, write: Write) -> None:
    control = write("control.yaml", (ROOT / "config" / "slider_control.yaml").read_text("utf-8"))
    robot = control.parent / "made.urdf"
    file = write("right.yaml", f"""{PLAIN}steps:
  - urdf: slider -o {robot}
  - spawn: {robot}
  - {{fault add: joint1 --kind nokind, fails: no kind of fault}}
  - {{spawn: slidr, fails: true}}
  - {{controller start: joint_state_controller, fails: no controller}}
  - {{launch: my_slidr slider.launch, fails: my_slidr}}
  - sim save: begin
  - at: 0.5
  - sim load: begin
  - {{at: 0.2, service call: /gazebo/reset_simulation}}
  - at: 0.1
  - controller config: {control}
  - controller spawn: joint_state_controller
  - urdf: slider -o "${{tmp}}/other.urdf"
  - {{spawn: "${{tmp}}/other.urdf -n other", fails: namespace}}
""")  # fmt: skip
    assert [(run["verdict"], run["message"]) for run in results(slidectl, str(file)).values()] == [("passed", "")]


def test_wrong_files_are_named_with_their_lines_and_never_tracebacks(slidectl: CommandLine, write: Write) -> None:
    merges = "\n".join(f"  m{i}: &m{i} {{<<: [*m{i - 1}, *m{i - 1}]}}" for i in range(1, 60))
    files = {
        "date": ("steps:\n  - {at: 2001-99-99}", "2: '2001-99-99' cannot be read: month must be in 1..12"),
        "number": ("vars: {x: !!int foo}\nsteps: [robots]", "1: 'foo' cannot be read: invalid literal"),
        "flag": ("vars: {x: !!bool foo}\nsteps: [robots]", "1: 'foo' cannot be read"),
        "digits": (f"vars: {{x: {'9' * 5000}}}\nsteps: [robots]", "1: '999"),
        "object": ("vars: {x: !!python/object:os.x y}\nsteps: [robots]", "1: 'y' cannot be read: could not determine"),
        "tags": ("cases: [{x: 1, tags: 5}]\nsteps: [robots]", "1: 'tags' is a list of texts, not 5"),
        "xfail": ("cases: [{xfail: ' '}]\nsteps: [robots]", "1: 'xfail' is a text that says why, not empty"),
        "why": ("xfail:\nsteps: [robots]", "1: 'xfail' is a text that says why, not null"),
        "cases": ("cases: []\nsteps: [robots]", "1: 'cases' is empty"),
        "key": ("? [a, b]\n: 1\nsteps: [robots]", "1: a list or mapping is not a name"),
        "merge": ("<<: 5\nsteps: [robots]", "1: `<<` merges mappings only"),
        "merges": (f"vars:\n  m0: &m0 {{a: 1}}\n{merges}\nsteps: [robot]", "62: no step 'robot'."),
        "option": ("steps:\n  - wait: {target: a, near: }", "2: 'near' of wait has no value"),
        "fork": ("steps:\n  - sim fork: x -i forked", "2: sim fork leaves a daemon behind"),
        "keep": ("steps:\n  - replay: x --keep", "2: --keep leaves a daemon behind"),
        "tool": ("steps:\n  - ros: -q roslaunch x.launch", "2: roslaunch brings up a world"),
    }
    paths = {name: write(f"{name}.yaml", text) for name, (text, _) in files.items()}
    os.mkfifo(paths["key"].parent / "pipe.yaml")
    done = slidectl("test", str(paths["key"].parent), "--check")
    assert (done.returncode, "a bug in slidectl" in done.stderr) == (2, False)
    for name, (_, said) in files.items():
        assert f"{paths[name]}:{said}" in done.stderr
    assert "is a folder, and ::a is a case of a file" in slidectl("test", f"{paths['key'].parent}::a").stderr
    nothing = write("nothing.yaml", "world: {gravity: null, engine: null}\nsteps: [robots]")
    assert results(slidectl, str(nothing), "--sim-timeout", "1e300")["nothing"]["verdict"] == "passed"


def test_a_file_of_too_many_steps_is_refused_before_they_are_read(
    slidectl: CommandLine, write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {
        "steps": ("steps:\n" + "- sim step: 1\n" * 100_000, "10002: more than 10000 items in a list"),
        "deep": ("steps:\n" + "- " * 900 + "robots", "nested too deep"),
        "aliases": (
            "vars:\n  a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1]\n"
            + "".join(f"  a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 8)}]\n" for n in range(1, 20))
            + "steps: [robots]",
            "is too large, or nested too deeply",
        ),
        "values": (
            "vars:\n" + "".join(f"  a{n}: [{'1, ' * 999}]\n" for n in range(101)) + "steps: [robots]",
            "101: more than 100000 values",
        ),
        "cases": (
            "cases:\n" + "".join(f"- {{x: {n}}}\n" for n in range(1000)) + "steps:\n" + "- robots\n" * 200,
            "1: 200000 steps in 1000 cases: a file may have 100000 in all",
        ),
    }
    for name, (text, said) in files.items():
        file = write(f"{name}.yaml", text)
        done = slidectl("test", "--list", str(file))
        assert (done.returncode, "a bug in slidectl" in done.stderr) == (2, False)
        assert f"{file}:" in done.stderr
        assert said in done.stderr
    monkeypatch.setattr(scenario_file.yaml_tree, "documents", lambda *_: pytest.fail("it is read"))
    monkeypatch.setattr(yaml, "parse", counted := Counted(yaml.parse))
    mistakes: list[BadFile] = []
    assert scenario_file.read(str(write("steps.yaml", files["steps"][0])), StepRunner(False), mistakes) == []
    assert len(mistakes) == 1
    assert counted.events < 50_000  # of 400 000


class Counted:
    """PyYAML's function, which tells of how many events it was asked."""

    def __init__(self, parse: Callable[..., Iterator[yaml.Event]]) -> None:
        self.events = 0
        self._parse = parse

    def __call__(self, *arguments: Any) -> Iterator[yaml.Event]:
        for event in self._parse(*arguments):
            self.events += 1
            yield event


def test_a_file_with_many_mistakes_is_not_checked_to_its_end(slidectl: CommandLine, write: Write) -> None:
    file = write("wrong.yaml", "steps:\n" + "".join(f"- wiat{n}: 1\n" for n in range(5000)))
    done = slidectl("test", "--check", str(file), "--json")
    assert (done.returncode, len(done.stdout.splitlines())) == (2, 100)


def test_only_a_failure_of_the_command_is_one_that_was_to_come(slidectl: CommandLine, write: Write) -> None:
    cases = {
        "past": "[sim step: 3s, {at: 1.0, robots: , fails: true}]",
        "used_up": "[{wait: /clock/clock --above 30, within: 100, fails: not}]",
        "later": "[{wait: /clock/clock --above 30 --within 1, background: true, fails: was not above}, sim step: 2s]",
        "goes_on": "[{pub: /x std_msgs/Float64 1 -r 10 --allow-unheard, background: true, fails: true}, sim step: 2s]",
        "own_limit": "[{sim step: 3s, within: 1, fails: true}]",
    }
    files = [str(write(f"{name}.yaml", f"{PLAIN}sim_timeout: 5\nsteps: {steps}")) for name, steps in cases.items()]
    found = {name: (run["verdict"], run["message"]) for name, run in results(slidectl, *files).items()}
    assert found.pop("past") == ("failed", "it is 3 s already, and the step is at 1 s")
    assert found.pop("used_up")[1].startswith("not done within the 5 s of the case of simulated time")
    assert found.pop("goes_on") == ("failed", "it should have failed")
    assert found == {"later": ("passed", ""), "own_limit": ("passed", "")}


def test_a_case_at_its_wall_limit_names_the_step_and_is_not_run_again_and_xfail_covers_no_error(
    slidectl: CommandLine, write: Write, tmp_path: Path
) -> None:
    step = "sim step 1000000s --timeout 1e9"
    wall = write("wall.yaml", f"{PLAIN}timeout: 1\nxfail: slow\nsteps:\n  - robots\n  - {step}")
    setup = write("setup.yaml", f"{PLAIN}xfail: it drifts\nsetup: [delete nobody]\nsteps: [robots]")
    kept = tmp_path / "kept"
    found = results(slidectl, str(wall), str(setup), "--keep-failed", str(kept), "--sim-timeout", "1e8")
    ended = found["wall"]
    assert (ended["verdict"], ended["message"], ended["was_ended"]) == (
        "error",
        "not done within 1 s of wall time",
        True,
    )
    assert (ended["step"], ended["line"], ended["section"], ended["kept"]) == (step, 6, "steps", [])
    assert ended["hint"].startswith("not recorded")
    assert ended["sim_time"] > 0
    assert found["setup"]["verdict"] == "error"
    assert sorted(found["setup"]["kept"]) == sorted(map(str, kept.iterdir()))


def test_paths_that_cannot_be_written_are_told_of_before_anything_runs_or_beside_the_failure(
    slidectl: CommandLine, write: Write, tmp_path: Path
) -> None:
    file = write("two.yaml", f"{PLAIN}cases: [{{name: a b}}, {{name: a_b}}]\nsteps: [delete nobody]")
    for words in (("--junitxml", str(tmp_path / "none" / "out.xml")), ("--keep-failed", str(file))):
        done = slidectl("test", str(file), *words)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"{words[1]}: cannot be written: " in done.stderr
    kept = tmp_path / "kept"
    ran = results(slidectl, str(file), "--keep-failed", str(kept))
    assert len({path for run in ran.values() for path in run["kept"]}) == 4
    in_the_way = next(path for path in ran["a_b"]["kept"] if path.endswith(".journal"))
    os.unlink(in_the_way)
    os.mkdir(in_the_way)
    again = results(slidectl, str(file), "--keep-failed", str(kept))["a_b"]
    assert (again["verdict"], again["message"].splitlines()[0]) == ("failed", "no robot 'nobody'.")
    assert again["message"].splitlines()[1].startswith(f"not recorded: {in_the_way}")
    full = slidectl("test", str(file), "--junitxml", "/dev/full")
    assert full.returncode == 2
    assert "2 failed" in full.stdout
    assert "/dev/full: cannot be written: No space left on device" in full.stderr


def test_keywords_are_words_with_and_or_not_and_brackets_alone(slidectl: CommandLine, write: Write) -> None:
    file = write("k.yaml", "cases: [{name: one}, {name: two}]\nsteps: [robots]")
    assert slidectl.ok("test", str(file), "--list", "-k", "not (one or three) and True or k.yaml::two").split() == [
        f"{file}::two"
    ]
    for text in ("one(two)", "one two", "()", "not " * 3000 + "one", "(" * 500 + "one" + ")" * 500):
        done = slidectl("test", str(file), "--list", "-k", text)
        assert (done.returncode, done.stdout) == (2, "")
        assert "-k takes words with and, or, not and ( )" in done.stderr


def test_ctrl_c_before_the_first_case_has_begun_ends_it_too(
    slidectl: CommandLine, write: Write, tmp_path: Path
) -> None:
    file = write("long.yaml", f"{PLAIN}timeout: 30\nsteps: [sim step: 1000000s --timeout 1e9]")
    xml = tmp_path / "out.xml"
    made = tmp_path / "made"
    made.mkdir()
    process = slidectl.start("test", str(file), "--junitxml", str(xml), "--sim-timeout", "1e8", TMPDIR=str(made))
    eventually(lambda: list(made.glob("slidectl-test-*")), "no folder was made for the cases")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    suite = etree.parse(xml).find("testsuite")
    assert suite is not None
    assert int(suite.get("skipped")) + int(suite.get("errors")) == 1


def test_nothing_that_a_user_has_for_pytest_changes_a_run(slidectl: CommandLine, write: Write) -> None:
    two = write("two.yaml", f"{PLAIN}cases: [{{name: one}}, {{name: two}}]\nsteps: [robots]")
    breaks = 'raise SystemExit("of the user")\n'
    for name in ("conftest.py", "plugin_of_mine.py", "execnet.py", "pickle.py", "platform.py"):
        write(name, breaks)
    write("pytest.ini", "[pytest]\naddopts = --no-such-option\n")
    variables = {"PYTEST_ADDOPTS": "--no-such-option", "PYTEST_PLUGINS": "plugin_of_mine", "PYTHONSAFEPATH": "1"}
    for count in ("1", "2"):
        done = slidectl("test", "two.yaml", "-n", count, cwd=two.parent, **variables)
        assert (done.returncode, done.stdout.splitlines()[-1], done.stderr) == (0, "2 passed", "")
    assert not (two.parent / ".pytest_cache").exists()


def test_file_names_may_have_colons_and_bytes_that_are_not_utf_8(slidectl: CommandLine, tmp_path: Path) -> None:
    folder = tmp_path / "scenarios"
    folder.mkdir()
    text = f"{PLAIN}cases: [{{name: one}}, {{name: 'two::three[4]'}}]\nsteps: [delete nobody]"
    for name in (b"a::b.yaml", b"caf\xe9.yaml"):
        (folder / os.fsdecode(name)).write_text(text)
    xml = tmp_path / "out.xml"
    for count in ("1", "2"):
        done = slidectl("test", str(folder), "-n", count, "--junitxml", str(xml))
        assert (done.returncode, done.stderr) == (1, "")
        assert done.stdout.splitlines()[-1] == "4 failed"
        assert etree.parse(xml).find("testsuite").get("failures") == "4"
    one = slidectl("test", f"{folder}/a::b.yaml::two::three[4]", "--list")
    assert one.stdout == f"{folder}/a::b.yaml::two::three[4]\n"
    assert slidectl.ok("test", f"{folder}/a::b.yaml", "--list").splitlines()[0] == f"{folder}/a::b.yaml::one"


def test_a_worker_that_dies_is_named_with_its_scenario_and_the_others_run(slidectl: CommandLine, write: Write) -> None:
    killer = write("killer.py", "import os, signal\nos.kill(os.getppid(), signal.SIGKILL)\n")
    write("killed.yaml", f"world: {{engine: plain, imports: [{killer}]}}\nsteps: [robots]")
    write("others.yaml", f"{PLAIN}cases: [{{name: one}}, {{name: two}}, {{name: three}}]\nsteps: [robots]")
    found = results(slidectl, str(killer.parent), "-n", "2")
    killed = next(result for name, result in found.items() if "killed" in name)
    assert killed["verdict"] == "error"
    assert re.fullmatch(r"worker 'gw\d' crashed while running '.*killed.yaml::killed'", killed["message"])
    assert sorted(result["verdict"] for result in found.values()) == ["error", "passed", "passed", "passed"]


def test_without_pytest_it_says_what_to_install(slidectl: CommandLine, write: Write) -> None:
    file = write("one.yaml", "steps: [robots]")
    hidden = write("sitecustomize.py", "import sys\nsys.modules['xdist'] = None\n").parent
    done = slidectl("test", str(file), PYTHONPATH=str(hidden))
    assert (done.returncode, done.stdout) == (1, "")
    assert "scenarios run with the library pytest-xdist" in done.stderr
    assert "[test]'" in done.stderr
    assert slidectl("test", str(file), "--check", PYTHONPATH=str(hidden)).returncode == 0
