"""Reads scenario files: YAML into cases with steps. Every mistake is reported with file and line before anything runs.

The check, the JSON schema and the documentation are all made from the tables of keys in this file.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from slidectl.command_steps import StepEffects
from slidectl.description import yaml_tree
from slidectl.description.models import read_file
from slidectl.errors import BadFile, SlidectlError, UsageError, closest
from slidectl.extensions.recording.comparison import tolerances_of
from slidectl.extensions.scenarios.step_commands import (
    Commands,
    StepCommand,
    StepOption,
    as_word,
    split,
    words_of,
)

SUFFIXES = (".yaml", ".yml")
SECTIONS = ("setup", "steps", "teardown")
TEMPORARY = "${tmp}"
"""Placeholder in words for the folder of the running case, which is known only when it runs."""
_VARIABLE = re.compile(r"\$(\$)?\{([^}]*)\}")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_MOST_VALUES = 100_000
"""The most values of a file, counting what aliases repeat."""
_MOST_ITEMS = 10_000
"""The most steps of a section, cases, or items of another list."""
_MOST_MISTAKES = 100
"""After so many mistakes the rest of a file is not checked: its author has enough to do, and each takes a search."""
_MOST_STEPS = 100_000
"""The most steps of all cases of a file."""
_UNREADABLE = (yaml.YAMLError, ValueError, OverflowError, LookupError, AttributeError)
"""The exceptions of PyYAML for values that do not fit their tags."""
_GIVEN = ("dir", "tmp")
"""Variables that every scenario has."""


class Key(NamedTuple):
    """A key of a file: the kind of its value (see KINDS), and its help text."""

    kind: str
    help: str


SCENARIO_KEYS = {
    "name": Key("text", "The scenario's name; by default the name of the file."),
    "description": Key("text", "What it is for."),
    "tags": Key("texts", "Words that choose scenarios, with --tag."),
    "vars": Key("mapping", "Variables with their values, for ${name} in steps."),
    "cases": Key("cases", "One case a row: variables with their values, and name, tags and xfail of the case."),
    "world": Key("world", "The world that it begins with."),
    "timeout": Key("seconds", "Wall seconds that a case may take, instead of --timeout."),
    "sim_timeout": Key("seconds", "Simulated seconds that a case may take, instead of --sim-timeout."),
    "xfail": Key("reason", "The reason of a known failure: then the case must fail, and a pass is a failure."),
    "baseline": Key("baseline", "What --baseline compares."),
    "setup": Key("steps", "Steps that come first; if one fails, the case is an error."),
    "steps": Key("steps", "The steps of the test, in order; the first failure ends it."),
    "teardown": Key("steps", "Steps that run at the end, also after a failure."),
}
CASE_KEYS = {name: SCENARIO_KEYS[name] for name in ("name", "tags", "xfail")}
WORLD_KEYS = {
    "timestep": Key("seconds", "Seconds of a cycle (0.001)."),
    "gravity": Key("vector", "m/s² along x, y and z ([0, 0, -9.8])."),
    "ground": Key("flag", "Whether there is a floor at height 0 (true)."),
    "engine": Key("engine", "What runs the cycles: auto, plain or compiled; the results are the same."),
    "imports": Key("texts", "Modules, or files FILE.py, with controllers and hardware of your own."),
    "paused": Key("flag", "Whether the world is paused until a step resumes it (false)."),
}
BASELINE_KEYS = {
    "fields": Key("fields", "Topics or TOPIC/FIELD[I], each with or without =TOL; all joint states by default."),
    "tol": Key("tolerance", "Tolerance of fields without one of their own (0)."),
}
STEP_KEYS = {
    "at": Key("time", "Simulated time at which the step begins, s; alone it only waits for that time."),
    "within": Key("seconds", "Simulated seconds that the step may take."),
    "background": Key("flag", "Continue with the next step meanwhile; the step ends with the case."),
    "fails": Key("failure", "The command must fail: true, or a text that its message holds."),
}


@dataclass(frozen=True)
class ScenarioStep:
    """A command line with its conditions. Without words the step only waits for the time `at`."""

    words: tuple[str, ...]
    line: int
    section: str
    at: float | None = None
    within: float | None = None
    background: bool = False
    fails: bool | str = False
    starts_programs: bool = False
    """True when it starts other programs, which run by wall time."""

    @property
    def text(self) -> str:
        """The step as a typed command line."""
        return shlex.join(self.words) if self.words else f"at: {self.at:g}"


class BaselineFields(NamedTuple):
    """The content of a baseline: fields with tolerances; if there are none, all joint states with `tol`."""

    fields: Mapping[str, float] = {}
    tol: float = 0.0


@dataclass(frozen=True)
class Case:
    """One run: a scenario with one row of its table of cases."""

    file: str
    name: str
    """The name of the case; empty if the scenario has no table."""
    scenario: str
    tags: tuple[str, ...] = ()
    world: Mapping[str, Any] = field(default_factory=dict)
    timeout: float | None = None
    sim_timeout: float | None = None
    xfail: str = ""
    baseline: BaselineFields = field(default_factory=BaselineFields)
    steps: tuple[ScenarioStep, ...] = ()

    @property
    def id(self) -> str:
        """The name that selects it on the command line."""
        return f"{self.file}::{self.name}" if self.name else self.file


def find(words: Sequence[str]) -> list[tuple[str, str]]:
    """Find files for FILE, FOLDER and FILE::CASE. Returns each with the case name (empty: all). Raises BadFile."""
    found: list[tuple[str, str]] = []
    for word in words:
        path, case = _file_and_case(word)
        if os.path.isdir(path):
            if case:
                raise BadFile(f"is a folder, and ::{case} is a case of a file", path)
            files = (file for suffix in SUFFIXES for file in Path(path).rglob(f"*{suffix}"))
            inside = sorted(str(file) for file in files if file.is_file())
            if not inside:
                raise BadFile("holds no scenario", path, hint=f"scenarios are files that end with {SUFFIXES[0]}")
            found += [(file, "") for file in inside]
        else:
            found.append((path, case))
    return list(dict.fromkeys(found))


def _file_and_case(word: str) -> tuple[str, str]:
    """The file and the case of FILE::CASE. The name of a file may contain `::` too."""
    parts = word.split("::")
    ends = (end for end in range(len(parts), 0, -1) if os.path.exists("::".join(parts[:end])))
    end = next(ends, 1)
    return "::".join(parts[:end]), "::".join(parts[end:])


def read(file: str, commands: Commands, mistakes: list[BadFile]) -> list[Case]:
    """Read the cases of a file; its mistakes are added to `mistakes`."""
    reader = _Reader(file, commands, mistakes)
    try:
        text = read_file(Path(file), pipes=True)
        _check_size(text, file)
        documents = yaml_tree.documents(text, file, yaml.SafeLoader)
    except BadFile as error:
        mistakes.append(error)
        return []
    if len(documents) != 1:
        line = documents[1].start_mark.line + 1 if documents else None
        what = "a second document: a file has one scenario" if documents else "is empty"
        mistakes.append(BadFile(what, file, line))
        return []
    return reader.cases(documents[0])


def _check_size(text: bytes, file: str) -> None:
    """Raise BadFile for a file with too many values, before all of them are read, which takes a minute for a MiB.

    libyaml reads one after the other quickly. Other mistakes are left to the reader, which is exact.
    """
    counts: list[int] = []
    """How many values the open lists and mappings have so far."""
    nodes = 0
    try:
        for event in yaml.parse(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
            if isinstance(event, yaml.CollectionEndEvent):
                counts.pop()
            if not isinstance(event, yaml.NodeEvent):
                continue
            nodes += 1
            what = "values" if nodes > _MOST_VALUES else ""
            if counts:
                counts[-1] += 1
                what = "items in a list" if counts[-1] > _MOST_ITEMS else what
            if what:
                most = _MOST_VALUES if what == "values" else _MOST_ITEMS
                line = event.start_mark.line + 1 if event.start_mark is not None else None
                raise BadFile(f"more than {most} {what}, the maximum of a scenario", file, line)
            if isinstance(event, yaml.CollectionStartEvent):
                counts.append(0)
    except (yaml.YAMLError, ValueError, RecursionError):
        return


KeyPath = tuple[str | int, ...]


class _Reader:
    """Reads one file. Lines are stored by the path of a value."""

    def __init__(self, file: str, commands: Commands, mistakes: list[BadFile]) -> None:
        self._file = file
        self._commands = commands
        self._mistakes = mistakes
        self._lines: dict[KeyPath, int] = {}
        self._loader = yaml.SafeLoader("")
        self._pairs = yaml_tree.MergedPairs(file).of
        self._values = 0
        """The number of values read, counting what aliases repeat."""
        self._texts: set[str] = set()
        """The mistakes found."""
        self._mistakes_found = 0
        """The number of mistakes found, including repeated ones."""
        self._checked: dict[tuple[str, ...], SlidectlError | StepEffects] = {(): StepEffects()}

    def _add_mistake(self, path: KeyPath, message: str, hint: str | None = None) -> None:
        self._mistakes_found += 1
        while path and path not in self._lines:
            path = path[:-1]
        mistake = BadFile(message, self._file, self._lines.get(path), hint)
        if str(mistake) not in self._texts:  # every case of a table finds the same mistakes
            self._texts.add(str(mistake))
            self._mistakes.append(mistake)

    def _value(self, node: yaml.Node, path: KeyPath) -> Any:
        """The value of a node. Raises BadFile."""
        line = self._lines[path] = node.start_mark.line + 1
        self._values += 1
        if self._values > _MOST_VALUES or len(path) > yaml_tree.DEEPEST:
            raise BadFile("is too large, or nested too deeply", self._file, line)
        if isinstance(node, yaml.MappingNode):
            found: dict[str, Any] = {}
            for key, value in self._pairs(node):
                if not isinstance(key, yaml.ScalarNode):
                    raise BadFile("a list or mapping is not a name: names are text", self._file, line)
                name = str(key.value)
                if name in found:
                    self._add_mistake((*path, name), f"duplicate key {name!r}")
                found[name] = self._value(value, (*path, name))
                self._lines[(*path, name)] = key.start_mark.line + 1
            return found
        if isinstance(node, yaml.SequenceNode):
            return [self._value(item, (*path, index)) for index, item in enumerate(node.value)]
        try:
            value = self._loader.construct_object(node)
        except _UNREADABLE as error:
            problem = getattr(error, "problem", None) or error
            raise BadFile(f"{node.value!r} cannot be read: {problem}", self._file, line) from None
        return value if value is None or isinstance(value, bool | int | float | str) else node.value

    def cases(self, node: yaml.Node) -> list[Case]:
        try:
            tree = self._value(node, ())
        except BadFile as error:
            self._mistakes.append(error)
            return []
        if not isinstance(tree, dict):
            self._add_mistake((), "a scenario is a mapping: steps, vars, cases, ...")
            return []
        before = len(self._mistakes)
        self._check_keys(tree, SCENARIO_KEYS, (), "scenario")
        if not tree.get("steps"):
            self._add_mistake((), "a scenario has steps", "steps:\n  - spawn: slider")
        world = tree.get("world") or {}
        if isinstance(world, dict):
            world = {name: value for name, value in world.items() if value is not None or name not in WORLD_KEYS}
            self._check_keys(world, WORLD_KEYS, ("world",), "world")
        golden = tree.get("baseline") or {}
        if isinstance(golden, dict):
            self._check_keys(golden, BASELINE_KEYS, ("baseline",), "baseline")
        if len(self._mistakes) > before:
            return []
        name = str(tree.get("name") or Path(self._file).stem)
        tolerance = float(golden.get("tol") or 0.0)
        base = Case(
            self._file, "", name, tuple(tree.get("tags") or ()), world, tree.get("timeout"), tree.get("sim_timeout"),
            tree.get("xfail") or "", BaselineFields(tolerances_of(golden.get("fields") or (), tolerance), tolerance),
        )  # fmt: skip
        variables = dict(tree.get("vars") or {})
        self._check_names(variables, ("vars",))
        rows = list(self._rows(base, tree.get("cases"), variables))
        count = len(rows) * sum(len(tree.get(section) or ()) for section in SECTIONS)
        if count > _MOST_STEPS:
            text = f"{count} steps in {len(rows)} cases: a file may have {_MOST_STEPS} in all"
            self._add_mistake(("cases",), text, "make several files of it")
            return []
        return [replace(case, steps=tuple(self._steps(tree, row))) for case, row in rows]

    def _rows(self, base: Case, table: Any, variables: dict[str, Any]) -> Iterator[tuple[Case, dict[str, Any]]]:
        if table is None:
            yield base, variables
            return
        names: set[str] = set()
        if not table:
            self._add_mistake(("cases",), "'cases' is empty: nothing would run")
        for index, row in enumerate(table):
            path: KeyPath = ("cases", index)
            own = {key: value for key, value in row.items() if key in CASE_KEYS}
            given = {key: value for key, value in row.items() if key not in CASE_KEYS}
            before = len(self._mistakes)
            self._check_keys(own, CASE_KEYS, path, "case")
            self._check_names(given, path)
            if len(self._mistakes) > before:
                continue
            name = str(own.get("name") or "-".join(map(as_word, given.values())) or index + 1)
            if name in names:
                self._add_mistake(path, f"a second case {name!r}", "give the cases a name each")
            names.add(name)
            tags = (*base.tags, *(own.get("tags") or ()))
            yield replace(base, name=name, tags=tags, xfail=own.get("xfail") or base.xfail), {**variables, **given}

    def _check_names(self, variables: Mapping[str, Any], path: KeyPath) -> None:
        for name in variables:
            if not _NAME.match(name) or name in _GIVEN:
                self._add_mistake((*path, name), f"{name!r} is not a name for a variable: letters, digits and '_'")

    # --- keys and values ----------------------------------------------------------------------------------------

    def _check_keys(self, given: Mapping[str, Any], known: Mapping[str, Key], path: KeyPath, what: str) -> None:
        for name, value in given.items():
            if name not in known:
                meant = self._meant(name, known)
                self._add_mistake(
                    (*path, name), f"no field {name!r} in a {what}.{meant}", f"fields: {', '.join(known)}"
                )
                continue
            expected, fits, _ = KINDS[known[name].kind]
            if (value is not None or known[name].kind == "reason") and not fits(value):
                self._add_mistake((*path, name), f"{name!r} is {expected}, not {as_word(value).strip() or 'empty'}")

    # --- steps --------------------------------------------------------------------------------------------------

    def _steps(self, tree: Mapping[str, Any], variables: Mapping[str, Any]) -> Iterator[ScenarioStep]:
        reached = 0.0
        earlier = _EarlierSteps(is_alone=not (tree.get("world") or {}).get("imports"))
        for section in SECTIONS:
            for index, content in enumerate(tree.get(section) or ()):
                if len(self._texts) >= _MOST_MISTAKES:
                    return
                path: KeyPath = (section, index)
                step = None
                try:
                    step = self._step(content, path, section, variables)
                    if step is not None:
                        earlier.judge(step, self._check_words(step.words))
                except SlidectlError as error:
                    self._add_mistake(path, error.message, error.hint)
                if step is None:
                    earlier.is_whole = False
                    continue
                if step.at is not None:
                    if step.at < reached:
                        self._add_mistake(
                            (*path, "at"), f"{step.at:g} s is in the past: an earlier step is at {reached:g} s"
                        )
                    reached = step.at
                if _sets_clock(step.words):
                    reached = 0.0
                yield step

    def _step(self, content: Any, path: KeyPath, section: str, variables: Mapping[str, Any]) -> ScenarioStep | None:
        """Read a step; None for a wrong one. Raises SlidectlError."""
        if isinstance(content, str):  # a whole command line, as `- sim pause`
            first, _, rest = content.strip().partition(" ")
            content = {first: rest or None}
        content = self._filled(content, variables)
        own = {key: content[key] for key in content if key in STEP_KEYS}
        commands = [key for key in content if key not in STEP_KEYS]
        before = self._mistakes_found
        self._check_keys(own, STEP_KEYS, path, "step")
        for key in list(commands) if len(commands) > 1 else ():
            if not self._commands.has(key.partition(" ")[0]):
                text = f"no field {key!r} in a step.{self._meant(key, STEP_KEYS)}"
                self._add_mistake((*path, key), text, self._steps_and_fields())
                commands.remove(key)
        if self._mistakes_found > before:
            own = {}
            if not commands:
                return None
        if len(commands) != 1 and (commands or own.get("at") is None):
            what = f"is {' and '.join(map(repr, commands))}" if commands else "has no command"
            raise UsageError(f"this step {what}; a step is one command", self._steps_and_fields())
        line = self._lines.get(path, 1)
        words = self._words(commands[0], content[commands[0]], path) if commands else []
        within = own.get("within")
        if words and within is not None and self._has_within(words):
            words[len(commands[0].split()) : len(commands[0].split())] = ["--within", as_word(within)]
            own["within"] = None
        starts_programs = self._check_words((*words,)).starts_programs
        if self._mistakes_found > before:
            return None
        return ScenarioStep(
            tuple(words), line, section, own.get("at"), own.get("within"), own.get("background") or False,
            own.get("fails") or False, starts_programs,
        )  # fmt: skip

    def _meant(self, name: str, known: Iterable[str]) -> str:
        near = closest(name, known)
        return f" Did you mean {near!r}?" if near else ""

    def _steps_and_fields(self) -> str:
        return f"steps: {', '.join(self._commands.tops())}; fields: {', '.join(STEP_KEYS)}"

    def _has_within(self, words: Sequence[str]) -> bool:
        known = self._commands.known
        command = known.get(" ".join(words[:2])) or known.get(words[0])
        has_option = command is not None and any(option.name == "within" for option in command.options)
        return has_option and not any(word.partition("=")[0] == "--within" for word in words)

    def _words(self, name: str, value: Any, path: KeyPath) -> list[str]:
        """The words of a step's command. Raises SlidectlError."""
        begin = name.split()
        known = self._commands.known
        if not begin or not self._commands.has(begin[0]):
            meant = self._meant(begin[0] if begin else "", [*self._commands.tops(), *STEP_KEYS])
            raise UsageError(f"no step {name!r}.{meant}", self._steps_and_fields())
        if name in self._commands.kinds:
            return [name, json.dumps(value)]
        if value is None:
            return begin
        if isinstance(value, dict):
            if " ".join(begin) not in known:
                verbs = [command for command in known if command.split()[0] == begin[0]]
                raise UsageError(f"{name!r} with options is one of: {', '.join(verbs)}")
            return begin + words_of(
                known[" ".join(begin)], value, lambda mistake: self._add_mistake(path, mistake.message, mistake.hint)
            )
        if isinstance(value, list):
            return begin + [as_word(item) for item in value]
        return begin + (value.words if isinstance(value, _Filled) else [as_word(value)])

    def _check_words(self, words: tuple[str, ...]) -> StepEffects:
        """Check a command. Raises SlidectlError."""
        if words not in self._checked:
            try:
                self._checked[words] = self._commands.check([word.replace(TEMPORARY, "/tmp") for word in words])
            except SlidectlError as error:
                self._checked[words] = error
        known = self._checked[words]
        if isinstance(known, SlidectlError):
            raise known
        return known

    # --- variables ----------------------------------------------------------------------------------------------

    def _filled(self, content: Any, variables: Mapping[str, Any]) -> dict[str, Any]:
        """Replace the variables in a step. Raises UsageError."""
        if not isinstance(content, dict):
            raise UsageError("a step is one command", "a step: - pub: command 1.0")

        def fill(text: str) -> Any:
            return _fill(text, lambda name: self._variable(name, variables))

        def walk(value: Any) -> Any:
            if isinstance(value, str):
                return fill(value)
            if isinstance(value, dict):
                return {key: walk(inner) for key, inner in value.items()}
            return [walk(inner) for inner in value] if isinstance(value, list) else value

        filled: dict[str, Any] = {}
        for key, value in content.items():
            is_command = key not in STEP_KEYS and key not in self._commands.kinds
            if isinstance(value, str) and is_command:  # split first, so that a value stays one word
                filled[key] = _Filled([as_word(fill(word)) for word in split(value)])
            else:
                filled[key] = walk(value)
        return filled

    def _variable(self, name: str, variables: Mapping[str, Any]) -> Any:
        if name == "tmp":
            return TEMPORARY
        if name == "dir":
            return os.path.dirname(self._file) or "."
        if name not in variables:
            near = closest(name, [*variables, *_GIVEN])
            meant = f" Did you mean ${{{near}}}?" if near else ""
            known = ", ".join([*variables, *_GIVEN])
            raise UsageError(f"no variable {name!r}.{meant}", f"variables: {known}; $${{ stands for ${{ itself")
        return variables[name]


