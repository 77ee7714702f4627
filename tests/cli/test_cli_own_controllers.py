"""Controllers of the user's own, from files: loaded, edited, reloaded, and every way in which they may be broken."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent

import pytest
from command_line import CommandLine, Done
from daemon_fixture import Runtime
from push_law import LAW


@pytest.fixture(autouse=True)
def _empty_again(world: CommandLine) -> Iterator[None]:
    yield
    if world.ok("robots", "--json"):
        world.ok("delete", "slider")
    with world.client() as client:
        for top in {name.split("/")[1] for name in client.call("/rosapi/get_param_names")["names"]}:
            client.call("/rosapi/delete_param", {"name": f"/{top}"})


@pytest.fixture
def slider(world: CommandLine) -> CommandLine:
    world.ok("spawn", "slider")
    return world


@pytest.fixture
def law(tmp_path: Path) -> Path:
    """The file of a law that works."""
    return written(tmp_path / "my_laws.py", LAW)


def written(path: Path, text: str) -> Path:
    path.write_text(dedent(text), encoding="utf-8")
    return path


def state(world: CommandLine, name: str = "my_law") -> str | None:
    records = map(json.loads, world.ok("controller", "list", "--json").splitlines())
    return {record["name"]: record["state"] for record in records}.get(name)


def effort(world: CommandLine) -> float:
    """What the law tells in the next cycle."""
    with world.client() as client, client.subscribe("/slider/my_law/told") as told:
        client.step(2)
        return float(told.get()["data"])


def refused(world: CommandLine, file: Path, class_name: str = "Push", code: int = 2) -> str:
    """What `load --from` says. Nothing is left behind."""
    done: Done = world("controller", "load", "my_law", "--from", f"{file}:{class_name}")
    assert done.returncode == code, done.stderr
    assert state(world) is None
    assert "/slider/my_law/type" not in world.ok("param", "list")
    assert "internal error" not in done.stderr
    return done.stderr


BROKEN = [
    ("1 / 0\n", "my_laws.py:1: ZeroDivisionError: division by zero"),
    ("x = 1\n", "my_laws.py: it defines no controller"),
    (LAW.replace("def init(self", "def init(self:"), "my_laws.py:12: "),
    (LAW.replace("time_ns, period_s", "time"), "Push.update has a wrong signature"),
]
"""Texts of modules, and what is said of each."""


# -- load --------------------------------------------------------------------------------------------------------------


def test_a_law_from_a_file_is_loaded_started_and_listed(slider: CommandLine, law: Path) -> None:
    loaded = slider("controller", "load", "my_law", "--from", "my_laws.py:Push", cwd=law.parent)
    assert loaded.stdout == "my_law: initialized (was unloaded)\n", loaded.stderr
    assert slider.ok("controller", "start", "my_law") == "my_law: running (was initialized)\n"
    assert "my_laws/Push" in slider.ok("controller", "list", "-v")
    assert effort(slider) == 1.0
    assert "my_laws/Push" in slider.ok("controller", "types")


def test_any_client_can_load_and_reload(slider: CommandLine, law: Path) -> None:
    with slider.client() as client:
        request = {"robot": "slider", "name": "my_law", "file": str(law), "class_name": "Push"}
        assert client.call("/slidectl/load_controller_file", request) == {"ok": True}
        assert client.call("/slidectl/reload_controller", {"robot": "/slider", "name": "my_law"}) == {"ok": True}
        assert client.controllers("/slider").states() == {"my_law": "initialized"}


def test_a_controller_that_is_not_loaded_cannot_be_reloaded(slider: CommandLine) -> None:
    slider.ok("param", "set", "/slider/idle/type", "effort_controllers/JointPositionController", "--new")
    done = slider("controller", "reload", "idle")
    assert done.returncode == 1
    assert done.stderr == (
        "error: cannot reload controller 'idle': it is not loaded\nload it: slidectl controller load idle\n"
    )


def test_a_file_that_is_not_there(slider: CommandLine, tmp_path: Path) -> None:
    assert refused(slider, tmp_path / "no.py") == f"error: {tmp_path}/no.py: no such file\n"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("def init(self", "def init(self:", "my_laws.py:12: "),
        (
            "time_ns, period_s",
            "time",
            "my_laws.py:17: Push.update has a wrong signature: (self, time), but it is called with",
        ),
        ("class Push", "class Pull", "error: no controller class 'Push' in "),
    ],
)
def test_a_file_that_is_wrong(slider: CommandLine, law: Path, old: str, new: str, said: str) -> None:
    code = 1 if "no controller class" in said else 2
    assert said in refused(slider, written(law, LAW.replace(old, new)), code=code)


def test_a_word_that_names_no_python_file(world: CommandLine) -> None:
    done = world("controller", "load", "my_law", "--from", "my_laws:Push")
    assert (done.returncode, done.stderr) == (2, "error: --from takes FILE.py or FILE.py:CLASS, not 'my_laws:Push'\n")


@pytest.mark.parametrize(("old", "line"), [("JOINT = ", 4), ("        self.told =", 15)])
def test_a_loop_without_an_end_is_ended_and_the_daemon_answers_again(
    slider: CommandLine, tmp_path: Path, old: str, line: int
) -> None:
    space = " " * (len(old) - len(old.lstrip()))
    bad = written(tmp_path / "bad.py", LAW.replace(old, f"{space}while True: pass\n{old}", 1))
    text = refused(slider, bad, code=1)
    assert f"the code ran longer than 5 s and was ended ({bad}:{line})" in text
    assert slider.ok("sim", "status")


# -- edited ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def pushing(slider: CommandLine, law: Path) -> CommandLine:
    """The law runs."""
    slider.ok("param", "set", "/slider/my_law/push", "2.0", "--new")
    slider.ok("controller", "load", "my_law", "--from", f"{law}:Push")
    slider.ok("controller", "start", "my_law")
    return slider


def test_an_edited_law_runs_on_with_its_name_and_parameters(pushing: CommandLine, law: Path) -> None:
    assert effort(pushing) == 2.0
    for factor in (3, 4):
        written(law, LAW.replace("= self.push\n", f"= {factor} * self.push\n"))
        assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, running\n"
        assert effort(pushing) == factor * 2.0


def test_a_law_that_raises_is_aborted_with_file_and_line_and_runs_again_when_it_is_mended(
    pushing: CommandLine, law: Path
) -> None:
    pushing.ok("param", "set", "/slider/states/type", "joint_state_controller/JointStateController", "--new")
    pushing.ok("param", "set", "/slider/states/publish_rate", "50", "--new")
    pushing.ok("controller", "spawn", "states")
    written(law, LAW.replace("= self.push\n", "= self.push / 0\n"))
    pushing.ok("controller", "reload", "my_law")
    pushing.ok("sim", "step", "2")
    assert state(pushing) == "aborted"
    assert state(pushing, "states") == "running"
    log = pushing.ok("daemon", "logs", "-n", "5")
    assert f"'my_law' failed in update and is aborted: ZeroDivisionError: float division by zero ({law}:18)" in log
    written(law, LAW)
    assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, running (was aborted)\n"
    assert effort(pushing) == 2.0


@pytest.mark.parametrize(
    "exit_",
    [
        "__import__('sys').exit(3)",
        "raise KeyboardInterrupt",
        "raise GeneratorExit",
        "raise __import__('asyncio').CancelledError",
    ],
)
@pytest.mark.parametrize("hook", ["starting(self, time_ns)", "update(self, time_ns, period_s)"])
def test_an_exit_in_a_hook_aborts_its_controller_and_the_daemon_goes_on(
    pushing: CommandLine, law: Path, hook: str, exit_: str
) -> None:
    written(law, f"{LAW}\n    def {hook}:\n        {exit_}\n")
    pushing("controller", "reload", "my_law")
    pushing.ok("sim", "step", "2")
    assert state(pushing) == "aborted"
    line = len(LAW.splitlines()) + 3
    assert re.search(
        rf"'my_law' failed in \w+ and is aborted: \w+: 3? ?\({law}:{line}\)", pushing.ok("daemon", "logs", "-n", "5")
    )
    written(law, LAW)
    pushing.ok("controller", "reload", "my_law")
    assert effort(pushing) == 2.0


def test_a_reload_of_a_law_that_fails_in_its_first_update_fails_with_the_reason(
    pushing: CommandLine, law: Path
) -> None:
    text = f"failed in update and is aborted: ZeroDivisionError: float division by zero ({law}:18)"
    written(law, LAW.replace("= self.push\n", "= self.push / 0\n"))
    try:
        pushing.ok("sim", "resume")
        for _ in range(3):
            done = pushing("controller", "reload", "my_law")
            assert (done.returncode, done.stdout) == (1, "")
            assert text in done.stderr
    finally:
        pushing.ok("sim", "pause")
    done = pushing("controller", "reload", "my_law")
    assert (done.returncode, done.stdout) == (0, "my_law: reloaded, running (was aborted)\n")
    assert "the simulation is paused; nothing runs until it goes on: slidectl sim resume" in done.stderr


LOOP = """while True:
            try:
                time_ns += 1
            except Exception:
                pass
