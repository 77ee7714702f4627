"""`make units`, `scripts/pythons.sh`, which runs it with each Python of the machine, and `scripts/gate_tests.sh`."""

from __future__ import annotations

import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest
from kinds_of_tests import KINDS, marks_left_out, marks_of

ROOT = Path(__file__).parent.parent
OWN = f"{sys.version_info.major}.{sys.version_info.minor}"
OTHER = "3.12" if OWN != "3.12" else "3.13"


def program(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def machine(tmp_path: Path) -> dict[str, str]:
    """The environment of a machine with this Python alone, and with a `make` that tells its words and fails if told."""
    program(tmp_path / "bin" / "make", 'echo "make $*"; exit "${MAKE_FAILS:-0}"')
    for name in ("bash", "dirname", "env"):
        (tmp_path / "bin" / name).symlink_to(f"/usr/bin/{name}")
    return {"PATH": str(tmp_path / "bin"), "HOME": str(tmp_path), "PYTHON": sys.executable}


def run(environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    script = ["/bin/bash", str(ROOT / "scripts" / "pythons.sh")]
    return subprocess.run(script, env=environment, capture_output=True, text=True, check=False)


def test_each_other_python_of_the_machine_runs_the_quick_tests(machine: dict[str, str], tmp_path: Path) -> None:
    """Those are stand-ins that say which version they are: they start, and can make environments."""
    says = "case $2 in *{0}*) exit 0;; esac; exit 1"
    on_path = program(tmp_path / "bin" / f"python{OTHER}", says.format(OTHER))
    of_pyenv = program(tmp_path / ".pyenv" / "versions" / "3.14.2" / "bin" / "python3", says.format("3.14"))
    done = run(machine)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[:2] == [
        f"make PYTHON={on_path} VENV=.venv-{OTHER} units",
        f"make PYTHON={of_pyenv} VENV=.venv-3.14 units",
    ]
    assert f"VENV=.venv-{OWN}" not in done.stdout


def test_pythons_that_are_not_there_or_do_not_start_are_named_and_no_failure(
    machine: dict[str, str], tmp_path: Path
) -> None:
    program(tmp_path / "bin" / f"python{OTHER}", f'echo "pyenv: python{OTHER}: command not found" >&2; exit 127')
    done = run(machine)
    assert done.returncode == 0, done.stderr
    missing = [version for version in ("3.11", "3.12", "3.13", "3.14") if version != OWN]
    assert done.stdout == f"not tested, since they are not on this machine: Python {' '.join(missing)}\n"


def test_a_python_whose_tests_fail_is_a_failure(machine: dict[str, str], tmp_path: Path) -> None:
    program(tmp_path / "bin" / f"python{OTHER}", f"case $2 in *{OTHER}*) exit 0;; esac; exit 1")
    assert run({**machine, "MAKE_FAILS": "2"}).returncode == 2


def test_make_takes_another_python_and_folder_and_leaves_the_slow_tests_out() -> None:
    command = ["make", "--dry-run", "--always-make", f"PYTHON={sys.executable}", "VENV=elsewhere/venv", "most"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert f"{sys.executable} -m venv --clear elsewhere/venv" in told
    assert 'elsewhere/venv/bin/python -m pytest -n 4 --dist loadfile -m "not slow"' in told


def files_of_tests() -> list[str]:
    return [path.relative_to(ROOT / "tests").as_posix() for path in (ROOT / "tests").rglob("test_*.py")]


def test_every_entry_of_the_kinds_of_tests_means_files_that_are_there() -> None:
    entries = {entry for patterns in KINDS.values() for entry in patterns}
    assert [entry for entry in entries if not any(fnmatch(file, entry) for file in files_of_tests())] == []


def test_files_that_start_commands_or_daemons_are_known_to() -> None:
    """A file that imports what tests have for it starts processes. Others may start one in a few of their tests."""
    modules = ("command_line", "daemon_fixture", "page_browser", "running_gateway")
    unknown = [
        file
        for file in files_of_tests()
        if "process" not in marks_of(file)
        and any(f"from {module} import" in (ROOT / "tests" / file).read_text("utf-8") for module in modules)
    ]
    assert unknown == []


def test_marks_that_an_expression_leaves_out() -> None:
    assert marks_left_out("not slow and not process") == {"slow", "process"}
    assert marks_left_out("not slow") == {"slow"}
    assert marks_left_out("slow") == marks_left_out("") == marks_left_out("not slow or process") == set()


def test_most_files_of_tests_are_not_slow_and_every_room_has_some() -> None:
    files = [file for file in files_of_tests() if "slow" not in marks_of(file)]
    assert len(files) > 0.6 * len(files_of_tests())
    assert {file.partition("/")[0] for file in files} >= {
        "check", "cli", "client", "control", "daemon", "description", "gateways", "launch", "msgs", "physics",
        "simulation", "viewing",
    }  # fmt: skip


# It fails once in a folder.
FLAKY = """
import pathlib
def test_{0}():
    seen = pathlib.Path('seen-{0}')
    first = not seen.exists()
    seen.touch()
    assert not first
"""


@pytest.mark.parametrize(
    ("tests", "code", "said"),
    [
        (["def test_right(): pass\n"], 0, "1 passed"),
        ([FLAKY.format("one"), "def test_right(): pass\n"], 0, "tests/test_0.py::test_one"),
        (["def test_wrong(): assert False\n", FLAKY.format("one")], 1, "1 failed"),
        ([FLAKY.format(number) for number in range(11)], 2, "11 tests failed"),
    ],
)
def test_the_gate_runs_what_failed_once_more(tmp_path: Path, tests: list[str], code: int, said: str) -> None:
    (tmp_path / "scripts").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / "scripts" / "gate_tests.sh").write_text((ROOT / "scripts" / "gate_tests.sh").read_text())
    for number, text in enumerate(tests):
        (tmp_path / "tests" / f"test_{number}.py").write_text(text)
    program(tmp_path / "environment" / "bin" / "python", f'exec {sys.executable} "$@" -p no:slidectl')
    (tmp_path / "Makefile").write_text("test:\n\t@$(VENV)/bin/python -m pytest tests\n")
    done = subprocess.run(
        ["bash", "scripts/gate_tests.sh", "VENV=environment", "test"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == code, done
    assert said in done.stdout + done.stderr, done
    assert ("has a race" in done.stdout) == (code == 0 and len(tests) == 2)
