"""rospy nodes beside slidectl: topics, services, actions, parameters, time, and what goes wrong."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_fixture import ROOT, Runtime, running_daemon
from ros1_tools import Program, Ros, gateway, need_ros
from waiting import eventually

from slidectl.client import Client

COMMAND = "/slider/joint1_position_controller/command"
PID = "/slider/joint1_position_controller/pid"
CONTROLLERS = ["joint_state_controller", "joint1_position_controller"]

LISTENER = """
import sys, rospy
from sensor_msgs.msg import JointState

count = gaps = last = 0
def take(message):
    global count, gaps, last
    stamp = message.header.stamp.to_nsec()
    gaps += bool(count) and stamp != last + 1000000
    last = stamp
    count += 1
    if count % 200 == 0:
        print("count", count, "gaps", gaps, flush=True)

rospy.init_node("listener", anonymous=True)
rospy.Subscriber("/slider/joint_states", JointState, take, queue_size=None)
print("ready", flush=True)
rospy.spin()
"""


def spawn_slider(client: Client, rate: int = 1000) -> None:
    """The slider, whose state is published in each cycle."""
    client.spawn("slider", controllers=str(ROOT / "config/slider_control.yaml"))
    client.params["/slider/joint_state_controller/publish_rate"] = rate
    manager = client.controllers("/slider")
    for name in CONTROLLERS:
        manager.load(name)
    manager.switch(CONTROLLERS, [])


@pytest.fixture(scope="module")
def daemon() -> Iterator[Runtime]:
    need_ros()
    with running_daemon() as daemon:
        yield daemon


@pytest.fixture(scope="module")
def client(daemon: Runtime) -> Iterator[Client]:
    with daemon.client(60.0) as client:
        spawn_slider(client)
        yield client


@pytest.fixture(scope="module")
def gate(daemon: Runtime, client: Client) -> Iterator[Ros]:  # noqa: ARG001
    with gateway(daemon) as ros:
        yield ros


@pytest.fixture
def ros(gate: Ros) -> Iterator[Ros]:
    """ROS with the gateway as its master; the nodes of a test end with it."""
    with Ros(gate.env["ROS_MASTER_URI"]) as ros:
        ros.gateway = gate.gateway
        yield ros


def counted(program: Program) -> tuple[int, int]:
    """How many messages the listener got, and how many gaps there were between them."""
    found = re.findall(r"count (\d+) gaps (\d+)", program.output)
    return (int(found[-1][0]), int(found[-1][1])) if found else (0, 0)


def slidectl(daemon: Runtime, *words: str) -> list[str]:
    del daemon
    return [sys.executable, "-m", "slidectl", *words]


# Topics


def test_a_subscriber_at_1_khz_loses_nothing(ros: Ros) -> None:
    listener = ros.python(LISTENER)
    listener.prints("count 3000 ")
    assert counted(listener)[1] == 0


def test_a_publisher_moves_the_slider(ros: Ros, client: Client) -> None:
    node = ros.python("""
import rospy
from std_msgs.msg import Float64

rospy.init_node("mover")
publisher = rospy.Publisher("/slider/joint1_position_controller/command", Float64, queue_size=1)
while publisher.get_num_connections() == 0:
    rospy.rostime.wallsleep(0.01)
