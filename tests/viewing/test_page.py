"""The page as a process: what browsers see of the world, and what they change in it. They speak viser's protocol."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page
from websockets.exceptions import InvalidStatus

LINK = "/robots/slider/link2"


def test_the_robot_is_where_the_simulation_has_it(world: CommandLine, browser: PageBrowser) -> None:
    browser.wait_for(lambda: "position" in browser.nodes.get(LINK, {}))
    before = browser.nodes[LINK]["position"][2]
    assert any(name.startswith(f"{LINK}/surface") for name in browser.nodes)
    with world.client() as client:
        client.publish("/slider/joint1_position_controller/command", {"data": 1.0})
        client.step(seconds=5)
    browser.wait_for(lambda: browser.nodes[LINK]["position"][2] > before + 0.3)


def test_pause_step_and_reset(world: CommandLine, browser: PageBrowser) -> None:
    with world.client() as client:

        def status(key: str) -> object:
            return client.call("/slidectl/status")[key]

        cycles = status("cycles")
        browser.set("cycles of a step", 7)
        browser.click("Step")
        browser.wait_for(lambda: status("cycles") == cycles + 7)
        browser.trigger("Step")
        browser.wait_for(lambda: status("cycles") == cycles + 14)
        browser.trigger("Pause or resume")
        browser.wait_for(lambda: not status("paused"))
        browser.wait_for(lambda: browser.find("Pause (space)"))
        browser.click("Pause (space)")
        browser.wait_for(lambda: status("paused"))
        browser.set("reset", "robots and time", "ButtonGroup")
        browser.wait_for(lambda: status("time") == 0)


def test_many_steps_hold_up_nobody_and_end_with_a_pause(world: CommandLine, browser: PageBrowser) -> None:
    with world.client() as client:
        browser.set("cycles of a step", 1_000_000)
        browser.click("Step")
        before = client.call("/slidectl/status")["cycles"]
        browser.wait_for(lambda: client.call("/slidectl/status")["cycles"] > before)
        browser.click("Step")
        browser.wait_for(lambda: any("the world is stepping" in told for told in browser.notifications))
        browser.trigger("Pause or resume")
        browser.wait_for(lambda: any("of 1000000 cycles" in told for told in browser.notifications))
        assert client.call("/slidectl/status")["paused"]
        browser.set("cycles of a step", 7)


def test_a_snapshot_is_loaded_twice_and_the_speed_is_that_of_the_world(
    world: CommandLine, browser: PageBrowser
) -> None:
    with world.client() as client:
        at = client.save("twice")
        for _ in range(2):
            client.step(3)
            browser.wait_for(lambda: "twice" in browser.element("load", "Dropdown")["options"])
            browser.set("load", "twice", "Dropdown")
            browser.wait_for(lambda: client.call("/slidectl/status")["time"] == at)
            browser.wait_for(lambda: browser.element("load", "Dropdown")["value"] == "none")
        for speed, shown in ((3.5, "3.5"), (0.0, "max"), (1.0, "1")):
            client.call("/slidectl/set_speed", {"speed": speed})
            browser.wait_for(lambda shown=shown: browser.element("speed", "Dropdown")["value"] == shown)


def test_two_browsers_see_the_same_and_a_robot_comes_and_goes(
    world: CommandLine, page: str, browser: PageBrowser
) -> None:
    with PageBrowser(page) as other:
        world.ok("spawn", "rrbot", "--name", "second")
        for one in (browser, other):
            one.wait_for(lambda one=one: "/robots/second/link3" in one.nodes)
        world.ok("delete", "second")
        for one in (browser, other):
            one.wait_for(lambda one=one: "/robots/second/link3" not in one.nodes)


def test_what_is_refused_is_told(browser: PageBrowser) -> None:
    browser.set("snapshot", "no/name")
    browser.click("Save")
    browser.wait_for(lambda: any("no/name" in told for told in browser.notifications))
    browser.set("snapshot", "here")


def test_the_page_waits_for_a_daemon_that_has_gone() -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        command.ok("spawn", "slider")
        with served_page(command) as url, PageBrowser(url) as browser:
            browser.wait_for(lambda: LINK in browser.nodes)
            command.ok("daemon", "stop")
            browser.element("the daemon has gone")
            browser.wait_for(lambda: LINK not in browser.nodes)
            command.ok("daemon", "start", "--paused")
            command.ok("spawn", "slider")
            browser.wait_for(lambda: LINK in browser.nodes)
            browser.click("Step")
            with command.client() as client:
                browser.wait_for(lambda: client.call("/slidectl/status")["cycles"] == 1)


def test_a_page_that_only_looks_changes_nothing(world: CommandLine) -> None:
    with served_page(world, "--read-only") as url, PageBrowser(url) as browser, world.client() as client:
        browser.wait_for(lambda: LINK in browser.nodes)
        cycles = client.call("/slidectl/status")["cycles"]
        _, step = browser.wait_for(lambda: browser.find("Step", "Button"))
        assert step["disabled"]
        assert browser.find("Pause or resume") is None
        step["disabled"] = False
        browser.click("Step")  # by force
        browser.set("frames of links", True)
        browser.wait_for(lambda: browser.nodes.get(f"{LINK}/name", {}).get("visible"))
        assert client.call("/slidectl/status")["cycles"] == cycles


@pytest.mark.parametrize(
    ("more", "headers", "told"),
    [
        ("", {}, "a token is needed"),
        ("?token=wrong-token", {}, "the token is wrong"),
        ("?token=open-sesame", {"Origin": "http://elsewhere.example"}, "may not use this one"),
    ],
)
def test_who_has_no_token_or_comes_from_elsewhere_is_kept_out(
    token_page: str, more: str, headers: dict[str, str], told: str
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        PageBrowser(token_page.partition("?")[0] + more, additional_headers=headers)
    assert refused.value.response.status_code == 403
    assert told in refused.value.response.body.decode()


@pytest.fixture(scope="module")
def token_page(world: CommandLine) -> Iterator[str]:
    with served_page(world, "--token", "open-sesame") as url:
        yield url


def test_the_address_with_the_token_opens_the_page(token_page: str) -> None:
    address, _, query = token_page.partition("?")
    assert query == "token=open-sesame"
    with pytest.raises(InvalidStatus) as found:
        PageBrowser(token_page)
    assert found.value.response.status_code == 302
    cookie = found.value.response.headers["Set-Cookie"].partition(";")[0]
    with PageBrowser(address, additional_headers={"Cookie": cookie, "Origin": address.rstrip("/")}) as browser:
        browser.element("Step", "Button")


def test_a_foreign_page_may_not_use_one_without_a_token(page: str) -> None:
    foreign = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "image"}
    for headers in ({"Origin": "http://elsewhere.example"}, {"Host": "rebound.example"}, foreign):
        with pytest.raises(InvalidStatus):
            PageBrowser(page, additional_headers=headers)


def test_a_port_that_is_taken_and_a_host_that_is_open(world: CommandLine, page: str) -> None:
    port = page.rstrip("/").rpartition(":")[2]
    process = subprocess.Popen(
        world.argv("view", "--no-open", "--port", port), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=world.environment,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline().strip() != page
    process.send_signal(signal.SIGINT)
    assert f"port {port} is taken" in process.communicate(timeout=60)[1]
    refused = world("view", "--no-open", "--host", "0.0.0.0")
    assert refused.returncode == 2
    assert "--token WORD is needed" in refused.stderr
    assert world("view", "--no-open", "--host", "no.such.host.example").returncode == 1


def test_without_the_library_one_line_says_what_to_install(world: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "viser.py").write_text("raise ModuleNotFoundError('no', name='viser')\n", "utf-8")
    done = world("view", "--no-open", PYTHONPATH=f"{tmp_path}:{world.environment['PYTHONPATH']}")
    assert done.returncode == 1
    assert "[view]'" in done.stderr


def test_a_push_lasts_as_long_as_the_mouse_is_held(page: str, world: CommandLine) -> None:
    world.ok("spawn", "car", "--at", "0", "3", "0")
    try:
        with PageBrowser(page) as browser, world.client() as client:

            def x() -> float:
                return float(client.call("/gazebo/get_model_state", {"model_name": "car"})["pose"]["position"]["x"])

            mesh = browser.wait_for(lambda: next((name for name in browser.nodes if name.startswith("/robots/car/")
                                                  and "surface" in name), None))  # fmt: skip
            before = x()
            browser.drag(mesh, "start", (0.0, 3.0, 0.1), (2.0, 3.0, 0.1))
            browser.wait_for(lambda: client.step(100) and x() > before + 0.5)  # it is held, and does not move
            browser.drag(mesh, "end", (0.0, 3.0, 0.1), (2.0, 3.0, 0.1))
            browser.wait_for(lambda: "/push" not in browser.nodes)
    finally:
        world.ok("delete", "car")
