"""Pictures by what is where in them, drawn in this process: by software always, by OpenGL where there is one."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slidectl import description
from slidectl.errors import AmbiguousName, UnknownName
from slidectl.extensions.viewing import drawn_scene
from slidectl.extensions.viewing.drawing import WorldView
from slidectl.extensions.viewing.drawn_scene import ViewpointChoice
from slidectl.extensions.viewing.gl_renderer import GlRenderer
from slidectl.extensions.viewing.picture_files import Pixels
from slidectl.extensions.viewing.software_renderer import SoftwareRenderer
from slidectl.physics import rendering
from slidectl.simulation import Simulation

ROOT = Path(__file__).parent.parent.parent
SIZE = (320, 240)
Write = Callable[[str, str], Path]

BODY = """<robot name="body"><link name="link"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  <visual>{origin}<geometry>{geometry}</geometry><material name="c"><color rgba="{colour} 1"/></material></visual>
  {more}</link>{after}</robot>"""
RED, GREEN = "1 0 0", "0 1 0"


def body(
    geometry: str = '<box size="0.2 0.2 0.2"/>', colour: str = RED, origin: str = "", more: str = "", after: str = ""
) -> str:
    return BODY.format(geometry=geometry, colour=colour, origin=origin, more=more, after=after)


def pose(x: float, y: float, z: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return (x, y, z), (0.0, 0.0, 0.0, 1.0)


class Watched:
    """A world in this process, from one camera."""

    def __init__(self, simulation: Simulation, camera: str, size: tuple[int, int] = SIZE) -> None:
        self.told: list[str] = []
        client: Any = simulation  # it has the one method that a view calls
        self.view = WorldView(client, camera, size, True, self.told.append)

    def draw(self) -> Pixels:
        return self.view.draw()


def where(pixels: Pixels, channel: int) -> tuple[float, float, int]:
    """Column and row of the middle of what has one strong colour, and how many pixels it has."""
    others = np.delete(pixels, channel, axis=2).max(axis=2)
    rows, columns = np.nonzero((pixels[:, :, channel] > 80) & (others < 40))
    assert len(rows), "nothing has the colour"
    return float(columns.mean()), float(rows.mean()), len(rows)


@pytest.mark.parametrize(
    ("camera", "across", "down"), [("side", 1, 0), ("front", -1, -1), ("top", 1, 0), ("iso", 1, 1)]
)
def test_a_body_is_where_it_is_before_and_after_a_move_along_x(camera: str, across: int, down: int) -> None:
    simulation = Simulation()
    simulation.robots.spawn(body(), "crate", pose=pose(0, 0, 1))
    simulation.robots.spawn(body(colour=GREEN), "other", pose=pose(0, 0.5, 0.1))
    watched = Watched(simulation, camera)
    before, other = where(watched.draw(), 0), where(watched.draw(), 1)
    state = {"model_name": "crate", "pose": {"position": {"x": 0.4, "y": 0, "z": 1}}}
    simulation.call("/gazebo/set_model_state", {"model_state": state})
    after = where(watched.draw(), 0)
    assert np.sign(np.round([after[0] - before[0], after[1] - before[1]], 0)).tolist() == [across, down]
    assert where(watched.draw(), 1) == other
    if camera == "front":  # it came nearer
        assert after[2] > 1.1 * before[2]


def test_what_comes_and_goes_is_drawn_and_a_model_that_stands_around_too() -> None:
    simulation = Simulation()
    simulation.robots.spawn(body(), "crate", pose=pose(0, 0, 1))
    watched = Watched(simulation, "side")
    watched.draw()
    request = {"model_name": "late", "model_xml": body(colour=GREEN), "initial_pose": {"position": {"x": 0.2, "z": 1}}}
    assert simulation.call("/gazebo/spawn_sdf_model", request)["success"]
    assert where(watched.draw(), 1)[0] > where(watched.draw(), 0)[0]
    simulation.delete("late")
    with pytest.raises(AssertionError, match="nothing has the colour"):
        where(watched.draw(), 1)


def test_a_robot_is_drawn_as_the_one_that_took_its_place() -> None:
    simulation = Simulation()
    simulation.robots.spawn(body(), "crate", pose=pose(0, 0, 1))
    watched = Watched(simulation, "side")
    where(watched.draw(), 0)
    simulation.delete("crate")
    simulation.robots.spawn(body(colour=GREEN), "crate", pose=pose(0, 0, 1))
    where(watched.draw(), 1)


def test_a_view_that_follows_keeps_its_link_in_the_middle() -> None:
    simulation = Simulation()
    simulation.robots.spawn(body(), "crate", pose=pose(0, 0, 1))
    watched = Watched(simulation, "follow:link")
    for x in (0, 7):
        state = {"model_name": "crate", "pose": {"position": {"x": x, "y": -x, "z": 1}}}
        simulation.call("/gazebo/set_model_state", {"model_state": state})
        assert where(watched.draw(), 0)[:2] == pytest.approx((SIZE[0] / 2, SIZE[1] / 2), abs=6)


def test_a_camera_of_a_robot_sees_with_its_own_eyes_what_reaches_behind_it_too() -> None:
    camera = """<gazebo reference="link"><sensor type="camera" name="eye"><pose>0 0 0.5 0 0 0</pose><camera>
      <horizontal_fov>1.5708</horizontal_fov></camera><plugin name="c" filename="libgazebo_ros_camera.so"/></sensor>
      </gazebo>"""
    simulation = Simulation()
    simulation.robots.spawn(body(after=camera), "watcher", pose=pose(0, 0, 1))
    # A wall to the left, from 10 m behind the eye to 10 m before it; and a ball 2 m ahead, 1 m to the right.
    simulation.robots.spawn(body('<box size="20 0.2 20"/>', GREEN), "wall", pose=pose(0, 2.1, 0))
    simulation.robots.spawn(body('<sphere radius="0.2"/>'), "ball", pose=pose(2, -1, 1.5))
    pixels = Watched(simulation, "eye").draw()
    column, row, _ = where(pixels, 0)
    assert (column, row) == pytest.approx((SIZE[0] * 0.75, SIZE[1] / 2), abs=3)  # 1 m of the 2 m that half sees there
    assert pixels[SIZE[1] // 2, 2, 1] > 80
    assert where(pixels, 1)[0] < SIZE[0] / 2


def test_a_camera_that_is_not_there_names_those_that_are() -> None:
    simulation = Simulation()
    for name in ("a", "b"):
        simulation.robots.spawn(body(), name, pose=pose(0, 0, ord(name)))
    with pytest.raises(UnknownName, match="sied") as raised:
        Watched(simulation, "sied")
    assert {"iso", "front", "top", "side", "follow:LINK"} <= set(raised.value.known)
    with pytest.raises(UnknownName, match="no link 'lnk'"):
        Watched(simulation, "follow:lnk")
    with pytest.raises(AmbiguousName, match="a::link"):
        Watched(simulation, "follow:link")
    Watched(simulation, "follow:b::link").draw()


def test_meshes_are_drawn_and_one_that_is_missing_is_a_box_with_a_notice(write: Write) -> None:
    corners = ("0 0 0", "1 0 0", "0 0 1")  # a triangle in the plane that `side` looks at
    facet = "facet normal 0 -1 0 outer loop " + " ".join(f"vertex {corner}" for corner in corners) + " endloop endfacet"
    file = write("flat.stl", f"solid flat {facet} endsolid flat")
    simulation = Simulation()
    simulation.robots.spawn(body(f'<mesh filename="file://{file}"/>', GREEN), "flat", pose=pose(0, 0, 1))
    simulation.robots.spawn(body('<mesh filename="file:///nowhere/arm.stl"/>'), "gone", pose=pose(0.8, 0, 1.8))
    watched = Watched(simulation, "side", (400, 400))
    pixels = watched.draw()
    assert [text for text in watched.told if "gone::link" in text and "arm.stl" in text and "a box" in text]
    assert len(watched.told) == 1
    green, red = where(pixels, 1), where(pixels, 0)
    assert green[2] / red[2] == pytest.approx(0.5 / 0.1**2, rel=0.3)  # their sizes, half a m² and a hundredth
    assert red[0] > green[0]
    assert red[1] < green[1]


@pytest.mark.parametrize("camera", ["iso", "side", "top", "follow:link3", "camera1"])
def test_software_and_opengl_draw_the_same(camera: str) -> None:
    if not rendering.gl_backend():
        pytest.skip("there is no OpenGL on this machine")
    simulation = Simulation()
    simulation.robots.spawn(description.load(ROOT / "models" / "rrbot.xacro").xml, "rrbot")
    simulation.robots.spawn(body('<cylinder radius="0.3" length="0.8"/>', GREEN), "barrel", pose=pose(1, 0.5, 0.4))
    simulation.robots.spawn(body('<sphere radius="0.3"/>'), "ball", pose=pose(1, -0.5, 0.3))
    simulation.call(
        "/gazebo/set_model_configuration",
        {"model_name": "rrbot", "joint_names": ["joint1", "joint2"], "joint_positions": [math.pi / 3, math.pi / 4]},
    )
    scene = Watched(simulation, camera).view.scene
    view = ViewpointChoice(scene, camera, SIZE).of(scene)
    ours, theirs = (drawer(SIZE).draw(scene, view).astype(int) for drawer in (SoftwareRenderer, GlRenderer))
    differing = (np.abs(ours - theirs).max(axis=2) > 30).mean()
    assert differing < 0.03  # edges, which OpenGL smooths, and round bodies, which it shades smoothly


@pytest.mark.filterwarnings("error")
def test_a_colour_beyond_white_is_white() -> None:
    simulation = Simulation()
    simulation.spawn(body(colour="1e308 1e308 1e308"), "body")
    scene = Watched(simulation, "iso").view.scene
    picture = SoftwareRenderer(SIZE).draw(scene, ViewpointChoice(scene, "iso", SIZE).of(scene))
    assert picture[SIZE[1] // 2, SIZE[0] // 2].tolist() == [255, 255, 255]


@pytest.fixture(params=[GlRenderer, SoftwareRenderer])
def drawer(request: pytest.FixtureRequest) -> Any:
    """The class that draws the pictures of the test."""
    if request.param is GlRenderer and not rendering.gl_backend():
        pytest.skip("there is no OpenGL on this machine")
    return request.param


def test_a_robot_has_a_shadow_on_the_ground_away_from_the_sun(drawer: Any) -> None:
    simulation = Simulation()
    simulation.robots.spawn(body(), "crate", pose=pose(0, 0, 0.6))
    scene = Watched(simulation, "top").view.scene
    view = ViewpointChoice(scene, "top", SIZE).of(scene)
    picture = drawer(SIZE).draw(scene, view).astype(int)
    x, y = (0.6 * part / -drawn_scene.SUN[2] for part in drawn_scene.SUN[:2])
    pixels_a_metre = SIZE[1] / 2 / math.tan(view.field_of_view / 2) / float(view.eye[2])
    shade, opposite = (
        picture[round(SIZE[1] / 2 - way * y * pixels_a_metre), round(SIZE[0] / 2 + way * x * pixels_a_metre)]
        for way in (1, -1)
    )
    assert np.ptp(shade) < 10  # it is grey
    assert shade.max() < 0.8 * opposite.min()


def test_the_sky_is_bluer_above_and_edges_before_it_are_smooth(drawer: Any) -> None:
    simulation = Simulation(ground=False)
    simulation.robots.spawn(body(), "crate", pose=pose(0, 0, 1))
    scene = Watched(simulation, "side").view.scene
    choice = ViewpointChoice(scene, "side", SIZE).of(scene)
    upwards = np.array((0.0, math.cos(0.3), math.sin(0.3)))
    view = choice._replace(up=np.array((0.1, -math.sin(0.3), math.cos(0.3))), ahead=upwards)
    picture = drawer(SIZE).draw(scene, view).astype(int)
    blueness = picture[:, 0, 2] - picture[:, 0, 0]
    assert blueness[0] > blueness[SIZE[1] // 2] > blueness[-1]
    edges = (picture[:, :, 1] > 40) & (picture[:, :, 1] < 150)  # between the sky and the crate, which has no green
    assert edges.sum() > 20


def test_a_robot_that_has_gone_far_is_not_in_the_haze(drawer: Any) -> None:
    simulation = Simulation()
    simulation.robots.spawn(body('<box size="1 1 1"/>'), "crate", pose=pose(0, 0, 0.5))
    scene = Watched(simulation, "side").view.scene
    view = ViewpointChoice(scene, "side", SIZE).of(scene)
    renderer = drawer(SIZE)
    assert where(renderer.draw(scene, view), 0)[2] > 100
    scene.poses["crate::link"] = pose(0, 40, 0.5)
    assert where(renderer.draw(scene, view), 0)[2] >= 10
