"""`$(...)` in a text: `env V`, `optenv V words`, `find PKG`, `anon ID`, `arg A`, `dirname` and `eval EXPRESSION`.

Texts in, texts out: what is found is put in as it is, and looked through again for `find` only, as roslaunch does it:
`model:='$(find my_robot)/model.urdf'` on a command line is understood. Paths come out protected (see protected.py).
Knows no tags and no places; who has a place adds it to the error.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from slidectl.errors import SlidectlError, closest, listing
from slidectl.expressions import MATH
from slidectl.launch.evaluator import ExpressionError, evaluate
from slidectl.launch.protected import plain, protect
from slidectl.launch.typed import automatic

COMMANDS = ("find", "env", "optenv", "dirname", "anon", "arg")
OPEN = "$("
_EVAL = "$(eval "
MOST_TEXT = 4 * 2**20
"""Letters that the substitutions of one text may come to."""
MOST_SUBSTITUTIONS = 10_000
"""In one text."""
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*\Z")


class SubstitutionError(SlidectlError):
    """A `$(...)` that makes no sense or leads nowhere."""


class Surroundings(Protocol):
    """What a whole launch shares: the packages, the environment, and the names that `anon` has given."""

    @property
    def environment(self) -> Mapping[str, str]:
        """The environment variables."""

    def find(self, package: str) -> str:
        """The package's folder."""

    def executable(self, package: str, path: str) -> str | None:
        """What a build has put elsewhere for `path` in a package, an executable most often; None when it has not."""

    def anonymous(self, identifier: str) -> str:
        """A name that nobody else has; the same for the same identifier."""


class Substitution:
    """The substitutions of one scope. `arguments` are its args, `folder` is that of the file that holds the text."""

    def __init__(self, surroundings: Surroundings, arguments: Mapping[str, str], folder: str) -> None:
        self.surroundings = surroundings
        self.arguments = arguments
        self.folder = folder

    def resolve(self, text: str) -> str:
        """The text with everything put in. Raises SubstitutionError, UnknownPackage."""
        if OPEN not in text:
            return text
        if text.startswith(_EVAL) and text.endswith(")"):
            return self._eval(text[len(_EVAL) : -1])
        return self._pass(self._pass(text, finds=False), finds=True)

    def _pass(self, text: str, finds: bool) -> str:
        """The text with `find` put in, or with everything but `find`."""
        pieces: list[str] = []
        size = count = 0
        rest = text
        while (start := rest.find(OPEN)) >= 0:
            inside, after = _inside(rest, start)
            command, *words = [word for word in inside.split(" ") if word] or [""]
            if command not in COMMANDS:
                raise _unknown(command, inside)
            if finds is not (command == "find"):
                found = f"{OPEN}{inside})"
            elif finds:
                found, after = self._find(_one(command, words), after)
            else:
                found = self._command(command, words)
            pieces += [rest[:start], found]
            rest = after
            count += 1
            size += start + len(found)
            if count > MOST_SUBSTITUTIONS or size + len(rest) > MOST_TEXT:
                what = f"{MOST_TEXT >> 10} KiB of text" if count <= MOST_SUBSTITUTIONS else f"{count - 1} substitutions"
                raise SubstitutionError(f"comes to more than {what}", "do arguments repeat each other many times over?")
        return "".join([*pieces, rest])

    def _command(self, command: str, words: list[str]) -> str:
        """What the text in brackets stands for."""
        commands: dict[str, Callable[[], str]] = {
            "optenv": lambda: self._optional(words),
            "env": lambda: self._environment(_one(command, words)),
            "anon": lambda: self.surroundings.anonymous(_one(command, words)),
            "arg": lambda: self._argument(_one(command, words)),
            "dirname": lambda: protect(self._dirname(words)),
        }
        return commands[command]()

    def _find(self, package: str, after: str) -> tuple[str, str]:
        """The package's folder joined with the path that follows, up to a blank, with or without a slash before it.

        Of a package that was built, an executable may be somewhere else than where the text says.
        """
        folder = self.surroundings.find(package)
        if not after or after.startswith(" "):
            return protect(folder), after
        path, blank, rest = after.partition(" ")
        path = path.replace("\\", "/").removeprefix("/")
        elsewhere = self.surroundings.executable(package, path)
        if path.startswith("/"):  # as os.path.join has it
            return "", path + blank + rest
        if elsewhere is not None:
            return protect(elsewhere), blank + rest
        return protect(folder), (f"/{path}" if path else "") + blank + rest

    def _environment(self, name: str) -> str:
        if name not in self.surroundings.environment:
            raise SubstitutionError(f"environment variable {name!r} is not set", f"use $(optenv {name} DEFAULT)")
        return self.surroundings.environment[name]

    def _optional(self, words: list[str]) -> str:
        if not words:
            raise SubstitutionError("$(optenv) needs the name of a variable", "$(optenv NAME DEFAULT)")
        return self.surroundings.environment.get(words[0], " ".join(words[1:]))

    def _argument(self, name: str) -> str:
        if name not in self.arguments:
            near = closest(name, self.arguments)
            suggestion = f" Did you mean {near!r}?" if near else ""
            raise SubstitutionError(
                f"there is no argument {name!r} here.{suggestion}", f"arguments: {listing(self.arguments)}"
            )
        return self.arguments[name]

    def _dirname(self, words: list[str]) -> str:
        if words:
            raise SubstitutionError("$(dirname) takes nothing after it")
        return self.folder

    def _eval(self, expression: str) -> str:
        functions: dict[str, Any] = {
            "arg": lambda name: automatic(self._argument(name)),
            "env": self._environment,
            "optenv": lambda name, default="": self.surroundings.environment.get(name, default),
            "find": lambda package: protect(self.surroundings.find(package)),
            "anon": self.surroundings.anonymous,
            "dirname": lambda: protect(self.folder),
        }
        taken = {*MATH, *functions, "true", "false"}
        values = {
            name: automatic(value)
            for name, value in self.arguments.items()
            if name not in taken and _IDENTIFIER.match(name)
        }
        try:
            named = {name: _of_names(name, function) for name, function in functions.items()}
            return _text(evaluate(expression, {**values, **named}))
        except ExpressionError as error:
            raise SubstitutionError(f"$(eval {plain(expression)}) {error}") from None


