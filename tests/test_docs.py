"""The documents name every command, every exit code and every setting, and say nothing that is not there."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from slidectl import errors, msgs
from slidectl.cli.main import COMMANDS

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EXIT_CODES = sorted({value for name, value in vars(errors).items() if name.startswith("EXIT_")})


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("script", ["command_reference.py", "controller_reference.py"])
def test_a_reference_is_what_the_program_says(script: str) -> None:
    done = subprocess.run([sys.executable, f"scripts/{script}", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_readme_names_every_command(name: str) -> None:
    assert re.search(rf"`(slidectl )?{name}\b", read("README.md")) or re.search(
        rf"slidectl {name}\b", read("README.md")
    )


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


def test_the_reference_script_is_a_plain_module() -> None:
    module = runpy.run_path(str(ROOT / "scripts" / "command_reference.py"))
    names = {name for name, _ in module["commands"]()}
    assert {f"slidectl {name}" for name in COMMANDS} <= names


def test_every_service_type_of_slidectl_is_its_own_data() -> None:
    assert {"slidectl/Status", "slidectl/Step", "slidectl/Wait"} <= set(msgs.service_names())


def test_the_man_page_shows_every_command_and_no_line_of_it_is_taken_for_a_request() -> None:
    text = read("docs/man/slidectl.1")
    for name in COMMANDS:
        assert f".SS slidectl {name}\n" in text
    requests = set(re.findall(r"^[.'](\w+)", text, re.MULTILINE))
    assert requests == {"TH", "SH", "SS", "B", "BR", "TP", "I", "nf", "fi"}
