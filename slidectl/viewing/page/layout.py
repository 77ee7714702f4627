"""The panels of the page, and their positions."""

from __future__ import annotations

from slidectl.viewing.page.controllers_panel import ControllersPanel
from slidectl.viewing.page.gains_panel import GainsPanel
from slidectl.viewing.page.graph_panel import GraphPanel
from slidectl.viewing.page.joints_panel import JointsPanel
from slidectl.viewing.page.log_panel import LogPanel
from slidectl.viewing.page.message_panels import PublishPanel, ServicesPanel
from slidectl.viewing.page.page import Page, Panel
from slidectl.viewing.page.plots_panel import PlotsPanel
from slidectl.viewing.page.record_panel import RecordPanel
from slidectl.viewing.page.scene_view import SceneView
from slidectl.viewing.page.simulation_panel import SimulationPanel
from slidectl.viewing.page.topics_panel import TopicsPanel
from slidectl.viewing.page.trajectories_panel import TrajectoriesPanel

_WORLD: tuple[type[Panel], ...] = (SimulationPanel, SceneView, RecordPanel)
_ROBOT: tuple[type[Panel], ...] = (JointsPanel, ControllersPanel, GainsPanel, TrajectoriesPanel)
"""Panels that move robots."""
_DATA: tuple[type[Panel], ...] = (PlotsPanel, PublishPanel, ServicesPanel, TopicsPanel, LogPanel, GraphPanel)
"""Panels that show and send messages."""
_WIDTH = 380.0
"""The width of the panels beside the view, in pixels."""


def lay_out(page: Page) -> None:
    """Create all panels."""
    gui = page.server.gui
    tabs = gui.add_tab_group()
    for kind in _WORLD:
        page.add_panel(kind(page), tabs.add_tab(kind.title))
    gui.main_panel.dock_left()
    robot, data = gui.add_panel(), gui.add_panel()
    robot.dock_below(gui.main_panel)
    data.dock_right()
    gui.main_panel.set_width(_WIDTH)
    data.set_width(_WIDTH)
    for kinds, panel in ((_ROBOT, robot), (_DATA, data)):
        for kind in kinds:
            page.add_panel(kind(page), panel.add_tab(kind.title))
