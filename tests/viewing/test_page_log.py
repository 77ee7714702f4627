"""The log on the page."""

from __future__ import annotations

from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page


def test_the_log_is_filtered_held_and_cleared() -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:

            def say(level: int, text: str) -> None:
                message = {"level": level, "name": "/talker", "msg": text}
                client.deliver("/rosout", message, "rosgraph_msgs/Log")

            browser.element("Clear the log", "Button")
            browser.wait_for(lambda: client.call("/rosapi/subscribers", {"topic": "/rosout"})["subscribers"])
            say(2, "first <b>words</b>")
            say(8, "second")
            shown = browser.element("talker: second", "Html")
            assert "info /talker: first &lt;b&gt;words&lt;/b&gt;" in shown["content"]
            assert shown["content"].index("first") < shown["content"].index("second")

            browser.set("severity from", "warn")
            browser.wait_for(lambda: browser.find("first &lt;b&gt;") is None)
            browser.element("talker: second")
            browser.set("severity from", "debug")
            browser.set("log contains", "FIRST")
            browser.wait_for(lambda: browser.find("talker: second") is None and browser.find("first &lt;b&gt;"))
            browser.set("log contains", "")

            browser.set("pause the log", True)
            say(4, "while it is held")
            browser.set("pause the log", False)
            browser.element("warn /talker: while it is held", "Html")
            browser.click("Clear the log")
            browser.wait_for(lambda: browser.find("while it is held") is None)
            for number in range(250):
                say(2, f"line {number}.")
            browser.element("line 249.", "Html")
            browser.wait_for(lambda: browser.find("line 50."))
            browser.wait_for(lambda: browser.find("line 49.") is None)
