"""Fields of topics over the last seconds of simulated time, several per plot (rqt_plot)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any

import numpy as np
from viser import ClientHandle, GuiApi, GuiFolderHandle, GuiHtmlHandle, GuiUplotHandle, uplot

from slidectl.client import Client, Subscription
from slidectl.errors import NoDaemon, Refused, SlidectlError, UsageError, cut
from slidectl.extensions.viewing import plot_fields
from slidectl.extensions.viewing.page.page import Page, Panel, WorldState
from slidectl.extensions.viewing.plot_fields import TopicCurves
from slidectl.extensions.viewing.plots import Curve, Plot, as_file, thinned
from slidectl.msgs.schema import nanoseconds

_MOST_PLOTS = 8
_MOST_FIELDS = 16
"""Fields per plot."""
_MOST_POINTS = 1000
_LONGEST_S = 120.0
_QUEUE = 5000
_TRIM_EVERY = 1000
"""Messages between two removals of old samples, which also happen when no browser is connected."""
_LONGEST_NOTE = 600
_NONE, _NEW = "none", "new plot"
_PAUSE, _CSV, _REMOVE = "Pause", "CSV", "Remove"
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#17becf")


class PlotsPanel(Panel):
    """The plots, the same in all browsers. A plot waits for a missing topic."""

    title = "Plots"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._plots: dict[int, _LivePlot] = {}
        self._is_built = False
        self._field = ""
        self._into = _NEW
        self._seconds = 10.0
        self._known: list[str] = []

    def build(self, world: WorldState) -> None:
        gui, looking = self.gui, self.page.looking
        self._known = sorted(world.topics)
        self._topic = gui.add_dropdown("plot topic", (_NONE, *self._known))
        looking(self._topic, self._choose_topic)
        self._text: Any = gui.add_text("plot field", self._field, hint="TOPIC/FIELD[I]; an array is a curve a number")
        looking(self._text, partial(setattr, self, "_field"))
        self._into = self._into if self._into in self._targets() else _NEW
        self._target = gui.add_dropdown("into plot", self._targets(), initial_value=self._into)
        looking(self._target, partial(setattr, self, "_into"))
        looking(gui.add_button("Plot"), lambda _: self._plot())
        seconds = gui.add_number("plot seconds", self._seconds, min=1.0, max=_LONGEST_S, step=1.0)
        looking(seconds, self._choose_seconds)
        self._folder = gui.add_folder(None)
        self._is_built = True
        for number, plot in self._plots.items():
            self._show(number, plot)

    def leave(self) -> None:
        self._is_built = False
        for plot in self._plots.values():
            plot.leave()

    def opened(self, query: Mapping[str, Sequence[str]]) -> None:
        fields = list(dict.fromkeys(query.get("plot", ())))[:_MOST_FIELDS]
        if fields and not any(plot.fields == fields for plot in self._plots.values()):
            self._add(_LivePlot(fields))

    def refresh(self, world: WorldState) -> None:
        if (topics := sorted(world.topics)) != self._known:
            self._known = topics
            self._topic.options = (_NONE, *topics)
            for plot in self._plots.values():
                plot.follow(self.page.client)
        for plot in self._plots.values():
            plot.draw(self.gui, self._seconds, world.status["paused"])

    def _targets(self) -> tuple[str, ...]:
        return _NEW, *(f"plot {number}" for number in self._plots)

    def _choose_topic(self, topic: str) -> None:
        if topic != _NONE:
            self._field = self._text.value = topic

    def _choose_seconds(self, value: float) -> None:
        self._seconds = value
        for plot in self._plots.values():
            plot.is_drawn = False

    def _plot(self) -> None:
        """Plot the typed field. Raises UnknownName, AmbiguousName, Unused, UsageError."""
        field = self._field.strip()
        if not field:
            raise UsageError("no field to plot", "write one, as joint_states/position[0], or choose a topic")
        number = next((number for number in self._plots if self._into == f"plot {number}"), None)
        plot = _LivePlot([]) if number is None else self._plots[number]
        plot.add(self.page.client, field)
        if number is None:
            self._add(plot)

    def _add(self, plot: _LivePlot) -> None:
        free = next((number for number in range(1, _MOST_PLOTS + 1) if number not in self._plots), None)
        if free is None:
            plot.leave()
            raise Refused(f"there are {_MOST_PLOTS} plots, and there can be no more", "remove one")
        self._plots[free] = plot
        if self._is_built:
            self._target.options = self._targets()
            self._show(free, plot)

    def _show(self, number: int, plot: _LivePlot) -> None:
        plot.follow(self.page.client)
        with self._folder, self.gui.add_folder(f"plot {number}") as plot.folder:
            plot.note = self.gui.add_html("", order=0)
            buttons = self.gui.add_button_group(f"plot {number}", (_PAUSE, _CSV, _REMOVE), order=2)
        self.page.answering(buttons, partial(self._press, number))

    def _press(self, number: int, button: str, browser: ClientHandle) -> None:
        plot = self._plots.get(number)
        if plot is None:  # another browser has just removed it
            return
        if button == _CSV:
            contents = as_file(Plot("", plot.curves(self._seconds), "one"), ".csv")
            browser.send_file_download(f"plot{number}.csv", contents, save_immediately=True)
        elif button == _PAUSE:
            plot.frozen = plot.curves(self._seconds) if plot.frozen is None else None
            plot.folder.label = f"plot {number}" + (" (paused)" if plot.frozen is not None else "")
            plot.is_drawn = False
        elif button == _REMOVE:
            plot.leave()
            plot.folder.remove()
            del self._plots[number]
            self._target.options = self._targets()
            self._into = self._target.value


class _LivePlot:
    """Curves of live topics. Missing topics are looked up again at each `follow`."""

    folder: GuiFolderHandle
    note: GuiHtmlHandle

    def __init__(self, fields: list[str]) -> None:
        self.fields = fields
        self.frozen: list[Curve] | None = None
        """The curves shown while the plot is paused."""
        self.is_drawn = False
        self._followed: dict[str, list[TopicCurves]] = {}
        """Field -> its topics' curves."""
        self._subscriptions: list[Subscription] = []
        self._troubles: dict[str, str] = {}
        """Field -> why it has no curve."""
        self._end = 0.0
        self._taken = 0
        self._chart: GuiUplotHandle | None = None
        self._labels: list[str] = []

    def add(self, client: Client, field: str) -> None:
        """Subscribe a field. Raises as `plot_fields.of_live`, and Refused."""
        if field in self._followed:
            return
        if len({*self.fields, field}) > _MOST_FIELDS:
            raise Refused(f"a plot has at most {_MOST_FIELDS} fields", "take another plot")
        every = plot_fields.of_live(client, [field])
        for topic in every:
            take = partial(self._take, field, every)
            self._subscriptions.append(client.subscribe(topic, queue_length=_QUEUE, take=take))
        self._followed[field] = list(every.values())
        self._troubles.pop(field, None)
        if field not in self.fields:
            self.fields.append(field)

    def follow(self, client: Client) -> None:
        """Subscribe the fields that exist now. Raises NoDaemon."""
        for field in self.fields:
            try:
                self.add(client, field)
            except NoDaemon:
                raise
            except SlidectlError as error:
                self._troubles[field] = str(error)

    def leave(self) -> None:
        """End subscriptions; the elements are removed."""
        for subscription in self._subscriptions:
            subscription.close()
        self._subscriptions.clear()
        self._followed.clear()
        self._troubles.clear()
        self._chart = None
        self.is_drawn = False

    def _take(self, field: str, every: Mapping[str, TopicCurves], published: dict[str, Any]) -> None:
        """Take a message. It may be called during any call, so errors are stored instead of raised."""
        if field in self._troubles:
            return
        time_ns = nanoseconds(published["time"])
        try:
            plot_fields.take(every, published["topic"], time_ns, published["msg"])
        except SlidectlError as error:
            self._troubles[field] = str(error)
            return
        self._end = 1e-9 * time_ns
        self._taken += 1
        self.is_drawn = self.is_drawn and self.frozen is not None
        if self._taken % _TRIM_EVERY == 0:
            for followed in self._followed.values():
                for one in followed:
                    one.keep_since(self._end - _LONGEST_S)

    def curves(self, seconds: float) -> list[Curve]:
        """The last seconds of all curves, or the curves at the pause. Raises Refused: no message yet."""
        if self.frozen is not None:
            return self.frozen
        found = []
        for curve in (curve for every in self._followed.values() for one in every for curve in one.curves):
            times, values = curve.points()
            here = (times >= self._end - seconds) & (times <= self._end)  # another topic's time may have gone back
            found.append(replace(curve, times=times[here], values=values[here]))
        if not any(len(curve.times) for curve in found):
            raise Refused("no message has come yet")
        return found

    def draw(self, gui: GuiApi, seconds: float, is_paused: bool) -> None:
        """Show new samples."""
        text = self._told(is_paused)
        if text != self.note.content:
            self.note.content = text
        if self.is_drawn:
            return
        try:
            plot = Plot("", self.curves(seconds), "one")
        except Refused:
            return
        self.is_drawn = True
        labels, columns = _labels(plot.curves), _columns(plot.curves)
        if self._chart is None or labels != self._labels:
            if self._chart is not None:
                self._chart.remove()
            self._labels = labels
            colours = [_COLOURS[place % len(_COLOURS)] for place in range(len(labels))]
            series = [
                uplot.Series(label=label, stroke=colour, width=1.5)
                for label, colour in zip(labels, colours, strict=True)
            ]
            with self.folder:
                self._chart = gui.add_uplot(
                    tuple(np.array(column, dtype=np.float64) for column in columns),
                    ({"label": plot.x_label}, *series), scales={"x": {"time": False}},
                    axes=({}, {"label": plot.rows()[0][0]}), height=240, order=1,
                )  # fmt: skip
        # viser's types want arrays, but lists are needed: None becomes null, which uPlot draws as a gap.
        self._chart.data = columns  # type: ignore[assignment]

    def _told(self, is_paused: bool) -> str:
        lines = [cut(", ".join(self.fields), _LONGEST_NOTE)]
        lines += [cut(text, _LONGEST_NOTE) for text in self._troubles.values()]
        if not self._troubles and not any(one.curves for every in self._followed.values() for one in every):
            lines.append("no message has come yet" + (": the simulation is paused" if is_paused else ""))
        if dropped := sum(subscription.dropped for subscription in self._subscriptions):
            lines.append(f"{dropped} messages were lost: the reader is too slow")
        text = "<br>".join(escape(line, quote=False) for line in lines)
        return f'<div style="overflow-wrap: anywhere; font-size: 0.85em">{text}</div>'


