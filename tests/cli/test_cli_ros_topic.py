"""`rostopic list`, `info`, `type`, `find` and `echo` in recorded sessions of the real tool: output and exit codes."""

# ruff: noqa: W291 - the tools end lines of YAML with a blank
from __future__ import annotations

import re
import signal
from collections.abc import Iterator

import pytest
from cli_ros_world import Session, SlideWorld, slide_world, usage


@pytest.fixture(scope="module")
def slide() -> Iterator[SlideWorld]:
    with slide_world() as world:
        yield world


SLIDE = ["command", "description", "forces", "joint_states", "pose", "poses", "position", "raw", "status"]
BELOW = "".join(f"/slide/{name}\n" for name in SLIDE)
JOINT_STATE = """header: 
  seq: 1
  stamp: 
    secs: 1795219417
    nsecs:  52549076
  frame_id: ''
name: 
  - slide
  - latch
position: [-0.009203153466526904, 0.25]
velocity: [-0.49991529479129915, 0.0]
effort: [1.5, -2.0]
---
"""
POSE = """header: 
  seq: 1
  stamp: 
    secs: 1795219417
    nsecs:  52549076
  frame_id: "base"
pose: 
  position: 
    x: 1.25
    y: 0.0
    z: 0.0
  orientation: 
    x: 0.0
    y: 0.0
    z: 0.0
    w: 1.0
---
"""
POSES = """header: 
  seq: 1
  stamp: 
    secs: 1795219417
    nsecs:  52549076
  frame_id: "base"
poses: 
  - 
    position: 
      x: 1.0
      y: 2.0
      z: 3.0
    orientation: 
      x: 0.0
      y: 0.0
      z: 0.0
      w: 1.0
  - 
    position: 
      x: 4.0
      y: 5.0
      z: 6.0
    orientation: 
      x: 0.0
      y: 0.0
      z: 0.0
      w: 1.0
---
"""
FIRST_POSE = """
- 
  position: 
    x: 1.0
    y: 2.0
    z: 3.0
  orientation: 
    x: 0.0
    y: 0.0
    z: 0.0
    w: 1.0
---
"""
POSE_CSV = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,field.pose.position.y,"
    "field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,"
    "field.pose.orientation.w\n"
)
POSES_CSV = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
    "field.poses0.position.x,field.poses0.position.y,field.poses0.position.z,"
    "field.poses0.orientation.x,field.poses0.orientation.y,field.poses0.orientation.z,field.poses0.orientation.w,"
    "field.poses1.position.x,field.poses1.position.y,field.poses1.position.z,"
    "field.poses1.orientation.x,field.poses1.orientation.y,field.poses1.orientation.z,field.poses1.orientation.w\n"
)
VALUES_OF_POSES = "1.0,2.0,3.0,0.0,0.0,0.0,1.0,4.0,5.0,6.0,0.0,0.0,0.0,1.0"
STATE_CSV = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.name0,field.name1,field.position0,"
    "field.position1,field.velocity0,field.velocity1,field.effort0,field.effort1\n"
)
TIME = "1795219417052549076"

