"""Each verb of rostopic, rosservice, rosparam and rosnode prints of slidectl what it prints of nodes of ROS.

On one side the tools talk to a daemon through its gateway, on the other to a real roscore, where rospy nodes do what
was recorded of the daemon. Hosts, ports, process ids, times and measured rates may differ, nothing else.
"""

from __future__ import annotations

import re
import shlex
import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from daemon_fixture import ROOT, running_daemon, shown
from ros1_tools import Done, Ros, both, gateway, graph, need_ros, normal, roscore, stand_in
from waiting import eventually

COMMAND = "/slider/joint1_position_controller/command"
STATES = "/slider/joint_states"
CONTROLLERS = ["joint_state_controller", "joint1_position_controller"]
CALLS: list[tuple[str, dict[str, Any]]] = [
    ("/slider/controller_manager/list_controllers", {}),
    ("/slider/controller_manager/list_controller_types", {}),
    ("/gazebo/get_model_state", {"model_name": "slider"}),
    ("/gazebo/get_model_state", {"model_name": "nobody"}),
    ("/gazebo/get_world_properties", {}),
    ("/slider/controller_manager/load_controller", {"name": "no_such"}),
]
Compare = Callable[[Callable[[Ros], Any]], Any]


@pytest.fixture(scope="module")
def sides() -> Iterator[list[Ros]]:
    """The tools with slidectl, and with the real roscore."""
    need_ros()
    with running_daemon() as daemon, daemon.client() as client:
        client.spawn("slider", controllers=str(ROOT / "config/slider_control.yaml"), start=CONTROLLERS)
        client.sleep(1.0)
        recorded = graph(client, CALLS)
        with gateway(daemon) as ours, roscore() as theirs, stand_in(theirs, recorded):
            yield [ours, theirs]


@pytest.fixture
def compare(sides: list[Ros]) -> Compare:
    """Does the same on both sides and asserts that what comes out of it is the same; returns that."""

    def do(action: Callable[[Ros], Any]) -> Any:
        ours, theirs = both(*(lambda side=side: action(side) for side in sides))
        assert ours == theirs
        return ours

    return do


def printed(side: Ros, line: str, stdin: str = "") -> Done:
    """What the line prints, in normal form."""
    done = side.run(line, stdin)
    return Done(normal(done.stdout), normal(done.stderr), done.returncode)


def test_the_commands_of_the_page_work() -> None:
    need_ros()
    export, *lines = shown("ros1.md", "rosbag record")
    assert export[0] == "export"
    with running_daemon() as daemon, daemon.client() as client:
        client.spawn("slider", controllers=str(ROOT / "config/slider_control.yaml"), start=CONTROLLERS)
        with gateway(daemon) as ros:
            for words in lines:
                ros.ok(shlex.join(words))
            assert list(ros.folder.glob("*.bag"))
        assert client.call("/slidectl/status")["paused"]


# Lines that run to their end

