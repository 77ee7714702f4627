"""What users and clients name is read through one module: regular files within a bound, and nothing is waited for."""

from __future__ import annotations

import ast
import io
import os
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from slidectl import input_files
from slidectl.errors import BadFile, NotThere

PACKAGE = Path(__file__).parent.parent / "slidectl"


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


def _endless(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


HOSTILE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a pipe without a writer": (_pipe, "is a pipe, and only regular files are read, of at most 16 MiB"),
    "an endless device": (lambda path: path.symlink_to("/dev/zero"), "is a device, and only regular files"),
    "a folder": (Path.mkdir, "is a folder, and only regular files"),
    "a socket": (_socket, "is a socket, and only regular files"),
    "too large": (_endless, "is larger than 16 MiB"),
    "missing": (lambda _: None, "no such file or directory"),
    "a link to itself": (lambda path: path.symlink_to(path), "too many levels of symbolic links"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_what_is_no_regular_file_within_the_bound_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    make, said = HOSTILE[kind]
    monkeypatch.chdir(tmp_path)
    path = Path("x")  # short enough for a socket
    make(path)
    before = os.listdir("/proc/self/fd")
    for read in (input_files.read_bytes, input_files.read_text):
        with pytest.raises(BadFile) as caught:
            read(path, input_files.MOST_TEXT)
        assert str(caught.value).startswith(f"x: {said}")
        assert (caught.value.exit_code, isinstance(caught.value, NotThere)) == (2, kind == "missing")
    assert os.listdir("/proc/self/fd") == before


def test_a_link_to_a_regular_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a robot")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert input_files.read_text(tmp_path / "link") == "a robot"


def test_a_link_is_refused_where_the_links_of_a_path_were_resolved_before(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"a mesh")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert input_files.read_bytes(tmp_path / "file", links=False) == b"a mesh"
    with pytest.raises(BadFile, match="link: is a link, and only regular files are read"):
        input_files.read_bytes(tmp_path / "link", links=False)


def test_a_file_that_tells_no_size_is_counted_while_it_is_read() -> None:
    assert os.stat("/proc/self/maps").st_size == 0
    assert b"python" in input_files.read_bytes("/proc/self/maps")
    with pytest.raises(BadFile, match="/proc/self/maps: is larger than 100 bytes, the most that is read"):
        input_files.read_bytes("/proc/self/maps", 100)


def test_a_file_that_grows_while_it_is_read_is_refused_at_the_bound(tmp_path: Path) -> None:
    path = tmp_path / "growing"
    path.write_bytes(b"a\n")
    with input_files.opened(path, 2**20) as file, input_files.opened_text(path, 2**20) as text:
        os.truncate(path, 2**40)
        with pytest.raises(BadFile, match="is larger than 1 MiB"):
            file.read()
        assert text.readline() == "a\n"
        with pytest.raises(BadFile, match="is larger than 1 MiB"):
            text.readline()


def test_a_file_of_just_the_bound_is_read(tmp_path: Path) -> None:
    path = tmp_path / "full"
    path.write_bytes(b"x" * 2**20)
    assert len(input_files.read_bytes(path, 2**20)) == 2**20
    with pytest.raises(BadFile, match="is larger than 1048575 bytes"):
        input_files.read_bytes(path, 2**20 - 1)


def test_the_output_of_a_command_is_read_where_a_command_names_a_file() -> None:
    reading, writing = os.pipe()
    writer = threading.Thread(target=lambda: (os.write(writing, b"a robot"), os.close(writing)))
    writer.start()
    try:
        assert input_files.read_bytes(f"/dev/fd/{reading}", 100, pipes=True) == b"a robot"
    finally:
        writer.join()
        os.close(reading)


def test_the_output_of_a_command_has_the_same_bound_and_is_nothing_for_the_daemon() -> None:
    reading, writing = os.pipe()
    os.write(writing, b"x" * 1000)
    try:
        with pytest.raises(BadFile, match="is larger than 100 bytes"):
            input_files.read_bytes(f"/dev/fd/{reading}", 100, pipes=True)
        with pytest.raises(BadFile, match="is a pipe, and only regular files are read"):
            input_files.read_bytes(f"/proc/self/fd/{reading}")
    finally:
        os.close(reading)
        os.close(writing)


def test_a_named_pipe_is_refused_with_the_other_way_though_a_command_may_read_pipes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadFile, match=r"is a pipe, and only regular files are read(.|\n)*write <\(COMMAND\)"):
        input_files.read_bytes(tmp_path / "pipe", pipes=True)


def test_standard_input_has_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"x" * 101)))
    with pytest.raises(BadFile, match="<stdin>: is larger than 100 bytes"):
        input_files.read_stdin(100)


