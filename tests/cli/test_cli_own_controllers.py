"""Controllers of the user's own, from files: loaded, edited, reloaded, and every way in which they may be broken."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent

import pytest
from command_line import CommandLine, Done
from daemon_fixture import Runtime

LAW = '''
from slidectl.control import NUMBER, TEXT, Controller, EffortJointInterface, Parameter, params

JOINT = Parameter("joint", TEXT, "the joint that it pushes", default="joint1")
PUSH = Parameter("push", NUMBER, "how hard", unit="N", default=1.0)


class Push(Controller):
    interface_type = EffortJointInterface
    parameters = (JOINT, PUSH)

    def init(self, interface, node):
        self.joint = interface.get_handle(params.value_of(node, JOINT))
        self.push = params.value_of(node, PUSH)
        self.told = node.advertise("told", "std_msgs/Float64")

    def update(self, time_ns, period_s):
        self.joint.command = self.push
        self.told.publish({"data": self.joint.command})
'''


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


# -- load --------------------------------------------------------------------------------------------------------------


def test_a_law_from_a_file_is_loaded_started_and_listed(slider: CommandLine, law: Path) -> None:
    loaded = slider("controller", "load", "my_law", "--from", "my_laws.py:Push", cwd=law.parent)
    assert loaded.stdout == "my_law: initialized (was unloaded)\n", loaded.stderr
    assert slider.ok("controller", "start", "my_law") == "my_law: running (was initialized)\n"
    assert "my_laws/Push" in slider.ok("controller", "list", "-v")
    assert effort(slider) == 1.0
    assert "my_laws/Push" in slider.ok("controller", "types")


def test_the_class_need_not_be_named_when_the_file_has_one_controller(slider: CommandLine, law: Path) -> None:
    slider.ok("controller", "load", "my_law", "--from", str(law), "--cm", "/slider")
    assert state(slider) == "initialized"


def test_parameters_are_those_of_the_namespace_and_are_checked_like_any(slider: CommandLine, law: Path) -> None:
    slider.ok("param", "set", "/slider/my_law/push", "2.5", "--new")
    slider.ok("controller", "load", "my_law", "--from", f"{law}:Push")
    slider.ok("controller", "start", "my_law")
    assert effort(slider) == 2.5
    done = slider("param", "set", "/slider/my_law/push", "much")
    assert done.returncode == 1
    assert "must be a number" in done.stderr


def test_it_is_loaded_again_by_its_type_after_it_was_unloaded(slider: CommandLine, law: Path) -> None:
    slider.ok("controller", "load", "my_law", "--from", f"{law}:Push")
    slider.ok("controller", "unload", "my_law")
    assert slider.ok("controller", "spawn", "my_law") == "my_law: running (was unloaded)\n"


def test_any_client_can_load_and_reload(slider: CommandLine, law: Path) -> None:
    with slider.client() as client:
        request = {"robot": "slider", "name": "my_law", "file": str(law), "class_name": "Push"}
        assert client.call("/slidectl/load_controller_file", request) == {"ok": True}
        assert client.call("/slidectl/reload_controller", {"robot": "/slider", "name": "my_law"}) == {"ok": True}
        assert client.controllers("/slider").states() == {"my_law": "initialized"}


# -- what is wrong with a file -----------------------------------------------------------------------------------------


def test_a_file_that_is_not_there(slider: CommandLine, tmp_path: Path) -> None:
    assert refused(slider, tmp_path / "no.py") == f"error: {tmp_path}/no.py: no such file\n"


@pytest.mark.parametrize("word", ["my_laws", "my_laws:Push", "my_laws.txt:Push"])
def test_a_word_that_names_no_python_file(slider: CommandLine, word: str) -> None:
    done = slider("controller", "load", "my_law", "--from", word)
    assert (done.returncode, done.stderr) == (2, f"error: --from takes FILE.py or FILE.py:CLASS, not {word!r}\n")


def test_one_file_is_for_one_controller(slider: CommandLine, law: Path) -> None:
    done = slider("controller", "load", "a", "b", "--from", str(law))
    assert (done.returncode, done.stderr) == (2, "error: --from is for one controller, and here are 2 names\n")


def test_a_syntax_error(slider: CommandLine, tmp_path: Path) -> None:
    bad = written(tmp_path / "bad.py", "x = 1\ndef update(self:\n")
    assert refused(slider, bad) == f"error: {bad}:2: '(' was never closed: def update(self:\n"


def test_a_class_that_is_not_in_the_file(slider: CommandLine, law: Path) -> None:
    text = refused(slider, law, "Pusch", code=1)
    assert text == f"error: no controller class 'Pusch' in {law}. Did you mean 'Push'?\ncontroller classes: Push\n"


def test_a_file_with_two_controllers_and_no_class_named(slider: CommandLine, law: Path) -> None:
    with law.open("a") as file:
        file.write("\nclass Pull(Push):\n    pass\n")
    done = slider("controller", "load", "my_law", "--from", str(law))
    assert (done.returncode, done.stderr.splitlines()[0]) == (2, f"error: {law} has 2 controllers: Pull, Push")


def test_a_class_that_is_no_controller(slider: CommandLine, tmp_path: Path) -> None:
    bad = written(tmp_path / "bad.py", "\nclass Push:\n    pass\n")
    assert f"{bad}:2: Push is no controller" in refused(slider, bad)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("time_ns, period_s", "time_ns", 18, "Push.update has a wrong signature: (self, time_ns) takes no call with"),
        ("self, interface, node", "self", 13, "def init(self, interface, node): ..."),
        ("def update", "def updates", 9, "Push has no update"),
        ("    interface_type = EffortJointInterface\n", "", 9, "Push does not say on which interface it is"),
        ("def init(", "def __init__(self, gain): pass\n\n    def init(", 13, "Push.__init__ has a wrong signature"),
        ("def init(", "def __init__(self): pass\n\n    def init(", 9, "does not call super().__init__()"),
        ("\nJOINT", "1 / 0\nJOINT", 3, "ZeroDivisionError: division by zero"),
        ("\nJOINT", "import no_such_thing\nJOINT", 3, "No module named 'no_such_thing'"),
        ("\nJOINT", "raise SystemExit(1)\nJOINT", 3, "SystemExit: 1"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(
    slider: CommandLine, tmp_path: Path, old: str, new: str, line: int, said: str
) -> None:
    bad = written(tmp_path / "bad.py", LAW.replace(old, new))
    code = 1 if "super()" in said else 2
    text = refused(slider, bad, code=code)
    assert f"{bad}:{line}: " in text
    assert said in text


def test_an_exception_in_init(slider: CommandLine, tmp_path: Path) -> None:
    bad = written(tmp_path / "bad.py", LAW.replace("        self.told =", "        {}['gain']\n        self.told ="))
    text = refused(slider, bad, code=1)
    assert text == f"error: cannot load controller 'my_law': KeyError: 'gain' ({bad}:16)\n"


def test_a_joint_that_the_robot_has_not(slider: CommandLine, law: Path) -> None:
    slider.ok("param", "set", "/slider/my_law/joint", "elbow", "--new")
    assert "no joint 'elbow'" in refused(slider, law, code=1)


def test_a_name_that_is_taken(slider: CommandLine, law: Path) -> None:
    slider.ok("controller", "load", "my_law", "--from", f"{law}:Push")
    done = slider("controller", "load", "my_law", "--from", f"{law}:Push")
    told = "error: cannot load controller 'my_law': it is loaded already\nslidectl controller reload my_law\n"
    assert (done.returncode, done.stderr) == (1, told)


@pytest.mark.parametrize(("old", "line"), [("JOINT = ", 4), ("        self.told =", 16)])
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
    for factor in (3, 4, 5):
        written(law, LAW.replace("= self.push\n", f"= {factor} * self.push\n"))
        assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, running\n"
        assert effort(pushing) == factor * 2.0


def test_a_stopped_law_stays_stopped(pushing: CommandLine) -> None:
    pushing.ok("controller", "stop", "my_law")
    assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, initialized (was stopped)\n"


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("def update(self", "def update(self:", 2),
        ("time_ns, period_s", "time", 2),
        ("class Push", "class Pull", 1),
        ("self.push = ", "self.push = 1 / 0 +", 1),
    ],
)
def test_a_law_runs_on_when_its_edited_file_is_broken(
    pushing: CommandLine, law: Path, old: str, new: str, code: int
) -> None:
    written(law, LAW.replace(old, new))
    done = pushing("controller", "reload", "my_law")
    assert done.returncode == code, done.stderr
    assert str(law) in done.stderr
    assert state(pushing) == "running"
    assert effort(pushing) == 2.0


def test_a_law_that_raises_is_aborted_with_file_and_line_and_runs_again_when_it_is_mended(
    pushing: CommandLine, law: Path
) -> None:
    pushing.ok("param", "set", "/slider/states/type", "joint_state_controller/JointStateController", "--new")
    pushing.ok("controller", "spawn", "states")
    written(law, LAW.replace("= self.push\n", "= self.push / 0\n"))
    pushing.ok("controller", "reload", "my_law")
    pushing.ok("sim", "step", "2")
    assert state(pushing) == "aborted"
    assert state(pushing, "states") == "running"
    log = pushing.ok("daemon", "logs", "-n", "5")
    assert f"'my_law' failed and is aborted: ZeroDivisionError: float division by zero ({law}:19)" in log
    written(law, LAW)
    assert pushing.ok("controller", "reload", "my_law") == "my_law: reloaded, running (was aborted)\n"
    assert effort(pushing) == 2.0


def test_a_controller_of_slidectl_is_not_reloaded(slider: CommandLine) -> None:
    slider.ok("param", "set", "/slider/states/type", "joint_state_controller/JointStateController", "--new")
    slider.ok("controller", "spawn", "states")
    done = slider("controller", "reload", "states")
    assert (done.returncode, state(slider, "states")) == (1, "running")
    assert "only those of users are reloaded" in done.stderr


def test_a_file_imports_what_stands_beside_it(slider: CommandLine, tmp_path: Path) -> None:
    written(tmp_path / "beside.py", "FACTOR = 7.0\n")
    law = written(tmp_path / "my_laws.py", "from beside import FACTOR\n" + LAW.replace("= self.push\n", "= FACTOR\n"))
    slider.ok("controller", "load", "my_law", "--from", f"{law}:Push")
    slider.ok("controller", "start", "my_law")
    assert effort(slider) == 7.0


# -- daemon start --import ---------------------------------------------------------------------------------------------


@pytest.fixture
def empty() -> Iterator[CommandLine]:
    """The command line in a folder of its own, without a daemon."""
    runtime = Runtime()
    yield CommandLine(runtime.folder)
    runtime.remove()


@pytest.mark.parametrize("word", ["my_laws", "my_laws.py"])
def test_types_of_an_imported_module_are_there_from_the_start(empty: CommandLine, law: Path, word: str) -> None:
    done = empty("daemon", "start", "--paused", "--import", word, cwd=law.parent)
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
        ("1 / 0\n", "my_laws.py:1: ZeroDivisionError: division by zero"),
        ("x = 1\n", "my_laws.py: there is no controller in it"),
        (LAW.replace("time_ns, period_s", "time"), "Push.update has a wrong signature"),
        ("while True: pass\n", "the code ran longer than 5 s"),
    ],
)
def test_a_daemon_with_a_broken_module_does_not_start(empty: CommandLine, law: Path, text: str, said: str) -> None:
    written(law, text)
    done = empty("daemon", "start", "--import", str(law))
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert empty("daemon", "status").returncode == 3


def test_a_module_that_is_nowhere(empty: CommandLine) -> None:
    done = empty("daemon", "start", "--import", "no_such_laws")
    assert done.returncode == 2
    assert "no module 'no_such_laws' is installed, nor is there a file no_such_laws.py here" in done.stderr


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