LIST = "rostopic list [/namespace]"
LOOKING = [
    Session("rostopic list /slide", BELOW),
    Session("rostopic list slide", BELOW),
    Session("ROS_NAMESPACE=/slide rostopic list pose", "/slide/pose\n"),
    Session("rostopic list /slide/p", "\n"),
    Session("rostopic list /slide/pose", "/slide/pose\n"),
    Session("rostopic list /nothing", "\n"),
    Session("rostopic list -s /slide", "/slide/command\n"),
    Session("rostopic list -p /slide", BELOW.replace("/slide/command\n", "")),
    Session("rostopic list --host /slide/pose", "Host [localhost]:\n  /slide/pose\n"),
    Session(
        "rostopic list -v /slide/command",
        "\nPublished topics:\n\nSubscribed topics:\n * /slide/command [std_msgs/Float64] 1 subscriber\n\n",
    ),
    Session(
        "rostopic list -v -p /slide/raw",
        "\nPublished topics:\n * /slide/raw [std_msgs/UInt8MultiArray] 1 publisher\n\n",
    ),
    usage("rostopic list -p -s", LIST, "you may only specify one of -p, -s"),
    usage("rostopic list a b", LIST, "you may only specify one input topic"),
    usage("rostopic list --bogus", LIST, "no such option: --bogus"),
    Session("rostopic list -b /nofile.bag", "", "ERROR: bag file [/nofile.bag] does not exist\n", 1),
    Session(
        "rostopic info /slide/position",
        "Type: std_msgs/Float64\n\nPublishers: \n * <node> (<uri>)\n\nSubscribers: None\n\n\n",
    ),
    Session(
        "rostopic info slide/command",
        "Type: std_msgs/Float64\n\nPublishers: None\n\nSubscribers: \n * <node> (<uri>)\n\n\n",
    ),
    Session("rostopic info /nope", "", "ERROR: Unknown topic /nope\n", 1),
    Session("rostopic info /slide/position/data", "", "ERROR: Unknown topic /slide/position/data\n", 1),
    usage("rostopic info", "rostopic info /topic", "you must specify a topic name"),
    usage("rostopic info /a /b", "rostopic info /topic", "you may only specify one topic name"),
    Session("rostopic type /slide/position", "std_msgs/Float64\n"),
    Session("rostopic type /slide/command", "std_msgs/Float64\n"),
    Session("rostopic type /slide/pose/pose/position/x", "geometry_msgs/PoseStamped pose/position/x float64\n"),
    Session("rostopic type /slide/joint_states/position", "sensor_msgs/JointState position float64[]\n"),
    Session("rostopic type '/slide/joint_states/position[0]'", "sensor_msgs/JointState position[0] float64\n"),
    Session("rostopic type /nope", "", "unknown topic type [/nope]\n", 1),
    Session("rostopic type /slide/position/nofield", "", "unknown topic type [/slide/position/nofield]\n", 1),
    Session(
        "rostopic type",
        "",
        "usage: rostopic type [-h] topic_or_field\n"
        "rostopic type: error: the following arguments are required: topic_or_field\n",
        2,
    ),
    Session(
        "rostopic type /a /b",
        "",
        "usage: rostopic type [-h] topic_or_field\nrostopic type: error: unrecognized arguments: /b\n",
        2,
    ),
    Session("rostopic type /slide/position | rosmsg show", "float64 data\n\n"),
    Session("rostopic find std_msgs/Bool", "\n"),
    Session("rostopic find std_msgs/Float64", "/slide/command\n/slide/position\n"),
    Session("rostopic find geometry_msgs/PoseArray", "/slide/poses\n"),
    Session("rostopic find std_msgs/Nope", "\n"),
    Session("rostopic find garbage", "\n"),
    usage("rostopic find", "rostopic find msg-type", "please specify a message type"),
    usage("rostopic find a b", "rostopic find msg-type", "you may only specify one message type"),
]

