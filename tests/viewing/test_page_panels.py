"""The page's panels, operated in Chromium as a person does. The scene is not drawn here, which would take long."""

from __future__ import annotations

import math
import os
import re
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page, spawn_slider
from panels_tab import CHROMIUM, PanelsTab, chromium, eventually
from playwright.sync_api import Browser, expect

CONTROLLER = "/slider/joint1_position_controller"
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
expect.set_options(timeout=120_000)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium(draws=False) as one:
        yield one


@pytest.fixture
def tab(browser: Browser, page: str) -> Iterator[PanelsTab]:
    one = PanelsTab(browser, page)
    one.page.get_by_text("joint1_position_controller").first.wait_for()
    yield one
    one.close()


def test_time_is_stepped_resumed_paused_and_reset(world: CommandLine, tab: PanelsTab) -> None:
    with world.client() as client:

        def status(key: str) -> object:
            return client.call("/slidectl/status")[key]

        cycles = status("cycles")
        length = tab.page.get_by_label("Step length, cycles")
        length.fill("7")
        length.press("Enter")
        tab.button("Step (.)").click()
        eventually(lambda: status("cycles") == cycles + 7)
        tab.page.locator("body").press(".")
        eventually(lambda: status("cycles") == cycles + 14)
        tab.page.locator("body").press(" ")
        eventually(lambda: not status("paused"))
        tab.button("Pause (space)").click()
        eventually(lambda: status("paused"))
        length.fill("0")
        length.press("Enter")
        tab.notice("from 1 to 1000000")
        for speed, shown in ((3.5, "3.5"), (0.0, "max"), (1.0, "1")):
            client.call("/slidectl/set_speed", {"speed": speed})
            expect(tab.page.get_by_label("Rate, × real time")).to_have_value(shown)
        tab.page.get_by_label("Rate, × real time").select_option("0.5")
        eventually(lambda: status("speed") == 0.5)
        tab.page.get_by_label("Rate, × real time").select_option("1")
        tab.button("Reset").click()
        tab.page.get_by_role("menuitem", name="Reset robots and time").click()
        eventually(lambda: status("time") == 0)


def test_snapshots_are_saved_loaded_and_deleted(world: CommandLine, tab: PanelsTab) -> None:
    tab.panel("World")
    with world.client() as client:
        at = client.call("/slidectl/status")["time"]
        name = tab.page.get_by_label("Snapshot name")
        name.fill("no/name")
        tab.button("Save").click()
        tab.notice("no/name")
        name.fill("twice")
        tab.button("Save").click()
        tab.notice("twice saved")
        for _ in range(2):
            client.step(3)
            tab.button("Load").click()
            eventually(lambda: client.call("/slidectl/status")["time"] == at)
        tab.button("Delete twice").click()
        eventually(lambda: not client.snapshots())


def test_controllers_are_stopped_started_switched_loaded_and_unloaded(world: CommandLine, tab: PanelsTab) -> None:
    with world.client() as client:
        manager = client.controllers("/slider")
        name = "joint1_position_controller"
        row = tab.page.locator(".controller", has_text=name)
        row.get_by_role("button", name=f"Stop {name}").click()
        expect(row).to_contain_text("joint1 keeps its last effort when")
        row.get_by_role("button", name="Stop and zero").click()
        eventually(lambda: client.step() and manager.states()[name] != "running")
        expect(row.locator(".chip")).to_have_text("stopped")
        row.get_by_role("button", name=f"Start {name}").click()
        eventually(lambda: client.step() and manager.states()[name] == "running")
        expect(row.locator(".chip")).to_have_text("running")
        manager.stop(name)
        row.get_by_role("button", name=f"More of {name}").click()
        row.get_by_role("button", name="Unload").click()
        eventually(lambda: name not in manager.states())
        expect(row.locator(".chip")).to_have_text("unloaded")
        row.get_by_role("button", name="Load", exact=True).click()
        eventually(lambda: manager.states().get(name) == "initialized")
        tab.page.get_by_text("Switch in one cycle").click()
        tab.page.get_by_label("Start", exact=True).select_option(name)
        tab.page.get_by_label("Stop", exact=True).select_option("joint_state_controller")
        tab.button("Switch").click()
        eventually(lambda: client.step() and manager.states() == {"joint_state_controller": "stopped", name: "running"})
        tab.button("Start joint_state_controller").click()
        eventually(lambda: client.step() and set(manager.states().values()) == {"running"})
        row.get_by_role("button", name="Reload").click()
        tab.notice(f"{name} reloaded")
        assert set(manager.states().values()) == {"running"}


