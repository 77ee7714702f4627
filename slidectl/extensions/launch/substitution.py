"""`$(...)` in a text: `env V`, `optenv V words`, `find PKG`, `anon ID`, `arg A`, `dirname` and `eval EXPRESSION`.

`find-pkg-share PKG`, which ROS 2 has, is `find PKG`.

Texts in, texts out. As in roslaunch, results are searched again for `find` only, so that
`model:='$(find my_robot)/model.urdf'` works on a command line. This module knows no tags and no places; the caller adds
the place to an error.

Paths are protected: a package's folder may contain blanks, quotes and dollars, and `$(find)` and `$(dirname)` replace
these by placeholder characters. The placeholders pass through arguments and includes, and are changed back where a
value is used, so that a path stays one word. roslaunch splits such a path into several words.
"""

from __future__ import annotations

import ast
import json
import math
import os
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slidectl import confined
from slidectl.confined import Limits
from slidectl.description import guarded_eval, install_rules
from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.errors import SlidectlError, closest, listing

COMMANDS = ("find", "env", "optenv", "dirname", "anon", "arg")
MOST_TEXT = 4 * 2**20
"""The most characters that all substitutions of one text may insert, and the most bytes of the result of an
`$(eval ...)`.

Against: arguments that repeat each other, in a launch file that was sent."""
MOST_SUBSTITUTIONS = 10_000
"""The most substitutions in one text. Against: the same; each may search the packages."""
LIMITS = Limits(cpu_s=5, wall_s=20, new_bytes=256 << 20)
"""Of an `$(eval ...)`, which runs in a process of its own.

Against: a launch file that was sent, when it is checked or read. What it starts is not bounded."""
_MATH = {name: value for name, value in vars(math).items() if not name.startswith("_")}
DEFAULTS = {"ROS_DISTRO": "noetic"}
"""Variables that every ROS 1 environment sets; these are their values where they are not set."""
_EVAL = "$(eval "
_SUBSTITUTION = re.compile(r"\$\(([^)]*)(\)?)([^ $]*)")
"""The text in the brackets, the closing bracket, and the path that may follow."""
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*\Z")

# Placeholders are in the last private plane of Unicode, which file names and launch files do not use.
_STAND_INS = {ord(letter): chr(0x10F700 + ord(letter)) for letter in "$ \t\n\r\f\v\"'\\"}
_LETTERS = {ord(stand_in): chr(letter) for letter, stand_in in _STAND_INS.items()}
# Marks the name of a missing package in the place of its folder. Arguments pass it on to the tag that needs the
# folder, and only that tag is left out.
_ABSENT = "\U0010f6ff"
_ABSENT_PACKAGE = re.compile(f"{_ABSENT}([^{_ABSENT}]*){_ABSENT}")


class SubstitutionError(SlidectlError):
    """A `$(...)` is not valid, or names something that does not exist."""


_SIMPLE_LENGTH, _SHORT = 1000, 10_000
"""The most characters of a simple expression, and of a text in it."""
_SIMPLE = (
    ast.Expression, ast.Constant, ast.Name, ast.Load, ast.BoolOp, ast.boolop, ast.UnaryOp, ast.Not, ast.USub, ast.UAdd,
    ast.BinOp, ast.Add, ast.Sub, ast.Div, ast.Compare, ast.cmpop, ast.IfExp, ast.Call,
)  # fmt: skip
"""Parts of simple expressions. Calls are of the functions of launch files: `arg`, `find` and the like."""


class EvalError(ValueError):
    """An expression cannot be computed. The text is a clause without a subject."""


def protect(path: str) -> str:
    """Put placeholders into the path."""
    return path.translate(_STAND_INS)


def plain(text: str) -> str:
    """Replace placeholders by the original characters."""
    return text.translate(_LETTERS)


def absent_packages(text: str) -> list[str]:
    """The missing packages that a substituted text needs."""
    return _ABSENT_PACKAGE.findall(text)


def automatic(text: str) -> Any:
    """The value of a text by roslaunch's rules: `1.0` a float, `10` an int, `true` a bool, `1e3` the text itself."""
    try:
        if "." in text:
            return float(text)
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    return {"true": True, "false": False}.get(text.lower(), text)