"""


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [
        ("self.joint.command = self.push\n", LOOP, range(18, 23)),
        ("    def update", f"    def starting(self, time_ns):\n        {LOOP}\n    def update", range(18, 23)),
    ],
    ids=["update", "starting"],
)
def test_a_loop_without_an_end_in_a_cycle_aborts_its_controller_and_the_others_go_on(
    pushing: CommandLine, law: Path, old: str, new: str, lines: range
) -> None:
    pushing.ok(
        "param", "set", "/slider/states", "{type: joint_state_controller/JointStateController, publish_rate: 50}"
    )
    pushing.ok("controller", "spawn", "states")
    written(law, LAW.replace(old, new))
    pushing("controller", "reload", "my_law")
    pushing.ok("sim", "step", "2")
    assert state(pushing) == "aborted"
    log = pushing.ok("daemon", "logs", "-n", "5")
    [line] = [int(line) for line in re.findall(rf"ran longer than 5 s and was ended \({law}:(\d+)\)", log)]
    assert line in lines
    pushing.ok("sim", "step", "2000")  # with the clock of the limit that has gone by
    assert state(pushing, "states") == "running"
    written(law, LAW)
    assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, running (was aborted)\n"
    assert effort(pushing) == 2.0


def test_a_callback_that_fails_is_an_error_of_its_caller_and_one_that_does_not_end_is_the_last_that_is_called(
    pushing: CommandLine, law: Path
) -> None:
    hear = """
    def hear(self, message):
        while message["data"]: pass
        raise SystemExit(4)
