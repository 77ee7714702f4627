"""The panel of gains: turned, undone, changed by others, and saved as a file that a spawn takes."""

from __future__ import annotations

from pathlib import Path

from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page

PID = "/slider/joint1_position_controller/pid"
FILE = "slider_control.yaml"


def test_gains_are_turned_undone_and_saved(tmp_path: Path) -> None:
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        spawn = ("spawn", "slider", "--start", "joint1_position_controller", "--controllers")
        command.ok(*spawn, "config/slider_control.yaml")
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:

            def becomes(**gains: float | bool) -> None:
                browser.wait_for(lambda: all(client.params[f"{PID}/{name}"] == now for name, now in gains.items()))
                kinds = {name: "Checkbox" if isinstance(now, bool) else "Number" for name, now in gains.items()}
                browser.wait_for(
                    lambda: all(browser.element(name, kinds[name])["value"] == gains[name] for name in gains)
                )

            becomes(p=100.0, i=0.01, d=10.0, antiwindup=False)
            for typed in (1, 15, 150):
                browser.set("p", typed, "Number")
            becomes(p=150.0)
            browser.set("d", 20.5, "Number")
            becomes(p=150.0, d=20.5)
            browser.set("antiwindup", True)
            becomes(antiwindup=True)
            browser.wait_for(lambda: browser.find(f"{PID}/p", "Html"))
            for left in ({"antiwindup": False, "d": 20.5}, {"p": 150.0, "d": 10.0}, {"p": 100.0}):
                browser.click("Undo")
                becomes(**left)
            browser.click("Undo")
            browser.wait_for(lambda: any("no change to undo" in told for told in browser.notifications))

            command.ok("param", "set", f"{PID}/p", "55.5")
            becomes(p=55.5)
            browser.set("p", 77.25, "Number")
            becomes(p=77.25)
            browser.click("Save as YAML")
            browser.wait_for(lambda: b"p: 77.25" in browser.downloads.get(FILE, b""))
            browser.element("p: 77.25", "Html")
            (tmp_path / FILE).write_bytes(browser.downloads[FILE])
            command.ok("delete", "slider")
            browser.element("no gains", "Markdown")
            command.ok("param", "delete", "/slider")
            command.ok(*spawn, str(tmp_path / FILE))
            becomes(p=77.25, i=0.01, d=10.0)


def test_a_server_that_was_not_ready_and_has_values_of_other_types() -> None:
    with running_daemon() as runtime:
        command = CommandLine(runtime.folder)
        command.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start",
                   "joint1_position_controller")  # fmt: skip
        with served_page(command) as url, PageBrowser(url) as browser, command.client() as client:
            browser.element("p", "Number")
            kinds = {"doubles": {"name": "gain", "value": 2.0}, "ints": {"name": "order", "value": 3}}
            config = {kind: [entry] for kind, entry in kinds.items()}
            client.advertise_service("/slider/other/set_parameters", "dynamic_reconfigure/Reconfigure", lambda _: {})
            client.publish("/slider/other/parameter_updates", config, "dynamic_reconfigure/Config", latch=True)
            description = "/slider/other/parameter_descriptions", "dynamic_reconfigure/ConfigDescription"
            client.advertise(*description, latch=True)
            client.flush()
            browser.wait_for(lambda: any("parameter_descriptions" in told for told in browser.notifications))
            parameters = [{"name": "gain", "type": "double"}, {"name": "order", "type": "int"}]
            limits = dict.fromkeys(("min", "max", "dflt"), config)
            client.publish(description[0], {"groups": [{"parameters": parameters}], **limits}, latch=True)
            client.flush()
            assert browser.element("gain", "Number")["value"] == 2.0
            browser.element("order: type int", "Html")
            browser.element("p", "Number")
