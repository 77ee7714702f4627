"""How long a whole command takes, from fork to reaped, beside the floor that Python and click set."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable

from benchmarks.harness import ENVIRONMENT, SLIDECTL, SLIDER_CONTROLLERS, Daemon, Row, daemon, timed

RUNS = 21
GOAL_S = 0.050
COMMAND = ("/slider/joint1_position_controller/command", "std_msgs/Float64", "data: 1.0")
FOREIGN_GOAL_S = 0.060
GOAL_RATIO = 1.35


def measure() -> list[Row]:
    """Everyday commands against a running slider, then start-up and spawn."""
    rows = []
    with daemon() as instance:
        instance.spawn("slider", SLIDER_CONTROLLERS)
        rows += [*_commands(instance)]
    return rows + _start_up() + _launch() + _spawns()


def _commands(instance: Daemon) -> list[Row]:
    actions: dict[str, Callable[[], object]] = {
        "python -c 'import click'": _python("import click"),
        "slidectl pub command 1.0": _slidectl(instance, "pub", "command", "1.0"),
        "slidectl controller list": _slidectl(instance, "controller", "list"),
        "slidectl echo joint_states -n 1": _slidectl(instance, "echo", "joint_states", "-n", "1"),
        "slidectl service call list_controllers": _slidectl(instance, "service", "call", "list_controllers"),
        "slidectl param get pid/p": _slidectl(instance, "param", "get", "joint1_position_controller/pid/p"),
        "slidectl ros rostopic pub -1": _slidectl(instance, "ros", "rostopic", "pub", "-1", *COMMAND),
        "slidectl --help": _slidectl(instance, "--help"),
    }
    medians = interleaved(actions, RUNS)
    floor = medians["python -c 'import click'"]
    rows = []
    for name, seconds in medians.items():
        foreign = "rostopic" in name
        everyday = name.startswith("slidectl") and "help" not in name and not foreign
        note = "waits for a message, one every 20 ms" if "echo" in name else "the floor" if seconds == floor else ""
        goal = 1000 * GOAL_S if everyday else 1000 * FOREIGN_GOAL_S if foreign else None
        rows.append(Row(name, 1000 * seconds, "ms", goal, note=note))
        if everyday:
            rows.append(Row(f"{name}: ratio to python -c 'import click'", seconds / floor, "x", GOAL_RATIO))
    return rows


def interleaved(actions: dict[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Median seconds of each action, taken in turns so that a noisy moment hits all alike."""
    taken: dict[str, list[float]] = {name: [] for name in actions}
    for run in range(runs + 1):
        for name, action in actions.items():
            seconds = timed(action)
            if run:
                taken[name].append(seconds)
    return {name: statistics.median(seconds) for name, seconds in taken.items()}


def _python(code: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, check=True)


def _slidectl(instance: Daemon, *words: str) -> Callable[[], object]:
    def run() -> None:
        subprocess.run([SLIDECTL, *words], env=instance.environment, check=True, stdout=subprocess.DEVNULL)

    return run


def _start_up(runs: int = 5) -> list[Row]:
    taken = []
    for run in range(runs + 1):
        instance = Daemon()
        seconds = timed(lambda instance=instance: instance.run("daemon", "start"))
        instance.run("daemon", "stop")
        shutil.rmtree(instance.folder, ignore_errors=True)
        if run:
            taken.append(seconds)
    return [Row("slidectl daemon start", 1000 * statistics.median(taken), "ms", 450)]


def _launch(runs: int = 5) -> list[Row]:
    """The tutorial's launch file until its controllers run: from nothing, and with a daemon that has an empty world."""
    name = "slidectl launch my_slider slider.launch"
    nothing, daemon_up = (1000 * statistics.median(_launches(up) for _ in range(runs)) for up in (False, True))
    return [Row(f"{name}, from nothing", nothing, "ms", 600), Row(f"{name}, with a daemon up", daemon_up, "ms", 500)]


def _launches(daemon_is_up: bool) -> float:
    instance = Daemon()
    if daemon_is_up:
        instance.run("daemon", "start")
    seconds = timed(lambda: instance.run("launch", "my_slider", "slider.launch", "--detach"))
    instance.run("daemon", "stop")
    shutil.rmtree(instance.folder, ignore_errors=True)
    return seconds


def _spawns(runs: int = 5) -> list[Row]:
    with daemon() as instance:
        first = timed(lambda: instance.run("spawn", "slider", "-n", "first"))
        later = [
            timed(lambda k=k: instance.run("spawn", "slider", "-n", f"s{k}", "--at", str(k + 1), "0", "0"))
            for k in range(runs)
        ]
    return [
        Row("slidectl spawn slider, the first", 1000 * first, "ms"),
        Row("slidectl spawn slider, later ones", 1000 * statistics.median(later), "ms", 300),
    ]
