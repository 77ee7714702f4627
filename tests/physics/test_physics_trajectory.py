"""The recorded trajectories, and the program that compares any such file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
DATA = TESTS / "data"
sys.path.insert(0, str(TESTS))

import trajectory  # noqa: E402


def run(*arguments: str | Path) -> int:
    """The exit code of the program."""
    return trajectory.main([str(argument) for argument in arguments])


def files(name: str) -> list[Path]:
    """The three files of a recording."""
    return [DATA / f"{name}{suffix}" for suffix in (".csv", ".urdf", ".yaml")]


@pytest.mark.parametrize("name", ["slider_horizontal", "slider_vertical"])
def test_the_recorded_trajectories_come_out_again(name: str) -> None:
    command = [sys.executable, str(TESTS / "trajectory.py"), *map(str, files(name)), "slider"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("worst deviation") == 3
    assert "all within 1e-09" in done.stdout


def test_a_deviation_of_two_billionths_is_a_mismatch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, urdf, yaml = files("slider_vertical")
    recorded = (DATA / "slider_vertical.csv").read_text(encoding="ascii").splitlines()
    t, command, position, velocity, effort = recorded[50].split(",")
    recorded[50] = f"{t},{command},{float(position) + 2e-9!r},{velocity},{effort}"
    changed = tmp_path / "changed.csv"
    changed.write_text("\n".join(recorded[:60]) + "\n", encoding="ascii")
    assert run(changed, urdf, yaml, "/slider") == 1
    printed = capsys.readouterr().out
    assert "mismatch in position" in printed
    assert f"position  worst deviation 2e-09 at t = {float(t):.3f}" in printed


def test_a_recording_that_is_not_a_number_is_a_mismatch(tmp_path: Path) -> None:
    _, urdf, yaml = files("slider_horizontal")
    strange = tmp_path / "strange.csv"
    strange.write_text("t,command,position,velocity,effort\n0.001,0,nan,0,0\n", encoding="ascii")
    assert run(strange, urdf, yaml, "slider") == 1


@pytest.mark.parametrize(
    "text",
    ["", "t,position\n0.001,0\n", "t,command,position,velocity,effort\n0.001,0,zero,0,0\n"],
    ids=["empty", "columns", "numbers"],
)
def test_a_file_that_cannot_be_read_is_another_exit_code(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    csv, urdf, yaml = files("slider_horizontal")
    broken = tmp_path / "broken"
    broken.write_text(text, encoding="ascii")
    for arguments in ([broken, urdf, yaml, "slider"], [csv, broken, yaml, "slider"], [csv, urdf, broken, "slider"]):
        assert run(*arguments) == 2
        assert str(broken) in capsys.readouterr().err
    assert run(csv, urdf, tmp_path / "missing", "slider") == 2
    assert run(csv, urdf, yaml, "other") == 2
    assert run(csv, urdf) == 2
