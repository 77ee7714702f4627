"""The gateway to ROS 1 with rospy nodes, beside the same nodes on a real roscore in the same run.

    python -m benchmarks ros1

From publish to effort, from call to answer, joint_states at 1 kHz to many, and the start of the gateway. It needs
ROS 1 and says so where it is not installed.
"""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import IO

from benchmarks.compare import roscore
from benchmarks.harness import RRBOT_CONTROLLERS, Daemon, Row, daemon, percentile, process_cpu_s, timed
from benchmarks.latency import MOVED, PUSH, effect, velocity
from slidectl import Client

PYTHON = "/usr/bin/python3"
EFFECTS = 300
CALLS = 500
COMMANDS = 5
STARTS = 5
SECONDS = 5.0
SUBSCRIBERS = (1, 10)
COMMAND, STATES, SERVICE = "/rrbot/push/command", "/rrbot/joint_states", "/gazebo/unpause_physics"
_LIMIT_S = 30.0

# A node each. They print a line when they are ready, and obey the lines of their standard input.
PUBLISHER = f"""
import sys, time, rospy
from std_msgs.msg import Float64
rospy.init_node("bench_publisher", disable_rostime=True)
publisher = rospy.Publisher("{COMMAND}", Float64, queue_size=1, tcp_nodelay=True)
while not publisher.get_num_connections():
    time.sleep(0.01)
print("ready", flush=True)
for line in sys.stdin:
    began = time.monotonic()
    publisher.publish(float(line))
    print(began, flush=True)
"""
ECHO = f"""
import time, rospy
from std_msgs.msg import Float64
rospy.init_node("bench_echo", disable_rostime=True)
rospy.Subscriber("{COMMAND}", Float64, lambda _: print(time.monotonic(), flush=True), tcp_nodelay=True)
print("ready", flush=True)
rospy.spin()
"""
CLIENT = f"""
import time, rospy
from std_srvs.srv import Empty
rospy.init_node("bench_client", disable_rostime=True)
rospy.wait_for_service("{SERVICE}")
print("ready", flush=True)
for persistent in (False, True):
    call = rospy.ServiceProxy("{SERVICE}", Empty, persistent=persistent)
    for _ in range({CALLS}):
        began = time.monotonic()
        call()
        print(time.monotonic() - began, flush=True)
"""
SERVER = f"""
import rospy
from std_srvs.srv import Empty, EmptyResponse
rospy.init_node("bench_server", disable_rostime=True)
rospy.Service("{SERVICE}", Empty, lambda _: EmptyResponse())
print("ready", flush=True)
rospy.spin()
"""
COUNTER = f"""
import sys, rospy
from sensor_msgs.msg import JointState
rospy.init_node("bench_counter", anonymous=True, disable_rostime=True)
taken = []
rospy.Subscriber("{STATES}", JointState, lambda message: taken.append(message.header.seq))
while len(taken) < 10:
    rospy.rostime.wallsleep(0.01)
print("ready", flush=True)
sys.stdin.readline()
numbers = list(taken)
print(numbers[-1] - numbers[0] + 1 - len(numbers), len(numbers), flush=True)
rospy.signal_shutdown("done")
"""


