"""`slidectl render` and `slidectl video` against a real daemon; files are read back by PyAV."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import av
import numpy as np
import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from waiting import eventually

SMALL = ("--size", "160x120", "--camera", "front", "--software")


def pictures(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as file:
        return [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]


def height_of_the_block(pixels: np.ndarray) -> float:
    """How far above the picture's lower edge the middle of what is black is."""
    rows, _ = np.nonzero(pixels.max(axis=2) < 40)
    assert len(rows)
    return float(pixels.shape[0] - rows.mean())


@pytest.fixture(scope="module")
def slider(world: CommandLine) -> CommandLine:
    """A paused slider with its controller."""
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint1_position_controller")
    return world


def test_a_picture_shows_the_block_where_it_is(slider: CommandLine, tmp_path: Path) -> None:
    before, after = tmp_path / "before.png", tmp_path / "after.png"
    said = json.loads(slider.ok("render", "-o", str(before), "--json", "--software", "--camera", "front"))
    assert (said["width"], said["height"], said["robots"], said["drawn_by"]) == (800, 600, ["slider"], "software")
    with slider.client() as client:
        client.call(
            "/gazebo/set_model_configuration",
            {"model_name": "slider", "joint_names": ["joint1"], "joint_positions": [0.9]},
        )
    slider.ok("render", "-o", str(after), "--software", "--camera", "front")
    [low], [high] = pictures(before), pictures(after)
    assert low.shape == high.shape == (600, 800, 3)
    assert height_of_the_block(high) > height_of_the_block(low) + 20


