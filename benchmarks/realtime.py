"""At real-time factor 1: processor use, cycle lateness, round trips of a service call, and memory."""

from __future__ import annotations

import ctypes
import os
import select
import statistics
import time
from collections.abc import Callable
from functools import partial

import mujoco

from benchmarks.cycles import build
from benchmarks.harness import RRBOT_CONTROLLERS, SLIDER_CONTROLLERS, Row, daemon, percentile, process_cpu_s

SECONDS = 10.0
CALLS = 2000
MEMORY_GOALS_MIB = {"plain": 120.0, "compiled": 260.0}
COMPILE_LIMIT_S = 120.0
_PR_SET_TIMERSLACK = 29


def measure() -> list[Row]:
    """The slider alone, then RRBot alone."""
    rows = _measure("slider", SLIDER_CONTROLLERS, goals=False) + _measure("rrbot", RRBOT_CONTROLLERS, goals=True)
    rows += [
        _floor("a bare loop that waits 1 ms", lambda: None),
        _floor("the same, with a bare mj_step of rrbot", _step()),
    ]
    return rows + [_memory(engine, goal) for engine, goal in MEMORY_GOALS_MIB.items()]


def _measure(model: str, controllers: tuple[str, ...], *, goals: bool) -> list[Row]:
    with daemon("--rtf", "1.0") as instance:
        instance.spawn(model, controllers)
        pid = int(instance.status()["pid"])
        cpu, wall = process_cpu_s(pid), time.perf_counter()
        bare = bare_lateness(SECONDS)
        share = (process_cpu_s(pid) - cpu) / (time.perf_counter() - wall)
        status = instance.status()
        trips = _round_trips(instance)
    beside = f"{1e3 * percentile(bare, 0.99):.2f} ms for a bare wait of 1 ms meanwhile"
    p50, p99 = statistics.median(trips), percentile(trips, 0.99)
    return [
        Row(f"{model} at real time: processor use of one core", 100 * share, "%", 5 if goals else None),
        Row(f"{model} at real time: cycle lateness p50", 1e3 * status["lateness_p50"], "ms", 0.1 if goals else None),
        Row(
            f"{model} at real time: cycle lateness p99",
            1e3 * status["lateness_p99"],
            "ms",
            1 if goals else None,
            note=beside,
        ),
        Row(f"{model} at real time: reached factor", status["speed_reached"], ""),
        Row(f"{model} at real time: service call p50", 1e3 * p50, "ms", note=f"{CALLS} calls on one connection"),
        Row(f"{model} at real time: service call p99", 1e3 * p99, "ms"),
    ]


def _step() -> Callable[[], object]:
    world = build("rrbot", RRBOT_CONTROLLERS, "plain").world
    return partial(mujoco.mj_step, world.model, world.data)


def _floor(name: str, action: Callable[[], object]) -> Row:
    """What a process of Python's takes that does nothing else: a step after a sleep finds its caches cold."""
    cpu, wall = process_cpu_s(os.getpid()), time.perf_counter()
    bare_lateness(SECONDS / 2, action)
    share = (process_cpu_s(os.getpid()) - cpu) / (time.perf_counter() - wall)
    return Row(f"{name}: processor use of one core", 100 * share, "%", note="the floor")


def _memory(engine: str, goal: float) -> Row:
    """Of a daemon with RRBot that runs, once the engine is at work."""
    with daemon("--engine", engine) as instance:
        instance.spawn("rrbot", RRBOT_CONTROLLERS)
        limit = time.monotonic() + COMPILE_LIMIT_S
        while (status := instance.status())["engine"] != engine:
            if time.monotonic() > limit:
                raise TimeoutError(f"the engine is {status['engine']!r}, not {engine!r}")
            time.sleep(0.1)
        time.sleep(1.0)
        return Row(f"memory of the daemon with rrbot, {engine}", instance.status()["memory"] / 2**20, "MiB", goal)


def bare_lateness(seconds: float, action: Callable[[], object] = lambda: None) -> list[float]:
    """How late this process wakes from waits of a millisecond, s: what the machine itself adds at that time."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    late = []
    due = time.perf_counter()
    end = due + seconds
    while due < end:
        due += 0.001
        select.select((), (), (), max(0.0, due - time.perf_counter()))
        late.append(time.perf_counter() - due)
        action()
    return late


def _round_trips(instance: object) -> list[float]:
    trips = []
    with instance.client() as client:  # type: ignore[attr-defined]
        for _ in range(CALLS):
            began = time.perf_counter()
            client.call("/rosapi/get_time")
            trips.append(time.perf_counter() - began)
    return trips
