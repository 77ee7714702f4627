"""What a URDF may not be: each refusal names the link or joint, the file and the line."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from description_urdf_text import INERTIAL, LIMIT, cart, joint, link, robot

from slidectl.description import parse, yaml_tree
from slidectl.errors import EXIT_USAGE, BadFile

Refuse = Callable[[str], BadFile]


def inertial(mass: str = "1", moments: str = "1 0 0 1 0 1") -> str:
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{name}="{value}"' for name, value in zip(names, moments.split(), strict=True))
    return f'<inertial><mass value="{mass}"/><inertia {inertia}/></inertial>'


def geometry(shape: str) -> str:
    return f"{INERTIAL}<collision><geometry>{shape}</geometry></collision>"


LINKS = [
    ("", "the root, has no <inertial>, nor has a link fixed to it"),
    (inertial(mass="0"), "'arm' has a mass of 0 kg; it must be above 0"),
    (inertial(mass="-2"), "'arm' has a mass of -2 kg"),
    (inertial(mass="nan"), "not a finite number"),
    (inertial(mass="1,5"), "the decimal sign is a point"),
    (inertial(mass="heavy"), "is 'heavy', which is not a number"),
    (inertial(mass=""), "attribute 'value' of <mass> is empty"),
    (inertial(mass="1_0"), "not a number"),
    (inertial(mass="1e999"), "too large"),
    (inertial(moments="0 0 0 0 0 0"), "no body can have"),
    (inertial(moments="-1 0 0 1 0 1"), "each must be above 0"),
    (inertial(moments="1 0 0 1 0 3"), "none may exceed the sum of the other two"),
    (inertial(moments="1 2 0 1 0 1"), "each must be above 0"),
    ("<inertial><mass value='1'/></inertial>", "<inertial> lacks <inertia>"),
    ("<inertial/>", "<inertial> lacks <mass>"),
    (geometry(""), "<geometry> holds nothing; known shapes: box"),
    (geometry('<cone radius="1"/>'), "<geometry> holds cone"),
    (geometry('<box size="1 2"/>'), "2 numbers, expected 3"),
    (geometry('<box size="1 0 1"/>'), "no volume"),
    (geometry('<box size="1 -1 1"/>'), "above 0"),
    (geometry("<box/>"), "<box> lacks the attribute 'size'"),
    (geometry('<sphere radius="-1"/>'), "must not be negative"),
    (geometry('<cylinder radius="1" length="inf"/>'), "not a finite number"),
    (geometry('<mesh filename="a.stl" scale="1 0 1"/>'), "has no volume"),
    (geometry("<mesh/>"), "lacks the attribute 'filename'"),
    (f"{INERTIAL}<collision/>", "<collision> lacks <geometry>"),
    (f'{INERTIAL}<visual><origin xyz="1 2 3 4"/></visual>', "<visual> lacks <geometry>"),
]


@pytest.mark.parametrize(("inside", "reason"), LINKS)
def test_an_impossible_link_is_named_with_its_line(refuse: Refuse, inside: str, reason: str) -> None:
    error = refuse(robot(link("arm", inside)))
    assert "'arm'" in str(error)
    assert reason in str(error)
    assert (error.file, error.line) == ("bot.urdf", 2)
    assert error.exit_code == EXIT_USAGE


JOINTS = [
    ("", "is prismatic and lacks <limit>"),
    ('<limit lower="-1" upper="1" velocity="1"/>', "lacks the attribute 'effort'"),
    ('<limit lower="-1" upper="1" effort="1"/>', "lacks the attribute 'velocity'"),
    ('<limit effort="-1" velocity="1"/>', "must not be negative"),
    (LIMIT + '<axis xyz="0 0 0"/>', "not a direction"),
    (LIMIT + '<axis xyz="1 0"/>', "2 numbers, expected 3"),
    (LIMIT + '<origin xyz="a b c"/>', "not a number"),
    (LIMIT + '<dynamics damping="-1"/>', "must not be negative"),
    (LIMIT + "<safety_controller/>", "lacks the attribute 'k_velocity'"),
    (LIMIT + '<mimic joint="nobody"/>', "no joint 'nobody'"),
    (LIMIT + '<mimic joint="slide"/>', "round in a circle: slide - slide"),
    (LIMIT + "<mimic/>", "lacks the attribute 'joint'"),
]


@pytest.mark.parametrize(("inside", "reason"), JOINTS)
def test_an_impossible_joint_is_named_with_its_line(refuse: Refuse, inside: str, reason: str) -> None:
    error = refuse(cart(joint_inside=inside))
    assert "slide" in str(error)
    assert reason in str(error)
    assert (error.file, error.line) == ("bot.urdf", 4)


def test_an_unknown_joint_type_lists_the_known_ones_and_the_closest(refuse: Refuse) -> None:
    error = refuse(robot(link("a"), link("b"), joint("j", "revolut", "a", "b")))
    assert "Did you mean 'revolute'?" in str(error)
    assert "prismatic" in str(error)


def test_a_joint_to_a_missing_link_names_the_links_that_exist(refuse: Refuse) -> None:
    error = refuse(robot(link("base"), joint("j", parent="bace", child="base")))
    assert "joint 'j': parent: no link 'bace'. Did you mean 'base'?" in str(error)
    assert error.line == 3


def test_a_joint_without_parent_or_child_is_refused(refuse: Refuse) -> None:
    assert "lacks <parent>" in str(refuse(robot(link("a"), '<joint name="j" type="fixed"/>')))


@pytest.mark.parametrize("kind", ["link", "joint"])
def test_two_of_one_name_are_refused_with_both_lines(refuse: Refuse, kind: str) -> None:
    twice = {
        "link": robot(link("a", ""), link("a", "")),
        "joint": robot(joint("a", parent="x", child="y"), joint("a", parent="x", child="y")),
    }
    error = refuse(twice[kind])
    assert f"duplicate {kind} 'a'; the first is at bot.urdf:2" in str(error)
    assert error.line == 3


def test_a_link_below_two_joints_is_refused(refuse: Refuse) -> None:
    error = refuse(robot(link("a"), link("b"), joint("j", "fixed", "a", "b"), joint("k", "fixed", "a", "b")))
    assert "link 'b' is the child of two joints, 'j' and 'k'" in str(error)


def test_links_in_a_circle_are_named(refuse: Refuse) -> None:
    circle = robot(
        link("root"), link("a"), link("b"), joint("j", parent="a", child="b"), joint("k", parent="b", child="a")
    )
    assert "links go round in a circle" in str(refuse(circle))
    assert "a - b - a" in str(refuse(circle)) or "b - a - b" in str(refuse(circle))


def test_a_link_joined_to_itself_is_a_circle(refuse: Refuse) -> None:
    assert "circle: a - a" in str(refuse(robot(link("a"), joint("j", parent="a", child="a"))))


def test_two_roots_are_refused_and_named(refuse: Refuse) -> None:
    error = refuse(robot(link("a"), link("b")))
    assert "more than one root link: a, b" in str(error)


def test_a_robot_without_links_is_refused(refuse: Refuse) -> None:
    assert "no link" in str(refuse('<robot name="empty"/>'))


def test_a_moving_link_without_mass_is_named(refuse: Refuse) -> None:
    error = refuse(cart(link_inside="<visual><geometry><sphere radius='1'/></geometry></visual>"))
    assert "link 'cart', moved by joint 'slide', has no <inertial>" in str(error)
    assert error.line == 3


def test_a_free_root_without_mass_is_named(refuse: Refuse) -> None:
    error = refuse(robot(link("base", ""), link("arm"), joint(parent="base", child="arm")))
    assert "link 'base', the root, has no <inertial>" in str(error)
    assert "--fixed" in str(error)


def test_mimics_in_a_circle_are_refused(refuse: Refuse) -> None:
    error = refuse(
        robot(
            link("world", ""),
            link("a"),
            link("b"),
            joint("j", child="a", inside=LIMIT + '<mimic joint="k"/>'),
            joint("k", child="b", inside=LIMIT + '<mimic joint="j"/>'),
        )
    )
    assert "round in a circle: j - k - j" in str(error)


def test_a_mimic_of_a_fixed_joint_is_refused(refuse: Refuse) -> None:
    error = refuse(
        cart(link("b"), joint("weld", "fixed", "cart", "b", ""), joint_inside=LIMIT + '<mimic joint="weld"/>')
    )
    assert "cannot mimic 'weld', which is fixed" in str(error)


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        ("", "no element found"),
        ("just text", "not well-formed"),
        ("<robot", "unclosed token"),
        ("<robot name='a'><link></robot>", "mismatched tag"),
        ("<robot name='a'>\n<link>\n</robot>", "</link> is missing: its element begins in line 2"),
        ("<robot name='a'>\n<link name='${a < b}'/></robot>", "a < within a value is written &lt;"),
        ("\n<robot name='a'><link name='${a && b}'/></robot>", "an & is written &amp;"),
        ("<robot name='a'><!-- wheels -- and so on --></robot>", "may not hold two hyphens in a row"),
        ("<sdf/>", "the outermost element is <sdf>, expected <robot>"),
        ("<robot/>", "lacks the attribute 'name'"),
        ("<robot name='a'>\x00</robot>", "not well-formed"),
        ("<robot name='\udc80'/>", "cannot be decoded"),
        ("<?xml version='1.0' encoding='nonsense'?><robot name='a'/>", "the robot has no link"),
        ("<robot name='a'>" + "<a>" * 300 + "</a>" * 300 + "</robot>", "nested deeper than 200"),
        ("<robot name='a'>" + "<link/>" * 200_001 + "</robot>", "more than 200000 elements"),
        ("<robot name='" + "a" * 17_000_000 + "'/>", "larger than 16 MiB"),
    ],
    ids=lambda value: value[:30],
)
def test_what_is_no_robot_at_all_is_refused_clearly(refuse: Refuse, xml: str, reason: str) -> None:
    assert reason in str(refuse(xml))


BOMB = """<?xml version="1.0"?>
<!DOCTYPE robot [
  <!ENTITY a "aaaaaaaaaa">
  <!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
]>
<robot name="&b;"/>"""


def test_an_entity_bomb_is_refused_where_it_is_declared(refuse: Refuse) -> None:
    error = refuse(BOMB)
    assert "entities are refused" in str(error)
    assert error.line == 3


def test_an_entity_from_a_file_is_refused(refuse: Refuse) -> None:
    error = refuse('<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>')
    assert "entities are refused" in str(error)


def test_an_entity_of_a_document_type_elsewhere_is_refused_and_nothing_fetched(refuse: Refuse) -> None:
    error = refuse('<!DOCTYPE robot SYSTEM "http://127.0.0.1:9/robot.dtd"><robot name="a">&x;</robot>')
    assert "unknown XML entity 'x'" in str(error)


def test_a_file_that_is_not_in_utf8_is_refused_with_what_to_do() -> None:
    with pytest.raises(BadFile, match="it is not UTF-8: save it as that"):
        parse("<robot name='café'/>".encode("latin-1"))


def test_a_file_of_parameters_that_would_take_minutes_is_refused() -> None:
    with pytest.raises(BadFile, match="is larger than 2 MiB"):
        yaml_tree.read(b"a: 1\n" * 1_000_000, "control.yaml")


PLANAR = '<gazebo><plugin name="p" filename="libgazebo_ros_planar_move.so">\n{}</plugin></gazebo>'
LASER = """<gazebo reference="arm"><sensor type="ray" name="l">
{}<plugin filename="libgazebo_ros_laser.so"/></sensor></gazebo>"""


@pytest.mark.parametrize(
    ("text", "tag"), [(PLANAR, "odometryRate"), (LASER, "update_rate")], ids=["of a drive", "of a sensor"]
)
def test_a_rate_that_no_clock_can_count_is_refused_with_its_line(refuse: Refuse, text: str, tag: str) -> None:
    xml = robot(link("arm", INERTIAL) + "\n" + text.format(f"<{tag}>1e-300</{tag}>"))
    error = refuse(xml)
    assert f"<{tag}> is 1e-300 Hz; it must not be negative, nor its period above 2147483647 s" in str(error)
    assert error.line == xml[: xml.index(f"<{tag}>")].count("\n") + 1