publisher.publish(0.3)
print("published", flush=True)
rospy.spin()
""")
    node.prints("published")
    states = client.subscribe("/slider/joint_states", queue_length=1)
    eventually(lambda: abs(states.get()["position"][0] - 0.3) < 0.02, "the slider does not move")
    states.close()


def test_a_reader_that_stops_costs_the_others_nothing(ros: Ros) -> None:
    stopped, other = ros.python(LISTENER), ros.python(LISTENER)
    stopped.prints("count 200 ")
    other.prints("count 200 ")
    stopped.signal(signal.SIGSTOP)
    before, start = memory_kib(ros.gateway), counted(other)[0]
    other.prints(f"count {start + 6000} ")
    assert counted(other)[1] == 0
    assert memory_kib(ros.gateway) - before < 50_000
    stopped.signal(signal.SIGCONT)
    held = counted(stopped)[0]
    eventually(lambda: counted(stopped)[0] > held + 1000, "the reader that was stopped does not go on")


def memory_kib(program: Program) -> int:
    status = Path(f"/proc/{program.process.pid}/status").read_text("ascii")
    return int(status.partition("VmRSS:")[2].split()[0])


# Services


def test_a_service_of_rospy_is_called_by_slidectl(ros: Ros, daemon: Runtime) -> None:
    ros.start("talker.py helper").prints("^ready")
    words = slidectl(daemon, "service", "call", "/helper/answer")
    eventually(lambda: "/helper/answer" in output(daemon, "service", "list"))
    done = subprocess.run(words, env=daemon.env, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert "helper" in done.stdout
    words[-1] = "/helper/fail"
    done = subprocess.run(words, env=daemon.env, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    assert "the motor is on fire" in done.stderr


def output(daemon: Runtime, *words: str) -> str:
    done = subprocess.run(slidectl(daemon, *words), env=daemon.env, capture_output=True, text=True, timeout=60)
    return done.stdout


def test_a_call_ends_with_the_reason_when_the_server_is_killed_in_the_middle(ros: Ros, daemon: Runtime) -> None:
    node = ros.python("""
import rospy
from std_srvs.srv import Trigger

def wait(_):
    print("called", flush=True)
    rospy.rostime.wallsleep(1000)

rospy.init_node("slow")
rospy.Service("~wait", Trigger, wait)
print("ready", flush=True)
rospy.spin()
""")
    node.prints("^ready")
    eventually(lambda: "/slow/wait" in output(daemon, "service", "list"))
    words = slidectl(daemon, "service", "call", "/slow/wait")
    with subprocess.Popen(words, env=daemon.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as call:
        node.prints("called")
        node.signal(signal.SIGKILL)
        _, errors = call.communicate(timeout=60)
    assert call.returncode != 0
    assert "transport error completing service call" in errors


# Actions


def test_an_action_client_of_rospy_moves_the_arm(ros: Ros, client: Client) -> None:
    config = str(ROOT / "config/arm_control.yaml")
    client.spawn("arm", at=(0, 3, 0), controllers=config, start=["joint_state_controller", "arm_controller"])
    try:
        node = ros.python("""
import actionlib, rospy
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from trajectory_msgs.msg import JointTrajectoryPoint

rospy.init_node("planner")
client = actionlib.SimpleActionClient("/arm/arm_controller/follow_joint_trajectory", FollowJointTrajectoryAction)
client.wait_for_server()
goal = FollowJointTrajectoryGoal()
goal.trajectory.joint_names = [f"joint{number}" for number in range(1, 7)]
goal.trajectory.points = [JointTrajectoryPoint(positions=[0.5] + 5 * [0.0], time_from_start=rospy.Duration(1.0))]
feedback = []
client.send_goal(goal, feedback_cb=feedback.append)
client.wait_for_result()
print("state", client.get_state(), "code", client.get_result().error_code, "feedback", len(feedback) > 0, flush=True)
goal.trajectory.points[0].time_from_start = rospy.Duration(100.0)
client.send_goal(goal)
while client.get_state() != actionlib.GoalStatus.ACTIVE:
    rospy.sleep(0.01)
client.cancel_goal()
client.wait_for_result()
print("state", client.get_state(), flush=True)
goal.trajectory.joint_names[0] = "no_such_joint"
client.send_goal_and_wait(goal)
print("state", client.get_state(), "code", client.get_result().error_code, flush=True)
""")
        assert "state 3 code 0 feedback True\nstate 2\nstate 5 code -2\n" in node.prints("state 5.*\n")
        assert node.ends() == 0
    finally:
        client.delete("arm")


def test_an_action_server_of_rospy_is_sent_goals_by_slidectl(ros: Ros, daemon: Runtime) -> None:
    node = ros.python("""
import actionlib, rospy
from control_msgs.msg import GripperCommandAction, GripperCommandFeedback, GripperCommandResult

def execute(goal):
    server.publish_feedback(GripperCommandFeedback(position=goal.command.position / 2))
    if goal.command.position > 1:
        server.set_aborted(GripperCommandResult(stalled=True), "too wide")
    else:
        server.set_succeeded(GripperCommandResult(position=goal.command.position, reached_goal=True), "held")