ECHO = "rostopic echo [options] /topic"
ECHOED = [
    Session("rostopic echo -n 1 /slide/position", "data: 0.0\n---\n"),
    Session("rostopic echo -n1 slide/position", "data: 0.0\n---\n"),
    Session("rostopic echo -n 1 /slide/joint_states", JOINT_STATE),
    Session("rostopic echo -n 2 /slide/joint_states", JOINT_STATE * 2),
    Session("rostopic echo -n 1 /slide/status", 'data: "ok: \\"moving\\""\n---\n'),
    Session(
        "rostopic echo -n 1 /slide/description",
        'data: "<robot name=\\"slide\\">\\n  <link name=\\"base\\"/>\\n</robot>"\n---\n',
    ),
    Session(
        "rostopic echo -n 1 /slide/forces",
        'layout: \n  dim: \n    - \n      label: "f"\n      size: 3\n      stride: 3\n  data_offset: 0\n'
        "data: [1.0, -2.5, 1e-09]\n---\n",
    ),
    Session("rostopic echo -n 1 /slide/poses", POSES),
    Session("rostopic echo -n 1 /slide/pose", POSE),
    Session("rostopic echo -n 1 /slide/raw", "layout: \n  dim: []\n  data_offset: 0\ndata: [0, 65, 255]\n---\n"),
    Session("rostopic echo -n 1 /slide/raw/data", "[0, 65, 255]\n---\n"),
    Session("rostopic echo -n 1 '/slide/raw/data[1]'", "65\n---\n"),
    Session(
        "rostopic echo -n 1 /slide/description/data",
        '"<robot name=\\"slide\\">\\n  <link name=\\"base\\"/>\\n</robot>"\n---\n',
    ),
    Session("rostopic echo -n 1 /slide/position/", "data: 0.0\n---\n"),
    Session("rostopic echo -n 2 /slide/position/data", "0.0\n---\n" * 2),
    Session("rostopic echo -n 1 /slide/joint_states/position", "[-0.009203153466526904, 0.25]\n---\n"),
    Session("rostopic echo -n 1 '/slide/joint_states/position[0]'", "-0.009203153466526904\n---\n"),
    Session("rostopic echo -n 1 '/slide/joint_states/name[1]'", '"latch"\n---\n'),
    Session("rostopic echo -n 1 /slide/joint_states/name", "\n- slide\n- latch\n---\n"),
    Session("rostopic echo -n 1 /slide/pose/pose/position", "x: 1.25\ny: 0.0\nz: 0.0\n---\n"),
    Session("rostopic echo -n 1 /slide/pose/pose/position/x", "1.25\n---\n"),
    Session("rostopic echo -n 1 /slide/pose/header/stamp", "\nsecs: 1795219417\nnsecs:  52549076\n---\n"),
    Session("rostopic echo -n 1 /slide/pose/header/stamp/secs", "1795219417\n---\n"),
    Session("rostopic echo -n 1 '/slide/poses/poses[0]/position'", "x: 1.0\ny: 2.0\nz: 3.0\n---\n"),
    Session("rostopic echo -n 1 '/slide/poses/poses[:]/position/x'", "[1.0, 4.0]\n---\n"),
    Session("rostopic echo -n 1 '/slide/poses/poses[0:1]'", FIRST_POSE),
    Session("rostopic echo -n 1 '/slide/joint_states/position[-1]'", "0.25\n---\n"),
    Session("rostopic echo -n 1 '/slide/joint_states/position[::2]'", "[-0.009203153466526904]\n---\n"),
    Session(
        "rostopic echo -p -n 2 /slide/joint_states",
        STATE_CSV + f"{TIME},1,{TIME},,slide,latch,-0.009203153466526904,0.25,-0.49991529479129915,0.0,1.5,-2.0\n" * 2,
    ),
    Session("rostopic echo -p -n 2 /slide/position", "%time,field.data\n" + "1,0.0\n" * 2),
    Session("rostopic echo -p -n 2 /slide/position/data", "%time,field\n" + "1,0.0\n" * 2),
    Session(
        "rostopic echo -p -n 1 /slide/forces",
        "%time,field.layout.dim0.label,field.layout.dim0.size,field.layout.dim0.stride,field.layout.data_offset,"
        "field.data0,field.data1,field.data2\n1,f,3,3,0,1.0,-2.5,1e-09\n",
    ),
    Session("rostopic echo -p -n 1 /slide/status", '%time,field.data\n1,ok: "moving"\n'),
    Session(
        "rostopic echo -p -n 1 /slide/joint_states/position",
        f"%time,field0,field1\n{TIME},-0.009203153466526904,0.25\n",
    ),
    Session("rostopic echo -p -n 1 '/slide/joint_states/position[0]'", f"%time,field\n{TIME},-0.009203153466526904\n"),
    Session(
        "rostopic echo -p -n 1 --nostr /slide/joint_states",
        "%time,field.header.seq,field.header.stamp,field.position0,field.position1,field.velocity0,field.velocity1,"
        f"field.effort0,field.effort1\n{TIME},1,{TIME},-0.009203153466526904,0.25,-0.49991529479129915,0.0,1.5,-2.0\n",
    ),
    Session(
        "rostopic echo -p -n 1 --noarr /slide/joint_states",
        f"%time,field.header.seq,field.header.stamp,field.header.frame_id\n{TIME},1,{TIME},\n",
    ),
    Session("rostopic echo -p -n 1 --nostr --noarr /slide/status", "%time,\n1,\n"),
    Session("rostopic echo -p -n 1 /slide/raw", "%time,field.layout.data_offset\n1,0\n"),
    Session(
        "rostopic echo -p -n 1 /slide/pose",
        POSE_CSV + f"{TIME},1,{TIME},base,1.25,0.0,0.0,0.0,0.0,0.0,1.0\n",
    ),
    Session("rostopic echo -p -n 1 /slide/poses", POSES_CSV + f"{TIME},1,{TIME},base,{VALUES_OF_POSES}\n"),
    Session("rostopic echo -p -n 1 -w 5 /slide/position", "%time,field.data\n1,0.0\n"),
    Session(
        "rostopic echo -n 1 --noarr /slide/joint_states",
        JOINT_STATE.partition("name:")[0] + 'name: "<array type: string, length: 2>"\n'
        'position: "<array type: float64, length: 2>"\nvelocity: "<array type: float64, length: 2>"\n'
        'effort: "<array type: float64, length: 2>"\n---\n',
    ),
    Session(
        "rostopic echo -n 1 --nostr /slide/joint_states",
        JOINT_STATE.replace("''", '"<string length: 0>"').replace(
            "name: \n  - slide\n  - latch", 'name: "<array type: string, length: 2>"'
        ),
    ),
    Session("rostopic echo -n 1 --nostr /slide/status", 'data: "<string length: 12>"\n---\n'),
    Session(
        "rostopic echo -n 1 --noarr /slide/poses",
        POSES.partition("poses:")[0] + 'poses: "<array type: geometry_msgs/Pose, length: 2>"\n---\n',
    ),
    Session("rostopic echo -n 1 --noarr /slide/joint_states/position", '"<array type: float64, length: 2>"\n---\n'),
    Session("rostopic echo -n 1 -w 6 /slide/joint_states/velocity", "[-0.499, 0.0000]\n---\n"),
    Session("rostopic echo -n 1 -w 2 /slide/position", "data: 0.\n---\n"),
    Session("rostopic echo -n 1 -w 6 /slide/pose/pose/position", "x: 1.2500\ny: 0.0000\nz: 0.0000\n---\n"),
    Session("rostopic echo -n 1 -c /slide/position", "\033[2J\033[;Hdata: 0.0\n---\n"),
    Session(
        "rostopic echo -n 1 --filter 'm.position[1] > 0.2' /slide/joint_states/position",
        "[-0.009203153466526904, 0.25]\n---\n",
    ),
    Session("rostopic echo -n 1 --filter m.data==0 /slide/position", "data: 0.0\n---\n"),
    Session("rostopic echo -n 0 /slide/position"),
    Session("rostopic echo -n -1 /slide/position"),
    Session("rostopic echo -n 1 /slide/position __name:=fixed", "data: 0.0\n---\n"),
    usage("rostopic echo", ECHO, "topic must be specified"),
    usage("rostopic echo /a /b", ECHO, "you may only specify one input topic"),
    usage("rostopic echo -n x /slide/position", ECHO, "COUNT must be an integer"),
    usage("rostopic echo -n 1 -w 1 /slide/position", ECHO, "Fixed width for numeric values must be at least 2"),
    usage("rostopic echo -n 1 -w x /slide/position", ECHO, "NUM_WIDTH must be an integer"),
    usage("rostopic echo -a /slide/position", ECHO, "Display all option is only valid when echoing from bag files"),
    usage("rostopic echo --offset -b x.bag /t", ECHO, "offset time option is not valid with bag files"),
    Session(
        'rostopic echo /slide/position > /dev/full; echo "rc $?"',
        "rc 1\n",
        "ERROR: cannot write the output: No space left on device\n",
    ),
    Session('rostopic list /slide | head -n 1; echo "${PIPESTATUS[@]}"', "/slide/command\n0 0\n"),
    Session('rostopic echo /slide/position | grep -m1 data; echo "${PIPESTATUS[@]}"', "data: 0.0\n0 0\n"),
    Session('rostopic hz /slide/pose | head -n 1; echo "${PIPESTATUS[@]}"', "subscribed to [/slide/pose]\n0 0\n"),
    Session("rostopic echo -b /nofile.bag /t", "", "ERROR: bag file [/nofile.bag] does not exist\n", 1),
]


