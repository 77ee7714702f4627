"""World files: ground, gravity, step and pace are used, everything else in them is reported."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from launch_files import Workspace, notices

from slidectl.errors import BadFile
from slidectl.extensions.launch.nodes.gazebo import Gazebo, WorldFile, WorldSettings, read_world


def world(workspace: Workspace, content: str) -> WorldFile:
    return read_world(
        workspace.write("worlds/test.world", f'<sdf version="1.6"><world name="w">{content}</world></sdf>')
    )


def test_a_world_file_gives_ground_gravity_step_and_pace(workspace: Workspace) -> None:
    found = world(
        workspace,
        """<include><uri>model://sun</uri></include><include><uri>model://ground_plane</uri></include>
        <gravity>0 0 -1.62</gravity><light name="sun" type="directional"/>
        <physics type="ode"><max_step_size>0.002</max_step_size><real_time_factor>2</real_time_factor></physics>""",
    )
    assert found.settings == WorldSettings(False, 0.002, (0.0, 0.0, -1.62), 2.0, True)
    assert found.notices == []


@pytest.mark.parametrize(
    ("physics", "speed"),
    [
        ("", None),
        ("<real_time_factor>0.5</real_time_factor>", 0.5),
        ("<real_time_update_rate>0</real_time_update_rate>", math.inf),
        ("<real_time_update_rate>2000</real_time_update_rate>", 2.0),
        ("<max_step_size>0.002</max_step_size><real_time_update_rate>1000</real_time_update_rate>", 2.0),
        ("<real_time_factor>1</real_time_factor><real_time_update_rate>500</real_time_update_rate>", 0.5),
    ],
)
def test_the_pace_is_the_rate_of_updates_if_there_is_one_else_the_factor(
    workspace: Workspace, physics: str, speed: float | None
) -> None:
    assert world(workspace, f"<physics>{physics}</physics>").settings.speed == speed


def test_factor_and_rate_that_contradict_are_pointed_out(workspace: Workspace) -> None:
    text = "<real_time_factor>1</real_time_factor><real_time_update_rate>500</real_time_update_rate>"
    [notice] = world(workspace, f"<physics>{text}</physics>").notices
    assert "the factor is 0.5" in notice.text


def model(shape: str) -> str:
    return f'<model name="m"><link name="l"><collision name="c"><geometry>{shape}</geometry></collision></link></model>'


@pytest.mark.parametrize(
    ("content", "ground"),
    [
        ("", False),
        ("<include><uri>model://ground_plane</uri></include>", True),
        ('<model name="ground_plane"><static>true</static></model>', True),
        (model("<plane/>"), True),
        (model("<box/>"), False),
    ],
)
def test_the_ground_is_a_plane_however_it_is_written(workspace: Workspace, content: str, ground: bool) -> None:
    assert world(workspace, content).settings.ground is ground


def test_what_else_a_world_holds_is_reported_with_its_line(workspace: Workspace) -> None:
    found = world(
        workspace,
        """

        <plugin name="p" filename="x.so"/>
        <scene/><gui/><state/><wind/>
        <physics><ode><solver/></ode></physics>""",
    )
    assert [(notice.verdict, notice.line) for notice in found.notices] == [
        ("wrong", 3), ("ignored", 4), ("ignored", 4), ("ignored", 4), ("ignored", 5),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("<gravity>0 0</gravity>", "<gravity> is 3 numbers, not '0 0'"),
        ("<gravity>0 0 nan</gravity>", "<gravity> is 'nan', which is not a finite number"),
        ("<physics><max_step_size>0</max_step_size></physics>", "<max_step_size> is 0; it must be above 0"),
        (
            "<physics><real_time_factor>fast</real_time_factor></physics>",
            "<real_time_factor> is 'fast', which is not a number",
        ),
    ],
)
def test_numbers_that_are_none_are_refused_with_the_place(workspace: Workspace, content: str, reason: str) -> None:
    with pytest.raises(BadFile, match=rf"test.world:1: {reason}"):
        world(workspace, content)


def test_a_file_that_is_no_world_is_refused(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match="this is not a world file"):
        read_world(workspace.write("w.world", '<robot name="r"/>'))
    with pytest.raises(BadFile, match="no such file"):
        read_world(Path("/no/such.world"))


def gazebo(workspace: Workspace, args: str, kind: str = "gzserver") -> Gazebo:
    plan = workspace.plan(f'<node pkg="gazebo_ros" type="{kind}" name="gazebo" args="{args}"/>')
    return Gazebo(plan.nodes[0], plan)


def test_the_options_of_gazebo_and_its_world_make_the_settings(workspace: Workspace) -> None:
    text = "<world name='w'><gravity>0 0 -1</gravity><physics><max_step_size>0.01</max_step_size></physics></world>"
    path = workspace.write("w.world", text)
    settings = gazebo(workspace, f"-u -e ode --verbose {path}").settings(WorldSettings())
    assert settings == WorldSettings(True, 0.01, (0.0, 0.0, -1.0), None, False)
    assert gazebo(workspace, "").settings(WorldSettings()) == WorldSettings()
    assert gazebo(workspace, "worlds/empty.world").settings(WorldSettings()).ground is True


def test_a_world_file_is_looked_for_in_gazebos_resource_path(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace.write("worlds/mine.world", '<sdf version="1.6"><world name="w"/></sdf>')
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", f"/nowhere:{workspace.package}")
    found = gazebo(workspace, "worlds/mine.world").world
    assert found is not None
    assert found.file == "demo/worlds/mine.world"
    plan = workspace.plan('<node pkg="gazebo_ros" type="gzserver" name="g" args="worlds/none.world"/>')
    Gazebo(plan.nodes[0], plan)
    with pytest.raises(BadFile, match=r"/g: there is no world file worlds/none.world"):
        plan.missing.refuse()


def test_options_without_effect_are_pointed_out_and_unknown_ones_refused(workspace: Workspace) -> None:
    plan = workspace.plan('<node pkg="gazebo_ros" type="gzserver" name="g" args="-r -s libx.so"/>')
    Gazebo(plan.nodes[0], plan)
    assert [text.rpartition(": ")[2] for text in notices(plan)] == [
        "Gazebo's option -s has no effect",
        "Gazebo's option -r has no effect",
    ]
    with pytest.raises(BadFile, match=r"gazebo_ros/gzserver has no option '--pase' here; did you mean --pause\?"):
        gazebo(workspace, "--pase")
    with pytest.raises(BadFile, match="one world file at most"):
        gazebo(workspace, "a.world b.world")


def test_the_counterpart_of_empty_world_passes_its_arguments_on(workspace: Workspace) -> None:
    from slidectl.extensions.launch import node_kinds

    path = workspace.write("w.world", '<sdf version="1.6"><world name="w"><gravity>0 0 -2</gravity></world></sdf>')
    include = f"""<include file="$(find gazebo_ros)/launch/empty_world.launch">
        <arg name="paused" value="true"/><arg name="use_sim_time" value="false"/><arg name="gui" value="true"/>
        <arg name="headless" value="true"/><arg name="debug" value="false"/><arg name="world_name" value="{path}"/>
        </include>"""
    plan = workspace.plan(include)
    server, window = node_kinds.tasks(plan, workspace.packages)
    assert isinstance(server, Gazebo)
    assert server.settings(WorldSettings()) == WorldSettings(True, None, (0.0, 0.0, -2.0), None, False)
    assert window.node.full_name == "/gazebo_gui"
    assert plan.parameters()["/use_sim_time"][0] is False


def test_lights_other_than_the_sun_are_reported(workspace: Workspace) -> None:
    found = world(workspace, '<light name="sun" type="directional"/>\n<light name="lamp" type="point"/>')
    assert [(notice.verdict, notice.line) for notice in found.notices] == [("ignored", 2)]
    assert "the light of pictures is that of the camera and the sun" in found.notices[0].text


@pytest.mark.parametrize("argument", ["paused", "gui", "recording"])
def test_a_boolean_argument_of_the_world_that_is_none_is_refused_by_its_name(
    workspace: Workspace, argument: str
) -> None:
    include = '<include file="$(find gazebo_ros)/launch/empty_world.launch">{}</include>'
    with pytest.raises(BadFile, match=f"the argument '{argument}' is 'maybe', which is neither true nor false"):
        workspace.plan(include.format(f'<arg name="{argument}" value="maybe"/>'))
