"""Pictures and videos of RRBot, by OpenGL where there is one and by software."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

from benchmarks.harness import Row, daemon, median_of, timed

RUNS = 5
VIDEO_S = 5


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
    return rows