def test_without_opengl_a_picture_is_drawn_by_software_and_that_is_said(slider: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "now.png"
    done = slider("render", "-o", str(file), __EGL_VENDOR_LIBRARY_FILENAMES="/dev/null", LIBGL_DRIVERS_PATH="/dev/null")
    assert done.returncode == 0, done.stderr
    assert "drawn by software" in done.stderr
    assert "apt install libegl1" in done.stderr
    assert height_of_the_block(pictures(file)[0]) > 0


def test_a_variable_that_mujoco_cannot_use_stops_neither_the_daemon_nor_a_picture(tmp_path: Path) -> None:
    slidectl = CommandLine(tmp_path)
    slidectl.ok("daemon", "start", "--paused", MUJOCO_GL="bogus")
    try:
        slidectl.ok("spawn", "slider")
        done = slidectl("render", "-o", str(tmp_path / "now.png"), "--camera", "front", MUJOCO_GL="bogus")
    finally:
        slidectl.ok("daemon", "stop")
    assert done.returncode == 0, done.stderr
    assert "drawn by software: MuJoCo cannot be used with MUJOCO_GL=bogus" in done.stderr
    assert height_of_the_block(pictures(tmp_path / "now.png")[0]) > 0


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("render", "-o", "x.png", "--camera", "sied"), 1, "Did you mean 'side'"),
        (("render", "-o", "x.png", "--camera", "follow:link9"), 1, "slider::link2"),
        (("render", "-o", "x.png", "--size", "15x600"), 2, "from 16x16 to 4096x4096"),
        (("render", "-o", "x.png", "--size", "9000x9000"), 2, "from 16x16 to 4096x4096"),
        (("render", "-o", "x.jpeg"), 2, ".png"),
        (("render", "-o", "/nowhere/x.png", "--software"), 1, "cannot write /nowhere/x.png"),
        (("video", "x.avi", "--for", "1", *SMALL), 2, ".mp4, .gif"),
        (("video", "x.mp4", "--for", "1", "--software", "--size", "161x120"), 2, "even widths"),
        (("video", "x.gif", "--for", "1", "--fps", "60", *SMALL), 2, "at most 50 pictures a second"),
        (("video", "x.mp4", "--for", "1", "--fps", "2000", *SMALL), 2, "at most 240 pictures a second"),
        (("video", "/nowhere/x.mp4", "--for", "1", *SMALL), 1, "cannot write /nowhere/x.mp4"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_what_can(
    slider: CommandLine, tmp_path: Path, words: tuple[str, ...], code: int, told: str
) -> None:
    done = slider(*words, cwd=tmp_path)
    assert (done.returncode, list(tmp_path.iterdir())) == (code, []), done.stderr
    assert told in done.stderr


def test_words_are_checked_before_a_daemon_is_looked_for(slidectl: CommandLine) -> None:
    for words, told in (("x.avi",), ".mp4, .gif"), (("x.mp4", "--size", "161x120"), "even widths"):
        done = slidectl("video", *words)
        assert done.returncode == 2
        assert told in done.stderr


@pytest.mark.parametrize(("kind", "rate", "count"), [("mp4", "30", 15), ("gif", "24", 12)])
def test_a_paused_world_is_stepped_for_a_video_of_exactly_that_length(
    slider: CommandLine, tmp_path: Path, kind: str, rate: str, count: int
) -> None:
    file = tmp_path / f"slide.{kind}"
    slider.ok("sim", "reset", "--time")
    slider.ok("pub", "/slider/joint1_position_controller/command", "-1.0")
    said = json.loads(slider.ok("video", str(file), "--for", "0.5", "--fps", rate, "--json", *SMALL))
    assert (said["pictures"], said["seconds"]) == (count, 0.5)
    status = json.loads(slider.ok("sim", "status", "--json"))
    assert (status["time"], status["paused"]) == (0.5, True)
    shown = pictures(file)
    assert len(shown) == count
    with av.open(str(file)) as opened:
        assert opened.duration == 500_000  # microseconds
    assert np.abs(shown[0].astype(int) - shown[-1]).max() > 100  # it moves


def test_a_running_world_is_watched_in_lock_step_and_runs_on(tmp_path: Path) -> None:
    with running_daemon(rtf=float("inf")) as runtime:
        slidectl = CommandLine(runtime.folder)
        slidectl.ok("spawn", "slider")
        before = json.loads(slidectl.ok("sim", "status", "--json"))["time"]
        said = json.loads(slidectl.ok("video", str(tmp_path / "run.mp4"), "--for", "2", "--fps", "7", "--json", *SMALL))
        status = json.loads(slidectl.ok("sim", "status", "--json"))
        assert (said["pictures"], len(pictures(tmp_path / "run.mp4"))) == (14, 14)
        assert not status["paused"]
        assert status["lockstep"] == []
        assert status["time"] > before + 2


def test_a_video_says_when_somebody_pauses_its_world(tmp_path: Path) -> None:
    with running_daemon(rtf=1.0) as runtime:
        slidectl = CommandLine(runtime.folder)
        process = slidectl.start("video", str(tmp_path / "held.gif"), "--for", "3", "--fps", "10", *SMALL)
        eventually(lambda: json.loads(slidectl.ok("sim", "status", "--json"))["lockstep"])
        slidectl.ok("sim", "pause")
        assert process.stderr is not None
        assert "the simulation is paused; the video waits until it goes on" in process.stderr.readline()
        slidectl.ok("sim", "resume")
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert len(pictures(tmp_path / "held.gif")) == 30


def test_a_video_says_when_somebody_moves_the_time_of_its_world(tmp_path: Path) -> None:
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        process = slidectl.start("video", str(tmp_path / "moved.gif"), "--for", "20", "--fps", "10", *SMALL)
        with slidectl.client() as client:
            eventually(lambda: client.call("/slidectl/status")["time"] > 0.2)
            client.call("/gazebo/reset_simulation")
        _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "somebody else moved the world's time between two pictures" in err


@pytest.mark.parametrize(
    ("words", "end", "code"), [((), "signal", 0), (("--for", "60"), "signal", 130), ((), "daemon", 3)]
)
def test_a_video_that_ends_early_can_be_played(tmp_path: Path, words: tuple[str, ...], end: str, code: int) -> None:
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        slidectl.ok("spawn", "slider")
        with slidectl.client() as client:
            process = slidectl.start("video", str(tmp_path / "cut.mp4"), "--json", *words, *SMALL)
            eventually(lambda: client.call("/slidectl/status")["time"] > 0.5)
        os.kill(process.pid if end == "signal" else int(runtime.pid or 0), signal.SIGINT)
        out, err = process.communicate(timeout=60)
        assert process.returncode == code, err
        count = json.loads(out)["pictures"]
        assert len(pictures(tmp_path / "cut.mp4")) == count >= 15


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_a_video_on_a_full_disk_says_so(slider: CommandLine, tmp_path: Path, kind: str) -> None:
    (tmp_path / f"full.{kind}").symlink_to("/dev/full")
    done = slider("video", f"full.{kind}", "--for", "2", "--fps", "50", *SMALL, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"error: cannot write full.{kind}: No space left on device\n"


def test_a_terminal_shows_how_far_a_video_is(slider: CommandLine, tmp_path: Path) -> None:
    shown = slider.on_a_terminal("video", str(tmp_path / "bar.gif"), "--for", "0.2", "--fps", "10", *SMALL)
    assert b"2/2" in shown
    assert b"bar.gif: 2 pictures, 0.200 s" in shown
