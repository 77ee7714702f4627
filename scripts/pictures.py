"""Makes the pictures of README.md and docs/ from the running program: `make pictures`. Needs Chromium."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from playwright.sync_api import sync_playwright

from slidectl import Client, traces

ROOT = Path(__file__).parent.parent
PICTURES = ROOT / "docs" / "pictures"
SLIDECTL = str(Path(sys.executable).with_name("slidectl"))
SETTLE_S = 20
"""Wall seconds in which a browser that draws by software has drawn the page."""


@contextmanager
def world(*options: str) -> Iterator[dict[str, str]]:
    """A daemon of its own; the environment that leads to it."""
    with tempfile.TemporaryDirectory(prefix="slidectl-", dir="/tmp") as folder:
        environment = {**os.environ, "XDG_RUNTIME_DIR": folder}
        try:
            run(environment, "daemon", "start", "-q", *options)
            yield environment
        finally:
            run(environment, "daemon", "stop", "-q")


def socket_of(environment: dict[str, str]) -> str:
    return str(Path(environment["XDG_RUNTIME_DIR"]) / "slidectl" / "default" / "socket")


def run(environment: dict[str, str], *words: str) -> None:
    subprocess.run([SLIDECTL, *words], env=environment, cwd=ROOT, check=True)


def quick_slider(folder: str, heavy: bool = False) -> str:
    """The shipped slider with a limit of 5 m/s, since 0.1 m/s is too slow to look at; `heavy`: without counterweight.

    Returns the path of the model, which is written into the folder.
    """
    model = (ROOT / "models" / "slider.xacro").read_text(encoding="utf-8").replace('velocity="0.1"', 'velocity="5"')
    if heavy:
        model = model.replace('effort="100"', 'effort="1000"').replace("<turnGravityOff>true", "<turnGravityOff>false")
    quick = Path(folder) / "slider.xacro"
    quick.write_text(model, encoding="utf-8")
    return str(quick)


def page(chromium: str) -> None:
    """RRBot in the page, after a motion that the plot shows."""
    with world("--paused") as environment:
        run(environment, "spawn", "rrbot", "--controllers", "config/rrbot_control.yaml", "-q", "--start",
            "joint_state_controller", "joint1_position_controller", "joint2_position_controller")  # fmt: skip
        served = subprocess.Popen(
            [SLIDECTL, "view", "--no-open", "--port", "0"], env=environment, stdout=subprocess.PIPE, text=True
        )
        assert served.stdout is not None
        url = served.stdout.readline().strip()
        try:
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(
                    executable_path=chromium,
                    args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
                )
                tab = browser.new_page(viewport={"width": 1440, "height": 800})
                fields = "joint1_position_controller/state/{set_point,process_value}"
                tab.goto(f"{url}?plot={fields}")
                time.sleep(SETTLE_S)
                for joint, position in (("joint1", 0.8), ("joint2", -0.6)):
                    run(environment, "pub", f"{joint}_position_controller/command", str(position), "-q")
                for _ in range(40):
                    run(environment, "sim", "step", "0.1s", "-q")
                time.sleep(SETTLE_S)
                tab.screenshot(path=PICTURES / "page.png", timeout=120_000)
                browser.close()
        finally:
            served.terminate()
            served.wait()


def slide() -> None:
    """The response of the slider to a step."""
    with world("--rtf", "max") as environment:
        run(environment, "spawn", "slider", "--controllers", "config/slider_control.yaml", "-q", "--start",
            "joint_state_controller", "joint1_position_controller")  # fmt: skip
        file = str(PICTURES / "slide.svg")
        run(environment, "controller", "plot", "joint1_position_controller", "--step", "1.0", "--for", "12",
            "--save", file, "-q")  # fmt: skip


def animation() -> None:
    """The slider and RRBot follow sine waves: a video for the site, a .gif for README.md, and a still picture.

    The waves are trajectories, which the world itself follows: a program that publishes beside it is late on a busy
    machine. A period begins where RRBot is highest, for the view takes in what is there at the first picture.
    """
    waves = {"slider": {"joint1": (0.8, 1)}, "rrbot": {"joint1": (0.7, 1), "joint2": (1.2, 2)}}
    times = np.arange(0, 18.5, 0.1)
    with world("--paused") as environment, tempfile.TemporaryDirectory(prefix="slidectl-") as folder:
        for (robot, joints), model, y in zip(
            waves.items(), (quick_slider(folder), "rrbot"), ("-0.8", "0.8"), strict=True
        ):
            gains = ", ".join(f"{joint}: {{p: 1000, d: 100}}" for joint in joints)
            file = Path(folder) / f"{robot}.yaml"
            file.write_text(
                f"{robot}:\n  waves:\n    type: effort_controllers/JointTrajectoryController\n"
                f"    joints: [{', '.join(joints)}]\n    gains: {{{gains}}}\n",
                encoding="utf-8",
            )
            run(environment, "spawn", model, "-q", "--at", "0", y, "0", "--controllers", str(file), "--start", "waves")
        with Client(socket=socket_of(environment)) as client:
            for robot, joints in waves.items():
                points = [
                    {
                        "positions": [height * np.sin(n * np.pi * t / 3) for height, n in joints.values()],
                        "velocities": [
                            height * n * np.pi / 3 * np.cos(n * np.pi * t / 3) for height, n in joints.values()
                        ],
                        "time_from_start": {"secs": int(t), "nsecs": round(t % 1 * 1e9)},
                    }
                    for t in times[1:].tolist()
                ]
                client.publish(f"/{robot}/waves/command", {"joint_names": list(joints), "points": points})
            client.step(seconds=6)  # the swing of the beginning has gone: a period ends where it begins
        for name, more in (("slide.mp4", ("--size", "960x540")), ("slide.gif", ("--size", "480x270", "--fps", "10"))):
            run(environment, "video", str(PICTURES / name), "--for", "6", *more, "-q")
        run(environment, "render", "-o", str(PICTURES / "slide.png"), "--size", "960x540", "-q")


BLUE, ORANGE, GREY = "#0b6bcb", "#c2410c", "#6b7280"


def axes(height: float = 3.4) -> tuple[Figure, Axes]:
    """An empty figure of the width of a page."""
    figure, drawn = plt.subplots(figsize=(7.2, height), layout="constrained")
    drawn.spines[["top", "right"]].set_visible(False)
    return figure, drawn


def save(figure: Figure, name: str) -> None:
    figure.savefig(PICTURES / name, metadata={"Date": None})
    plt.close(figure)


def measured_step() -> None:
    """A step of the slider that overshoots, with what `slidectl assert` measures on it. For measures.md."""
    with world("--paused") as environment, tempfile.TemporaryDirectory(prefix="slidectl-") as folder:
        loose = Path(folder) / "loose.yaml"
        loose.write_text(
            "slider:\n  joint1_position_controller:\n    type: effort_controllers/JointPositionController\n"
            "    joint: joint1\n    pid: {p: 1000.0, i: 0.0, d: 40.0}\n",
            encoding="utf-8",
        )
        run(environment, "spawn", quick_slider(folder, heavy=True), "-q", "--controllers", str(loose), "--start",
            "joint1_position_controller")  # fmt: skip
        run(environment, "sim", "step", "3s", "-q")
        run(environment, "pub", "command", "0.5", "-q")
        run(environment, "sim", "step", "1.7s", "-q")
        with Client(socket=socket_of(environment)) as client:
            motion = traces.live(client, "joint1", last=1.9)
    times, values = motion.times - motion.times[0], motion.values
    start, end, goal = values[0], values[-1], 0.5
    step = end - start
    rise, overshoot, settling = (motion.measure(name) for name in ("rise", "overshoot", "settling"))
    low, high = (float(times[np.argmax(values >= start + share * step)]) for share in (0.1, 0.9))
    settled = settling.time - motion.times[0]
    figure, drawn = axes(4.0)
    drawn.axhspan(end - 0.02 * step, end + 0.02 * step, color=BLUE, alpha=0.12, linewidth=0)
    drawn.axhline(goal, color=GREY, linewidth=1, linestyle="--")
    drawn.plot(times, values, color=BLUE, linewidth=2)
    peak = int(np.argmax(values))
    arrow = {"arrowstyle": "<->", "color": ORANGE, "shrinkA": 0, "shrinkB": 0}
    for left, right, height, text in (
        (low, high, start + 0.1 * step, f"rise {rise:.2f} s (from 10 % to 90 %)"),
        (settled - settling, settled, start - 0.1 * step, f"settling {settling:.2f} s (stays within 2 %)"),
    ):
        drawn.annotate("", (left, height), (right, height), arrowprops=arrow)
        drawn.text(right + 0.02, height, text, va="center", color=ORANGE)
        for edge in (left, right):
            drawn.axvline(edge, color=ORANGE, linewidth=0.8, linestyle=":")
    drawn.annotate("", (times[peak], end), (times[peak], values[peak]), arrowprops=arrow)
    drawn.text(times[peak] + 0.06, values[peak] - 0.005, f"overshoot {overshoot:.0f} %", va="center", color=ORANGE)
    drawn.annotate("", (times[-1] - 0.1, end), (times[-1] - 0.1, goal), arrowprops=arrow)
    drawn.text(times[-1] - 0.12, (end + goal) / 2, f"error {goal - end:.3f} m", va="center", ha="right", color=ORANGE)
    drawn.text(0.01, goal, "set point", va="bottom", color=GREY)
    drawn.set(xlabel="time, s", ylabel="position of joint1, m", xlim=(0, times[-1]), ylim=(-0.2, 0.56))
    save(figure, "measures.svg")


def trajectory() -> None:
    """What a trajectory controller makes of the points of a goal, and how the joint follows. For controllers.md."""
    points = {1.0: 1.0, 2.0: 0.4, 3.0: 0.4}
    with world("--paused") as environment:
        run(environment, "spawn", "arm", "-q", "--controllers", "config/arm_control.yaml", "--start", "arm_controller")
        with Client(socket=socket_of(environment)) as client:
            states = client.subscribe("/arm/arm_controller/state")
            client.publish(
                "/arm/arm_controller/command",
                {
                    "joint_names": ["joint1"],
                    "points": [
                        {"positions": [position], "velocities": [0.0], "time_from_start": {"secs": int(time)}}
                        for time, position in points.items()
                    ],
                },
            )
            client.step(seconds=3.5)
            last = client.call("/slidectl/status")["time"]
            rows = []
            for state in states:
                stamp = state["header"]["stamp"]
                at = stamp["secs"] + stamp["nsecs"] / 1e9
                rows.append((at, state["desired"]["positions"][0], state["actual"]["positions"][0]))
                if at > last - 0.05:
                    break
    times, desired, actual = np.array(rows).T
    figure, drawn = axes()
    drawn.plot(times, desired, color=GREY, linewidth=1.5, linestyle="--", label="desired: a spline through the points")
    drawn.plot(times, actual, color=BLUE, linewidth=2, label="actual")
    drawn.plot(list(points), list(points.values()), "o", color=ORANGE, label="points of the goal")
    drawn.fill_between(times, desired - 0.2, desired + 0.2, color=GREY, alpha=0.12, linewidth=0,
                       label="path tolerance (constraints/joint1/trajectory)")  # fmt: skip
    drawn.set(xlabel="time from start, s", ylabel="position of joint1, rad", xlim=(0, times[-1]))
    drawn.legend(loc="lower right", frameon=False)
    save(figure, "trajectory.svg")


def cycle() -> None:
    """What happens in one cycle, on the line of simulated time. For time.md."""
    figure, drawn = axes(2.6)
    steps = (
        "clock advances",
        "hardware reads",
        "controllers\nupdate",
        "limits act,\nefforts applied",
        "MuJoCo\nintegrates",
    )
    for number in range(3):
        begin = number * 6
        for place, text in enumerate(steps):
            colour = ORANGE if place == 4 else BLUE
            drawn.add_patch(plt.Rectangle((begin + place, 0), 1, 1, color=colour, alpha=0.16 if number == 1 else 0.07))
            if number == 1:
                drawn.text(begin + place + 0.5, 0.5, text, rotation=90, ha="center", va="center", fontsize=8)
        drawn.add_patch(plt.Rectangle((begin + 5, 0), 1, 1, color=GREY, alpha=0.3))
        drawn.text(begin + 5.5, 0.5, "sockets", rotation=90, ha="center", va="center", fontsize=8)
        drawn.text(begin + 2.5, 1.08, f"cycle {('k - 1', 'k', 'k + 1')[number]}", ha="center", color=GREY)
    drawn.set(xlim=(0, 18), ylim=(0, 1.2), yticks=[], xlabel="simulated time, in time steps (dt)")
    drawn.set_xticks([0, 6, 12, 18], ["(k - 1) dt", "k dt", "(k + 1) dt", "(k + 2) dt"])
    drawn.spines["left"].set_visible(False)
    save(figure, "cycle.svg")


def room() -> None:
    """The room of worlds.md with RRBot between its wall and its crate."""
    page = (ROOT / "docs" / "worlds.md").read_text(encoding="utf-8")
    with world("--rtf", "max") as environment, tempfile.TemporaryDirectory(prefix="slidectl-") as folder:
        file = Path(folder) / "room.world"
        file.write_text(page.partition("```xml\n")[2].partition("```")[0], encoding="utf-8")
        run(environment, "spawn", str(file), "-q")
        run(environment, "spawn", "rrbot", "-q", "--controllers", "config/rrbot_control.yaml", "--start",
            "joint1_position_controller", "joint2_position_controller")  # fmt: skip
        run(environment, "sim", "step", "1s", "-q")
        run(environment, "render", "-o", str(PICTURES / "room.png"), "--size", "960x540", "--camera", "side", "-q")


def main() -> int:
    chromium = shutil.which("chromium")
    if chromium is None:
        print("Chromium is not installed (on Debian: apt install chromium)", file=sys.stderr)
        return 1
    PICTURES.mkdir(exist_ok=True)
    animation()
    slide()
    measured_step()
    trajectory()
    cycle()
    room()
    page(chromium)
    return 0


if __name__ == "__main__":
    sys.exit(main())
