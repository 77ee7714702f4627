"""The parameters that a launch sets: gathered into one tree with the places of all values, and its robots read.

Runs none of the user's programs. Judging the controllers among them is for controllers.py.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from slidectl import description, names
from slidectl.check import kinds, model
from slidectl.check.findings import Findings
from slidectl.check.launch_tags import LaunchTags
from slidectl.check.model import Model
from slidectl.description.models import read_file
from slidectl.description.packages import Packages
from slidectl.errors import BadFile, NotThere
from slidectl.launch.files import shown
from slidectl.launch.plan import Plan, Setting, leaves

F = TypeVar("F", bound=BadFile)
Places = dict[str, tuple[str, int | None]]


class LaunchParameters:
    """All parameters of a plan. `values` goes by full names; a later setting replaces an earlier one."""

    def __init__(
        self,
        plan: Plan,
        tags: LaunchTags,
        packages: Packages,
        findings: Findings,
        ask_others: bool = False,
        strict: bool = False,
    ) -> None:
        self.plan = plan
        self.tags = tags
        self.packages = packages
        self.findings = findings
        self.values: dict[str, Any] = {}
        self.places: Places = {}
        self.robots: dict[str, Model | None] = {}
        """The parameters that hold a robot; None where it cannot be used."""
        self.is_complete = True
        """False when a value is not known: it cannot be had, or a program would have to be run for it."""
        for setting in plan.settings:
            self._take(setting)
        if self.is_complete:
            self._tell_conflicts()
        self._read_robots(ask_others, strict)

    @property
    def tree(self) -> dict[str, Any]:
        """The known ones, nested; without the robots' texts."""
        tree: dict[str, Any] = {}
        for full, value in self.values.items():
            if value is None or full in self.robots:
                continue
            *above, last = full.strip("/").split("/")
            branch: Any = tree
            for part in above:
                branch = branch.setdefault(part, {}) if isinstance(branch, dict) else {}
            if isinstance(branch, dict):
                branch[last] = value
        return tree

    def _take(self, setting: Setting) -> None:
        place = (setting.place.file, setting.place.line)
        if setting.runs_command:
            self._miss(setting)
            self.findings.add("used", setting.name, "note: a check does not run the command", *place)
            return
        try:
            value = setting.value()
            found = dict(leaves(setting.name, value, setting.place))
        except NotThere as error:
            self._miss(setting)
            self.findings.missing.note(_placed(error, setting), setting.loss)
            return
        except BadFile as error:
            self._miss(setting)
            self.findings.fail(f"parameter {setting.name}", _placed(error, setting))
            return
        for name in found:
            self.values.pop(name, None)
        self.values.update(found)
        self.places[setting.name] = place
        self.places.update(self._inner_places(setting))

    def _miss(self, setting: Setting) -> None:
        self.is_complete = False
        self.values[setting.name] = None

    def _inner_places(self, setting: Setting) -> Places:
        """The lines of a YAML tree."""
        from slidectl.description import yaml_tree

        if setting.origin not in ("file", "yaml"):
            return {}
        file = shown(setting.source) if setting.source else setting.place.file
        text = read_file(Path(setting.source)) if setting.source else self.tags.text_at(setting.place)
        try:
            lines = yaml_tree.places(text, file)
        except BadFile:  # only `subst_value` makes it YAML
            return {}
        return {names.join(setting.name, path.strip("/")): (file, line) for path, line in lines.items()}

    def _tell_conflicts(self) -> None:
        try:
            self.plan.parameters(gather=True)
        except BadFile as error:
            self.findings.fail("parameters", error)

    def _read_robots(self, ask_others: bool, strict: bool) -> None:
        for name, value in self.values.items():
            if isinstance(value, str) and _is_robot(value):
                setting = next(setting for setting in reversed(self.plan.settings) if setting.name == name)
                file = shown(setting.source) if setting.source else f"parameter {name}"
                own = Findings()
                if self.findings.missing.keeps_going:
                    value = self._without_absences(value)
                self.robots[name] = model.check_text(value, file, own, ask_others, self.packages, strict)
                self.findings.extend(replace(notice, file=shown(notice.file)) for notice in own.sorted())
                self.findings.broken += own.broken

    def _without_absences(self, xml: str) -> str:
        """The robot as it is spawned when what is not there is left out."""
        try:
            return description.load(xml, {}, self.packages, missing=self.findings.missing).xml
        except BadFile:  # which is said when it is read
            return xml


def _is_robot(text: str) -> bool:
    try:
        return text.lstrip("\ufeff \t\r\n").startswith("<") and kinds.of_text(text.encode(), "") == "model"
    except BadFile:
        return False


def _placed(error: F, setting: Setting) -> F:
    """The error, at the tag if it names no line of its own."""
    if error.line is not None:
        return error
    return type(error)(error.message, setting.place.file, setting.place.line, error.hint)
