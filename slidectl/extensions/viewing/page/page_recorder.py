"""Recordings into files in the working folder of the page, each by its own `slidectl record` process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from slidectl.errors import Refused, UsageError

if TYPE_CHECKING:
    from slidectl.extensions.viewing.page.page import Page

_LAST = 4096
"""Bytes read from the end of a recorder's output."""
_LONGEST_NAME = 200


class PageRecorder:
    """One recording at a time. It ends when it is stopped, with the page, or with the daemon."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = Path.cwd()
        self._recording: _Recording | None = None

    def state(self) -> dict[str, str] | None:
        """The file that is recorded, and what it has so far; None without one."""
        one = self._recording
        return None if one is None else {"file": one.path.name, "text": one.so_far()}

    def leave(self) -> None:
        """End the recording."""
        if self._recording is not None:
            self._recording.stop()

    def stop(self) -> None:
        """End the recording. Raises Refused: there is none."""
        if self._recording is None:
            raise Refused("nothing is recorded")
        self._recording.stop()

    def update(self) -> None:
        """Tell the browsers of a recorder that has ended."""
        one = self._recording
        if one is None or one.process.poll() is None:
            return
        self._recording = None
        if trouble := one.trouble():
            self._page.tell("error", f"{one.path.name} ended\n{trouble}")
        else:
            self._page.tell("info", f"{one.path.name} recorded\n{one.so_far()}, in {self._folder}")

    def start(self, request: dict[str, Any]) -> None:
        """Record the `topics`, all without any, into the new `file`. Raises Refused, UsageError."""
        self.update()
        if self._recording is not None:
            raise Refused(f"{self._recording.path.name} is being recorded", "stop it first")
        paths = self._page.client.paths
        daemon = ["--socket", paths.socket_text] if paths.prefix else ["--instance", paths.name]
        topics = str(request.get("topics", "")).split()
        if any(not topic.isprintable() for topic in topics):
            raise UsageError("there are characters in the names of topics that no topic has")
        path = self._path(str(request["file"]).strip())
        self._recording = _Recording(path, [*daemon, *(["--", *topics] if topics else ["--all"])])

    def _path(self, name: str) -> Path:
        """The path of the file. Raises UsageError, Refused."""
        from slidectl.extensions.recording.recording_files import check_kind

        if not name or Path(name).name != name or not name.isprintable() or len(os.fsencode(name)) > _LONGEST_NAME:
            where = f"the file is made in {self._folder}"
            raise UsageError(f"{name!r} is no name of a file", f"give a name without a folder, as run.bag; {where}")
        path = self._folder / name
        check_kind(path)
        if path.exists():
            raise Refused(f"{name} is there already", "give another name")
        return path


class _Recording:
    """A `slidectl record` process. Its output goes to files: a pipe could fill up when no browser reads it."""

    def __init__(self, path: Path, words: list[str]) -> None:
        """Raises Refused: it cannot be started."""
        self.path = path
        self._told: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        command = [sys.executable, "-m", "slidectl", "record", "--json", "--progress", "-O", str(path), *words]
        try:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=self._told, stderr=self._errors,
                start_new_session=True,  # Ctrl-C is for the page, which then stops the recorder
            )  # fmt: skip
        except OSError as error:
            raise Refused(f"cannot start the recorder: {error.strerror}") from None

    def stop(self) -> None:
        """Interrupt the recorder, which then completes the file."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def so_far(self) -> str:
        """The progress in words."""
        lines = _end_of(self._told).splitlines()
        if not lines:
            return "begins"
        said: dict[str, Any] = json.loads(lines[-1])
        return f"{said['messages']} messages of {said['topics']} topics, {said['seconds']:.3f} s"

    def trouble(self) -> str:
        """The error of an ended recorder; empty without one."""
        if not self.process.returncode:
            return ""
        last = (_end_of(self._errors).splitlines() or [""])[-1]
        try:
            said = json.loads(last)
        except ValueError:  # it ended without an error message in JSON
            return last or f"the recorder ended with {self.process.returncode}"
        return "\n".join(filter(None, (said["error"], said["hint"])))


def _end_of(file: IO[bytes]) -> str:
    size = os.fstat(file.fileno()).st_size
    text = os.pread(file.fileno(), _LAST, max(0, size - _LAST)).decode("utf-8", "replace")
    return text[: text.rfind("\n") + 1]  # whole lines
