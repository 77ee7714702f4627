"""Models: each tag and attribute has a verdict, once, and what makes no sense is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from check_texts import BALL, INERTIAL, LIMIT, PLUGIN, Check, Lines, cart, driven_cart, transmission

from slidectl.check.dispatch import check
from slidectl.description import Packages
from slidectl.errors import BadFile, UnknownName


def shipped(name: str, second_opinion: bool = False) -> Lines:
    return Lines(check([name], {}, Packages(), second_opinion=second_opinion))


def test_everything_in_a_sound_robot_is_used(model: Check) -> None:
    lines = model(driven_cart())
    assert lines.of("converted", "ignored", "wrong") == []
    assert "used 3 link 'cart'/<inertial>/<mass>: value=\"1\"" in lines.all
    assert "used 5 transmission 't_slide'/<actuator name=\"m\">/<mechanicalReduction>: 1" in lines.all
    assert 'used 6 <gazebo>/<plugin name="c">/<robotNamespace>: /bot' in lines.all


def test_every_tag_and_attribute_is_listed_once(model: Check) -> None:
    xml = driven_cart()
    lines = model(xml)
    subjects = [line.split(": ")[0] for line in lines.of("used") if "note:" not in line]
    assert len(subjects) == len(set(subjects))
    tags = xml.count("<") - xml.count("</")
    limits = len(("lower", "upper", "effort", "velocity"))
    assert len(subjects) == tags - len(["limit"]) + limits


def test_a_limit_is_listed_with_its_unit_and_what_it_does(model: Check) -> None:
    sliding, turning = model(driven_cart()), model(driven_cart(kind="revolute"))
    assert sliding.about("<limit>, effort") == [
        "used 4 joint 'slide'/<limit>, effort: 10 N; bounds what pushes the joint"
    ]
    assert "2 m/s;" in sliding.about("<limit>, velocity")[0]
    assert "10 N·m;" in turning.about("<limit>, effort")[0]
    assert "-1 rad;" in turning.about("<limit>, lower")[0]


ODD = [
    ("<kp>1</kp>", 'ignored 7 <gazebo reference="cart">/<kp>: has no effect here'),
    ("<mu1>1</mu1><mu2>1</mu2>", 'used 7 <gazebo reference="cart">/<mu2>: 1'),
    ("<mu1>1</mu1><mu2>2</mu2>", "ignored 7 link 'cart'/<mu2>: has no effect: friction is the same in all directions"),
    ("<selfCollide>maybe</selfCollide>", "wrong 7 <gazebo reference=\"cart\">/<selfCollide>: 'maybe' is neither"),
]


@pytest.mark.parametrize(("inside", "expected"), ODD)
def test_tags_of_gazebo_are_judged_by_what_the_world_makes_of_them(model: Check, inside: str, expected: str) -> None:
    lines = model(driven_cart(f'<gazebo reference="cart">{inside}</gazebo>'))
    assert [line for line in lines.all if line.startswith(expected)], "\n".join(lines.about("gazebo"))


def test_an_attribute_without_effect_is_ignored_and_the_others_are_used(model: Check) -> None:
    lines = model(driven_cart(joint=LIMIT + '<dynamics damping="1" spring="2"/>'))
    assert len(lines.about("spring")) == 1
    assert lines.about("spring")[0].startswith("ignored 4 joint 'slide'/<dynamics>: attribute 'spring'")
    assert lines.about("<dynamics>, damping") == [
        "used 4 joint 'slide'/<dynamics>, damping: 1 N·s/m; acts against the velocity"
    ]


def test_what_the_parser_knows_but_does_not_read_is_ignored(model: Check) -> None:
    lines = model(cart(transmission().replace("<transmission ", '<transmission type="old" '), PLUGIN))
    assert lines.of("ignored") == ["ignored 5 transmission 't_slide', attribute 'type': is not read"]


def test_nothing_below_an_ignored_tag_is_used(model: Check) -> None:
    sensor = '<sensor name="s"><update_rate>40</update_rate><ray><scan/></ray></sensor>'
    lines = model(driven_cart(f'<gazebo reference="cart">{sensor}</gazebo>'))
    assert lines.about("sensor") == [
        'used 7 <gazebo reference="cart">: with <sensor>',
        'ignored 7 <gazebo reference="cart">/<sensor name="s">: has no effect: '
        "sensors here are ray, gpu_ray, imu, contact, camera, not ''",
    ]
    assert not lines.about("update_rate")


def test_limits_the_wrong_way_round_are_converted_and_not_used_as_well(model: Check) -> None:
    lines = model(driven_cart(joint=LIMIT.replace('lower="-1"', 'lower="3"')))
    assert lines.of("converted") == ["converted 4 joint 'slide'/<limit>: lower 3 is above upper 1; they are swapped"]
    assert not lines.about("<limit>, lower")
    assert lines.about("<limit>, effort")


def test_a_joint_without_a_transmission_moves_freely_and_its_limits_bound_less(model: Check) -> None:
    lines = model(cart())
    assert "no transmission drives it" in lines.about("joint 'slide': note")[0]
    assert "bounds forces from outside only" in lines.about("<limit>, effort")[0]


def test_a_joint_without_limits_is_pointed_out(model: Check) -> None:
    lines = model(driven_cart(joint="", kind="continuous"))
    assert "without <limit>: neither its effort nor its velocity is bounded" in lines.about("joint 'slide': note")[0]


def test_a_limit_of_zero_on_a_driven_joint_is_wrong(model: Check) -> None:
    lines = model(driven_cart(joint=LIMIT.replace('effort="10"', 'effort="0"')))
    assert "the effort limit of joint 'slide' is 0" in lines.of("wrong")[0]


def test_transmissions_without_a_plugin_are_driven_all_the_same(model: Check) -> None:
    (line,) = model(cart(transmission())).of("converted")
    assert line.startswith("converted 1 robot 'bot': has transmissions but no libgazebo_ros_control.so")
    assert line.endswith("in the namespace /bot")


def test_a_plugin_without_transmissions_drives_nothing(model: Check) -> None:
    assert model(cart(PLUGIN)).about("without a transmission it drives no joint")


def test_an_interface_of_the_actuator_that_says_otherwise_is_ignored(model: Check) -> None:
    other = "<hardwareInterface>hardware_interface/VelocityJointInterface</hardwareInterface>"
    lines = model(cart(transmission().replace("<mechanicalReduction>", other + "<mechanicalReduction>"), PLUGIN))
    (line,) = lines.of("ignored")
    assert "VelocityJointInterface has no effect: the joint's interface counts" in line
    assert line.startswith("ignored 5")


def test_a_limit_is_used_when_one_of_several_interfaces_has_a_use_for_it(model: Check) -> None:
    kind = "<hardwareInterface>hardware_interface/{}JointInterface</hardwareInterface>"
    safety = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="0.5" k_position="1" k_velocity="2"/>'
    plugin = PLUGIN.replace("</robotNamespace>", "</robotNamespace><transmissions>real</transmissions>")
    for names, verdict in ((("Position", "Effort"), "used"), (("Position", "Velocity"), "ignored")):
        several = transmission().replace(kind.format("Effort"), "".join(map(kind.format, names)))
        lines = model(cart(several, plugin, joint=LIMIT + safety))
        assert lines.about("<safety_controller>, k_velocity")[0].startswith(verdict), lines.all
        assert "bounds what pushes the joint" in lines.about("<limit>, effort")[0]


def test_a_control_period_between_two_steps_is_rounded_up(model: Check) -> None:
    plugin = PLUGIN.replace("</plugin>", "<controlPeriod>0.0025</controlPeriod></plugin>")
    (line,) = model(cart(transmission(), plugin)).of("converted")
    assert line.endswith("controllers run every 0.003 s")


def inertia(mass: float, moment: float, at: str = "0 0 0") -> str:
    return INERTIAL.replace('value="1"', f'value="{mass}"').replace("0.01", f"{moment}").replace("0 0 0", at)


def test_more_inertia_than_mass_and_size_can_have_is_wrong(model: Check) -> None:
    (line,) = model(driven_cart(link=inertia(0.1, 10) + BALL)).of("wrong")
    assert line.startswith("wrong 3 link 'cart'/<inertial>: 0.1 kg within its shapes have moments of at most")


def test_a_little_too_much_inertia_is_a_note(model: Check) -> None:
    lines = model(driven_cart(link=inertia(0.1, 0.1) + BALL))
    assert lines.of("wrong") == []
    assert len(lines.about("<inertial>: note", "within its shapes")) == 1


def test_less_inertia_than_the_densest_matter_has_is_wrong(model: Check) -> None:
    (line,) = model(driven_cart(link=inertia(1, 1e-9))).of("wrong")
    assert "no matter is so dense" in line


def test_a_centre_of_mass_outside_of_the_body_is_a_note(model: Check) -> None:
    lines = model(driven_cart(link=inertia(1, 0.01, "5 0 0") + BALL))
    assert lines.about("the centre of mass, 5 0 0, lies outside of its shapes")


BROKEN = [
    (transmission("slyde"), 5, "no joint 'slyde'. Did you mean 'slide'?"),
    ('<gazebo reference="cart"><mu1>x</mu1></gazebo>', 5, "which is not a number"),
]


@pytest.mark.parametrize(("part", "line", "reason"), BROKEN)
def test_a_broken_part_is_named_and_the_rest_is_checked(model: Check, part: str, line: int, reason: str) -> None:
    lines = model(cart(part, transmission(), PLUGIN, '<gazebo reference="nobody"/>'))
    assert [error.line for error in lines.findings.broken] == [line]
    assert [found for found in lines.of("wrong") if reason in found and found.startswith(f"wrong {line}")]
    assert lines.about("there is no link or joint 'nobody'")
    assert lines.about("used", "link 'cart'/<inertial>/<mass>")


def test_a_model_that_is_no_robot_has_one_finding_and_cannot_be_used(model: Check) -> None:
    lines = model(cart().replace('<mass value="1"/>', '<mass value="one"/>'))
    assert [error.line for error in lines.findings.broken] == [3]
    assert "link 'cart': 'value' of <mass> is 'one'" in lines.of("wrong")[-1]


def test_a_dropped_transmission_is_wrong_and_nothing_in_it_is_used(model: Check) -> None:
    lines = model(cart(transmission().replace("<type>transmission_interface/SimpleTransmission</type>", ""), PLUGIN))
    assert lines.of("wrong") == [
        'wrong 5 <transmission name="t_slide">: the transmission is dropped: <type> is missing; '
        "add <type>transmission_interface/SimpleTransmission</type>"
    ]
    assert not lines.about("mechanicalReduction")


def test_findings_of_macros_and_includes_name_the_line_where_things_were_written(model: Check, write: Check) -> None:
    macro = '<xacro:macro name="m" params="n">\n<link name="${n}" colour="red"/>\n</xacro:macro>'
    write("part.xacro", f'<robot xmlns:xacro="x">\n{macro}</robot>')
    text = '<robot name="bot" xmlns:xacro="x"><xacro:include filename="part.xacro"/>\n<xacro:m n="world"/></robot>'
    lines = model(text, name="bot.xacro")
    (notice,) = [notice for notice in lines.findings.sorted() if notice.verdict == "ignored"]
    assert notice.where.endswith("part.xacro:3")


def test_arguments_of_the_model_are_listed_with_their_values(model: Check) -> None:
    declared = '<xacro:arg name="a" default="1"/><xacro:arg name="b" default="2"/>'
    text = f'<robot name="bot" xmlns:xacro="x">\n{declared}\n<link name="world"/></robot>'
    lines = model(text, name="bot.xacro", a="7", c="8")
    assert "used 2 argument a: '7', as given" in lines.all
    assert "used 2 argument b: '2', by default" in lines.all
    assert lines.of("ignored")[0].startswith("ignored None c:=: the file has no such argument")


def test_a_mesh_that_cannot_be_read_is_wrong_and_one_that_collides_is_its_hull(model: Check, write: Check) -> None:
    write("good.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    write("bad.stl", "no mesh")
    seen = '<visual><geometry><mesh filename="bad.stl"/></geometry></visual>'
    touched = '<collision><geometry><mesh filename="good.obj"/></geometry></collision>'
    lines = model(driven_cart(link=INERTIAL + seen + touched))
    assert [line for line in lines.of("wrong") if "<visual>/<mesh>" in line and "bad.stl" in line]
    assert [line for line in lines.of("converted") if "collides as its convex hull" in line]


@pytest.mark.parametrize("name", ["slider", "rrbot"])
def test_the_shipped_models_have_nothing_wrong(name: str) -> None:
    lines = shipped(name)
    assert lines.of("wrong", "converted") == []
    assert [line for line in lines.of("ignored") if "<sensor" not in line or "<plugin" in line] == []


def test_another_reader_is_asked_for_its_opinion(capfd: pytest.CaptureFixture[str]) -> None:
    lines = shipped("slider", second_opinion=True)
    assert lines.about("yourdfpy reads the same tree, masses and limits")
    assert capfd.readouterr() == ("", "")


def test_a_reader_that_fails_is_a_remark_only(write: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    import yourdfpy

    def fail(*_: object, **__: object) -> None:
        print("noise")
        raise RuntimeError("no idea")

    monkeypatch.setattr(yourdfpy.URDF, "load", fail)
    lines = Lines(check([str(write("bot.urdf", driven_cart()))], {}, Packages(), second_opinion=True))
    assert lines.of("wrong") == []
    assert lines.about("yourdfpy cannot read it: no idea")


def test_a_file_that_is_not_there_is_an_error_and_no_finding(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match="no such file"):
        check([str(tmp_path / "none.urdf")], {}, Packages())
    with pytest.raises(UnknownName, match="Did you mean 'slider'"):
        check(["slidr"], {}, Packages())


def tree(*joints: str, more: str = "") -> str:
    """Links a, b and c, each on a line, joints from line 6 on, and behind them a tag that nobody knows."""
    links = [f'<link name="{name}">{INERTIAL}</link>' for name in "abc"]
    return "\n".join(['<robot name="r">', '<link name="world"/>', *links, *joints, more + "<unknown/></robot>"])


def joint(name: str, parent: str, child: str, kind: str = "continuous") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'


SOUND = joint("one", "world", "a"), joint("two", "a", "b"), joint("three", "b", "c")
BROKEN = {
    "type": (tree(joint("one", "world", "a", "continous"), *SOUND[1:]), ["wrong 6 no joint type 'continous'"]),
    "no type": (tree(SOUND[0].replace("type", "tipe"), *SOUND[1:]), ["wrong 6 lacks the attribute 'type'"]),
    "no name": (tree(SOUND[0].replace("name", "nom"), *SOUND[1:]), ["wrong 6 lacks the attribute 'name'"]),
    "parent": (tree(SOUND[0], joint("two", "aa", "b"), SOUND[2]), ["wrong 7 parent: no link 'aa'"]),
    "child": (tree(*SOUND[:2], joint("three", "b", "cc")), ["wrong 8 child: no link 'cc'"]),
    "no child": (tree(*SOUND[:2], SOUND[2].replace('<child link="c"/>', "")), ["wrong 8 lacks <child>"]),
    "twin joint": (tree(*SOUND[:2], joint("two", "b", "c")), ["wrong 8 duplicate joint 'two'"]),
    "twin link": (tree(*SOUND, more='<link name="a"/>'), ["wrong 9 duplicate link 'a'"]),
    "two roots": (tree(*SOUND, more='<link name="lonely"/>'), ["wrong 9 the robot has more than one root link"]),
    "two parents": (tree(*SOUND, joint("four", "a", "c")), ["wrong 9 link 'c' is the child of two joints"]),
    "circle": (tree(joint("one", "c", "a"), *SOUND[1:]), ["wrong 6 links go round in a circle"]),
    "several": (
        tree(joint("one", "wrld", "a"), joint("two", "aa", "b"), joint("three", "b", "c", "fixd")),
        ["wrong 8 no joint type 'fixd'"],
    ),
    "several ends": (
        tree(joint("one", "wrld", "a"), joint("two", "aa", "b"), SOUND[2]),
        ["wrong 6 parent: no link 'wrld'", "wrong 7 parent: no link 'aa'"],
    ),
}


@pytest.mark.parametrize(("xml", "faults"), BROKEN.values(), ids=BROKEN)
def test_a_tree_that_is_broken_is_named_and_the_rest_looked_at(model: Check, xml: str, faults: list[str]) -> None:
    lines = model(xml)
    wrong = lines.of("wrong")
    for fault in faults:
        start, text = fault[:7], fault[8:]
        assert [line for line in wrong if line.startswith(start) and text in line], (fault, wrong)
    assert len(wrong) == len(faults)
    assert any("<unknown>" in line for line in lines.of("ignored"))
    assert "used 5 link 'c'/<inertial>/<mass>: value=\"1\"" in lines.all


def test_a_fault_in_a_tag_of_gazebo_hides_no_other(model: Check) -> None:
    inside = "<mu1>abc</mu1><materal>Gazebo/Red</materal><selfCollide>maybe</selfCollide>"
    lines = model(driven_cart(f'<gazebo reference="cart">{inside}</gazebo>'))
    assert [line.split(": ")[0] for line in lines.of("wrong")] == [
        "wrong 7 <mu1>", 'wrong 7 <gazebo reference="cart">/<selfCollide>',
    ]  # fmt: skip
    assert "<materal>: has no effect here; did you mean <material>?" in lines.of("ignored")[0]


def test_the_type_of_noise_is_read_and_an_unknown_one_is_told(model: Check) -> None:
    def noise(kind: str) -> str:
        return (
            '<gazebo reference="cart"><sensor type="ray" name="s"><update_rate>10</update_rate><ray>'
            f"<range><min>0.1</min><max>5</max></range><noise><type>{kind}</type><mean>0</mean><stddev>0.01</stddev></noise></ray>"
            '<plugin name="p" filename="libgazebo_ros_laser.so"/></sensor></gazebo>'
        )

    for kind in ("gaussian", "none"):
        assert model(driven_cart(noise(kind))).about("<type>", "not read") == []
    assert model(driven_cart(noise("none"))).about("<stddev>", "not read") != []
    assert model(driven_cart(noise("uneven"))).about("ignored", "<noise>", "gaussian or none, not 'uneven'") != []
