"""The step response of a single-joint controller: its curves and its measures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from slidectl import measures, names, traces
from slidectl.client import Client
from slidectl.errors import Refused, UsageError
from slidectl.extensions.viewing.plots import Curve, Plot, Reading
from slidectl.measures import Array, Measured, NoMeasure, measure_text
from slidectl.traces import JointOrFieldTrace

_CONTROLLED = {"JointPositionController": "position", "JointVelocityController": "velocity"}
MEASURES = ("rise", "overshoot", "settling", "error", "effort-peak")


class StepResponse(NamedTuple):
    """The plot; the time of the step (s); measure -> its value, None if it cannot be measured; the unit."""

    plot: Plot
    start: float
    measured: dict[str, Measured | None]
    unit: str


def step_response(
    client: Client, namespace: str, controller: str, set_point: float, duration: float, timeout: float
) -> StepResponse:
    """Give a controller a set point and record its joint for `duration` simulated seconds.

    Raises:
        UsageError: not a position or velocity controller of one joint. TimedOut, NoDaemon.
        Refused: it takes no command: it does not run, or publishes none of its joint.
    """
    space = names.join(namespace, controller)
    about = client.params.get(space, {})
    kind = str(about.get("type", "")).rpartition("/")[2]
    if kind not in _CONTROLLED or "joint" not in about:
        raise UsageError(
            f"{space} is {about.get('type') or 'of no type'}: a step response is of one joint",
            f"controllers of the types {', '.join(_CONTROLLED)} have one",
        )
    quantity, joint, command = _CONTROLLED[kind], names.join(namespace, str(about["joint"])), f"{space}/command"
    times: list[float] = []

    def take(published: dict[str, Any]) -> None:
        if published.get("latch") is None and published["msg"]["data"] == set_point:
            times.append(published["time"]["secs"] + published["time"]["nsecs"] * 1e-9)

    with client.subscribe(command, "std_msgs/Float64", take=take):
        trace = traces.live(
            client, joint if quantity == "position" else f"{joint}/{quantity}", duration=duration, timeout=timeout,
            begun=lambda: client.publish(command, {"data": set_point}),
        )  # fmt: skip
    client.flush()
    if not times:
        raise Refused(f"{command} did not come within {duration:g} s", "give it longer: --for SECONDS")
    start, now = times[0], trace.times
    measured: dict[str, Measured | None] = {}
    texts = []
    for name in MEASURES:
        try:
            measured[name] = trace.measure(name, set_point, start)
            texts.append(f"{name} {measure_text(measured[name] or 0.0, trace.unit_of(name))}")
        except NoMeasure as error:
            measured[name] = None
            texts.append(f"{name}: {error.message}")
    wanted: Array = np.where(now >= start - 1e-9, set_point, np.nan)
    efforts = trace.efforts if trace.efforts is not None else np.full(now.shape, math.nan)
    curves = [
        Curve(f"{space}/set_point", "", trace.unit, now, wanted),
        Curve(f"{space}/process_value", f"{quantity} of {about['joint']}", trace.unit, now, trace.values),
        Curve(f"{space}/error", "", trace.unit, now, wanted - trace.values, "error"),
        Curve(f"{space}/effort", str(about["joint"]), trace.effort_unit, now, efforts, is_banded=True),
    ]
    drawn = Plot(
        f"{space}: step to {set_point:g}", curves, notes=[", ".join(texts[:3]), ", ".join(texts[3:])],
        x_label="time from the step (s)", origin=start,
    )  # fmt: skip
    with suppress(NoMeasure):
        step = measures.step(now, trace.values, set_point, start)
        half = abs(measures.BAND * step.size)
        drawn.tolerance = (step.final - half, step.final + half, f"\N{PLUS-MINUS SIGN}{100 * measures.BAND:g} %")
        drawn.readings = list(_readings(trace, measured))
    return StepResponse(drawn, start, measured, trace.unit)


def _readings(trace: JointOrFieldTrace, measured: dict[str, Measured | None]) -> Iterator[Reading]:
    """Where rise, overshoot and settling are read, as far as they were reached; there is none of no overshoot."""

    def reading(time: float, text: str, name: str) -> Reading:
        return Reading(time, float(np.interp(time, trace.times, trace.values)), text, name)

    rise, overshoot, settling = (measured[name] for name in MEASURES[:3])
    if rise is not None and rise < math.inf:
        yield reading(rise.time - rise, f"{100 * measures.LOW:g} %", f"{100 * measures.LOW:g} %")
        text = f"{100 * measures.HIGH:g} %"
        yield reading(rise.time, f"{text}: rise {rise:.3g} s", f"{text}: rise")
    if overshoot:
        yield reading(overshoot.time, f"overshoot {overshoot:.3g} %", "overshoot")
    if settling is not None and settling < math.inf:
        yield reading(settling.time, f"settling {settling:.3g} s", "settling")
