"""The command that messages give for an extra that is not installed: it adds it to the installation that says so."""

from __future__ import annotations

import json
import re
import shlex
from importlib import metadata
from pathlib import Path

import pytest

from slidectl.paths import install_command

ROOT = Path(__file__).parent.parent


def installed(monkeypatch: pytest.MonkeyPatch, direct_url: object) -> None:
    """As if pip had left this file; None: none."""

    class Distribution:
        def read_text(self, _: str) -> str | None:
            return direct_url if direct_url is None or isinstance(direct_url, str) else json.dumps(direct_url)

    monkeypatch.setattr(metadata, "distribution", lambda _: Distribution())


@pytest.mark.parametrize(("editable", "words"), [(True, ["pip", "install", "-e"]), (False, ["pip", "install"])])
def test_it_names_the_clone_that_slidectl_was_installed_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, editable: bool, words: list[str]
) -> None:
    clone = tmp_path / "a clone [1]"
    clone.mkdir()
    (clone / "pyproject.toml").touch()
    installed(monkeypatch, {"url": clone.as_uri(), "dir_info": {"editable": editable}})
    assert shlex.split(install_command("view")) == [*words, f"{clone}[view]"]


@pytest.mark.parametrize(
    "direct_url",
    [None, "not JSON", "[]", {"url": "file:///no/such/clone", "dir_info": {}}, {"url": "https://x/y.whl"}, {"url": 3}],
)
def test_it_says_so_where_the_clone_is_not_known(monkeypatch: pytest.MonkeyPatch, direct_url: object) -> None:
    installed(monkeypatch, direct_url)
    assert install_command("view") == "pip install '.[view]' in a clone of slidectl"


def test_no_page_and_no_message_names_a_package_of_an_index() -> None:
    """slidectl is on none: another project might have its name there."""
    places = [*(ROOT / "docs").glob("*.md"), ROOT / "README.md", *(ROOT / "slidectl").rglob("*.py")]
    found = [
        str(path.relative_to(ROOT))
        for path in places
        if re.search(r"""(?<!un)install ['\"]?slidectl\b""", path.read_text("utf-8"))
    ]
    assert found == []
