"""The messages that the page makes of the texts of a form: once, at a rate, and for services."""

from __future__ import annotations

import math
from typing import Any

import pytest
from page_browser import CommandLine, PageBrowser, served_page
from waiting import eventually

COMMAND = "/slider/joint1_position_controller/command"


def test_texts_become_the_message_that_slidectl_pub_makes(world: CommandLine, browser: PageBrowser) -> None:
    assert browser.page("fill", topic=COMMAND, texts={"data": "pi / 8"})["message"] == {"data": math.pi / 8}
    for text, told in (("sin(t", "not a valid expression"), ("[1, 2]", "must be"), ("{", "not valid YAML"),
                       ("len([a for a in range(300) for b in range(300)])", "takes more than")):  # fmt: skip
        assert told in browser.refusal("fill", topic=COMMAND, texts={"data": text})
    assert "has no field" in browser.refusal("fill", topic=COMMAND, texts={"no_field": "1"})
    with world.client() as client:
        client.advertise("/wanted", "trajectory_msgs/JointTrajectoryPoint")
        client.advertise("/twist", "geometry_msgs/TwistStamped")
        client.flush()
        texts = {"positions": "[1, sqrt(4)]", "velocities": "[]", "time_from_start": "{secs: 3, nsecs: 0}"}
        point = browser.page("fill", topic="/wanted", texts=texts)["message"]
        assert (point["positions"], point["velocities"]) == ([1.0, 2.0], [])
        assert point["time_from_start"] == {"secs": 3, "nsecs": 0}
        texts = {"header.stamp": "now", "header.frame_id": "12", "twist.angular.z": "-.5", "twist.linear.x": ""}
        twist = browser.page("fill", topic="/twist", texts=texts)["message"]
        assert twist["header"]["frame_id"] == "12"  # text stays text
        assert twist["header"]["stamp"] == client.call("/rosapi/get_time")["time"]
        assert twist["twist"]["angular"] == {"z": -0.5}


def test_a_request_of_a_service_is_made_of_texts(browser: PageBrowser) -> None:
    service = "/slider/controller_manager/switch_controller"
    texts = {"stop_controllers": "[joint1_position_controller]", "strictness": "2", "start_asap": True}
    request = browser.page("fill", service=service, texts=texts)["message"]
    assert (request["stop_controllers"], request["strictness"]) == (["joint1_position_controller"], 2)
    assert request["start_asap"] is True
    assert "no name 'much'" in browser.refusal("fill", service=service, texts={"strictness": "much"})


def test_an_expression_is_published_at_a_rate_of_simulated_time_until_it_is_stopped(world: CommandLine) -> None:
    came: list[tuple[float, float]] = []

    def take(published: dict[str, Any]) -> None:
        came.append((published["time"]["secs"] + 1e-9 * published["time"]["nsecs"], published["msg"]["data"]))

    def published(browser: PageBrowser) -> int:
        return sum(one["published"] for one in browser.page("state")["publications"])

    form = {"topic": COMMAND, "texts": {"data": "0.1 * sin(2 * pi * t) + i"}, "rate": 4}
    with served_page(world) as url, world.client() as client, client.subscribe(COMMAND, take=take):
        with PageBrowser(url) as browser:
            browser.page("publish", **form)
            browser.wait_for(lambda: published(browser) == 1)
            begin = client.step(seconds=1)  # of 0, 0.25, 0.5, 0.75 and 1
            browser.wait_for(lambda: published(browser) == 5)
            client.flush()
            assert [time for time, _ in came] == pytest.approx([begin - 1 + i / 4 for i in range(5)], abs=1e-9)
            assert [data for _, data in came] == [0.1 * math.sin(2 * math.pi * (i / 4)) + i for i in range(5)]
        goes_on_until = begin + 12  # nobody has the page open, and what was handed over before ends after 5 s
        eventually(lambda: client.step(seconds=1) and came[-1][0] > goes_on_until)
        with PageBrowser(url) as browser:
            browser.page("stop_publishing", topic=COMMAND)
            assert browser.page("state")["publications"] == []
            client.flush()
            count = len(came)
            client.step(seconds=1)
            assert len(came) == count
            browser.page("publish", **form)
            browser.wait_for(lambda: published(browser) == 1)
            world.ok("sim", "reset", "--time")  # i and t begin anew with the time
            browser.wait_for(lambda: published(browser) == 2)
            client.flush()
            assert came[-1] == (0.0, 0.0)
            for rate in (0, -1, 1e9, "often"):
                assert browser.refusal("publish", **{**form, "rate": rate})
    client_left = len(came)
    with world.client() as client, client.subscribe(COMMAND, take=take):
        client.step(seconds=1)  # the page has ended, and what it handed over with it
        assert len(came) == client_left


def test_an_expression_that_cannot_be_computed_ends_the_publishing(browser: PageBrowser) -> None:
    browser.page("publish", topic=COMMAND, texts={"data": "1 / (2 - i)"}, rate=10)
    browser.wait_for(lambda: any("is no longer published: cannot compute" in told for told in browser.told))
    assert browser.page("state")["publications"] == []
