"""The page: what one that is open costs the daemon, what it costs itself, and how quickly it shows and acts.

The browser only speaks viser's protocol and, as the panels do, rosbridge's: a real one that draws by software would
take the processor's time.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from benchmarks.harness import RRBOT_CONTROLLERS, SLIDECTL, Daemon, Row, daemon, median_of, process_cpu_s

sys.path[:0] = [str(Path(__file__).parent.parent / "tests"), str(Path(__file__).parent.parent / "tests" / "cli")]
from page_browser import PageBrowser  # noqa: E402

SECONDS = 5.0
DRAGS = 50
RUNS = 3


def measure() -> list[Row]:
    """Rows of this module."""
    rows = [*_costs()]
    for count, goal in ((1, None), (10, 30.0), (50, None)):
        rows.append(Row(f"page, {count} RRBots: frames a second", _frames(count), "/s", goal, "higher"))
    return [*rows, _drag(), _plot()]


@contextmanager
def _page(instance: Daemon) -> Iterator[tuple[int, PageBrowser]]:
    """The process id of a page and a browser that has it open."""
    process = subprocess.Popen(
        [SLIDECTL, "view", "--no-open", "--port", "0"], env=instance.environment, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        with PageBrowser(process.stdout.readline().strip()) as browser:
            browser.wait_for(lambda: any(name.endswith("link3") for name in browser.nodes))
            browser.take(1.0)
            yield process.pid, browser
    finally:
        process.terminate()
        process.wait()


def _costs() -> Iterator[Row]:
    with daemon() as instance:
        instance.spawn("rrbot", RRBOT_CONTROLLERS)
        pid = instance.status()["pid"]
        without = _used(partial(time.sleep, SECONDS), pid)
        with _page(instance) as (page, browser):
            scene = _used(lambda: browser.take(SECONDS), pid)
            with_page = _used(partial(_panels, browser), pid, page)
    yield Row("page: the daemon's processor time beside that without, the scene alone", scene[0] / without[0], "")
    yield Row("page: the daemon's processor time beside that without", with_page[0] / without[0], "", 1.3)
    yield Row("page: its own processor time", 100 * with_page[1], "% of a core", 25.0, note="RRBot at real time")


def _panels(browser: PageBrowser) -> None:
    """What the panels of a browser ask for as the page opens: the first plot, the command sliders, and the tables."""
    plot, slider = {"queue_length": 1000}, {"throttle_rate": 200, "queue_length": 1}
    for topic, options in (
        ("/rrbot/joint1_position_controller/state", plot),
        ("/rrbot/joint1_position_controller/state", plot),
        ("/rrbot/joint1_position_controller/command", slider),
        ("/rrbot/joint2_position_controller/command", slider),
    ):
        browser.panels.send(json.dumps({"op": "subscribe", "topic": topic, "stamped": True, **options}))
    second = ("/slidectl/status", "/slidectl/list_robots", "/rrbot/controller_manager/list_controllers")
    for fifth in range(int(SECONDS * 5)):
        for service in ("/slidectl/joint_states", *(second if fifth % 5 == 0 else ())):
            browser.panels.send(json.dumps({"op": "call_service", "id": service, "service": service, "args": {}}))
        browser.take(0.2)
        with suppress(TimeoutError):
            while True:
                browser.panels.recv(timeout=0)


def _used(action: partial[None] | object, *pids: int) -> list[float]:
    """The share of a core that each process takes meanwhile."""
    before, began = [process_cpu_s(pid) for pid in pids], time.monotonic()
    action()  # type: ignore[operator]
    passed = time.monotonic() - began
    return [(process_cpu_s(pid) - was) / passed for pid, was in zip(pids, before, strict=True)]


def _frames(count: int) -> float:
    """How often a second a swinging arm is shown somewhere else."""
    with daemon() as instance:
        for number in range(count):
            instance.run(
                "spawn", "rrbot", "-n", f"r{number}", "--at", "0", str(2 * number), "0", "--joint", "joint1=1.0"
            )
        with _page(instance) as (_, browser):
            places = set()
            end = time.monotonic() + SECONDS
            while (left := end - time.monotonic()) > 0:
                browser.take(min(left, 0.005))
                places.add(tuple(browser.nodes["/robots/r0/link3"]["position"]))
    return len(places) / SECONDS


def _drag() -> Row:
    """From the slider in the browser to the controller that has the set point."""
    with daemon() as instance, instance.client() as client:
        instance.spawn("rrbot", RRBOT_CONTROLLERS)
        with _page(instance) as (_, browser):
            taken = []
            with client.subscribe("/rrbot/joint1_position_controller/state", queue_length=1) as state:
                for number in range(DRAGS):
                    value = 0.01 * (number + 1)
                    began = time.perf_counter()
                    command = {"op": "publish", "topic": "/rrbot/joint1_position_controller/command"}
                    browser.panels.send(json.dumps({**command, "msg": {"data": value}}))
                    while state.get()["set_point"] != value:
                        pass
                    taken.append(time.perf_counter() - began)
    return Row("page: a dragged slider to the controller's state: p50", 1e3 * statistics.median(taken), "ms")


def _plot() -> Row:
    with daemon("--rtf", "max") as instance:
        instance.spawn("slider", ("joint_state_controller",))
        file = str(Path(instance.folder) / "plot.csv")
        instance.run("plot", "joint_states/position[0]", "--for", "30", "--save", file)
        picture = str(Path(instance.folder) / "plot.svg")
        seconds = median_of(partial(instance.run, "plot", file, "--save", picture), RUNS)
    return Row("slidectl plot of 1500 samples into an .svg", seconds, "s", note="whole command")