def test_gains_are_turned_undone_changed_by_others_and_saved(
    world: CommandLine, tab: PanelsTab, tmp_path: Path
) -> None:
    pid = f"{CONTROLLER}/pid"
    with world.client() as client:
        tab.button("More of joint1_position_controller").click()
        p, d = tab.page.get_by_label("p", exact=True), tab.page.get_by_label("d", exact=True)
        expect(p).to_have_value("100")
        for gain, text in ((p, "150"), (d, "20,5")):
            gain.fill(text)
            gain.press("Enter")
        eventually(lambda: (client.params[f"{pid}/p"], client.params[f"{pid}/d"]) == (150.0, 20.5))
        p.fill("much")
        p.press("Enter")
        expect(tab.page.locator(".gains .error")).to_contain_text("not a number")
        tab.page.get_by_label("antiwindup", exact=True).check()
        eventually(lambda: client.params[f"{pid}/antiwindup"] is True)
        for wanted in ((150.0, 20.5, False), (150.0, 10.0, False), (100.0, 10.0, False)):
            tab.button("Undo").click()
            eventually(lambda w=wanted: tuple(client.params[f"{pid}/{n}"] for n in ("p", "d", "antiwindup")) == w)
        world.ok("param", "set", f"{pid}/p", "55.5")
        expect(p).to_have_value("55.5")
        with tab.page.expect_download() as saved:
            tab.button("Save YAML").click()
        assert saved.value.suggested_filename == "slider_control.yaml"
        saved.value.save_as(tmp_path / "slider_control.yaml")
        assert "p: 55.5" in (tmp_path / "slider_control.yaml").read_text("utf-8")
        world.ok("param", "set", f"{pid}/p", "100.0")


def test_a_box_stays_as_it_was_clicked_until_the_daemon_answers(world: CommandLine, tab: PanelsTab) -> None:
    antiwindup = f"{CONTROLLER}/pid/antiwindup"
    tab.button("More of joint1_position_controller").click()
    p, box = tab.page.get_by_label("p", exact=True), tab.page.get_by_label("antiwindup", exact=True)
    expect(p).to_have_value("100")
    with world.client() as client:
        os.kill(client.daemon_pid, signal.SIGSTOP)
        try:
            box.check()
            p.fill("much")  # the panel is drawn again
            p.press("Enter")
            expect(tab.page.locator(".gains .error")).to_contain_text("not a number")
            expect(box).to_be_checked()
        finally:
            os.kill(client.daemon_pid, signal.SIGCONT)
        eventually(lambda: client.params[antiwindup] is True)
        expect(box).to_be_checked()
        box.uncheck()
        eventually(lambda: client.params[antiwindup] is False)


def test_a_joint_is_commanded_and_its_slider_follows_others(world: CommandLine, tab: PanelsTab) -> None:
    with world.client() as client, client.subscribe(f"{CONTROLLER}/command") as commands:
        slider = tab.page.get_by_role("slider", name="joint1_position_controller, joint1")
        slider.focus()
        before = float(slider.input_value())
        slider.press("ArrowRight")
        assert commands.get(timeout=60)["data"] > before
        exact = tab.page.get_by_label("Command of joint1, m")
        exact.fill("0.75")
        exact.press("Enter")
        eventually(lambda: commands.get(timeout=60)["data"] == 0.75)
        exact.fill("much")
        exact.press("Enter")
        expect(exact).to_have_value("0.750")
        tab.notice("joint1: a number is needed")
        client.publish(f"{CONTROLLER}/command", {"data": 0.25})
        eventually(lambda: client.step(10) and exact.input_value() == "0.250")
        tab.page.get_by_role("button", name="Jog joint1 forth").hover()
        tab.page.mouse.down()
        eventually(lambda: commands.get(timeout=60)["data"] > 0.26)
        tab.page.mouse.up()
        joints = tab.page.locator("table.states").first
        expect(joints).to_contain_text("joint1")


