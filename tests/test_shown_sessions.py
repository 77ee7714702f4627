"""Every session that a page shows (a fenced `console` block) is typed into a shell, and prints what the page says.

Numbers may differ; a line `...` stands for any lines. Every fenced `python` block runs beside a slider.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![A-Za-z_/])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
PAGES = [
    page
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    if BLOCK.search(page.read_text("utf-8"))
]


def sessions(page: Path) -> list[tuple[str, list[str]]]:
    """Commands and the lines that each is said to print, in the order of the page."""
    steps: list[tuple[str, list[str]]] = []
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in block.splitlines():
            if line.startswith("$ "):
                steps.append((line[2:].partition("    #")[0].rstrip(), []))
            else:
                steps[-1][1].append(line)
    return steps


def pattern(lines: list[str]) -> re.Pattern[str]:
    """What the printed text must look like."""
    parts = [r"(?:.*\n)*?" if line.strip() == "..." else _line(line) + r"[ ]*\n" for line in lines]
    return re.compile("".join(parts) + r"\Z")


def _line(line: str) -> str:
    pieces = NUMBER.split(line.rstrip())
    return r"[-+]?[\d.]+(?:e[-+]?\d+)?".join(re.sub(r"(?:\\ )+", r"[ ]+", re.escape(piece)) for piece in pieces)


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    folder = tempfile.mkdtemp(prefix="slidectl-docs-", dir="/tmp")
    variables = {**os.environ, "XDG_RUNTIME_DIR": folder, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    for name in ("SLIDECTL_SOCKET", "SLIDECTL_INSTANCE", "SLIDECTL_NAMESPACE"):
        variables.pop(name, None)
    yield variables
    subprocess.run(["slidectl", "-q", "daemon", "stop"], env=variables, capture_output=True, check=False)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_sessions_of_a_page_print_what_it_shows(page: Path, environment: dict[str, str]) -> None:
    evaluated: list[str] = []
    for command, lines in sessions(page):
        done = subprocess.run(
            ["bash", "-c", "\n".join([*evaluated, command])],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=120,
            check=False,
        )
        evaluated += [command] if command.startswith("eval ") else []
        printed = "".join(line.rstrip() + "\n" for line in done.stdout.splitlines())
        fails = any(line.lower().startswith("error:") for line in lines)
        assert bool(done.returncode) == fails or "||" in command, f"$ {command}\nexit {done.returncode}:\n{printed}"
        assert pattern(lines).match(printed), (
            f"$ {command}\n--- printed (exit {done.returncode}):\n{printed}--- shown:\n" + "\n".join(lines)
        )


PROGRAM = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
PROGRAMS = [
    pytest.param(program, id=f"{page.name}-{index}")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    if page.name not in ("python.md", "extending.md", "pytest.md")  # run by test_python_page.py and their own tests
    for index, program in enumerate(PROGRAM.findall(page.read_text(encoding="utf-8")))
]
SLIDER = (
    "slidectl daemon start --rtf max",
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