rospy.init_node("hand")
server = actionlib.SimpleActionServer("/hand/command", GripperCommandAction, execute, auto_start=False)
server.start()
print("ready", flush=True)
rospy.spin()
""")
    node.prints("^ready")
    eventually(lambda: "/hand/command" in output(daemon, "action", "list"), "the action is not there")
    sent = subprocess.run(
        slidectl(daemon, "action", "send", "/hand/command", "{command: {position: 0.25}}", "--wait"),
        env=daemon.env, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert sent.returncode == 0, sent.stderr
    assert "0.25" in sent.stdout
    sent = subprocess.run(
        slidectl(daemon, "action", "send", "/hand/command", "{command: {position: 2.0}}", "--wait"),
        env=daemon.env, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert sent.returncode != 0
    assert "too wide" in sent.stdout + sent.stderr


# Parameters and time


def test_a_dynamic_reconfigure_client_sets_gains(ros: Ros, client: Client) -> None:
    node = ros.python(f"""
import rospy
from dynamic_reconfigure.client import Client

rospy.init_node("tuner")
updates = []
client = Client("{PID}", timeout=30, config_callback=updates.append)
print("before", client.get_configuration(timeout=30)["p"], flush=True)
print("parameters", sorted(one["name"] for one in client.get_parameter_descriptions(timeout=30)), flush=True)
print("after", client.update_configuration({{"p": 123.0, "antiwindup": True}})["p"], flush=True)
while not any(update["p"] == 123.0 for update in updates):
    rospy.rostime.wallsleep(0.01)
print("heard", flush=True)
""")
    printed = node.prints("heard")
    assert "before 100.0" in printed
    assert "parameters ['antiwindup', 'd', 'i', 'i_clamp_max', 'i_clamp_min', 'p']" in printed
    assert "after 123.0" in printed
    assert client.params[f"{PID}/p"] == 123.0
    assert client.params[f"{PID}/antiwindup"] is True
    client.params[f"{PID}/p"] = 100.0
    client.params[f"{PID}/antiwindup"] = False


def test_a_gain_that_rosparam_sets_takes_effect(ros: Ros, client: Client) -> None:
    states = client.subscribe("/slider/joint1_position_controller/state", queue_length=1)
    try:
        assert ros.run(f"rosparam set {PID}/p 77.5").returncode == 0
        eventually(lambda: states.get()["p"] == 77.5, "the controller has another gain")
        refused = ros.run(f"rosparam set {PID}/p many")
        assert refused.returncode == 1
        assert "p" in refused.stderr
        assert client.params[f"{PID}/p"] == 77.5
        assert ros.run(f"rosparam delete {PID}/p").returncode == 1
    finally:
        states.close()
        client.params[f"{PID}/p"] = 100.0


def test_a_node_hears_of_parameters_that_slidectl_sets(ros: Ros, client: Client) -> None:
    client.params["/watched"] = 1
    node = ros.python("""
import rospy
rospy.init_node("watcher")
last = None
while not rospy.is_shutdown():
    value = rospy.get_param_cached("/watched")
    if value != last:
        print("value", value, flush=True)
        last = value
    rospy.rostime.wallsleep(0.01)
""")
    node.prints("value 1")
    client.params["/watched"] = {"deep": [1, "two"]}
    node.prints(re.escape("value {'deep': [1, 'two']}"))


def test_time_is_the_simulations_and_pausing_stops_it(ros: Ros, client: Client) -> None:
    node = ros.python("""
import sys, rospy
rospy.init_node("timer")
while rospy.Time.now().is_zero():
    rospy.rostime.wallsleep(0.01)
print("ready", flush=True)
for _ in sys.stdin:
    print("now", rospy.Time.now().to_nsec(), flush=True)
