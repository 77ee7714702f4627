"""The folder of compiled code: only what is the user's own is run, and what nobody uses goes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from slidectl.errors import Refused
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

BEHIND_OTHERS = pytest.mark.timeout(1200)
"""The compiler lets all other processes go first: on a busy machine it takes many times its 10 seconds."""
needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty one, of this test alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(object_file, "place", lambda: object_file.folder() / "cycle-now.o")
    object_file.prepare()
    return object_file.folder()


def put(folder: Path, name: str) -> Path:
    """A file that was used long ago."""
    file = folder / name
    file.write_bytes(b"code")
    file.chmod(0o600)
    return file


def test_what_is_written_is_the_users_alone(folder: Path) -> None:
    file = folder / "cycle-now.o"
    assert not object_file.is_there()
    object_file.write(object_file.place(), b"code")
    assert object_file.is_there()
    assert object_file._read(object_file.place()) == b"code"
    assert file.stat().st_mode & 0o777 == 0o600
    assert folder.stat().st_mode & 0o777 == 0o700
    assert list(folder.iterdir()) == [file]


@pytest.mark.parametrize(("place", "mode"), [("cycle-now.o", 0o620), ("cycle-now.o", 0o602), (".", 0o770)])
def test_what_others_may_write_is_not_taken(folder: Path, place: str, mode: int) -> None:
    object_file.write(object_file.place(), b"code")
    (folder / place).chmod(mode)
    with pytest.raises(object_file.UnsafeFile, match="belongs to another user, or others may write"):
        object_file._read(object_file.place())


def test_a_link_to_a_file_is_not_taken(folder: Path, tmp_path: Path) -> None:
    (folder / "cycle-now.o").symlink_to(put(tmp_path, "code"))
    with pytest.raises(OSError, match="symbolic link"):
        object_file._read(object_file.place())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_file_of_somebody_else_is_not_taken(folder: Path) -> None:
    object_file.write(object_file.place(), b"code")
    os.chown(folder / "cycle-now.o", 12345, 12345)
    with pytest.raises(object_file.UnsafeFile):
        object_file._read(object_file.place())


@needs_numba
def test_an_engine_without_a_place_for_its_code_says_so_and_runs_plain(folder: Path) -> None:
    folder.chmod(0o777)
    simulation = Simulation(engine="auto")
    simulation.driven = True
    simulation.step(3)
    assert simulation.cycles == 3
    assert str(simulation.engine).startswith(f"plain: there is no place for compiled code: {folder} belongs to")
    with pytest.raises(Refused, match="chmod go-w"):
        simulation.engine.complete()


@needs_numba
def test_code_that_is_tidied_away_under_an_engine_is_made_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    object_file.write(object_file.place(), b"code")

    def gone() -> None:
        (folder / "cycle-now.o").unlink(missing_ok=True)
        raise FileNotFoundError

    monkeypatch.setattr(object_file, "load", gone)
    simulation = Simulation(engine="auto")
    simulation.step(3)
    assert str(simulation.engine) == "auto: plain so far"


def test_the_files_that_were_used_last_stay(folder: Path) -> None:
    object_file.write(object_file.place(), b"code")
    for age in range(object_file.KEPT + 5):
        os.utime(put(folder, f"cycle-{age}.o"), (10_000.0 - age, 10_000.0 - age))
    os.utime(folder / "cycle-now.o", (1.0, 1.0))
    object_file._read(object_file.place())
    (folder / ".cycle-1.4711.o").write_bytes(b"cod")
    (folder / "compiling.log").touch()
    object_file.tidy()
    kept = {f"cycle-{age}.o" for age in range(object_file.KEPT - 1)}
    assert {path.name for path in folder.iterdir()} == kept | {"cycle-now.o", "compiling.log"}


@needs_numba
@BEHIND_OTHERS
def test_two_compilers_at_once_do_the_work_once_and_tidy_up(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    object_file.prepare()
    folder = object_file.folder()
    for age in range(object_file.KEPT):
        os.utime(put(folder, f"cycle-{age}.o"), (10_000.0 - age, 10_000.0 - age))
    command = [sys.executable, "-m", "slidectl.simulation.compiled.compiler"]
    both = [subprocess.Popen(command, env=dict(os.environ)) for _ in range(2)]
    assert [process.wait() for process in both] == [0, 0]
    assert object_file.report().read_text() == ""
    made = [path for path in folder.glob("*.o") if path.stat().st_size > 1000]
    assert [path.parent for path in made] == [folder]
    assert len(list(folder.glob("*.o"))) == object_file.KEPT
    assert not (folder / f"cycle-{object_file.KEPT - 1}.o").exists()


@needs_numba
def test_a_compiler_whose_folder_is_gone_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "gone"))
    done = subprocess.run([sys.executable, "-m", "slidectl.simulation.compiled.compiler"], env=dict(os.environ))
    assert done.returncode == 1
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_not_what_was_written_is_thrown_away(folder: Path) -> None:
    for damaged in (b"", b"short", b"\0" * 9000):
        file = put(folder, "cycle-now.o")
        file.write_bytes(damaged)
        with pytest.raises(FileNotFoundError):
            object_file._read(object_file.place())
        assert not file.exists()


@needs_numba
@BEHIND_OTHERS
def test_damaged_code_is_compiled_again_and_ends_no_process(tmp_path: Path) -> None:
    program = (
        "from slidectl.simulation import Simulation\n"
        "from slidectl.simulation.compiled import object_file\n"
        "object_file.prepare()\n"
        "object_file.place().write_bytes(b'half of what was ' * 100)\n"
        "object_file.place().chmod(0o600)\n"
        "simulation = Simulation(engine='compiled')\n"
        "simulation.engine.complete()\n"
        "simulation.step(10)\n"
        "print(simulation.engine, simulation.cycles)\n"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert (done.stdout, done.stderr, done.returncode) == ("compiled 10\n", "", 0)


def run_in(folder: Path, program: str, **environment: str) -> str:
    """What a program prints that is started in this folder, with code of its own."""
    changed = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), **environment}
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, env=changed, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_numba
@BEHIND_OTHERS
def test_the_compiler_takes_no_file_of_the_users_for_a_library(tmp_path: Path) -> None:
    (tmp_path / "random.py").write_text("raise SystemExit('this is not the library')\n")
    program = (
        "import sys; sys.path.pop(0)\n"
        "from slidectl.simulation import Simulation\n"
        "simulation = Simulation(engine='compiled')\n"
        "simulation.engine.complete()\n"
        "print(simulation.engine)\n"
    )
    assert run_in(tmp_path, program) == "compiled\n"


def test_without_numba_the_interpreter_runs_the_cycles(tmp_path: Path) -> None:
    program = (
        "from importlib import metadata\n"
        "version = metadata.version\n"
        "def without_numba(name):\n"
        "    if name == 'numba': raise metadata.PackageNotFoundError(name)\n"
        "    return version(name)\n"
        "metadata.version = without_numba\n"
        "from slidectl.errors import Refused\n"
        "from slidectl.simulation import Simulation\n"
        "simulation = Simulation(engine='auto')\n"
        "print(simulation.step(20000), simulation.engine)\n"
        "try: Simulation(engine='compiled')\n"
        "except Refused as refusal: print(refusal.message)\n"
    )
    assert run_in(tmp_path, program) == "20000 plain\nthe compiled engine needs numba\n"


@needs_numba
def test_a_compiler_that_breaks_says_why_in_the_report_and_the_log(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys; sys.modules['llvmlite.ir'] = None\n")
    program = (
        "from slidectl.errors import Refused\n"
        "from slidectl.simulation import Simulation\n"
        "from slidectl.simulation.compiled import object_file\n"
        "simulation = Simulation(engine='compiled')\n"
        "lines = []\n"
        "simulation.subscribe('/rosout', lines.append)\n"
        "simulation.driven = True\n"
        "while not simulation.engine.is_settled: simulation.step(1)\n"
        "print(simulation.engine, lines[-1]['msg'], lines[-1]['level'], sep='\\n')\n"
        "print(object_file.report().read_text())\n"
    )
    status, logged, level, *report = run_in(tmp_path, program, PYTHONPATH=str(tmp_path)).splitlines()
    assert status == f"plain: compiling failed, see {tmp_path}/cache/slidectl/compiling.log"
    assert (logged, level) == (f"cycles run in the interpreter: {status.removeprefix('plain: ')}", "8")
    assert "llvmlite.ir" in "".join(report)