def test_a_joint_without_limits_takes_numbers_beyond_its_slider(
    world: CommandLine, browser: Browser, page: str
) -> None:
    world.ok("spawn", "rrbot", "--at", "0", "3", "0", "--controllers", "config/rrbot_control.yaml", "--start",
             "joint1_position_controller")  # fmt: skip
    try:
        tab = PanelsTab(browser, page, "&robot=rrbot")
        with world.client() as client, client.subscribe("/rrbot/joint1_position_controller/command") as commands:
            exact = tab.page.get_by_label("Command of joint1, rad")
            exact.fill("20,12345")
            exact.press("Enter")
            assert commands.get(timeout=60)["data"] == 20.12345
            slider = tab.page.get_by_role("slider", name="joint1_position_controller, joint1")
            assert float(slider.input_value()) < 6.3
            tab.page.get_by_role("button", name="Jog joint1 forth").hover()
            tab.page.mouse.down()
            assert commands.get(timeout=60)["data"] > 20.12
            tab.page.mouse.up()
        tab.close()
    finally:
        world.ok("delete", "rrbot")


def test_fields_are_plotted_paused_and_saved(world: CommandLine, tab: PanelsTab) -> None:
    with world.client() as client:

        def moved(target: float) -> bool:
            client.publish(f"{CONTROLLER}/command", {"data": target})
            return bool(client.step(200))

        legend = tab.page.locator(".u-legend")
        eventually(lambda: moved(0.7) and legend.count() == 1)  # set point and process value of the first controller
        expect(legend).to_contain_text("set_point, m")
        expect(tab.page.get_by_text("No message has come yet")).to_have_count(0)
        field = tab.page.get_by_label("Plot field")
        for text, told in (("", "No field to plot"), ("joint_states/no_field", "no field no_field"),
                           ("joint_states/name", "which is not a number"), ("no_topic/x", "no topic")):  # fmt: skip
            field.fill(text)
            tab.button("Plot").click()
            expect(tab.page.locator(".plot-form .error")).to_contain_text(told)
        field.fill("joint_states/{position,velocity}")
        tab.button("Plot").click()
        plots = tab.page.locator("section.plot")
        expect(plots).to_have_count(2)
        assert "plot=%2Fslider%2Fjoint_states%2Fvelocity" in tab.page.url
        eventually(lambda: moved(0.5) and legend.count() == 2)
        ink = "one => [getComputedStyle(one).color, getComputedStyle(document.querySelector('#slidectl')).color]"
        tab.page.emulate_media(color_scheme="dark")
        eventually(lambda: tab.page.evaluate("document.documentElement.dataset.theme") == "dark")
        label, page_ink = legend.nth(1).locator(".u-label").last.evaluate(ink)
        assert label == page_ink
        tab.page.emulate_media(color_scheme="light")
        expect(legend.nth(1)).to_contain_text("velocity[0] (joint1), m/s")
        plots.nth(1).get_by_label("Derived curve").select_option("derivative")
        expect(legend.nth(1)).to_contain_text("d/dt position[0] (joint1), m/s")
        plots.nth(0).get_by_label("Pause the plot").click()
        moved(0.1)
        with tab.page.expect_download() as saved:
            plots.nth(0).get_by_role("button", name="CSV").click()
        header, *rows = Path(saved.value.path()).read_text("utf-8").splitlines()
        assert header == "%time,set_point,process_value"
        assert {row.split(",")[1] for row in rows} <= {"0.7", "0.5", "0"}
        plots.nth(0).get_by_label("Remove the plot").click()
        expect(plots).to_have_count(1)
        field.fill("level/data")
        client.advertise("/level", "std_msgs/Float64")
        client.flush()
        tab.button("Plot").click()
        eventually(lambda: client.call("/rosapi/subscribers", {"topic": "/level"})["subscribers"])
        for value in (1.0, math.nan, 2.0):
            client.publish("/level", {"data": value})
            client.step(1)
        with tab.page.expect_download() as saved:
            eventually(lambda: plots.nth(1).get_by_role("button", name="CSV").is_enabled())
            plots.nth(1).get_by_role("button", name="CSV").click()
        values = [row.split(",")[1] for row in Path(saved.value.path()).read_text("utf-8").splitlines()[1:]]
        assert values == ["1", "", "2"]


