"""At real-time factor 1: processor use, cycle lateness, round trips of a service call, and memory."""

from __future__ import annotations

import statistics
import time

from benchmarks.harness import RRBOT_CONTROLLERS, SLIDER_CONTROLLERS, Row, daemon, percentile, process_cpu_s

SECONDS = 10.0
CALLS = 2000


def measure() -> list[Row]:
    """The slider alone, then RRBot alone."""
    return _measure("slider", SLIDER_CONTROLLERS, goals=True) + _measure("rrbot", RRBOT_CONTROLLERS, goals=False)


def _measure(model: str, controllers: tuple[str, ...], *, goals: bool) -> list[Row]:
    with daemon("--rtf", "1.0") as instance:
        instance.spawn(model, controllers)
        pid = int(instance.status()["pid"])
        cpu, wall = process_cpu_s(pid), time.perf_counter()
        time.sleep(SECONDS)
        share = (process_cpu_s(pid) - cpu) / (time.perf_counter() - wall)
        status = instance.status()
        trips = _round_trips(instance)
    p50, p99 = statistics.median(trips), percentile(trips, 0.99)
    return [
        Row(f"{model} at real time: processor use of one core", 100 * share, "%", 15 if goals else None),
        Row(f"{model} at real time: cycle lateness p50", 1e3 * status["lateness_p50"], "ms"),
        Row(f"{model} at real time: cycle lateness p99", 1e3 * status["lateness_p99"], "ms", 2 if goals else None),
        Row(f"{model} at real time: reached factor", status["speed_reached"], ""),
        Row(f"{model} at real time: service call p50", 1e3 * p50, "ms", note=f"{CALLS} calls on one connection"),
        Row(f"{model} at real time: service call p99", 1e3 * p99, "ms"),
        Row(f"memory of the daemon with {model}", status["memory"] / 2**20, "MiB", 200 if goals else None),
    ]


def _round_trips(instance: object) -> list[float]:
    trips = []
    with instance.client() as client:  # type: ignore[attr-defined]
        for _ in range(CALLS):
            began = time.perf_counter()
            client.call("/rosapi/get_time")
            trips.append(time.perf_counter() - began)
    return trips
