"""The small parts of the daemon: statistics, the lock, the log."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slidectl.daemon.lock import InstanceLock, LockFailed, holder
from slidectl.daemon.logfile import LogFile
from slidectl.daemon.statistics import Ring, SpeedMeter


def test_a_ring_summarizes_its_latest_values() -> None:
    ring = Ring()
    assert ring.summary() == (0, 0, 0, 0)
    values = np.random.default_rng(1).random(20_000)
    for value in values:
        ring.add(value)
    mean, p50, p99, worst = ring.summary()
    latest = values[-8192:]
    assert mean == pytest.approx(latest.mean())
    assert p50 == pytest.approx(np.percentile(latest, 50), abs=1e-3)
    assert p99 == pytest.approx(np.percentile(latest, 99), abs=1e-3)
    assert worst == latest.max()
    ring.clear()
    ring.add(3.0)
    assert ring.summary() == (3, 3, 3, 3)


def advance(meter: SpeedMeter, now_s: float, simulated_s: float) -> None:
    """As the pacer does after each group of cycles."""
    meter.simulated_s += simulated_s
    if now_s >= meter.next_mark_s:
        meter.mark(now_s)


def test_the_speed_is_that_of_the_last_seconds() -> None:
    meter = SpeedMeter()
    assert meter.reached(0.0) == 0
    meter.begin(0.0)
    for tick in range(1, 101):
        advance(meter, tick * 0.1, 0.1)
    for tick in range(101, 201):
        advance(meter, tick * 0.1, 0.05)
    assert meter.reached(20.0) == pytest.approx(0.5)
    meter.stop()
    assert meter.reached(21.0) == 0


def lock_in_another_process(path: Path) -> subprocess.Popen[str]:
    """A process that holds the lock until its stdin is closed."""
    script = (
        "import sys; from pathlib import Path; from slidectl.daemon.lock import InstanceLock\n"
        "print(InstanceLock(Path(sys.argv[1])).acquire(), flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "True\n"
    return process


def test_the_lock_names_its_holder_and_is_free_when_that_has_died(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    assert holder(path) is None
    with lock_in_another_process(path) as process:
        assert holder(path) == process.pid
        assert holder(path) == process.pid  # asking disturbs nobody
        assert not InstanceLock(path).acquire()
        assert path.read_text() == f"{process.pid}\n"
        process.kill()
        process.wait()
        assert path.exists()
        assert holder(path) is None
        lock = InstanceLock(path)
        assert lock.acquire()
        lock.release()
    assert not path.exists()


def test_a_file_system_without_locks_is_told_from_a_lock_that_is_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("slidectl.daemon.lock.fcntl.lockf", refuse)
    with pytest.raises(LockFailed, match=r"cannot take the lock .*: No locks available"):
        InstanceLock(tmp_path / "lock").acquire()


def test_a_lock_that_cannot_be_had_is_not_taken_for_one_that_is_held(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "folder", tmp_path / "nowhere" / "lock"):
        with pytest.raises(LockFailed, match=f"cannot make the lock {path}: "):
            InstanceLock(path).acquire()


def test_a_lock_that_was_never_acquired_removes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    path.write_text("mine")
    InstanceLock(path).release()
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


def test_lines_that_were_lost_on_a_full_disk_are_counted_when_there_is_room_again(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.symlink_to("/dev/full")
    log = LogFile(path, foreground=True, most_bytes=500)
    for _ in range(3):
        log.write("info", "lost")
    path.unlink()
    log.write("info", "x" * 600)  # too long for the file, so a new one is begun
    log.close()
    lost, entry = path.read_text().splitlines()
    assert lost.startswith("(3 entries")
    assert entry.endswith("xxx")


def test_an_entry_that_was_cut_off_by_a_full_disk_does_not_run_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = LogFile(tmp_path / "log", foreground=True)
    write = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, bytes(data)[:20]))
    log.write("info", "the disk is full")
    monkeypatch.undo()
    log.write("info", "there is room again")
    log.write("info", "and still")
    log.close()
    cut, lost, entry, last = (tmp_path / "log").read_text().splitlines()
    assert len(cut) == 20
    assert lost.startswith("(1 entries")
    assert entry.endswith("there is room again")
    assert last.endswith("and still")


def test_a_log_in_a_folder_that_has_gone_harms_nobody(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "gone" / "log", foreground=True)
    log.write("error", "nobody reads this")
    log.close()


def test_an_entry_of_several_lines_is_indented(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "log", foreground=True)
    log.write("warn", "first\nsecond\n")
    log.close()
    assert os.linesep.join((tmp_path / "log").read_text().splitlines()).endswith("warn  first\n    second")
