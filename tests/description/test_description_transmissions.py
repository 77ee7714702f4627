"""Transmissions are taken or dropped as ros_control's parser does, and each drop is a notice."""

from __future__ import annotations

import pytest
from description_urdf_text import TRANSMISSION, cart, joint, link, robot

from slidectl.description import parse
from slidectl.description.robot import TransmissionActuator, TransmissionInfo, TransmissionJoint
from slidectl.errors import BadFile

TYPE = "<type>transmission_interface/SimpleTransmission</type>"
EFFORT = "<hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>"
JOINT = f'<joint name="slide">{EFFORT}</joint>'
ACTUATOR = '<actuator name="motor1"/>'


def transmission(inside: str, attributes: str = 'name="tran1"') -> str:
    return f"<transmission {attributes}>{inside}</transmission>"


def read(text: str) -> tuple[list[TransmissionInfo], list[str]]:
    bot = parse(cart(text), "bot.urdf")
    return list(bot.transmissions), [f"{notice.verdict} {notice}" for notice in bot.report]


def test_the_usual_transmission_is_read_without_a_word() -> None:
    infos, report = read(TRANSMISSION)
    assert report == []
    assert infos == [
        TransmissionInfo(
            "tran1",
            "transmission_interface/SimpleTransmission",
            (TransmissionJoint("slide", ("hardware_interface/EffortJointInterface",)),),
            (TransmissionActuator("motor1", (), 1.0),),
            5,
            "bot.urdf",
        )
    ]


def test_blanks_around_and_inside_texts_are_condensed() -> None:
    (info,), _ = read(transmission(f"<type>\n  a \n b </type>{JOINT}{ACTUATOR}"))
    assert info.type == "a b"


def test_another_type_of_one_joint_is_taken_as_a_simple_one_and_that_is_reported() -> None:
    _, report = read(transmission(f"<type>transmission_interface/Magic</type>{JOINT}{ACTUATOR}"))
    (notice,) = report
    assert notice.startswith('ignored bot.urdf:5: <transmission name="tran1">/<type>: transmission_interface/')
    assert "Magic has no effect" in notice
    assert read(transmission(f"<type>SimpleTransmission</type>{JOINT}{ACTUATOR}"))[1] == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (transmission(TYPE + JOINT + ACTUATOR, ""), "has no name"),
        (transmission(TYPE + JOINT + ACTUATOR, 'name=" "'), "has no name"),
        (transmission(JOINT + ACTUATOR, 'name="t" type="SimpleTransmission"'), "<type> is missing"),
        (transmission("<type/>" + JOINT + ACTUATOR), "<type> is empty"),
        (transmission("<type><!-- x -->y</type>" + JOINT + ACTUATOR), "a comment before its text hides it"),
        (transmission(TYPE + JOINT + f"<joint>{EFFORT}</joint>" + ACTUATOR), "a <joint> has no name"),
        (transmission(TYPE + ACTUATOR), "it has no <joint>"),
        (transmission(TYPE + JOINT), "it has no <actuator>"),
        (transmission(TYPE + JOINT + "<actuator/>" + ACTUATOR), "an <actuator> has no name"),
        (transmission(TYPE + '<joint name="slide"/>' + ACTUATOR), "no valid <joint> is left"),
        (transmission(TYPE + JOINT + '<actuator name=""/>'), "no valid <actuator> is left"),
    ],
)
def test_a_transmission_is_dropped_with_a_notice(text: str, reason: str) -> None:
    infos, report = read(text)
    assert infos == []
    assert report[-1].startswith("wrong bot.urdf:5: ")
    assert "the transmission is dropped: " in report[-1]
    assert reason in report[-1]


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        (f'<joint name="">{EFFORT}</joint>', "is skipped: its name is empty"),
        ('<joint name="slide"><hardwareInterface/></joint>', "is skipped: it has no <hardwareInterface> with a text"),
        ('<actuator name=""/>', "is skipped: its name is empty"),
    ],
)
def test_a_part_is_skipped_and_the_rest_stays(extra: str, reason: str) -> None:
    (info,), report = read(transmission(TYPE + JOINT + extra + ACTUATOR))
    assert (len(info.joints), len(info.actuators)) == (1, 1)
    assert reason in report[0]


