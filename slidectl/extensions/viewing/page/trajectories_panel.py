"""Target positions and a duration for a trajectory controller (rqt_joint_trajectory_controller)."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.client import Subscription
from slidectl.client.action_client import Action, desired_positions, goal_to, hold, trajectory_controllers
from slidectl.extensions.viewing.page.joints_panel import bounds, placed, step_of
from slidectl.extensions.viewing.page.page import PADDING, Page, Panel, WorldState, html_table

if TYPE_CHECKING:
    from slidectl.msgs.typed import RobotInfoMsg

_STATE_EVERY_MS = 100
_LONGEST_S = 1e6


class TrajectoriesPanel(Panel):
    """A goal form for one of the running trajectory controllers."""

    title = "Trajectories"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._controller = ""
        """The full name of the chosen controller."""
        self._duration = 2.0
        self._targets: dict[str, dict[str, float]] = {}
        """Controller -> joint -> position."""
        self._sliders: dict[str, Any] = {}
        self._states: Subscription | None = None
        self._goal: tuple[Action, str] | None = None
        """The action and the id of the goal that was sent and has not ended."""
        self._told = "no goal was sent"

    def shape(self, world: WorldState) -> Hashable:
        running = {
            controller: tuple(
                (joint["name"], joint["type"], joint["lower"], joint["upper"]) for joint in robot["joints"]
            )
            for controller, _, robot in _running(world)
        }
        if self._controller not in running:
            self._controller = next(iter(running), "")
        return self._controller, tuple(running.items())

    def build(self, world: WorldState) -> None:
        running = {controller: (action, robot) for controller, action, robot in _running(world)}
        if not running:
            self.gui.add_markdown(
                "no JointTrajectoryController runs. One of its own: `slidectl spawn arm --at 2 0 0 --controllers "
                "config/arm_control.yaml --start joint_state_controller arm_controller`"
            )
            return
        controller = self._controller
        action, robot = running[controller]
        self.page.looking(self.gui.add_dropdown("controller", tuple(running), initial_value=controller), self._choose)
        joints = {joint["name"]: joint for joint in robot["joints"]}
        before = self._targets.get(controller, {})
        targets = self._targets[controller] = {}
        for name, position in desired_positions(self.page.client, controller).items():
            low, high = bounds(joints[name], "Position")
            targets[name] = placed(before.get(name, position), low, high)
            slider = self._sliders[name] = self.gui.add_slider(name, low, high, step_of(low, high), targets[name])
            self.page.acting(slider, partial(targets.__setitem__, name), coalesce=True)
        cycle = world.status["timestep"]
        duration = self.gui.add_number("duration (s)", max(self._duration, cycle), min=cycle, max=_LONGEST_S, step=0.1)
        self.page.acting(duration, partial(setattr, self, "_duration"))
        goal = self.gui.add_button_group("goal", ("send", "hold", "cancel"))
        self.page.acting(goal, partial(self._act, controller, action))
        present = self.gui.add_button("Take present positions", hint="targets where the joints are meant to be now")
        self.page.acting(present, lambda _: self._take_present(controller))
        self._told_of_goal = self.gui.add_html("")
        self._table = self.gui.add_html("")
        self._states = self.subscribe(f"{controller}/state", queue_length=1, throttle_rate=_STATE_EVERY_MS)
        self.refresh(world)

    def _choose(self, controller: str) -> None:
        self._controller = controller
        self.page.look_again()

    def _take_present(self, controller: str) -> None:
        for name, position in desired_positions(self.page.client, controller).items():
            if (slider := self._sliders.get(name)) is None:
                return  # another controller has been chosen meanwhile
            slider.value = self._targets[controller][name] = placed(position, slider.min, slider.max)

    def _act(self, controller: str, action: str, what: str) -> None:
        client = self.page.client
        if what == "send":
            self._end_goal()
            server = Action(client, action)
            self._goal = server, server.send(goal_to(self._targets[controller], self._duration))
            self._told = "active"
        elif what == "hold":
            hold(client, controller)
        else:
            client.deliver(f"{action}/cancel", {})

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        if self._states is None:
            return
        self._look_at_goal()
        self._told_of_goal.content = f'<div style="{PADDING}">goal: {escape(self._told)}</div>'
        while len(self._states):
            now = self._states.get()
            columns = [now[which]["positions"] for which in ("desired", "actual", "error")]
            self._table.content = html_table(
                ("joint", "desired", "actual", "error"), zip(now["joint_names"], *columns, strict=True)
            )

    def _look_at_goal(self) -> None:
        if self._goal is not None and (ended := self._goal[0].ended(self._goal[1])) is not None:
            self._told = f"{ended.state}: {ended.text}" if ended.text else ended.state
            self._goal[0].close()
            self._goal = None

    def _end_goal(self) -> None:
        """Stop following the goal."""
        self._look_at_goal()
        if self._goal is not None:
            self._goal[0].close()
            self._goal, self._told = None, "how it ended is not known"

    def leave(self) -> None:
        super().leave()
        self._states = None
        self._end_goal()
        self._sliders.clear()


def _running(world: WorldState) -> Iterator[tuple[str, str, RobotInfoMsg]]:
    """The full name of each running trajectory controller, its action and its robot."""
    actions = trajectory_controllers(world.topics)
    robots = {robot["namespace"]: robot for robot in world.robots if robot["kind"] == "robot"}
    for space, loaded in world.controllers.items():
        for one in loaded:
            controller = names.join(space, one["name"])
            if one["state"] == "running" and controller in actions and space in robots:
                yield controller, actions[controller], robots[space]
