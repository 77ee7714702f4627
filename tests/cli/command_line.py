"""Runs the command line as a user starts it: a process of its own, in a private runtime folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from daemon_fixture import clean_environment
from waiting import eventually

from slidectl import Client

ROOT = Path(__file__).parent.parent.parent
LIMIT_S = 240.0
"""Wall seconds after which a command has hung: less than the limit of a test, which ends the test alone."""

Done = subprocess.CompletedProcess[str]


class CommandLine:
    """Runs `slidectl WORDS` with its standard streams as pipes. `environment` is what every run gets."""

    def __init__(self, runtime: Path) -> None:
        self.runtime = runtime
        self.environment = {**clean_environment(), "XDG_RUNTIME_DIR": str(runtime)}

    def client(self) -> Client:
        """A connection to the daemon of the default instance."""
        return Client(socket=str(self.runtime / "slidectl" / "default" / "socket"))

    def until_subscribed(self, topic: str) -> None:
        """Wait until somebody subscribes to the topic."""
        with self.client() as client:
            request = {"topic": topic}
            eventually(lambda: client.call("/rosapi/subscribers", request)["subscribers"], f"nobody hears {topic}")

    def argv(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "slidectl", *words]

    def __call__(self, *words: str, stdin: str = "", cwd: Path = ROOT, **environment: str) -> Done:
        return subprocess.run(
            self.argv(*words),
            input=stdin,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            cwd=cwd,
            env={**self.environment, **environment},
            check=False,
        )

    def ok(self, *words: str, **environment: str) -> str:
        """Runs it and expects success; its standard output."""
        done = self(*words, **environment)
        assert done.returncode == 0, f"slidectl {' '.join(words)}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def start(self, *words: str, **environment: str) -> subprocess.Popen[str]:
        """Starts it and does not wait."""
        return subprocess.Popen(
            self.argv(*words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**self.environment, **environment},
        )

    def on_a_terminal(self, *words: str, end_at: bytes = b"", **environment: str) -> bytes:
        """What it writes when its standard streams are a terminal. NO_COLOR counts only when it is given here.

        It is sent SIGTERM when it has written `end_at`.
        """
        master, slave = os.openpty()
        kept = {key: value for key, value in self.environment.items() if key != "NO_COLOR"}
        env = {**kept, "TERM": "xterm", **environment}
        process = subprocess.Popen(self.argv(*words), stdin=slave, stdout=slave, stderr=slave, env=env, cwd=ROOT)
        os.close(slave)
        output = b""
        while part := _read(master):
            output += part
            if end_at and end_at in output:
                process.terminate()
                end_at = b""
        process.wait(30)
        os.close(master)
        return output


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # the last process that had the terminal open has ended
        return b""
