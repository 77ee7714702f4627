"""Installs packages into a folder as pip does, without a network: their modules and their metadata."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path

WORKSHOP = Path(__file__).parent.parent / "examples" / "packages" / "slidectl-workshop"


def install(project: Path, site: Path) -> None:
    """Installs a project: its packages, and what its pyproject.toml says of it."""
    table = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for package in project.iterdir():
        if (package / "__init__.py").exists():
            shutil.copytree(package, site / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    _write_metadata(site, table["name"], table["version"], table["description"], table["entry-points"])


def write_package(
    site: Path, name: str, points: Mapping[str, Mapping[str, str]], modules: Mapping[str, str], version: str = "1.0"
) -> None:
    """Installs a package with these entry points, by group and name, and modules, by name."""
    for module, text in modules.items():
        site.mkdir(parents=True, exist_ok=True)
        (site / f"{module}.py").write_text(text, encoding="utf-8")
    _write_metadata(site, name, version, "A package", points)


def _write_metadata(site: Path, name: str, version: str, summary: str, points: Mapping[str, Mapping[str, str]]) -> None:
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    text = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\nSummary: {summary}\n"
    (info / "METADATA").write_text(text, encoding="utf-8")
    groups = (
        f"[{group}]\n" + "".join(f"{point} = {value}\n" for point, value in each.items())
        for group, each in points.items()
    )
    (info / "entry_points.txt").write_text("\n".join(groups), encoding="utf-8")
