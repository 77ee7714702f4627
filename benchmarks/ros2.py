"""The gateway to ROS 2 with rclpy nodes, beside rclpy nodes among themselves in the same run.

    python -m benchmarks ros2

From publish to effort, from call to answer, joint_states and /clock at 1 kHz, and the start of the gateway. It needs
Python 3.12 and rclpy's wheels, as the tests of the gateway do, and makes their environment.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.harness import RRBOT_CONTROLLERS, Daemon, Row, daemon, percentile, process_cpu_s, timed
from benchmarks.latency import PUSH
from benchmarks.ros1 import Node, effect_of, nodes

sys.path[:0] = [str(Path(__file__).parent.parent / "tests" / "gateways" / "ros2")]
from ros2_environment import folder_of, free_domain  # noqa: E402

EFFECTS = 300
CALLS = 300
STARTS = 5
SECONDS = 5.0
SUBSCRIBERS = (1, 10)
COMMAND, STATES, SERVICE = "/rrbot/push/command", "/rrbot/joint_states", "/gazebo/unpause_physics"

_BEGIN = """
import sys, time, rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_srvs.srv import Empty
rclpy.init()
"""
# A node each. They print a line when they are ready, and obey the lines of their standard input.
PUBLISHER = f"""{_BEGIN}
node = Node("bench_publisher")
publisher = node.create_publisher(Float64, "{COMMAND}", 10)
while not publisher.get_subscription_count():
    time.sleep(0.01)
time.sleep(1.0)
print("ready", flush=True)
for line in sys.stdin:
    began = time.monotonic()
    publisher.publish(Float64(data=float(line)))
    print(began, flush=True)
"""
ECHO = f"""{_BEGIN}
node = Node("bench_echo")
node.create_subscription(Float64, "{COMMAND}", lambda _: print(time.monotonic(), flush=True), 10)
print("ready", flush=True)
rclpy.spin(node)
"""
CLIENT = f"""{_BEGIN}
node = Node("bench_client")
client = node.create_client(Empty, "{SERVICE}")
client.wait_for_service()
print("ready", flush=True)
for _ in range({CALLS}):
    began = time.monotonic()
    rclpy.spin_until_future_complete(node, client.call_async(Empty.Request()))
    print(time.monotonic() - began, flush=True)
"""
SERVER = f"""{_BEGIN}
node = Node("bench_server")
node.create_service(Empty, "{SERVICE}", lambda request, response: response)
print("ready", flush=True)
rclpy.spin(node)
"""


def _counter(kind: str, topic: str, time_of: str) -> str:
    """A node that counts the messages of a topic that has one each simulated millisecond."""
    return f"""{_BEGIN}
import threading
node = Node(f"bench_counter_{{time.monotonic_ns()}}")
taken = []
node.create_subscription({kind}, "{topic}", lambda message: taken.append({time_of}), 1000)
spinning = threading.Thread(target=rclpy.spin, args=(node,))
spinning.start()
while len(taken) < 10:
    time.sleep(0.01)
