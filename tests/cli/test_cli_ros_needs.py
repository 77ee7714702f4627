"""What cannot be done without ROS 1 or a screen: said before the start, with the place, and with exit code 1 or 2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import processes

SCRIPTS = {
    "plain": "#!/usr/bin/env python3\nimport rospy\nprint('ran')\n",
    "of_python_2": "#!/usr/bin/env python\nimport rospy\nprint 'ran'\n",
    "after_another": "#!/usr/bin/env python3\nimport os; import rospy\nprint('ran')\n",
    "of_python_2_in_a_list": "#!/usr/bin/env python\nimport os, rospy\nprint 'ran'\n",
    "from": "#!/usr/bin/env python3\n'''A node.'''\nfrom rospy import Publisher\n",
}
HARMLESS = {
    "that_can_do_without": "#!/usr/bin/env python3\ntry:\n    import rospy\nexcept ImportError:\n    print('ran')\n",
    "that_speaks_of_it": "#!/usr/bin/env python3\n# import rospy\nprint('ran, no rospy')\n",
    "that_quotes_it": "#!/usr/bin/env python3\n'''\nimport rospy\n'''\nprint('ran, no rospy')\n",
}


@pytest.fixture
def launch(tmp_path: Path) -> Path:
    """A package `demo` whose launch file starts its script `talker`; the script is yet to be written."""
    package = tmp_path / "demo"
    (package / "scripts").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>demo</name></package>")
    path = package / "demo.launch"
    path.write_text('<launch>\n<node name="t" pkg="demo" type="talker.py"/>\n</launch>')
    return path


def script(launch: Path, content: str | bytes) -> None:
    path = launch.parent / "scripts" / "talker.py"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    path.chmod(0o755)


@pytest.mark.parametrize("name", SCRIPTS)
@pytest.mark.parametrize("words", [("launch", "--strict"), ("launch", "--strict", "--dry-run"), ("check",)])
def test_a_node_that_needs_rospy_is_named_before_anything_starts(
    slidectl: CommandLine, launch: Path, name: str, words: tuple[str]
) -> None:
    script(launch, SCRIPTS[name])
    done = slidectl(words[0], str(launch), *words[1:])
    assert done.returncode == 2
    assert "demo.launch:2: node /t (demo/talker.py): talker.py imports rospy, which needs ROS 1" in done.stderr
    assert "ran" not in done.stdout.split()
    assert "Traceback" not in done.stderr
    assert not processes(slidectl.runtime)


def test_a_program_that_is_linked_with_roscpp_is_named_too(slidectl: CommandLine, launch: Path) -> None:
    script(launch, b"\x7fELF\x02\x01\x01" + bytes(64) + b"libroscpp.so\0libc.so.6\0")
    done = slidectl("launch", str(launch), "--dry-run", "--strict")
    assert done.returncode == 2
    assert "demo.launch:2: node /t (demo/talker.py): talker.py is linked with roscpp, which needs ROS 1" in done.stderr


def test_a_program_that_was_not_compiled_says_what_it_would_need(slidectl: CommandLine, launch: Path) -> None:
    (launch.parent / "CMakeLists.txt").write_text("add_executable(talker.py src/talker.cpp)")
    done = slidectl("launch", str(launch), "--dry-run", "--strict")
    assert "it is compiled from C++ (CMakeLists.txt), and with roscpp it needs ROS 1" in done.stderr


@pytest.mark.parametrize("name", HARMLESS)
def test_a_script_that_does_without_rospy_runs(slidectl: CommandLine, launch: Path, name: str) -> None:
    script(launch, HARMLESS[name])
    assert slidectl("launch", str(launch), "--dry-run").returncode == 0


def test_a_script_runs_where_its_rospy_is_found(slidectl: CommandLine, launch: Path) -> None:
    script(launch, SCRIPTS["plain"])
    (launch.parent / "scripts" / "rospy.py").write_text("")
    assert slidectl("launch", str(launch), "--dry-run").returncode == 0


def test_such_nodes_are_left_out(slidectl: CommandLine, launch: Path) -> None:
    script(launch, SCRIPTS["plain"])
    for options in ((), ("--strict", "--skip-unknown"), ("--keep-going",)):
        done = slidectl("launch", str(launch), "--dry-run", *options)
        assert done.returncode == 0
        assert "the node /t is left out" in done.stderr


@pytest.mark.parametrize(
    ("package", "program", "instead"),
    [
        ("rviz", "rviz", "slidectl echo joint_states"),
        ("rqt_gui", "rqt_gui", "slidectl echo -p"),
        ("rqt_plot", "rqt_plot", "slidectl plot"),
        ("gazebo_ros", "gzclient", "slidectl view"),
        ("rqt_reconfigure", "rqt_reconfigure", "slidectl param set"),
        ("joint_state_publisher", "joint_state_publisher", "slidectl spawn MODEL"),
        ("joint_state_publisher_gui", "joint_state_publisher_gui", "slidectl spawn MODEL"),
    ],
)
def test_rosrun_of_what_cannot_be_shown_fails_and_says_what_to_use(
    slidectl: CommandLine, package: str, program: str, instead: str
) -> None:
    done = slidectl("ros", "rosrun", package, program)
    assert done.returncode == 1
    assert done.stdout == ""
    assert f"{package}/{program} cannot be run here" in done.stderr
    assert instead in done.stderr


FIELD = "/rrbot/joint_states/position[0]"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("rqt_plot", FIELD), 2),
        (("ros", "rqt_plot", FIELD), 1),
        (("ros", "rosrun", "rqt_plot", "rqt_plot", FIELD), 1),
    ],
    ids=str,
)
def test_a_plot_of_rqt_is_answered_with_the_line(slidectl: CommandLine, words: Sequence[str], code: int) -> None:
    done = slidectl(*words)
    assert done.returncode == code
    assert f"type: slidectl plot '{FIELD}'\n" in done.stderr
    first = next(line for line in done.stderr.splitlines() if "no windows" in line)
    assert first.index("slidectl view") < first.index("slidectl plot") < first.index("slidectl top")


def test_more_fields_behind_a_topic_of_rqt_plot_are_fields_of_that_topic(slidectl: CommandLine) -> None:
    done = slidectl("ros", "rqt_plot", "/turtle1/pose/x:y", "/b/data")
    assert "type: slidectl plot /turtle1/pose/x /turtle1/pose/y /b/data\n" in done.stderr


@pytest.mark.parametrize("name", ["rqt", "rviz", "gzclient", "rqt_graph", "rqt_console", "rqt_reconfigure"])
def test_windows_are_answered_by_their_own_words_too(slidectl: CommandLine, name: str) -> None:
    for words, code in (((name,), 2), (("ros", name), 1)):
        done = slidectl(*words)
        assert done.returncode == code
        assert "there are no windows here; slidectl view" in done.stderr


def test_a_window_that_rosrun_gets_without_its_program_is_answered(slidectl: CommandLine) -> None:
    assert "slidectl plot TOPIC/FIELD draws the numbers" in slidectl("ros", "rosrun", "rqt_plot").stderr


def test_rosrun_of_a_script_with_rospy_says_why_not(slidectl: CommandLine, launch: Path) -> None:
    script(launch, SCRIPTS["plain"])
    slidectl.environment["ROS_PACKAGE_PATH"] = str(launch.parent.parent)
    done = slidectl("ros", "rosrun", "demo", "talker.py")
    assert done.returncode == 1
    assert "talker.py imports rospy, which needs ROS 1" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_display_launch_of_a_tutorial_runs_with_what_there_is(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "display.launch"
    path.write_text(
        '<launch><param name="robot_description" command="$(find xacro)/xacro --inorder \'$(find my_slider)/urdf/'
        'slider.xacro\'"/><node name="joint_state_publisher" pkg="joint_state_publisher" type="joint_state_publisher">'
        '<param name="use_gui" value="TRUE"/></node>'
        '<node name="rsp" pkg="robot_state_publisher" type="state_publisher"/>'
        '<node name="rviz" pkg="rviz" type="rviz" args="-d $(find my_slider)/launch/slider.rviz"/></launch>'
    )
    try:
        done = slidectl("launch", str(path), "--detach")
        assert done.returncode == 0
        assert "/joint_state_publisher: left out: joints are those of a robot in the world here" in done.stderr
        assert "/rviz: left out: there are no windows here; slidectl view" in done.stderr
        assert "/rsp: waits for a robot" in done.stdout
        assert "<robot" in slidectl.ok("param", "get", "/robot_description")
    finally:
        slidectl("daemon", "stop")
