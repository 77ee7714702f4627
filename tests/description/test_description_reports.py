"""Nothing is ignored in silence: what each tag without effect leaves in the report."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from description_urdf_text import INERTIAL, LIMIT, cart, joint, link, robot

Notices = Callable[[str], list[str]]

BALL = '<geometry><sphere radius="1"/></geometry>'

CART_LINK = [
    ("<inertial/>", "<inertial>: only the first <inertial> counts, line 3"),
    ('<collision group="x"><geometry><sphere radius="1"/></geometry></collision>', "attribute 'group' is unknown"),
    (
        '<collision><verbose value="1"/><geometry><sphere radius="1"/></geometry></collision>',
        "link 'cart'/<collision>/<verbose>: is unknown here and has no effect",
    ),
    (
        '<visual><geometry><sphere radius="1"/><box size="1 1 1"/></geometry></visual>',
        "only the first shape of a <geometry> counts",
    ),
    (
        '<visual><material name="m"><texture filename="a.png"/></material>' + BALL + "</visual>",
        "textures are not drawn",
    ),
    (
        '<visual><material name="m"><color rgba="2 0 0 1"/></material>' + BALL + "</visual>",
        "parts of a colour lie between 0 and 1",
    ),
    ('<visual><geometry><mesh filename="package://nope/a.dae"/></geometry></visual>', "no package 'nope'"),
    ('<visual><geometry><mesh filename="/no/such.stl"/></geometry></visual>', "looked for /no/such.stl"),
    ('<visual><geometry><mesh filename="/etc/passwd"/></geometry></visual>', "known: .stl, .obj, .dae"),
    ('<visual><geometry><mesh filename="http://a/b.stl"/></geometry></visual>', "begins with package://"),
]


@pytest.mark.parametrize(("inside", "reason"), CART_LINK)
def test_a_link_tag_without_effect_is_reported(notices: Notices, inside: str, reason: str) -> None:
    (line,) = notices(cart(link_inside=INERTIAL + inside))
    assert reason in line
    assert "bot.urdf:3:" in line


CART_JOINT = [
    ('<calibration rising="0"/>', "ignored", "need no calibration"),
    ('<dynamics damping="1" spring="2"/>', "ignored", "attribute 'spring' is unknown"),
    ("<hardwareInterface/>", "ignored", "is unknown here"),
    (
        '<safety_controller soft_lower_limit="-2" soft_upper_limit="0.5" k_position="1" k_velocity="1"/>',
        "wrong",
        "soft limits -2 to 0.5 lie outside of the hard ones, -1 to 1",
    ),
    (
        '<safety_controller soft_lower_limit="0.5" soft_upper_limit="-0.5" k_position="1" k_velocity="1"/>',
        "wrong",
        "soft_lower_limit is above soft_upper_limit",
    ),
    ('<safety_controller k_velocity="1"/>', "wrong", "with k_position 0 the soft limits allow no velocity"),
]


@pytest.mark.parametrize(("inside", "verdict", "reason"), CART_JOINT)
def test_a_joint_tag_without_effect_is_reported(notices: Notices, inside: str, verdict: str, reason: str) -> None:
    (line,) = notices(cart(joint_inside=LIMIT + inside))
    assert line.startswith(f"{verdict} bot.urdf:4: ")
    assert reason in line


@pytest.mark.parametrize("inside", ['<axis xyz="0 0 0"/>', LIMIT, '<dynamics damping="1"/>', '<mimic joint="slide"/>'])
def test_a_fixed_joint_has_neither_axis_nor_limits_nor_friction(notices: Notices, inside: str) -> None:
    (line,) = notices(cart(joint("weld", "fixed", "cart", "b", inside), link("b")))
    assert line.startswith("ignored bot.urdf:5: joint 'weld'/")


@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        ('<limit effort="1" velocity="1"/>', "the joint cannot move"),
        ('<limit lower="1" upper="2" effort="1" velocity="1"/>', "starts at 0, outside of its limits 1 to 2"),
    ],
)
def test_limits_that_leave_no_way_to_move_are_pointed_out(notices: Notices, limit: str, reason: str) -> None:
    (line,) = notices(cart(joint_inside=limit))
    assert line.startswith("wrong bot.urdf:4: joint 'slide'/<limit>: ")
    assert reason in line


def test_a_continuous_joint_has_no_range(notices: Notices) -> None:
    lines = notices(robot(link("world", ""), link("cart"), joint(kind="continuous")))
    assert [line.rpartition(": ")[2] for line in lines] == [
        "a continuous joint has no 'lower'",
        "a continuous joint has no 'upper'",
    ]


def test_unknown_tags_of_the_robot_are_reported_and_namespaces_are_not(notices: Notices) -> None:
    xml = cart("<sensor name='eye'/>").replace("<robot ", '<robot xmlns:xacro="http://x" colour="red" ')
    attribute, tag = notices(xml)
    assert "attribute 'colour' is unknown" in attribute
    assert '<sensor name="eye">: is unknown here' in tag


def test_an_inertia_of_the_world_has_no_effect(notices: Notices) -> None:
    (line,) = notices(robot(link("world")))
    assert "the world does not move" in line


def test_a_material_defined_twice_keeps_its_first_colour(notices: Notices) -> None:
    blue, red = (f'<material name="m"><color rgba="{rgba}"/></material>' for rgba in ("0 0 1 1", "1 0 0 1"))
    (line,) = notices(robot(link("world", ""), blue, red))
    assert "defined twice; the first one counts" in line


def test_of_many_unknown_attributes_the_first_are_named_and_the_rest_is_counted(notices: Notices) -> None:
    attributes = " ".join(f'a{number}="1"' for number in range(1500))
    lines = notices(robot(f'<link name="world" {attributes}/>'))
    assert len(lines) == 101
    assert "'a99'" in lines[99]
    assert "and 1400 more unknown attributes have no effect" in lines[100]


def test_a_report_of_a_hopeless_file_ends_with_how_many_more_there_are(notices: Notices) -> None:
    lines = notices(cart('<gazebo reference="nothing"/>' * 1500))
    assert len(lines) == 1001
    assert "500 more notices" in lines[-1]