@dataclass(frozen=True)
class Substitution:
    """Resolves the substitutions of one scope."""

    packages: Packages
    environment: Mapping[str, str]
    arguments: Mapping[str, str]
    """The arguments of the scope, protected."""
    folder: str
    """The folder of the file with the text."""
    anonymous_names: dict[str, str]
    """The names that `anon` has made in this file so far."""
    absent: dict[str, UnknownPackage]
    """Collects the missing packages."""

    def resolve(self, text: str) -> str:
        """The text with all substitutions made. Raises SubstitutionError."""
        if "$(" not in text:
            return text
        if text.startswith(_EVAL) and text.endswith(")"):
            return self._eval(text[len(_EVAL) : -1])
        return self._pass(self._pass(text, finds=False), finds=True)

    def _pass(self, text: str, finds: bool) -> str:
        """Substitute only `find`, or everything but `find`."""
        count = size = 0

        def replacement(match: re.Match[str]) -> str:
            nonlocal count, size
            command, words = _split(match, text)
            if finds is not (command == "find"):
                return match[0]
            count += 1
            if count > MOST_SUBSTITUTIONS:
                raise _too_much(f"{MOST_SUBSTITUTIONS} substitutions")
            if finds:
                inserted = self._package_path(_one(command, words), match[3])
            else:
                inserted = self._command(command, words) + match[3]
            size += len(inserted)
            if size > MOST_TEXT:
                raise _too_much(f"{MOST_TEXT >> 10} KiB of text")
            return inserted

        return _SUBSTITUTION.sub(replacement, text)

    def _command(self, command: str, words: list[str]) -> str:
        if command == "optenv":
            if not words:
                raise SubstitutionError("$(optenv) needs the name of a variable", "$(optenv NAME DEFAULT)")
            return self.environment.get(words[0], " ".join(words[1:]))
        if command == "dirname":
            if words:
                raise SubstitutionError("$(dirname) takes nothing after it")
            return protect(self.folder)
        read = {"env": self._variable, "anon": self._anonymous, "arg": self._argument}[command]
        return read(_one(command, words))

    def _package_path(self, package: str, path: str) -> str:
        """The package's folder joined with the path after it, with or without a slash between.

        For an executable of an installed package it is `PREFIX/lib/PACKAGE` instead of `PREFIX/share/PACKAGE`.
        """
        folder = self._folder_of(package)
        path = path.replace("\\", "/").removeprefix("/")
        if path.startswith("/"):  # an absolute path, as os.path.join treats it
            return path
        share = Path(folder).parent
        built = share.parent / "lib" / package / path
        if "/" not in path and share.name == "share" and is_file(built) and os.access(built, os.X_OK):
            return protect(str(built))
        whole = protect(folder) + (f"/{path}" if path else "")
        if package in self.absent:
            return whole
        bare = whole.rstrip("'\"")  # quotes around the path belong to a command line
        wanted = Path(plain(bare))
        found = install_rules.located(wanted)
        return whole if found == wanted else protect(str(found)) + whole[len(bare) :]

    def _folder_of(self, package: str) -> str:
        """The package's folder; for a missing package a mark that `absent_packages` finds."""
        try:
            return str(self.packages.find(package))
        except UnknownPackage as error:
            self.absent[package] = error
            return f"{_ABSENT}{package}{_ABSENT}"

    def _anonymous(self, identifier: str) -> str:
        """`identifier` with host, process id and a random number appended; the same for the same identifier."""
        if identifier not in self.anonymous_names:
            host = "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in os.uname().nodename)
            number = int.from_bytes(os.urandom(6), "big")
            self.anonymous_names[identifier] = f"{identifier}_{host}_{os.getpid()}_{number}"
        return self.anonymous_names[identifier]

    def _variable(self, name: str) -> str:
        if name not in self.environment:
            raise SubstitutionError(f"environment variable {name!r} is not set", f"use $(optenv {name} DEFAULT)")
        return self.environment[name]

    def _argument(self, name: str) -> str:
        if name not in self.arguments:
            near = closest(name, self.arguments)
            suggestion = f" Did you mean {near!r}?" if near else ""
            raise SubstitutionError(
                f"there is no argument {name!r} here.{suggestion}", f"arguments: {listing(self.arguments)}"
            )
        return self.arguments[name]

    def _eval(self, expression: str) -> str:
        functions: dict[str, Callable[..., Any]] = {
            "arg": lambda name: automatic(self._argument(name)),
            "env": self._variable,
            "optenv": lambda name, default="": self.environment.get(name, default),
            "find": lambda package: protect(self._folder_of(package)),
            "anon": self._anonymous,
            "dirname": lambda: protect(self.folder),
        }
        taken = {*_MATH, *functions, "true", "false"}
        arguments = {name: automatic(value) for name, value in self.arguments.items() if _IDENTIFIER.match(name)}
        values = {name: value for name, value in arguments.items() if name not in taken}
        names = values | {name: _of_names(name, call) for name, call in functions.items()}
        try:
            value, (anonymous_names, absent) = evaluate(
                expression, names, lambda: (self.anonymous_names, list(self.absent))
            )
        except EvalError as error:
            raise SubstitutionError(f"$(eval {plain(expression)}) {error}") from None
        self.anonymous_names.update(anonymous_names)
        for package in absent:
            self._folder_of(package)
        return value


