"""The page's plots: curves of topics in the browser, kept over reloads and restarts, and saved as CSV."""

from __future__ import annotations

import math
import urllib.request
from collections.abc import Iterator
from typing import Any

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page, spawn_slider

STATE = "joint1_position_controller/state"


@pytest.fixture
def page(world: CommandLine) -> Iterator[str]:
    with served_page(world) as url:
        yield url


class Plotter(PageBrowser):
    """A browser that looks at plots."""

    def charts(self) -> list[dict[str, Any]]:
        return [one for one in self.elements.values() if one["type"] == "GuiUplotMessage" and "data" in one]

    def curve(self, label: str) -> list[tuple[float, float | None]]:
        """Times and values of the newest curve of a legend; nothing before it is drawn."""
        for chart in reversed(self.charts()):
            labels = [one.get("label") for one in chart["series"]]
            if label in labels and isinstance(chart["data"], list) and isinstance(chart["data"][0], list):
                return list(zip(chart["data"][0], chart["data"][labels.index(label)], strict=True))
        return []

    def plot(self, field: str, into: str = "new plot") -> None:
        self.set("plot field", field)
        self.set("into plot", into)
        self.click("Plot")


def moved(world: CommandLine, target: float) -> None:
    with world.client() as client:
        client.publish("/slider/joint1_position_controller/command", {"data": target})
        client.step(seconds=2)


def is_heard(world: CommandLine, topic: str) -> bool:
    """Whether the page subscribes it: of what is published before in a paused world nothing is drawn."""
    with world.client() as client:
        return bool(client.call("/rosapi/subscribers", {"topic": topic})["subscribers"])


def spanned(points: list[tuple[float, float | None]]) -> float:
    return points[-1][0] - points[0][0] if points else 0.0


def test_several_curves_move_with_the_joint_and_are_saved(world: CommandLine, page: str) -> None:
    with Plotter(page) as browser, Plotter(page) as other:
        browser.plot(STATE + "/{set_point,process_value}")
        browser.element("the simulation is paused", "Html")
        browser.wait_for(lambda: is_heard(world, f"/slider/{STATE}"))
        moved(world, 0.7)
        for one in (browser, other):
            one.wait_for(lambda one=one: spanned(one.curve("set_point")) > 1.9)
            assert one.curve("set_point")[-1][1] == 0.7
        times = [time for time, _ in browser.curve("process_value")]
        assert times == sorted(times)
        assert len(times) <= 1000
        browser.plot("joint_states/velocity[0]", into="plot 1")
        label = "velocity[0] (joint1)"

        def is_drawn() -> bool:
            moved(world, 0.4)
            return bool(browser.curve(label))

        browser.wait_for(is_drawn)
        browser.set("plot 1", "CSV", "ButtonGroup")
        browser.wait_for(lambda: "plot1.csv" in browser.downloads)
        assert "plot1.csv" not in other.downloads
        header, *rows = browser.downloads["plot1.csv"].decode().splitlines()
        name = "/slider/joint1_position_controller/state"
        assert header == f"%time,{name}/set_point,{name}/process_value,/slider/joint_states/velocity[0]"
        assert rows[-1].split(",")[1] == "0.4"
        browser.set("plot 1", "Remove", "ButtonGroup")
        browser.wait_for(lambda: not browser.charts())


def test_a_plot_is_paused_and_what_is_older_than_its_window_is_left_out(world: CommandLine, page: str) -> None:
    with Plotter(page) as browser:
        browser.plot(f"{STATE}/set_point")
        browser.wait_for(lambda: is_heard(world, f"/slider/{STATE}"))
        moved(world, 0.3)
        browser.wait_for(lambda: browser.curve("set_point")[-1:] and browser.curve("set_point")[-1][1] == 0.3)
        browser.set("plot 1", "Pause", "ButtonGroup")
        browser.element("plot 1 (paused)")
        moved(world, 0.6)
        with Plotter(page) as other:  # who comes later sees what is frozen
            other.wait_for(lambda: other.curve("set_point"))
            assert other.curve("set_point")[-1][1] == 0.3
        browser.set("plot 1", "Pause", "ButtonGroup")
        browser.wait_for(lambda: browser.curve("set_point")[-1][1] == 0.6)
        browser.set("plot seconds", 1)
        browser.wait_for(lambda: spanned(browser.curve("set_point")) <= 1.0)


def test_what_is_no_number_is_a_gap(world: CommandLine, page: str) -> None:
    with Plotter(page) as browser, world.client() as client:
        client.advertise("/level", "std_msgs/Float64")
        client.flush()
        browser.plot("level/data")
        browser.wait_for(lambda: is_heard(world, "/level"))
        for value in (1.0, math.nan, 2.0):
            client.publish("/level", {"data": value})
            client.step(1)
        browser.wait_for(lambda: [value for _, value in browser.curve("data")] == [1.0, None, 2.0])


def test_fields_that_are_not_there_are_told_with_the_closest(page: str) -> None:
    with Plotter(page) as browser:
        browser.plot(f"{STATE}/set_pint")
        browser.wait_for(lambda: any("set_point" in told for told in browser.notifications))
        browser.plot("joint_states/name")
        browser.wait_for(lambda: any("which is no number" in told for told in browser.notifications))
        browser.plot("joint_states/position[7]")
        browser.wait_for(lambda: browser.find("plot 1", "ButtonGroup"))
        assert not browser.find("plot 2", "ButtonGroup")


def test_a_link_opens_with_a_plot_which_outlives_the_daemon() -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        spawn_slider(command)
        with served_page(command, "--read-only") as url:
            link = f"{url}?plot={STATE}/set_point&plot=joint_states/no_field"
            for _ in range(2):  # a reload makes no other plot
                with urllib.request.urlopen(link) as answer:
                    assert answer.status == 200
            with Plotter(url) as browser:
                browser.element("no field 'no_field'", "Html")
                assert not browser.find("plot 2", "ButtonGroup")
                browser.wait_for(lambda: is_heard(command, f"/slider/{STATE}"))
                moved(command, 0.2)
                browser.wait_for(lambda: browser.curve("set_point"))
                command.ok("daemon", "stop")
                browser.wait_for(lambda: not browser.charts())
                command.ok("daemon", "start", "--paused")
                browser.element("no topic", "Html")
                spawn_slider(command)
                browser.wait_for(lambda: browser.find("no field 'no_field'", "Html"))
                browser.wait_for(lambda: is_heard(command, f"/slider/{STATE}"))
                moved(command, 0.5)
                browser.wait_for(lambda: browser.curve("set_point")[-1:] and browser.curve("set_point")[-1][1] == 0.5)
