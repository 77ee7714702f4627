"""Nodes of topic_tools and twist_mux in launch files: what they pass on in a real world."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import Launched, kill_all
from waiting import eventually

from slidectl import Client
from slidectl.client.connection import Subscription
from slidectl.errors import Refused, TimedOut

TWIST_MUX = """<node pkg="twist_mux" type="twist_mux" name="mux"><remap from="cmd_vel_out" to="/cart/cmd_vel"/>
  <rosparam>
    topics:
    - {name: autopilot, topic: auto, timeout: 0.5, priority: 10}
    - {name: pad, topic: pad, timeout: 0.5, priority: 100}
    locks: [{name: pause, topic: pause, timeout: 0.0, priority: 50}]
  </rosparam></node>"""


@pytest.fixture
def world(slidectl: CommandLine) -> Iterator[CommandLine]:
    """A daemon with a cart, in a world that is stepped."""
    slidectl.ok("daemon", "start")
    slidectl.ok("sim", "pause")
    slidectl.ok("spawn", "cart")
    yield slidectl
    slidectl("daemon", "stop")
    kill_all(slidectl.runtime)


def launched(world: CommandLine, tmp_path: Path, content: str) -> Launched:
    path = tmp_path / "topics.launch"
    path.write_text(f"<launch>{content}</launch>")
    run = Launched(world, str(path))
    run.up()
    return run


def node(kind: str, args: str, name: str = "") -> str:
    return f'<node pkg="topic_tools" type="{kind}" name="{name or kind}" args="{args}"/>'


def count(subscription: Subscription, most: int) -> int:
    """How many messages come, up to so many and one more that is not to come."""
    found = 0
    with suppress(TimedOut):
        while found <= most:
            subscription.get(2.0 if found < most else 0.3)
            found += 1
    return found


def test_messages_are_relayed_and_throttled_by_number_and_by_bytes(world: CommandLine, tmp_path: Path) -> None:
    nodes = [("relay", "cart/odom mirror"), ("throttle", "messages cart/odom 10")]
    nodes.append(("throttle", "bytes cart/odom 1400 1 small"))
    run = launched(world, tmp_path, "".join(node(*one, name=f"n{index}") for index, one in enumerate(nodes)))
    with world.client() as client:
        counts = {"/mirror": 50, "/cart/odom_throttle": 10, "/small": 2}
        heard = {topic: client.subscribe(topic, "nav_msgs/Odometry") for topic in counts}
        client.step(1000)
        assert {topic: count(heard[topic], most) for topic, most in counts.items()} == counts
    assert run.interrupt() == 130
    assert "/mirror" not in world.ok("topic", "list")


def test_a_relay_latches_what_was_latched_and_says_when_its_output_takes_nothing(
    world: CommandLine, tmp_path: Path
) -> None:
    with world.client() as client:
        client.publish("/name", {"data": "cart"}, "std_msgs/String", latch=True)
        client.advertise("/taken", "std_msgs/Float64")
        client.flush()
        run = launched(world, tmp_path, node("relay", "name again", "one") + node("relay", "name taken", "two"))
        run.until("/two: not passed on to /taken")
        again = client.subscribe("/again", "std_msgs/String")
        client.publish("/name", {"data": "wagon"})
        assert [again.get()["data"], again.get()["data"]] == ["cart", "wagon"]
        with world.client() as late:
            assert late.subscribe("/again").get()["data"] == "wagon"
    run.interrupt()
    assert run.text.count("not passed on to /taken") == 1


def test_a_relay_outlives_a_daemon_that_is_busy_while_it_looks_for_its_topic(
    world: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "relay.launch"
    path.write_text(f"<launch>{node('relay', 'late again')}</launch>")
    run = Launched(world, str(path), "--timeout", "5")
    run.up()
    with world.client() as client:
        os.kill(client.daemon_pid, signal.SIGSTOP)
        try:
            run.until("it searches for its topics again")
        finally:
            os.kill(client.daemon_pid, signal.SIGCONT)
        out = client.subscribe("/again", "std_msgs/Float64")
        client.advertise("/late", "std_msgs/Float64")
        eventually(lambda: hears(client, "/late"), "nobody listens to /late")
        client.deliver("/late", {"data": 2.0})
        assert out.get()["data"] == 2.0
    assert run.interrupt() == 130


def test_a_mux_passes_on_the_input_that_is_selected_and_takes_more(world: CommandLine, tmp_path: Path) -> None:
    run = launched(world, tmp_path, node("mux", "out /one /two"))
    with world.client() as client:
        out, selected = client.subscribe("/out", "std_msgs/Float64"), client.subscribe("/mux/selected")
        assert selected.get()["data"] == "/one"
        assert client.call("/mux/select", {"topic": "two"})["prev_topic"] == "/one"
        for topic in ("/one", "/two"):
            client.advertise(topic, "std_msgs/Float64")
        eventually(lambda: hears(client, "/two"), "nobody listens to /two")
        client.deliver("/two", {"data": 2.0})
        assert out.get()["data"] == 2.0
        client.call("/mux/add", {"topic": "/three"})
        assert client.call("/mux/list")["topics"] == ["/one", "/two", "/three"]
        with pytest.raises(Refused, match="is selected"):
            client.call("/mux/delete", {"topic": "/two"})
        with pytest.raises(Refused, match="no input '/four' of /mux"):
            client.call("/mux/select", {"topic": "/four"})
        assert client.call("/mux/select", {"topic": "__none"})["prev_topic"] == "/two"
        assert not hears(client, "/two")
    run.interrupt()


def hears(client: Client, topic: str) -> bool:
    """Whether somebody subscribes to the topic."""
    return bool(client.call("/rosapi/subscribers", {"topic": topic})["subscribers"])


def test_the_twist_with_the_highest_priority_drives_unless_it_is_silent_or_locked(
    world: CommandLine, tmp_path: Path
) -> None:
    run = launched(world, tmp_path, TWIST_MUX)
    with world.client() as client:
        out = client.subscribe("/cart/cmd_vel", "geometry_msgs/Twist")

        def send(topic: str, velocity: float) -> None:
            client.deliver(topic, {"linear": {"x": velocity}}, "geometry_msgs/Twist")

        client.step(1000)
        send("/auto", 0.1)
        send("/pad", 0.2)
        send("/auto", -1.0)  # the pad has spoken
        client.step(600)
        send("/auto", 0.3)  # it is silent
        client.deliver("/pause", {"data": True}, "std_msgs/Bool")
        send("/auto", -1.0)
        send("/pad", 0.4)
        client.call("/gazebo/reset_simulation")
        client.step(600)
        send("/auto", 0.5)  # what came before the reset does not count
        for count in range(6, 60):
            client.publish("/pad", {"linear": {"x": count / 10}}, "geometry_msgs/Twist")
            client.publish("/auto", {"linear": {"x": -1.0}}, "geometry_msgs/Twist")
        assert [out.get(30.0)["linear"]["x"] for _ in range(59)] == [count / 10 for count in range(1, 60)]
    run.interrupt()


def test_a_source_whose_topic_is_no_name_is_refused_with_what_is_expected(world: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "mux.launch"
    path.write_text(f"<launch>{TWIST_MUX.replace('topic: auto', 'topic: 5')}</launch>")
    done = world("launch", str(path))
    assert done.returncode == 1
    assert "an entry has name, topic, timeout (s) and priority, not {'name': 'autopilot', 'topic': 5" in done.stderr


@pytest.mark.parametrize(
    ("kind", "args", "words"),
    [
        ("relay", "", "takes IN [OUT]"),
        ("throttle", "messages a", "takes messages IN RATE [OUT]"),
        ("throttle", "messages a 0", "the rate must be above 0"),
        ("throttle", "messages a often", "is a number, not 'often'"),
        ("mux", "out", "takes OUT IN [IN]..."),
    ],
)
def test_arguments_that_make_no_sense_are_found_before_anything_starts(
    slidectl: CommandLine, tmp_path: Path, kind: str, args: str, words: str
) -> None:
    path = tmp_path / "bad.launch"
    path.write_text(f"<launch>{node(kind, args)}</launch>")
    done = slidectl("launch", str(path))
    assert (done.returncode, words in done.stderr) == (2, True), done.stderr


def test_a_robot_without_controllers_has_its_topics_where_its_spawn_node_is(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "box.urdf"
    file.write_text(
        '<robot name="box"><link name="base"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1"'
        ' iyz="0" izz="1"/></inertial></link><gazebo><plugin name="p" filename="libgazebo_ros_planar_move.so"/>'
        "</gazebo></robot>"
    )
    spawn = f'<node pkg="gazebo_ros" type="spawn_model" name="s" args="-urdf -file {file} -model NAME"/>'
    grouped = f'<group ns="two">{spawn.replace("NAME", "b")}</group>'
    path = tmp_path / "boxes.launch"
    path.write_text(f"<launch>{spawn.replace('NAME', 'a')}{grouped}</launch>")
    world.ok("launch", str(path))
    topics = world.ok("topic", "list").splitlines()
    assert {"/cmd_vel", "/odom", "/two/cmd_vel", "/two/odom"} <= set(topics)


def test_a_launch_file_of_the_joint_state_controller_package_starts_it(world: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "states.launch"
    path.write_text(
        '<launch><group ns="cart"><include file="$(find joint_state_controller)/joint_state_controller.launch"/>'
        "</group></launch>"
    )
    run = Launched(world, str(path))
    run.up()
    assert "joint_state_controller" in world.ok("controller", "list")
    run.interrupt()
