"""A check and the spawn of the same model never contradict each other: robots are checked, and then spawned."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from check_texts import BALL, INERTIAL, LIMIT, PLUGIN, cart, driven_cart, transmission
from hypothesis import given, settings
from hypothesis import strategies as st

from slidectl import description
from slidectl.check import Findings
from slidectl.check.dispatch import check
from slidectl.description import Packages
from slidectl.description.controllers_file import read
from slidectl.errors import SlidectlError
from slidectl.simulation import Simulation

SOFT = '<safety_controller soft_lower_limit="-.5" soft_upper_limit="0.5" k_position="10" k_velocity="10"/>'
MESH = '<{0}><geometry><mesh filename="package://nobody/a.stl"/></geometry></{0}>'


def plugin(*inside: str) -> str:
    return PLUGIN.replace("</plugin>", "".join(inside) + "</plugin>")


REAL = plugin("<transmissions>real</transmissions>")
FIRST = "<hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>"
SECOND = FIRST.replace("Effort", "Velocity")

ODD = {
    "sound": driven_cart(),
    "no plugin": cart(transmission()),
    "no transmission": cart(PLUGIN),
    "no interface": cart(transmission().replace("hardwareInterface>", "hardware_interface>"), PLUGIN),
    "old interface": cart(transmission(interface="EffortJointInterface"), PLUGIN),
    "unknown interface": cart(transmission(interface="hardware_interface/EffortJointInteface"), PLUGIN),
    "interface of C++": cart(transmission(interface="hardware_interface::EffortJointInterface"), PLUGIN),
    "two transmissions": cart(transmission(), transmission(), PLUGIN),
    "unknown joint": cart(transmission("slid"), PLUGIN),
    "fixed joint driven": driven_cart(kind="fixed", joint=""),
    "position": cart(transmission(interface="hardware_interface/PositionJointInterface"), PLUGIN, joint=LIMIT + SOFT),
    "hardware type": cart(transmission(), plugin("<robotSimType>gazebo_ros_control/Default</robotSimType>")),
    "short hardware type": cart(transmission(), plugin("<robotSimType>DefaultRobotHWSim</robotSimType>")),
    "position and velocity": cart(transmission(interface="hardware_interface/PosVelJointInterface"), PLUGIN),
    "real": cart(transmission(), REAL),
    "real of no kind": cart(transmission().replace("SimpleT", "SimpelT"), REAL),
    "real without reduction": cart(transmission().replace("<mechanicalReduction>1</mechanicalReduction>", ""), REAL),
    "real with several interfaces": cart(transmission().replace(FIRST, f"{SECOND}{FIRST}"), REAL),
    "real with an unknown interface": cart(transmission(interface="hardware_interface/Effort"), REAL),
    "real, twice": cart(transmission(), transmission(), REAL),
    "nearly real": cart(transmission(), REAL.replace("real", "reel")),
    "legacy": cart(transmission(), plugin("<legacyModeNS>true</legacyModeNS>")),
    "misspelt plugin": cart(transmission(), PLUGIN.replace("libgazebo", "gazebo")),
    "misspelt tags": driven_cart('<gazebo reference="cart"><mu>1</mu></gazebo><gazebo reference="crat"/><lnk/>'),
    "no inertial": driven_cart(link=BALL),
    "no mass": driven_cart(link=INERTIAL.replace('value="1"', 'value="0"')),
    "no limit": driven_cart(joint=""),
    "no effort": driven_cart(joint='<limit lower="-1" upper="1" velocity="2"/>'),
    "swapped": driven_cart(joint='<limit lower="1" upper="-1" effort="10" velocity="2"/>'),
    "no way": driven_cart(joint='<limit effort="10" velocity="2"/>'),
    "continuous": driven_cart(kind="continuous", joint=SOFT),
    "unknown mimic": driven_cart(joint=LIMIT + '<mimic joint="slid"/>'),
    "free": '<robot name="bot">' + f'<link name="base">{INERTIAL}{BALL}</link></robot>',
    "unseen mesh": driven_cart(link=INERTIAL + MESH.format("visual")),
    "missing mesh": driven_cart(link=INERTIAL + MESH.format("collision")),
    "broken mesh": driven_cart(link=INERTIAL + MESH.format("collision").replace("package://nobody/a", "bad")),
    "flat mesh": driven_cart(
        link=INERTIAL + MESH.format("collision").replace("package://nobody/a", "flat").replace("stl", "obj")
    ),
    "no name": driven_cart().replace(' name="bot"', ""),
    "no XML": "<robot",
    "two roots": driven_cart(f'<link name="other">{INERTIAL}</link>'),
}


def spawned(source: Path | str) -> tuple[Simulation | None, list[tuple[object, ...]]]:
    """The world with the robot, None when it is refused; and what the spawn reports."""
    simulation = Simulation(ground=False, engine="plain")
    try:
        document = description.load(source)
        simulation.spawn(document.xml, "bot")
    except SlidectlError:
        return None, []
    notices = (*document.report, *simulation.robots.get("bot").description.report)
    return simulation, [(n.verdict, n.file, n.line, n.subject) for n in notices]


def check_agreement(source: Path | str) -> Findings:
    findings = check([str(source)], {}, Packages())
    simulation, reported = spawned(source)
    assert bool(findings.broken) == (simulation is None)
    told = [(n.verdict, n.file, n.line, n.subject) for n in findings.sorted()]
    assert set(reported) <= set(told)
    without_effect = {
        place for verdict, *place in map(list, reported) if verdict == "ignored" for place in [tuple(place)]
    }
    assert not [entry for entry in told if entry[0] == "used" and entry[1:] in without_effect]
    return findings


@pytest.mark.parametrize("name", ["slider", "rrbot"])
def test_shipped_models_are_spawned_as_they_were_checked(name: str) -> None:
    path = description.models.shipped()[name]
    assert not check_agreement(path).broken


@pytest.mark.parametrize("name", ODD)
def test_odd_models_are_spawned_or_refused_as_they_were_checked(name: str, tmp_path: Path) -> None:
    path = tmp_path / "bot.urdf"
    path.write_text(ODD[name], "utf-8")
    (tmp_path / "bad.stl").write_text("solid nothing")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    check_agreement(path)


SAYS = PLUGIN.replace("</plugin>", "<transmissions>{}</transmissions></plugin>")


@pytest.mark.parametrize(
    ("own", "parameter", "option", "verdict", "is_real"),
    [
        (PLUGIN, "real", None, "used", True),
        (PLUGIN, "rael", None, "wrong", None),
        (SAYS.format("gazebo"), "real", None, "ignored", False),
        (SAYS.format("real"), "rael", None, "ignored", True),
        (PLUGIN, "real", "gazebo", "ignored", False),
    ],
)
def test_the_parameter_of_transmissions_is_judged_as_the_spawn_takes_it(
    tmp_path: Path, own: str, parameter: str, option: str | None, verdict: str, is_real: bool | None
) -> None:
    robot, control = tmp_path / "bot.urdf", tmp_path / "control.yaml"
    robot.write_text(cart(transmission(), own))
    control.write_text(f"bot: {{gazebo_ros_control: {{transmissions: {parameter}}}}}")
    findings = check([str(robot)], {}, Packages(), [control], transmissions=option)
    told = {(notice.subject, notice.verdict) for notice in findings.sorted()}
    assert ("/bot/gazebo_ros_control/transmissions", verdict) in told
    simulation, xml = Simulation(ground=False, engine="plain"), robot.read_text()
    simulation.parameters.set("/bot/gazebo_ros_control/transmissions", parameter)
    xml = xml if option is None else description.with_transmissions(xml, option)
    if is_real is None:
        with pytest.raises(SlidectlError, match="transmissions are gazebo or real, not 'rael'"):
            simulation.spawn(xml, "bot")
    else:
        simulation.spawn(xml, "bot")
        assert ("/bot/actuator_states" in simulation.call("/rosapi/topics")["topics"]) == is_real


def test_a_fault_that_real_transmissions_make_is_found_though_a_parameter_makes_them_real(tmp_path: Path) -> None:
    robot, control = tmp_path / "bot.urdf", tmp_path / "control.yaml"
    robot.write_text(cart(transmission().replace("SimpleT", "SimpelT"), PLUGIN))
    control.write_text("bot: {gazebo_ros_control: {transmissions: real}}")
    assert not check([str(robot)], {}, Packages()).broken
    (fault,) = check([str(robot)], {}, Packages(), [control]).broken
    assert "SimpelTransmission" in fault.message
    launch = tmp_path / "bot.launch"
    launch.write_text(
        f'<launch><param name="robot_description" textfile="{robot}"/>'
        '<param name="two/gazebo_ros_control/transmissions" value="real"/><node pkg="gazebo_ros" type="spawn_model"'
        ' name="s" args="-urdf -param robot_description -model two -robot_namespace two"/></launch>'
    )
    assert "SimpelTransmission" in check([str(launch)], {}, Packages()).broken[0].message


POSITION = "type: position_controllers/JointPositionController"
EFFORT = "type: effort_controllers/JointPositionController"
CONTROLLERS = {
    "sound": f"{EFFORT}, joint: slide, pid: {{p: 1.0, i: 1.0}}",
    "unknown parameter": f"{EFFORT}, joint: slide, pid: {{p: 1.0}}, more: 1",
    "unknown joint": f"{EFFORT}, joint: slid, pid: {{p: 1.0}}",
    "joints": f"{EFFORT}, joints: [slide], pid: {{p: 1.0}}",
    "list for a joint": f"{EFFORT}, joint: [slide], pid: {{p: 1.0}}",
    "no gains": f"{EFFORT}, joint: slide",
    "gains without a space": f"{EFFORT}, joint: slide, pid: 'p:1'",
    "text for a gain": f"{EFFORT}, joint: slide, pid: {{p: '1'}}",
    "other interface": f"{POSITION}, joint: slide",
    "unknown type": "type: effort_controllers/JointPositionControler, joint: slide",
    "type of C++": "type: effort_controllers::JointPositionController, joint: slide",
    "no rate": "type: joint_state_controller/JointStateController",
    "rate": "type: joint_state_controller/JointStateController, publish_rate: 50",
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_with_nothing_wrong_can_be_loaded_and_no_other(name: str, tmp_path: Path) -> None:
    robot, parameters = tmp_path / "bot.urdf", tmp_path / "control.yaml"
    robot.write_text(driven_cart())
    parameters.write_text(f"bot:\n  c: {{{CONTROLLERS[name]}}}\n")
    findings = check([str(robot)], {}, Packages(), [parameters])
    simulation, _ = spawned(robot)
    assert simulation is not None
    simulation.parameters.set("/bot/c", read(parameters)["bot"]["c"])
    loaded = simulation.call("/bot/controller_manager/load_controller", {"name": "c"})["ok"]
    assert loaded == (findings.count("wrong") == 0)


def chain(joints: int) -> str:
    links = "".join(f'<link name="l{index}">{INERTIAL}</link>' for index in range(joints + 1))
    welds = "".join(
        f'<joint name="j{index}" type="fixed"><parent link="l{index}"/><child link="l{index + 1}"/></joint>'
        for index in range(joints)
    )
    return f'<robot name="bot">{links}{welds}</robot>'


def plate(moments: str = "0.195728 0 0 0.332102 0 0.527831", mass: str = "1") -> str:
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{name}="{value}"' for name, value in zip(names, moments.split(), strict=True))
    inertial = f'<inertial><mass value="{mass}"/><inertia {inertia}/></inertial>'
    return f'<robot name="bot"><link name="a">{inertial}</link></robot>'


def shaped(shape: str) -> str:
    return driven_cart(link=f"{INERTIAL}<collision><geometry>{shape}</geometry></collision>")


TINY = '<mesh filename="tetrahedron.obj" scale="{0} {0} {0}"/>'
BAD = {
    "1000 joints deep": (chain(1000), True),
    "1001 joints deep": (chain(1001), False),
    "a plate": (plate(), True),
    "a turned plate": (plate("0.2639 0.0681 0 0.2639 0 0.5278"), True),
    "a mass below MuJoCo's least": (plate(mass="1e-16"), True),
    "a mass of next to nothing": (plate(mass="1e-320"), True),
    "moments below MuJoCo's least": (plate("1e-16 0 0 1e-16 0 1e-16"), True),
    "moments of next to nothing, turned": (plate("1e-14 1e-16 0 1e-14 0 1e-14"), True),
    "the triangle rule broken": (plate("1 0 0 1 0 2.06"), True),
    "sums beyond all numbers": (plate("1e308 0 0 1e308 0 -1e308"), False),
    "a sphere of 1e-324": (shaped('<sphere radius="1e-324"/>'), True),
    "a sphere of 5e-324": (shaped('<sphere radius="5e-324"/>'), True),
    "a box of 1e150": (shaped('<box size="1e150 1e100 1e100"/>'), True),
    "a mesh of a hundredth of a millimetre": (shaped(TINY.format("1e-5")), False),
    "a mesh of a tenth": (shaped(TINY.format("1e-4")), True),
    "a mesh of 1e150": (shaped(TINY.format("1e150")), False),
    "a mesh of 1e-320": (shaped(TINY.format("1e-320")), False),
    "a period beyond all durations": (cart(transmission(), plugin("<controlPeriod>1e308</controlPeriod>")), False),
    "a period of nothing": (cart(transmission(), plugin("<controlPeriod>1e-320</controlPeriod>")), True),
    "equal limits at the end of all numbers": (
        driven_cart(joint='<limit lower="1e308" upper="1e308" effort="1" velocity="2"/>'),
        True,
    ),
    "equal limits far out": (driven_cart(joint='<limit lower="1e16" upper="1e16" effort="1" velocity="2"/>'), True),
}


@pytest.mark.parametrize("name", BAD)
def test_a_check_refuses_what_the_physics_refuses_and_nothing_else(name: str, tmp_path: Path) -> None:
    text, is_taken = BAD[name]
    (tmp_path / "tetrahedron.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    path = tmp_path / "bot.urdf"
    path.write_text(text, "utf-8")
    assert bool(check_agreement(path).broken) is not is_taken


NUMBERS = re.split(r'(?<=[" ])(-?[\d.]+)(?=[" ])', """<robot name="bot"><link name="world"/>
<link name="cart"><inertial><origin xyz="0.1 0 0" rpy="0.2 0 0"/><mass value="1"/>
<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial>
<collision><origin xyz="0 0.3 0" rpy="0 0 0.4"/><geometry><box size="0.5 0.6 0.7"/></geometry></collision>
<visual><geometry><cylinder radius="0.11" length="0.12"/></geometry></visual></link>
<link name="tip"><inertial><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial>
<collision><geometry><sphere radius="0.13"/></geometry></collision></link>
<joint name="slide" type="revolute"><origin xyz="0 0.2 0" rpy="0 0.3 0"/><parent link="world"/><child link="cart"/>
<axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="10" velocity="2"/><dynamics damping="0.7" friction="0.1"/>
<safety_controller soft_lower_limit="-1.2" soft_upper_limit="1.2" k_position="12" k_velocity="13"/></joint>
<joint name="weld" type="fixed"><origin xyz="0 0 0.4" rpy="0 0 0.5"/><parent link="cart"/><child link="tip"/></joint>
<gazebo reference="tip"><mu1 value="0.6" /></gazebo>""" + transmission() + "</robot>")  # fmt: skip
EXTREMES = [
    "0",
    "-1",
    "1",
    "1e150",
    "-1e150",
    "1e-320",
    "5e-324",
    "1e-324",
    "1e308",
    "-1e308",
    "1e-16",
    "1e16",
    "inf",
    "nan",
]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    changes=st.dictionaries(
        st.integers(0, len(NUMBERS) // 2 - 1).map(lambda index: 2 * index + 1), st.sampled_from(EXTREMES), max_size=4
    )
)
def test_a_check_and_a_spawn_agree_on_any_number_in_a_robot(changes: dict[int, str]) -> None:
    text = "".join(changes.get(index, part) for index, part in enumerate(NUMBERS))
    check_agreement(text)