LINES = [
    "rostopic list",
    "rostopic list -p",
    "rostopic list -s",
    "rostopic list /slider",
    "rostopic list -v /slider/joint_states",
    "rostopic list /nowhere",
    "rostopic list --host",
    "rostopic info /slider/joint_states",
    "rostopic info /clock",
    f"rostopic info {COMMAND}",
    "rostopic info /nowhere",
    "rostopic type /slider/joint_states",
    "rostopic type /slider/joint_states/position[0]",
    "rostopic type /slider/joint_states/header/stamp",
    f"rostopic type {COMMAND}",
    "rostopic type /nowhere",
    "rostopic find sensor_msgs/JointState",
    "rostopic find gazebo_msgs/LinkStates",
    "rostopic find std_msgs/Nothing",
    "rostopic echo -n 1 /slider/joint_states",
    "rostopic echo -n 1 -p /slider/joint_states",
    "rostopic echo -n 1 --noarr /slider/joint_states",
    "rostopic echo -n 1 --nostr /slider/joint_states",
    "rostopic echo -n 2 /slider/joint_states/position[0]",
    "rostopic echo -n 1 /slider/joint_states/header/stamp",
    "rostopic echo -n 1 --offset /clock",
    "rostopic echo -n 1 -c /slider/joint_states/name",
    "rostopic echo -n 1 --filter 'm.name[0] == \"joint1\"' /slider/joint_states",
    "rostopic echo -n 1 /clock",
    "rostopic echo -n 1 /gazebo/model_states",
    "rostopic echo -n 1 /gazebo/link_states",
    "rostopic echo -n 1 /slider/joint1_position_controller/state",
    "rostopic echo -n 1 /slider/joint1_position_controller/pid/parameter_updates",
    "rostopic echo -n 1 /slider/joint1_position_controller/pid/parameter_descriptions",
    "rostopic echo -n 1 /tf",
    "rostopic echo -n 1 /tf_static",
    f"rostopic pub -1 {COMMAND} std_msgs/Float64 0.0",
    f"rostopic pub -1 {COMMAND} std_msgs/Float64 'data: 0.0'",
    f"rostopic pub --once -f command.yaml {COMMAND} std_msgs/Float64",
    f"rostopic pub -1 {COMMAND} std_msgs/Float64 'position: 0.0'",
    f"rostopic pub -1 {COMMAND} std_msgs/Float64 1.0 2.0",
    f"rostopic pub -1 {COMMAND} no_msgs/Nothing 1.0",
    "rostopic pub",
    "rosservice list",
    "rosservice list -n",
    "rosservice list /slider",
    "rosservice list /slider/controller_manager/list_controllers",
    "rosservice list /nowhere",
    "rosservice args /gazebo/get_model_state",
    "rosservice args /gazebo/spawn_urdf_model",
    "rosservice args /gazebo/pause_physics",
    "rosservice args /nowhere",
    "rosservice call /slider/controller_manager/list_controllers",
    "rosservice call /slider/controller_manager/list_controllers {}",
    "rosservice call /slider/controller_manager/list_controller_types",
    "rosservice call /slider/controller_manager/load_controller no_such",
    "rosservice call /gazebo/get_model_state slider ''",
    "rosservice call /gazebo/get_model_state '{model_name: slider}'",
    "rosservice call /gazebo/get_model_state nobody ''",
    "rosservice call /gazebo/get_model_state slider",
    "rosservice call /gazebo/get_model_state '{name: slider}'",
    "rosservice call /gazebo/get_world_properties",
    "rosservice call /nowhere",
    "rosservice call --wait /gazebo/get_world_properties",
    "rosservice find gazebo_msgs/GetModelState",
    "rosservice find std_srvs/Empty",
    "rosservice find std_srvs/Nothing",
    "rosservice info /gazebo/get_model_state",
    "rosservice info /slider/joint1_position_controller/pid/set_parameters",
    "rosservice info /nowhere",
    "rosservice type /slider/controller_manager/switch_controller",
    "rosservice type /nowhere",
    "rosservice uri /slider/controller_manager/switch_controller",
    "rosservice uri /nowhere",
    "rosparam get /slider/joint1_position_controller/pid",
    "rosparam get /slider/joint1_position_controller/pid/p",
    "rosparam get /slider/joint1_position_controller/pid/antiwindup",
    "rosparam get -p /slider/joint1_position_controller",
    "rosparam get /slider/robot_description",
    "rosparam get /slider",
    "rosparam get /use_sim_time",
    "rosparam get /nowhere",
    "rosparam list /slider",
    "rosparam list /nowhere",
    "rosparam dump - /slider",
    "rosparam delete /nowhere",
    "rosparam get",
    "rosnode list",
    "rosnode list -u",
    "rosnode list -a",
    "rosnode list /slider",
    "rosnode info /slidectl",
    "rosnode info /slider/robot_state_publisher",
    "rosnode info /nobody",
    "rosnode machine",
    "rosnode machine localhost",
    "rosnode machine nowhere",
    "rosnode ping /nobody",
    "rosnode kill /nobody",
]


@pytest.mark.parametrize("line", LINES)
def test_a_line_prints_the_same(compare: Compare, line: str) -> None:
    def act(side: Ros) -> Done:
        (side.folder / "command.yaml").write_text("data: 0.0\n", "utf-8")
        return printed(side, line)

    compare(act)


def test_rostopic_list_v_tells_the_same_in_its_own_order(compare: Compare) -> None:
    lines = compare(lambda side: sorted(printed(side, "rostopic list -v").stdout.splitlines()))
    assert " * /slider/joint_states [sensor_msgs/JointState] 1 publisher" in lines


def test_rosparam_list_tells_the_same_but_for_the_launcher_of_roscore(compare: Compare) -> None:
    lines = compare(lambda side: re.sub("/roslaunch/.*\n", "", printed(side, "rosparam list").stdout).splitlines())
    assert {"/run_id", "/rosdistro", "/rosversion", "/use_sim_time"} < set(lines)


def node_info(side: Ros, node: str) -> list[str]:
    """What `rosnode info` prints, with the connections in an order of their own."""
    head, _, connections = printed(side, f"rosnode info {node}").stdout.partition("Connections:\n")
    return [head.strip(), *sorted(connections.strip().split(" * topic: "))]