def test_each_unit_of_a_plot_has_a_scale_of_its_own(world: CommandLine, browser: Browser, page: str) -> None:
    tab = PanelsTab(browser, page, "".join(f"&plot=joint_states/{name}" for name in ("velocity", "position", "effort")))
    tab.page.get_by_text("joint1_position_controller").first.wait_for()
    rows_of_the_third = """one => {
        const { width, height } = one;
        const { data } = one.getContext("2d").getImageData(0, 0, width, height);
        const rows = [];
        for (let at = 0; at < data.length; at += 4) {
            const far = Math.abs(data[at] - 0x1e) + Math.abs(data[at + 1] - 0x9e) + Math.abs(data[at + 2] - 0x5a);
            if (data[at + 3] > 200 && far < 40) rows.push(Math.floor(at / 4 / width));
        }
        return rows.length ? (Math.max(...rows) - Math.min(...rows)) / height : 0;
    }"""
    with world.client() as client:

        def is_high() -> bool:
            client.publish(f"{CONTROLLER}/command", {"data": -client.step(300) % 1})
            canvas = tab.page.locator(".chart canvas")
            return bool(canvas.count()) and canvas.evaluate(rows_of_the_third) > 0.4

        eventually(is_high)
    assert tab.page.locator(".u-axis").count() == 3  # of the time and of the first two units
    tab.close()


def test_slices_of_fields_are_those_of_python(world: CommandLine, tab: PanelsTab) -> None:
    here = "import('/slidectl/fields.js')"
    taken = f"text => {here}.then((f) => f.valueAt({{ data: [0, 1, 2, 3, 4] }}, f.steps(`data${{text}}`)))"
    numbers = list(range(5))
    for text in ("[::2]", "[-2:]", "[:-1]", "[1:3]", "[::-1]", "[-9:9]", "[3:0:-2]", "[9:]", "[:]"):
        begin, end, step = [int(part) if part else None for part in (text[1:-1] + "::").split(":")[:3]]
        assert tab.page.evaluate(taken, text) == numbers[begin:end:step], text
    of_each = f"{here}.then((f) => f.valueAt({{ poses: [{{ x: 1 }}, {{ x: 2 }}] }}, f.steps('poses[1:]/x')))"
    assert tab.page.evaluate(of_each) == [2]
    name = f"{here}.then((f) => f.nameOfElement({{ name: ['a', 'b', 'c'] }}, 'position[-2:][0]'))"
    assert tab.page.evaluate(name) == "b"
    field = tab.page.get_by_label("Plot field")
    field.fill("joint_states/position[::0]")
    tab.button("Plot").click()
    expect(tab.page.locator(".plot-form .error")).to_contain_text("step of a slice cannot be 0")
    field.fill("joint_states/position[-1:]")
    tab.button("Plot").click()
    with world.client() as client:
        legend = tab.page.locator(".u-legend", has_text="position[-1:][0] (joint1), m")
        eventually(lambda: client.step(100) and legend.count())