print("ready", flush=True)
sys.stdin.readline()
times = [round((one.sec + one.nanosec * 1e-9) * 1000) for one in list(taken)]
print(times[-1] - times[0] + 1 - len(times), len(times), flush=True)
rclpy.shutdown()  # one that is killed counts as a subscriber for 20 s more
spinning.join()
"""


def measure() -> list[Row]:
    """Rows of this module."""
    programs = folder_of("kilted")
    python = str(programs / "python")
    with free_domain() as domain, daemon("--rtf", "1.0") as instance:
        alone = {**instance.environment, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        ours = {**alone, "ROS_DOMAIN_ID": str(domain)}
        instance.spawn("rrbot", ())
        instance.run("param", "set", "/rrbot/joint_state_controller/publish_rate", "1000")
        instance.run("param", "set", "/rrbot/push/type", "effort_controllers/JointEffortController")
        instance.run("param", "set", "/rrbot/push/joint", "joint1")
        instance.run("controller", "spawn", "push", RRBOT_CONTROLLERS[0])
        gateway = Gateway(programs, ours)
        rows = [gateway.start_times()]
        gateway.run("start")
        with free_domain() as other:
            theirs = {**alone, "ROS_DOMAIN_ID": str(other)}
            rows += _effects(instance, ours, theirs, python) + _calls(ours, theirs, python)
        for number in SUBSCRIBERS:
            counter = _counter("JointState", STATES, "message.header.stamp")
            rows += _stream(instance, gateway, ours, python, "joint_states", counter, number)
        rows += _stream(instance, gateway, ours, python, "/clock", _counter("Clock", "/clock", "message.clock"), 1)
        gateway.run("stop")
    return rows


class Gateway:
    """The gateway, of the environment that has rclpy."""

    def __init__(self, programs: Path, environment: dict[str, str]) -> None:
        self._slidectl = str(programs / "slidectl")
        self._environment = environment

    def run(self, *words: str) -> str:
        command = [self._slidectl, "gateway", "ros2", *words]
        return subprocess.run(command, env=self._environment, check=True, capture_output=True, text=True).stdout

    @property
    def pid(self) -> int:
        return int(json.loads(self.run("status", "--json"))["pid"])

    def start_times(self) -> Row:
        taken = []
        for _ in range(STARTS):
            taken.append(timed(lambda: self.run("start")))
            self.run("stop")
        return Row("slidectl gateway ros2 start", statistics.median(taken), "s", 1.5)


def _effects(instance: Daemon, ours: dict[str, str], theirs: dict[str, str], python: str) -> list[Row]:
    """Effort is seen as motion, as in the group `latency`; on the other side a node hears the message."""
    with instance.client() as client, nodes(ours, PUBLISHER, python=python) as (publisher,):
        pushed = [effect_of(client, publisher, number) for number in range(EFFECTS)]
    heard = []
    with nodes(theirs, ECHO, PUBLISHER, python=python) as (echo, publisher):
        for _ in range(EFFECTS):
            time.sleep(0.01)
            publisher.tell(str(PUSH))
            began = float(publisher.line())
            heard.append(float(echo.line()) - began)
    ours_ms, theirs_ms = (1e3 * statistics.median(times) for times in (pushed, heard))
    return [
        Row("rclpy publish to effort, real time: p50", ours_ms, "ms"),
        Row("rclpy publish to effort, real time: p99", 1e3 * percentile(pushed, 0.99), "ms"),
        Row("rclpy publish to an rclpy subscriber: p50", theirs_ms, "ms"),
        Row("rclpy publish to an rclpy subscriber: p99", 1e3 * percentile(heard, 0.99), "ms"),
        Row("rclpy publish to effort beside one hop of rclpy", ours_ms / theirs_ms, "", 1.5),
    ]


def _calls(ours: dict[str, str], theirs: dict[str, str], python: str) -> list[Row]:
    own = 1e3 * statistics.median(_call_times(ours, python))
    with nodes(theirs, SERVER, python=python):
        other = 1e3 * statistics.median(_call_times(theirs, python))
    return [Row("service call of an rclpy client: p50", own, "ms", note=f"an rclpy server: {other:.2f} ms")]


def _call_times(environment: dict[str, str], python: str) -> list[float]:
    with nodes(environment, CLIENT, python=python) as (client,):
        return [float(client.line()) for _ in range(CALLS)]


def _stream(
    instance: Daemon, gateway: Gateway, ours: dict[str, str], python: str, name: str, counter: str, number: int
) -> list[Row]:
    pids = {"the gateway": gateway.pid, "the daemon": instance.status()["pid"]}
    with nodes(ours, *[counter] * number, python=python) as counters:
        before, began = {who: process_cpu_s(pid) for who, pid in pids.items()}, time.monotonic()
        time.sleep(SECONDS)
        wall = time.monotonic() - began
        used = {who: 100 * (process_cpu_s(pid) - before[who]) / wall for who, pid in pids.items()}
        status = instance.status()
        counts = [_count(one) for one in counters]
    title = f"{name} at 1 kHz to {number} rclpy node{'s' if number > 1 else ''}"
    goals = {"the gateway": 40.0 if number == max(SUBSCRIBERS) else None, "the daemon": None}
    return [
        Row(f"{title}: lost", sum(lost for lost, _ in counts), "", 0, note=f"of {sum(map(sum, counts))}"),
        *(Row(f"{title}: processor use of {who}", share, "%", goals[who]) for who, share in used.items()),
        Row(f"{title}: real-time factor", round(status["speed_reached"], 3), "", 0.99, better="higher"),
    ]


def _count(counter: Node) -> tuple[int, int]:
    """How many messages a node has lost, and how many it has."""
    counter.tell("stop")
    lost, taken = map(int, counter.line().split())
    counter.ended()
    return lost, taken
