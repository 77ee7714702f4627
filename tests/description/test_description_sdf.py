"""Models of SDF and of Gazebo worlds as URDF: frames, shapes, masses, joints, includes, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from slidectl.description import parse, sdf
from slidectl.description.robot import Box, Cylinder, Mesh, Robot, Sphere
from slidectl.errors import BadFile, NotThere
from slidectl.rotations import from_rpy

MODEL = """<sdf version="1.6">
  <model name="{name}">{inside}</model>
</sdf>"""


def scene(inside: str, name: str = "thing", version: str = "1.6") -> sdf.Scene:
    return sdf.parse(MODEL.replace("1.6", version).format(name=name, inside=inside))


def robot(model: sdf.SdfModel) -> Robot:
    return parse(model.xml)


def box(name: str = "link", size: str = "1 2 3", more: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><mass>2</mass></inertial>{more}'
        f'<collision name="c"><geometry><box><size>{size}</size></box></geometry></collision></link>'
    )


def test_a_free_box_is_a_robot_of_one_link_at_the_pose_of_the_model_and_the_link() -> None:
    (model,) = scene("<pose>1 0 0 0 0 1.5707963267948966</pose>" + box(more="<pose>0 2 0 0 0 0</pose>")).models
    assert model.name == "thing"
    assert not model.is_static
    assert model.pose[0] == pytest.approx((-1.0, 0.0, 0.0))
    assert model.pose[1] == pytest.approx(from_rpy((0.0, 0.0, math.pi / 2)))
    link = robot(model).links["link"]
    assert link.inertial is not None
    assert (link.inertial.mass, link.collisions[0].geometry) == (2.0, Box((1.0, 2.0, 3.0)))


def test_a_static_model_hangs_on_the_world_and_keeps_the_poses_of_its_links() -> None:
    inside = "<static>true</static><pose>0 0 5 0 0 0</pose>" + box() + box("shelf", more="<pose>0 0 1 0 0 0</pose>")
    (model,) = scene(inside).models
    robot_model = robot(model)
    assert model.is_static
    assert robot_model.is_fixed_to_world
    assert model.pose[0] == (0.0, 0.0, 5.0)
    assert robot_model.joints["world_to_shelf"].origin.xyz == (0.0, 0.0, 1.0)


def test_shapes_masses_friction_and_gravity_are_taken() -> None:
    inside = """<link name="l"><gravity>0</gravity>
      <inertial><pose>0 0 0.1 0 0 0</pose><mass>3</mass>
        <inertia><ixx>1</ixx><iyy>2</iyy><izz>2.5</izz></inertia></inertial>
      <collision name="a"><geometry><sphere><radius>0.5</radius></sphere></geometry>
        <surface><friction><ode><mu>0.7</mu><mu2>0.6</mu2></ode></friction></surface></collision>
      <visual name="b"><geometry><cylinder><radius>0.1</radius><length>2</length></cylinder></geometry>
        <material><ambient>1 0 0 1</ambient></material></visual></link>"""
    robot_model = robot(scene(inside).models[0])
    link = robot_model.links["l"]
    assert link.inertial is not None
    assert (link.inertial.mass, link.inertial.inertia) == (3.0, (1.0, 0.0, 0.0, 2.0, 0.0, 2.5))
    assert link.inertial.origin.xyz == (0.0, 0.0, 0.1)
    assert (link.collisions[0].geometry, link.visuals[0].geometry) == (Sphere(0.5), Cylinder(0.1, 2.0))
    assert (link.surface.mu1, link.surface.mu2, link.surface.turn_gravity_off) == (0.7, 0.6, True)
    assert link.visuals[0].material is not None
    assert link.visuals[0].material.rgba == (1.0, 0.0, 0.0, 1.0)


def test_a_joint_has_its_frame_in_the_child_and_its_axis_in_that_frame() -> None:
    inside = (
        box("base")
        + box("door", more="<pose>1 0 0 0 0 1.5707963267948966</pose>")
        + """<joint name="hinge" type="revolute"><parent>base</parent><child>door</child><pose>0.5 0 0 0 0 0</pose>
          <axis><xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper><effort>5</effort></limit>
          <dynamics><damping>0.3</damping></dynamics></axis></joint>"""
    )
    joint = robot(scene(inside).models[0]).joints["hinge"]
    assert joint.origin.xyz == pytest.approx((1.0, 0.5, 0.0))
    assert joint.origin.rpy == pytest.approx((0.0, 0.0, math.pi / 2))
    assert (joint.axis, joint.damping) == ((0.0, 0.0, 1.0), 0.3)
    assert joint.limit is not None
    assert (joint.limit.lower, joint.limit.upper, joint.limit.effort) == (-1.0, 1.0, 5.0)


def test_shapes_of_a_child_stay_where_they_were_when_its_frame_goes_to_the_joint() -> None:
    inside = (
        box("base")
        + box("door")
        + """<joint name="hinge" type="revolute"><parent>base</parent><child>door</child><pose>0.5 0 0 0 0 0</pose>
          <axis><xyz>0 0 1</xyz></axis></joint>"""
    )
    robot_model = robot(scene(inside).models[0])
    assert robot_model.joints["hinge"].type == "continuous"
    assert robot_model.links["door"].collisions[0].origin.xyz == (-0.5, 0.0, 0.0)


@pytest.mark.parametrize(
    ("version", "more"), [("1.4", ""), ("1.6", "<use_parent_model_frame>1</use_parent_model_frame>")]
)
def test_an_axis_may_be_given_in_the_frame_of_the_model(version: str, more: str) -> None:
    inside = (
        box("base")
        + box("door", more="<pose>0 0 0 0 0 1.5707963267948966</pose>")
        + f"""<joint name="hinge" type="prismatic"><parent>base</parent><child>door</child>
          <axis><xyz>1 0 0</xyz>{more}<limit><lower>0</lower><upper>1</upper></limit></axis></joint>"""
    )
    assert robot(scene(inside, version=version).models[0]).joints["hinge"].axis == pytest.approx((0.0, -1.0, 0.0))


def test_links_without_a_joint_between_them_are_robots_of_their_own() -> None:
    found = scene(box("a") + box("b", more="<pose>0 0 4 0 0 0</pose>"))
    assert [(model.name, model.pose[0]) for model in found.models] == [
        ("thing", (0.0, 0.0, 0.0)),
        ("thing_b", (0.0, 0.0, 4.0)),
    ]
    assert [notice.verdict for notice in found.notices] == ["converted"]


def test_a_world_gives_its_models_in_order_with_the_poses_of_its_state() -> None:
    world = f"""<sdf version="1.6"><world name="w">
      <include><uri>model://ground_plane</uri></include><include><uri>model://sun</uri></include>
      <model name="a"><pose>1 1 1 0 0 0</pose>{box()}</model><model name="a b">{box()}</model>
      <state world_name="w"><model name="a"><pose>2 2 2 0 0 0</pose></model></state></world></sdf>"""
    found = sdf.parse(world)
    assert found.has_ground
    assert [(model.name, model.pose[0]) for model in found.models] == [
        ("a", (2.0, 2.0, 2.0)),
        ("a_b", (0.0, 0.0, 0.0)),
    ]


def test_included_models_are_found_by_path_and_beside_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    crate = tmp_path / "path" / "crate"
    crate.mkdir(parents=True)
    (crate / "model.config").write_text(
        "<model><sdf version='1.4'>old.sdf</sdf><sdf version='1.6'>new.sdf</sdf></model>"
    )
    (crate / "new.sdf").write_text(MODEL.format(name="crate", inside=box()))
    world = tmp_path / "two.world"
    world.write_text(
        """<sdf version="1.6"><world name="w"><include><uri>model://crate</uri><pose>1 0 0 0 0 0</pose></include>
        <include><uri>model://crate</uri><name>other</name><static>1</static></include></world></sdf>"""
    )
    with pytest.raises(NotThere, match="GAZEBO_MODEL_PATH"):
        sdf.read(world)
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path / "path"))
    found = sdf.read(world).models
    assert [(model.name, model.pose[0], model.is_static) for model in found] == [
        ("crate", (1.0, 0.0, 0.0), False),
        ("other", (0.0, 0.0, 0.0), True),
    ]