def as_printed(text: str, line: str) -> str:
    """The text with what differs from run to run brought to one form: sequence numbers, and times of arrival."""
    text = re.sub(r"^(  seq:) +\d+$", r"\1 1", text, flags=re.MULTILINE)
    if "echo -p" in line:
        text = re.sub(rf"^{TIME},\d+,", f"{TIME},1,", text, flags=re.MULTILINE)
        text = re.sub(r"^\d{5,12},", "1,", text, flags=re.MULTILINE)
    return text


@pytest.mark.parametrize("session", [*LOOKING, *ECHOED], ids=lambda session: session.line)
def test_the_line_prints_what_the_real_tool_prints(slide: SlideWorld, session: Session) -> None:
    done = slide(session.line)
    expected = session.stdout.replace("<node>", slide.node.name).replace("<uri>", slide.uri)
    assert as_printed(done.stdout, session.line) == expected
    assert done.stderr == session.stderr
    assert done.returncode == session.code


def test_without_a_verb_the_list_of_verbs_goes_to_stdout_with_exit_code_64(slide: SlideWorld) -> None:
    for line in ("rostopic", "rostopic bogus", "rostopic -h"):
        done = slide(line)
        assert (done.returncode, done.stderr) == (64, "")
        for verb in ("bw", "delay", "echo", "find", "hz", "info", "list", "pub", "type"):
            assert f"rostopic {verb}" in done.stdout


