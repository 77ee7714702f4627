"""Programs of the user's as nodes: started as roslaunch starts them, watched, ended with all they started."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import CommandLine
from launch_runs import Launched, kill_all, nothing_is_left, processes
from waiting import eventually

from slidectl.description.packages import Packages
from slidectl.extensions.launch import files
from slidectl.extensions.launch.loader import load
from slidectl.extensions.launch.node_kinds import tasks
from slidectl.extensions.launch.nodes import programs


class Package:
    """A package `demo` with scripts, in a folder whose name has blanks and letters of all kinds."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "Pfad mit Blänks & 'Quotes'" / "demo"
        (self.folder / "scripts").mkdir(parents=True)
        (self.folder / "package.xml").write_text("<package><name>demo</name></package>")

    def script(self, name: str, text: str, executable: bool = True) -> Path:
        path = self.folder / "scripts" / name
        path.write_text(f"#!/bin/bash\n{text}\n")
        path.chmod(0o755 if executable else 0o644)
        return path

    def launch(self, text: str) -> str:
        path = self.folder / "demo.launch"
        path.write_text(f"<launch>\n{text}\n</launch>")
        return str(path)


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path)


@pytest.fixture(autouse=True)
def clean(slidectl: CommandLine) -> Iterator[None]:
    yield
    kill_all(slidectl.runtime)


@pytest.fixture
def daemon(slidectl: CommandLine) -> Iterator[CommandLine]:
    """With a daemon that runs already, a launch ends when its last process has ended."""
    slidectl.ok("daemon", "start")
    yield slidectl
    slidectl("daemon", "stop")


def test_output_is_shown_with_the_name_of_the_node(daemon: CommandLine, package: Package) -> None:
    package.script("talk", "echo out; echo err >&2; printf 'no end of line'")
    done = daemon("launch", package.launch('<node pkg="demo" type="talk" name="talker" ns="left"/>'))
    assert done.returncode == 0
    assert "[left/talker] out\n" in done.stdout
    assert "[left/talker] no end of line\n" in done.stdout
    assert "[left/talker] err\n" in done.stderr
    assert "/left/talker: finished" in done.stdout


def test_a_program_gets_arguments_remaps_its_name_its_namespace_and_its_environment(
    daemon: CommandLine, package: Package
) -> None:
    show = 'printf "<%s>" "$@"; echo; echo "ns=${ROS_NAMESPACE-none} X=$X instance=$SLIDECTL_INSTANCE"'
    package.script("show", show)
    text = """
      <group ns="left">
        <remap from="pos" to="position"/>
        <env name="X" value="the group's"/>
        <node pkg="demo" type="show" name="a" args="one 'two words' --three"/>
        <node pkg="demo" type="show" name="b" ns="inner"><env name="X" value="its own"/><remap from="q" to="/r"/></node>
      </group>
      <node pkg="demo" type="show" name="c"/>"""
    done = daemon("launch", package.launch(text))
    assert "[left/a] <one><two words><--three><pos:=position><__name:=a><__log:=" in done.stdout
    assert "[left/a] ns=/left X=the group's instance=default\n" in done.stdout
    assert re.search(
        r"\[left/inner/b\] <pos:=position><q:=/r><__name:=b><__log:=/.*/left-inner-b-2\.log>\n", done.stdout
    )
    assert "[left/inner/b] ns=/left/inner X=its own instance=default\n" in done.stdout
    assert "[c] ns=none X= instance=default\n" in done.stdout


def test_everything_is_below_the_namespace_of_the_environment(daemon: CommandLine, package: Package) -> None:
    package.script("show", 'echo "ns=$ROS_NAMESPACE"')
    text = '<node pkg="demo" type="show" name="a"><param name="p" value="1"/></node><param name="/q" value="2"/>'
    file = package.launch(text)
    assert daemon("launch", "--nodes", file, ROS_NAMESPACE="left").stdout == "/left/a\n"
    assert daemon("launch", "--dump-params", file, ROS_NAMESPACE="/left").stdout == "/left/a/p: 1\n/q: 2\n"
    assert "[left/a] ns=/left\n" in daemon("launch", file, ROS_NAMESPACE="left").stdout


def test_a_program_reaches_the_launchs_daemon_and_sees_its_private_parameters(
    slidectl: CommandLine, package: Package
) -> None:
    python = slidectl.argv()[0]
    package.script("ask", f"'{python}' -m slidectl param get /asker/gain; '{python}' -m slidectl param get /asker/both")
    text = """
      <param name="~both" value="shared"/>
      <node pkg="demo" type="ask" name="asker" required="true"><param name="gain" value="2.5"/></node>"""
    done = slidectl("launch", package.launch(text))
    assert done.returncode == 0, done.stderr
    assert "[asker] 2.5\n" in done.stdout
    assert "[asker] shared\n" in done.stdout
    nothing_is_left(slidectl.runtime)


