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

from playwright.sync_api import sync_playwright

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


def run(environment: dict[str, str], *words: str) -> None:
    subprocess.run([SLIDECTL, *words], env=environment, cwd=ROOT, check=True)


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
                for button in tab.locator(".mantine-Notification-closeButton").all():
                    button.click()
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

    The waves begin where both robots are highest, for the view takes in what is there at the first picture.
    """
    waves = {
        "/slider/joint1_position_controller": "0.8*sin(2*pi*t/6)",
        "/rrbot/joint1_position_controller": "0.7*sin(2*pi*t/6)",
        "/rrbot/joint2_position_controller": "1.2*sin(4*pi*t/6)",
    }
    with world("--paused") as environment, tempfile.TemporaryDirectory(prefix="slidectl-") as folder:
        quick = Path(folder) / "quick.yaml"  # the slider's own limit of 0.1 m/s is too slow to look at
        quick.write_text(
            (ROOT / "config" / "slider_control.yaml").read_text(encoding="utf-8")
            + "\n  joint_limits: {joint1: {has_velocity_limits: true, max_velocity: 2.0}}\n",
            encoding="utf-8",
        )
        run(environment, "spawn", "slider", "-q", "--at", "0", "-0.8", "0", "--controllers", str(quick), "--start",
            "joint1_position_controller")  # fmt: skip
        run(environment, "spawn", "rrbot", "-q", "--at", "0", "0.8", "0", "--controllers",
            "config/rrbot_control.yaml", "--start", "joint1_position_controller",
            "joint2_position_controller")  # fmt: skip
        publishers = [
            subprocess.Popen([SLIDECTL, "pub", "-q", "-r", "100", f"{name}/command", wave], env=environment)
            for name, wave in waves.items()
        ]
        try:
            time.sleep(2)  # until they publish, as time stands still
            run(environment, "sim", "step", "6s", "-q")  # the swing of the beginning has gone: the last picture of
            # the next period leads to its first one
            for file, more in (("slide.mp4", ("--size", "960x540")),
                               ("slide.gif", ("--size", "480x270", "--fps", "10"))):  # fmt: skip
                run(environment, "video", str(PICTURES / file), "--for", "6", *more, "-q")
            run(environment, "render", "-o", str(PICTURES / "slide.png"), "--size", "960x540", "-q")
        finally:
            for publisher in publishers:
                publisher.terminate()
                publisher.wait()


def main() -> int:
    chromium = shutil.which("chromium")
    if chromium is None:
        print("Chromium is not installed (on Debian: apt install chromium)", file=sys.stderr)
        return 1
    PICTURES.mkdir(exist_ok=True)
    animation()
    slide()
    page(chromium)
    return 0


if __name__ == "__main__":
    sys.exit(main())