@pytest.mark.parametrize("verb", ["bw", "delay", "echo", "find", "hz", "info", "list", "pub", "type"])
def test_every_verb_has_a_help(slide: SlideWorld, verb: str) -> None:
    done = slide(f"rostopic {verb} -h")
    assert (done.returncode, done.stderr) == (0, "")
    assert f"rostopic {verb}" in done.stdout


def test_an_offset_is_counted_from_now(slide: SlideWorld) -> None:
    done = slide("rostopic echo -p -n 1 --offset /slide/pose")
    time, _, stamp, *_ = done.stdout.splitlines()[1].split(",")
    assert time == stamp
    assert int(time) > 10**18  # the node's stamps are of a time that the simulation is not near to


def test_an_offset_in_yaml_has_seconds_rounded_down(slide: SlideWorld) -> None:
    done = slide("rostopic echo -n 1 --offset /slide/pose/header/stamp")
    secs, nsecs = (int(line.partition(":")[2]) for line in done.stdout.splitlines()[1:3])
    assert secs > 10**9
    assert 0 <= nsecs < 10**9


WAITING = [
    ("/slide/command", ""),  # somebody subscribes, nobody publishes
    (
        "//slide//position",
        "WARNING: topic [//slide//position] does not appear to be published yet; did you mean /slide/position?\n",
    ),
    ("pos pos:=/slide/position", "WARNING: topic [/pos] does not appear to be published yet\n"),
]


