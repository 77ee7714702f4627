"""Nodes that have a counterpart: which they are, what their arguments mean, and which of these are refused at once."""

from __future__ import annotations

import pytest
from launch_files import Workspace, notices

from slidectl.errors import BadFile
from slidectl.extensions.launch import node_kinds
from slidectl.extensions.launch.nodes.spawn_model import SpawnModel
from slidectl.extensions.launch.task import Task


def tasks(workspace: Workspace, content: str) -> list[Task]:
    return node_kinds.tasks(workspace.plan(content), workspace.packages)


def task(workspace: Workspace, kind: str, args: str = "", attributes: str = "") -> Task:
    package, _, name = kind.partition("/")
    args = args.replace('"', "&quot;")
    [made] = tasks(workspace, f'<node pkg="{package}" type="{name}" name="n" args="{args}" {attributes}/>')
    return made


@pytest.mark.parametrize(
    ("kind", "args", "family", "text"),
    [
        ("gazebo_ros/gazebo", "-u", "world", "the world, paused"),
        ("gazebo_ros/gzserver", "", "world", "the world"),
        ("gazebo_ros/gzclient", "", "notice", "there are no windows here"),
        ("gazebo_ros/spawn_model", "-urdf -model m -param robot_description", "robot",
         "spawn m from parameter /robot_description"),
        ("controller_manager/spawner", "a b", "controllers", "load and start a, b in /"),
        ("controller_manager/spawner", "--stopped --namespace=rrbot a", "controllers", "load a in /rrbot"),
        ("controller_manager/spawner", "--stop --name rrbot a", "controllers", "load a in /rrbot"),
        ("controller_manager/unspawner", "a", "controllers", "keep a stopped in /"),
        ("controller_manager/controller_manager", "sp a", "controllers", "controller_manager spawn a"),
        ("controller_manager/controller_group", "switch g", "controllers", "controller_group switch g"),
        ("robot_state_publisher/robot_state_publisher", "", "frames", "frames on /tf, of the robot with /joint_states"),
        ("robot_state_publisher/state_publisher", "", "frames", "frames on /tf, of the robot with /joint_states"),
        ("joint_state_publisher/joint_state_publisher", "", "notice", "left out: joints are those of a robot in the"),
        ("tf/static_transform_publisher", "0 0 1 0 0 0 a b 100", "frames", "the frame b in a"),
        ("tf2_ros/static_transform_publisher", "0 0 1 0 0 0 1 a /b", "frames", "the frame b in a"),
        ("rostopic/rostopic", "pub /x std_msgs/Float64 1.0", "tool", "run rostopic pub /x std_msgs/Float64 1.0"),
        ("rosservice/rosservice", "call /x", "tool", "run rosservice call /x"),
        ("rviz/rviz", "-d x.rviz", "notice", "slidectl tf tree"),
        ("rqt_gui/rqt_gui", "", "notice", "slidectl pub -r"),
        ("rqt_plot/rqt_plot", "", "notice", "slidectl plot"),
    ],
)  # fmt: skip
def test_each_is_what_it_is_here(workspace: Workspace, kind: str, args: str, family: str, text: str) -> None:
    made = task(workspace, kind, args)
    assert made.family == family
    assert text in made.text


