"""The documents name every command, every exit code and every setting, and say nothing that is not there."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from slidectl import errors, msgs
from slidectl.cli.command_table import COMMANDS

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MAN_PAGES = sorted((ROOT / "docs" / "man").iterdir())
EXIT_CODES = sorted({value for name, value in vars(errors).items() if name.startswith("EXIT_")})


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("script", ["command_reference.py", "controller_reference.py", "typed_messages.py"])
def test_a_reference_is_what_the_program_says(script: str) -> None:
    done = subprocess.run([sys.executable, f"scripts/{script}", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_readme_names_every_command(name: str) -> None:
    named = re.search(rf"`(slidectl )?{name}\b|slidectl {name}\b", read("README.md"))
    assert named, f"name `slidectl {name}` in the table of README.md's section Commands"


@pytest.mark.parametrize("code", EXIT_CODES)
@pytest.mark.parametrize("page", ["README.md", "docs/commands.md"])
def test_the_documents_explain_every_exit_code(page: str, code: int) -> None:
    assert re.search(rf"^\| `?{code}`? \|", read(page), re.MULTILINE)


def test_the_documents_name_no_exit_code_that_does_not_exist() -> None:
    for page in ("README.md", "docs/commands.md"):
        table = re.search(r"^\| exit code \|.*?\n\n", read(page), re.MULTILINE | re.DOTALL)
        assert table is not None
        assert [int(code) for code in re.findall(r"^\| `?(\d+)`? \|", table.group(), re.MULTILINE)] == EXIT_CODES


@pytest.mark.parametrize("variable", ["SLIDECTL_INSTANCE", "SLIDECTL_SOCKET", "SLIDECTL_NAMESPACE"])
def test_the_documents_name_every_environment_variable(variable: str) -> None:
    assert any(variable in page.read_text(encoding="utf-8") for page in PAGES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_the_documents_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "seeing.md"], ids=lambda page: page.name)
def test_no_cell_of_a_table_holds_three_sentences(page: Path) -> None:
    rows = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    cells = [cell.strip() for row in rows for cell in re.split(r"(?<!\\)\|", re.sub(r"`[^`]*`", "CODE", row))]
    assert [cell for cell in cells if len(re.split(r"[.!?] ", cell)) > 2] == []


NOT_ENGLISH = re.compile(r"\b(is|are) told\b|\bwho has (this|the) word\b|(?<!there )\b(is|are) no (text|number)\b")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_documents_and_the_help_use_the_words_of_the_field(page: Path) -> None:
    assert NOT_ENGLISH.search(page.read_text(encoding="utf-8")) is None


def test_the_reference_script_is_a_plain_module() -> None:
    module = runpy.run_path(str(ROOT / "scripts" / "command_reference.py"))
    names = {name for name, _ in module["commands"]()}
    assert {f"slidectl {name}" for name in COMMANDS} <= names


def test_every_service_type_of_slidectl_is_its_own_data() -> None:
    assert {"slidectl/Status", "slidectl/Step", "slidectl/Wait"} <= set(msgs.service_names())


def test_every_command_has_a_man_page_whose_lines_are_taken_for_no_other_request() -> None:
    overview = read("docs/man/slidectl.1")
    pages = {page.name for page in MAN_PAGES}
    assert pages == {"slidectl.1", *(f"slidectl-{name}.1" for name in COMMANDS)}
    for name in COMMANDS:
        assert f".BR slidectl\\-{name} (1)\n" in overview
    for page in MAN_PAGES:
        requests = set(re.findall(r"^[.'](\w+)", page.read_text(encoding="ascii"), re.MULTILINE))
        assert requests <= {"TH", "SH", "SS", "B", "BR", "TP", "PP", "I", "nf", "fi", "nh", "ad"}


@pytest.mark.foreign
@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_man_pages_are_read_without_a_warning() -> None:
    done = subprocess.run(
        ["groff", "-man", "-ww", "-Tutf8", "-z", *map(str, MAN_PAGES)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.foreign
@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_shows_the_options_of_a_command_as_they_are_typed() -> None:
    shown = subprocess.run(
        ["man", "-l", str(ROOT / "docs" / "man" / "slidectl-spawn.1")],
        env={**os.environ, "MANPAGER": "cat", "MANWIDTH": "100", "LC_ALL": "C.UTF-8"},
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    text = re.sub(".\b", "", shown)
    assert "--at X Y Z [R P Y]" in text
    assert "slidectl spawn slider --controllers config/slider_control.yaml" in text


def test_the_wheel_brings_the_man_pages() -> None:
    settings = tomllib.loads(read("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert settings["shared-data"] == {"docs/man": "share/man/man1"}