class Node:
    """A program of a client, a rospy node by default, that says when it is ready."""

    def __init__(self, text: str, environment: dict[str, str], python: str = PYTHON) -> None:
        self._process = subprocess.Popen(
            [python, "-c", text], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input: IO[str] = self._process.stdin
        self._output: IO[str] = self._process.stdout

    def ready(self) -> Node:
        """Wait until it is."""
        if self.line() != "ready":
            raise RuntimeError("a client does not start")
        return self

    def tell(self, line: str) -> None:
        self._input.write(line + "\n")
        self._input.flush()

    def line(self) -> str:
        return self._output.readline().strip()

    def ended(self) -> None:
        """Wait until it has ended by itself."""
        self._process.wait(_LIMIT_S)

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def nodes(environment: dict[str, str], *texts: str, python: str = PYTHON) -> Iterator[list[Node]]:
    """These nodes, started one after the other."""
    with ExitStack() as stack:
        started = []
        for text in texts:
            node = Node(text, environment, python)
            stack.callback(node.close)
            started.append(node.ready())
        yield started


def measure() -> list[Row]:
    """None, and the reason on stderr, where ROS 1 is not installed."""
    has_rospy = (
        shutil.which(PYTHON) and not subprocess.run([PYTHON, "-c", "import rospy"], capture_output=True).returncode
    )
    if not has_rospy or shutil.which("roscore") is None:
        print("skipped: rospy and roscore are not installed here", file=sys.stderr, flush=True)
        return []
    with roscore() as theirs, daemon("--rtf", "1.0") as instance:
        instance.spawn("rrbot", ())
        instance.run("param", "set", "/rrbot/joint_state_controller/publish_rate", "1000")
        instance.run("param", "set", "/rrbot/push/type", "effort_controllers/JointEffortController")
        instance.run("param", "set", "/rrbot/push/joint", "joint1")
        instance.run("controller", "spawn", "push", RRBOT_CONTROLLERS[0])
        rows = [_start(instance)]
        uri = next(word for word in _start_gateway(instance).split() if word.startswith("http"))
        ours = {**theirs, "ROS_MASTER_URI": uri}
        rows += _effects(instance, ours, theirs) + _calls(ours, theirs)
        for number in SUBSCRIBERS:
            rows += _stream(instance, ours, number)
        instance.run("gateway", "ros1", "stop")
    return rows


def _start_gateway(instance: Daemon) -> str:
    return instance.run("gateway", "ros1", "start", "--port", "0")


def _start(instance: Daemon) -> Row:
    taken = []
    for _ in range(STARTS):
        taken.append(timed(lambda: _start_gateway(instance)))
        instance.run("gateway", "ros1", "stop")
    return Row("slidectl gateway ros1 start", statistics.median(taken), "s", 0.6)


def _effects(instance: Daemon, ours: dict[str, str], theirs: dict[str, str]) -> list[Row]:
    """Effort is seen as motion, as in the group `latency`; on the other side a node hears the message."""
    with instance.client() as client, nodes(ours, PUBLISHER) as (publisher,):
        pushed = [effect_of(client, publisher, number) for number in range(EFFECTS)]
        direct = [effect(client, number) for number in range(EFFECTS)]
    heard = []
    with nodes(theirs, ECHO, PUBLISHER) as (echo, publisher):
        for _ in range(EFFECTS):
            time.sleep(0.01)
            publisher.tell(str(PUSH))
            began = float(publisher.line())
            heard.append(float(echo.line()) - began)
    note = f"a client of the daemon itself: {1e3 * statistics.median(direct):.2f} ms"
    return [
        Row("rospy publish to effort, real time: p50", 1e3 * statistics.median(pushed), "ms", 0.8, note=note),
        Row("rospy publish to effort, real time: p99", 1e3 * percentile(pushed, 0.99), "ms"),
        Row("rospy publish to a rospy subscriber, roscore: p50", 1e3 * statistics.median(heard), "ms"),
        Row("rospy publish to a rospy subscriber, roscore: p99", 1e3 * percentile(heard, 0.99), "ms"),
    ]


def effect_of(client: Client, publisher: Node, number: int) -> float:
    """Seconds from the publish of a node, which prints when it began, to the motion of the joint."""
    time.sleep(0.01 + 0.003 * (number * 0.618 % 1))  # at any moment of a cycle
    before = velocity(client)
    publisher.tell(str(PUSH if number % 2 else -PUSH))
    limit = time.monotonic() + _LIMIT_S
    while abs(velocity(client) - before) < MOVED:
        if time.monotonic() > limit:
            raise RuntimeError("the joint does not move")
    ended = time.monotonic()
    return ended - float(publisher.line())


def _calls(ours: dict[str, str], theirs: dict[str, str]) -> list[Row]:
    """Of a rospy proxy, with a connection for each call and with one for all, and of the tool."""
    here, tool_here = _call_times(ours)
    with nodes(theirs, SERVER):
        there, tool_there = _call_times(theirs)
    rows = []
    for title, begin in (("a connection each", 0), ("persistent", CALLS)):
        own, other = (1e3 * statistics.median(times[begin : begin + CALLS]) for times in (here, there))
        note = f"a rospy server with roscore: {other:.2f} ms"
        rows.append(Row(f"service call of a rospy client, {title}: p50", own, "ms", note=note))
    note = f"a rospy server with roscore: {tool_there:.2f} s"
    return [*rows, Row("rosservice call", tool_here, "s", note=note)]


def _call_times(environment: dict[str, str]) -> tuple[list[float], float]:
    with nodes(environment, CLIENT) as (client,):
        calls = [float(client.line()) for _ in range(2 * CALLS)]
    words = ["rosservice", "call", SERVICE, "{}"]
    silent = subprocess.DEVNULL
    tool = [timed(lambda: subprocess.run(words, env=environment, check=True, stdout=silent)) for _ in range(COMMANDS)]
    return calls, statistics.median(tool)


def _stream(instance: Daemon, ours: dict[str, str], number: int) -> list[Row]:
    gateway = json.loads(instance.run("gateway", "ros1", "status", "--json"))
    pids = {"the gateway": gateway["pid"], "the daemon": instance.status()["pid"]}
    with nodes(ours, *[COUNTER] * number) as counters:
        before, began = {who: process_cpu_s(pid) for who, pid in pids.items()}, time.monotonic()
        time.sleep(SECONDS)
        wall = time.monotonic() - began
        used = {who: 100 * (process_cpu_s(pid) - before[who]) / wall for who, pid in pids.items()}
        status = instance.status()
        for counter in counters:
            counter.tell("stop")
        counts = [tuple(map(int, counter.line().split())) for counter in counters]
    title = f"joint_states at 1 kHz to {number} rospy nodes"
    return [
        Row(f"{title}: lost", sum(lost for lost, _ in counts), "", 0, note=f"of {sum(map(sum, counts))}"),
        *(Row(f"{title}: processor use of {who}", share, "%") for who, share in used.items()),
        Row(f"{title}: real-time factor", round(status["speed_reached"], 3), "", 0.99, better="higher"),
    ]
