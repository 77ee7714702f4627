"""Pictures and videos of RRBot, and the rates of its camera, by OpenGL where there is one and by software."""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.harness import Row, daemon, median_of, process_cpu_s, timed
from slidectl.physics import rendering

RUNS = 5
VIDEO_S = 5
CAMERA_S = 6.0
CAMERA_GOALS = {(800, 800): 10.0, (320, 240): 30.0}
"""Width and height of RRBot's camera, of which 30 Hz are asked, and the rate that is wanted without a card."""
MODEL = Path(__file__).parent.parent / "models" / "rrbot.xacro"


def measure() -> list[Row]:
    """Rows of this module."""
    rows = []
    with daemon("--paused") as instance:
        instance.spawn("rrbot", ())
        for how in ((), ("--software",)):
            picture, video = Path(instance.folder, "now.png"), Path(instance.folder, "swing.mp4")
            drawn_by = json.loads(instance.run("render", "-o", str(picture), "--json", *how))["drawn_by"]
            if drawn_by == "software" and not how:
                continue
            render = median_of(partial(instance.run, "render", "-o", str(picture), *how), RUNS)
            seconds = timed(partial(instance.run, "video", str(video), "--for", str(VIDEO_S), *how))
            rows += [
                Row(f"slidectl render by {drawn_by}: p50", 1000 * render, "ms", note="800 x 600, whole command"),
                Row(f"slidectl video by {drawn_by}", VIDEO_S / seconds, "s/s", better="higher",
                    note="simulated a wall second, 30 pictures each"),
            ]  # fmt: skip
    for size, goal in CAMERA_GOALS.items():
        for has_opengl in (True, False):
            if not has_opengl or rendering.gl_backend():
                rows += camera_rate(size, goal, has_opengl)
    return rows


def camera_rate(size: tuple[int, int], goal: float, has_opengl: bool) -> list[Row]:
    """The rate of RRBot's camera, with one subscriber, while the arm swings; and what the world keeps of its speed."""
    with TemporaryDirectory(prefix="slidectl-bench-") as folder:
        if not has_opengl:
            for file in ("libEGL.so.1", "libOSMesa.so.8", "libOSMesa.so.6"):  # what is found first is no library
                Path(folder, file).write_bytes(b"")
        text, model = MODEL.read_text(), Path(folder, "rrbot.xacro")
        for side, pixels in zip(("width", "height"), size, strict=True):
            text = text.replace(f"<{side}>800</{side}>", f"<{side}>{pixels}</{side}>")
        model.write_text(text)
        environment = {} if has_opengl else {"LD_LIBRARY_PATH": folder}
        with daemon(environment=environment) as instance:
            instance.run("spawn", str(model), "--joint", "joint1=1.5")
            with instance.client() as client, client.subscribe("/rrbot/camera1/image_raw") as pictures:
                for _ in range(3):
                    pictures.get(60.0)
                began, wall = client.call("/slidectl/status")["time"], time.perf_counter()
                daemon_pid = client.call("/slidectl/status")["pid"]
                (renderer,) = Path(f"/proc/{daemon_pid}/task/{daemon_pid}/children").read_text().split()
                cpu = process_cpu_s(int(renderer))
                stamps: list[float] = []
                while not stamps or stamps[-1] < began + CAMERA_S:
                    stamp = pictures.get(60.0)["header"]["stamp"]
                    stamps.append(stamp["secs"] + 1e-9 * stamp["nsecs"])
                cpu = process_cpu_s(int(renderer)) - cpu
                speed = (client.call("/slidectl/status")["time"] - began) / (time.perf_counter() - wall)
                drawn_by = client.call("/slidectl/status")["pictures"].partition(":")[0]
    what = f"camera of {size[0]} x {size[1]} at 30 Hz by {drawn_by}"
    rate = (len(stamps) - 1) / (stamps[-1] - stamps[0])
    return [
        Row(f"{what}: rate", rate, "Hz", goal, "higher", note="in simulated time, one subscriber"),
        Row(f"{what}: processor time of a picture", 1000 * cpu / len(stamps), "ms", note="of all threads"),
        Row(f"{what}: real-time factor", speed, "", 0.99, "higher"),
    ]