def test_topics_show_fields_with_units_and_pictures(world: CommandLine, tab: PanelsTab) -> None:
    tab.panel("Topics")
    with world.client() as client:
        search = tab.page.get_by_label("Topic contains")
        search.fill("joint_states")
        tab.page.locator(".topic .fold").first.click()
        eventually(lambda: client.step(100) and tab.page.locator(".leaf", has_text="[0] joint1").count() >= 3)
        expect(tab.page.locator(".leaf", has_text="[0] joint1").first).to_contain_text("m")
        eventually(lambda: client.step(100) and tab.page.get_by_text(" Hz").count())
        tab.page.get_by_role("button", name="Plot [0] joint1").first.click()
        tab.notice("is plotted")
        client.advertise("/eye", "sensor_msgs/Image")
        client.flush()
        search.fill("/eye")
        tab.page.get_by_role("button", name="Show /eye over the view").click()
        depth = {"height": 2, "width": 2, "encoding": "32FC1", "step": 8, "data": "AACAPwAAAEAAAIA/AADAfw=="}
        red = {"height": 1, "width": 2, "encoding": "rgb8", "step": 6, "data": "/wAA/wAA"}
        wrong = {"height": 9, "width": 9, "encoding": "rgb8", "step": 27, "data": "/wAA"}
        eventually(lambda: client.call("/rosapi/subscribers", {"topic": "/eye"})["subscribers"])
        for image, text in ((red, "2 × 1, rgb8"), (depth, "1.00 to 2.00 m"), (wrong, "too little data")):

            def is_drawn(image: dict[str, object] = image, text: str = text) -> bool:
                client.publish("/eye", image)
                client.step(1)
                return text in tab.page.locator(".overlay figcaption").inner_text()

            eventually(is_drawn)
        overlay = tab.page.locator(".overlay")
        expect(overlay).to_contain_text(re.compile(r"No picture for \d+ s: the world is paused"))
        client.resume()
        expect(overlay).to_contain_text(re.compile(r"No picture for \d+ s: the camera has stopped"))
        client.pause()
    expect(overlay).to_contain_text(re.compile(r"No picture for \d+ s: the camera has gone"))


def test_messages_are_published_and_services_called_by_forms(world: CommandLine, tab: PanelsTab) -> None:
    tab.panel("Send")
    with world.client() as client, client.subscribe(f"{CONTROLLER}/command") as commands:
        tab.page.get_by_label("Topic", exact=True).select_option(f"{CONTROLLER}/command")
        data = tab.page.get_by_label("data", exact=True)
        data.fill("pi / 8")
        tab.button("Publish once").click()
        assert commands.get(timeout=60)["data"] == math.pi / 8
        data.fill("sin(t")
        tab.button("Publish once").click()
        tab.notice("not a valid expression")
        data.fill("0.1 * i")
        tab.button("Publish at").click()
        expect(tab.page.get_by_text("10 Hz, ")).to_be_visible()
        tab.page.get_by_role("button", name=f"Stop {CONTROLLER}/command").click()
        expect(tab.page.get_by_text("10 Hz, ")).to_have_count(0)
        tab.page.get_by_label("Service", exact=True).select_option("/slider/controller_manager/load_controller")
        tab.page.get_by_label("name", exact=True).fill("no_such_controller")
        tab.button("Call").click()
        answer = tab.page.locator(".answer")
        expect(answer).to_contain_text("ok: false")
        expect(answer).to_contain_text("# ")
        tab.page.get_by_label("Service", exact=True).select_option("/slidectl/sleep")
        tab.page.get_by_label("duration", exact=True).fill("0.5")
        tab.button("Call").click()
        expect(answer).to_contain_text("calling")
        eventually(lambda: client.step(seconds=1) and "success: true" in answer.inner_text())


def test_the_log_is_filtered_and_names_are_never_markup(world: CommandLine, tab: PanelsTab) -> None:
    with world.client() as client:
        for level, text in ((2, "a plain line"), (4, "<img src=x onerror=alert(1)>"), (8, "an <b>error</b>")):
            client.publish("/rosout", {"level": level, "name": "/<i>node</i>", "msg": text}, "rosgraph_msgs/Log")
        client.flush()
        tab.panel("Log")
        expect(tab.page.locator(".log")).to_contain_text("/<i>node</i>: <img src=x onerror=alert(1)>")
        tab.page.get_by_label("Severity from").select_option("From error")
        expect(tab.page.locator(".log")).not_to_contain_text("a plain line")
        expect(tab.page.locator(".log")).to_contain_text("an <b>error</b>")
        assert tab.page.locator(".log img, .log i").count() == 0
        tab.page.get_by_label("Log contains").fill("no such text")
        expect(tab.page.locator(".log")).to_contain_text("No lines")
        tab.page.get_by_label("Log contains").fill("")
        tab.page.get_by_label("Severity from").select_option("From debug")
        tab.button("Clear").click()
        expect(tab.page.locator(".log")).to_contain_text("No lines")


