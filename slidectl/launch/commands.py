"""`<param command="...">`: xacro runs in this process, by our own; any other command as the user's own program.

As roslaunch does it, there is no shell: words, quotes, and nothing is expanded.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from slidectl.description.packages import is_file
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, SlidectlError
from slidectl.launch.children import run
from slidectl.launch.files import shown
from slidectl.launch.tag import Tag

_XACRO = ("xacro", "xacro.py")
_PYTHON = re.compile(r"python[\d.]*\Z")
_FLAGS = ("--inorder", "-i", "-q", "-v", "--check-order", "--xacro-ns", "--debug")
_WITHOUT_EFFECT = ("--verbosity",)


class Command:
    """One command, taken apart. What is wrong with it is said when it is read, not when it runs."""

    def __init__(self, tag: Tag) -> None:
        self.tag = tag
        self.words = tag.words("command")
        if not self.words:
            raise tag.error("the attribute 'command' is empty")
        before = _before_xacro(self.words)
        self.is_xacro = before is not None
        if before is not None:
            self.file, self.arguments = _xacro_arguments(tag, self.words[before:])
        elif not tag.scope.launch.run_commands:
            raise tag.error(f"runs the program {self.words[0]!r}", "that is refused by --no-commands")

    def output(self) -> str:
        """What the command prints. Raises BadFile when it fails."""
        return self._expand() if self.is_xacro else self._run()

    def _expand(self) -> str:
        from slidectl import description

        try:
            document = description.load(
                self.file, self.arguments, self.tag.scope.packages, missing=self.tag.plan.missing
            )
        except BadFile:
            raise
        except SlidectlError as error:
            raise self.tag.error(error.message, error.hint) from None
        self.tag.plan.notices += map(self._placed, document.report)
        return document.xml

    def _placed(self, notice: Notice) -> Notice:
        """What is said of an argument of the command belongs to the line where that stands."""
        if notice.line is not None:
            return notice
        place = self.tag.place
        return replace(notice, text=f"{notice.text} (of {shown(self.file)})", file=place.file, line=place.line)

    def _run(self) -> str:
        words = " ".join(self.words)
        try:
            code, output = run(self.words, environment(self.tag.scope.launch.environment), MOST_BYTES)
        except OverflowError as error:
            raise self.tag.error(f"the command prints {error}", f"command: {words}") from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise self.tag.error(f"cannot run {self.words[0]!r}: {reason}", f"command: {words}") from None
        if code:
            raise self.tag.error(f"the command ended with code {code}", f"command: {words}")
        try:
            return output.decode("utf-8")
        except UnicodeDecodeError:
            raise self.tag.error("the command's output is no text", f"command: {words}") from None


def environment(own: Mapping[str, str]) -> dict[str, str]:
    """What a program gets beside `own`, so that the xacro which is shipped here finds slidectl."""
    return {**own, "SLIDECTL_PYTHON": sys.executable}


def _before_xacro(words: list[str]) -> int | None:
    """How many words lead up to xacro's arguments: xacro itself, by whatever path, through python or rosrun."""
    program = os.path.basename(words[0])
    if program in _XACRO:
        return 1
    if _PYTHON.match(program) and os.path.basename("".join(words[1:2])) in _XACRO:
        return 2
    return 3 if program == "rosrun" and words[1:2] == ["xacro"] and words[2:3] in ([n] for n in _XACRO) else None


def _xacro_arguments(tag: Tag, words: list[str]) -> tuple[Path, dict[str, str]]:
    """The model's file, and its arguments."""
    files, arguments = [], {}
    for word in words:
        name, given, value = word.partition(":=")
        if given and name and not word.startswith("-"):
            arguments[name] = value
        elif not word.startswith("-"):
            files.append(word)
        elif word not in _FLAGS and not word.startswith(_WITHOUT_EFFECT):
            raise tag.error(f"xacro's option {word!r} is not understood here", f"these are: {', '.join(_FLAGS)}")
    if len(files) != 1:
        raise tag.error(f"xacro takes one file, not {len(files)}: {' '.join(words)}")
    path = Path(files[0])
    if not is_file(path):
        raise tag.absence(f"xacro: no such file: {path}", thing=f"file {path}")
    return path, arguments