def test_a_launch_prefix_stands_before_the_program_and_cwd_is_its_folder(daemon: CommandLine, package: Package) -> None:
    package.script("where", 'echo "in $PWD, Y=$Y"')
    node = '<node pkg="demo" type="where" name="n" cwd="node" {}/>'
    done = daemon("launch", package.launch(node.format("")))
    assert f"[n] in {package.folder / 'scripts'}, Y=" in done.stdout
    done = daemon("launch", package.launch(node.format('launch-prefix="/usr/bin/env Y=1"')))
    assert "[n] in /usr/bin, Y=1" in done.stdout


def test_a_broken_launch_prefix_fails_the_step(slidectl: CommandLine, package: Package) -> None:
    package.script("talk", "echo hello")
    done = slidectl("launch", package.launch('<node pkg="demo" type="talk" name="n" launch-prefix="/no/gdb --args"/>'))
    assert done.returncode == 1
    assert "demo.launch:2: node /n (demo/talk): cannot run /no/gdb" in done.stderr
    nothing_is_left(slidectl.runtime)


def test_output_log_goes_to_a_file_and_errors_are_still_shown(
    daemon: CommandLine, package: Package, tmp_path: Path
) -> None:
    package.script("talk", "echo quiet; echo loud >&2")
    node = package.launch('<node pkg="demo" type="talk" name="n" output="log"/>')
    done = daemon("launch", node, ROS_LOG_DIR=str(tmp_path / "logs"))
    assert "quiet" not in done.stdout
    assert "[n] loud" in done.stderr
    assert [path.read_text() for path in (tmp_path / "logs").glob("n-*-stdout.log")] == ["quiet\n"]
    assert "[n] quiet" in daemon("launch", node, "--screen").stdout
    node = package.launch('<node pkg="demo" type="talk" name="n" output="screen"/>')
    assert "[n] quiet" not in daemon("launch", node, "--log").stdout


def test_a_node_that_dies_is_reported_and_the_others_go_on(daemon: CommandLine, package: Package) -> None:
    package.script("die", "exit 3")
    package.script("live", "trap 'echo bye; exit 0' INT; echo alive; while :; do sleep 0.05; done")
    text = '<node pkg="demo" type="die" name="d"/><node pkg="demo" type="live" name="l"/>'
    launched = Launched(daemon, package.launch(text))
    launched.until("/d: died: exit code 3")
    launched.until("[l] alive")
    assert launched.interrupt() == 130
    assert "[l] bye" in launched.text


def test_when_all_have_ended_and_one_of_them_badly_the_launch_fails(daemon: CommandLine, package: Package) -> None:
    package.script("die", "exit 3")
    package.script("kill", "kill -SEGV $$")
    done = daemon(
        "launch", package.launch('<node pkg="demo" type="die" name="d"/><node pkg="demo" type="kill" name="k"/>')
    )
    assert done.returncode == 1
    assert "these nodes died: /d (exit code 3), /k (by SIGSEGV)" in done.stderr
    assert "/slidectl/status" in daemon.ok("service", "list")


def test_the_end_of_a_required_node_ends_the_launch(slidectl: CommandLine, package: Package) -> None:
    package.script("die", "exit 3")
    package.script("fine", "exit 0")
    package.script("live", "while :; do sleep 0.05; done")
    others = '<node pkg="demo" type="live" name="l"/>'
    done = slidectl("launch", package.launch(others + '<node pkg="demo" type="die" name="d" required="true"/>'))
    assert done.returncode == 1
    assert "node /d (demo/die): it is required, and it died: exit code 3" in done.stderr
    done = slidectl("launch", package.launch(others + '<node pkg="demo" type="fine" name="f" required="true"/>'))
    assert done.returncode == 0
    assert "/f is required: the launch ends" in done.stdout
    done = slidectl("launch", package.launch(others + '<node pkg="demo" type="die" name="d"/>'), "--required")
    assert done.returncode == 1
    nothing_is_left(slidectl.runtime)


FLOOD = "rm -f fifo; mkfifo fifo; (yes hello | head -c 500000; : > fifo; exec yes hello) & : < fifo"
"""A line of a script: from here on a child of it writes without end, faster than anybody reads."""


def test_the_end_of_a_node_is_noticed_though_a_child_of_it_goes_on_writing(
    slidectl: CommandLine, package: Package
) -> None:
    package.script("leave", f"cd '{slidectl.runtime}'; {FLOOD}; exit 3")
    done = slidectl("launch", package.launch('<node pkg="demo" type="leave" name="n" required="true"/>'))
    assert done.returncode == 1
    assert "[n] hello\n" in done.stdout
    assert "/n: died: exit code 3" in done.stderr
    assert "node /n (demo/leave): it is required, and it died: exit code 3" in done.stderr
    nothing_is_left(slidectl.runtime)


