"""Every session that a page shows (a fenced `console` block) is typed into a shell, and prints what the page says.

Numbers may differ; a line `...` stands for any lines, and `^C` is typed when the lines before it are there. The files
that the page tells to save are there. Every fenced `python` block runs beside a slider.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"^([^\n]*)\n\n```(?!console)\w+\n(.*?)^```", re.MULTILINE | re.DOTALL)
END = "the-command-has-ended"
LIMIT_S = 120
NUMBER = re.compile(r"(?<![A-Za-z_/])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TAB = re.compile(r'^=== ".*"\n((?:(?: {4}.*)?\n)+)', re.MULTILINE)
ALL = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))


def text_of(page: Path) -> str:
    """The page, with what stands in its tabs moved to the left."""
    return TAB.sub(lambda tab: textwrap.dedent(tab[1]), page.read_text(encoding="utf-8"))


PAGES = [page for page in ALL if BLOCK.search(text_of(page))]


def sessions(page: Path) -> list[tuple[str, list[str]]]:
    """Commands and the lines that each is said to print, in the order of the page."""
    steps: list[tuple[str, list[str]]] = []
    for block in BLOCK.findall(text_of(page)):
        for line in block.splitlines():
            if line.startswith("$ "):
                steps.append((line[2:].partition("    #")[0].rstrip(), []))
            elif line.startswith("> ") and not steps[-1][1]:  # the command goes on
                steps[-1] = (f"{steps[-1][0]}\n{line[2:]}", [])
            else:
                steps[-1][1].append(line)
    return steps


def files(page: Path) -> Iterator[tuple[str, str]]:
    """Those that the page tells to save: a block that begins with `# NAME`, or stands behind "... as `NAME`"."""
    for before, text in FILE.findall(text_of(page)):
        if name := re.match(r"# (\S+\.\w+)\n", text) or re.search(r"\bas `(\S+\.\w+)`[^`]*\Z", before):
            yield name[1], text


def pattern(lines: list[str]) -> re.Pattern[str]:
    """What the printed text must look like."""
    parts = [r"(?:.*\n)*?" if line.strip() == "..." else _line(line) + r"[ ]*\n" for line in lines]
    return re.compile("".join(parts) + r"\Z")


def _line(line: str) -> str:
    pieces = NUMBER.split(line.rstrip())
    return r"[-+]?[\d.]+(?:e[-+]?\d+)?".join(re.sub(r"(?:\\ )+", r"[ ]+", re.escape(piece)) for piece in pieces)


class Shell:
    """One for all sessions of a page, as a reader has it: its folder, functions and background jobs stay."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._bash = subprocess.Popen(
            ["bash"],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def type(self, command: str, lines: list[str]) -> tuple[int, str]:
        """The exit code, and what was printed until then. `^C` in what it is to print is typed after what is before."""
        assert self._bash.stdin is not None
        assert self._bash.stdout is not None
        late = threading.Timer(LIMIT_S, self.end)
        late.start()
        awaited = pattern(lines[: lines.index("^C")]) if "^C" in lines else None
        self._bash.stdin.write(f"trap : INT; eval {shlex.quote(command)} </dev/null; printf '\\n%s %s\\n' {END} $?\n")
        self._bash.stdin.flush()
        printed = ""
        for line in self._bash.stdout:
            if line.startswith(END):
                late.cancel()
                return int(line.split()[1]), "".join(line.rstrip() + "\n" for line in printed[:-1].splitlines())
            printed += line
            if awaited and awaited.match(printed):
                awaited = None
                os.killpg(self._bash.pid, signal.SIGINT)
        raise AssertionError(f"$ {command}\ndoes not end:\n{printed}")

    def end(self) -> None:
        """Of the shell, and of what it left running."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._bash.pid, signal.SIGKILL)


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    folder = tempfile.mkdtemp(prefix="slidectl-docs-", dir="/tmp")
    variables = {
        **os.environ,
        "XDG_RUNTIME_DIR": folder,
        "TMPDIR": folder,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    for name in ("SLIDECTL_SOCKET", "SLIDECTL_INSTANCE", "SLIDECTL_NAMESPACE", "DISPLAY", "WAYLAND_DISPLAY"):
        variables.pop(name, None)
    yield variables
    for instance in (Path(folder) / "slidectl").glob("*/"):
        stop = ["slidectl", "-q", "-i", instance.name, "daemon", "stop"]
        subprocess.run(stop, env=variables, capture_output=True, check=False)
    shutil.rmtree(folder, ignore_errors=True)


def anywhere(command: str) -> str:
    """The command with any port that is free where the page has the usual one: another test may have that one."""
    command = re.sub(r"--(ros1|websocket|foxglove)\b( \d+)?", r"--\1 0", command)
    return re.sub(r"gateway \w+ (start|run)\b|slidectl view\b", r"\g<0> --port 0", command)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_sessions_of_a_page_print_what_it_shows(page: Path, environment: dict[str, str], tmp_path: Path) -> None:
    for name, text in files(page):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    for folder in ("config", "models"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    shell = Shell(tmp_path, environment)
    try:
        for command, lines in sessions(page):
            code, printed = shell.type(anywhere(command), lines)
            fails = any(line.lower().startswith("error:") for line in lines)
            is_ended = code == 130 and "^C" in lines
            lines = [line for line in lines if line != "^C"]
            assert bool(code) == fails or is_ended or "||" in command, f"$ {command}\nexit {code}:\n{printed}"
            assert pattern(lines).match(printed), (
                f"$ {command}\n--- printed (exit {code}):\n{printed}--- shown:\n" + "\n".join(lines)
            )
    finally:
        shell.end()


PROGRAM = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def _is_typed(program: str, page: Path) -> bool:
    """True when a session of the page runs the program as a file."""
    name = re.match(r"# (\S+\.py)\n", program)
    return name is not None and any(command == f"python {name[1]}" for command, _ in sessions(page))


PROGRAMS = [
    pytest.param(program, id=f"{page.name}-{index}")
    for page in ALL
    if page.name not in ("python.md", "extending.md", "pytest.md")  # run by test_python_page.py and their own tests
    for index, program in enumerate(PROGRAM.findall(text_of(page)))
    if not _is_typed(program, page)
]
SLIDER = (
    "slidectl daemon start --rtf 20",  # as fast as it can be, a motion is over before a busy machine goes on here
    "slidectl spawn slider --controllers config/slider_control.yaml"
    " --start joint_state_controller joint1_position_controller",
)


@pytest.mark.parametrize("program", PROGRAMS)
def test_the_programs_of_a_page_run(program: str, environment: dict[str, str]) -> None:
    for command in SLIDER:
        subprocess.run(["bash", "-c", command], cwd=ROOT, env=environment, check=True, capture_output=True)
    if "9090" in program:  # a gateway of the test's own, on any port
        started = subprocess.run(
            [*("slidectl", "gateway", "websocket", "start", "--port", "0", "--json")],
            env=environment, check=True, capture_output=True, text=True,
        )  # fmt: skip
        program = program.replace("9090", json.loads(started.stdout)["address"].rpartition(":")[2])
    variables = {**environment, "SLIDECTL_SOCKET": f"{environment['XDG_RUNTIME_DIR']}/slidectl/default/socket"}
    done = subprocess.run([sys.executable, "-c", program], env=variables, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_numbers_may_differ_but_words_may_not() -> None:
    assert pattern(["position: [0.5, 1]"]).match("position: [-0.25, 3]\n")
    assert not pattern(["position: [0.5]"]).match("velocity: [0.5]\n")
    assert pattern(["a", "...", "z"]).match("a\nb\nc\nz\n")


def test_no_block_of_a_page_stands_there_unrun() -> None:
    """One that is neither a session, nor a program, nor a file to save, is taken from its page by another test."""
    others: dict[str, int] = {}
    for page in ALL:
        text = text_of(page)
        kinds = re.findall(r"^```(\w*)\n.*?^```", text, re.MULTILINE | re.DOTALL)
        saved = sum(f"```python\n{file}" not in text for _, file in files(page))
        others[page.name] = len(kinds) - kinds.count("console") - kinds.count("python") - saved
    assert {name: count for name, count in others.items() if count and name != "commands.md"} == {
        "architecture.md": 1,  # a picture
        "ci.md": 5,  # test_deployment.py, test_pythons.py
        "extending.md": 3,  # the files of the example package: test_cli_installed_packages.py
        "index.md": 1,  # pip: test_pythons.py
        "install.md": 3,  # pip
        "pytest.md": 1,  # what pytest prints
        "ros1.md": 2,  # gateways/ros1/test_ros1_tools.py, test_ros1_rosmaster.py
        "ros2.md": 4,  # gateways/ros2/test_ros2_nodes.py, test_ros2_control.py, test_ros2_actions.py
        "seeing.md": 1,  # gateways/ros1/test_rviz.py
        "websocket.md": 1,  # gateways/websocket/test_websocket_page.py
    }