def test_a_nested_model_is_part_of_the_model_around_it() -> None:
    inside = (
        box("base")
        + f'<model name="arm"><pose>0 0 1 0 0 0</pose>{box("hand")}</model>'
        + '<joint name="weld" type="fixed"><parent>base</parent><child>arm::hand</child></joint>'
    )
    robot_model = robot(scene(inside).models[0])
    assert robot_model.joints["weld"].child == "arm::hand"
    assert robot_model.joints["weld"].origin.xyz == (0.0, 0.0, 1.0)


def test_a_mesh_is_found_by_its_model_and_has_its_scale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cup").mkdir()
    (tmp_path / "cup" / "cup.stl").write_text("solid\nendsolid\n")
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path))
    shape = "<mesh><uri>model://cup/cup.stl</uri><scale>2 2 2</scale></mesh>"
    inside = f'<link name="l"><collision name="c"><geometry>{shape}</geometry></collision></link>'
    mesh = robot(scene(inside).models[0]).links["l"].collisions[0].geometry
    assert isinstance(mesh, Mesh)
    assert (mesh.path, mesh.scale) == (str(tmp_path / "cup" / "cup.stl"), (2.0, 2.0, 2.0))


def test_what_is_left_out_is_reported_with_its_line() -> None:
    inside = '<plugin name="p" filename="libp.so"/>\n' + box() + "\n<gripper name='g'/>"
    assert [(notice.verdict, notice.line) for notice in scene(inside).notices] == [("wrong", 2), ("ignored", 4)]


