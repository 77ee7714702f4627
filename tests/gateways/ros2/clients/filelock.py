"""What the spawner uses of the package filelock, which is not among rclpy's wheels."""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import Any


class Timeout(Exception):
    """Never raised here: `acquire` waits as long as it takes."""


class FileLock:
    """A lock that one process at a time can hold."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._file: Any = None

    def acquire(self, timeout: float) -> None:  # noqa: ARG002 - of the interface
        self._file = Path(self._path).open("w")  # noqa: SIM115 - `release` closes it
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def release(self) -> None:
        self._file.close()

    @property
    def is_locked(self) -> bool:
        return self._file is not None and not self._file.closed
