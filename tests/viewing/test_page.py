"""The page as a process: what browsers see of the world, and what they change in it. They speak viser's protocol."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page
from waiting import eventually
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

LINK = "/robots/slider/link2"


def test_the_robot_is_where_the_simulation_has_it(world: CommandLine, browser: PageBrowser) -> None:
    browser.wait_for(lambda: "position" in browser.nodes.get(LINK, {}))
    before = browser.nodes[LINK]["position"][2]
    assert any(name.startswith(f"{LINK}/surface") for name in browser.nodes)
    with world.client() as client:
        client.publish("/slider/joint1_position_controller/command", {"data": 1.0})
        client.step(seconds=5)
    browser.wait_for(lambda: browser.nodes[LINK]["position"][2] > before + 0.3)


def test_the_panels_are_a_client_of_the_daemon_on_the_port_of_the_page(
    world: CommandLine, browser: PageBrowser
) -> None:
    with world.client() as client:
        cycles = client.call("/slidectl/status")["cycles"]
        assert browser.call("/slidectl/step", cycles=7)["cycles"] == cycles + 7
        assert "no service" in browser.ask("/no/such/service")["values"]
        assert browser.page("state")["read_only"] is False
        assert "service of the page" in browser.refusal("no_such_service")
        assert "is not valid" in browser.refusal("camera")
        assert "view" in browser.refusal("camera", view="under")


def test_the_view_shows_what_was_chosen_in_all_browsers(page: str, browser: PageBrowser) -> None:
    with PageBrowser(page) as other:
        browser.page("view", frames=True)
        for one in (browser, other):
            one.wait_for(lambda one=one: one.nodes.get("/labels/slider.link2", {}).get("visible"))
        browser.page("view", frames=False, trace="slider::link2")
        other.wait_for(lambda: "/labels/slider.link2" not in other.nodes)
        assert other.page("state")["view"]["trace"] == "slider::link2"
        browser.page("view", trace="", collisions=True)
        browser.page("view", collisions=False)
        assert "no link" in browser.refusal("view", trace="slider::no_link")
        assert "option of the view" in browser.refusal("view", colour=True)


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


def test_the_page_waits_for_a_daemon_that_has_gone() -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        command.ok("spawn", "slider")
        with served_page(command) as url, PageBrowser(url) as browser:
            browser.wait_for(lambda: LINK in browser.nodes)
            command.ok("daemon", "stop")
            browser.wait_for(lambda: LINK not in browser.nodes)
            command.ok("daemon", "start", "--paused")
            command.ok("spawn", "slider")
            browser.wait_for(lambda: LINK in browser.nodes)
            with PageBrowser(url) as again, command.client() as client:
                again.call("/slidectl/step", cycles=1)
                assert client.call("/slidectl/status")["cycles"] == 1


def test_a_page_that_only_looks_changes_nothing(world: CommandLine) -> None:
    with served_page(world, "--read-only") as url, PageBrowser(url) as browser, world.client() as client:
        browser.wait_for(lambda: LINK in browser.nodes)
        cycles = client.call("/slidectl/status")["cycles"]
        assert browser.page("state")["read_only"]
        assert browser.ask("/slidectl/step", {"cycles": 1})["result"] is False
        twist = {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
        for what, args in (
            ("drive", {"topic": "/cmd_vel", "twist": twist}), ("record", {"file": "run.bag"}),
            ("publish", {"topic": "/clock", "texts": {}, "rate": 1}), ("place", {"robot": "slider"}),
        ):  # fmt: skip
            assert "this page is read-only" in browser.refusal(what, **args)
        browser.page("view", frames=True)
        browser.wait_for(lambda: browser.nodes.get("/labels/slider.link2", {}).get("visible"))
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
    address = token_page.partition("?")[0]
    for path in ("", "rosbridge"):
        with pytest.raises(InvalidStatus) as refused:
            connect(address.replace("http", "ws", 1) + path + more, additional_headers=headers)
        assert refused.value.response.status_code == 403
        assert told in refused.value.response.body.decode()
    with pytest.raises(HTTPError) as unseen:
        urlopen(Request(f"{address}slidectl/app.js{more}", headers=headers))
    assert unseen.value.code == 403


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
        assert browser.page("state")["view"]


def test_the_document_runs_no_script_but_its_own_and_its_modules_come_from_the_package(page: str) -> None:
    with urlopen(page) as answer:
        policy, text = answer.headers["Content-Security-Policy"], answer.read().decode()
        assert answer.headers["X-Frame-Options"] == "SAMEORIGIN"
    nonce = policy.partition("'nonce-")[2].partition("'")[0]
    assert len(nonce) >= 16
    assert text.count("<script") == text.count(f'nonce="{nonce}"', 0, text.index("data-p="))
    assert "default-src 'none'" in policy
    assert "'unsafe-inline'" not in policy.partition("script-src")[2].partition(";")[0]
    with urlopen(page) as answer:
        assert nonce not in answer.headers["Content-Security-Policy"]
    for name in ("app.js", "style.css", "vendor/uPlot.esm.js", "panels/plots.js"):
        with urlopen(f"{page}slidectl/{name}") as answer:
            assert answer.headers["X-Content-Type-Options"] == "nosniff"
    for name in ("", "no.js", "../page.py", "vendor/LICENSE.htm", "%2e%2e/page.py"):
        with pytest.raises(HTTPError) as missing:
            urlopen(f"{page}slidectl/{name}")
        assert missing.value.code == 404


def test_a_base_that_is_not_driven_any_more_stops(world: CommandLine, page: str) -> None:
    world.ok(
        "spawn", "car", "--at", "0", "3", "0", "--controllers", "config/car_control.yaml", "--start", "base_controller"
    )
    try:
        with world.client() as client, client.subscribe("/car/base_controller/cmd_vel") as twists:
            forwards = {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
            with PageBrowser(page) as browser:
                browser.page("drive", topic="/car/base_controller/cmd_vel", twist=forwards)
                assert twists.get(timeout=60)["linear"]["x"] == 1.0
            assert twists.get(timeout=60)["linear"]["x"] == 0.0  # the browser has gone without a word
    finally:
        world.ok("delete", "car")


def test_a_base_stands_when_the_page_ends() -> None:
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        command.ok(
            "spawn",
            "cart",
            "drive:=controller",
            "--controllers",
            "config/cart_control.yaml",
            "--start",
            "base_controller",
        )
        topic = "/cart/base_controller/cmd_vel"
        forwards = {"linear": {"x": 0.5, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
        with command.client() as client, client.subscribe(topic) as twists:

            def turns() -> bool:
                return max(map(abs, client.call("/slidectl/joint_states")["velocity"])) > 0.1

            with served_page(command) as url, PageBrowser(url) as browser:
                eventually(lambda: browser.page("drive", topic=topic, twist=forwards) is not None and turns())
                browser.page("drive", topic=topic, twist=forwards)
            eventually(lambda: twists.get(timeout=60)["linear"]["x"] == 0.0)
            eventually(lambda: not turns())


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

            def is_grasped() -> bool:  # the page takes the mouse a moment after it shows the mesh
                browser.drag(mesh, "start", (0.0, 3.0, 0.1), (2.0, 3.0, 0.1))
                return "/push" in browser.nodes

            browser.wait_for(is_grasped)
            browser.wait_for(lambda: client.step(100) and x() > before + 0.5)  # it is held, and does not move
            browser.drag(mesh, "end", (0.0, 3.0, 0.1), (2.0, 3.0, 0.1))
            browser.wait_for(lambda: "/push" not in browser.nodes)
    finally:
        world.ok("delete", "car")