def test_an_interrupt_is_heard_while_what_a_node_left_behind_goes_on_writing(
    slidectl: CommandLine, package: Package
) -> None:
    package.script("leave", f"cd '{slidectl.runtime}'; {FLOOD}; exit 3")
    launched = Launched(slidectl, package.launch('<node pkg="demo" type="leave" name="n"/>'))
    launched.until("/n: died: exit code 3")
    assert launched.interrupt() == 130
    assert "does not end" not in launched.text
    nothing_is_left(slidectl.runtime)


def test_a_node_with_respawn_is_started_again(slidectl: CommandLine, package: Package) -> None:
    package.script("die", "echo born; exit 3")
    launched = Launched(slidectl, package.launch('<node pkg="demo" type="die" name="d" respawn="true"/>'))
    launched.until("[d] born", times=3)
    assert launched.text.count("/d: died: exit code 3") >= 2
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_a_node_that_ends_at_once_again_and_again_is_started_more_and_more_seldom(
    slidectl: CommandLine, package: Package
) -> None:
    package.script("die", "echo born; exit 3")
    launched = Launched(slidectl, package.launch('<node pkg="demo" type="die" name="d" respawn="true"/>'))
    launched.until("started again in 2 s")
    message = "/d: ended {} times in a row within 5 s of its start: it is started again in {} s"
    assert message.format(2, 1) in launched.text
    assert message.format(3, 2) in launched.text
    assert launched.text.count("[d] born") == 3
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_the_pause_before_a_respawn_grows_to_half_a_minute_and_no_further(
    package: Package, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr(programs.time, "monotonic", lambda: now)
    package.script("die", "exit 3")
    text = package.launch('<node pkg="demo" type="die" name="d" respawn="true" respawn_delay="1.5"/>')
    packages = Packages(start=package.folder)
    plan = load(files.find([text], packages), {}, packages)
    (task,) = tasks(plan, packages)
    assert isinstance(task, programs.Process)
    run: Any = SimpleNamespace(console=SimpleNamespace(warn=lambda _: None))
    task.started_at = now - 0.3
    assert [task._respawn_pause(run) for _ in range(9)] == [1.5, 1.5, 2, 4, 8, 16, 30, 30, 30]
    task.started_at = now - 60
    assert task._respawn_pause(run) == 1.5


def test_what_has_just_died_is_not_said_to_run(daemon: CommandLine, package: Package) -> None:
    package.script("die", "exit 3")
    package.script("live", "exec sleep 600")
    nodes = '<node pkg="demo" type="{}" name="d" {}/><node pkg="demo" type="live" name="l"/>'
    launched = Launched(daemon, package.launch(nodes.format("die", "")))
    launched.until("these nodes died: /d (exit code 3); the rest runs (1 node, 0 controllers running)")
    assert "everything runs" not in launched.text
    assert launched.interrupt() == 130
    done = daemon("launch", package.launch(nodes.format("die", 'required="true"')))
    assert done.returncode == 1
    assert "everything runs" not in done.stdout
    assert "it is required, and it died: exit code 3" in done.stderr
    launched = Launched(daemon, package.launch(nodes.format("die", 'respawn="true"')))
    launched.until("these nodes died: /d (exit code 3); the rest runs")
    assert launched.interrupt() == 130
    done = daemon("launch", "--detach", package.launch(nodes.format("die", 'required="true"')))
    assert done.returncode == 1


def test_nodes_end_in_reverse_order(daemon: CommandLine, package: Package) -> None:
    package.script("live", "trap 'echo \"end of $1\"; exit 0' INT; echo up; while :; do sleep 0.02; done")
    nodes = "".join(f'<node pkg="demo" type="live" name="{n}" args="{n}"/>' for n in ("one", "two", "three"))
    launched = Launched(daemon, package.launch(nodes))
    launched.until("] up", times=3)
    assert launched.interrupt() == 130
    places = [launched.text.index(f"end of {name}") for name in ("three", "two", "one")]
    assert places == sorted(places)


def test_one_that_does_not_end_is_told_so_again_and_then_killed_with_all_it_started(
    slidectl: CommandLine, package: Package
) -> None:
    package.script("stubborn", "trap '' INT TERM; sleep 600 & echo up; while :; do sleep 0.05; done")
    launched = Launched(
        slidectl, package.launch('<node pkg="demo" type="stubborn" name="s"/>'), "--sigint-timeout", "0.2",
        "--sigterm-timeout", "0.2",
    )  # fmt: skip
    launched.until("[s] up")
    assert launched.interrupt() == 130
    assert "/s: does not end; sending SIGTERM" in launched.text
    assert "/s: does not end; sending SIGKILL" in launched.text
    nothing_is_left(slidectl.runtime)


def test_a_second_interrupt_waits_for_nobody(slidectl: CommandLine, package: Package) -> None:
    package.script("stubborn", "trap 'echo refused' INT TERM; echo up; while :; do sleep 0.05; done")
    launched = Launched(
        slidectl, package.launch('<node pkg="demo" type="stubborn" name="s"/>'), "--sigint-timeout", "300"
    )
    launched.until("[s] up")
    launched.signal()
    launched.until("refused")
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_what_a_program_left_behind_ends_with_the_launch(slidectl: CommandLine, package: Package) -> None:
    package.script("parent", "(trap '' INT TERM; echo child; exec sleep 600) & exit 0")
    launched = Launched(slidectl, package.launch('<node pkg="demo" type="parent" name="p"/>'))
    launched.until("[p] child")
    launched.until("/p: finished")
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_a_launch_that_is_killed_takes_its_daemon_along(slidectl: CommandLine) -> None:
    launched = Launched(slidectl, "slider")
    launched.up()
    assert launched.end(signal.SIGKILL) == -signal.SIGKILL
    eventually(lambda: not processes(slidectl.runtime), "the daemon outlives the launch")


def test_a_program_that_may_not_be_executed_or_is_not_there_is_named_before_anything_starts(
    slidectl: CommandLine, package: Package
) -> None:
    path = package.script("locked", "echo no", executable=False)
    package.script("talker", "echo yes")
    done = slidectl("launch", package.launch('<node pkg="demo" type="locked" name="n"/>'), "--strict")
    assert done.returncode == 2
    assert f"demo.launch:2: node /n (demo/locked): {path} is not executable" in done.stderr
    assert "chmod +x" in done.stderr
    done = slidectl("launch", package.launch('<node pkg="demo" type="taler" name="n"/>'), "--strict")
    assert done.returncode == 2
    assert "no program 'taler' in the package, and no counterpart here. Did you mean 'talker'?" in done.stderr
    done = slidectl("launch", package.launch('<node pkg="nowhere" type="x" name="n"/>'), "--strict")
    assert done.returncode == 2
    assert "no package 'nowhere'" in done.stderr
    assert "looked in:" in done.stderr
    done = slidectl("launch", package.launch('<node pkg="nowhere" type="x" name="n"/>'), "--dry-run")
    assert done.returncode == 0
    assert "the node /n is left out" in done.stderr


def test_an_executable_of_a_build_is_found_beside_its_share_folder(daemon: CommandLine, tmp_path: Path) -> None:
    share = tmp_path / "install" / "share" / "built"
    built = tmp_path / "install" / "lib" / "built" / "prog"
    share.mkdir(parents=True)
    built.parent.mkdir(parents=True)
    (share / "package.xml").write_text("<package><name>built</name></package>")
    built.write_text("#!/bin/sh\necho built it is\n")
    built.chmod(0o755)
    (share / "a.launch").write_text('<launch><node pkg="built" type="prog" name="n"/></launch>')
    done = daemon("launch", "built", "a.launch", SLIDECTL_PACKAGE_PATH=str(tmp_path / "install" / "share"))
    assert "[n] built it is" in done.stdout, done.stderr


def test_json_is_one_object_a_line_for_steps_and_output(daemon: CommandLine, package: Package) -> None:
    package.script("talk", "echo out; echo err >&2")
    done = daemon("launch", package.launch('<node pkg="demo" type="talk" name="n"/>'), "--json")
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"event": "output", "node": "n", "stream": "stdout", "line": "out"} in records
    assert {"event": "output", "node": "n", "stream": "stderr", "line": "err"} in records
    started = next(record for record in records if record["event"] == "node")
    assert started["node"] == "/n"
    assert started["kind"] == "process"
    assert started["line"] == 2
    assert any(record["event"] == "running" for record in records)


def test_a_launch_that_has_nothing_to_watch_says_so(daemon: CommandLine, package: Package) -> None:
    done = daemon("launch", package.launch('<param name="x" value="1"/>'))
    assert done.returncode == 0
    assert (
        "everything runs (0 nodes, 0 controllers running); nothing is left to watch, so the launch ends" in done.stdout
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("#!/no/such/python\r\nprint()", r"its first line names a program that does not exist: '#!/no/such/python\r'"),
        ("print()", "a script begins with a line such as #!/usr/bin/env python3"),
    ],
)
def test_a_script_that_the_system_cannot_run_is_told_of_its_first_line(
    slidectl: CommandLine, package: Package, text: str, reason: str
) -> None:
    package.script("odd", "").write_text(text, newline="")
    done = slidectl("launch", package.launch('<node pkg="demo" type="odd" name="o"/>'))
    assert done.returncode == 1
    assert "node /o (demo/odd): cannot run" in done.stderr
    assert reason in done.stderr
    nothing_is_left(slidectl.runtime)
