"""Pictures of cameras in a daemon: they come beside the world, and what renders them ends with the daemon."""

from __future__ import annotations

import base64
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import opengl
import pytest
from daemon_fixture import Runtime, running_daemon
from waiting import eventually

from slidectl import Client
from slidectl.client import Subscription
from slidectl.physics import rendering

ROBOT = """<robot name="watcher"><link name="base"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <gazebo reference="base"><sensor type="camera" name="eye"><update_rate>20</update_rate><camera>
  <image><width>64</width><height>48</height></image></camera>
  <plugin name="c" filename="libgazebo_ros_camera.so"/></sensor></gazebo></robot>"""

pytestmark = pytest.mark.usefixtures("drawn_by")


@pytest.fixture(params=[rendering.BY_OPENGL, rendering.BY_SOFTWARE])
def drawn_by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    """What draws the pictures of the daemon in the test."""
    if request.param == rendering.BY_SOFTWARE:
        monkeypatch.setenv("LD_LIBRARY_PATH", opengl.missing(tmp_path)["LD_LIBRARY_PATH"])
    elif not rendering.gl_backend():
        pytest.skip("there is no OpenGL on this machine")
    return str(request.param)


def renders(process: int) -> bool:
    """Whether a process is one that renders, and runs."""
    try:
        return b"slidectl.physics.rendering" in Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:  # it has ended
        return False


def renderer_of(daemon: Runtime) -> int:
    """The process that renders."""
    children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
    (renderer,) = filter(renders, map(int, children))
    return renderer


def has_ended(process: int) -> bool:
    """With all its threads, so that nothing of it is left but its exit code."""
    state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    return state == "Z" and len(os.listdir(f"/proc/{process}/task")) == 1


@contextmanager
def watching(folder: Path) -> Iterator[tuple[Runtime, Client, Subscription]]:
    """A daemon that stands still, somebody who listens to a camera there, and a first picture that has come."""
    file = folder / "watcher.urdf"
    file.write_text(ROBOT)
    with running_daemon(paused=True) as daemon, daemon.environment(), Client(timeout=60.0) as client:
        client.spawn(str(file), at=(0, 0, 1))
        with client.subscribe("/watcher/image_raw") as pictures:
            client.step(50)
            pictures.get()
            yield daemon, client, pictures


def test_pictures_come_while_the_world_goes_on_and_after_others_have_come_to_it(tmp_path: Path) -> None:
    with watching(tmp_path) as (daemon, client, pictures):
        client.call("/gazebo/unpause_physics")
        first = pictures.get()
        assert len(base64.b64decode(first["data"])) == first["height"] * first["step"] == 48 * 64 * 3
        client.spawn("slider", at=(3, 0, 0))  # the world is another one now
        later = [pictures.get() for _ in range(3)]
        assert later[-1]["data"] != first["data"]
        renderer = renderer_of(daemon)
    assert not renders(renderer)


def test_the_status_and_the_log_say_who_draws(drawn_by: str, tmp_path: Path) -> None:
    with watching(tmp_path) as (daemon, client, _):
        assert client.call("/slidectl/status")["pictures"].partition(":")[0] == drawn_by
        is_told = "camera eye is drawn by software: there is no OpenGL; install OpenGL" in daemon.log
        assert is_told == (drawn_by == rendering.BY_SOFTWARE)


def test_the_world_does_not_wait_for_a_process_that_is_told_of_a_large_world(tmp_path: Path) -> None:
    with watching(tmp_path) as (daemon, client, pictures):
        renderer = renderer_of(daemon)
        os.kill(renderer, signal.SIGSTOP)
        for place in range(5):  # a model of 100 KB and more
            client.spawn("rrbot", name=f"rrbot{place}", at=(place, 3, 0))
        client.step(50)
        assert client.call("/slidectl/status")["time"] == pytest.approx(0.1)
        os.kill(renderer, signal.SIGCONT)
        assert pictures.get()["header"]["stamp"]["nsecs"] == 100_000_000


def test_a_small_picture_takes_little_memory(tmp_path: Path) -> None:
    with watching(tmp_path) as (daemon, _, _):
        text = Path(f"/proc/{renderer_of(daemon)}/status").read_text()
        peak_kb = int(text.partition("VmHWM:")[2].split()[0])
    assert peak_kb < 600_000  # interpreter and libraries; a screen of 4096 x 4096 alone takes a gigabyte


def test_a_process_that_ended_before_a_picture_is_started_again(tmp_path: Path) -> None:
    with watching(tmp_path) as (daemon, client, pictures):
        renderer = renderer_of(daemon)
        os.kill(renderer, signal.SIGKILL)
        eventually(lambda: has_ended(renderer))
        client.step(50)
        assert pictures.get()["header"]["stamp"]["nsecs"] == 100_000_000
        assert renderer_of(daemon) != renderer


def test_a_process_that_ends_during_a_picture_costs_that_picture_alone(tmp_path: Path) -> None:
    with watching(tmp_path) as (daemon, client, pictures):
        renderer = renderer_of(daemon)
        os.kill(renderer, signal.SIGSTOP)
        client.step(50)  # it has got a picture to make
        os.kill(renderer, signal.SIGKILL)
        eventually(lambda: "camera eye: the process that renders pictures has ended" in daemon.log)
        client.step(50)
        assert pictures.get()["header"]["stamp"]["nsecs"] == 150_000_000


def test_where_opengl_breaks_software_draws(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", opengl.broken(tmp_path)["LD_LIBRARY_PATH"])
    file = tmp_path / "watcher.urdf"
    file.write_text(ROBOT)
    with running_daemon(paused=True) as daemon, daemon.environment(), Client(timeout=60.0) as client:
        client.spawn(str(file), at=(0, 0, 1))
        with client.subscribe("/watcher/image_raw") as pictures:
            client.step(50)
            eventually(lambda: "has ended" in daemon.log)
            client.step(50)
            assert pictures.get()["header"]["stamp"]["nsecs"] == 100_000_000
        drawn_by = client.call("/slidectl/status")["pictures"]
        assert drawn_by == "software: OpenGL (egl) ends the process that uses it"
