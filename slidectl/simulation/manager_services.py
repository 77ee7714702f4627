"""The six services of a robot's controller manager, handled in the same order as in ros_control.

A seventh, `switch_controllers`, is the switch with the field names of ros2_control. A robot of ROS 2 has further ones
(Ros2ManagerServices).

While a switch is armed, all requests wait in a queue, as they do at the manager's mutex. When the world stands still
the switch is finished at once, at the present time; ros_control would hang.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from slidectl.control.controller_interface import State
from slidectl.control.controller_switch import STRICT
from slidectl.control.duration import to_seconds
from slidectl.control.node_handle import Message, Reasons
from slidectl.effects import Effect
from slidectl.errors import Reason, Refused, SlidectlError
from slidectl.msgs.schema import nanoseconds
from slidectl.simulation.clock import Timer
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.control.controller_manager import ControllerManager
    from slidectl.simulation.graph import GraphNode
    from slidectl.simulation.loop import Loop

Act = Callable[[Message, Pending], Message | None]
"""Handles a request. Returns the response, or None when the answer is resolved at the end of a switch."""


class ManagerServices:
    """`/<ns>/controller_manager/*` for one manager.

    Args:
        read_joints: reads the joints outside of a cycle, for controllers that start then.
        loop: knows whether a cycle will come without a request.
    """

    def __init__(
        self, manager: ControllerManager, node: GraphNode, read_joints: Callable[[], None], loop: Loop
    ) -> None:
        self._manager = manager
        self._node = node
        self._read_joints = read_joints
        self._loop = loop
        self._queue: deque[tuple[Act, Message, Pending, Reasons | None]] = deque()
        self._switch: Pending | None = None
        self._after_update: dict[Callable[[], None], Timer] = {}
        """Callbacks for the first update of a controller, with timers."""
        acts: dict[str, tuple[str, Act]] = {
            "list_controllers": ("ListControllers", lambda *_: {"controller": manager.list()}),
            "list_controller_types": (
                "ListControllerTypes",
                lambda *_: {"types": manager.types(), "base_classes": manager.base_classes()},
            ),
            "load_controller": ("LoadController", lambda request, _: {"ok": manager.load(request["name"])}),
            "unload_controller": ("UnloadController", lambda request, _: {"ok": manager.unload(request["name"])}),
            "reload_controller_libraries": (
                "ReloadControllerLibraries",
                lambda request, _: {"ok": manager.reload_libraries(request["force_kill"])},
            ),
            "switch_controller": ("SwitchController", self._start_switch),
        }
        self._own_node = node.child("controller_manager")
        self._advertise("controller_manager_msgs", acts)
        self._own_node.advertise_service("switch_controllers", "slidectl/SwitchControllers", self._switch_as_in_ros2)

    def _advertise(self, package: str, acts: Mapping[str, tuple[str, Act]]) -> None:
        for name, (kind, act) in acts.items():
            effect = Effect.READS if name.startswith("list_") else Effect.WRITES
            self._own_node.advertise_service(name, f"{package}/{kind}", partial(self._enqueue, act), effect)

    def settle(self) -> None:
        """Finish an armed switch and all waits for a first update now, because the world has stopped."""
        for finish in tuple(self._after_update):
            finish()
        if self._switch is not None and self._manager.switching:
            self._read_joints()
            self._manager.manage_switch(self._node.now_ns())

    @property
    def is_busy(self) -> bool:
        """True while a switch or a wait for a controller's first update is open."""
        return self._switch is not None or bool(self._queue or self._after_update)

    def load_file(self, name: str, file: str, class_name: str) -> Pending:
        """Load a user's class from a file under a name; its type becomes the controller's parameter `type`.

        Answered with `ok`. On failure nothing changes. Raises as `ControllerTypes.add_file`, and when the name is not
        free.
        """

        def load(_request: Message, _pending: Pending) -> Message:
            manager, node = self._manager, self._node
            try:
                manager.check_new(name)
            except Refused as error:
                raise Refused(
                    f"cannot load controller {name!r}: {error}", f"slidectl controller reload {name}"
                ) from None
            type_name = manager.known.add_file(file, class_name)
            parameter = f"{name}/type"
            before = node.get_param(parameter, None)
            node.set_param(parameter, type_name)
            ok = manager.load(name)
            if not ok and before is not None:
                node.set_param(parameter, before)
            elif not ok:
                node.delete_param(parameter)
            return {"ok": ok}

        return self._enqueue(load, {})

    def reload(self, name: str, control_period_ns: int) -> Pending:
        """Load the present content of a controller's file: stop the controller if it runs, replace it, start it again.

        An aborted controller is started too. Name, parameters and place in the order of updates stay. Answered with
        `ok` after the first update, or at once when the world stands still. Raises as `ControllerTypes.renewed`, and
        then nothing changes; when the new class fails to load, the old controller goes on.
        """
        manager = self._manager
        if self._switch is not None:
            raise Refused(f"cannot reload controller {name!r}: a switch is under way")
        state = manager.renew(name)
        acts: list[tuple[Act, Message]] = [(lambda *_: {"ok": manager.exchange(name)}, {})]
        strict = {"start_asap": False, "timeout": 0.0, "strictness": STRICT}
        if state is State.RUNNING:
            acts.insert(0, (self._start_switch, {**strict, "start_controllers": [], "stop_controllers": [name]}))
        if state in (State.RUNNING, State.ABORTED):
            acts.append((self._start_switch, {**strict, "start_controllers": [name], "stop_controllers": []}))
            acts.append((partial(self._see_update, name, control_period_ns), {}))
        answers = [self._enqueue(act, request) for act, request in acts]
        return answers[-1].converted(lambda _: {"ok": all(answer.result()["ok"] for answer in answers)})

    def _see_update(self, name: str, control_period_ns: int, _request: Message, answer: Pending) -> None:
        """Resolve `answer` after the first update of a started controller: `ok` is False when it aborted in it."""
        reasons = self._node.reasons

        def finish() -> None:
            timer = self._after_update.pop(finish)
            timer.cancel()
            failure = self._manager.failure_of(name)
            if failure and reasons is not None and failure not in reasons:
                reasons.append(Reason(failure))
            answer.resolve({"ok": not failure})

        self._after_update[finish] = self._loop.graph.timers.after(control_period_ns + self._loop.step_ns, finish)
        if self._loop.stands_still:
            finish()

    def _enqueue(self, act: Act, request: Message) -> Pending:
        pending = Pending()
        self._queue.append((act, request, pending, self._node.reasons))
        self._work()
        return pending

    def _work(self) -> None:
        """Handle queued requests, up to the next switch that needs a cycle."""
        while self._queue and self._switch is None:
            act, request, pending, reasons = self._queue.popleft()
            if pending.cancelled:
                continue
            with self._node.answering(reasons):  # it may have waited for the switch of another request
                self._node.before_entry()  # brings the robot's objects up to date
                try:
                    response = act(request, pending)
                except SlidectlError as error:
                    self._switch = None
                    pending.reject(error)
                else:
                    if response is not None:
                        pending.resolve(response)

    def _switch_as_in_ros2(self, request: Message) -> Pending:
        """Switch controllers by a request with the field names of ros2_control."""
        reasons = self._node.reasons
        return self._enqueue(self._start_switch, as_in_ros1(request)).converted(
            lambda done: {**done.result(), "message": "\n".join(reasons or ())}
        )

    def _start_switch(self, request: Message, answer: Pending) -> Message | None:
        def finish(ok: bool) -> None:
            self._switch = None
            answer.resolve({"ok": ok})
            self._work()

        self._switch = answer
        armed = self._manager.request_switch(
            request["start_controllers"],
            request["stop_controllers"],
            request["strictness"],
            request["start_asap"],
            request["timeout"],
            lambda ok: self._loop.after_cycle(partial(finish, ok)),
        )
        if not armed:
            self._switch = None
            return {"ok": False}
        if self._loop.stands_still:
            self.settle()
        return None


def as_in_ros1(request: Message) -> Message:
    """The request of slidectl/SwitchControllers as that of controller_manager_msgs/SwitchController."""
    return {
        "start_controllers": request["activate_controllers"],
        "stop_controllers": request["deactivate_controllers"],
        "strictness": request["strictness"],
        "start_asap": request["activate_asap"],
        "timeout": to_seconds(nanoseconds(request["timeout"])),
    }
