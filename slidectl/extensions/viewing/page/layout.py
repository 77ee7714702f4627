"""The panels of the page, and their positions."""

from __future__ import annotations

from slidectl.extensions.viewing.page.controllers_panel import ControllersPanel
from slidectl.extensions.viewing.page.gains_panel import GainsPanel
from slidectl.extensions.viewing.page.graph_panel import GraphPanel
from slidectl.extensions.viewing.page.joints_panel import JointsPanel
from slidectl.extensions.viewing.page.log_panel import LogPanel
from slidectl.extensions.viewing.page.message_panels import PublishPanel, ServicesPanel
from slidectl.extensions.viewing.page.page import Page, Panel
from slidectl.extensions.viewing.page.plots_panel import PlotsPanel
from slidectl.extensions.viewing.page.record_panel import RecordPanel
from slidectl.extensions.viewing.page.scene_view import SceneView
from slidectl.extensions.viewing.page.simulation_panel import SimulationPanel
from slidectl.extensions.viewing.page.topics_panel import TopicsPanel
from slidectl.extensions.viewing.page.trajectories_panel import TrajectoriesPanel

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
