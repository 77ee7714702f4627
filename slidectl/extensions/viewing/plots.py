"""Plots: curves in panels with a shared time axis, as text for a terminal, as SVG, PNG, PDF, HTML and CSV.

It knows no daemon and no recording: `plot_fields` makes the curves. The same curves give the same bytes.
"""

from __future__ import annotations

import html
import io
import math
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, takewhile
from typing import Any, NamedTuple

import numpy as np

from slidectl.errors import Refused, UsageError
from slidectl.measures import Array
from slidectl.paths import install_command
from slidectl.writing import file_kind

FORMATS = (".svg", ".png", ".pdf", ".html", ".csv")
PANELS = ("unit", "each", "one")
"""Which curves share a panel: those of one unit, none, or all."""
_BUCKETS = 2000
"""The maximum number of minimum-maximum pairs drawn per curve in a file: more than there are pixels."""
_LARGEST = 1e300
"""Larger values are not drawn: the length of an axis could overflow."""
_TIME = "time (s)"
_DPI = 100
_LEGEND_ROW = 18
"""The height of a row of a legend, pixels."""
_LETTER = 7
"""The width of a letter of a legend, pixels, and of a curve's sample in letters."""
_SAMPLE = 7
_REST = 1e-6
_BANDS = 240
"""The number of parts of a curve in which chatter is looked for."""
_REVERSALS = 4
"""So many turns back and forth within a part are chatter."""
_CHATTER = 0.02
"""The least height of chatter, as a part of the curve's height."""
_MARK = "\N{BLACK CIRCLE}"
_TICKS = (1.0, 2.0, 2.5, 5.0, 10.0)
"""Distances between ticks, times a power of ten."""
_LEAST_ROWS = 6
_PENS = (("blue+", 94), ("red+", 91), ("green+", 92), ("orange+", 93), ("magenta+", 95), ("cyan+", 96))
"""Colours of curves in a terminal: plotext's names, and escape codes."""
_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_NANOSECONDS = 1e9


class MissingPlotLibrary(Refused):
    """A plotting library is not installed."""

    def __init__(self, library: str, what: str) -> None:
        super().__init__(f"{what} needs the library {library}", f"install it: {install_command('plot')}")


@dataclass
class Curve:
    """One number over simulated time (s), or over another number. nan is a gap."""

    name: str
    """In full: `/slider/joint_states/position[0]`."""
    about: str = ""
    """Additional text for the legend: the joint."""
    unit: str = ""
    """Empty if unknown."""
    times: array[float] | Array = field(default_factory=lambda: array("d"))
    values: array[float] | Array = field(default_factory=lambda: array("d"))
    panel: str = ""
    """Curves of one unit and different panels do not share one."""
    is_banded: bool = False
    """In a file, draw the mean, and a band from minimum to maximum, where the values chatter."""

    def points(self, begin: float = -math.inf) -> tuple[Array, Array]:
        """Times and values (n,) from `begin` on."""
        times, values = np.array(self.times), np.array(self.values)
        here = times >= begin
        return times[here], values[here]


class Reading(NamedTuple):
    """A point of the first panel at which a measure is read, and what it is."""

    time: float
    value: float
    text: str
    name: str
    """In short, for a terminal."""


@dataclass
class Plot:
    """A plot. `notes` are lines below the title; `x_label` applies to all panels."""

    title: str
    """By default the common beginning of all curve names."""
    curves: Sequence[Curve]
    panels: str = "unit"
    notes: Sequence[str] = ()
    x_label: str = _TIME
    y_label: str = ""
    window: float | None = None
    is_phase: bool = False
    """x is another number, not time."""
    origin: float = 0.0
    """The time that pictures show as 0, s; a CSV has simulated time."""
    readings: Sequence[Reading] = ()
    tolerance: tuple[float, float, str] | None = None
    """Two values of the first panel between which a band is drawn, and its label."""

    def __post_init__(self) -> None:
        parts = zip(*(curve.name.split("/")[:-1] for curve in self.curves), strict=False)
        self._shared = "/".join(every[0] for every in takewhile(lambda every: len(set(every)) == 1, parts))
        self.title = self.title or self._shared

    @property
    def begin(self) -> float:
        """The start of the last `window` seconds, which end with the last sample of all curves."""
        if self.window is None:
            return -math.inf
        return max((curve.times[-1] for curve in self.curves if len(curve.times)), default=0.0) - self.window

    def labelled(self) -> list[tuple[str, Curve]]:
        """The curves with their legend labels: their names without the common beginning."""
        cut = len(self._shared) + bool(self._shared)
        return [(curve.name[cut:] + (f" ({curve.about})" if curve.about else ""), curve) for curve in self.curves]

    def rows(self) -> list[tuple[str, list[tuple[str, Curve]]]]:
        """The panels from top to bottom: the label of the y axis, and the labelled curves."""
        found: dict[Any, list[tuple[str, Curve]]] = {}
        for number, (label, curve) in enumerate(self.labelled()):
            key = {"unit": (curve.panel, curve.unit), "each": number, "one": ""}[self.panels]
            found.setdefault(key, []).append((label, curve))
        units = [dict.fromkeys(curve.unit for _, curve in row if curve.unit) for row in found.values()]
        return [(self.y_label or " / ".join(unit), row) for unit, row in zip(units, found.values(), strict=True)]

    def points(self, curve: Curve, buckets: int) -> tuple[Array, Array]:
        """The points of a curve to draw: thinned, with nan for values that no axis can show."""
        times, values = curve.points(self.begin)
        here = thinned(buckets, times, values) if self.is_phase else thinned(buckets, values)
        times, values = times[here] - self.origin, values[here]
        return times, np.where((abs(values) < _LARGEST) & (abs(times) < _LARGEST), values, np.nan)