def test_the_graph_fits_its_panel_and_frames_are_followed(world: CommandLine, tab: PanelsTab) -> None:
    tab.panel("Graph")
    picture = tab.page.get_by_alt_text("Graph of nodes and topics")
    eventually(lambda: picture.evaluate("one => one.naturalWidth") > 100)
    assert picture.bounding_box()["width"] < 400
    tab.page.get_by_label("Graph of").fill("joint_sates")
    expect(tab.page.locator(".group .error")).to_contain_text("joint_states")
    with world.client() as client:
        assert not client.call("/rosapi/subscribers", {"topic": "/tf"})["subscribers"]
        tab.page.get_by_label("Follow the tf tree").check()
        eventually(lambda: client.step(100) and tab.page.locator(".tree", has_text="link2").count())
        tab.page.get_by_label("Follow the tf tree").uncheck()
        eventually(lambda: not client.call("/rosapi/subscribers", {"topic": "/tf"})["subscribers"])


def test_keys_are_shown_and_colours_are_switched(tab: PanelsTab) -> None:
    tab.page.locator("body").press("?")
    expect(tab.page.get_by_role("dialog", name="Keys")).to_contain_text("Pause or resume")
    tab.page.keyboard.press("Escape")
    expect(tab.page.get_by_role("dialog")).to_have_count(0)
    theme = "document.documentElement.dataset.theme"
    assert tab.page.evaluate(theme) == "light"
    tab.page.emulate_media(color_scheme="dark")
    # A browser notices this when it draws a frame, and this one draws no scene: frames are asked for.
    drawn = f"new Promise((done) => requestAnimationFrame(() => done({theme})))"
    eventually(lambda: tab.page.evaluate(drawn) == "dark")
    tab.button("Colours: system").click()
    assert tab.page.evaluate(theme) == "light"
    tab.button("Colours: light").click()
    assert tab.page.evaluate(theme) == "dark"


def test_a_trajectory_is_sent_and_succeeds(world: CommandLine, browser: Browser, page: str) -> None:
    world.ok("spawn", "arm", "--at", "2", "0", "0", "--controllers", "config/arm_control.yaml", "--start",
             "joint_state_controller", "arm_controller")  # fmt: skip
    try:
        tab = PanelsTab(browser, page, "&robot=arm&panel=robot&plot=/arm/arm_controller/state/desired/positions[0]")
        with world.client() as client:
            legend = tab.page.locator(".u-legend", has_text="positions[0] (joint1), rad")
            eventually(lambda: client.step(100) and legend.count())
            goal = tab.page.get_by_role("slider", name="Goal of").first
            goal.focus()
            for _ in range(20):
                goal.press("ArrowRight")
            duration = tab.page.get_by_label("Duration, s")
            duration.fill("-1")
            assert tab.button("Send").is_disabled()
            duration.fill("0.5")
            with PageBrowser(page) as scene:
                scene.wait_for(lambda: scene.nodes.get("/ghost/flange", {}).get("visible"), "the goal has no ghost")
                tab.button("Send").click()
                expect(tab.page.get_by_text("Goal: active")).to_be_visible()
                eventually(lambda: client.step(200) and tab.page.get_by_text("Goal: succeeded").count())
                scene.wait_for(lambda: "/ghost/flange" not in scene.nodes, "the ghost stays")
                goal.press("ArrowLeft")
                scene.wait_for(lambda: "/ghost/flange" in scene.nodes)
                tab.panel("View")
                scene.wait_for(lambda: "/ghost/flange" not in scene.nodes, "the ghost stays when the panel is closed")
                tab.panel("Robot")
            tab.button("Set to the present positions").click()
            tab.button("Hold").click()
        tab.close()
    finally:
        world.ok("delete", "arm")


