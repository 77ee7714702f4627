"""At real-time factor 1: processor use, cycle lateness, round trips of a service call, and memory."""

from __future__ import annotations

import ctypes
import select
import statistics
import time

from benchmarks.harness import RRBOT_CONTROLLERS, SLIDER_CONTROLLERS, Row, daemon, percentile, process_cpu_s

SECONDS = 10.0
CALLS = 2000
_PR_SET_TIMERSLACK = 29


def measure() -> list[Row]:
    """The slider alone, then RRBot alone."""
    return _measure("slider", SLIDER_CONTROLLERS, goals=False) + _measure("rrbot", RRBOT_CONTROLLERS, goals=True)


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
        Row(f"memory of the daemon with {model}", status["memory"] / 2**20, "MiB", 120 if goals else None),
    ]


def bare_lateness(seconds: float) -> list[float]:
    """How late this process wakes from waits of a millisecond, s: what the machine itself adds at that time."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    late = []
    due = time.perf_counter()
    end = due + seconds
    while due < end:
        due += 0.001
        select.select((), (), (), max(0.0, due - time.perf_counter()))
        late.append(time.perf_counter() - due)
    return late


def _round_trips(instance: object) -> list[float]:
    trips = []
    with instance.client() as client:  # type: ignore[attr-defined]
        for _ in range(CALLS):
            began = time.perf_counter()
            client.call("/rosapi/get_time")
            trips.append(time.perf_counter() - began)
    return trips