"""
    subscribe = 'node.subscribe("hear", "std_msgs/Bool", self.hear)\n        self.told ='
    text = LAW.replace("self.told =", subscribe, 1) + hear
    written(law, text)
    pushing.ok("controller", "reload", "my_law")
    first = text.splitlines().index("    def hear(self, message):") + 1

    def heard(value: str) -> str:
        done = pushing("pub", "/slider/my_law/hear", value)
        assert done.returncode == 1
        return done.stderr

    assert f"SystemExit: 4 ({law}:{first + 2})" in heard("false")
    assert effort(pushing) == 2.0
    too_long = f"the code ran longer than 5 s and was ended ({law}:{first + 1})"
    assert too_long in heard("true")
    cut_off = f"Push is not called any more, because {too_long}"
    for _ in range(3):  # they would be 15 s, in which nobody is answered
        assert cut_off in heard("true")
    pushing.ok("sim", "step", "2")
    assert state(pushing) == "aborted"
    assert f"'my_law' failed in update and is aborted: {cut_off}" in pushing.ok("daemon", "logs", "-n", "5")
    assert pushing("controller", "start", "my_law").returncode == 1
    assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, running (was aborted)\n"
    assert effort(pushing) == 2.0


@pytest.mark.parametrize(
    "fault", ["raise Silent", "del self.joint.command", "self.joint.velocity = 'x'"], ids=["text", "del", "state"]
)
def test_a_fault_of_a_law_aborts_it_alone_and_the_world_goes_on(pushing: CommandLine, law: Path, fault: str) -> None:
    pushing.ok(
        "param", "set", "/slider/states", "{type: joint_state_controller/JointStateController, publish_rate: 50}"
    )
    pushing.ok("controller", "spawn", "states")
    silent = "class Silent(Exception):\n    def __str__(self): raise ValueError\n"
    written(law, silent + LAW + f"        {fault}\n")
    pushing("controller", "reload", "my_law")
    pushing.ok("sim", "step", "200")
    assert (state(pushing), state(pushing, "states")) == ("aborted", "running")
    assert "'my_law' failed in update and is aborted: " in pushing.ok("daemon", "logs", "-n", "5")
    assert "internal error" not in pushing.ok("daemon", "logs", "-n", "20")


def test_the_times_of_updates_are_listed_and_a_budget_is_warned_of(pushing: CommandLine) -> None:
    pushing.ok("sim", "step", "100")
    [line] = pushing.ok("controller", "list", "-v").splitlines()[1:]
    assert re.search(r" \d+\.\d us, longest \d+\.\d us$", line)
    [record] = map(json.loads, pushing.ok("controller", "list", "-v", "--json").splitlines())
    assert record["update_times"]["updates"] == 100
    assert 0 < record["update_times"]["mean"] <= record["update_times"]["longest"] < 1
    assert "update_times" not in pushing.ok("controller", "list", "--json")
    pushing.ok("param", "set", "/slider/my_law/update_budget", "1e-9", "--new")
    pushing.ok("sim", "step", "100")
    assert pushing.ok("controller", "list", "-v").endswith("100 over 0.001 us\n")
    log = pushing.ok("daemon", "logs", "-n", "20")
    assert (
        len(
            re.findall(
                r"controller 'my_law': an update took .* us; its budget is 0.001 us, which 1 of 101 exceeded", log
            )
        )
        == 1
    )
    assert state(pushing) == "running"


# -- daemon start --import ---------------------------------------------------------------------------------------------


@pytest.fixture
def empty() -> Iterator[CommandLine]:
    """The command line in a folder of its own, without a daemon."""
    runtime = Runtime()
    yield CommandLine(runtime.folder)
    runtime.remove()


def test_types_of_an_imported_module_are_there_from_the_start(empty: CommandLine, law: Path) -> None:
    done = empty("daemon", "start", "--paused", "--import", "my_laws", cwd=law.parent)
    assert done.returncode == 0, done.stderr
    empty.ok("spawn", "slider")
    assert "my_laws/Push" in empty.ok("controller", "types")
    empty.ok("param", "set", "/slider/my_law/type", "my_laws/Push", "--new")
    empty.ok("controller", "spawn", "my_law")
    assert effort(empty) == 1.0
    written(law, LAW.replace("= self.push\n", "= 5.0\n"))
    empty.ok("controller", "reload", "my_law")
    assert effort(empty) == 5.0
    assert f"--import {law}" in empty("daemon", "restart").stderr
    empty.ok("spawn", "slider")
    assert "my_laws/Push" in empty.ok("controller", "types")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *BROKEN,
        ("while True: pass\n", "the code ran longer than 5 s"),
    ],
)
def test_a_daemon_with_a_broken_module_does_not_start(empty: CommandLine, law: Path, text: str, said: str) -> None:
    written(law, text)
    done = empty("daemon", "start", "--import", str(law))
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert empty("daemon", "status").returncode == 3


@pytest.mark.parametrize(("text", "said"), BROKEN)
def test_check_refuses_a_broken_module(empty: CommandLine, law: Path, text: str, said: str) -> None:
    done = empty("check", "slider", "--import", str(written(law, text)))
    assert done.returncode == 2
    assert said in done.stderr


def test_a_module_that_is_nowhere(empty: CommandLine) -> None:
    done = empty("daemon", "start", "--import", "no_such_laws")
    assert done.returncode == 2
    assert "no module 'no_such_laws' is installed, nor is there a file no_such_laws.py here" in done.stderr


# -- check --import ----------------------------------------------------------------------------------------------------


def test_check_knows_the_parameters_of_imported_types(empty: CommandLine, law: Path) -> None:
    file = written(
        law.parent / "my_control.yaml",
        """
        slider:
          good: {type: my_laws/Push, joint: joint1, push: 2.0, update_budget: 1.0e-3}
          bad: {type: my_laws/Push, joint: elbow, push: much, pish: 1}
          free: {type: my_laws/Free, anything: 1}
        """,
    )
    with law.open("a") as text:
        text.write("\n\nclass Free(Push):\n    parameters = ()\n")
    words = ["check", "slider", "--controllers", str(file)]
    assert "'my_laws/Push'" in empty(*words).stdout
    for module in ("my_laws", "my_laws.py"):
        done = empty(*words, "--import", module, "--json", cwd=law.parent)
        found = {record["subject"]: record for record in map(json.loads, done.stdout.splitlines())}
        wrong = {name.removeprefix("/slider/") for name, record in found.items() if record["verdict"] == "wrong"}
        assert (done.returncode, wrong) == (1, {"bad/joint", "bad/push"})
        assert "did you mean 'push'?" in found["/slider/bad/pish"]["text"]
        assert found["/slider/good/update_budget"]["verdict"] == "used"
        assert found["/slider/free/anything"]["text"] == "Free does not say which parameters it reads"


# -- entry points ------------------------------------------------------------------------------------------------------


def test_an_installed_package_brings_types_by_its_entry_points(empty: CommandLine, law: Path) -> None:
    folder = law.parent / "site"
    info = folder / "laws_of_mine-1.0.dist-info"
    info.mkdir(parents=True)
    written(folder / "laws_of_mine.py", LAW)
    written(info / "METADATA", "Metadata-Version: 2.1\nName: laws-of-mine\nVersion: 1.0\n")
    points = "[slidectl.controllers]\nmine/Push = laws_of_mine:Push\nmine/Broken = laws_of_mine:Gone\n"
    written(info / "entry_points.txt", points)
    path = f"{folder}:{empty.environment['PYTHONPATH']}"
    empty.ok("daemon", "start", "--paused", PYTHONPATH=path)
    empty.ok("spawn", "slider")
    assert "mine/Push" in empty.ok("controller", "types")
    empty.ok("param", "set", "/slider/my_law/type", "mine/Push", "--new")
    empty.ok("controller", "spawn", "my_law")
    assert effort(empty) == 1.0
    empty.ok("param", "set", "/slider/other/type", "mine/Broken", "--new")
    done = empty("controller", "load", "other")
    assert done.returncode == 1
    assert "no controller class 'Gone'" in done.stderr
