"""What a good URDF becomes."""

from __future__ import annotations

import math

import pytest
from description_urdf_text import INERTIAL, LIMIT, cart, joint, link, robot

from slidectl.description import parse
from slidectl.description.robot import Box, Cylinder, Limit, Material, Mimic, Pose, Safety, Sphere


def test_links_and_joints_keep_the_order_of_the_file() -> None:
    bot = parse(
        robot(
            link("z"),
            joint("j2", child="b", parent="a"),
            link("a"),
            joint("j1", child="a", parent="z"),
            link("b"),
        )
    )
    assert list(bot.links) == ["z", "a", "b"]
    assert list(bot.joints) == ["j2", "j1"]
    assert bot.root == "z"
    assert not bot.is_fixed_to_world


def test_a_root_called_world_is_the_world_itself() -> None:
    bot = parse(cart())
    assert bot.is_fixed_to_world
    assert [child.name for child in bot.children_of("world")] == ["slide"]
    assert not bot.report


def test_mass_inertia_and_their_frame_are_read() -> None:
    inside = (
        '<inertial><origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><mass value="4"/>'
        '<inertia ixx="0.2" ixy="0.01" ixz="0.02" iyy="0.3" iyz="0.03" izz="0.4"/></inertial>'
    )
    inertial = parse(robot(link("a", inside))).links["a"].inertial
    assert inertial is not None
    assert inertial.origin == Pose((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    assert inertial.mass == 4.0
    assert inertial.inertia == (0.2, 0.01, 0.02, 0.3, 0.03, 0.4)


def test_every_primitive_shape_is_read_with_its_place_and_name() -> None:
    shapes = (
        '<collision name="c1"><origin xyz="0 0 1"/><geometry><box size="1 2 3"/></geometry></collision>'
        '<collision><geometry><cylinder radius="0.5" length="2"/></geometry></collision>'
        '<visual><geometry><sphere radius="0.25"/></geometry></visual>'
    )
    read = parse(robot(link("a", INERTIAL + shapes))).links["a"]
    assert read.collisions[0].name == "c1"
    assert read.collisions[0].origin.xyz == (0.0, 0.0, 1.0)
    assert [shape.geometry for shape in read.collisions] == [Box((1.0, 2.0, 3.0)), Cylinder(0.5, 2.0)]
    assert read.visuals[0].geometry == Sphere(0.25)


def test_a_visual_names_a_global_material_or_brings_its_own() -> None:
    def visual(material: str) -> str:
        return f'<visual><geometry><sphere radius="1"/></geometry>{material}</visual>'

    bot = parse(
        robot(
            '<material name="blue"><color rgba="0 0 1 1"/></material>',
            link("a", INERTIAL + visual('<material name="blue"/>') + visual('<material name="red"/>')),
            joint(parent="a", child="b"),
            link("b", INERTIAL + visual('<material name="red"><color rgba="1 0 0 0.5"/></material>')),
            joint("k", parent="b", child="c"),
            link("c", INERTIAL + visual('<material name="red"/>')),
        )
    )
    blue, unknown = bot.links["a"].visuals
    assert blue.material == Material("blue", (0.0, 0.0, 1.0, 1.0))
    assert unknown.material == Material("red")
    assert bot.links["c"].visuals[0].material == Material("red", (1.0, 0.0, 0.0, 0.5))
    assert [notice.verdict for notice in bot.report] == ["wrong"]


def test_an_axis_becomes_a_unit_vector_and_the_report_says_so() -> None:
    bot = parse(cart(joint_inside=LIMIT + '<axis xyz="0 3 4"/>'))
    assert bot.joints["slide"].axis == pytest.approx((0.0, 0.6, 0.8))
    assert [notice.verdict for notice in bot.report] == ["converted"]


def test_an_axis_of_length_one_stays_bit_for_bit() -> None:
    third = 1 / math.sqrt(3)
    bot = parse(cart(joint_inside=LIMIT + f'<axis xyz="{third!r} {third!r} {third!r}"/>'))
    assert bot.joints["slide"].axis == (third, third, third)
    assert not bot.report


def test_the_axis_is_x_when_none_is_given() -> None:
    assert parse(cart()).joints["slide"].axis == (1.0, 0.0, 0.0)


def test_limits_dynamics_and_safety_controller_are_read() -> None:
    inside = (
        '<limit lower="-1.5" upper="2" effort="30" velocity="4"/><dynamics damping="0.7" friction="0.1"/>'
        '<safety_controller soft_lower_limit="-1" soft_upper_limit="1.5" k_position="20" k_velocity="5"/>'
    )
    slide = parse(cart(joint_inside=inside)).joints["slide"]
    assert slide.limit == Limit(-1.5, 2.0, 4.0, 30.0, 4)
    assert (slide.damping, slide.friction) == (0.7, 0.1)
    assert slide.safety == Safety(-1.0, 1.5, 20.0, 5.0)


def test_limits_the_wrong_way_round_are_swapped_and_reported() -> None:
    bot = parse(cart(joint_inside='<limit lower="1" upper="-1" effort="1" velocity="1"/>'))
    limit = bot.joints["slide"].limit
    assert limit is not None
    assert (limit.lower, limit.upper) == (-1.0, 1.0)
    assert "swapped" in str(bot.report[0])


def test_a_continuous_joint_may_have_no_limit_at_all() -> None:
    bot = parse(robot('<link name="world"/>', link("cart"), joint(kind="continuous", inside="")))
    assert bot.joints["slide"].limit is None


def test_a_mimic_joint_follows_with_factor_and_offset() -> None:
    bot = parse(
        cart(
            link("finger"),
            joint("follow", parent="cart", child="finger", inside=LIMIT + '<mimic joint="slide" multiplier="-2"/>'),
        )
    )
    assert bot.joints["follow"].mimic == Mimic("slide", -2.0, 0.0)


def test_a_massless_link_may_move_when_a_link_fixed_to_it_has_mass() -> None:
    bot = parse(
        robot(
            '<link name="world"/>',
            link("frame", ""),
            joint(child="frame"),
            joint("weld", "fixed", "frame", "body", ""),
            link("body"),
        )
    )
    assert bot.links["frame"].inertial is None


def test_numbers_may_have_signs_exponents_and_blanks_around_them() -> None:
    bot = parse(cart(joint_inside='<limit lower=" -1e0 " upper="+.5" effort="1E2" velocity="2."/>'))
    assert bot.joints["slide"].limit == Limit(-1.0, 0.5, 2.0, 100.0, 4)


def test_blank_lines_before_the_xml_declaration_do_no_harm_and_lines_still_count() -> None:
    bot = parse('\n\n<?xml version="1.0"?>\n' + cart())
    assert bot.joints["slide"].line == 7


def test_lines_are_those_where_tags_begin_even_when_they_go_over_many() -> None:
    xml = robot(link("world", ""), link("cart", INERTIAL), '<joint\n name="slide"\n type="fixed"\n>')
    xml = xml.replace("</robot>", '<parent link="world"/><child link="cart"/></joint></robot>')
    assert parse(xml).joints["slide"].line == 4


def test_other_encodings_are_read_as_they_declare() -> None:
    xml = '<?xml version="1.0" encoding="iso-8859-1"?>' + robot(link("glänzend"))
    assert parse(xml.encode("iso-8859-1")).root == "glänzend"
    assert parse(xml).root == "glänzend"
