"""Paths that keep together when a text is taken apart as a shell would do it.

A package's folder may hold blanks, quotes and dollars. What `$(find)` and `$(dirname)` give is written with stand-ins
for these, which go through arguments and includes as they are, and are turned back where a value is used. roslaunch
itself takes such a path for several words.
"""

from __future__ import annotations

import shlex

_SPECIAL = "$ \t\n\r\f\v\"'\\"
# The last private plane of Unicode: no file name and no launch file has a use for it.
_STAND_INS = {ord(letter): chr(0x10F700 + ord(letter)) for letter in _SPECIAL}
_LETTERS = {ord(stand_in): chr(letter) for letter, stand_in in _STAND_INS.items()}


def protect(path: str) -> str:
    """The path with stand-ins."""
    return path.translate(_STAND_INS)


def plain(text: str) -> str:
    """The text as it is meant, without stand-ins."""
    return text.translate(_LETTERS)


def words(text: str) -> list[str]:
    """The words of a command line, as a POSIX shell takes them apart; nothing is expanded.

    Raises:
        ValueError: a quotation that does not end.
    """
    return [plain(word) for word in shlex.split(text)]