# --- nobody reads a file in another way -------------------------------------------------------------------------------

ELSEWHERE = {
    "input_files.py": "the one way",
    "cli/__init__.py": "/dev/null in the place of closed standard streams",
    "cli/daemon.py": "the log of the instance, which slidectl wrote",
    "cli/detached.py": "the log of a process that slidectl started: written, and read with a lock",
    "confined.py": "/dev/null, and a pipe to the parent process",
    "daemon/lifecycle.py": "a pipe to the new daemon",
    "entry_points.py": "the metadata of installed packages",
    "extensions/gateways/process.py": "the lock of a gateway, which slidectl wrote, and a pipe to it",
    "operating_system.py": "/proc, and files in memory, which are written",
    "msgs/definitions.py": "the package's own definitions of messages",
    "physics/rendering.py": "a file in memory for another process",
    "paths.py": "what pip wrote about the installation",
    "processes.py": "locks and logs of the instance, which slidectl wrote",
    "extensions/scenarios/pytest_plugin.py": "the log of the instance, which slidectl wrote",
    "extensions/scenarios/scenario_items.py": "a log that is written, and /dev/null",
    "extensions/scenarios/commands/test_run.py": "files in a temporary folder, which slidectl and pytest wrote",
    "simulation/compiled/object_file.py": "the package's own code, and the cache of machine code, which slidectl wrote",
    "extensions/viewing/world_monitor.py": "the log of the instance, which slidectl wrote",
    "extensions/viewing/page/page_files.py": "the page's own scripts, which are a part of slidectl",
    "web_access.py": "/proc",
    "writing.py": "drafts, which are written",
}
"""The files that read in another way, and what: nothing that a user or a client can name."""
_READING = {"read_text", "read_bytes", "fromfile", "loadtxt", "genfromtxt", "memmap", "FileInput", "fdopen"}
_OF_MODULES = {
    ("os", "open"),
    ("io", "open"),
    ("io", "FileIO"),
    ("np", "load"),
    ("numpy", "load"),
    ("runpy", "run_path"),
}


def _opens(call: ast.Call) -> bool:
    """True for a call that opens a file, and not for writing alone."""
    function = call.func
    if isinstance(function, ast.Name):
        return function.id == "open" and _reads(call.args[1:2], call)
    if not isinstance(function, ast.Attribute):
        return False
    owner = function.value.id if isinstance(function.value, ast.Name) else ""
    if owner == "input_files":
        return False
    if (owner, function.attr) == ("os", "open"):
        return "O_WRONLY" not in ast.unparse(call)
    if (owner, function.attr) in _OF_MODULES or function.attr in _READING:
        return True
    # Path.open: with a mode, or with the keywords of a text. Sockets, recordings and gateways are opened without.
    words = {keyword.arg for keyword in call.keywords}
    has_mode = bool(call.args) and isinstance(call.args[0], ast.Constant) and str(call.args[0].value)[:1] in "rwax"
    return function.attr == "open" and (has_mode or bool(words & {"encoding", "newline"})) and _reads(call.args, call)


def _reads(modes: list[ast.expr], call: ast.Call) -> bool:
    given = [*modes, *(keyword.value for keyword in call.keywords if keyword.arg == "mode")]
    mode = next((str(one.value) for one in given if isinstance(one, ast.Constant)), "r")
    return "r" in mode or "+" in mode


def test_files_are_opened_for_reading_by_one_module() -> None:
    found = {
        str(path.relative_to(PACKAGE))
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and _opens(node)
    }
    assert found - ELSEWHERE.keys() == set(), "read it by slidectl.input_files, or say here what it reads"
    assert ELSEWHERE.keys() - found == set(), "these read nothing in another way any more"


@pytest.mark.parametrize(
    "source",
    [
        "open(path)",
        "open(path, 'rb+')",
        "Path(path).read_bytes()",
        "path.open('rb')",
        "path.open(encoding='utf-8')",
        "os.open(path, os.O_RDONLY)",
        "np.load(path)",
    ],
)
def test_another_way_to_read_would_be_found(source: str) -> None:
    assert _opens(ast.parse(source).body[0].value)  # type: ignore[attr-defined]
