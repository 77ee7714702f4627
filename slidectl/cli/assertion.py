"""`slidectl assert`: whether conditions on a joint or a field hold, and the measures of its motion.

What is measured, and how, is in `slidectl.measures`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import click
import numpy as np

from slidectl import traces
from slidectl.cli import completion
from slidectl.cli.bag import open_recording
from slidectl.cli.commands import command, simulated_seconds, wait_for_world_s
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import paused, way_on
from slidectl.errors import Refused, UsageError
from slidectl.measures import NoMeasure
from slidectl.traces import MEASURES, Signal

_BOUND = re.compile(r"\s*(<=|>=|==|=|<|>)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*\Z")
_HOLDS: dict[str, Callable[[float, float], bool]] = {
    "<": lambda measured, bound: measured < bound,
    "<=": lambda measured, bound: measured <= bound,
    ">": lambda measured, bound: measured > bound,
    ">=": lambda measured, bound: measured >= bound,
    "==": lambda measured, bound: measured == bound,
    "=": lambda measured, bound: measured == bound,
}
_UNITS = {
    "%": ("%", 1.0), "s": ("s", 1.0), "ms": ("s", 1e-3), "m": ("m", 1.0), "mm": ("m", 1e-3), "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180), "N": ("N", 1.0), "Nm": ("N·m", 1.0), "N·m": ("N·m", 1.0), "J": ("J", 1.0),
    "m/s": ("m/s", 1.0), "rad/s": ("rad/s", 1.0),
}  # fmt: skip
"""What may stand behind a number -> the unit of a measure, and the factor."""
_DEFAULT_TOLERANCE = 0.01


class _Bound(NamedTuple):
    """`<5%`, as it was written."""

    text: str
    relation: str
    number: float
    unit: str


def _bound(_click: click.Context, _param: click.Parameter, text: str | None) -> _Bound | None:
    if text is None:
        return None
    match = _BOUND.match(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is no condition: write '<5', '>=0.5' or '==0', in quotes for the shell")
    relation, number, unit = match.groups()
    if unit and unit not in _UNITS:
        raise click.BadParameter(f"{unit!r} is no unit; there are: {', '.join(_UNITS)}")
    return _Bound(text.strip(), relation, float(number), unit)


class _Verdict(NamedTuple):
    """What became of one condition. `text` is the sentence about it."""

    condition: str
    expected: str
    holds: bool
    text: str
    measured: float | None = None
    unit: str = ""
    time: float | None = None

    def record(self, trace: Signal) -> dict[str, Any]:
        begin, end = (float(trace.times[0]), float(trace.times[-1])) if len(trace.times) else (None, None)
        about = {**self._asdict(), "message": self.text, "target": trace.name, "start": begin, "end": end}
        keys = ("target", "condition", "expected", "holds", "measured", "unit", "time", "start", "end", "message")
        return {key: about[key] for key in keys}


def _measure_options(function: Callable[..., None]) -> Callable[..., None]:
    """An option for each measure."""
    for name, measure in reversed(MEASURES.items()):
        function = click.option(f"--{name}", metavar="COND", callback=_bound, help=f"{measure.help}.")(function)
    return function


@command(
    "assert",
    examples=[
        "slidectl assert 'joint_states/position[0]' --near 1.0 --tol 0.02",
        "slidectl assert joint1 --overshoot '<5%' --settling '<2s' --last 10",
        "slidectl assert joint1 --set-point 1.0 --error '<5mm' --effort-peak '<100N' --from run.bag",
        "slidectl assert joint1_position_controller/state/process_value --set-point set_point --iae '<5' --for 5",
    ],
)
@click.argument("target", shell_complete=completion.topics)
@click.option("--near", type=float, metavar="X", help="Within --tol of X.")
@click.option("--above", type=float, metavar="X", help="Greater than X.")
@click.option("--below", type=float, metavar="X", help="Less than X.")
@click.option("--equals", type=float, metavar="X", help="Exactly X.")
@click.option("--tol", type=click.FloatRange(min=0), metavar="T", help="How far --near may be off (0.01).")
@_measure_options
@click.option("--set-point", metavar="X|FIELD", help="What the value is to be: a number, or a field of the same topic.")
@click.option("--since", type=float, metavar="T", help="Simulated time of the step; else when the motion began.")
@click.option("--band", type=click.FloatRange(0, 100, min_open=True), default=2.0, metavar="PERCENT",
              help="Half the width of the band of --settling, of the step (2).")  # fmt: skip
@click.option("--effort-limit", type=float, metavar="X", help="Of --saturation; else the joint's.")
@click.option("--lower", type=float, metavar="X", help="Bound of --limit-hits; else the joint's.")
@click.option("--upper", type=float, metavar="X", help="Bound of --limit-hits; else the joint's.")
@click.option("--last", type=float, callback=simulated_seconds, metavar="S", help="Of the last S simulated seconds.")
@click.option("--for", "duration", type=float, callback=simulated_seconds, metavar="S",
              help="Of the next S simulated seconds.")  # fmt: skip
@click.option("--from", "file", metavar="FILE", shell_complete=completion.files, help="Of a recording.")
@click.pass_obj
def assert_(
    ctx: Context, /, target: str, last: float | None, duration: float | None, file: str | None, **given: Any
) -> None:
    """Tell whether conditions hold, and measure motions.

    TARGET is a joint (joint1, slider/joint1, joint1/velocity, joint1/effort) or TOPIC/FIELD[I]. --near, --above,
    --below and --equals are of this moment, or of the end of a recording; with --last or --for of every sample of that
    time. COND is a relation, a number and, if you like, its unit: '<5%', '>=0.2s', '==0'. All conditions are told;
    exits 1 when one does not hold, or cannot be measured. docs/measures.md has the definitions. JSON keys, a line a
    condition: target, condition, expected, holds, measured, unit, time (when it was so), start, end, message.
    """
    values = {kind: given[kind] for kind in ("near", "above", "below", "equals") if given[kind] is not None}
    bounds = {name: bound for name in MEASURES if (bound := given[name.replace("-", "_")]) is not None}
    _check(values, bounds, last, duration, file, given["tol"])
    trace = _trace(ctx, target, last or 0.0, duration or 0.0, file, given["set_point"])
    known = {"lower": given["lower"], "upper": given["upper"], "max_effort": given["effort_limit"]}
    trace = replace(trace, **{name: value for name, value in known.items() if value is not None})
    if last and not file and trace.times[0] > max(0.0, trace.times[-1] - last) + np.diff(trace.times).max(initial=0.0):
        ctx.warn(f"of the last {last:g} s only those since {trace.times[0]:.3f} s are kept")
    whole = bool(last or duration)
    verdicts = [_of_value(trace, kind, wanted, given["tol"], whole) for kind, wanted in values.items()]
    verdicts += [_of_measure(trace, name, bound, given) for name, bound in bounds.items()]
    for verdict in verdicts:
        if verdict.holds or ctx.format != "text":
            ctx.emit(verdict.record(trace), f"{trace.name}: {verdict.text}")
    failed = [f"{trace.name}: {verdict.text}" for verdict in verdicts if not verdict.holds]
    if failed:
        raise Refused("\n".join(failed))


def _check(
    values: dict[str, float],
    bounds: dict[str, _Bound],
    last: float | None,
    duration: float | None,
    file: str | None,
    tolerance: float | None,
) -> None:
    """Raises UsageError for options that do not go together."""
    if not values and not bounds:
        raise UsageError("no condition", f"give --near, --above, --below, --equals, --{', --'.join(MEASURES)}")
    if tolerance is not None and "near" not in values:
        raise UsageError("--tol goes with --near only")
    if duration and (last or file):
        raise UsageError("--for is of the time to come; it goes with neither --last nor --from")
    if bounds and not (last or duration or file):
        raise UsageError(
            f"--{next(iter(bounds))} is measured over a time", "give --last S, --for S, or --from FILE of a recording"
        )


def _trace(ctx: Context, name: str, last: float, duration: float, file: str | None, set_point: str | None) -> Signal:
    field = "" if set_point is None or _number(set_point) is not None else set_point
    if file is not None:
        with open_recording(ctx, file) as recording:
            return traces.recorded(recording, name, last=last, set_point=field, namespace=ctx.namespace)
    if duration:
        status = ctx.call("/slidectl/status")
        if status["paused"]:
            ctx.say(f"{paused(status)}; this waits until it goes on: {way_on(status)}")
    limit = ctx.wait_limit(wait_for_world_s(duration) if duration else ctx.client.timeout)
    how: dict[str, Any] = {"set_point": field, "namespace": ctx.namespace, "timeout": limit}
    return traces.live(ctx.client, name, last=last, duration=duration, **how)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _of_value(trace: Signal, kind: str, wanted: float, tolerance: float | None, whole: bool) -> _Verdict:
    """The last value, or of all the one that is worst."""
    allowed = _DEFAULT_TOLERANCE if tolerance is None else tolerance
    expected = f"{kind} {wanted:g}" + (f" ± {allowed:g}" if kind == "near" else "")
    if not len(trace.values):
        return _Verdict(kind, expected, False, f"there are no samples, expected {expected}")
    times, values = (trace.times, trace.values) if whole else (trace.times[-1:], trace.values[-1:])
    excess = {
        "near": np.maximum(wanted - allowed - values, values - (wanted + allowed)),
        "above": wanted - values,
        "below": values - wanted,
        "equals": np.abs(values - wanted),
    }[kind]
    worst = int(np.argmax(np.where(np.isnan(excess), np.inf, excess)))
    value, time = float(values[worst]), float(times[worst])
    holds = bool(excess[worst] < 0 if kind in ("above", "below") else excess[worst] <= 0)
    shown = f"{_shown(value, trace.unit)} at {time:.3f} s"
    text = f"{shown} ({expected})" if holds else f"{shown}, expected {expected}"
    if whole:
        text += f" at all times from {times[0]:.3f} to {times[-1]:.3f} s"
    return _Verdict(kind, expected, holds, text, value, trace.unit, time)


def _of_measure(trace: Signal, name: str, bound: _Bound, given: dict[str, Any]) -> _Verdict:
    unit = trace.unit_of(name)
    base, factor = _UNITS.get(bound.unit, (unit, 1.0))
    if base != unit and (unit or not MEASURES[name].unit):  # of a field whose unit nobody knows it is believed
        what = f"is in {unit}" if unit else "is a number"
        raise UsageError(f"--{name} {what}, and {bound.text!r} is not", "leave the unit out for SI units")
    try:
        measured = trace.measure(name, _number(given["set_point"]), given["since"], given["band"] / 100.0)
    except NoMeasure as error:
        return _Verdict(name, bound.text, False, f"{name} cannot be measured: {error.message}", unit=unit)
    holds = _HOLDS[bound.relation](measured, bound.number * factor)
    when = "" if math.isnan(measured.time) or math.isinf(measured) else f" at {measured.time:.3f} s"
    shown = f"{name} {_shown(measured, unit)}{when}"
    text = f"{shown} ({bound.text})" if holds else f"{shown}, expected {bound.text}"
    time = None if math.isnan(measured.time) else measured.time
    return _Verdict(name, bound.text, holds, text, None if math.isinf(measured) else float(measured), unit, time)


def _shown(value: float, unit: str) -> str:
    if value == math.inf:
        return "never"
    return f"{value:.6g} {unit}".rstrip()