def test_what_is_not_read_of_a_joint_or_an_include_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "crate").mkdir()
    (tmp_path / "crate" / "model.sdf").write_text(MODEL.format(name="crate", version="1.6", inside=box("side")))
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path))
    include = "<include><uri>model://crate</uri><static>1</static>\n<placement_frame>side</placement_frame></include>"
    joint = "<joint name='j' type='fixed'><parent>a</parent><child>b</child>\n<physics><ode/></physics></joint>"
    told = [notice.subject for notice in scene(box("a") + box("b") + joint + include).notices]
    assert told[:3] == ["<physics>", "<static>", "<placement_frame>"]


def test_a_pose_without_angles_is_a_position_as_in_gazebo() -> None:
    (model,) = scene("<pose>1 2 3</pose>" + box(more="<pose>0 0 1</pose>")).models
    assert model.pose == ((1.0, 2.0, 4.0), (0.0, 0.0, 0.0, 1.0))
    found = scene("<pose>1 2 3 1</pose>" + box())
    assert found.models[0].pose == ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    (notice,) = found.notices
    assert "lacks some of its three angles: it is a position without rotation" in notice.text


@pytest.mark.parametrize(
    ("inside", "text"),
    [
        ("", "has no <link>"),
        (box() + box(), "duplicate link 'link'"),
        (box(size="1 2"), "<size> is 3 numbers"),
        (box(size="1 2 nan"), "not a finite number"),
        (box(more="<pose>1 2</pose>"), "<pose> is 6 numbers, or 3 without its angles"),
        (box(more="<pose relative_to='x'>0 0 0 0 0 0</pose>"), "frames by name are not read"),
        ("<static>maybe</static>" + box(), "expected true or false"),
        (box() + "<joint name='j' type='fixed'><parent>link</parent></joint>", "lacks <child>"),
        (box() + "<joint name='j' type='fixed'><parent>link</parent><child>no</child></joint>", "no link 'no'"),
        (
            box("a") + box("b") + "<joint name='j' type='screw'><parent>a</parent><child>b</child></joint>",
            "type 'screw'",
        ),
        (
            box("a")
            + box("b")
            + "<joint name='j' type='fixed'><parent>a</parent><child>b</child></joint>"
            + "<joint name='k' type='fixed'><parent>b</parent><child>a</child></joint>",
            "loop of joints",
        ),
        (
            box("a")
            + "<joint name='j' type='fixed'><parent>world</parent><child>a</child></joint>"
            + "<joint name='k' type='fixed'><parent>world</parent><child>a</child></joint>",
            "is the child of two joints",
        ),
    ],
)
def test_broken_models_are_refused_with_file_and_line(inside: str, text: str) -> None:
    with pytest.raises(BadFile, match=text) as refused:
        scene(inside)
    assert refused.value.line is not None


def test_a_model_that_includes_itself_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "snake").mkdir()
    (tmp_path / "snake" / "model.sdf").write_text(
        MODEL.format(name="snake", inside="<include><uri>model://snake</uri></include>")
    )
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path))
    with pytest.raises(BadFile, match="nested deeper than"):
        sdf.read(tmp_path / "snake" / "model.sdf")


def test_damping_of_a_body_bounce_and_lights_are_reported_unless_they_ask_for_nothing() -> None:
    quiet = (
        "<velocity_decay><linear>0</linear></velocity_decay>",
        "<surface><bounce><restitution_coefficient>0</restitution_coefficient></bounce></surface>",
    )
    asked = (
        "<velocity_decay><linear>0.01</linear><angular>0.01</angular></velocity_decay><light name='lamp'/>",
        "<surface><bounce><restitution_coefficient>0.5</restitution_coefficient></bounce></surface>",
    )

    def notices(link: str, surface: str) -> list[tuple[str, str, str]]:
        found = scene(box(more=link).replace("</collision>", f"{surface}</collision>")).notices
        return [(notice.verdict, notice.subject, notice.text) for notice in found]

    assert notices(*quiet) == []
    assert notices(*asked) == [
        ("ignored", "<velocity_decay>", "has no effect: bodies here have no damping of their own, joints have"),
        ("ignored", '<light name="lamp">', sdf.NO_LIGHT),
        ("ignored", "<bounce>", "has no effect: contacts here do not bounce"),
    ]
