"""Many commands in one process: scripts, their comments and failures, and the prompt of a terminal."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine
from terminal import Terminal

CONTROLLERS = ("joint_state_controller", "joint1_position_controller")


@pytest.fixture(scope="module")
def slider(world: CommandLine) -> CommandLine:
    """A paused world with a slider under control."""
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *CONTROLLERS)
    return world


def test_a_script_runs_its_lines_in_order(slider: CommandLine) -> None:
    script = """
        # where it goes
        param set /wanted 0.5
        slidectl param get /wanted   # as it would be typed
        pub command 0.5
        sim step 10
        controller list --json
    """
    done = slider("shell", stdin=script)
    assert done.returncode == 0, done.stderr
    first, *rest = done.stdout.splitlines()
    assert first == "0.5"
    assert {json.loads(line)["name"] for line in rest if line.startswith("{")} == set(CONTROLLERS)


def test_all_lines_share_one_connection(slider: CommandLine) -> None:
    done = slider("--json", "shell", stdin="sim status\n" * 3)
    assert [json.loads(line)["connections"] for line in done.stdout.splitlines()] == [1, 1, 1]


def test_a_script_stops_at_the_first_failure_with_its_exit_code(slider: CommandLine) -> None:
    done = slider("shell", stdin="param set /a 1\nparam get\nparam set /a 2\n")
    assert done.returncode == 2
    assert "stdin, line 2: param get" in done.stderr
    assert slider.ok("param", "get", "/a") == "1\n"


def test_keep_going_goes_on_and_tells_the_first_failure(slider: CommandLine) -> None:
    done = slider("shell", "--keep-going", stdin="param get /no/such\nno_command\nparam set /b 2\n")
    assert done.returncode == 1
    assert done.stderr.count("error:") == 2
    assert slider.ok("param", "get", "/b") == "2\n"


def test_a_script_may_be_a_file_and_its_commands_may_read_stdin(slider: CommandLine, tmp_path: Path) -> None:
    script = tmp_path / "script"
    script.write_text("param load - /loaded\nparam get /loaded/x\n")
    done = slider("shell", str(script), stdin="x: 1.5\n")
    assert (done.returncode, done.stdout) == (0, "1.5\n"), done.stderr


def test_a_script_on_stdin_is_not_eaten_by_its_commands(slider: CommandLine) -> None:
    done = slider("shell", stdin="pub command --stdin\nparam get /slider/joint1_position_controller/pid/p\n")
    assert (done.returncode, done.stdout) == (0, "100.0\n"), done.stderr


def test_a_missing_script_is_a_bad_file(slidectl: CommandLine) -> None:
    done = slidectl("shell", "no_such_script")
    assert done.returncode == 2
    assert "no_such_script" in done.stderr


def test_bytes_that_are_no_text_are_words_of_their_line(slidectl: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "script").write_bytes(b"version\nbag info \xff.bag\n")
    done = slidectl("shell", str(tmp_path / "script"))
    assert (done.returncode, done.stdout.startswith("slidectl ")) == (2, True)
    assert "error: \\udcff.bag: no such file or directory" in done.stderr
    assert "script, line 2: bag info" in done.stderr


def test_a_line_without_end_is_refused(slidectl: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "script"
    with file.open("wb") as script:
        script.truncate(2**40)
    done = slidectl("shell", str(file))
    assert done.returncode == 2
    assert f"{file}:1: a line longer than" in done.stderr


def test_exit_ends_a_script(slidectl: CommandLine) -> None:
    done = slidectl("shell", stdin="version\nexit\nversion\n")
    assert (done.returncode, done.stdout.count("\n")) == (0, 1)


def test_options_before_the_shell_hold_for_each_line_and_a_line_may_say_otherwise(slider: CommandLine) -> None:
    done = slider(
        "--json", "--ns", "/slider", "shell", stdin="param get joint1_position_controller/type\n-o text version\n"
    )
    record, version = done.stdout.splitlines()
    assert json.loads(record)["parameter"] == "/slider/joint1_position_controller/type"
    assert version.startswith("slidectl ")


def test_a_line_may_pick_another_daemon(slider: CommandLine) -> None:
    done = slider("shell", "--keep-going", stdin="-i no_such_daemon sim status\nparam set /c 3\nparam get /c\n")
    assert (done.returncode, done.stdout) == (3, "3\n")


def test_echo_leaves_no_subscription_behind(slider: CommandLine) -> None:
    script = "echo /tf_static -n 1 --noarr\ntopic info /tf_static\n"
    done = slider("shell", stdin=script)
    assert done.returncode == 0, done.stderr
    assert "Subscribers: None" in done.stdout


def test_a_shell_does_not_run_in_a_shell(slidectl: CommandLine) -> None:
    assert slidectl("shell", stdin="shell\n").returncode == 2


def test_a_script_may_start_restart_and_stop_the_daemon(slidectl: CommandLine) -> None:
    lines = ["daemon start --paused", "sim step 5", "sim status --json", "daemon restart --paused", "sim status --json"]
    try:
        done = slidectl("-q", "shell", stdin="\n".join([*lines, "daemon stop", "sim status"]))
    finally:
        slidectl("daemon", "stop")
    assert done.returncode == 3, done.stderr
    assert [json.loads(line)["cycles"] for line in done.stdout.splitlines() if line.startswith("{")] == [5, 0]


def test_what_is_detached_goes_on_in_the_background_and_the_script_goes_on_too(
    slidectl: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "run.bag"
    lines = [
        "daemon start --paused",
        "spawn slider --controllers config/slider_control.yaml --start joint_state_controller",
        f"record joint_states -O {path} --detach",
        "sim step 100ms",
        "daemon stop",  # returns when the recording has ended
        "daemon start --paused",
        f"play {path} --detach",
        "sim step 1s",
        "daemon stop",
        f"bag info {path}",
    ]
    try:
        done = slidectl("--json", "shell", stdin="\n".join(lines))
    finally:
        slidectl("daemon", "stop")
    assert done.returncode == 0, done.stderr
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert records[2]["file"] == str(path)
    count = records[-1]["messages"]
    assert count in (4, 5)
    [log] = tmp_path.glob("slidectl/default/playing-*.log")
    assert json.loads(log.read_text())["published"] == count


# --- what a line knows of the lines before it, and of others --------------------------------------------------------

SECOND = (
    "spawn slider -n second namespace:=/second --at 0 5 0 --controllers config/slider_control.yaml --start "
    "joint1_position_controller"
)


def remove_second(slider: CommandLine) -> None:
    """Its parameters would stay, as with ROS."""
    slider("delete", "second")
    slider.ok("param", "delete", "/second")


class Feeding:
    """A shell that gets its lines one by one, as if somebody typed them."""

    def __init__(self, slidectl: CommandLine, *options: str) -> None:
        pipe = subprocess.PIPE
        argv = slidectl.argv(*options, "shell", "--keep-going")
        env = slidectl.environment
        self.process = subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=env, cwd=ROOT)

    def say(self, line: str) -> tuple[str, list[str]]:
        """What the line wrote to standard output and to standard error."""
        assert self.process.stdin is not None
        print(line, "version", "no_such_command", sep="\n", file=self.process.stdin, flush=True)
        output = "".join(iter(self._line, "version"))
        return output, list(iter(self._complaint, "no command 'no_such_command'."))

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        return "version" if line.startswith(("slidectl ", '{"slidectl"')) else line

    def _complaint(self) -> str:
        assert self.process.stderr is not None
        line = self.process.stderr.readline().strip()
        if line.startswith("{"):
            error = json.loads(line)
            line = f"{error['error']} {error['hint']}"
        if not line.startswith("no command"):
            return line
        while "line" not in self.process.stderr.readline():
            pass
        return "no command 'no_such_command'."


@pytest.fixture
def feeding(slider: CommandLine) -> Iterator[Feeding]:
    shell = Feeding(slider, "--json")
    yield shell
    shell.process.kill()
    shell.process.communicate()


def test_what_others_do_between_two_lines_counts_for_the_second(slider: CommandLine, feeding: Feeding) -> None:
    line = "pub command 0.1"
    assert json.loads(feeding.say(line)[0])["topic"] == "/slider/joint1_position_controller/command"
    slider.ok(*SECOND.split())
    try:
        output, complaint = feeding.say(line)
        assert output == ""
        assert "/second/joint1_position_controller/command" in " ".join(complaint)
    finally:
        remove_second(slider)
    assert json.loads(feeding.say(line)[0])["topic"] == "/slider/joint1_position_controller/command"
    slider.ok("controller", "unspawn", "joint1_position_controller")
    try:
        output, complaint = feeding.say(line)
        assert (output, bool(complaint)) == ("", True)
    finally:
        slider.ok("controller", "spawn", "joint1_position_controller")
    assert feeding.say(line)[1] == []


def test_a_warning_of_the_log_belongs_to_its_line(slider: CommandLine, feeding: Feeding) -> None:
    slider.ok("controller", "stop", "joint1_position_controller")
    try:
        for _ in range(2):
            assert "is not running" in " ".join(feeding.say("pub command 0.1")[1])
            feeding.say("sim step 2000")  # it is not said more often than that
    finally:
        slider.ok("controller", "start", "joint1_position_controller")
    with slider.client() as other:
        owner = "/slider/joint1_position_controller"
        other.deliver("/rosout", {"level": 4, "name": owner, "msg": f"{owner} says something in between"})
    assert feeding.say("pub command 0.1")[1] == []


def test_a_daemon_that_was_replaced_is_told_once(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--paused")
    shell = Feeding(slidectl, "--json")
    try:
        assert json.loads(shell.say("param get /use_sim_time --default 5")[0])
        slidectl.ok("daemon", "restart", "--paused")
        assert "the daemon went away" in " ".join(shell.say("param get /nothing --default 5")[1])
        assert json.loads(shell.say("param get /nothing --default 5")[0])["value"] == 5
    finally:
        shell.process.kill()
        shell.process.communicate()
        slidectl("daemon", "stop")


# --- at a terminal --------------------------------------------------------------------------------------------------


@pytest.fixture
def conversation(slider: CommandLine, tmp_path: Path) -> Iterator[Terminal]:
    with Terminal(slider, "shell", TERM="dumb", XDG_STATE_HOME=str(tmp_path)) as talk:
        hear(talk, "slidectl> ")
        yield talk


def hear(conversation: Terminal, *texts: str) -> None:
    """Wait for the texts, one after the other, behind what was heard before."""
    for text in texts:
        conversation.says(text)
        conversation.output = conversation.output.partition(text)[2]


def test_a_failure_does_not_end_a_conversation(conversation: Terminal) -> None:
    conversation.press("param get /no/such\n")
    hear(conversation, "error:", "slidectl> ")
    conversation.press("param get /slider/joint1_position_controller/pid/p\n")
    hear(conversation, "100.0", "slidectl> ")
    conversation.press("exit\n")
    assert conversation.ended() == 0


def test_what_was_typed_is_remembered_and_names_are_completed(conversation: Terminal, tmp_path: Path) -> None:
    pytest.importorskip("readline")
    conversation.press("param get joint1_position_controller/pid/p\t\n")
    hear(conversation, "100.0", "slidectl> ")
    conversation.press("vers\t\n")
    hear(conversation, "slidectl 0", "slidectl> ")
    conversation.press("\x04")
    assert conversation.ended() == 0
    assert "joint1_position_controller/pid/p" in (tmp_path / "slidectl" / "history").read_text()
