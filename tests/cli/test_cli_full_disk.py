"""Every command that writes a file, on a disk that is full: the file is whole, or nothing new is there."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine
from daemon_fixture import Runtime
from inherited_signals import inherited
from small_disk import PAGE, SmallDisk, small_disk

from slidectl.extensions.recording.recording_files import opened

STATES = "/slider/joint_states"
ROOM = 4 << 20
"""Bytes of the disk."""


class World(CommandLine):
    """The command line, with a daemon and a small disk that both see. `folder` is beside the disk, and has room."""

    def __init__(self, runtime: Path, folder: Path, disk: SmallDisk) -> None:
        super().__init__(runtime)
        self.folder = folder
        self.disk = disk

    def argv(self, *words: str) -> list[str]:
        """With @ for the folder that has room, and % for the disk."""
        given = [word.replace("@", f"{self.folder}").replace("%", f"{self.disk.folder}") for word in words]
        return [*self.disk.prefix, *super().argv(*given)]


_SCENARIO = f"""setup:
  - spawn slider --controllers {ROOT}/config/slider_control.yaml --start joint_state_controller
steps:
  - sim step 300
"""
_FAILING = _SCENARIO + "  - assert joint1 --equals 5\n"


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    runtime, folder = Runtime(), Path(tempfile.mkdtemp(prefix="slidectl-test-", dir="/tmp"))
    try:
        with small_disk(folder / "disk", ROOM) as disk:
            made = World(runtime.folder, folder, disk)
            made.ok("daemon", "start", "--paused", "--journal", "@/sound.journal")
            started = ("--start", "joint_state_controller", "joint1_position_controller")
            made.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", *started)
            recorder = made.start("record", "-a", "-O", "@/sound.bag", "--duration", "3")
            assert recorder.stderr is not None
            assert "recording" in recorder.stderr.readline()
            made.ok("sim", "step", "3100ms")
            recorder.communicate(timeout=60)
            content = (folder / "sound.bag").read_bytes()
            (folder / "cut.bag").write_bytes(content[: len(content) * 3 // 4])
            made.ok("bag", "filter", "@/sound.bag", "@/short.bag", "t < 1.0")
            (folder / "short.baseline").mkdir()
            shutil.copy(folder / "short.bag", folder / "slider.bag")
            shutil.copy(folder / "sound.journal", folder / "copy.journal")
            (folder / "scenario.yaml").write_text(_SCENARIO)
            (folder / "dump.launch").write_text(
                '<launch><rosparam command="dump" file="%/d.yaml" ns="/slider"/></launch>'.replace(
                    "%", str(disk.folder)
                )
            )
            (folder / "table.csv").write_text(f"time,topic\n0.1,{STATES}\n")
            yield made
            made("daemon", "stop")
    finally:
        runtime.remove()
        shutil.rmtree(folder, ignore_errors=True)


NEEDS_AV = pytest.mark.skipif(find_spec("av") is None, reason="PyAV is not installed")
NEEDS_PARQUET = pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is not installed")
FIELD = f"{STATES}/position[0]"
PLOT = ("plot", "@/sound.bag", FIELD)
WRITERS = [
    ("bag", "filter", "@/sound.bag", "%/f.bag"),
    ("bag", "filter", "@/sound.bag", "%/f.bag", "--force", "--compression", "bz2"),
    ("bag", "filter", "@/sound.bag", "%/f.mcap"),
    ("bag", "filter", "@/sound.bag", "%/f.mcap", "--force", "--compression", "zstd"),
    ("bag", "export", "@/sound.bag", "--topic", STATES, "--csv", "%/t.csv"),
    ("bag", "export", "@/sound.bag", "--topic", STATES, "--csv", "%/t.csv", "--force"),
    pytest.param(("bag", "export", "@/sound.bag", "--parquet", "%/t.parquet"), marks=NEEDS_PARQUET),
    ("bag", "diff", "@/short.bag", "%/baselines", "--update-baseline"),
    ("bag", "diff", "@/short.bag", "%/new/fields.csv", "--fields", FIELD, "--update-baseline"),
    ("render", "-o", "%/now.png", "--software", "--size", "200x150"),
    pytest.param(("video", "%/v.gif", "--software", "--size", "64x48", "--for", "0.3"), marks=NEEDS_AV),
    pytest.param(("video", "%/v.mp4", "--software", "--size", "64x48", "--for", "0.3"), marks=NEEDS_AV),
    *((*PLOT, "--save", f"%/p.{kind}") for kind in ("svg", "png", "pdf", "html", "csv")),
    ("controller", "plot", "joint1_position_controller", "--step", "0.1", "--for", "0.3", "--save", "%/step.svg"),
    ("graph", "--all", "-o", "%/g.svg"),
    ("graph", "-o", "%/g.dot"),
    ("graph", "-o", "%/g.md"),
    ("sim", "save", "one", "--to", "%/one.snapshot"),
    ("urdf", "rrbot", "-o", "%/m.urdf"),
    ("param", "dump", "%/p.yaml"),
    ("ros", "rosparam", "dump", "%/p.yaml"),
    ("ros", "rosrun", "xacro", "xacro", "-o", "%/x.urdf", "rrbot"),
    ("launch", "@/dump.launch"),
    ("test", "@/scenario.yaml", "--junitxml", "%/junit.xml"),
    ("test", "@/scenario.yaml", "--baseline", "%/golden", "--update-baseline"),
    ("replay", "@/copy.journal", "--record", "%/r.bag"),
    ("replay", "@/copy.journal", "--record", "%/r.mcap"),
]


@pytest.mark.parametrize("words", WRITERS, ids=lambda words: " ".join(words[:2]) + " " + words[-1])
def test_a_full_disk_leaves_the_whole_file_or_nothing_new(world: World, words: tuple[str, ...]) -> None:
    world.disk.clear()
    world.ok("sim", "resume" if "--step" in words else "pause")
    done = world(*words)
    assert done.returncode == 0, done.stderr
    sizes = world.disk.files()
    assert sum(size for size in sizes.values() if size > 0) > 0
    replaced = next((name for name in sizes if "--force" in words), "")
    for free in sorted({0, max(sizes.values()) // 2 // PAGE * PAGE}):
        world.disk.clear()
        if replaced:
            (world.disk.seen / replaced).write_text("old")
        world.disk.fill(free)
        before = world.disk.files()
        done = world(*words)
        assert done.returncode in (1, 2), done.stdout
        assert f"No space left on device: the disk at {world.disk.folder} is full" in done.stderr + done.stdout
        assert "Traceback" not in done.stderr
        if words[0] == "replay" and free:
            assert_recording_is_kept(world, done.stderr)
        else:
            assert world.disk.files() == before
    world.disk.clear()


def assert_recording_is_kept(world: World, told: str) -> None:
    """A recording is the exception: what came before is kept, and how much that is has been told."""
    [name] = world.disk.files()
    info = json.loads(world.ok("bag", "info", f"%/{name}", "--json"))
    assert info["messages"] > 0
    assert f"{info['messages']} can be read in it" in told
    assert f"slidectl bag reindex {world.disk.folder}/{name}" in told


def test_a_file_that_cannot_be_completed_on_a_full_disk_stays_as_it_was(world: World) -> None:
    world.disk.clear()
    shutil.copy(world.folder / "cut.bag", world.disk.seen / "cut.bag")
    world.disk.fill(2 * PAGE)
    before = world.disk.files()
    done = world("bag", "reindex", "%/cut.bag")
    assert (done.returncode, f"the disk at {world.disk.folder} is full" in done.stderr) == (1, True), done.stderr
    assert world.disk.files() == before
    (world.disk.seen / "filling").unlink()
    world.ok("bag", "reindex", "%/cut.bag")
    assert sorted(world.disk.files()) == ["cut.bag", "cut.orig.bag"]


def begun(world: World, *words: str) -> subprocess.Popen[str]:
    """A recorder that records."""
    recorder = world.start("record", *words)
    assert recorder.stderr is not None
    line = recorder.stderr.readline()
    assert line.startswith("recording"), line
    return recorder


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recording_keeps_what_came_before_the_disk_was_full(world: World, suffix: str) -> None:
    world.disk.clear()
    world.disk.fill(60 * 1024)
    recorder = begun(world, "-a", "-O", f"%/run{suffix}")
    with world.client() as client:
        client.step(seconds=3.0)  # all of it is one chunk or more
    stdout, stderr = recorder.communicate(timeout=60)
    assert (recorder.returncode, stdout) == (1, ""), stderr
    assert f"the disk at {world.disk.folder} is full; of " in stderr
    assert_recording_is_kept(world, stderr)
    with opened(world.disk.seen / f"run{suffix}") as recording:
        assert recording.damage == "it was cut off"
        kept = sum(len(record.raw) for record in recording.records())
    assert kept > 60 * 1024 / 2
    assert (world.disk.seen / f"run{suffix}").stat().st_size >= 56 * 1024


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
@pytest.mark.parametrize("free", [0, PAGE])
def test_a_recording_of_nothing_leaves_no_file_on_a_full_disk(world: World, suffix: str, free: int) -> None:
    world.disk.clear()
    world.disk.fill(free)
    recorder = world.start("record", STATES, "-O", f"%/run{suffix}")
    assert recorder.stderr is not None
    said = recorder.stderr.readline()
    if said.startswith("recording"):
        world.disk.fill(0)
        with world.client() as client:
            client.step(seconds=1.0)
    stderr = said + recorder.communicate(timeout=60)[1]
    assert (recorder.returncode, f"the disk at {world.disk.folder} is full" in stderr) == (1, True), stderr
    if "can be read in it" in stderr:  # a page has room for some messages
        assert_recording_is_kept(world, stderr)
    else:
        assert not world.disk.files()


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recording_that_cannot_begin_keeps_the_old_file(world: World, suffix: str) -> None:
    world.disk.clear()
    (world.disk.seen / f"old{suffix}").write_text("old")
    world.disk.fill(0)
    done = world("record", STATES, "-O", f"%/old{suffix}", "--force")
    assert (done.returncode, f"the disk at {world.disk.folder} is full" in done.stderr) == (1, True), done.stderr
    assert world.disk.files() == {f"old{suffix}": 3}


def test_a_process_id_that_cannot_be_written_leaves_no_file(world: World) -> None:
    world.disk.clear()
    world.disk.fill(0)
    (world.folder / "empty.launch").write_text("<launch/>")
    for words in (
        ("record", STATES, "-O", "@/pid.bag", "--pid", "%/pid"),
        ("launch", "@/empty.launch", "--pid", "%/pid"),
    ):
        done = world(*words)
        assert (done.returncode, f"the disk at {world.disk.folder} is full" in done.stderr) == (1, True), done.stderr
        assert not world.disk.files()


def test_a_journal_that_cannot_be_begun_leaves_no_file(world: World) -> None:
    world.disk.clear()
    world.disk.fill(0)
    done = world("-i", "other", "daemon", "start", "--journal", "%/new.journal")
    assert (done.returncode, f"the disk at {world.disk.folder} is full" in done.stderr) == (1, True), done.stderr
    assert not world.disk.files()


def test_a_journal_keeps_its_whole_entries_when_the_disk_is_full(world: World) -> None:
    world.disk.clear()
    world.disk.fill(2 * PAGE)
    world.ok("-i", "other", "daemon", "start", "--paused", "--journal", "%/run.journal")
    try:
        world.ok("-i", "other", "spawn", "slider")
        world.ok("-i", "other", "sim", "step", "60s")
        assert f"the disk at {world.disk.folder} is full" in world.ok("-i", "other", "daemon", "logs")
    finally:
        world.ok("-i", "other", "daemon", "stop")
    world.ok("replay", "%/run.journal")


def test_a_failed_case_says_when_its_recording_has_no_room(world: World) -> None:
    world.disk.clear()
    world.disk.fill(0)
    (world.folder / "failing.yaml").write_text(_FAILING)
    done = world("test", "@/failing.yaml", "--keep-failed", "%/kept")
    assert done.returncode == 2 if "cannot be written" in done.stderr else 1, done.stderr
    assert f"the disk at {world.disk.folder} is full" in done.stdout + done.stderr
    assert not [name for name, size in world.disk.files().items() if size >= 0]


def test_a_file_with_two_names_keeps_its_content_on_a_full_disk(world: World) -> None:
    """It cannot be replaced, as its other name would show the old content."""
    world.disk.clear()
    (world.disk.seen / "p.yaml").write_text("old")
    (world.disk.seen / "other").hardlink_to(world.disk.seen / "p.yaml")
    world.ok("param", "dump", "%/p.yaml")
    assert (world.disk.seen / "other").read_text() == (world.disk.seen / "p.yaml").read_text() != "old"
    (world.disk.seen / "p.yaml").write_text("old")
    world.disk.fill(0)
    (world.disk.seen / "p.yaml").write_text("")
    world.disk.fill(0)
    done = world("param", "dump", "%/p.yaml")
    assert (done.returncode, f"the disk at {world.disk.folder} is full" in done.stderr) == (2, True), done.stderr
    assert (world.disk.seen / "p.yaml").read_text() == ""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_in_the_middle_leaves_nothing(world: World, number: int) -> None:
    """The command gets the signal while its draft is on the disk; one that was done before it came says nothing."""
    keep = "sum(math.sin(k) for k in m.position * 3000) < 1e9"
    for _ in range(5):
        world.disk.clear()
        with inherited(number, signal.SIG_DFL):
            running = world.start("bag", "filter", "@/sound.bag", "%/f.bag", f"topic == '{STATES}' and {keep}")
        try:
            while running.poll() is None and not world.disk.files():
                pass
            running.send_signal(number)
            running.communicate(timeout=60)
        finally:
            running.kill()
        if running.returncode:
            break
    assert running.returncode in (-number, 128 + number, 130)
    assert not world.disk.files()


# --- targets that are no plain file of one's own ---------------------------------------------------------------------

COPY = ("bag", "filter", "@/short.bag")
TABLE = ("bag", "export", "@/short.bag", "--topic", STATES, "--force", "--csv")


@pytest.fixture
def place(world: World) -> Iterator[Path]:
    """A folder of this test alone, where there is room. `%` and `@` in words do not mean it."""
    folder = Path(tempfile.mkdtemp(dir=world.folder))
    yield folder
    folder.chmod(0o700)


def written(world: World, path: Path) -> bool:
    """True when the file holds the whole table or recording."""
    if path.suffix == ".csv":
        return path.read_text().endswith("\n") and len(path.read_text().splitlines()) > 10
    return "damage" not in world.ok("bag", "info", str(path))


@pytest.mark.parametrize(("words", "suffix"), [(COPY, ".bag"), (COPY, ".mcap"), (TABLE, ".csv")])
def test_what_a_link_points_to_is_written_and_the_link_stays(
    world: World, place: Path, words: tuple[str, ...], suffix: str
) -> None:
    (place / "there").mkdir()
    link, target = place / f"link{suffix}", place / "there" / f"file{suffix}"
    link.symlink_to(target)
    world.ok(*words, str(link))
    assert link.is_symlink()
    assert written(world, target)
    more = () if "--force" in words else ("--force",)
    target.write_text("old")
    target.chmod(0o640)
    world.ok(*words, str(link), *more)
    assert link.is_symlink()
    assert (written(world, target), target.stat().st_mode & 0o777) == (True, 0o640)
    assert len(list(place.rglob("*"))) == 3


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recording_follows_a_link_and_replaces_no_pipe_and_no_folder(world: World, place: Path, suffix: str) -> None:
    (place / f"link{suffix}").symlink_to(place / f"file{suffix}")
    recorder = begun(world, STATES, "-O", str(place / f"link{suffix}"))
    twice = world("record", STATES, "-O", str(place / f"link{suffix}"), "--force")
    assert (twice.returncode, f"link{suffix} is being recorded" in twice.stderr) == (1, True)
    over = world(*COPY, str(place / f"link{suffix}"), "--force")
    assert (over.returncode, f"link{suffix} is being recorded" in over.stderr) == (1, True)
    with world.client() as client:
        client.step(seconds=0.5)
    recorder.send_signal(signal.SIGTERM)
    recorder.communicate(timeout=60)
    assert (place / f"link{suffix}").is_symlink()
    assert written(world, place / f"file{suffix}")
    os.mkfifo(place / f"pipe{suffix}")
    (place / f"folder{suffix}").mkdir()
    before = sorted(place.iterdir())
    for name in ("pipe", "folder"):
        for words in (("record", STATES, "-O"), COPY):
            done = world(*words, str(place / f"{name}{suffix}"), "--force")
            assert (done.returncode, f"{name}{suffix} is not a regular file" in done.stderr) == (1, True), done.stderr
    assert sorted(place.iterdir()) == before


def test_a_pipe_gets_a_table_and_a_folder_is_refused(world: World, place: Path) -> None:
    os.mkfifo(place / "pipe.csv")
    export = world.start(*TABLE, str(place / "pipe.csv"))
    text = (place / "pipe.csv").read_text()
    export.communicate(timeout=60)
    assert (export.returncode, len(text.splitlines()) > 10) == (0, True)
    (place / "folder.csv").mkdir()
    done = world(*TABLE, str(place / "folder.csv"))
    assert (done.returncode, "Is a directory" in done.stderr) == (1, True)
    assert len(list(place.iterdir())) == 2


@pytest.mark.parametrize(("words", "suffix"), [(COPY, ".bag"), (TABLE, ".csv")])
def test_two_that_write_one_file_leave_one_of_both(
    world: World, place: Path, words: tuple[str, ...], suffix: str
) -> None:
    path = place / f"both{suffix}"
    more = () if "--force" in words else ("--force",)
    running = [world.start(*words, str(path), *more) for _ in range(3)]
    for one in running:
        one.communicate(timeout=60)
    assert [one.returncode for one in running] == [0, 0, 0]
    assert written(world, path)
    assert list(place.iterdir()) == [path]


def test_of_two_recorders_of_one_file_the_second_is_refused(world: World, place: Path) -> None:
    first = begun(world, STATES, "-O", str(place / "run.bag"))
    second = world("record", STATES, "-O", str(place / "run.bag"))
    assert (second.returncode, "run.bag already exists" in second.stderr) == (1, True)
    with world.client() as client:
        client.step(seconds=0.5)
    first.send_signal(signal.SIGINT)
    first.communicate(timeout=60)
    assert written(world, place / "run.bag")


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")
def test_another_user_changes_no_file_and_leaves_none_where_he_may_not(world: World) -> None:
    """A folder that is not his, and a file of another that everybody may write, in a folder that he may not change."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "mine.csv").write_text("old")
        (folder / "ours.csv").write_text("old")
        (folder / "ours.csv").chmod(0o666)
        shutil.copy(world.folder / "short.bag", folder / "short.bag")
        (folder / "short.bag").chmod(0o644)
        stranger = [
            "setpriv",
            "--reuid",
            "65534",
            "--regid",
            "65534",
            "--clear-groups",
            sys.executable,
            "-m",
            "slidectl",
        ]

        def run(*words: str) -> subprocess.CompletedProcess[str]:
            return subprocess.run(
                [*stranger, *words], env={**world.environment, "XDG_RUNTIME_DIR": name}, capture_output=True, text=True,
                timeout=60, check=False, cwd="/",
            )  # fmt: skip

        if run("--version").returncode != 0:
            pytest.skip("another user cannot run this program here: it is in a folder that only its owner may read")
        table = ("bag", "export", str(folder / "short.bag"), "--topic", STATES, "--force", "--csv")
        for words in (
            (*table, str(folder / "mine.csv")),
            (*table, str(folder / "new.csv")),
            ("urdf", "rrbot", "-o", str(folder / "m.urdf")),
        ):
            done = run(*words)
            assert done.returncode in (1, 2), done.stdout
            assert "Permission denied" in done.stderr
        assert (folder / "mine.csv").read_text() == "old"
        done = run(*table, str(folder / "ours.csv"))
        assert done.returncode == 0, done.stderr
        assert written(world, folder / "ours.csv")
        assert (folder / "ours.csv").stat().st_uid == 0
        assert sorted(path.name for path in folder.iterdir()) == ["mine.csv", "ours.csv", "short.bag"]
