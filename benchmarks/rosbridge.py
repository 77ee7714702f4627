"""The WebSocket gateway with roslibpy subscribers: joint_states at 1 kHz to one and to ten.

    python -m benchmarks rosbridge

Each subscriber is a process of its own.
"""

from __future__ import annotations

import json
import sys
import time

from benchmarks.harness import Daemon, Row, daemon, process_cpu_s
from benchmarks.ros1 import Node

SECONDS = 5.0
SUBSCRIBERS = (1, 10)
COUNTER = """
import sys, threading, time, roslibpy
from urllib.parse import urlsplit
url = urlsplit(URL)
ros = roslibpy.Ros(url.hostname, url.port)
ros.run(30)
taken = []
enough = threading.Event()
def take(message):
    taken.append(message["header"]["seq"])
    if len(taken) == 10:
        enough.set()
roslibpy.Topic(ros, "/rrbot/joint_states", "sensor_msgs/JointState", queue_length=10000).subscribe(take)
enough.wait(30)
print("ready", flush=True)
last = int(sys.stdin.readline())
while taken[-1] < last:
    time.sleep(0.01)
numbers = list(taken)
print(numbers[-1] - numbers[0] + 1 - len(numbers), len(numbers), flush=True)
"""


def measure() -> list[Row]:
    with daemon("--rtf", "1.0") as instance:
        instance.spawn("rrbot", ())
        instance.run("param", "set", "/rrbot/joint_state_controller/publish_rate", "1000")
        instance.run("controller", "spawn", "joint_state_controller")
        instance.run("gateway", "websocket", "start", "--port", "0")
        rows = [row for number in SUBSCRIBERS for row in _stream(instance, number)]
        instance.run("gateway", "websocket", "stop")
    return rows


def _stream(instance: Daemon, number: int) -> list[Row]:
    gateway = json.loads(instance.run("gateway", "websocket", "status", "--json"))
    pids = {"the gateway": gateway["pid"], "the daemon": instance.status()["pid"]}
    text = COUNTER.replace("URL", repr(gateway["address"]))
    counters = [Node(text, instance.environment, sys.executable) for _ in range(number)]
    try:
        for counter in counters:
            counter.ready()
        before, began = {who: process_cpu_s(pid) for who, pid in pids.items()}, time.monotonic()
        time.sleep(SECONDS)
        wall = time.monotonic() - began
        used = {who: 100 * (process_cpu_s(pid) - before[who]) / wall for who, pid in pids.items()}
        status = instance.status()
        with instance.client() as client, client.subscribe("/rrbot/joint_states", queue_length=1) as states:
            last = states.get()["header"]["seq"]
        for counter in counters:
            counter.tell(str(last))  # what comes late is not lost
        counts = [tuple(map(int, counter.line().split())) for counter in counters]
    finally:
        for counter in counters:
            counter.close()
    title = f"joint_states at 1 kHz to {number} roslibpy subscribers"
    return [
        Row(f"{title}: lost", sum(lost for lost, _ in counts), "", 0, note=f"of {sum(map(sum, counts))}"),
        *(Row(f"{title}: processor use of {who}", share, "%") for who, share in used.items()),
        Row(f"{title}: real-time factor", round(status["speed_reached"], 3), "", 0.99, better="higher"),
    ]
