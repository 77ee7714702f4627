"""Cameras that a model declares: what they see, and what they say of themselves."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np
import pytest

from slidectl import Simulation, description
from slidectl.description.sensors import Camera
from slidectl.errors import BadFile
from slidectl.physics import World, rendering
from slidectl.rotations import Pose
from slidectl.simulation.host import Host
from slidectl.simulation.pending import Pending

LINK = """<link name="base"><inertial><mass value="2"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  <visual><geometry><box size="1 1 1"/></geometry><material name="m"><color rgba="{0}"/></material></visual>
  <collision><geometry><box size="{1} {1} {1}"/></geometry></collision></link>"""
CAMERA = """<gazebo reference="base"><sensor type="camera" name="eye"><update_rate>10</update_rate>
  <pose>0.2 0 0 0 0 0</pose><camera><horizontal_fov>1.5708</horizontal_fov>
  <image><width>64</width><height>48</height><format>{0}</format></image><clip><near>0.05</near><far>30</far></clip>
  {1}</camera><plugin name="c" filename="libgazebo_ros_camera.so"><cameraName>eye</cameraName>
  <frameName>eye_link</frameName>{2}</plugin></sensor></gazebo>"""


@pytest.fixture(params=[rendering.BY_OPENGL, rendering.BY_SOFTWARE])
def drawn_by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What draws the pictures of the test."""
    if request.param == rendering.BY_SOFTWARE:
        monkeypatch.setattr(rendering, "_LIBRARIES", {})
    elif not rendering.gl_backend():
        pytest.skip("there is no OpenGL on this machine")
    return str(request.param)


def robot(colour: str, more: str = "", size: float = 0.2) -> str:
    return f'<robot name="thing">{LINK.format(colour, size)}{more}</robot>'


def at(x: float, y: float = 0.0) -> Any:
    return ((x, y, 1.0), (0.0, 0.0, 0.0, 1.0))


def pictures(camera: str, cycles: int = 200, ground: bool = False) -> list[dict[str, Any]]:
    """What a camera at the origin sees of a red cube 1 m ahead, and of a blue one to the left of it."""
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), ground=ground)
    simulation.spawn(robot("1 1 1 1", camera), "thing", pose=at(0.0))
    simulation.spawn(robot("1 0 0 1"), "red", pose=at(1.3))
    simulation.spawn(robot("0 0 1 1"), "blue", pose=at(1.3, 0.5))
    heard: list[dict[str, Any]] = []
    simulation.subscribe("/thing/eye/image_raw", heard.append)
    simulation.step(cycles)
    return heard


def pixels(message: dict[str, Any]) -> Any:
    found = np.frombuffer(base64.b64decode(message["data"]), np.uint8).astype(int)
    return found.reshape(message["height"], message["width"], -1)


@pytest.mark.usefixtures("drawn_by")
def test_a_camera_sees_links_in_their_colours_where_they_are() -> None:
    heard = pictures(CAMERA.format("R8G8B8", "", ""))
    assert [message["header"]["stamp"]["nsecs"] for message in heard] == [100_000_000, 200_000_000]
    message = heard[-1]
    assert (message["encoding"], message["step"], message["header"]["frame_id"]) == ("rgb8", 192, "eye_link")
    image = pixels(message)
    assert image.shape == (48, 64, 3)
    red, blue = image[24, 32], image[24, 16]  # 90 degrees wide: what is 0.5 m to the left at 1 m is half the way out
    assert red[0] > 60 + 2 * max(red[1:])
    assert blue[2] > 60 + 2 * max(blue[:2])
    assert image[2, 60].max() < 30  # nothing is there


@pytest.mark.usefixtures("drawn_by")
def test_a_grey_picture_has_noise_that_is_the_same_in_every_run() -> None:
    noise = "<noise><type>gaussian</type><mean>0</mean><stddev>0.05</stddev></noise>"
    first, second = pictures(CAMERA.format("L8", noise, "")), pictures(CAMERA.format("L8", noise, ""))
    assert first[0]["encoding"] == "mono8"
    assert [message["data"] for message in first] == [message["data"] for message in second]
    assert first[0]["data"] != first[1]["data"]
    plain = pixels(pictures(CAMERA.format("L8", "", ""))[0])
    middle = (slice(21, 28), slice(29, 36))
    assert np.std(pixels(first[0])[middle] - plain[middle]) == pytest.approx(0.05 * 255, rel=0.4)


def test_the_geometry_of_a_camera_needs_no_picture() -> None:
    simulation = Simulation()
    simulation.spawn(robot("1 1 1 1", CAMERA.format("R8G8B8", "", "<hackBaseline>0.07</hackBaseline>")), "thing")
    heard: list[dict[str, Any]] = []
    simulation.subscribe("/thing/eye/camera_info", heard.append)
    simulation.step(100)
    (message,) = heard
    length = 64 / (2 * math.tan(1.5708 / 2))
    assert message["K"] == pytest.approx([length, 0, 32.5, 0, length, 24.5, 0, 0, 1])
    assert message["P"][3] == pytest.approx(-0.07 * length)