""")
    node.prints("^ready")

    def now() -> int:
        lines = node.output.count("now ")
        node.type("\n")
        node.prints(f"(now .*\\s+){{{lines + 1}}}")
        return int(re.findall(r"now (\d+)", node.output)[-1])

    first = now()
    eventually(lambda: now() > first, "the time stands still")
    client.call("/gazebo/pause_physics")
    try:
        paused = round(client.call("/gazebo/get_world_properties")["sim_time"] * 1e9)
        eventually(lambda: now() == paused, "the time is not that of the paused world")
        client.step(250)
        eventually(lambda: now() == paused + 250_000_000, "the time did not go on by the steps")
        assert now() == paused + 250_000_000
    finally:
        client.call("/gazebo/unpause_physics")


# What goes wrong


def test_a_type_that_does_not_fit_is_refused_with_both_named(ros: Ros) -> None:
    node = ros.python("""
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

class Old(JointState):
    _md5sum = "0" * 32

class Foreign(String):
    _type = "lab_msgs/Foreign"
    _md5sum = "1" * 32

rospy.init_node("old")
rospy.Subscriber("/slider/joint_states", Old, print)
rospy.Subscriber("/gazebo/model_states", Foreign, print)
rospy.spin()
""")
    texts = (
        f"sensor_msgs/JointState/{'0' * 32}",
        "3066dcd76a6cfaef579bd0f34173e9fd",
        "[lab_msgs/Foreign] vs. [gazebo_",
    )

    def are_logged() -> bool:
        logged = "".join(file.read_text("utf-8") for file in (ros.folder / "log").rglob("old*.log"))
        return all(text in logged for text in texts)

    eventually(are_logged, "rospy was not told the types")
    assert node.process.poll() is None


def test_a_command_of_another_type_is_refused_and_the_slider_stays(ros: Ros, client: Client) -> None:
    states = client.subscribe("/slider/joint_states", queue_length=1)
    before = states.get()["position"][0]
    with ros.started(f"rostopic pub -r 10 {COMMAND} std_msgs/String up"):
        ros.gateway.prints("std_msgs/String")
    assert states.get()["position"][0] == pytest.approx(before, abs=0.05)
    states.close()


def test_a_type_unknown_here_passes_between_two_nodes(ros: Ros) -> None:
    code = """
import sys, rospy
from std_msgs.msg import String

class Foreign(String):
    _type = "lab_msgs/Foreign"
    _md5sum = "1" * 32

rospy.init_node(sys.argv[1])
if sys.argv[1] == "giver":
    rospy.Publisher("/foreign", Foreign, latch=True, queue_size=1).publish("from one to the other")
else:
    rospy.Subscriber("/foreign", Foreign, lambda message: print("got", message.data, flush=True))
print("ready", flush=True)
rospy.spin()
"""
    taker = ros.python(code, "taker")
    taker.prints("^ready")
    ros.python(code, "giver")
    taker.prints("got from one to the other")
    assert ros.ok("rostopic type /foreign") == "lab_msgs/Foreign\n"


def test_the_second_node_of_a_name_ends_the_first(ros: Ros) -> None:
    first = ros.start("talker.py same")
    first.prints("^ready")
    second = ros.start("talker.py same")
    second.prints("^ready")
    assert "new node registered with same name" in first.prints("shutdown request")
    assert first.ends() == 0
    assert ros.ok("rostopic echo -n 1 /same/said") == 'data: "same"\n---\n'
    assert second.process.poll() is None


def test_nodes_go_on_when_the_daemon_comes_back() -> None:
    need_ros()
    with running_daemon() as daemon, gateway(daemon) as ros:
        with daemon.client(60.0) as client:
            spawn_slider(client)
            listener, talker = ros.python(LISTENER), ros.start("talker.py helper")
            listener.prints("count 200 ")
            talker.prints("^ready")
        daemon.stop()
        eventually(lambda: "/slider/joint_states" not in ros.run("rostopic list -p").stdout)
        assert ros.ok("rostopic echo -n 1 /helper/said") == 'data: "helper"\n---\n'
        daemon.start()
        with daemon.client(60.0) as client:
            spawn_slider(client)
            before = counted(listener)[0]
            eventually(lambda: counted(listener)[0] >= before + 600, "the listener hears nothing any more")
            assert ros.ok("rosparam get /use_sim_time") == "true\n"
            eventually(lambda: "/helper/answer" in client.services())
            assert client.call("/helper/answer")["message"] == "helper"