@pytest.mark.parametrize(("words", "warning"), WAITING, ids=[words for words, _ in WAITING])
def test_an_echo_that_nothing_comes_to_waits(slide: SlideWorld, words: str, warning: str) -> None:
    done = slide.shell.slidectl("--timeout", "0.5", "ros", "rostopic", "echo", *words.split())
    assert (done.stdout, done.returncode) == ("", 4)
    assert done.stderr.startswith(warning)


def test_a_wrong_field_or_index_is_said_once(slide: SlideWorld) -> None:
    done = slide("rostopic echo -n 1 /slide/joint_states/nofield")
    assert done.returncode == 1
    assert "no field 'nofield'" in done.stderr
    assert "position" in done.stderr
    done = slide("rostopic echo -n 1 '/slide/joint_states/position[7]'")
    assert (done.returncode, done.stderr.count("out of range")) == (1, 1)
    assert "fields: data" in slide("rostopic echo -n 1 /slide/position/nofield").stderr
    for index in ("[x]", "[0", "[]"):
        done = slide(f"rostopic echo -n 1 '/slide/joint_states/position{index}'")
        assert (done.stdout, done.returncode, len(done.stderr.splitlines())) == ("", 2, 1)


def test_a_filter_that_is_no_expression_is_refused_before_the_first_message(slide: SlideWorld) -> None:
    for condition in ("m.data ==", "m.nofield > 0", "topic == 1"):
        done = slide(f"rostopic echo -n 1 --filter '{condition}' /slide/position")
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith("ERROR: ")


def test_a_topic_that_does_not_exist_yet_is_waited_for(slide: SlideWorld) -> None:
    waiting = slide.shell.start("rostopic echo -n 1 /later")
    assert waiting.stderr.readline() == "WARNING: topic [/later] does not appear to be published yet\n"
    slide.client.publish("/later", {"data": 2.5}, "std_msgs/Float64", latch=True)
    slide.client.flush()
    stdout, stderr = waiting.communicate(timeout=30)
    assert (stdout, stderr, waiting.returncode) == ("data: 2.5\n---\n", "", 0)


def test_a_time_limit_ends_the_wait_for_a_topic(slide: SlideWorld) -> None:
    done = slide.shell.slidectl("--timeout", "0.2", "ros", "rostopic", "echo", "/nope")
    assert done.returncode == 4
    assert "WARNING: topic [/nope] does not appear to be published yet" in done.stderr


def test_interrupting_an_echo_is_130(slide: SlideWorld) -> None:
    echo = slide.shell.slidectl.start("ros", "rostopic", "echo", "/slide/position")
    assert echo.stdout is not None
    assert echo.stdout.readline() == "data: 0.0\n"
    echo.send_signal(signal.SIGINT)
    assert echo.communicate(timeout=30)[1] == ""
    assert echo.returncode == 130


def test_a_closed_pipe_ends_an_echo_quietly(slide: SlideWorld) -> None:
    done = slide('rostopic echo /slide/position | head -n 2; echo "${PIPESTATUS[@]}"')
    assert (done.stdout, done.stderr) == ("data: 0.0\n---\n0 0\n", "")


def test_without_a_daemon_the_first_line_is_that_of_the_tools_and_the_code_is_3(slide: SlideWorld) -> None:
    for verb in ("list", "list -v", "echo /t", "hz /t", "bw /t", "delay /t", "info /t", "type /t", "find t/T"):
        done = slide.shell.slidectl("-i", "nobody", "ros", "rostopic", *verb.split())
        assert (done.returncode, done.stdout) == (3, "")
        assert done.stderr.splitlines()[0] == "ERROR: Unable to communicate with master!"
        assert "slidectl -i nobody daemon start" in done.stderr
