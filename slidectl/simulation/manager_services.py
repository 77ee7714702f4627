"""The six services of a robot's controller manager, in the order in which ros_control would carry them out.

While a switch is armed all of them queue behind it, as behind the manager's mutex. When the world stands still
the switch is finished at once, at the present time; ros_control would hang.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message, Reasons
from slidectl.errors import SlidectlError
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.control.controller_manager import ControllerManager
    from slidectl.simulation.graph import GraphNode
    from slidectl.simulation.loop import Loop

Act = Callable[[Message, Pending], None]
"""Carries out a request; the answer is settled then, or when its switch is done."""


class ManagerServices:
    """`/<ns>/controller_manager/*` for one manager.

    Args:
        look: reads the joints outside of a cycle, for controllers that start then.
        loop: says whether a cycle will come by itself.
    """

    def __init__(self, manager: ControllerManager, node: GraphNode, look: Callable[[], None], loop: Loop) -> None:
        self._manager = manager
        self._node = node
        self._look = look
        self._loop = loop
        self._queue: deque[tuple[Callable[[Pending], None], Pending, Reasons | None]] = deque()
        self._switch: Pending | None = None
        self._advertise()

    def settle(self) -> None:
        """Finish an armed switch now, because the world has come to a stand."""
        if self._switch is not None and self._manager.switching:
            self._look()
            self._manager.manage_switch(self._node.now_ns())

    def _advertise(self) -> None:
        offers: dict[str, tuple[str, Act]] = {
            "list_controllers": ("ListControllers", self._list),
            "list_controller_types": ("ListControllerTypes", self._types),
            "load_controller": ("LoadController", self._load),
            "unload_controller": ("UnloadController", self._unload),
            "switch_controller": ("SwitchController", self._start_switch),
            "reload_controller_libraries": ("ReloadControllerLibraries", self._reload),
        }
        services = self._node.child("controller_manager")
        for name, (kind, act) in offers.items():
            services.advertise_service(name, f"controller_manager_msgs/{kind}", self._queued(act))

    def _queued(self, act: Act) -> Callable[[Message], Pending]:
        def handle(request: Message) -> Pending:
            pending = Pending()
            self._queue.append((lambda answer: act(request, answer), pending, self._node.reasons))
            self._work()
            return pending

        return handle

    def _work(self) -> None:
        """Carry out what is queued, up to the next switch that needs a cycle."""
        while self._queue and self._switch is None:
            act, pending, reasons = self._queue.popleft()
            if not pending.cancelled:
                with self._node.answering(reasons):  # it may have waited for the switch of another request
                    self._carry_out(act, pending)

    def _carry_out(self, act: Callable[[Pending], None], pending: Pending) -> None:
        try:
            act(pending)
        except SlidectlError as error:
            self._switch = None
            pending.reject(error)

    def _list(self, _request: Message, answer: Pending) -> None:
        answer.resolve({"controller": self._manager.list()})

    def _types(self, _request: Message, answer: Pending) -> None:
        answer.resolve({"types": self._manager.types(), "base_classes": self._manager.base_classes()})

    def _load(self, request: Message, answer: Pending) -> None:
        answer.resolve({"ok": self._manager.load(request["name"])})

    def _unload(self, request: Message, answer: Pending) -> None:
        answer.resolve({"ok": self._manager.unload(request["name"])})

    def _reload(self, request: Message, answer: Pending) -> None:
        answer.resolve({"ok": self._manager.reload_libraries(request["force_kill"])})

    def _start_switch(self, request: Message, answer: Pending) -> None:
        self._switch = answer
        armed = self._manager.request_switch(
            request["start_controllers"],
            request["stop_controllers"],
            request["strictness"],
            request["start_asap"],
            request["timeout"],
            lambda ok: self._loop.after_cycle(lambda: self._finish_switch(answer, ok)),
        )
        if not armed:
            self._switch = None
            answer.resolve({"ok": False})
        elif self._loop.stands_still:
            self.settle()

    def _finish_switch(self, answer: Pending, ok: bool) -> None:
        self._switch = None
        answer.resolve({"ok": ok})
        self._work()
