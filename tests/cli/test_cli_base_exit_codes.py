"""What a script sees of a command that cannot do its work: the exit code, a few lines on stderr, nothing on stdout."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from command_line import CommandLine
from fake_daemon import DIE, NEVER, FakeDaemon


def test_an_unknown_command_is_wrong_usage_and_suggests_the_closest(slidectl: CommandLine) -> None:
    done = slidectl("spwan", "slider")
    assert (done.returncode, done.stdout) == (2, "")
    assert "no command 'spwan'. Did you mean 'slidectl spawn'?" in done.stderr
    assert "slidectl --help" in done.stderr
    assert len(done.stderr.splitlines()) <= 3


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_as_good_as_the_null_device(slidectl: CommandLine, closed: str) -> None:
    shell = ["bash", "-c", f'"$@" {closed}', "bash"]
    for words, code in ((("version",), 0), (("robots",), 3), (("spwan",), 2), (("spawn", "-"), 2)):
        done = subprocess.run(
            [*shell, *slidectl.argv(*words)], capture_output=True, text=True, env=slidectl.environment, timeout=60
        )
        assert done.returncode == code, (words, done.stderr)
        assert "Traceback" not in done.stderr


def test_the_exit_code_survives_an_error_that_cannot_be_printed(slidectl: CommandLine) -> None:
    shell = ["bash", "-c", '"$@" 2>/dev/full', "bash"]
    assert subprocess.run([*shell, *slidectl.argv("spwan")], env=slidectl.environment, timeout=60).returncode == 2


@pytest.mark.parametrize("words", [("--help",), ("version",), ("pub", "--help")], ids=" ".join)
def test_output_that_cannot_be_written_is_an_error(slidectl: CommandLine, words: tuple[str, ...]) -> None:
    shell = ["bash", "-c", '"$@" >/dev/full', "bash"]
    done = subprocess.run(
        [*shell, *slidectl.argv(*words)], stderr=subprocess.PIPE, text=True, env=slidectl.environment, timeout=60
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: cannot write the output: No space left on device")


def test_an_error_that_quotes_something_endless_is_shortened(slidectl: CommandLine, tmp_path: Path) -> None:
    model = tmp_path / "endless.urdf"
    model.write_text(f'<robot name="x">{2 * f"""<link name="{"x" * 100_000}"/>"""}</robot>')
    done = slidectl("spawn", str(model))
    assert done.returncode == 2
    assert len(done.stderr) < 6000
    assert "characters left out" in done.stderr


def test_an_unknown_option_is_wrong_usage(slidectl: CommandLine) -> None:
    done = slidectl("robots", "--jsn")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--json" in done.stderr
    assert "slidectl robots --help" in done.stderr


@pytest.mark.parametrize("words", [(), ("sim",), ("daemon",), ("controller",)], ids=" ".join)
def test_a_group_alone_shows_its_help_on_stderr_and_is_wrong_usage(
    slidectl: CommandLine, words: tuple[str, ...]
) -> None:
    done = slidectl(*words)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"Usage: {' '.join(('slidectl', *words))}")


def test_without_a_daemon_the_exit_code_is_3_and_the_hint_starts_one(slidectl: CommandLine) -> None:
    done = slidectl("robots")
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("error: no daemon answers")
    assert "slidectl daemon start" in done.stderr


def test_instance_and_socket_exclude_each_other(slidectl: CommandLine) -> None:
    done = slidectl("-i", "a", "--socket", "/tmp/b", "robots")
    assert done.returncode == 2
    assert "exclude each other" in done.stderr


@pytest.mark.parametrize("option", ["--instance", "--socket"])
def test_an_empty_variable_does_not_mean_another_daemon(slidectl: CommandLine, option: str) -> None:
    slidectl.ok("daemon", "start")
    done = slidectl(option, "", "daemon", "stop")
    assert done.returncode == 2
    assert "path is empty" in done.stderr or "instance name ''" in done.stderr
    slidectl.ok("daemon", "stop")


def test_a_long_instance_name_is_told_its_length(slidectl: CommandLine) -> None:
    done = slidectl("-i", "a" * 200, "daemon", "start")
    assert done.returncode == 2
    assert "has 200 characters, more than 64" in done.stderr


def test_ros_names_the_commands_that_do_what_other_verbs_of_rosbag_do(slidectl: CommandLine) -> None:
    done = slidectl("ros", "rosbag", "fix", "run.bag")
    assert done.returncode == 1
    assert "rosbag fix is not available; use slidectl bag reindex FILE" in done.stderr


def test_a_namespace_must_be_a_legal_name(slidectl: CommandLine) -> None:
    assert slidectl("--ns", "a b", "robots").returncode == 2
    assert slidectl("robots", SLIDECTL_NAMESPACE="a b").returncode == 2


def test_a_daemon_that_does_not_answer_is_given_up_after_the_timeout(slidectl: CommandLine, fake: FakeDaemon) -> None:
    fake.answers["/slidectl/list_robots"] = NEVER
    fake.answers["/slidectl/status"] = NEVER
    done = slidectl("robots", "--timeout", "0.2")
    assert (done.returncode, done.stdout) == (4, "")
    assert "0.2 s" in done.stderr


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "soon"])
def test_a_timeout_must_be_a_time(slidectl: CommandLine, seconds: str) -> None:
    assert slidectl("robots", "--timeout", seconds).returncode == 2


def test_a_daemon_that_dies_meanwhile_is_no_daemon(slidectl: CommandLine, fake: FakeDaemon) -> None:
    fake.answers["/slidectl/list_robots"] = DIE
    done = slidectl("robots")
    assert (done.returncode, done.stdout) == (3, "")
    assert len(done.stderr.splitlines()) <= 3


def test_ctrl_c_ends_with_130_and_without_a_word(slidectl: CommandLine, fake: FakeDaemon) -> None:
    fake.answers["/slidectl/list_robots"] = NEVER
    process = slidectl.start("robots", "--timeout", "60")
    assert fake.asked.wait(30)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert (process.returncode, stdout, stderr) == (130, "", "")


def test_a_closed_pipe_ends_quietly(slidectl: CommandLine, fake: FakeDaemon) -> None:
    fake.answers["/rosapi/services_for_type"] = {"services": []}
    fake.answers["/slidectl/list_robots"] = {"robots": []}
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        slidectl.argv("version"), stdout=writer, stderr=subprocess.PIPE, text=True, env=slidectl.environment, timeout=60
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_command_that_follows_ends_when_its_reader_has_gone(slidectl: CommandLine, tmp_path: Path) -> None:
    folder = tmp_path / "slidectl" / "default"
    folder.mkdir(mode=0o700, parents=True)
    (folder / "log").write_text("only line\n")
    process = slidectl.start("daemon", "logs", "-f")
    assert process.stdout is not None
    assert process.stdout.readline() == "only line\n"
    process.stdout.close()
    assert process.wait(30) == 0
    assert process.stderr is not None
    assert process.stderr.read() == ""
    process.stderr.close()


def test_a_traceback_is_shown_only_when_v_is_given_twice(slidectl: CommandLine) -> None:
    assert "Traceback" not in slidectl("robots", "-v").stderr
    done = slidectl("robots", "-vv")
    assert done.returncode == 3
    assert "Traceback" in done.stderr
    assert "NoDaemon" in done.stderr
    assert slidectl("-v", "robots", "-v").stderr == slidectl("-v", "-v", "robots").stderr


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("start", ["slidectl daemon start", "slidectl controller start"]),
        ("stop", ["slidectl daemon stop", "slidectl controller stop"]),
        ("status", ["slidectl daemon status", "slidectl sim status"]),
        ("list", ["slidectl controller list", "slidectl topic list", "slidectl param list"]),
        ("load joint1_position_controller", ["slidectl controller load", "slidectl param load"]),
        ("switch", ["slidectl controller switch"]),
        ("run", ["slidectl daemon run", "slidectl ros rosrun"]),
        ("kill", ["slidectl daemon stop"]),
        ("rosbag", ["slidectl record", "slidectl play", "slidectl bag"]),
        ("pause", ["slidectl sim pause"]),
        ("rostopic list", ["slidectl ros rostopic"]),
    ],
)
def test_a_word_that_is_a_command_elsewhere_leads_there(slidectl: CommandLine, words: str, meant: list[str]) -> None:
    done = slidectl(*words.split())
    assert (done.returncode, done.stdout) == (2, "")
    for command in meant:
        assert command in done.stderr


def test_help_is_the_help_option(slidectl: CommandLine) -> None:
    assert slidectl.ok("help") == slidectl.ok("--help")
    assert slidectl.ok("help", "sim", "step") == slidectl.ok("sim", "step", "--help")
    done = slidectl("help", "spwan")
    assert (done.returncode, "Did you mean 'slidectl spawn'?" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "code", "error", "hint"),
    [
        ("robots --json", 3, "no daemon answers on", "start it with: slidectl daemon start"),
        ("--json robots", 3, "no daemon answers on", "start it with: slidectl daemon start"),
        ("-o json spawn /no/file.urdf", 2, "/no/file.urdf", ""),
        ("robots --bogus --json", 2, "No such option", "see 'slidectl robots --help'"),
        ("spwan --json", 2, "no command 'spwan'", "see 'slidectl --help'"),
    ],
)
def test_with_json_an_error_is_one_object(slidectl: CommandLine, words: str, code: int, error: str, hint: str) -> None:
    done = slidectl(*words.split())
    record = json.loads(done.stderr)
    assert (done.returncode, done.stdout, list(record)) == (code, "", ["error", "hint", "exit_code"])
    assert record["exit_code"] == code
    assert error in record["error"]
    assert hint in (record["hint"] or "")
