"""Packages are found by name, by search path, and upwards from the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from slidectl.description import Packages, UnknownPackage

Write = Callable[[str, str], Path]


@pytest.fixture
def workspace(write: Write, tmp_path: Path) -> Path:
    write("src/group/alpha/package.xml", "<package format='2'>\n<name> alpha </name></package>")
    write("src/folder_of_beta/package.xml", "<package><name>beta</name></package>")
    write("src/ignored/CATKIN_IGNORE", "")
    write("src/ignored/gamma/package.xml", "<package><name>gamma</name></package>")
    write("src/.hidden/delta/package.xml", "<package><name>delta</name></package>")
    return tmp_path / "src"


def test_a_given_name_comes_first(workspace: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(workspace))
    assert Packages({"alpha": tmp_path}).find("alpha") == tmp_path


@pytest.mark.parametrize("variable", ["SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH"])
def test_the_search_path_is_crawled_for_packages(
    workspace: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    monkeypatch.setenv(variable, f"/no/such/folder:{workspace}")
    packages = Packages()
    assert packages.find("alpha") == workspace / "group" / "alpha"
    assert packages.find("beta") == workspace / "folder_of_beta"
    assert packages.names() == ["alpha", "beta"]


def test_our_own_search_path_goes_before_that_of_ros(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = write("ours/beta/package.xml", "").parent
    write("theirs/beta/package.xml", "")
    monkeypatch.setenv("SLIDECTL_PACKAGE_PATH", str(ours.parent))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(ours.parent.parent / "theirs"))
    assert Packages().find("beta") == ours


def test_upwards_from_the_file_its_own_package_and_its_neighbours_are_found(workspace: Path) -> None:
    packages = Packages(start=workspace / "folder_of_beta" / "urdf")
    assert packages.find("beta") == workspace / "folder_of_beta"
    assert packages.find("folder_of_beta") == workspace / "folder_of_beta"
    assert Packages(start=workspace / "group" / "alpha" / "urdf").find("alpha") == workspace / "group" / "alpha"


def test_a_folder_of_the_packages_name_above_the_file_will_do_without_a_package_file(tmp_path: Path) -> None:
    assert Packages(start=tmp_path / "my_slider" / "urdf").find("my_slider") == tmp_path / "my_slider"


def test_an_unknown_package_says_where_was_looked(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(workspace))
    with pytest.raises(UnknownPackage, match=r"no package 'alphha'. Did you mean 'alpha'\?") as caught:
        Packages({"other": "/x"}, start=workspace / "group").find("alphha")
    text = str(caught.value)
    assert f"ROS_PACKAGE_PATH={workspace}" in text
    assert "--package other" in text
    assert f"{workspace / 'group'} and the folders above it" in text


def test_a_circle_of_links_in_the_search_path_does_no_harm(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (workspace / "group" / "again").symlink_to(workspace)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(workspace))
    assert Packages().find("beta").name == "folder_of_beta"


def test_packages_from_before_catkin_are_found_by_their_manifest(
    workspace: Path, write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    write("src/stack/old_arm/manifest.xml", "<package/>")
    write("src/stack/old_arm/rospack_nosubdirs", "")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(workspace))
    assert Packages().find("old_arm") == workspace / "stack" / "old_arm"
