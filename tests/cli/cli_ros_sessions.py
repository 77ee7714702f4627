"""A typed line with what it prints and its exit code, as the recorded sessions of the ROS tools have them."""

from __future__ import annotations

from typing import NamedTuple


class Session(NamedTuple):
    """A line, what it prints, and its exit code. `stdin` is what is piped into it."""

    line: str
    stdout: str = ""
    stderr: str = ""
    code: int = 0
    stdin: str = ""


def usage(line: str, text: str, complaint: str) -> Session:
    """Wrong usage, as optparse says it."""
    tool = line.split()[0]
    return Session(line, "", f"Usage: {text}\n\n{tool}: error: {complaint}\n", 2)
