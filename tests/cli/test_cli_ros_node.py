"""`rosnode` on the nodes that exist here: the simulation's, the robots' state publishers, and running clients."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Iterator

import pytest
from cli_graph_world import slider_world
from cli_ros_world import Shell, SlideWorld, slide_world, usage
from command_line import CommandLine
from fake_daemon import FakeDaemon

from slidectl.client import Client
from slidectl.errors import NoDaemon

RULE = "-" * 80 + "\n"


@pytest.fixture(scope="module")
def slide() -> Iterator[SlideWorld]:
    with slide_world() as world:
        yield world


def test_list_names_uris_or_both(slide: SlideWorld) -> None:
    nodes = ["/gazebo", "/rosapi", "/slidectl", slide.node.name]
    assert slide("rosnode list").stdout.split() == nodes
    assert slide("rosnode list -u").stdout == f"{slide.uri}\n" * len(nodes)
    assert slide("rosnode list -a").stdout == "".join(f"{slide.uri} \t{node}\n" for node in nodes)
    assert slide("rosnode list /gaz").stdout == "\n"
    assert slide("rosnode list /gazebo").stdout == "/gazebo\n"


def test_info_shows_topics_services_and_connections(slide: SlideWorld) -> None:
    with slide.daemon.client() as listener:
        listener.subscribe("/slide/position")
        done = slide(f"rosnode info {slide.node.name}")
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.startswith(
        f"{RULE}Node [{slide.node.name}]\nPublications: \n * /slide/description [std_msgs/String]\n"
        " * /slide/forces [std_msgs/Float64MultiArray]\n"
    )
    assert "\n\nSubscriptions: \n * /slide/command [unknown type]\n\nServices: \n * /sim/get_loggers\n" in done.stdout
    assert re.search(
        rf" \* /slide/stop\n\n\ncontacting node {slide.uri} \.\.\.\nPid: \d+\nConnections:\n"
        r" \* topic: /slide/position\n    \* to: /slidectl_\d+_\d+\n"
        r"    \* direction: outbound\n    \* transport: UNIX\n",
        done.stdout,
    )


def test_quiet_info_does_not_contact_the_node(slide: SlideWorld) -> None:
    done = slide(f"rosnode info -q {slide.node.name.removeprefix('/')}")
    assert done.stdout.endswith(" * /slide/stop\n\n")
    assert "Pid" not in done.stdout


def test_info_of_an_unknown_node_has_empty_sections_and_fails(slide: SlideWorld) -> None:
    done = slide("rosnode info /nope")
    assert done.stdout == f"{RULE}Node [/nope]\nPublications: None\n\nSubscriptions: None\n\nServices: None\n\n"
    assert (done.stderr, done.returncode) == ("cannot contact [/nope]: unknown node\n", 1)


def test_ping_measures_round_trips(slide: SlideWorld) -> None:
    done = slide("rosnode ping -c 2 /gazebo")
    assert (done.stderr, done.returncode) == ("", 0)
    reply = rf"xmlrpc reply from {slide.uri}\ttime=\d+\.\d{{6}}ms\n"
    assert re.fullmatch(
        r"rosnode: node is \[/gazebo\]\npinging /gazebo with a timeout of 3\.0s\n"
        rf"{reply}{reply}ping average: \d+\.\d{{6}}ms\n",
        done.stdout,
    )


def test_ping_goes_on_until_it_is_interrupted(slide: SlideWorld) -> None:
    ping = slide.shell.slidectl.start("ros", "rosnode", "ping", "/gazebo")
    assert ping.stdout is not None
    lines = [ping.stdout.readline() for _ in range(3)]
    assert lines[2].startswith("xmlrpc reply from")
    ping.send_signal(signal.SIGINT)
    ping.communicate(timeout=30)
    assert ping.returncode == 130


def test_ping_of_all_and_of_unknown_nodes(slide: SlideWorld) -> None:
    done = slide("rosnode ping -a")
    assert done.returncode == 0
    assert done.stdout.startswith("Will ping the following nodes: \n * /gazebo\n * /rosapi\n")
    assert done.stdout.count("pinging ") == done.stdout.count("xmlrpc reply") == 4
    done = slide("rosnode ping -c 1 /nope")
    assert (done.stdout, done.stderr) == ("rosnode: node is [/nope]\n", "cannot ping [/nope]: unknown node\n")
    assert done.returncode == 1


def test_machine_is_this_one(slide: SlideWorld) -> None:
    assert slide("rosnode machine").stdout == "localhost\n"
    assert slide("rosnode machine 127.0.0.1").stdout == slide("rosnode list").stdout
    assert slide("rosnode machine a b").stderr.endswith("rosnode: error: please enter only one machine name\n")
    done = slide("rosnode machine nohost.invalid")
    assert done.stderr == "ERROR: cannot resolve machine name [nohost.invalid] to address\n"
    assert done.returncode == 1


def test_there_is_nothing_to_clean_up(slide: SlideWorld) -> None:
    done = slide("rosnode cleanup < /dev/null")
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)


PING = "rosnode ping [options] <node>"
USAGES = [
    usage("rosnode list a b", "rosnode list", "invalid args: you may only specify one namespace"),
    usage("rosnode info", "rosnode info [options] node1 [node2...]", "You must specify at least one node name"),
    usage("rosnode ping -a -c 1", PING, "-c may not be used with --all"),
    usage("rosnode ping -c x /sim", PING, "option -c: invalid integer value: 'x'"),
]


@pytest.mark.parametrize("session", USAGES, ids=lambda session: session.line)
def test_wrong_usage(slide: SlideWorld, session: tuple[str, str, str, int]) -> None:
    done = slide(session[0])
    assert (done.stdout, done.stderr, done.returncode) == (session[1], session[2], session[3])


def test_ping_without_a_node_lists_them(slide: SlideWorld) -> None:
    done = slide("rosnode ping")
    assert done.returncode == 2
    assert "rosnode: error: Please enter a node to ping. Available nodes are:\n/gazebo\n" in done.stderr


def test_without_a_verb(slide: SlideWorld) -> None:
    assert [slide(line).returncode for line in ("rosnode", "rosnode bogus", "rosnode --help")] == [64, 64, 0]
    assert "rosnode ping" in slide("rosnode").stdout


def test_without_a_daemon_the_code_is_3(slide: SlideWorld) -> None:
    for words in ("list", "info /sim", "ping /sim", "ping -a", "kill /sim", "cleanup", "machine"):
        done = slide.shell.slidectl("-i", "nobody", "ros", "rosnode", *words.split())
        assert done.returncode == 3, words
        assert done.stderr.splitlines()[0] == "ERROR: Unable to communicate with master!"


def listener(slide: SlideWorld) -> tuple[object, str]:
    """A running `rostopic echo`, and the name of its node."""
    before = set(slide("rosnode list").stdout.split())
    process = slide.shell.slidectl.start("ros", "rostopic", "echo", "/slide/position")
    assert process.stdout is not None
    process.stdout.readline()
    (name,) = set(slide("rosnode list").stdout.split()) - before
    return process, name


def test_kill_ends_a_client_as_ctrl_c_would(slide: SlideWorld) -> None:
    process, name = listener(slide)
    done = slide(f"rosnode kill {name}")
    assert (done.stdout, done.stderr, done.returncode) == (f"killing {name}\nkilled\n", "", 0)
    process.communicate(timeout=30)
    assert process.returncode == 130
    assert name not in slide("rosnode list").stdout


def test_kill_asks_which_one(slide: SlideWorld) -> None:
    process, name = listener(slide)
    number = slide("rosnode list").stdout.split().index(name) + 1
    done = slide("rosnode kill", stdin=f"{number}\n")
    assert f"{number}. {name}\n" in done.stdout
    assert done.stdout.endswith(f"Please enter the number of the node you wish to kill.\n> killing {name}\nkilled\n")
    process.communicate(timeout=30)
    for answer in ("99\n", "", "x\n"):
        done = slide("rosnode kill", stdin=answer)
        assert done.returncode == 1
        assert "ERROR: " in done.stderr


def test_kill_of_an_unknown_node_kills_nobody(slide: SlideWorld) -> None:
    done = slide(f"rosnode kill /nope {slide.node.name}")
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr.startswith("ERROR: Unknown node(s):\n * /nope\nnodes: /gazebo, ")


@pytest.mark.parametrize(
    ("node", "pid_of_daemon"), [("/slidectl_0_1", None), ("/slidectl_{here}_1", 1), ("/slidectl_{here}_1", 0)]
)
def test_kill_across_containers_signals_nobody(
    slidectl: CommandLine, fake: FakeDaemon, node: str, pid_of_daemon: int | None
) -> None:
    with subprocess.Popen(["sleep", "600"], process_group=0) as bystander:
        node = node.format(here=bystander.pid)
        fake.answers["/rosapi/nodes"] = {"nodes": [node]}
        fake.answers["/slidectl/status"] = {"pid": os.getpid() if pid_of_daemon is None else pid_of_daemon}
        fake.answers["/rosapi/node_details"] = {"subscribing": [], "publishing": [], "services": []}
        done = subprocess.run(
            slidectl.argv("ros", "rosnode", "kill", node),
            env=slidectl.environment,
            process_group=bystander.pid,
            capture_output=True,
            text=True,
        )
        unharmed = bystander.poll() is None
        bystander.kill()
    assert done.returncode == 1
    assert done.stderr.startswith("ERROR: these nodes, or the daemon, run in another container")
    assert "killing" not in done.stdout
    assert unharmed


def test_a_killed_state_publisher_is_gone_until_it_is_started_again_and_gazebo_ends_the_daemon() -> None:
    with slider_world() as world:
        shell = Shell(world.slidectl)
        node = "/slider/robot_state_publisher"
        assert node in shell.run("rosnode list").stdout
        assert shell.run(f"rosnode kill {node}").stdout == f"killing {node}\nkilled\n"
        assert node not in shell.run("rosnode list").stdout
        assert shell.run("rostopic list | grep tf").stdout == ""
        restarted = world.slidectl.start("ros", "rosrun", "robot_state_publisher", "robot_state_publisher")
        assert restarted.stdout is not None
        assert restarted.stdout.readline() == "the simulation publishes the frames of slider at 50 Hz\n"
        assert node in shell.run("rosnode list").stdout
        restarted.send_signal(signal.SIGINT)
        restarted.communicate(timeout=30)
        done = shell.run("rosnode kill /gazebo")
        assert (done.stdout, done.stderr, done.returncode) == ("killing /gazebo\nkilled\n", "", 0)
        with pytest.raises(NoDaemon):
            Client(socket=world.daemon.paths.socket_text, timeout=0.0)


def test_all_nodes_are_killed_and_the_one_that_ends_the_daemon_is_the_last() -> None:
    with slider_world() as world:
        done = Shell(world.slidectl).run("rosnode kill -a")
        assert (done.stderr, done.returncode) == ("", 0)
        killed = re.findall(r"killing (\S+)", done.stdout)
        assert "/slider/robot_state_publisher" in killed
        assert killed.index("/slider/robot_state_publisher") < killed.index("/gazebo")
        assert done.stdout.endswith("killed\n")
        with pytest.raises(NoDaemon):
            Client(socket=world.daemon.paths.socket_text, timeout=0.0)