def test_a_sensor_is_switched_on_in_the_panel_of_the_view(world: CommandLine, page: str, tab: PanelsTab) -> None:
    tab.panel("View")
    with world.client() as client, PageBrowser(page) as scene:
        expect(tab.page.get_by_label("Shadows")).to_have_value("auto")
        expect(tab.page.get_by_text("Off while a browser draws by software.")).to_be_visible()
        expect(tab.page.get_by_text("Sensors and paths")).to_have_count(0)  # there are none
        client.advertise("/sonar", "sensor_msgs/Range")
        client.flush()
        tab.page.get_by_label("/sonar").check()
        expect(tab.page.get_by_text("No message has come yet.")).to_be_visible()
        message = {"header": {"frame_id": "no_link"}, "field_of_view": 0.4, "max_range": 4.0, "range": 1.0}
        eventually(lambda: client.call("/rosapi/subscribers", {"topic": "/sonar"})["subscribers"])
        client.publish("/sonar", message)
        client.flush()
        expect(tab.page.get_by_text("There is no frame 'no_link'")).to_be_visible()
        client.publish("/sonar", {**message, "header": {"frame_id": "link2"}})
        client.flush()
        scene.wait_for(lambda: scene.nodes.get("/sensors/sonar", {}).get("visible"))
        expect(tab.page.get_by_text("There is no frame")).to_have_count(0)
        tab.page.get_by_label("/sonar").uncheck()
        scene.wait_for(lambda: "/sensors/sonar" not in scene.nodes)


def test_the_camera_goes_near_the_chosen_robot_of_several(world: CommandLine, browser: Browser, page: str) -> None:
    world.ok("spawn", "slider", "-n", "other", "--at", "3", "0", "0")
    try:
        tab = PanelsTab(browser, page, "&robot=other")
        with PageBrowser(page) as scene:
            tab.button("Camera").click()
            tab.page.get_by_role("menuitem", name="Near other").click()
            scene.wait_for(lambda: scene.looks_at[0] > 2.5)
            tab.button("Camera").click()
            tab.page.get_by_role("menuitem", name="From the side above").click()
            scene.wait_for(lambda: scene.looks_at[0] < 2.5)
        tab.close()
    finally:
        world.ok("delete", "other")


def test_a_robot_that_goes_while_it_is_shown_is_named(world: CommandLine, browser: Browser, page: str) -> None:
    world.ok("spawn", "arm", "--at", "2", "0", "0", "--controllers", "config/arm_control.yaml", "--start",
             "joint_state_controller", "arm_controller")  # fmt: skip
    tab = PanelsTab(browser, page, "&robot=arm")
    goal = tab.page.get_by_role("slider", name="Goal of").first
    goal.focus()
    goal.press("ArrowRight")
    world.ok("delete", "arm")
    expect(tab.page.get_by_text("There is no robot arm with joints: this is slider.")).to_be_visible()
    tab.page.get_by_text("joint1_position_controller").first.wait_for()
    tab.close()


def test_twenty_browsers_at_once_see_the_same(world: CommandLine, browser: Browser, page: str) -> None:
    with ExitStack() as stack, world.client() as client:
        many = [stack.enter_context(PageBrowser(page)) for _ in range(17)]
        tabs = [PanelsTab(browser, page) for _ in range(3)]
        for one in tabs:
            one.page.get_by_text("joint1_position_controller").first.wait_for()
        exact = [one.page.get_by_label("Command of joint1, m") for one in tabs]
        for number, one in enumerate(many):
            one.call("/slidectl/step", cycles=1)
            assert one.page("state")["view"]["frames"] is False, number
        exact[0].fill("0.625")
        exact[0].press("Enter")
        for one in exact[1:]:
            eventually(lambda one=one: client.step(10) and one.input_value() == "0.625")
        for one in tabs:
            one.close()


def test_a_base_is_driven_by_keys_and_stops_when_they_are_let_go(
    world: CommandLine, browser: Browser, page: str
) -> None:
    world.ok(
        "spawn", "car", "--at", "0", "3", "0", "--controllers", "config/car_control.yaml", "--start", "base_controller"
    )
    try:
        tab = PanelsTab(browser, page, "&robot=car")
        with world.client() as client, client.subscribe("/car/base_controller/cmd_vel") as twists:
            pad = tab.page.get_by_role("group", name="Drive with the arrow keys")
            pad.focus()
            tab.page.keyboard.down("ArrowUp")
            assert twists.get(timeout=60)["linear"]["x"] == 0.5
            tab.page.keyboard.down("ArrowLeft")
            eventually(lambda: twists.get(timeout=60)["angular"]["z"] == 1.0)
            tab.page.keyboard.up("ArrowLeft")
            tab.page.keyboard.up("ArrowUp")
            eventually(lambda: twists.get(timeout=60)["linear"]["x"] == 0.0)
            tab.page.get_by_role("button", name="Backward").hover()
            tab.page.mouse.down()
            eventually(lambda: twists.get(timeout=60)["linear"]["x"] == -0.5)
            tab.page.mouse.up()
            eventually(lambda: twists.get(timeout=60)["linear"]["x"] == 0.0)
        tab.close()
    finally:
        world.ok("delete", "car")


