"""`eval "$(slidectl ros-commands)"`: functions for the shells, and `slidectl ros NAME` that they call."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_ros_world import Shell
from command_line import CommandLine
from daemon_fixture import running_daemon

from slidectl.cli.ros.command import TOOLS


@pytest.fixture(scope="module")
def shell() -> Iterator[Shell]:
    with running_daemon(paused=True) as daemon:
        yield Shell(CommandLine(daemon.folder))


@pytest.fixture
def nobody(tmp_path: Path) -> CommandLine:
    return CommandLine(tmp_path)


def test_every_tool_is_a_function(shell: Shell) -> None:
    done = shell.run("; ".join(f"type -t {name}" for name in TOOLS))
    assert done.stdout == "function\n" * len(TOOLS)


def test_scripts_that_bash_starts_have_the_functions_too(shell: Shell, tmp_path: Path) -> None:
    script = tmp_path / "tutorial.sh"
    script.write_text("#!/bin/bash\nset -euo pipefail\nrostopic type /clock\n")
    script.chmod(0o755)
    assert shell.run(str(script)).stdout == "rosgraph_msgs/Clock\n"


def test_the_functions_take_words_as_they_are(shell: Shell) -> None:
    done = shell.run("rosparam set /text 'two  words, * and $HOME'; rosparam get -p /text")
    assert done.stdout == "two  words, * and $HOME\n"


def test_the_exit_code_and_standard_input_pass_through(shell: Shell) -> None:
    assert shell.run("rostopic info /nope").returncode == 1
    assert shell.run("echo 'k: 1' | rosparam load - /in; rosparam get /in/k").stdout == "1\n"


def test_strict_scripts_may_use_the_functions(shell: Shell) -> None:
    done = shell.run("set -euo pipefail; rostopic list | grep -c clock; rostopic info /nope; echo not reached")
    assert (done.stdout, done.returncode) == ("1\n", 1)


@pytest.mark.parametrize(("number", "code"), [("INT", 130), ("TERM", 143)])
def test_a_signal_for_a_background_job_of_a_script_reaches_the_command(shell: Shell, number: str, code: int) -> None:
    done = shell.run(
        'mkfifo "$XDG_RUNTIME_DIR/lines"; rostopic echo /rosout >"$XDG_RUNTIME_DIR/lines" 2>&1 & job=$!\n'
        'exec 3<"$XDG_RUNTIME_DIR/lines"; rm "$XDG_RUNTIME_DIR/lines"; read -r line <&3; echo "$line"\n'
        f'kill -{number} "$job"; wait "$job"; echo "code $?"; rosnode list | grep slidectl_'
    )
    # The one line says that the simulation is paused; by then the command listens.
    assert done.stdout.splitlines()[1:] == [f"code {code}"]


def test_a_job_gets_the_standard_input_that_it_is_given(shell: Shell) -> None:
    assert shell.run("echo 'k: 2' | rosparam load - /job & wait; rosparam get /job/k").stdout == "2\n"


def test_the_functions_call_the_daemon_that_was_chosen(nobody: CommandLine) -> None:
    text = nobody.ok("-i", "two words".replace(" ", "-"), "--ns", "left", "ros-commands", "--shell", "bash")
    assert "-m slidectl --instance two-words --ns /left ros" in text
    assert "--socket /tmp/x/s ros" in nobody.ok("--socket", "/tmp/x/s", "ros-commands")


def test_the_shell_is_that_of_the_user(nobody: CommandLine) -> None:
    bash = nobody.ok("ros-commands", "--shell", "bash")
    for path in ("/bin/bash", "/usr/bin/zsh", "/bin/sh", ""):
        assert nobody.ok("ros-commands", SHELL=path) == bash
    fish = nobody.ok("ros-commands", SHELL="/usr/bin/fish")
    assert fish == nobody.ok("ros-commands", "--shell", "fish")
    assert fish.startswith("function roslaunch; ")
    assert " ros rostopic $argv; end\n" in fish
    done = nobody("ros-commands", SHELL="/bin/tcsh")
    assert (done.stdout, done.returncode) == ("", 2)
    assert "tcsh" in done.stderr


@pytest.mark.parametrize("name", ["dash", "zsh", "fish"])
def test_the_text_is_valid_in_other_shells(nobody: CommandLine, name: str) -> None:
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    text = nobody.ok("ros-commands", "--shell", name if name != "dash" else "bash")
    line = f"{text}\nrosparam; rosparam bogus >/dev/null"
    done = subprocess.run([name, "-c", line], capture_output=True, text=True, env=nobody.environment, check=False)
    assert (done.stderr, done.returncode) == ("", 0)
    assert "rosparam get" in done.stdout


def test_a_tool_that_there_is_not(nobody: CommandLine) -> None:
    done = nobody("ros", "rostopics", "list")
    assert (done.stdout, done.returncode) == ("", 2)
    assert "Did you mean 'rostopic'?" in done.stderr
    assert nobody("ros").returncode == 2


def test_options_of_slidectl_stand_before_the_name(shell: Shell) -> None:
    done = shell.slidectl("ros", "-i", "default", "rostopic", "type", "/clock")
    assert done.stdout == "rosgraph_msgs/Clock\n"
    assert shell.slidectl("ros", "rostopic", "--help").returncode == 64
    assert "Common options:" in shell.slidectl("ros", "--help").stdout


def test_a_tool_imports_no_other(nobody: CommandLine, tmp_path: Path) -> None:
    argv = [*nobody.argv("ros", "rosmsg", "md5", "std_msgs/Float64")]
    argv[1:3] = ["-X", "importtime", "-m", "slidectl"]
    done = subprocess.run(argv, capture_output=True, text=True, env=nobody.environment, cwd=tmp_path, check=True)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "slidectl.cli.ros.type_tool" in imported
    assert not {"slidectl.cli.topics", "slidectl.client", "slidectl.launch", "yaml", "rosbags"} & imported