@pytest.mark.parametrize("node", ["/gazebo", "/rosout"])
def test_rosnode_info_tells_the_same_but_for_connections_within_slidectl(compare: Compare, node: str) -> None:
    assert "Services: " in compare(lambda side: node_info(side, node)[0])


def test_rosnode_ping_tells_the_time_of_each_answer(compare: Compare) -> None:
    def act(side: Ros) -> str:
        return re.sub(r"[\d.]+ms", "N ms", printed(side, "rosnode ping -c 2 /gazebo").stdout)

    assert compare(act).count("xmlrpc reply from") == 2
    all_nodes = compare(lambda side: sorted(set(re.findall(r"\S+: time|ping \S+", side.ok("rosnode ping -a")))))
    assert all_nodes


# Lines that measure


def measured(text: str) -> list[str]:
    """The different lines, with N for each number; without what is said before there is anything to measure."""
    words = (re.sub(r"-?\b\d+(\.\d+)?([eE][-+]?\d+)?(B|KB|MB|s)?\b", "N", line).split() for line in text.splitlines())
    lines = {re.sub("=+|.*topic rate", "=", " ".join(line)) for line in words}
    lines = {line for line in lines if not line.startswith("subscribed to")}  # it is cut off now and then
    return sorted(lines - {"no new messages", "WARNING: may be using simulated time", "=", ""})


@pytest.mark.parametrize(
    ("line", "until"),
    [
        (f"rostopic hz {STATES}", "average rate.*\n.*window"),
        (f"rostopic hz -w 20 {STATES} /clock", "topic +rate"),
        (f"rostopic bw {STATES}", "average.*\n.*window"),
        (f"rostopic delay {STATES}", "average delay.*\n.*window"),
        (f"rostopic hz --wall-time {STATES}", "average rate.*\n.*window"),
        ("rostopic delay /clock", "does not have|no header|header"),
    ],
)
def test_what_measures_prints_the_same_but_for_the_figures(compare: Compare, line: str, until: str) -> None:
    def act(side: Ros) -> list[str]:
        with side.started(line) as program:
            program.prints(until)
            return measured(program.interrupt())

    assert compare(act)


# Lines that stay


def test_echo_of_a_topic_that_comes_later(compare: Compare) -> None:
    def act(side: Ros) -> list[str]:
        with side.started("rostopic echo /later") as echo:
            echo.prints("does not appear to be published yet")
            with side.started("rostopic pub -r 10 /later std_msgs/String 'a text'") as publisher:
                echo.prints("a text")
                assert "/later" in side.ok("rostopic list").split()
                said = publisher.interrupt()
            eventually(lambda: "/later" not in side.ok("rostopic list -p").split())
            return [sorted(set(echo.interrupt().splitlines())), said]

    compare(act)


def test_echo_of_a_field_that_is_not_there(compare: Compare) -> None:
    def act(side: Ros) -> str:
        with side.started("rostopic echo /slider/joint_states/nowhere") as echo:
            return echo.prints("nowhere.*\n")

    compare(act)


@pytest.mark.parametrize("options", ["-r 20", "-l", "", "-r 20 -s"])
def test_pub_that_stays_reaches_a_reader(compare: Compare, options: str) -> None:
    topic = "/stays" + re.sub(r"\W", "", options)

    def act(side: Ros) -> list[Any]:
        with side.started(f"rostopic echo {topic}/data") as echo:
            echo.prints("does not appear")
            with side.started(f"rostopic pub {options} {topic} std_msgs/Float64 0.25") as publisher:
                echo.prints("^0.25$")
                info = re.sub(r"_\d+_\d+", "_N", normal(side.ok(f"rostopic info {topic}")))
                return [publisher.interrupt(), info]

    compare(act)


def test_pub_reads_messages_from_its_standard_input(compare: Compare) -> None:
    def act(side: Ros) -> list[Any]:
        with side.started("rostopic echo /typed/data") as echo:
            echo.prints("does not appear")
            done = printed(side, "rostopic pub -r 2 /typed std_msgs/Float64", "data: 1.0\n---\ndata: 2.0\n---\n")
            echo.prints(r"1\.0\n---\n2\.0")
            return [done]

    compare(act)


def test_pub_of_what_the_type_cannot_hold(compare: Compare) -> None:
    def act(side: Ros) -> tuple[str, set[str], int]:
        stdout, stderr, code = printed(side, f"rostopic pub -1 {COMMAND} std_msgs/Float64 one")
        return stdout, set(stderr.splitlines()), code

    assert "field data must be float type" in str(compare(act))


# Parameters