def _of_names(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which takes nothing but texts."""

    def checked(*values: Any) -> Any:
        for value in values:
            if not isinstance(value, str):
                raise ExpressionError(f"{name}() takes names, in quotes, and not {value!r}")
        return function(*values)

    return checked


def _text(value: Any) -> str:
    if callable(value):
        raise ExpressionError("gives a function: its arguments are missing")
    return str(value)


def _inside(text: str, start: int) -> tuple[str, str]:
    """What is between the brackets that open at `start`, and what comes after them."""
    end = text.find(")", start)
    if end < 0:
        raise SubstitutionError(f"'$(' is not closed in {plain(text)!r}")
    inside = text[start + len(OPEN) : end]
    if "$" in inside or "(" in inside:
        what = "one substitution" if "$" in inside else "a bracket"
        hint = "write it with $(eval ...), for example $(eval find(arg('package')) + '/urdf')"
        raise SubstitutionError(f"{what} stands inside a substitution in {plain(text)!r}", hint)
    return inside, text[end + 1 :]


def _one(command: str, words: list[str]) -> str:
    if len(words) != 1:
        raise SubstitutionError(f"$({command}) takes exactly one name, not {len(words)}", f"$({command} NAME)")
    return words[0]


def _unknown(command: str, inside: str) -> SubstitutionError:
    known = ", ".join(COMMANDS)
    if command == "eval":
        return SubstitutionError("$(eval) must be the whole value", "put what stands beside it into the expression")
    near = closest(command, [*COMMANDS, "eval"])
    suggestion = f" Did you mean {near!r}?" if near else ""
    return SubstitutionError(f"unknown substitution $({plain(inside)}).{suggestion}", f"there are {known} and eval")
