"""Launch files: their tags, and whether what the nodes look for is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from check_texts import CONTROLLERS, Lines, driven_cart

from slidectl.check.dispatch import check
from slidectl.description import Packages

Write = Callable[[str, str], Path]
Launch = Callable[..., Lines]

ROBOT = '<param name="robot_description" textfile="$(dirname)/bot.urdf"/>'
SPAWN = '<node name="spawn" pkg="gazebo_ros" type="spawn_model" args="-urdf -model bot -param robot_description"/>'
LOAD = '<rosparam file="$(dirname)/control.yaml"/>'
START = '<node name="ctl" pkg="controller_manager" type="spawner" ns="/bot" args="slide_controller states"/>'
STATES = "  states: {type: joint_state_controller/JointStateController, publish_rate: 50}\n"
FRAMES = (
    '<node name="rsp" pkg="robot_state_publisher" type="robot_state_publisher">'
    '<remap from="/joint_states" to="/bot/joint_states"/></node>'
)
ALL = (ROBOT, SPAWN, LOAD, START, FRAMES)


@pytest.fixture
def launch(write: Write) -> Launch:
    """Checks a launch file of these parts, each on a line of its own from line 2 on, beside a robot and controllers."""

    def check_launch(*parts: str, controllers: str = CONTROLLERS + STATES, **arguments: str) -> Lines:
        write("bot.urdf", driven_cart())
        write("control.yaml", controllers)
        path = write("bot.launch", "\n".join(["<launch>", *parts, "</launch>"]))
        return Lines(check([str(path)], arguments, Packages()))

    return check_launch


def shipped(*words: str) -> Lines:
    return Lines(check(words, {}, Packages()))


def test_a_sound_launch_is_all_used_with_its_robot_and_controllers(launch: Launch) -> None:
    lines = launch(*ALL)
    assert lines.of("converted", "ignored", "wrong") == []
    assert "used 3 node /spawn: gazebo_ros/spawn_model: spawn bot from parameter /robot_description" in lines.all
    assert lines.about("used 3 link 'cart'/<inertial>/<mass>")
    assert lines.about("used 5 /bot/slide_controller/pid/p: 10.0")
    assert lines.about("used 6 node 'rsp'/<remap>")


def test_files_come_in_the_order_of_the_launch(launch: Launch) -> None:
    files = [Path(notice.file).name for notice in launch(*ALL).findings.sorted()]
    assert list(dict.fromkeys(files)) == ["bot.launch", "bot.urdf", "control.yaml"]


def test_of_the_files_that_stand_in_for_those_of_ros_only_what_is_amiss_is_listed() -> None:
    found = shipped("my_slider", "slider.launch").findings.sorted()
    subjects = [notice.subject for notice in found if Path(notice.file).name == "empty_world.launch"]
    assert subjects == ["/use_sim_time", "node /gazebo"]


SLIPS = [
    ("respwan", SPAWN.replace("/>", ' respwan="true"/>'), "wrong 3", "did you mean 'respawn'?"),
    ("tag", SPAWN + "\n<nod/>", "wrong 4", "did you mean <node>?"),
    ("test", SPAWN + '\n<test test-name="t" pkg="p" type="t"/>', "ignored 4", "is for rostest"),
    ("viewer", SPAWN + '\n<node name="v" pkg="rviz" type="rviz"/>', "ignored 4", "there are no windows here"),
    (
        "joints",
        SPAWN + '\n<node name="j" pkg="joint_state_publisher" type="joint_state_publisher"/>',
        "ignored 4",
        "the joints of a simulated robot are where the world has them",
    ),
    ("parameter", SPAWN.replace("-param robot_", "-param robt_"), "wrong 3", "did you mean /robot_description?"),
    (
        "option",
        SPAWN + '\n<node name="s" pkg="controller_manager" type="spawner" args="--stoped a"/>',
        "wrong 4 node /s: controller_manager/spawner has no option",
        "did you mean --stopped?",
    ),
    (
        "program",
        SPAWN + '\n<node name="s" pkg="controller_manager" type="spawnr" args="a"/>',
        "wrong 4 node /s: no package 'controller_manager'",
        "did you mean 'controller_manager/spawner'",
    ),
    ("stray", SPAWN + '\n<param name="bot/speed" value="3"/>', "ignored 4", "/bot/speed: no controller reads it"),
]


@pytest.mark.parametrize(
    ("part", "start", "end"), [mistake[1:] for mistake in SLIPS], ids=[mistake[0] for mistake in SLIPS]
)
def test_a_slip_is_found_at_its_line(launch: Launch, part: str, start: str, end: str) -> None:
    (line,) = launch(ROBOT, part).of("ignored", "wrong")
    assert line.startswith(start)
    assert end in line


def test_joint_states_that_nobody_publishes_are_pointed_out_at_the_remap(launch: Launch) -> None:
    lines = launch(ROBOT, SPAWN, LOAD, START, FRAMES.replace('to="/bot', 'to="/rrbot'))
    assert lines.of("wrong") == [
        "wrong 6 <remap>: /rsp listens to /rrbot/joint_states, which has no publisher; did you mean /bot/joint_states?"
    ]


def test_joint_states_that_are_not_remapped_are_pointed_out_at_the_node(launch: Launch) -> None:
    node = '<node name="rsp" pkg="robot_state_publisher" type="robot_state_publisher"/>'
    (line,) = launch(ROBOT, SPAWN, LOAD, START, node).of("wrong")
    assert line.startswith("wrong 6 node /rsp: it listens to /joint_states, which has no publisher")


def test_a_tool_makes_use_of_remaps_of_the_topics_that_it_names(launch: Launch) -> None:
    tool = (
        '<node name="go" pkg="rostopic" type="rostopic" ns="/bot" args="pub goal std_msgs/Float64 1.0">'
        '<remap from="{}" to="slide_controller/command"/></node>'
    )
    assert not launch(*ALL, tool.format("goal")).about("ignored 7 <remap>")
    assert not launch(*ALL, tool.format("/bot/goal")).about("ignored 7 <remap>")
    assert launch(*ALL, tool.format("gaol")).about(
        "ignored 7 <remap>: no node that it is for has the name 'gaol'; did you mean 'goal'?"
    )


def test_a_remap_that_no_node_makes_use_of_is_ignored(launch: Launch) -> None:
    lines = launch(
        *ALL[:4], FRAMES.replace("<remap", '<remap from="/jont_states" to="/a"/><remap'), '<remap from="a" to="b"/>'
    )
    assert lines.of("ignored") == [
        "ignored 6 <remap>: no node that it is for has the name '/jont_states'; did you mean 'joint_states'?",
        "ignored 7 <remap>: no node comes after it",
    ]


def test_a_spawner_in_another_namespace_than_the_robot_is_wrong(launch: Launch) -> None:
    lines = launch(ROBOT, SPAWN, LOAD, START.replace('ns="/bot"', 'ns="/bott"'))
    assert lines.about("wrong 5", "waits for a controller manager in /bott", 'did you mean ns="/bot"?')
    assert lines.about("wrong 5", "the launch sets no controller /bott/slide_controller")


def test_controllers_in_another_namespace_than_the_robot_are_wrong(launch: Launch) -> None:
    lines = launch(ROBOT, SPAWN, LOAD, controllers=CONTROLLERS.replace("bot:", "bat:"))
    assert lines.of("wrong") == [
        "wrong 1 namespace /bat: controllers are set here, but the robots of this launch live in /bot"
    ]


def test_the_namespace_that_the_spawning_node_gives_goes_before_the_plugins(launch: Launch) -> None:
    spawn = SPAWN.replace("-model bot", "-model bot -robot_namespace /bat")
    lines = launch(ROBOT, spawn, LOAD, controllers=CONTROLLERS.replace("bot:", "bat:"))
    assert lines.of("wrong") == []


def test_a_controller_that_is_not_set_is_wrong_for_its_spawner(launch: Launch) -> None:
    (line,) = launch(ROBOT, SPAWN, LOAD, START.replace("slide_c", "slyde_c")).of("wrong")
    assert "the launch sets no controller /bot/slyde_controller; did you mean /bot/slide_controller?" in line


def test_parameters_of_several_tags_are_judged_together(launch: Launch) -> None:
    more = '<param name="bot/slide_controller/joint" value="wing"/>'
    inline = "<rosparam>\nbot:\n  slide_controller:\n    pid: {i_clamp: 0.0}\n</rosparam>"
    lines = launch(ROBOT, SPAWN, LOAD, more, inline)
    assert lines.about("wrong 5 /bot/slide_controller/joint: the robot has no joint 'wing'")
    assert lines.about("used 9 /bot/slide_controller/pid/i_clamp: 0.0")
    assert lines.about("ignored 5 /bot/slide_controller/pid/i: 1 has no effect without i_clamp")


def test_two_robots_of_one_name_or_namespace_are_wrong(launch: Launch) -> None:
    lines = launch(ROBOT, SPAWN, SPAWN.replace('name="spawn"', 'name="again"'))
    assert [line.partition(":")[2][:40] for line in lines.of("wrong")] == [
        " spawns a second robot with the name bot",
        " spawns a second robot with the namespac",
    ]


def test_what_a_condition_leaves_out_is_used_up_by_the_condition(launch: Launch) -> None:
    lines = launch(
        '<arg name="gui" default="false"/>', '<group if="$(arg gui)"><node name="v" pkg="rviz" type="rviz"/></group>'
    )
    assert lines.of("ignored", "wrong") == []
    assert lines.about("<group>: left out by its condition")


def test_nothing_in_a_tag_that_is_not_read_is_used(launch: Launch) -> None:
    lines = launch('<foo><bar x="1"/></foo>', '<arg name="a" default="1"><bar x="1"/></arg>')
    assert lines.about("/<bar>") == ["ignored 3 arg 'a'/<bar>: is not read, nor is its content"]


def test_arguments_that_are_given_are_listed_as_such(launch: Launch) -> None:
    lines = launch('<arg name="gui" default="false" doc="a window"/>', gui="true")
    assert "used 2 argument gui: 'true', as given" in lines.all


def test_programs_of_the_user_are_not_run(launch: Launch, tmp_path: Path) -> None:
    command = f"touch {tmp_path / 'ran'}"
    lines = launch(f'<param name="robot_description" command="{command}"/>', SPAWN, LOAD, START)
    assert not (tmp_path / "ran").exists()
    assert lines.about("note: a check does not run the command")
    assert lines.of("wrong") == []


BROKEN = [
    ('<node name="a/b" pkg="p" type="t"/>', 2, "cannot hold a namespace"),
    ('<param name="a" value="$(arg nope)"/>', 2, "there is no argument 'nope' here"),
    ('<rosparam file="$(dirname)/none.yaml"/>', 2, "no such file"),
    ("<rosparam>\na: [1\n</rosparam>", None, "not YAML"),
    (SPAWN.replace("-urdf", "-trimesh"), 2, "only URDF and SDF can be spawned"),
    ('<node name="n" pkg="nowhere" type="nothing"/>', 2, "no package 'nowhere'"),
]


@pytest.mark.parametrize(("part", "line", "reason"), BROKEN)
def test_what_keeps_a_launch_from_starting_is_broken(launch: Launch, part: str, line: int | None, reason: str) -> None:
    lines = launch(part)
    assert len(lines.findings.broken) == 1
    assert line in (None, lines.findings.broken[0].line)
    assert [found for found in lines.of("wrong") if reason in found]


def test_a_broken_robot_does_not_hide_the_rest_of_the_launch(launch: Launch, write: Write) -> None:
    write("bad.urdf", driven_cart().replace('<mass value="1"/>', '<mass value="one"/>'))
    lines = launch('<param name="robot_description" textfile="$(dirname)/bad.urdf"/>', SPAWN, LOAD, START)
    (error,) = lines.findings.broken
    assert (Path(str(error.file)).name, error.line) == ("bad.urdf", 3)
    assert lines.about("used 5 /bot/slide_controller/pid/p")


RIVALS = CONTROLLERS + STATES + "  push: {type: effort_controllers/JointEffortController, joint: slide}\n"
BOTH = START.replace("states", "push")


def test_controllers_that_want_the_same_joint_cannot_be_started_by_one_spawner(launch: Launch) -> None:
    lines = launch(ROBOT, SPAWN, LOAD, BOTH, controllers=RIVALS)
    (line,) = lines.of("wrong")
    assert line.endswith("cannot start /bot/push beside /bot/slide_controller: both want joint 'slide' for themselves")
    stopped = BOTH.replace('args="', 'args="--stopped ')
    assert launch(ROBOT, SPAWN, LOAD, stopped, controllers=RIVALS).of("wrong") == []
    assert launch(ROBOT, SPAWN, LOAD, START, controllers=RIVALS).of("wrong") == []


def test_a_controller_that_two_spawners_load_is_wrong(launch: Launch) -> None:
    again = '<node name="again" pkg="controller_manager" type="spawner" args="--namespace /bot states"/>'
    (line,) = launch(ROBOT, SPAWN, LOAD, START, again).of("wrong")
    assert "loads /bot/states, which the node at" in line


def test_joint_states_that_nobody_starts_are_a_note_that_names_who_would(launch: Launch) -> None:
    lines = launch(ROBOT, SPAWN, LOAD, START.replace(" states", ""), FRAMES)
    assert lines.about("note: nothing in this launch publishes /bot/joint_states; /bot/states would")


def test_a_prefix_of_frames_is_used_by_the_robots_below(launch: Launch) -> None:
    lines = launch(*ALL, '<param name="/bot/tf_prefix" value="a"/>', '<param name="/else/tf_prefix" value="a"/>')
    assert "used 7 /bot/tf_prefix: for the frames of bot" in lines.all
    assert [line.partition(":")[0] for line in lines.of("ignored")] == ["ignored 8 /else/tf_prefix"]


@pytest.mark.parametrize(
    ("name", "hint"),
    [("publish_freqency", "did you mean 'publish_frequency'?"), ("use_tf_static", "fixed joints are on /tf_static")],
)
def test_a_parameter_that_the_state_publisher_does_not_read_has_a_hint(launch: Launch, name: str, hint: str) -> None:
    frames = FRAMES.replace("<remap", f'<param name="{name}" value="1"/><remap')
    (line,) = [line for line in launch(*ALL[:4], frames).of("ignored") if name in line]
    assert hint in line