DOCUMENT = """
text: some words
number: 3
ratio: 0.5
large: 1e10
flag: true
list: [1, 2.5, three, [4, 5]]
tree: {a: {b: {c: deep}}, empty: []}
angle: deg(180)
turn: rad(2*pi)
multi: |
  first
  second
unicode: "größer"
"""


@pytest.mark.parametrize(
    "value",
    ["1", "1.0", "-1e-3", "true", "no", "text", "''", "'1'", "'[1, 2, 3]'", "'{a: 1, b: {c: x}}'", "'a: b'", "''''",
     "größer", "' two  words '", "'[]'", "'{}'", "1e400", "2147483648", "'!!str 5'", "null", "2026-11-23"],
)  # fmt: skip
def test_a_parameter_is_read_back_as_it_was_set(compare: Compare, value: str) -> None:
    compare(
        lambda side: [
            printed(side, f"rosparam set /written {value}"),
            printed(side, "rosparam get /written"),
            printed(side, "rosparam list /written"),
            side.run("rosparam delete /written").returncode in (0, 1),
        ]
    )


def test_yaml_is_loaded_dumped_and_deleted_as_trees(compare: Compare) -> None:
    def act(side: Ros) -> list[Any]:
        (side.folder / "tree.yaml").write_text(DOCUMENT, "utf-8")
        done = [printed(side, line) for line in ("rosparam load tree.yaml /tree", "rosparam get /tree")]
        done += [printed(side, "rosparam dump dumped.yaml /tree"), (side.folder / "dumped.yaml").read_text("utf-8")]
        done += [printed(side, line) for line in ("rosparam list /tree", "rosparam dump -v all.yaml /tree")]
        done += [printed(side, line) for line in ("rosparam get /tree/tree/a", "rosparam get /tree/list")]
        done += [printed(side, "rosparam set /tree/tree '{x: 1}'"), printed(side, "rosparam get /tree/tree")]
        done += [printed(side, line) for line in ("rosparam delete /tree/tree", "rosparam list /tree")]
        done += [printed(side, line) for line in ("rosparam delete -v /tree", "rosparam get /tree")]
        done += [printed(side, "rosparam load /no/such.yaml"), printed(side, "rosparam set /tree '{'")]
        return done

    assert compare(act)[0].returncode == 0


def test_bytes_are_refused_as_a_parameter_with_the_reason(sides: list[Ros]) -> None:
    done = sides[0].run("rosparam set /bytes '!!binary \"AAEC/w==\"'")
    assert done.returncode == 1
    assert "parameter /bytes: binary data is not a value" in done.stderr


# Nodes of others


def test_a_node_is_killed_and_one_that_died_is_cleaned_up(compare: Compare) -> None:
    def act(side: Ros) -> list[Any]:
        done: list[Any] = []
        with side.started("talker.py kind") as kind, side.started("talker.py dead") as dead:
            kind.prints("^ready")
            dead.prints("^ready")
            for topic in ("/rosout", "/clock"):  # connections come a moment after the node
                eventually(lambda topic=topic: any(topic in part for part in node_info(side, "/kind")[1:]))
            done += [node_info(side, "/kind")]
            done += [printed(side, f"rosnode {verb}") for verb in ("list", "kill /kind")]
            kind.ends()
            done += [printed(side, "rosnode list")]
            dead.signal(signal.SIGKILL)
            dead.ends()
            done += [printed(side, "rosnode ping -c 1 /dead"), printed(side, "rosnode info /dead")]
            done += [printed(side, "rostopic info /dead/said"), printed(side, "rosservice call /dead/answer")]
            done += [printed(side, "rosnode cleanup", "n\n"), printed(side, "rosnode list")]
            done += [printed(side, "rosnode cleanup", "y\n"), printed(side, "rosnode list")]
            done += [printed(side, "rosservice list /dead"), printed(side, "rostopic list /dead")]
        return done

    compare(act)


def test_tools_say_the_same_of_nodes_that_are_not_slidectls(compare: Compare) -> None:
    lines = (
        *("rostopic info /other/said", "rostopic echo -n 1 /other/said", "rostopic type /other/said"),
        *("rosservice info /other/answer", "rosservice call /other/answer", "rosservice call /other/fail"),
        *("rosservice list -n /other/answer", "rosnode list /other", "rosnode machine localhost"),
        *("rosservice find std_srvs/Trigger",),
    )

    def act(side: Ros) -> list[Any]:
        with side.started("talker.py other") as talker:
            talker.prints("^ready")
            return [printed(side, line) for line in lines]

    assert "data:" in compare(act)[1].stdout
