"""`make bench`: runs the measurements, prints a table, writes JSON, and puts the table into docs/performance.md.

README.md gets the headlines: what was measured, without goals. docs/performance.md says which goals are missed, and
what bounds them.

    python -m benchmarks [NAME ...] [--no-write]

Names are the modules of this folder, see NAMES.
"""

from __future__ import annotations

import importlib
import json
import os
import platform
import re
import sys
import time
from pathlib import Path

from benchmarks.harness import Row

HERE = Path(__file__).parent
README = HERE.parent / "README.md"
PERFORMANCE = HERE.parent / "docs" / "performance.md"
NAMES = (
    "commands",
    "cycles",
    "controllers",
    "realtime",
    "latency",
    "streams",
    "recordings",
    "journals",
    "scenarios",
    "spawns",
    "snapshots",
    "pictures",
    "viewers",
    "ros1",
    "rosbridge",
    "ros2",
    "compare",
)
HEADLINES = (
    "slidectl pub command 1.0",
    "slidectl pub command 1.0: ratio to python -c 'import click'",
    "slidectl daemon start",
    "slidectl launch my_slider slider.launch, from nothing",
    "slider, compiled: ratio to bare mj_step",
    "rrbot, compiled: ratio to bare mj_step",
    "100 RRBots, compiled: ratio to bare mj_step",
    "rrbot at real time: processor use of one core",
    "publish to effort, real time: p50",
    "memory of the daemon with rrbot, plain",
)
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def main(arguments: list[str]) -> int:
    """Run the named measurements, or all of them. The exit code: 2 for a word that is no name."""
    write = "--no-write" not in arguments
    chosen = [word for word in arguments if word != "--no-write"]
    if not set(chosen) <= set(NAMES):
        print(f"python -m benchmarks [NAME ...] [--no-write]\nnames: {', '.join(NAMES)}", file=sys.stderr)
        return 0 if {"-h", "--help"} & set(chosen) else 2
    names = chosen or list(NAMES)
    results: dict[str, list[Row]] = {}
    for name in names:
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        results[name] = importlib.import_module(f"benchmarks.{name}").measure()
    rows = [row for group in results.values() for row in group]
    print(markdown(rows))
    if write:
        save(results)
        if names == list(NAMES):
            put_table(PERFORMANCE, markdown(rows))
            put_table(README, headlines(rows))
    return 0


def markdown(rows: list[Row]) -> str:
    """The rows as a Markdown table, which reads as well on a terminal."""
    lines = ["| what | measured | goal | |", "| --- | ---: | ---: | --- |"]
    for row in rows:
        goal = "" if row.goal is None else f"{'≤' if row.better == 'lower' else '≥'} {row.goal:g} {row.unit}".strip()
        verdict = {True: "", False: "**missed** ", None: ""}[row.met]
        lines.append(
            f"| {row.name} | {figure(row.value)} {row.unit} | {goal} | {verdict}{row.note} |".replace("  ", " ")
        )
    return "\n".join(lines)


def headlines(rows: list[Row]) -> str:
    """The rows of HEADLINES in their order as a Markdown table, without goals and verdicts."""
    lines = ["| what | measured | |", "| --- | ---: | --- |"]
    for name in HEADLINES:
        for row in rows:
            if row.name == name:
                lines.append(f"| {row.name} | {figure(row.value)} {row.unit} | {row.note} |".replace("  ", " "))
    return "\n".join(lines)


def figure(value: float) -> str:
    """Three significant digits, without an exponent."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def save(results: dict[str, list[Row]]) -> None:
    """One JSON file a run in benchmarks/results/, for the history."""
    folder = HERE / "results"
    folder.mkdir(exist_ok=True)
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    machine = {"cores": os.cpu_count(), "arch": platform.machine(), "python": platform.python_version()}
    content = {"taken": stamp, "machine": machine, "results": {k: [r.as_json() for r in v] for k, v in results.items()}}
    path = folder / f"{stamp}.json"
    path.write_text(json.dumps(content, indent=1) + "\n")
    print(f"written: {path.relative_to(HERE.parent)}", file=sys.stderr)


def put_table(page: Path, table: str) -> None:
    """Replace the table between the two marks of a page."""
    text = page.read_text(encoding="utf-8")
    pattern = re.compile(re.escape(BEGIN) + ".*?" + re.escape(END), re.DOTALL)
    page.write_text(pattern.sub(lambda _: f"{BEGIN}\n{table}\n{END}", text), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