def test_on_a_phone_all_panels_are_in_one_sheet(browser: Browser, page: str) -> None:
    tab = PanelsTab(browser, page, size=(390, 844))
    tab.page.get_by_text("joint1_position_controller").first.wait_for()
    assert tab.page.get_by_role("tab").count() == 8
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= 390
    sheet = tab.page.get_by_role("complementary", name="Panels").bounding_box()
    assert (sheet["x"], sheet["width"]) == (0, 390)
    assert sheet["y"] > 844 * 0.4
    tab.page.get_by_role("button", name="Hide panels").click()
    expect(tab.page.get_by_role("complementary")).to_have_count(0)
    tab.close()


def test_in_a_narrow_window_the_panel_of_the_address_is_shown_alone(browser: Browser, page: str) -> None:
    for more, shown in (("", "Robot"), ("&panel=topics", "Data"), ("&plot=joint_states/position", "Data")):
        tab = PanelsTab(browser, page, more, size=(1000, 800))
        tab.page.get_by_role("complementary", name=shown).wait_for()
        expect(tab.page.get_by_role("complementary")).to_have_count(1)
        tab.close()


@pytest.mark.parametrize("panel", ["robot", "plots"])
def test_the_toolbar_has_one_row_in_every_window(browser: Browser, page: str, panel: str) -> None:
    tab = PanelsTab(browser, page, f"&panel={panel}")
    expect(tab.button("Resume (space)")).to_be_enabled()
    for width in (1440, 1200, 1024, 800, 720, 640, 390):
        tab.page.set_viewport_size({"width": width, "height": 500})
        expect(tab.page.get_by_role("button", name="Hide panels")).to_have_count(int(width <= 700))
        box = tab.page.get_by_role("toolbar").bounding_box()
        assert box is not None
        assert box["height"] < 50, f"{width}: {box}"
    tab.close()


def test_a_page_that_only_looks_has_its_inputs_off(world: CommandLine, browser: Browser) -> None:
    with served_page(world, "--read-only") as url:
        tab = PanelsTab(browser, url)
        tab.page.get_by_text("Read-only: started with --read-only").wait_for()
        for name in ("Step (.)", "Stop joint1_position_controller", "Record"):
            assert tab.button(name).is_disabled(), name
        tab.panel("Send")
        tab.page.get_by_label("Topic", exact=True).select_option(f"{CONTROLLER}/command")
        assert tab.page.get_by_label("data", exact=True).is_disabled()
        assert tab.button("Publish once").is_disabled()
        tab.close()


def test_the_page_says_that_slidectl_view_has_ended(world: CommandLine, browser: Browser) -> None:
    with served_page(world) as url:
        tab = PanelsTab(browser, url)
        tab.page.get_by_text("joint1_position_controller").first.wait_for()
    expect(tab.page.get_by_role("alert")).to_contain_text("slidectl view has ended")
    expect(tab.page.get_by_role("complementary", name="Robot")).to_contain_text("slidectl view has ended")
    tab.close()


def test_the_page_says_that_the_daemon_has_gone_and_goes_on_with_the_next(browser: Browser) -> None:
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        spawn_slider(command)
        with served_page(command) as url:
            tab = PanelsTab(browser, url, "&plot=joint1_position_controller/state/set_point")
            legend = tab.page.locator(".u-legend", has_text="set_point")

            def is_plotted() -> bool:
                with command.client() as client:
                    client.step(100)
                return bool(legend.count())

            eventually(is_plotted)
            command.ok("daemon", "stop")
            expect(tab.page.get_by_role("alert")).to_contain_text("The daemon has gone")
            command.ok("daemon", "start", "--paused")
            tab.page.get_by_text("The world is empty").wait_for()
            spawn_slider(command)
            tab.page.get_by_text("joint1_position_controller").first.wait_for()
            eventually(is_plotted)
            tab.close()
