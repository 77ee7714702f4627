"""The page for people who do not see it, or not well: axe-core finds no serious and no critical fault."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from page_browser import CommandLine
from panels_tab import CHROMIUM, PanelsTab, chromium
from playwright.sync_api import Browser

sys.path.append(str(Path(__file__).parent.parent / "gateways"))
from node_scripts import modules

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
PANELS = ("Robot", "World", "View", "Plots", "Topics", "Send", "Log", "Graph")
FAULTS = """async () => {
    const { violations } = await axe.run(document, { resultTypes: ["violations"] });
    return violations.filter((one) => ["serious", "critical"].includes(one.impact)).flatMap((one) =>
        one.nodes.map((node) => `${one.impact} ${one.id}: ${node.html.slice(0, 160)} ${node.failureSummary}`));
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium(draws=False) as one:
        yield one


def faults(tab: PanelsTab) -> list[str]:
    if not tab.page.evaluate("'axe' in window"):
        tab.page.evaluate((modules() / "axe-core/axe.min.js").read_text("utf-8"))
    found: list[str] = tab.page.evaluate(FAULTS)
    return found


@pytest.mark.parametrize("colours", ["light", "dark"])
@pytest.mark.parametrize("size", [(1440, 900), (390, 844)], ids=["desk", "phone"])
def test_no_panel_has_a_serious_fault(
    world: CommandLine, browser: Browser, page: str, colours: str, size: tuple[int, int]
) -> None:
    world.ok("spawn", "arm", "--at", "2", "0", "0", "--controllers", "config/arm_control.yaml", "--start",
             "joint_state_controller", "arm_controller")  # fmt: skip
    try:
        tab = PanelsTab(browser, page, "&robot=arm", size)
        tab.page.emulate_media(color_scheme=colours)
        tab.page.get_by_text("arm_controller").first.wait_for()
        found = {}
        for panel in PANELS:
            tab.panel(panel)
            tab.page.wait_for_timeout(300)
            found[panel] = faults(tab)
        tab.panel("Robot")
        tab.button("More of arm_controller").click()
        tab.button("Reset").click()
        found["menus"] = faults(tab)
        tab.page.keyboard.press("Escape")
        tab.page.keyboard.press("?")
        found["keys"] = faults(tab)
        assert not any(found.values()), "\n".join(f"{panel}: {one}" for panel, all_ in found.items() for one in all_)
        tab.close()
    finally:
        world.ok("delete", "arm")