class _Filled(NamedTuple):
    """The words of a filled text."""

    words: list[str]


def _fill(text: str, value_of: Callable[[str], Any]) -> Any:
    """Replace the variables in a text. A text that is one variable becomes its value, with its type."""
    whole = _VARIABLE.fullmatch(text)
    if whole and not whole[1]:
        return value_of(whole[2])
    return _VARIABLE.sub(lambda match: match[0][1:] if match[1] else as_word(value_of(match[2])), text)


@dataclass
class _EarlierSteps:
    """The effects of the steps before a step, as far as their words show them."""

    is_alone: bool
    """True when all controllers come from slidectl and from these files."""
    is_whole: bool = True
    """True when no step with mistakes may have added controllers."""
    files: tuple[str, ...] = ()
    """The parameter files of spawns so far."""
    words: tuple[str, ...] = ()
    """The words of steps that may write files."""

    def judge(self, step: ScenarioStep, checked: StepEffects) -> None:
        """Check a step and add its effects. Raises SlidectlError if it can only fail."""
        is_there = TEMPORARY not in " ".join(step.words)
        files = (*self.files, checked.controllers) if checked.controllers else self.files
        self.is_alone &= not checked.may_add_controllers and (files == self.files or (is_there and not step.fails))
        is_whole, self.is_whole = self.is_whole, self.is_whole and files == self.files
        may_be_made = checked.model and (not is_there or any(checked.model in word for word in self.words))
        if checked.refusal is not None and not step.fails and not may_be_made:
            raise checked.refusal
        if self.is_alone and not step.fails and (files != self.files or (is_whole and checked.named)):
            _check_named(files, checked.named)
        self.files, self.is_whole = files, is_whole
        self.words += () if checked.model else step.words


