"""Files are written whole: nobody sees half of one, or one that is not for his eyes, nor gets another one written."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from slidectl.writing import replace, write_whole


@pytest.fixture
def generous_umask() -> Iterator[None]:
    """What is made may be read and written by all, unless it is made otherwise."""
    before = os.umask(0)
    yield
    os.umask(before)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int, int]]:
    """What happens to the draft: a step, the bytes that are in the file by then, and its permissions."""
    seen: list[tuple[str, int, int]] = []
    fsync, put = os.fsync, os.replace

    def watch(step: str, found: os.stat_result) -> None:
        seen.append((step, found.st_size, stat.S_IMODE(found.st_mode)))

    monkeypatch.setattr(os, "fsync", lambda fd: (watch("on the disk", os.fstat(fd)), fsync(fd)))
    monkeypatch.setattr(os, "replace", lambda old, new: (watch("in its place", os.stat(old)), put(old, new)))
    return seen


def test_all_of_it_is_on_the_disk_before_it_takes_its_place(steps: list[tuple[str, int, int]], tmp_path: Path) -> None:
    write_whole(tmp_path / "file", "new")
    assert [step[:2] for step in steps] == [("on the disk", 3), ("in its place", 3)]


@pytest.mark.usefixtures("generous_umask")
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666])
def test_a_file_keeps_its_permissions_and_the_new_one_never_had_others(
    steps: list[tuple[str, int, int]], tmp_path: Path, mode: int
) -> None:
    file = tmp_path / "file"
    file.write_text("old")
    file.chmod(mode)
    write_whole(file, "new")
    assert {step[2] for step in steps} == {mode}
    assert (file.read_text(), stat.S_IMODE(file.stat().st_mode)) == ("new", mode)


def test_a_new_file_has_what_the_umask_leaves(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "file", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o640


def test_a_link_that_lies_in_wait_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    trap = tmp_path / f"file.{os.getpid()}"
    trap.symlink_to(victim)
    write_whole(tmp_path / "file", "new")
    assert (victim.read_text(), (tmp_path / "file").read_text()) == ("precious", "new")
    assert trap.is_symlink()


def test_what_a_link_points_to_is_written_and_the_link_stays(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    for name in ("old", "none"):
        (tmp_path / name).symlink_to(tmp_path / "there" / name)
    (tmp_path / "there" / "old").write_text("old")
    for name in ("old", "none"):
        write_whole(tmp_path / name, "new")
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / "there" / name).read_text() == "new"
    assert len(list((tmp_path / "there").iterdir())) == 2


def test_pipes_and_devices_are_written_in_place(tmp_path: Path) -> None:
    write_whole("/dev/null", "new")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_whole(tmp_path / "pipe", "new")
    assert os.read(reader, 10) == b"new"
    os.close(reader)


def test_both_names_of_a_file_show_the_new_text(tmp_path: Path) -> None:
    (tmp_path / "one").write_text("old")
    os.link(tmp_path / "one", tmp_path / "other")
    write_whole(tmp_path / "one", "new")
    assert (tmp_path / "other").read_text() == "new"


@pytest.mark.parametrize("error", [OSError("no space"), KeyboardInterrupt()])
def test_what_is_not_written_whole_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: BaseException
) -> None:
    def fail(_: int) -> None:
        raise error

    monkeypatch.setattr(os, "fsync", fail)
    (tmp_path / "file").write_text("old")
    with pytest.raises(type(error)):
        replace(tmp_path / "file", b"new", 0o600)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
