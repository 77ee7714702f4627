"""Many commands from one process: calls a second, lines of a shell, and how soon a published command pushes a joint.

Effort is seen as motion: RRBot hangs at rest, so the first cycle with another effort changes the velocity of its
joint, for which a second connection asks in a loop. The figure holds one round trip of that question.
"""

from __future__ import annotations

import json
import resource
import select
import socket
import statistics
import subprocess
import sys
import time

from benchmarks.harness import SLIDECTL, Daemon, Row, daemon, percentile, process_cpu_s, timed
from slidectl import Client

CALLS = 10_000
IN_FLIGHT = 100
EFFECTS = 300
ROUNDS = 5
LINES = 3000
PUSH = 0.01
MOVED = 1e-7
_SERVICE = "/rosapi/get_time"
_ECHO = """
import json, select, socket, sys
far = socket.socket(fileno=int(sys.argv[1]))
while select.select((far,), (), ())[0] and (line := far.recv(4096)):
    values = {"time": {"secs": 1, "nsecs": 0}}
    far.send(json.dumps({"op": "service_response", "id": json.loads(line)["id"], "values": values}).encode())
"""


def measure() -> list[Row]:
    """At real time, then free-running, with RRBot and one effort controller."""
    rows = [_floor()]
    with daemon("--rtf", "1.0") as instance:
        instance.spawn("rrbot", ())
        instance.run("param", "set", "/rrbot/push/type", "effort_controllers/JointEffortController")
        instance.run("param", "set", "/rrbot/push/joint", "joint1")
        instance.run("controller", "spawn", "push")
        with instance.client() as client:
            rows += _calls(client) + _lines(instance)
            for speed, title, goals in ((1.0, "real time", (0.6, 1.5)), (0.0, "free-running", (0.2, None))):
                client.call("/slidectl/set_speed", {"speed": speed})
                rows += _effects(client, title, *goals)
            rows.append(_lockstep(client))
    return rows


def _lockstep(client: Client) -> Row:
    """Cycles of a free-running world that waits for one client after each of them."""

    def steps() -> None:
        for _ in range(CALLS):
            lock.step()

    with client.lockstep() as lock:
        fastest = min(timed(steps) for _ in range(ROUNDS))
    return Row("lock-stepped cycles a second, one client", CALLS / fastest, "1/s", 8000.0, "higher")


def _floor() -> Row:
    """What two Python processes reach that read, write and wait for each other's lines, and do nothing else."""
    near, far = socket.socketpair()
    with near, subprocess.Popen([sys.executable, "-c", _ECHO, str(far.fileno())], pass_fds=[far.fileno()]):
        far.close()
        trips = max(CALLS / timed(lambda: _pass_to_and_fro(near)) for _ in range(ROUNDS))
        near.shutdown(socket.SHUT_RDWR)
    return Row("lines of JSON passed to and fro by two bare processes", trips, "/s", note="the floor")


def _pass_to_and_fro(near: socket.socket) -> None:
    for number in range(CALLS):
        near.send(json.dumps({"op": "call_service", "id": f"call:{number}", "service": _SERVICE, "args": {}}).encode())
        select.select((near,), (), ())
        json.loads(near.recv(4096))


def _calls(client: Client) -> list[Row]:
    """Best of several rounds: whatever else runs on the machine only takes away."""
    one_by_one = max(CALLS / timed(lambda: _call_each(client)) for _ in range(ROUNDS))
    in_flight = max(CALLS / timed(lambda: _call_many(client)) for _ in range(ROUNDS))
    return [
        Row("calls of one client, one after the other", one_by_one, "/s", 15_000, "higher", f"best of {ROUNDS} rounds"),
        Row(f"calls of one client, {IN_FLIGHT} under way", in_flight, "/s", 15_000, "higher", "call_async and answer"),
    ]


def _call_each(client: Client) -> None:
    for _ in range(CALLS):
        client.call(_SERVICE)


def _call_many(client: Client) -> None:
    for _ in range(CALLS // IN_FLIGHT):
        for call in [client.call_async(_SERVICE) for _ in range(IN_FLIGHT)]:
            client.answer(call)


def _lines(instance: Daemon) -> list[Row]:
    """Lines of a script and documents of a pipe a second, without the start of the process that reads them."""
    pub, everything = (
        ["pub", "push/command", "--stdin"],
        {
            "pub, a line": (["shell"], "pub push/command 0.0\n"),
            "service call, a line": (["shell"], "service call /rosapi/get_time\n"),
            "param get, a line": (["shell"], "param get push/type\n"),
            "param set, a line": (["shell"], "param set /speed 1.0\n"),
        },
    )
    rows = [_rate(instance, f"slidectl shell: {name}", words, line, None) for name, (words, line) in everything.items()]
    rows.append(_rate(instance, "slidectl pub --stdin, a document", pub, '{"data": 0.0}\n', 15_000))
    instance.run("sim", "pause")
    rows.append(_rate(instance, "slidectl shell: sim step 1, a line", ["shell"], "sim step 1\n", None))
    instance.run("sim", "resume")
    return rows


def _rate(instance: Daemon, name: str, words: list[str], line: str, goal: float | None) -> Row:
    """Best of several rounds, with the processor time of both sides."""

    def run(count: int) -> tuple[float, float, float]:
        own, daemon = resource.getrusage(resource.RUSAGE_CHILDREN), process_cpu_s(pid)
        took = timed(
            lambda: subprocess.run(
                [SLIDECTL, *words],
                input=line * count,
                text=True,
                env=instance.environment,
                check=True,
                stdout=subprocess.DEVNULL,
            )
        )
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        return took, now.ru_utime + now.ru_stime - own.ru_utime - own.ru_stime, process_cpu_s(pid) - daemon

    pid = instance.status()["pid"]
    rounds = [[(many - one) / (LINES - 1) for many, one in zip(run(LINES), run(1), strict=True)] for _ in range(ROUNDS)]
    wall, client, daemon = min(rounds)
    note = f"{1e6 * client:.0f} µs of processor here, {1e6 * daemon:.0f} µs in the daemon"
    return Row(name, 1 / wall, "/s", goal, "higher", note)


def _effects(client: Client, title: str, p50_goal: float | None, p99_goal: float | None) -> list[Row]:
    taken = [effect(client, number) for number in range(EFFECTS)]
    trips = [timed(lambda: velocity(client)) for _ in range(EFFECTS)]
    note = f"one question takes {1e3 * statistics.median(trips):.2f} ms"
    return [
        Row(f"publish to effort, {title}: p50", 1e3 * statistics.median(taken), "ms", p50_goal, note=note),
        Row(f"publish to effort, {title}: p99", 1e3 * percentile(taken, 0.99), "ms", p99_goal),
    ]


def effect(client: Client, number: int) -> float:
    """Seconds from a publish of this client until the joint of RRBot moves."""
    time.sleep(0.01 + 0.003 * (number * 0.618 % 1))  # at any moment of a cycle
    before = velocity(client)
    began = time.perf_counter()
    client.publish("/rrbot/push/command", {"data": PUSH if number % 2 else -PUSH})
    while abs(velocity(client) - before) < MOVED:
        if time.perf_counter() - began > 5:
            raise RuntimeError("the joint does not move")
    return time.perf_counter() - began


def velocity(client: Client) -> float:
    """Of joint1, rad/s."""
    answer = client.call("/gazebo/get_joint_properties", {"joint_name": "rrbot::joint1"})
    return float(answer["rate"][0])
