"""Recordings into files in the working folder of the page, each by its own `slidectl record` process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from functools import partial
from html import escape
from pathlib import Path
from typing import IO, Any

from slidectl.errors import Refused, UsageError
from slidectl.extensions.viewing.page.page import SCROLLED, Page, Panel, WorldState

_LAST = 4096
"""Bytes read from the end of a recorder's output."""
_LONGEST_NAME = 200


class RecordPanel(Panel):
    """One recording at a time. It ends by its button, with the page, or with the daemon."""

    title = "Record"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._name = "run.bag"
        self._topics = ""
        self._folder = Path.cwd()
        self._recorder: _Recording | None = None

    def build(self, world: WorldState) -> None:
        acting = self.page.acting
        name = self.gui.add_text("file", self._name, hint=f".bag or .mcap, in {self._folder}")
        acting(name, partial(setattr, self, "_name"))
        topics = self.gui.add_text("topics to record", self._topics, hint="names or their ends; empty: all")
        acting(topics, partial(setattr, self, "_topics"))
        self._start_button = self.gui.add_button("Record")
        acting(self._start_button, lambda _: self._start())
        self._stop_button = self.gui.add_button("Stop recording")
        acting(self._stop_button, lambda _: self.leave())
        self._state = self.gui.add_html("")
        self.refresh(world)

    def leave(self) -> None:
        if self._recorder is not None:
            self._recorder.stop()

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        state, recorder = "not recording", self._recorder
        if recorder is not None:
            so_far = recorder.so_far()
            state = f"recording into {escape(recorder.path.name)}: {so_far}"
            if recorder.process.poll() is not None:
                self._recorder = None
                if trouble := recorder.trouble():
                    self.page.notify(f"{recorder.path.name} ended", trouble, "red")
                else:
                    self.page.notify(f"{recorder.path.name} recorded", so_far)
        state = f'<div style="{SCROLLED}">{state}</div>'
        if self._state.content != state:
            self._state.content = state
        is_recording = self._recorder is not None
        for button, is_off in ((self._start_button, is_recording), (self._stop_button, not is_recording)):
            if not self.page.read_only and button.disabled != is_off:
                button.disabled = is_off

    def _start(self) -> None:
        if self._recorder is not None:
            raise Refused(f"{self._recorder.path.name} is being recorded", "stop it first")
        paths = self.page.client.paths
        daemon = ["--socket", paths.socket_text] if paths.prefix else ["--instance", paths.name]
        topics = self._topics.split()
        if any(not topic.isprintable() for topic in topics):
            raise UsageError("there are characters in the names of topics that no topic has")
        self._recorder = _Recording(self._path(), [*daemon, *(["--", *topics] if topics else ["--all"])])

    def _path(self) -> Path:
        """The path of the file. Raises UsageError, Refused."""
        from slidectl.extensions.recording.recording_files import check_kind

        name = self._name.strip()
        if Path(name).name != name or not name.isprintable() or len(os.fsencode(name)) > _LONGEST_NAME:
            raise UsageError(f"{name!r} is no name of a file", f"it is made in {self._folder}: run.bag")
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