def _labels(curves: Sequence[Curve]) -> list[str]:
    """The shortest distinct ends of the names, with the joints."""
    parts = [curve.name.split("/") for curve in curves]
    ends = (["/".join(one[-count:]) for one in parts] for count in range(1, max(map(len, parts)) + 1))
    chosen = next((names for names in ends if len(set(names)) == len(names)), [curve.name for curve in curves])
    joints = (f" ({curve.about})" if curve.about else "" for curve in curves)
    return [name + joint for name, joint in zip(chosen, joints, strict=True)]


def _columns(curves: Sequence[Curve]) -> list[list[float | None]]:
    """The times, then one column per curve; None is a gap. Thinning keeps the minimum and maximum of each interval.

    A curve without a sample at a time is interpolated linearly.
    """
    points = [(np.asarray(curve.times), np.asarray(curve.values)) for curve in curves]
    grid = np.unique(np.concatenate([times for times, _ in points]))
    columns = []
    for times, values in points:
        if not np.array_equal(times, grid):
            values = np.interp(grid, times, values, np.nan, np.nan) if len(times) else np.full(len(grid), np.nan)
        columns.append(np.where(np.isfinite(values), values, np.nan))
    drawn = thinned(max(1, _MOST_POINTS // (4 * len(columns))), *columns)
    return [[None if value != value else value for value in column[drawn].tolist()] for column in (grid, *columns)]