def moves(curve: Curve) -> bool:
    """Whether the values change by more than a millionth (of 1, or of the largest value)."""
    finite = np.array(curve.values)[np.isfinite(curve.values)]
    return bool(len(finite) and np.ptp(finite) > _REST * max(1.0, abs(finite).max()))


def chatter(values: Array) -> Iterator[tuple[slice, bool]]:
    """The parts of a curve in order, and whether the values go back and forth in them."""
    height = _CHATTER * float(np.ptp(values)) if len(values) else 0.0
    for begin, end in pairwise(int(edge) for edge in np.linspace(0, len(values), _BANDS + 1)):
        part = values[begin:end]
        turns = np.sign(np.diff(part))
        reversals = np.count_nonzero(np.diff(turns[turns != 0]))
        yield slice(begin, end), bool(reversals >= _REVERSALS and np.ptp(part) > height)


def thinned(buckets: int, *columns: Array) -> Any:
    """Indices of the samples to draw: the minimum and maximum of each column in each bucket, and its gaps."""
    count = len(columns[0])
    if count <= 4 * buckets:
        return np.arange(count)
    kept = {0, count - 1}
    edges = [int(edge) for edge in np.linspace(0, count, buckets + 1)]
    for column in columns:
        finite = np.isfinite(column)
        lows, highs = np.where(finite, column, np.inf), np.where(finite, column, -np.inf)
        for begin, end in pairwise(edges):
            kept |= {begin + int(lows[begin:end].argmin()), begin + int(highs[begin:end].argmax())}
            if not finite[begin:end].all():
                kept.add(begin + int(finite[begin:end].argmin()))
    return np.array(sorted(kept))


# --- a terminal -------------------------------------------------------------------------------------------------------


def check_terminal() -> None:
    """Check that plotext is installed. Raises MissingPlotLibrary."""
    try:
        import plotext  # noqa: F401
    except ImportError:
        raise MissingPlotLibrary("plotext", "a plot in the terminal") from None


