"""`eval "$(slidectl ros-commands)"`: functions for the shells, and `slidectl ros NAME` that they call."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from cli_ros_world import Shell
from command_line import CommandLine, Done
from daemon_fixture import running_daemon

from slidectl.extensions.ros_commands.command import TOOLS

CTRL_C = "\x03"
PATIENCE_S = 30.0


def typed_at_a_terminal(argv: list[str], steps: list[tuple[str, str]], environment: dict[str, str]) -> None:
    """Types each text (a line, or Ctrl-C) and waits until the shell has shown what follows it."""
    program, terminal = os.forkpty()
    if program == 0:
        os.execvpe(argv[0], argv, {**environment, "TERM": "dumb"})
    try:
        for text, awaited in steps:
            os.write(terminal, (text if text == CTRL_C else text + "\n").encode())
            shown = ""
            while awaited not in shown:
                assert select.select([terminal], [], [], PATIENCE_S)[0], f"no {awaited!r} came after {text!r}: {shown}"
                shown += os.read(terminal, 65536).decode(errors="replace")
        with suppress(OSError):  # the shell has ended
            while os.read(terminal, 65536):
                pass
    finally:
        os.close(terminal)
        os.waitpid(program, 0)


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


EVAL = {
    "bash": 'eval "$({slidectl} ros-commands)"',
    "zsh": 'eval "$({slidectl} ros-commands)"',
    "dash": 'eval "$({slidectl} ros-commands)"',
    "fish": "{slidectl} ros-commands | source",
}
PLAIN = {"bash": ["--norc"], "zsh": ["-f"], "dash": [], "fish": ["--no-config"]}


class OtherShell:
    """A shell of that name, with the ROS commands defined as its users define them."""

    def __init__(self, name: str, slidectl: CommandLine) -> None:
        self.name = name
        self.environment = {**slidectl.environment, "SHELL": "/bin/false"}
        self.begin = EVAL[name].format(slidectl=" ".join(slidectl.argv()))

    def __call__(self, script: str, stdin: str = "") -> Done:
        return subprocess.run(
            [self.name, *PLAIN[self.name], "-c", f"{self.begin}\n{script}"],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=60,
            env=self.environment,
            check=False,
        )

    @property
    def code(self) -> str:
        """The variable with the exit code."""
        return "$status" if self.name == "fish" else "$?"


@pytest.fixture(params=EVAL)
def any_shell(request: pytest.FixtureRequest, shell: Shell) -> OtherShell:
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")
    return OtherShell(request.param, shell.slidectl)


WORDS = [
    ("rosparam set /named \"name: 'x'\"; rosparam get /named", "name: x\n\n"),
    ("rosparam set /w '{a: [b, c d], e: \"\"}'; rosparam get /w/a", "- b\n- c d\n\n"),
    ("rosparam set /w ''; rosparam get /w", "''\n\n"),
    ("rosparam set /w 'two  words, * and $HOME \\n'; rosparam get -p /w", "two  words, * and $HOME \\n\n"),
    ("rosparam set /w -0.5; rosparam get /w", "-0.5\n"),
    ("rosparam set -- /w -1; rosparam get -v /w", "getting parameter [/w]\n-1\n"),
    ("rosparam set /w 'grün ☃'; rosparam get -p /w", "grün ☃\n"),
    ("rostopic type /clock | rosmsg show", "time clock\n\n"),
    ("rostopic list | head -1", "/clock\n"),
    ("rosservice call /gazebo/get_physics_properties '{}' | head -1", "time_step: 0.001\n"),
]


@pytest.mark.parametrize(("line", "printed"), WORDS, ids=[line for line, _ in WORDS])
def test_words_and_pipes_are_the_same_in_every_shell(any_shell: OtherShell, line: str, printed: str) -> None:
    done = any_shell(line)
    assert (done.stdout, done.stderr, done.returncode) == (printed, "", 0)


def test_exit_codes_are_the_same_in_every_shell(any_shell: OtherShell) -> None:
    lines = (
        "rostopic type /clock",
        "rostopic info /nope",
        "rostopic info",
        "rostopic",
        "rosrun nopkg x",
        "rosrun tf x",
    )
    done = any_shell("\n".join(f'{line} >/dev/null 2>&1; echo "{any_shell.code}"' for line in lines))
    assert done.stdout.split() == ["0", "1", "2", "64", "2", "3"]


def test_standard_input_reaches_the_command_in_every_shell(any_shell: OtherShell) -> None:
    assert any_shell("rosparam load - /piped; rosparam get /piped/k", stdin="k: 1\n").stdout == "1\n"


def test_ctrl_c_ends_a_command_in_every_shell(any_shell: OtherShell) -> None:
    """Typed at a terminal, which is where a shell says how a command has ended."""
    steps = [
        (any_shell.begin, ""),
        (f'rostopic echo /rosout; echo "the code is" {any_shell.code}', "is paused"),
        (CTRL_C, "the code is 130"),
        ("exit", ""),
    ]
    typed_at_a_terminal([any_shell.name, *PLAIN[any_shell.name], "-i"], steps, any_shell.environment)


@pytest.mark.parametrize(("number", "code"), [("INT", 130), ("TERM", 143)])
def test_a_signal_reaches_a_background_job_of_a_zsh_script(shell: Shell, number: str, code: int) -> None:
    if shutil.which("zsh") is None:
        pytest.skip("zsh is not installed")
    done = OtherShell("zsh", shell.slidectl)(
        'mkfifo "$XDG_RUNTIME_DIR/zlines"; rostopic echo /rosout >"$XDG_RUNTIME_DIR/zlines" 2>&1 & job=$!\n'
        'exec 3<"$XDG_RUNTIME_DIR/zlines"; rm "$XDG_RUNTIME_DIR/zlines"; read -r line <&3; echo "$line"\n'
        f'kill -{number} "$job"; wait "$job"; echo "code $?"; rosnode list | grep slidectl_'
    )
    assert done.stdout.splitlines()[1:] == [f"code {code}"]


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
    assert "slidectl.cli.msg" in imported  # rosmsg imports it
    assert (
        not {"slidectl.cli.topic_streams", "slidectl.client", "slidectl.extensions.launch", "yaml", "rosbags"}
        & imported
    )
