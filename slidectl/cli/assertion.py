"""`slidectl assert`: check conditions on a joint or a field, and on the measures of its motion.

`slidectl.measures` defines the measures.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import click
import numpy as np

from slidectl import traces
from slidectl.cli import completion
from slidectl.cli.commands import command, conditions, finite, number, seconds, wait_for_world_s
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import pause_remark
from slidectl.errors import Refused, UsageError
from slidectl.measures import NoMeasure, measure_text
from slidectl.traces import MEASURES, JointOrFieldTrace

_BOUND = re.compile(r"\s*(<=|>=|==|=|<|>)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*\Z")
_HOLDS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "=": operator.eq,
}  # fmt: skip
_UNITS = {
    "%": ("%", 1.0), "s": ("s", 1.0), "ms": ("s", 1e-3), "m": ("m", 1.0), "mm": ("m", 1e-3), "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180), "N": ("N", 1.0), "Nm": ("N·m", 1.0), "N·m": ("N·m", 1.0), "J": ("J", 1.0),
    "m/s": ("m/s", 1.0), "rad/s": ("rad/s", 1.0),
}  # fmt: skip
"""Unit behind a number -> unit of the measure, and the factor between them."""
_POSSIBLE = {"value": ("m", "rad", "m/s", "rad/s", "N", "N·m", "J"), "effort": ("N", "N·m")}
"""Unit kind of a measure -> units that it may have when the unit of the values is not known."""
_OF_FORCES = ("contact", "peak-force")
_DEFAULT_TOLERANCE = 0.01


class _Bound(NamedTuple):
    """A condition such as `<5%`. `text` is the user's text."""

    text: str
    relation: str
    number: float
    unit: str