def as_text(plot: Plot, width: int, height: int, colour: bool) -> str:
    """The plot as text of this size in characters. Panels that do not fit are omitted, with a note."""
    lines = [plot.title, *plot.notes]
    rows = plot.rows()
    room = height - len(lines) - 1
    fitting = rows[: max(1, room // (_LEAST_ROWS + 1))]
    points = [[plot.points(curve, 2 * width) for _, curve in curves] for _, curves in fitting]
    xs = np.concatenate([times[np.isfinite(values)] for row in points for times, values in row])
    for number, (y_label, curves) in enumerate(fitting):
        readings = () if number else plot.readings
        lines.append(_key(y_label, [label for label, _ in curves], readings, width, colour))
        rest = max(_LEAST_ROWS, room // len(fitting) - 1)
        x_label = plot.x_label * (curves is fitting[-1][1])
        marks = [(one.time - plot.origin, one.value) for one in readings]
        lines += _panel(points[number], marks, xs, x_label, width, rest, colour)
    if len(fitting) < len(rows):
        lines.append(f"{len(rows) - len(fitting)} more panels: enlarge the terminal")
    return "\n".join(line if "\x1b" in line else line[:width].rstrip() for line in lines[:height])


def _key(unit: str, labels: Sequence[str], readings: Sequence[Reading], width: int, colour: bool) -> str:
    """The line above a panel: its curves in their colours, or with their letters, and readings, as far as they fit."""
    parts, left = [], width
    for number, label in enumerate(labels):
        part = label if colour or len(labels) == 1 else f"{_LETTERS[number % len(_LETTERS)]}: {label}"
        part = part[: max(0, left)]
        left -= len(part) + 2
        parts.append(f"\x1b[{_PENS[number % len(_PENS)][1]}m{part}\x1b[0m" if colour and part else part)
    for text in (f"[{unit}]" * bool(unit), f"{_MARK} " * bool(readings) + ", ".join(one.name for one in readings)):
        if left >= len(text):
            parts.append(text)
            left -= len(text) + 2
    return "  ".join(filter(None, parts))


def _panel(
    points: Sequence[tuple[Array, Array]],
    readings: Sequence[tuple[float, float]],
    xs: Array,
    x_label: str,
    width: int,
    height: int,
    colour: bool,
) -> list[str]:
    """The lines of a panel. `xs` are the x values of all panels, which share the axis; one panel has its label."""
    import plotext

    plotext.clear_figure()
    plotext.theme("clear")
    plotext.limit_size(False, False)
    plotext.plot_size(width, height)
    for number, (times, values) in enumerate(points):
        drawn = np.isfinite(values)
        more: dict[str, Any] = {"color": _PENS[number % len(_PENS)][0]} if colour else {}
        if len(points) > 1 and not colour:
            more["marker"] = _LETTERS[number % len(_LETTERS)]
        for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(drawn)) + 1):
            if len(part) and drawn[part[0]]:
                plotext.plot(times[part].tolist(), values[part].tolist(), **more)
    if readings:
        plotext.scatter(*map(list, zip(*readings, strict=True)), marker=_MARK)
    ys = np.concatenate([values[np.isfinite(values)] for _, values in points])
    for axis, column, count in (("x", xs, width // 16), ("y", ys, height // 3)):
        if len(column):
            ends, ticks, texts = _ticks(column, max(3, count))
            getattr(plotext, f"{axis}lim")(*ends)
            getattr(plotext, f"{axis}ticks")(ticks, texts)
    if x_label and width > 2 * len(x_label):
        plotext.xlabel(x_label)
    text = plotext.build()
    return str(text if colour else plotext.uncolorize(text)).rstrip("\n").splitlines()


def _ticks(values: Array, count: int) -> tuple[tuple[float, float], list[float], list[str]]:
    """The ends of an axis, about `count` round ticks between them, and their texts."""
    low, high = float(values.min()), float(values.max())
    size = max(abs(low), abs(high))
    if high - low <= 1e-9 * size:  # differences are only rounding errors
        low, high = low - (0.1 * size or 1.0), high + (0.1 * size or 1.0)
        size = max(abs(low), abs(high))
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    distance = min((factor * power for factor in _TICKS), key=lambda distance: abs(math.log(distance / rough)))
    slack = 1e-6  # a value that is on a tick but for rounding has this tick
    first, last = math.ceil(low / distance - slack), math.floor(high / distance + slack)
    ticks = [min(max(low, number * distance), high) for number in range(first, last + 1)]
    if distance >= 1e-4 and size < 1e6:
        places = len(f"{distance:g}".partition(".")[2])
        return (low, high), ticks, [f"{tick:z.{places}f}" for tick in ticks]
    digits = 2 + math.ceil(math.log10(size / distance))
    return (low, high), ticks, [f"{tick:.{digits}g}" for tick in ticks]


# --- files ------------------------------------------------------------------------------------------------------------


def check_file(path: str) -> None:
    """Check that a plot can be written to the file. Raises UsageError: unknown format. MissingPlotLibrary."""
    suffix = file_kind(path)
    if suffix not in FORMATS:
        raise UsageError(f"{path} is no file of a plot", f"its name ends in one of: {', '.join(FORMATS)}")
    if suffix != ".csv":
        try:
            import matplotlib.figure  # noqa: F401
        except ImportError:
            raise MissingPlotLibrary("matplotlib", f"a plot as {suffix}") from None


def as_file(plot: Plot, suffix: str, size: tuple[int, int] | None = None) -> bytes:
    """The content of a file of one of FORMATS. `size` is in pixels of 1/100 inch."""
    if suffix == ".csv":
        return _csv(plot).encode()
    if suffix == ".html":
        drawing = _drawn(plot, "svg", size).decode()
        return (
            f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{html.escape(plot.title)}</title>'
            "<style>body{margin:1em;text-align:center}svg{max-width:100%;height:auto}</style></head>\n"
            f"<body>\n{drawing[drawing.index('<svg') :]}</body>\n</html>\n"
        ).encode()
    return _drawn(plot, suffix.removeprefix("."), size)


def _drawn(plot: Plot, form: str, size: tuple[int, int] | None) -> bytes:
    from matplotlib import style
    from matplotlib.figure import Figure

    rows = plot.rows()
    width, height = size or (960, 200 + 240 * len(rows))
    # SVG text stays text. For reproducible bytes, ids are derived from the content, and there is no date.
    settings = {"svg.fonttype": "none", "svg.hashsalt": "slidectl", "axes.grid": True, "grid.alpha": 0.3}
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}
    with style.context(["default", settings]):
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, layout="constrained")
        figure.suptitle("\n".join([plot.title, *plot.notes]), fontsize="medium", parse_math=False)
        number = 0
        axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (y_label, curves) in zip(axes, rows, strict=True):
            for label, curve in curves:
                _draw_curve(axis, plot, label, curve, f"curve{number}")
                number += 1
            if axis is axes[0]:
                _draw_readings(axis, plot)
            axis.set_ylabel(y_label, parse_math=False)
            _draw_legend(axis, width, height / len(rows))
        axes[-1].set_xlabel(plot.x_label, parse_math=False)
        buffer = io.BytesIO()
        figure.savefig(buffer, format=form, metadata=dates[form])
    return buffer.getvalue()


def _draw_curve(axis: Any, plot: Plot, label: str, curve: Curve, gid: str) -> None:
    """A line; of a banded curve that chatters, the line is the mean of each part, and a band has all values."""
    times, values = curve.points(plot.begin)
    parts = list(chatter(values)) if curve.is_banded else []
    if not any(chatters for _, chatters in parts):
        times, values = plot.points(curve, _BUCKETS)
        alone = {"marker": "."} if len(times) == 1 else {}
        axis.plot(times, values, label=label, gid=gid, linewidth=1.2, **alone)
        return
    # Times, means, lowest and highest values: two of each part that chatters, and all samples of the others.
    columns: list[tuple[float, float, float, float]] = []
    for part, chatters in parts:
        here, now = values[part], times[part] - plot.origin
        if chatters:
            columns += [(moment, here.mean(), here.min(), here.max()) for moment in (now[0], now[-1])]
        else:
            columns += [(moment, value, math.nan, math.nan) for moment, value in zip(now, here, strict=True)]
    now, means, lows, highs = np.array(columns).T
    (line,) = axis.plot(now, means, label=f"{label}: mean", gid=gid, linewidth=1.2)
    shown = {"label": "where it chatters", "color": line.get_color(), "alpha": 0.3, "linewidth": 0}
    axis.fill_between(now, lows, highs, **shown)


def _draw_readings(axis: Any, plot: Plot) -> None:
    """The points at which measures are read, and the tolerance around the end of a step."""
    if plot.tolerance is not None:
        low, high, label = plot.tolerance
        axis.axhspan(low, high, color="grey", alpha=0.25, linewidth=0, label=label)
    if plot.readings:
        axis.margins(y=0.15)  # room for the texts
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    ends_low = plot.tolerance is not None and sum(plot.tolerance[:2]) < bottom + top
    for number, one in enumerate(plot.readings):
        time = one.time - plot.origin
        is_left = time < left + 0.6 * (right - left)
        axis.plot(time, one.value, "o", color="black", markersize=4)
        axis.axvline(time, color="black", linewidth=0.8, linestyle=":", alpha=0.6)
        # Each text has a height of its own, from the edge on to which the curve does not lead: none is over another.
        height = 0.05 + 0.12 * number
        axis.annotate(
            one.text, (time, 1.0 - height if ends_low else height), xycoords=("data", "axes fraction"),
            xytext=(5 if is_left else -5, 0), textcoords="offset points", ha="left" if is_left else "right",
            va="top" if ends_low else "bottom", fontsize="small", parse_math=False,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip


def _draw_legend(axis: Any, width: int, height: float) -> None:
    """Draw the legend above a panel of this size (pixels); over the curves only where there is no room for it."""
    labels = axis.get_legend_handles_labels()[1]
    if not labels:  # matplotlib leaves out those that begin with _
        return
    columns = max(1, width // (_LETTER * (max(map(len, labels)) + _SAMPLE)))
    columns = min(columns, len(labels))
    if math.ceil(len(labels) / columns) * _LEGEND_ROW < height / 2:
        place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": columns, "frameon": False}
    else:
        place = {"loc": "best"}
    for text in axis.legend(fontsize="small", **place).get_texts():
        text.set_parse_math(False)


def _csv(plot: Plot) -> str:
    """CSV as of `echo -p`: `%time` in ns, then one column per curve; empty without a sample at that time."""
    import csv

    points = [curve.points(plot.begin) for curve in plot.curves]
    moments = [np.round(times * _NANOSECONDS).astype(np.int64) for times, _ in points]
    every = np.unique(np.concatenate(moments))
    columns: list[list[str]] = []
    for (_, values), own in zip(points, moments, strict=True):
        cells = [""] * len(every)
        for place, value in zip(np.searchsorted(every, own).tolist(), values.tolist(), strict=True):
            cells[place] = repr(value)
        columns.append(cells)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["%time", *(curve.name for curve in plot.curves)])
    writer.writerows(zip(every.tolist(), *columns, strict=True))
    return buffer.getvalue()
