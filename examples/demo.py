"""What `make demo` runs: a daemon, the slider, its controllers, three commands, and the block moving before your eyes.

A user of the public Client and of the command line; nothing here is private to slidectl.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from slidectl import Client

SPEED = "4"
TARGETS = (("up", 1.0), ("middle", 0.0), ("down", -1.0))
TOLERANCE_M = 0.02
WITHIN_S = 20.0
HOLD_S = 0.5
WIDTH = 61


def main() -> int:
    """Run the demo in a world of its own, of which nothing stays; 0 when every target was reached."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SLIDECTL_SOCKET"] = f"{folder}/demo"
        return demo()


def demo() -> int:
    """Start, spawn, slide, stop."""
    console = Console(highlight=False)
    run("daemon", "start", "--rtf", SPEED)
    try:
        run("spawn", "slider", "--controllers", "config/slider_control.yaml")
        run("controller", "spawn", "joint_state_controller", "joint1_position_controller")
        with Client() as client:
            rows = [slide(client, console, name, target) for name, target in TARGETS]
    finally:
        run("daemon", "stop")
    console.print(table(rows, box.ROUNDED if console.is_terminal else box.ASCII2))
    return 0 if all(row["reached"] for row in rows) else 1


def run(*words: str) -> None:
    """One slidectl command, shown as a user would type it."""
    print("$ slidectl", *words, flush=True)
    slidectl = Path(sys.executable).with_name("slidectl")
    subprocess.run([slidectl, *words], check=True)


def slide(client: Client, console: Console, name: str, target: float) -> dict[str, Any]:
    """Send one command and show the position until the block has settled there."""
    print(f"$ slidectl pub command {target}    # {name}", flush=True)
    states = client.subscribe("/slider/joint_states")
    client.publish("/slider/joint1_position_controller/command", {"data": target})
    began = settled = None
    shown = -1.0
    view = Live(console=console, refresh_per_second=20, transient=True) if console.is_terminal else None
    with view or Quiet():
        for state in states:
            time_s, position = stamp(state), state["position"][0]
            began = time_s if began is None else began
            near = abs(position - target) <= TOLERANCE_M
            settled = (settled if settled is not None else time_s) if near else None
            if view:
                view.update(bar(time_s - began, position, target))
            elif time_s - shown >= 2.0:
                print(f"  t {time_s - began:5.1f} s   position {position:+.3f} m   to {target:+.1f} m", flush=True)
                shown = time_s
            if (settled is not None and time_s - settled >= HOLD_S) or time_s - began > WITHIN_S:
                break
    states.close()
    return {
        "name": name,
        "target": target,
        "position": position,
        "reached": near,
        "seconds": (settled or time_s) - began,
    }


class Quiet:
    """Stands where the live view would stand on a terminal."""

    def __enter__(self) -> Quiet:
        return self

    def __exit__(self, *_: object) -> None:
        return None


def stamp(message: dict[str, Any]) -> float:
    """Simulated time of a stamped message, s."""
    return float(message["header"]["stamp"]["secs"] + 1e-9 * message["header"]["stamp"]["nsecs"])


def bar(time_s: float, position: float, target: float) -> Text:
    """The rail from -1 to +1 m with the target and the block on it."""
    rail = ["─"] * WIDTH
    rail[cell(target)] = "┼"
    rail[cell(position)] = "█"
    return Text(f"  -1 {''.join(rail)} +1   {position:+.3f} m   t {time_s:5.1f} s")


def cell(position: float) -> int:
    """Index on the rail for a position in m."""
    return max(0, min(WIDTH - 1, round((position + 1.0) / 2.0 * (WIDTH - 1))))


def table(rows: list[dict[str, Any]], style: box.Box) -> Table:
    """What was asked and what was reached."""
    out = Table(title="asked and reached", title_justify="left", box=style)
    for column in ("command", "asked, m", "reached, m", "error, mm", "simulated s", ""):
        out.add_column(column, justify="left" if column in ("command", "") else "right")
    for row in rows:
        error = 1000 * (row["position"] - row["target"])
        verdict = "reached" if row["reached"] else "NOT reached"
        out.add_row(
            row["name"],
            f"{row['target']:+.3f}",
            f"{row['position']:+.3f}",
            f"{error:+.1f}",
            f"{row['seconds']:.1f}",
            verdict,
        )
    return out


if __name__ == "__main__":
    sys.exit(main())