def _sets_clock(words: tuple[str, ...]) -> bool:
    """True when a step may change the simulated time to any value."""
    is_call = any(word.endswith(("reset_simulation", "slidectl/load")) for word in words)
    return is_call or words[:2] == ("sim", "load") or (words[:2] == ("sim", "reset") and "--time" in words)


@cache
def _check_named(files: tuple[str, ...], names: tuple[str, ...]) -> None:
    from slidectl.check import controllers  # this imports all controllers

    controllers.check_named(files, names)


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= sys.float_info.max  # an int may be larger than any float


def _all(value: Any, fits: Callable[[Any], bool]) -> bool:
    return isinstance(value, list) and all(map(fits, value))


def _is_field(value: Any) -> bool:
    """True for a field with or without a tolerance."""
    with suppress(UsageError):
        return isinstance(value, str) and bool(tolerances_of([value], 0.0))
    return False


KINDS: dict[str, tuple[str, Callable[[Any], bool], dict[str, Any]]] = {
    "text": ("a text", lambda v: isinstance(v, str), {"type": "string"}),
    "reason": (
        "a text that says why", lambda v: isinstance(v, str) and bool(v.strip()), {"type": "string", "pattern": "\\S"},
    ),
    "texts": (
        "a list of texts", lambda v: _all(v, lambda one: isinstance(one, str)),
        {"type": "array", "items": {"type": "string"}},
    ),
    "flag": ("true or false", lambda v: isinstance(v, bool), {"type": "boolean"}),
    "seconds": (
        "a number of seconds above 0", lambda v: _is_number(v) and v > 0, {"type": "number", "exclusiveMinimum": 0},
    ),
    "time": ("a time of 0 s or more", lambda v: _is_number(v) and v >= 0, {"type": ["number", "string"], "minimum": 0}),
    "vector": (
        "three numbers", lambda v: _all(v, _is_number) and len(v) == 3,
        {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    ),
    "engine": (
        "auto, plain or compiled", lambda v: v in ("auto", "plain", "compiled"),
        {"enum": ["auto", "plain", "compiled"]},
    ),
    "failure": (
        "true, or a text that the message holds", lambda v: isinstance(v, bool | str), {"type": ["boolean", "string"]},
    ),
    "fields": (
        "a list of TOPIC/FIELD or TOPIC/FIELD=TOL", lambda v: _all(v, _is_field),
        {"type": "array", "items": {"type": "string"}},
    ),
    "tolerance": (
        "a number of 0 or more", lambda v: not isinstance(v, bool) and _is_field(f"={as_word(v)}"),
        {"type": ["number", "string"], "minimum": 0},
    ),
    "baseline": ("a mapping", lambda v: isinstance(v, dict), {"$ref": "#/$defs/baseline"}),
    "mapping": ("a mapping of names to values", lambda v: isinstance(v, dict), {"type": "object"}),
    "cases": (
        "a list of mappings", lambda v: _all(v, lambda one: isinstance(one, dict)),
        {"type": "array", "items": {"type": "object"}},
    ),
    "world": ("a mapping", lambda v: isinstance(v, dict), {"$ref": "#/$defs/world"}),
    "steps": ("a list of steps", lambda v: isinstance(v, list), {"type": "array", "items": {"$ref": "#/$defs/step"}}),
}  # fmt: skip
"""For each kind of value: its description, a test, and its JSON schema."""


# --- the JSON schema --------------------------------------------------------------------------------------------------

_VALUE = {"type": ["string", "number", "boolean"]}
_TYPES: dict[str, dict[str, Any]] = {
    "flag": {"type": "boolean"},
    "integer": {"type": ["integer", "string"]},
    "number": {"type": ["number", "string"]},
    "text": _VALUE,
}


def schema_text(commands: Commands) -> str:
    """The JSON schema (draft 2020-12) of scenario files as text, for completion and checks in editors."""
    table = _object(SCENARIO_KEYS, required=["steps"])
    table["properties"]["cases"]["items"]["properties"] = _properties(CASE_KEYS)
    tops = {command.split()[0] for command in commands.known}
    any_value = _VALUE | {"type": [*_VALUE["type"], "null", "array", "object"]}
    steps: dict[str, Any] = {
        **_properties(STEP_KEYS),
        **dict.fromkeys(sorted(tops), any_value),
        **{name: _command(command) for name, command in commands.known.items()},
        **{name: {"description": kind.help, **kind.schema} for name, kind in commands.kinds.items()},
    }
    step = {"type": "object", "properties": steps, "additionalProperties": False, "minProperties": 1}
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scenario of slidectl test",
        **table,
        "$defs": {
            "world": _object(WORLD_KEYS),
            "baseline": _object(BASELINE_KEYS),
            "step": {"anyOf": [{"type": "string", "description": "A whole command line."}, step]},
        },
    }
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _object(keys: Mapping[str, Key], **more: Any) -> dict[str, Any]:
    return {"type": "object", "properties": _properties(keys), "additionalProperties": False, **more}


def _properties(keys: Mapping[str, Key]) -> dict[str, Any]:
    found = {}
    for name, key in keys.items():
        shape = deepcopy(KINDS[key.kind][2])
        if keys is STEP_KEYS and shape.get("type") in ("number", "boolean"):  # it may be a variable
            shape["type"] = [shape["type"], "string"]
        found[name] = {"description": key.help, **shape}
    return found


def _command(command: StepCommand) -> dict[str, Any]:
    inside: dict[str, Any] = {}
    for argument in command.arguments:
        inside[argument.name] = {"type": ["string", "number", "boolean", "array", "object", "null"]}
    for option in command.options:
        inside[option.name] = {"description": option.help, **_option(option)}
    required = [argument.name for argument in command.arguments if argument.required]
    return {
        "description": command.help,
        "anyOf": [
            {"type": ["string", "number", "boolean", "null", "array"]},
            {
                "type": "object", "properties": inside, "additionalProperties": False,
                **({"required": required} if required else {}),
            },
        ],
    }  # fmt: skip


def _option(option: StepOption) -> dict[str, Any]:
    one = {"enum": list(option.choices)} if option.choices else dict(_TYPES[option.kind])
    return {"anyOf": [one, {"type": "array", "items": one}]} if option.takes_several else one