def evaluate(text: str, names: Mapping[str, Any], state: Callable[[], Any] = lambda: None) -> tuple[str, Any]:
    """Evaluate an expression of Python, with a guard, and in a process of its own where it may take long.

    It may use `names`, the names of the math module, and Python's own functions.

    Returns:
        The value as text, and what `state` returns after it in that process, by way of JSON.

    Raises EvalError: with the reason, but without the place. SubstitutionError: a function of `names` raised it.
    """
    if "__" in text:
        raise EvalError("may not contain double underscores")
    if _is_simple(text, names):
        try:
            return _computed(text, names), state()
        except SlidectlError as reason:
            raise SubstitutionError(reason.message, reason.hint) from None

    def work() -> bytes:
        value = error = None
        try:
            value = _computed(text, names)
        except EvalError as reason:
            error = [False, str(reason), None]
        except SlidectlError as reason:
            error = [True, reason.message, reason.hint]
        return json.dumps([value, error, state()]).encode()

    try:
        value, error, after = json.loads(confined.run(work, LIMITS, MOST_TEXT))
    except confined.EndedError as error:
        raise EvalError(f"cannot be computed: {error}") from None
    except OSError as error:
        raise EvalError(f"cannot be computed: no process can be started: {error.strerror}") from None
    if error is not None:
        is_of_function, reason, hint = error
        raise SubstitutionError(reason, hint) if is_of_function else EvalError(reason)
    return value, after


def _is_simple(text: str, names: Mapping[str, Any]) -> bool:
    """True when the expression cannot take long or much memory: it compares, adds and chooses among short values.

    Most expressions of launch files are such, and a process for each would cost milliseconds.
    """
    if len(text) > _SIMPLE_LENGTH or any(isinstance(one, str) and len(one) > _SHORT for one in names.values()):
        return False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the user cannot act on Python's warnings about this code
            tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    return all(
        isinstance(node, _SIMPLE)
        and (not isinstance(node, ast.Call) or (isinstance(node.func, ast.Name) and callable(names.get(node.func.id))))
        for node in ast.walk(tree)
    )


def _computed(text: str, names: Mapping[str, Any]) -> str:
    """The value of an expression as text. Raises as `evaluate` does."""
    symbols = {**_MATH, "true": True, "false": False, **names}
    try:
        value = guarded_eval.evaluate(text, symbols, None, (), guarded_eval.FUNCTIONS)
        if callable(value):
            raise EvalError("gives a function: its arguments are missing")
        return str(value)
    except EvalError:
        raise
    except SyntaxError as error:
        raise EvalError(f"is not valid: {error.msg}") from None
    except NameError as error:
        known = f"there are {', '.join(sorted(names))}, and the names of the math module"
        raise EvalError(f"there is no name {error.name!r}; {known}" if error.name else str(error)) from None
    except MemoryError:
        raise EvalError(f"takes more than {LIMITS.new_bytes >> 20} MiB of memory") from None
    except SlidectlError:
        raise
    except Exception as error:  # the operators and functions of Python may raise any exception
        reason = f"no key {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise EvalError(f"cannot be computed: {reason}") from None


def _of_names(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function so that it accepts only texts."""

    def checked(*values: Any) -> Any:
        for value in values[:1] if name == "optenv" else values:  # the default of optenv may be a number
            if not isinstance(value, str):
                raise EvalError(f"{name}() takes names, in quotes, and not {value!r}")
        return function(*values)

    return checked


def _too_much(what: str) -> SubstitutionError:
    return SubstitutionError(f"comes to more than {what}", "do arguments repeat each other many times over?")


def _split(match: re.Match[str], text: str) -> tuple[str, list[str]]:
    """Split a substitution into its command and words. Raises SubstitutionError."""
    inside = match[1]
    if not match[2]:
        raise SubstitutionError(f"'$(' is not closed in {plain(text)!r}")
    if "$" in inside or "(" in inside:
        what = "one substitution" if "$" in inside else "a bracket"
        hint = "use $(eval ...), for example $(eval find(arg('package')) + '/urdf')"
        raise SubstitutionError(f"{what} is inside a substitution in {plain(text)!r}", hint)
    command, *words = [word for word in inside.split(" ") if word] or [""]
    command = "find" if command == "find-pkg-share" else command
    if command == "eval":
        raise SubstitutionError("$(eval) must be the whole value", "put the rest of the value into the expression")
    if command not in COMMANDS:
        near = closest(command, [*COMMANDS, "eval"])
        suggestion = f" Did you mean {near!r}?" if near else ""
        known = f"there are {', '.join(COMMANDS)} and eval"
        raise SubstitutionError(f"unknown substitution $({plain(inside)}).{suggestion}", known)
    return command, words


def _one(command: str, words: list[str]) -> str:
    if len(words) != 1:
        meant = f"$({command} NAME), and names have no spaces: did you mean $({command} {'_'.join(words)})?"
        text = f"$({command}) takes exactly one name, not {len(words)}"
        raise SubstitutionError(text, meant if words else f"$({command} NAME)")
    return words[0]
