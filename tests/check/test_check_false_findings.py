"""What is right is not called wrong: limits of position joints, joints that a launch moves, planners, meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from check_texts import INERTIAL, PLUGIN, Check, Lines, cart, transmission

from slidectl import description
from slidectl.check.dispatch import check
from slidectl.description import Packages
from slidectl.simulation import Simulation

Write = Callable[[str, str], Path]
POSITION, VELOCITY, EFFORT = (f"hardware_interface/{kind}JointInterface" for kind in ("Position", "Velocity", "Effort"))
OUTSIDE = '<limit lower="-3" upper="-0.1" effort="10" velocity="2"/>'


@pytest.mark.parametrize(("interface", "is_wrong"), [(POSITION, False), (VELOCITY, True), (EFFORT, True)])
def test_an_effort_limit_of_0_stops_what_is_driven_by_efforts_only(
    model: Check, interface: str, is_wrong: bool
) -> None:
    limit = '<limit lower="-1" upper="1" effort="0" velocity="2"/>'
    lines = model(cart(transmission(interface=interface), PLUGIN, joint=limit))
    assert bool(lines.about("wrong", "cannot be driven")) is is_wrong


def test_an_actuator_is_told_of_with_its_own_transmission_when_a_macro_made_several(model: Check) -> None:
    """All of them are in the same line of the file."""
    tags = [transmission(interface=EFFORT), transmission(interface=VELOCITY), transmission("turn", EFFORT)]
    tags = [tag.replace("<mechanical", f"<hardwareInterface>{EFFORT}</hardwareInterface><mechanical") for tag in tags]
    more = '<link name="b"/><joint name="turn" type="continuous"><parent link="cart"/><child link="b"/></joint>'
    lines = model(cart("".join(tags), PLUGIN, more.replace('"b"/>', f'"b">{INERTIAL}</link>', 1)))
    (line,) = lines.about("has no effect: the joint's interface counts")
    assert "t_slide" in line
    assert VELOCITY in line


def test_a_position_joint_with_an_effort_limit_of_0_is_driven() -> None:
    simulation = Simulation(ground=False, engine="plain")
    limit = '<limit lower="-1" upper="1" effort="0" velocity="2"/>'
    simulation.spawn(cart(transmission(interface=POSITION), PLUGIN, joint=limit), "bot")
    (joint,) = simulation.robots.get("bot").hardware.driven()
    for _ in range(300):
        joint.handle.command = 0.5
        simulation.step(1)
    assert simulation.world.joint_state("bot", "slide")[0] == pytest.approx(0.5)


@pytest.mark.parametrize(("interface", "is_wrong"), [(POSITION, False), (EFFORT, True)])
def test_a_position_joint_goes_between_its_limits_by_itself(model: Check, interface: str, is_wrong: bool) -> None:
    lines = model(cart(transmission(interface=interface), PLUGIN, joint=OUTSIDE))
    assert bool(lines.about("wrong", "starts at 0, outside of its limits")) is is_wrong


SPAWN = '<node name="s{0}" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description -model m{0} {1}"/>'


@pytest.mark.parametrize(
    ("put", "is_wrong"), [(["-J slide -1"], False), ([""], True), (["-J slide 1"], True), (["-J slide -1", ""], True)]
)
def test_a_joint_that_every_spawn_puts_between_its_limits_does_not_start_outside(
    write: Write, put: list[str], is_wrong: bool
) -> None:
    write("bot.urdf", cart(transmission(), PLUGIN, joint=OUTSIDE))
    spawns = "".join(SPAWN.format(number, words) for number, words in enumerate(put))
    path = write(
        "bot.launch",
        f'<launch><param name="robot_description" textfile="$(dirname)/bot.urdf"/>{spawns}</launch>',
    )
    lines = Lines(check([str(path)], {}, Packages()))
    assert bool(lines.about("wrong", "starts at 0, outside of its limits")) is is_wrong


def test_a_joint_of_one_robot_that_is_put_inside_says_nothing_of_that_name_in_another(write: Write) -> None:
    parts = []
    for number, words in enumerate(("-J slide -1", "")):
        write(f"bot{number}.urdf", cart(transmission(), PLUGIN, joint=OUTSIDE).replace("/bot", f"/bot{number}"))
        parts.append(f'<param name="description{number}" textfile="$(dirname)/bot{number}.urdf"/>')
        parts.append(SPAWN.format(number, words).replace("robot_description", f"description{number}"))
    path = write("bots.launch", f"<launch>{''.join(parts)}</launch>")
    (notice,) = [one for one in check([str(path)], {}, Packages()).sorted() if "starts at 0, outside" in one.text]
    assert notice.file.endswith("bot1.urdf")


def test_the_planners_of_moveit_are_no_controllers(controllers: Check) -> None:
    lines = controllers("planner_configs:\n  RRT:\n    type: geometric::RRT\n    range: 0.0\n")
    assert not lines.of("wrong")
    assert lines.about("ignored", "MoveIt's planners")


def test_a_missing_mesh_in_a_package_that_is_there_is_told_by_its_file(tmp_path: Path) -> None:
    (tmp_path / "foo").mkdir()
    (tmp_path / "foo" / "package.xml").write_text("<package><name>foo</name></package>")
    mesh = '<visual><geometry><mesh filename="package://foo/meshes/none.stl"/></geometry></visual>'
    path = tmp_path / "bot.urdf"
    path.write_text(cart(link=INERTIAL + mesh))
    packages = Packages({"foo": tmp_path / "foo"})
    expected = f"no such file; looked for {tmp_path}/foo/meshes/none.stl"
    assert Lines(check([str(path)], {}, packages)).about("wrong", expected)
    (notice,) = (n for n in description.parse(description.load(path, {}, packages).xml).report if n.verdict == "wrong")
    assert expected in notice.text


def test_of_three_interfaces_on_a_joint_the_first_drives_and_the_others_load_no_controller(model: Check) -> None:
    kinds = (POSITION, VELOCITY, EFFORT)
    parts = [transmission(interface=kind).replace("t_slide", f"t{n}") for n, kind in enumerate(kinds)]
    xml = cart(*parts, PLUGIN)
    names = {"p": "position_controllers/JointPositionController", "v": "velocity_controllers/JointVelocityController",
             "e": "effort_controllers/JointEffortController"}  # fmt: skip
    yaml = "bot:\n" + "".join(f"  {name}: {{type: {kind}, joint: slide}}\n" for name, kind in names.items())
    lines = model(xml, yaml)
    assert [line.split()[1] for line in lines.about("wrong", "is already driven by", "this one is dropped")] == [
        "6",
        "7",
    ]
    assert not lines.about("wrong", "/bot/p/")
    simulation = Simulation(ground=False, engine="plain")
    simulation.spawn(xml, "bot")
    loaded = []
    for name, kind in names.items():
        simulation.parameters.set(f"/bot/{name}", {"type": kind, "joint": "slide"})
        loaded.append(simulation.call("/bot/controller_manager/load_controller", {"name": name})["ok"])
        assert loaded[-1] == (not lines.about("wrong", f"/bot/{name}/"))
    assert loaded == [True, False, False]
    (robot,) = simulation.call("/slidectl/list_robots", {"name": "bot"})["robots"]
    assert [joint["hardware_interface"] for joint in robot["joints"]] == [POSITION]