def test_roles_offsets_and_reductions_are_read_and_those_with_no_effect_reported() -> None:
    inside = f"<role>joint1</role>{EFFORT}<offset>0.5</offset><mechanicalReduction>2</mechanicalReduction>"
    motor = '<actuator name="m"><role>actuator1</role><mechanicalReduction>50</mechanicalReduction></actuator>'
    (info,), report = read(transmission(TYPE + f'<joint name="slide">{inside}</joint>' + motor))
    assert info.joints[0] == TransmissionJoint(
        "slide", ("hardware_interface/EffortJointInterface",), "joint1", 0.5, 2.0
    )
    assert info.actuators[0].reduction == 50.0
    assert info.actuators[0].role == "actuator1"
    assert [line.split(": ")[2].split()[0] for line in report] == ["2", "0.5", "50"]
    assert all(line.startswith("ignored") for line in report)


def test_a_reduction_that_is_no_number_is_reported() -> None:
    motor = '<actuator name="m"><mechanicalReduction>fifty</mechanicalReduction></actuator>'
    (info,), (line,) = read(transmission(TYPE + JOINT + motor))
    assert info.actuators[0].reduction is None
    assert "'fifty', which is not a number" in line


def test_a_transmission_to_a_joint_that_is_not_there_is_an_error_with_a_suggestion() -> None:
    with pytest.raises(BadFile, match=r"bot.urdf:5: transmission 'tran1': no joint 'slid'. Did you mean 'slide'"):
        read(TRANSMISSION.replace('"slide"', '"slid"').replace("\n", " "))


def test_a_transmission_to_a_fixed_joint_is_an_error() -> None:
    xml = cart(link("b"), joint("weld", "fixed", "cart", "b", ""), TRANSMISSION.replace('"slide"', '"weld"'))
    with pytest.raises(BadFile, match="joint 'weld' is fixed and cannot be driven"):
        parse(xml)


def test_a_dropped_transmission_may_name_any_joint() -> None:
    infos, report = read('<transmission><joint name="nobody"/></transmission>')
    assert infos == []
    assert len(report) == 1


@pytest.mark.parametrize(
    ("interface", "verdict", "reason"),
    [
        ("EffortJointInterface", "converted", "is read as hardware_interface/EffortJointInterface"),
        ("hardware_interface::EffortJointInterface", "wrong", "is not an interface of simulated joints"),
        ("hardware_interface/JointStateInterface", "wrong", "known: hardware_interface/EffortJointInterface"),
    ],
)
def test_an_interface_without_its_prefix_or_of_another_kind_is_reported(
    interface: str, verdict: str, reason: str
) -> None:
    _, (line,) = read(TRANSMISSION.replace("hardware_interface/EffortJointInterface", interface))
    assert line.startswith(verdict)
    assert reason in line


def test_of_several_interfaces_the_first_counts_and_that_is_reported() -> None:
    (info,), (line,) = read(TRANSMISSION.replace(EFFORT, EFFORT + EFFORT.replace("Effort", "Velocity")))
    assert len(info.joints[0].hardware_interfaces) == 2
    assert "only the first counts, hardware_interface/EffortJointInterface" in line


def test_a_joint_driven_twice_is_reported() -> None:
    infos, (line,) = read(TRANSMISSION + TRANSMISSION.replace("tran1", "tran2"))
    assert len(infos) == 2
    assert "joint 'slide' is already driven by <transmission name=\"tran1\"> (line 5)" in line


def test_a_transmission_with_two_joints_is_for_no_simulated_hardware() -> None:
    xml = robot(
        link("world", ""),
        link("cart"),
        joint(),
        link("b"),
        joint("k", parent="cart", child="b"),
        transmission(TYPE + JOINT + JOINT.replace("slide", "k") + ACTUATOR),
    )
    bot = parse(xml)
    assert len(bot.transmissions[0].joints) == 2
    assert "one joint only" in str(bot.report[0])


@pytest.mark.parametrize("other", ["weld", "nobody"])
def test_a_transmission_with_two_joints_may_name_any_joint(other: str) -> None:
    """gazebo_ros_control passes over it before it looks for its joints: Franka's names a fixed one."""
    inside = TYPE + JOINT + JOINT.replace("slide", other) + ACTUATOR
    bot = parse(cart(link("b"), joint("weld", "fixed", "cart", "b", ""), transmission(inside)))
    assert "one joint only" in str(bot.report[0])


def test_a_driven_joint_with_a_limit_of_zero_is_pointed_out() -> None:
    bot = parse(cart(TRANSMISSION, joint_inside='<limit lower="-1" upper="1" effort="0" velocity="1"/>'))
    (notice,) = bot.report
    assert "the effort limit of joint 'slide' is 0" in str(notice)


def test_only_children_of_the_robot_are_transmissions() -> None:
    bot = parse(cart(f"<group>{TRANSMISSION}</group>"))
    assert bot.transmissions == ()
    assert "<group>: is unknown here" in str(bot.report[0])
