"""Launch files written for a test, and the plans that they come to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slidectl.description.packages import Packages
from slidectl.extensions.launch import files
from slidectl.extensions.launch.loader import load
from slidectl.extensions.launch.plan import LaunchPlan, Node


class Workspace:
    """A folder that holds a package `demo`. `name` tells it from others."""

    def __init__(self, folder: Path, name: str = "demo") -> None:
        self.folder = folder
        self.package = folder / name
        self.write("package.xml", f"<package><name>{name}</name></package>")
        self.packages = Packages(start=folder)

    def write(self, name: str, text: str) -> Path:
        """A file in the package."""
        path = self.package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    def launch_file(self, content: str, name: str = "test.launch") -> Path:
        """A launch file with this inside <launch>; the content begins on line 1."""
        return self.write(f"launch/{name}", f"<launch>{content}</launch>")

    def plan(self, content: str, **arguments: str) -> LaunchPlan:
        """The plan of that file."""
        return self.load(self.launch_file(content), **arguments)

    def load(self, path: Path, run_commands: bool = True, **arguments: str) -> LaunchPlan:
        """The plan of a file."""
        return load(files.find([str(path)], self.packages), arguments, self.packages, run_commands=run_commands)

    def values(self, content: str, **arguments: str) -> dict[str, Any]:
        """The parameters of a text, by name."""
        return {name: value for name, (value, _) in self.plan(content, **arguments).parameters().items()}

    def value(self, attribute: str, **arguments: str) -> Any:
        """What the text of a parameter's value comes to, with these args declared."""
        declared = "".join(f'<arg name="{name}"/>' for name in arguments)
        escaped = attribute.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
        return self.values(f'{declared}<param name="x" value="{escaped}"/>', **arguments)["/x"]

    def node(self, content: str, **arguments: str) -> Node:
        """The only node of a text."""
        [node] = self.plan(content, **arguments).nodes
        return node


def notices(plan: LaunchPlan) -> list[str]:
    """What the plan says about its files."""
    return [str(notice) for notice in plan.notices]
