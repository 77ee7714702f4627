"""The small parts of the daemon: the lock and the log."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from slidectl.daemon.instance_files import InstanceFiles
from slidectl.errors import Refused
from slidectl.logfile import LogFile
from slidectl.paths import InstancePaths
from slidectl.processes import holder


def place(folder: Path) -> InstanceFiles:
    return InstanceFiles(InstancePaths(folder, folder / "socket"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    tmp_path.chmod(0o700)
    return tmp_path


def lock_in_another_process(folder: Path) -> subprocess.Popen[str]:
    """A process that holds the lock until its stdin is closed."""
    script = (
        "import sys; from slidectl.daemon.instance_files import InstanceFiles\n"
        "from slidectl.paths import InstancePaths\n"
        "print(InstanceFiles(InstancePaths(sys.argv[1], 'socket')).acquire(), flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "True\n"
    return process


def test_the_lock_names_its_holder_and_is_free_when_that_has_died(folder: Path) -> None:
    path = folder / "lock"
    assert holder(path) is None
    with lock_in_another_process(folder) as process:
        assert holder(path) == process.pid
        assert holder(path) == process.pid  # asking disturbs nobody
        assert not place(folder).acquire()
        assert path.read_text() == f"{process.pid}\n"
        process.kill()
        process.wait()
        assert path.exists()
        assert holder(path) is None
        taken = place(folder)
        assert taken.acquire()
        taken.release()
    assert not path.exists()


def test_a_file_system_without_locks_is_told_from_a_lock_that_is_held(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("slidectl.processes.fcntl.lockf", refuse)
    with pytest.raises(Refused, match=r"cannot acquire the lock .*: No locks available"):
        place(folder).acquire()


def test_a_lock_that_cannot_be_had_is_not_taken_for_one_that_is_held(folder: Path) -> None:
    (folder / "lock").mkdir()
    with pytest.raises(Refused, match=f"cannot create the lock {folder / 'lock'}: "):
        place(folder).acquire()


def test_a_place_that_was_never_taken_removes_nothing(folder: Path) -> None:
    path = folder / "lock"
    path.write_text("mine")
    place(folder).release()
    assert path.exists()


def test_the_log_rotates_and_keeps_two_copies(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    log = LogFile(tmp_path / "log", foreground=True, most_bytes=1000)
    for number in range(100):
        log.write("info", f"entry {number}")
    log.close()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log", "log.1", "log.2"]
    assert all(file.stat().st_size <= 1000 for file in tmp_path.iterdir())
    text = "".join((tmp_path / name).read_text() for name in ("log.2", "log.1", "log"))
    kept = [int(line.rpartition(" ")[2]) for line in text.splitlines()]
    assert kept == list(range(kept[0], 100))
    assert capfd.readouterr().err.count("\n") == 100


def test_a_log_that_could_not_be_written_goes_on_when_there_is_room_again(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.symlink_to("/dev/full")
    log = LogFile(path, foreground=True)
    log.write("info", "lost")
    path.unlink()
    log.write("info", "there is room again")
    log.close()
    assert path.read_text().endswith("there is room again\n")


def test_a_log_in_a_folder_that_has_gone_harms_nobody(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "gone" / "log", foreground=True)
    log.write("error", "nobody reads this")
    log.close()


def test_an_entry_of_several_lines_is_indented(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "log", foreground=True)
    log.write("warn", "first\nsecond\n")
    log.close()
    assert os.linesep.join((tmp_path / "log").read_text().splitlines()).endswith("warn  first\n    second")
