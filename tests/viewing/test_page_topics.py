"""The topics on the page: who uses them, how often their messages come, and the last one."""

from __future__ import annotations

import re

from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page

STATES = "/slider/joint_states"


def test_topics_are_listed_and_those_that_are_chosen_are_monitored() -> None:
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        spawn = ("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller")
        command.ok(*spawn)
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:

            def row(topic: str) -> list[str]:
                """Type, publishers and subscribers."""
                found = browser.find(f">{topic}</td>", "Html")
                cells = re.search(rf">{topic}</td>(.*?)</tr>", found[1]["content"] if found else "")
                return re.findall(r">([^<>]*)</td>", cells[1]) if cells else []

            browser.wait_for(lambda: row(STATES))
            kind, publishers, subscribers = row(STATES)
            assert (kind, publishers) == ("sensor_msgs/JointState", "1")
            browser.set("monitor topic", STATES, "Dropdown")
            browser.element(f"Stop {STATES}")
            browser.set("topic contains", "joint_st")
            browser.wait_for(lambda: not row("/clock") and row(STATES)[2:] == [str(int(subscribers) + 1)])
            browser.set("topic contains", "")
            # Its rate is set to 50 Hz.
            browser.wait_for(lambda: browser.find("sensor_msgs/JointState: 50.0 Hz") and browser.find("name: [joint1]"))

            client.publish("/chatter", {"data": "before"}, "std_msgs/String")
            browser.wait_for(lambda: row("/chatter"))
            browser.set("monitor topic", "/chatter", "Dropdown")
            browser.element("std_msgs/String: no message yet")
            client.deliver("/chatter", {"data": "<b>hello</b> " + "x" * 1000})
            shown = browser.element("&lt;b&gt;hello", "Html")
            assert len(shown["content"]) < 1000

            command.ok("delete", "slider")
            browser.wait_for(lambda: not row(STATES))
            browser.element("no such topic now")
            command.ok(*spawn)
            browser.element("sensor_msgs/JointState: 50.0 Hz")
            browser.click(f"Stop {STATES}")
            browser.wait_for(lambda: browser.find(f"Stop {STATES}") is None)
            browser.click("Stop /chatter")
            browser.wait_for(lambda: browser.find("Stop /chatter") is None)
            assert not client.call("/rosapi/subscribers", {"topic": "/chatter"})["subscribers"]
