"""Lock-step: the world waits for its clients, and controllers outside of the daemon give the same bits each time."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
from collections.abc import Iterator

import pytest
from daemon_fixture import Runtime, running_daemon

from slidectl.errors import Refused, TimedOut

CONTROLLER = """
import json, sys
from slidectl import Client

joint, goal, cycles = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
with Client() as client, client.subscribe("/rrbot/joint_states") as states, client.lockstep(timeout=60) as lock:
    print("joined", flush=True)
    seen, state = [], None
    for _ in range(cycles):
        lock.step()
        while len(states):
            state = states.get()
        if state is None:  # the first message is that of the second cycle
            continue
        position, velocity = state["position"][joint], state["velocity"][joint]
        seen.append([lock.time, position, velocity])
        client.publish(f"/rrbot/effort{joint + 1}/command", {"data": 60.0 * (goal - position) - 8.0 * velocity})
    print(json.dumps(seen))
"""
PARAMETERS = {
    "joint_state_controller": {"type": "joint_state_controller/JointStateController", "publish_rate": 1000},
    "effort1": {"type": "effort_controllers/JointEffortController", "joint": "joint1"},
    "effort2": {"type": "effort_controllers/JointEffortController", "joint": "joint2"},
}


@pytest.fixture
def daemon() -> Iterator[Runtime]:
    with running_daemon(rtf=math.inf, paused=True) as runtime:
        yield runtime


def test_two_controllers_outside_of_the_daemon_at_1_khz_give_the_same_bits_each_time() -> None:
    runs = []
    for _ in range(2):
        with running_daemon(rtf=math.inf, paused=True) as daemon, daemon.environment(), daemon.client() as client:
            client.spawn("rrbot")
            for name, settings in PARAMETERS.items():
                client.params[f"/rrbot/{name}"] = settings
            client.controllers("/rrbot").bring_up(list(PARAMETERS))
            outside = [
                subprocess.Popen(
                    [sys.executable, "-c", CONTROLLER, joint, goal, "400"], stdout=subprocess.PIPE, text=True
                )
                for joint, goal in (("0", "1.0"), ("1", "-0.5"))
            ]
            assert [process.stdout.readline() for process in outside if process.stdout] == ["joined\n"] * 2
            client.call("/gazebo/unpause_physics")
            outputs = [process.communicate(timeout=60)[0] for process in outside]
            assert [process.returncode for process in outside] == [0, 0]
            runs.append([json.loads(output) for output in outputs])
    assert runs[0] == runs[1]
    times = [time for time, *_ in runs[0][0]]
    assert [round(1000 * (after - before), 6) for before, after in itertools.pairwise(times)] == [1.0] * 398
    assert runs[0][0][-1][1] > 0.3


def test_the_world_goes_on_period_by_period_and_freely_afterwards(daemon: Runtime) -> None:
    with daemon.client() as client, daemon.client() as other:
        with client.lockstep(period=0.01) as lock:
            client.call("/gazebo/unpause_physics")
            assert lock.time == 0.0
            assert [round(lock.step(), 9) for _ in range(3)] == [0.01, 0.02, 0.03]
            status = other.call("/slidectl/status")
            assert (status["time"], status["paused"], len(status["lockstep"])) == (0.03, False, 1)
            with other.lockstep(period=0.02) as slower:  # from now on the world waits for both
                waiting = other.call_async("/slidectl/lockstep")
                other.flush()
                assert round(lock.step(), 9) == 0.04
                assert not other.is_answered(waiting)
                assert round(lock.step(), 9) == 0.05
                assert round(other.answer(waiting)["time"], 9) == 0.05
                with pytest.raises(TimedOut) as caught:
                    lock.step(timeout=0.1)
                assert "lock-step" in str(caught.value.hint)
                assert slower.time == 0.03
            assert round(lock.step(), 9) == 0.06
            other.call("/gazebo/reset_simulation")
            assert round(lock.step(), 9) == 0.01
        other.wait("/clock/clock/secs", above=1)


def test_what_needs_a_cycle_is_done_while_the_world_waits_for_the_client_that_asks(daemon: Runtime) -> None:
    with daemon.client() as client:
        client.spawn("rrbot")
        client.params["/rrbot/effort1"] = PARAMETERS["effort1"]
        client.call("/gazebo/unpause_physics")
        with client.lockstep() as lock:
            lock.step()
            client.controllers("/rrbot").bring_up(["effort1"])
            assert client.controllers("/rrbot").states() == {"effort1": "running"}
            assert client.call("/slidectl/status")["time"] == lock.time


def test_a_client_that_dies_or_takes_too_long_is_let_go(daemon: Runtime) -> None:
    code = (
        "from slidectl import Client; client = Client(); lock = client.lockstep(timeout=600); lock.__enter__();"
        "print('joined', flush=True); input()"
    )
    with daemon.environment(), daemon.client() as client:
        dying = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert dying.stdout is not None
        assert dying.stdout.readline() == b"joined\n"
        client.call("/gazebo/unpause_physics")
        assert client.call("/slidectl/status")["time"] == 0.0
        dying.kill()
        dying.communicate()
        client.wait("/clock/clock/secs", above=0)
        assert "has disconnected; the lock-step continues without it" in daemon.log

        with daemon.client() as slow, slow.lockstep(timeout=0.2) as lock:
            before = lock.time
            with client.subscribe("/clock") as clock:
                assert clock.get(20.0)["clock"]["secs"] >= int(before)
            assert "it held the world for more than 0.2 s" in daemon.log
            with pytest.raises(Refused, match="held the world for more than"):
                lock.step()
        assert client.call("/slidectl/status")["lockstep"] == []


def test_what_makes_no_sense_is_refused(daemon: Runtime) -> None:
    with daemon.client() as client:
        with pytest.raises(Refused, match="not in lock-step"):
            client.call("/slidectl/lockstep")
        with pytest.raises(Refused, match="not in lock-step"):
            client.call("/slidectl/lockstep", {"leave": True})
        for period in (-1.0, 1e9, math.inf):
            with pytest.raises(Refused, match="period is a time above 0 s"):
                client.call("/slidectl/lockstep", {"period": period})
        with pytest.raises(Refused, match="not a whole number of cycles") as caught, client.lockstep(period=0.0015):
            pass
        assert "possible: 0.001s or 0.002s" in str(caught.value)
        with client.lockstep():
            first, second = client.call_async("/slidectl/lockstep"), client.call_async("/slidectl/lockstep")
            with pytest.raises(Refused, match="waits for the end of its period already"):
                client.answer(second)
            client.call("/gazebo/unpause_physics")
            client.answer(first)
