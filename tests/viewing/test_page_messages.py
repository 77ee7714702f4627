"""The page's forms: messages that are published once and at a rate, and services that are called."""

from __future__ import annotations

import math
from typing import Any

import pytest
from page_browser import CommandLine, PageBrowser, served_page
from waiting import eventually

COMMAND = "/slider/joint1_position_controller/command"


def is_told(browser: PageBrowser, text: str) -> bool:
    browser.take()
    return any(text in told for told in browser.notifications)


def test_a_message_is_published_once(world: CommandLine, browser: PageBrowser) -> None:
    with world.client() as client, client.subscribe(COMMAND) as commands:
        browser.set("publish topic", COMMAND)
        browser.set("data", "pi / 8")
        browser.click("Publish once")
        assert commands.get(timeout=60)["data"] == math.pi / 8
        for text, told in (("sin(t", "not a valid expression"), ("[1, 2]", "must be"), ("{", "not valid YAML"),
                           ("len([a for a in range(300) for b in range(300)])", "takes more than")):  # fmt: skip
            browser.set("data", text)
            browser.click("Publish once")
            browser.wait_for(lambda told=told: is_told(browser, told))
        assert len(commands) == 0
        browser.set("data", "0.0")


def test_a_message_with_fields_inside_of_fields_and_a_topic_that_nobody_hears(
    world: CommandLine, browser: PageBrowser
) -> None:
    with world.client() as client:
        client.advertise("/wanted", "trajectory_msgs/JointTrajectoryPoint")
        client.advertise("/twist", "geometry_msgs/TwistStamped")
        client.flush()
        browser.wait_for(lambda: "/wanted" in browser.element("publish topic")["options"])
        browser.set("publish topic", "/wanted")
        browser.set("positions", "[1, sqrt(4)]")
        browser.set("time_from_start", "{secs: 3, nsecs: 0}")
        browser.click("Publish once")
        browser.wait_for(lambda: is_told(browser, "Nobody subscribes to /wanted"))
        with client.subscribe("/wanted") as points, client.subscribe("/twist") as twists:
            browser.click("Publish once")
            point = points.get(timeout=60)
            assert (point["positions"], point["velocities"]) == ([1.0, 2.0], [])
            assert point["time_from_start"] == {"secs": 3, "nsecs": 0}
            browser.set("publish topic", "/twist")
            browser.set("header.stamp", "now")
            browser.set("header.frame_id", "12")  # text stays text
            browser.set("twist.angular.z", "-.5")
            browser.click("Publish once")
            twist = twists.get(timeout=60)
            assert twist["header"]["frame_id"] == "12"
            assert twist["header"]["stamp"] == client.call("/rosapi/get_time")["time"]
            assert twist["twist"]["angular"] == {"x": 0.0, "y": 0.0, "z": -0.5}
        world.ok("sim", "step")


def test_an_expression_is_published_at_a_rate_of_simulated_time_until_it_is_stopped(world: CommandLine) -> None:
    came: list[tuple[float, float]] = []

    def take(published: dict[str, Any]) -> None:
        came.append((published["time"]["secs"] + 1e-9 * published["time"]["nsecs"], published["msg"]["data"]))

    with served_page(world) as url, world.client() as client, client.subscribe(COMMAND, take=take):
        with PageBrowser(url) as browser:
            browser.set("publish topic", COMMAND)
            browser.set("data", "0.1 * sin(2 * pi * t) + i")
            browser.set("Hz of simulated time", 4)
            browser.click("Publish at the rate")
            browser.element("1 published", "Html")
            begin = client.step(seconds=1)  # of 0, 0.25, 0.5, 0.75 and 1
            browser.element("5 published", "Html")
            client.flush()
            assert [time for time, _ in came] == pytest.approx([begin - 1 + i / 4 for i in range(5)], abs=1e-9)
            assert [data for _, data in came] == [0.1 * math.sin(2 * math.pi * (i / 4)) + i for i in range(5)]
        goes_on_until = begin + 12  # nobody has the page open, and what was handed over before ends after 5 s
        eventually(lambda: client.step(seconds=1) and came[-1][0] > goes_on_until)
        with PageBrowser(url) as browser:
            browser.click(f"Stop {COMMAND}")
            browser.wait_for(lambda: not browser.find(f"Stop {COMMAND}"))
            client.flush()
            count = len(came)
            client.step(seconds=1)
            assert len(came) == count
            browser.click("Publish at the rate")
            browser.element("1 published", "Html")
            world.ok("sim", "reset", "--time")  # i and t begin anew with the time
            browser.element("2 published", "Html")
            client.flush()
            assert came[-1] == (0.0, 0.0)
    client_left = len(came)
    with world.client() as client, client.subscribe(COMMAND, take=take):
        client.step(seconds=1)  # the page has ended, and what it handed over with it
        assert len(came) == client_left


def test_an_expression_that_cannot_be_computed_ends_the_publishing(browser: PageBrowser) -> None:
    browser.set("publish topic", COMMAND)
    browser.set("data", "1 / (2 - i)")
    browser.set("Hz of simulated time", 10)
    browser.click("Publish at the rate")
    browser.wait_for(lambda: is_told(browser, "is no longer published: cannot compute"))
    browser.wait_for(lambda: not browser.find(f"Stop {COMMAND}"))
    browser.set("data", "0.0")


def test_services_are_called_and_answer_as_yaml(world: CommandLine, browser: PageBrowser) -> None:
    manager = "/slider/controller_manager"
    browser.set("service", f"{manager}/switch_controller")
    browser.set("stop_controllers", "[joint1_position_controller]")
    browser.set("strictness", "2")
    browser.click("Call")
    with world.client() as client:
        browser.wait_for(lambda: client.step() and browser.find("ok: True", "Html"))
        assert client.controllers("/slider").states()["joint1_position_controller"] != "running"
        browser.set("strictness", "much")
        browser.click("Call")
        browser.wait_for(lambda: is_told(browser, "no name 'much'"))
        browser.set("service", f"{manager}/load_controller")
        browser.set("name", "no_such_controller")
        browser.click("Call")
        browser.element("ok: False", "Html")
        browser.element("# ", "Html")  # with the reasons
        browser.set("service", "/slidectl/sleep")
        browser.set("duration", "0.5")
        browser.click("Call")
        browser.element("calling ...", "Html")
        browser.set("service", f"{manager}/list_controllers")  # meanwhile the page goes on
        browser.element("controller_manager_msgs/ListControllers")
        client.step(seconds=1)
        browser.element("/slidectl/sleep\nsuccess: True", "Html")


def test_who_only_looks_publishes_and_calls_nothing(world: CommandLine) -> None:
    with served_page(world, "--read-only") as url, PageBrowser(url) as browser:
        browser.set("publish topic", COMMAND)
        for label in ("data", "Publish once", "Publish at the rate", "Call"):
            eventually(lambda: browser.element(label)["disabled"], f"{label} can be used")  # noqa: B023