@pytest.mark.parametrize(
    ("kind", "args", "reason"),
    [
        ("gazebo_ros/spawn_model", "-urdf -param d", "needs a name for the robot: -model NAME"),
        ("gazebo_ros/spawn_model", "-urdf -model m", "takes one of -param NAME and -file FILE"),
        ("gazebo_ros/spawn_model", "-sdf -model m", "takes one of -param NAME and -file FILE"),
        ("gazebo_ros/spawn_model", "-model m -database d", "-database NAME is model://NAME, which is SDF"),
        ("gazebo_ros/spawn_model", "-model m -param d -x one", "-x is a number, not 'one'"),
        ("gazebo_ros/spawn_model", "-model m -param d -J joint1", "argument -J: expected 2 arguments"),
        ("gazebo_ros/spawn_model", "-model m -param d -J joint1 inf", "-J joint1 is a number, not 'inf'"),
        ("gazebo_ros/spawn_model", "-model m -parm d", "no option '-parm' here; did you mean -param?"),
        ("gazebo_ros/spawn_model", "-model m -param d extra", "does not understand 'extra'"),
        ("gazebo_ros/spawn_model", "-model m -param d -x", "argument -x: expected 1 argument"),
        ("controller_manager/spawner", "", "needs the names of controllers"),
        ("controller_manager/spawner", "--timeot 3 a", "no option '--timeot' here; did you mean --timeout?"),
        ("gazebo_ros/spawn_model", "-p robot_description", "-p could match -param, -package_to_model"),
        ("controller_manager/spawner", "--timeout soon a", "--timeout is a number, not 'soon'"),
        ("controller_manager/unspawner", "", "needs the names of controllers"),
        ("controller_manager/controller_manager", "", "controller_manager needs a command"),
        ("controller_manager/controller_manager", "strat a", "Did you mean 'start'?"),
        ("controller_manager/controller_manager", "load", "load needs the names of controllers"),
        ("controller_manager/controller_group", "spawn", "does not understand 'spawn'"),
        ("tf/static_transform_publisher", "0 0 0 a b", "5 arguments are too few"),
        ("tf/static_transform_publisher", "0 0 0 0 0 0 0 0 a b 100 7", "are too many"),
        ("tf2_ros/static_transform_publisher", "0 0 x 0 0 0 a b", "is a number, not 'x'"),
        ("tf2_ros/static_transform_publisher", "0 0 0 0 0 0 /a a", "a is its own parent"),
        ("tf2_ros/static_transform_publisher", "0 0 0 0 0 0 0 a b", "the quaternion has the length 0"),
        ("tf/static_transform_publisher", "0 0 0 0 0 0 2 a b 100", "the quaternion has the length 2"),
        (
            "tf/static_transform_publisher",
            "0 0 0 0 0 a b 100",
            "x y z yaw pitch roll (or qx qy qz qw) FRAME CHILD PERIOD",
        ),
        ("controller_manager/unspawner", "--stopped a", "it takes no options"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_before_anything_starts(
    workspace: Workspace, kind: str, args: str, reason: str
) -> None:
    with pytest.raises(BadFile, match=r"test.launch:1: /n: ") as caught:
        task(workspace, kind, args)
    assert reason in str(caught.value)


def test_a_number_is_a_value_however_it_is_written(workspace: Workspace) -> None:
    made = task(workspace, "gazebo_ros/spawn_model", "-urdf -model m -param d -x -1e-3 -z -.5 -J m::j -2")
    assert isinstance(made, SpawnModel)
    assert (made.pose[0], made.joints) == ((-0.001, 0.0, -0.5), {"j": -2.0})


def test_a_world_in_a_namespace_is_the_one_world(workspace: Workspace) -> None:
    plan = workspace.plan(
        '<node pkg="gazebo_ros" type="spawn_model" name="n" args="-model m -param d -gazebo_namespace /a/gazebo"/>'
    )
    node_kinds.tasks(plan, workspace.packages)
    (notice,) = notices(plan)
    assert "-gazebo_namespace /a/gazebo has no effect: there is one world, in /gazebo" in notice


def test_attributes_that_only_mean_something_for_a_process_are_pointed_out(workspace: Workspace) -> None:
    plan = workspace.plan(
        '<node pkg="robot_state_publisher" type="robot_state_publisher" name="n" respawn="true" launch-prefix="gdb"'
        ' cwd="node"/>'
    )
    node_kinds.tasks(plan, workspace.packages)
    assert [text.rpartition("/n: ")[2].split()[0] for text in notices(plan)] == ["respawn", "launch-prefix", "cwd"]


def test_a_node_that_is_nothing_here_is_refused_or_left_out(workspace: Workspace) -> None:
    content = '<node pkg="fancy" type="thing" name="n"/><node pkg="rviz" type="rviz" name="r"/>'
    with pytest.raises(BadFile, match=r"test.launch:1: node /n \(fancy/thing\): no package 'fancy'"):
        tasks(workspace, content)
    plan = workspace.plan(content)
    plan.missing.forgiven = "nodes"
    [left] = node_kinds.tasks(plan, workspace.packages)
    assert left.node.name == "r"
    [line] = plan.missing.lines()
    assert line.endswith("test.launch:1: node /n (fancy/thing): no package 'fancy'; the node /n is left out")


def test_a_misspelt_counterpart_is_suggested(workspace: Workspace) -> None:
    with pytest.raises(BadFile) as caught:
        tasks(workspace, '<node pkg="controller_manager" type="spawnr" name="n"/>')
    assert "did you mean 'controller_manager/spawner'" in str(caught.value.hint)


def test_names_of_a_node_are_resolved_through_its_namespace_and_remaps(workspace: Workspace) -> None:
    node = workspace.node(
        '<group ns="g"><remap from="joint_states" to="/rrbot/joint_states"/><remap from="/abs" to="rel"/>'
        '<node pkg="rviz" type="rviz" name="n"><remap from="~own" to="other"/></node></group>'
    )
    assert node.resolve("joint_states") == "/rrbot/joint_states"
    assert node.resolve("/g/joint_states") == "/rrbot/joint_states"
    assert node.resolve("/joint_states") == "/joint_states"
    assert node.resolve("/abs") == "/g/rel"
    assert node.resolve("~own") == "/g/other"
    assert node.resolve("~x") == "/g/n/x"