def test_without_opengl_software_draws_the_same_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    if not rendering.gl_backend():
        pytest.skip("there is no OpenGL on this machine")
    camera = CAMERA.format("R8G8B8", "", "").replace("<width>64", "<width>160").replace("<height>48", "<height>120")
    (theirs,) = pictures(camera, cycles=100, ground=True)
    monkeypatch.setattr(rendering, "_LIBRARIES", {})
    (ours,) = pictures(camera, cycles=100, ground=True)
    assert ours["header"] == theirs["header"]
    differing = (np.abs(pixels(ours) - pixels(theirs)).max(axis=2) > 20).mean()
    assert differing < 0.02  # edges, which OpenGL smooths, and the shadows on the ground


def test_without_opengl_a_camera_is_spawned_without_a_warning_and_the_log_says_once_who_draws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rendering, "_LIBRARIES", {})
    simulation = Simulation()
    assert simulation.spawn(robot("1 1 1 1", CAMERA.format("R8G8B8", "", "")), "thing", pose=at(0.0)).warnings == []
    logged: list[str] = []
    simulation.subscribe("/rosout", lambda message: logged.append(message["msg"]))
    heard: list[dict[str, Any]] = []
    simulation.subscribe("/thing/eye/image_raw", heard.append)
    simulation.step(300)
    assert len(heard) == 3
    (told,) = [text for text in logged if "eye" in text]
    assert told.startswith("camera eye is drawn by software: there is no OpenGL; install OpenGL")
    assert simulation.call("/slidectl/status")["pictures"] == "software: there is no OpenGL"


def test_a_camera_that_cannot_be_is_refused_and_another_format_is_said() -> None:
    for right, bad, words in (
        ("1.5708", "4", "a horizontal_fov between 0 and pi"), ("<width>64", "<width>inf", "not a finite number"),
    ):  # fmt: skip
        with pytest.raises(BadFile, match=words):
            description.parse(robot("1 1 1 1", CAMERA.format("R8G8B8", "", "").replace(right, bad)))
    report = description.parse(robot("1 1 1 1", CAMERA.format("BAYER_RGGB8", "", ""))).report
    assert "<format> BAYER_RGGB8 is unknown here" in str(report[0])


class EmptyPictures(Host):
    """A host whose pictures are empty. Each takes `takes_ns` of simulated time, one after the other."""

    def __init__(self, takes_ns: int) -> None:
        super().__init__()
        self.takes_ns = takes_ns
        self.busy_until_ns = 0

    def render(self, world: World, camera: Camera, pose: Pose, seed: int) -> Pending:
        del world, camera, pose, seed
        drawn = Pending()
        assert self.simulation is not None
        if self.takes_ns:
            now_ns = self.simulation.time_ns
            self.busy_until_ns = max(now_ns, self.busy_until_ns) + self.takes_ns
            self.simulation.graph.timers.after(self.busy_until_ns - now_ns, lambda: drawn.resolve(""))
        else:
            drawn.resolve("")
        return drawn

    def drawn_by(self) -> str:
        return rendering.BY_OPENGL


def test_a_camera_that_drawing_does_not_keep_up_with_says_its_rate() -> None:
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), host=EmptyPictures(350_000_000))  # three others are due meanwhile
    simulation.spawn(robot("1 1 1 1", CAMERA.format("R8G8B8", "", "")), "thing")
    log: list[dict[str, Any]] = []
    simulation.subscribe("/rosout", log.append)
    assert simulation.call("/slidectl/status")["cameras"] == []
    simulation.subscribe("/thing/eye/image_raw", lambda _: None)
    simulation.step(3000)
    status = simulation.call("/slidectl/status")
    assert (status["cameras"], status["cameras_asked"]) == (["/thing/eye/image_raw"], [10.0])
    assert status["cameras_reached"] == [pytest.approx(1 / 0.35, abs=0.6)]
    assert "smaller pictures (<width>, <height>)" in status["cameras_advice"][0]
    (said,) = (line["msg"] for line in log if "does not keep up" in line["msg"])
    assert said.startswith("/thing/eye/image_raw: 10 Hz asked, ")


def test_a_picture_that_takes_a_little_longer_than_the_period_does_not_halve_the_rate() -> None:
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), host=EmptyPictures(120_000_000))
    simulation.spawn(robot("1 1 1 1", CAMERA.format("R8G8B8", "", "")), "thing")
    heard: list[dict[str, Any]] = []
    simulation.subscribe("/thing/eye/image_raw", heard.append)
    simulation.step(6000)
    assert len(heard) == pytest.approx(6 / 0.12, abs=2)
    stamps = [message["header"]["stamp"]["secs"] * 10**9 + message["header"]["stamp"]["nsecs"] for message in heard]
    assert all(stamp % 100_000_000 == 0 for stamp in stamps)  # of the cycle that the picture shows
    assert stamps == sorted(set(stamps))


def test_a_camera_that_keeps_up_has_nothing_to_say() -> None:
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), host=EmptyPictures(0))
    simulation.spawn(robot("1 1 1 1", CAMERA.format("R8G8B8", "", "")), "thing")
    simulation.subscribe("/thing/eye/image_raw", lambda _: None)
    simulation.step(3000)
    status = simulation.call("/slidectl/status")
    assert (status["cameras_reached"], status["cameras_advice"]) == ([10.0], [""])