def _bound(_click: click.Context, _param: click.Parameter, text: str | None) -> _Bound | None:
    if text is None:
        return None
    match = _BOUND.match(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not a condition: write '<5', '>=0.5' or '==0', in quotes for the shell")
    relation, number, unit = match.groups()
    if unit and unit not in _UNITS:
        raise click.BadParameter(f"{unit!r} is not a unit; there are: {', '.join(_UNITS)}")
    return _Bound(text.strip(), relation, float(number), unit)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _set_point(click_context: click.Context, param: click.Parameter, text: str | None) -> str | None:
    finite(click_context, param, _number(text))
    return text


class _Verdict(NamedTuple):
    """The result of one condition. `text` is the sentence that is printed."""

    condition: str
    expected: str
    holds: bool
    text: str
    measured: float | None = None
    unit: str = ""
    time: float | None = None

    def record(self, trace: JointOrFieldTrace) -> dict[str, Any]:
        begin, end = (float(trace.times[0]), float(trace.times[-1])) if len(trace.times) else (None, None)
        return {
            "target": trace.name, "condition": self.condition, "expected": self.expected, "holds": self.holds,
            "measured": self.measured, "unit": self.unit, "time": self.time, "start": begin, "end": end,
            "message": self.text,
        }  # fmt: skip


def _measure_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add an option for each measure."""
    for name, measure in reversed(MEASURES.items()):
        click.option(f"--{name}", metavar="COND", callback=_bound, help=f"{measure.help}{_in_unit(measure.unit)}.")(
            function
        )
    return function


def _in_unit(unit: str) -> str:
    """The unit of a measure, for its help."""
    named = {
        "value": "in the unit of the value", "value·s": "in the unit of the value times s", "effort": "N or N m",
        "": "a number of times", "%": "",
    }.get(unit, unit)  # fmt: skip
    return named and f", {named}"


def _conditions(
    last: float | None, duration: float | None, file: str | None, **given: Any
) -> tuple[dict[str, float], dict[str, _Bound]]:
    """The conditions on values, and those on measures, by name. Raises UsageError for options that do not combine."""
    values = {kind: given[kind] for kind in ("near", "above", "below", "equals") if given[kind] is not None}
    bounds = {name: bound for name in MEASURES if (bound := given[name.replace("-", "_")]) is not None}
    if not values and not bounds:
        raise UsageError("no condition", f"give --near, --above, --below, --equals, --{', --'.join(MEASURES)}")
    if given["tol"] is not None and "near" not in values:
        raise UsageError("--tol needs --near")
    if duration and (last or file):
        raise UsageError("--for measures the time to come; it excludes --last and --from")
    if bounds and not (last or duration or file):
        raise UsageError(
            f"--{next(iter(bounds))} is measured over a time", "give --last S, --for S, or --from FILE of a recording"
        )
    return values, bounds


@command(
    "assert",
    check_words=_conditions,
    examples=[
        "slidectl assert 'joint_states/position[0]' --near 1.0 --tol 0.02",
        "slidectl assert joint1 --overshoot '<5%' --settling '<2s' --last 10",
        "slidectl assert joint1 --set-point 1.0 --error '<5mm' --effort-peak '<100N' --from run.bag",
        "slidectl assert joint1_position_controller/state/process_value --set-point set_point --iae '<5' --for 5",
    ],
)
@click.argument("target", shell_complete=completion.topics_and_fields)
@conditions(number("--equals", help="Exactly X, in the unit of the value."))
@_measure_options
@click.option("--set-point", callback=_set_point, metavar="X|FIELD",
              help="The set point: a number in the unit of the value, or a field of the same topic.")  # fmt: skip
@number("--since", metavar="T", help="Simulated time of the step, s; by default the start of the motion.")
@click.option("--band", type=click.FloatRange(0, 100, min_open=True), default=2.0, callback=finite, metavar="PERCENT",
              help="Half the width of the band for --settling, % of the step (2).")  # fmt: skip
@number("--effort-limit", help="Limit for --saturation, N or N m; by default that of the joint.")
@number("--lower", help="Bound for --limit-hits, in the unit of the value; by default that of the joint.")
@number("--upper", help="Bound for --limit-hits, in the unit of the value; by default that of the joint.")
@seconds("--last", help="Measure the last S simulated seconds.")
@seconds("--for", "duration", help="Measure the next S simulated seconds.")
@completion.file_option("--from", "file", help="Measure a recording.")
@click.pass_obj
def assert_(
    ctx: Context, /, target: str, last: float | None, duration: float | None, file: str | None, **given: Any
) -> None:
    """Check conditions, and measure motions.

    TARGET is a joint (joint1, slider/joint1, joint1/velocity, joint1/effort) or TOPIC/FIELD[I]. --near, --above,
    --below and --equals test the present value, or the end of a recording; with --last or --for they test every sample
    of that time. COND is a relation, a number and an optional unit: '<5%', '>=0.2s', '==0'. It prints all conditions,
    and exits 1 when one does not hold or cannot be measured. docs/measures.md has the definitions. JSON keys, a line a
    condition: target, condition, expected, holds, measured, unit, time (when it was so), start, end, message.
    """
    values, bounds = _conditions(last, duration, file, **given)
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
        from slidectl.client import steady_error

        why = None if file is not None else steady_error.of_target(ctx.client, trace.name)
        raise Refused("\n".join(failed), why)


def _trace(
    ctx: Context, name: str, last: float, duration: float, file: str | None, set_point: str | None
) -> JointOrFieldTrace:
    field = "" if set_point is None or _number(set_point) is not None else set_point
    if file is not None:
        from slidectl.extensions.recording.commands.bag import open_recording

        with open_recording(ctx, file) as recording:
            return traces.recorded(recording, name, last=last, set_point=field, namespace=ctx.namespace)
    if duration:
        ctx.say(pause_remark(ctx.call("/slidectl/status")))
    limit = ctx.wait_limit(wait_for_world_s(duration) if duration else ctx.client.timeout)
    how: dict[str, Any] = {"set_point": field, "namespace": ctx.namespace, "timeout": limit}
    return traces.live(ctx.client, name, last=last, duration=duration, **how)


def _of_value(trace: JointOrFieldTrace, kind: str, wanted: float, tolerance: float | None, whole: bool) -> _Verdict:
    """Check the last value, or with `whole` all values and report the worst."""
    allowed = _DEFAULT_TOLERANCE if tolerance is None else tolerance
    expected = f"{kind} {wanted:g}" + (f" ± {allowed:g}" if kind == "near" else "")
    part = trace if whole else replace(trace, times=trace.times[-1:], values=trace.values[-1:])
    try:
        holds, worst = part.holds(kind, wanted, allowed)
    except NoMeasure as error:
        return _Verdict(kind, expected, False, f"{error.message}, expected {expected}")
    shown = f"{measure_text(worst, trace.unit)} at {worst.time:.3f} s"
    text = f"{shown} ({expected})" if holds else f"{shown}, expected {expected}"
    if whole:
        text += f" at all times from {trace.times[0]:.3f} to {trace.times[-1]:.3f} s"
    return _Verdict(kind, expected, holds, text, float(worst), trace.unit, worst.time)


def _of_measure(trace: JointOrFieldTrace, name: str, bound: _Bound, given: dict[str, Any]) -> _Verdict:
    unit = trace.unit_of(name)
    if name in _OF_FORCES and trace.unit not in ("", "N", "N·m"):
        raise UsageError(f"--{name} is of a force or a torque, and {trace.name} is in {trace.unit}")
    base, factor = _UNITS.get(bound.unit, (unit, 1.0))
    if base != unit and (unit or base not in _POSSIBLE.get(MEASURES[name].unit, ())):
        what = f"is in {unit}" if unit else "has the unit of the values" if MEASURES[name].unit else "is a number"
        raise UsageError(f"--{name} {what}, and {bound.text!r} is not", "leave the unit out for SI units")
    try:
        measured = trace.measure(name, _number(given["set_point"]), given["since"], given["band"] / 100.0)
    except NoMeasure as error:
        return _Verdict(name, bound.text, False, f"{name} cannot be measured: {error.message}", unit=unit)
    holds = _HOLDS[bound.relation](measured, bound.number * factor)
    when = "" if math.isnan(measured.time) or math.isinf(measured) else f" at {measured.time:.3f} s"
    shown = f"{name} {measure_text(measured, unit)}{when}"
    text = f"{shown} ({bound.text})" if holds else f"{shown}, expected {bound.text}"
    time = None if math.isnan(measured.time) else measured.time
    return _Verdict(name, bound.text, holds, text, None if math.isinf(measured) else float(measured), unit, time)
