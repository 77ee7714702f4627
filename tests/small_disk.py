"""A disk of a few kilobytes, seen only by the commands that are started on it: a tmpfs in a mount namespace."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

PAGE = 4096
"""The bytes in which a tmpfs gives away its room."""


class SmallDisk:
    """The disk is mounted on `folder`, for those whose command line begins with `prefix`. `seen` is it from outside."""

    def __init__(self, folder: Path, holder: int) -> None:
        self.folder = folder
        self.prefix = ["nsenter", "-t", str(holder), "-U", "-m", "--preserve-credentials", "--"]
        self.seen = Path(f"/proc/{holder}/root{folder}")

    def files(self) -> dict[str, int]:
        """The names below the disk, with their sizes (of folders: -1). The filling is left out."""
        found = {}
        for path in self.seen.rglob("*"):
            if path.name != "filling":
                found[str(path.relative_to(self.seen))] = -1 if path.is_dir() else path.lstat().st_size
        return found

    def clear(self) -> None:
        for path in self.seen.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()

    def fill(self, free: int) -> None:
        """Leave so many bytes, up to a page more."""
        about = os.statvfs(self.seen)
        size = about.f_bavail * about.f_frsize - free // PAGE * PAGE
        with (self.seen / "filling").open("ab") as file:
            file.write(bytes(size))


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[SmallDisk]:
    """A disk of so many bytes on `folder`, which is made. Skips the test where none can be had."""
    folder.mkdir()
    mount = 'mount -t tmpfs -o size="$1" none "$0" && echo mounted && exec cat'
    argv = ["unshare", "--user", "--mount", "--map-root-user", "sh", "-c", mount, str(folder), str(size)]
    if shutil.which("unshare") is None or shutil.which("nsenter") is None:
        pytest.skip("a small disk needs unshare and nsenter, of util-linux")
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as holder:
        try:
            assert holder.stdout is not None
            if holder.stdout.readline() != b"mounted\n":
                assert holder.stderr is not None
                pytest.skip(f"no user and mount namespace can be had: {holder.stderr.read().decode().strip()}")
            yield SmallDisk(folder, holder.pid)
        finally:
            holder.kill()
