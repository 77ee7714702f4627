"""Services between the daemon and nodes of ROS 2, both ways."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any

from slidectl import names
from slidectl.client.manager import STARTED
from slidectl.errors import Refused, TimedOut, UnknownName, quoted
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros2.conversion import ServiceConversion
from slidectl.extensions.gateways.ros2.participant import Participant
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

_CONFIGURE, _LOAD = "slidectl/ConfigureController", "controller_manager_msgs/LoadController"
_OF_ROS2 = {"slidectl/ListControllers": "list_controllers", "slidectl/SwitchControllers": "switch_controller"}
"""Types of services that a manager has beside those of ROS 1 of the same purpose -> their names in ROS 2."""
_OF_ROS1 = ("controller_manager_msgs/ListControllers", "controller_manager_msgs/SwitchController")

_REASON = ("message", "status_message", "error_message")
"""Fields in which a response of ROS 2 can say why the call failed: its services have nothing else for it."""
_LOOK_EVERY_S, _LONGEST_CALL_S = 1.0, 600.0
"""Wall seconds between two looks whether the provider of a called service is still there, and for a whole call: the
daemon does not say that its caller waits no longer."""


class OfferedService:
    """A service of the daemon that nodes of ROS 2 can call."""

    def __init__(
        self,
        name: str,
        node: str,
        conversion: ServiceConversion,
        participant: Participant,
        daemon: DaemonConnection,
        service: str = "",
    ) -> None:
        """`service` is its name in the daemon; empty: the same as in ROS 2, `name`."""
        self.name = name
        self.node = node
        """The node of ours that offers it."""
        self.type = conversion.name
        self._service = service or name
        self._conversion = conversion
        self._participant = participant
        self._daemon = daemon
        self._made: Any = None
        self._owner: Any = None

    def open(self, node: Any) -> None:
        """Offer it by this node of ours. Only in rclpy's thread."""
        self._owner = node
        self._made = self._participant.offer(node, self._conversion.ros2_class, self.name, self._answer)

    async def _answer(self, request: Any) -> Any:
        try:
            given = self._conversion.request.from_ros2(request)
            answer = await self._call(given)
            text = "\n".join(self._daemon.reasons)
            response = self._conversion.response.to_ros2(answer)
        except Exception as error:  # every request is answered
            text = self._daemon.failure_of(error)
            response = self._conversion.ros2_class.Response()
        if text:
            _log.warning("a node of ROS 2 called %s: %s", self.name, text)
            fields = response.get_fields_and_field_types()
            for name in _REASON:
                if fields.get(name) == "string" and not getattr(response, name):
                    setattr(response, name, text)
        return response

    async def _call(self, request: Message) -> Message:
        return await self._daemon.call(self._service, request, timeout=math.inf)

    def close(self) -> None:
        """Only in rclpy's thread."""
        if self._made is not None:
            self._participant.withdraw(self._owner, self._made)
            self._made = None


class ConfigureOfRos1(OfferedService):
    """The `configure_controller` of a manager as in ROS 1, whose controllers are configured when they are loaded."""

    async def _call(self, request: Message) -> Message:
        manager, name = names.parent(self.name), request["name"]
        answer = await self._daemon.call(f"{manager}/list_controllers")
        states = {one["name"]: one["state"] for one in answer["controller"]}
        if name not in states:
            raise UnknownName("controller", name, list(states), "that is loaded")
        if states[name] in STARTED:
            raise Refused(f"cannot configure controller {quoted(name)}: it is {states[name]}")
        return {"ok": True}


def as_in_ros2(services: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Services of the daemon, given as in /slidectl/graph, by their names in ROS 2; `serves` is the daemon's.

    A manager has each service once: with the fields of ROS 2 if its robot is of ROS 2, else with those of ROS 1, and
    then a ConfigureOfRos1 beside them, which serves nothing of the daemon.
    """
    of_ros2 = {names.parent(one["name"]) for one in services if one["type"] == _CONFIGURE}
    found: dict[str, dict[str, Any]] = {}
    for one in services:
        manager, _, own = one["name"].rpartition("/")
        if one["type"] in _OF_ROS2:
            if manager in of_ros2:
                name = f"{manager}/{_OF_ROS2[one['type']]}"
                found[name] = {**one, "name": name, "serves": one["name"]}
        elif one["type"] in _OF_ROS1:
            if manager not in of_ros2:
                found[one["name"]] = {**one, "serves": one["name"]}
        else:
            found[one["name"]] = {**one, "serves": one["name"]}
        if one["type"] == _LOAD and own == "load_controller" and manager not in of_ros2:
            name = f"{manager}/configure_controller"
            found.setdefault(name, {**one, "name": name, "type": _CONFIGURE, "serves": ""})
    return list(found.values())


class ForeignServices:
    """Calls of services that nodes of ROS 2 provide, by a node of ours."""

    def __init__(self, participant: Participant, node: Any) -> None:
        self._participant = participant
        self._node = node
        self._clients: dict[str, Any] = {}
        self._waiting: dict[tuple[Any, int], asyncio.Future[Any]] = {}
        """Client and number of a request -> its response."""

    async def call(self, service: str, conversion: ServiceConversion, request: Message) -> Message:
        """Call a service and return its response. Raises Refused: its provider has ended; TimedOut."""
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def begin() -> tuple[Any, int]:
            used = self._clients.get(service)
            if used is None:
                used = self._participant.client(self._node, conversion.ros2_class, service, self._answered)
                self._clients[service] = used
            sent = used, int(used.handle.send_request(conversion.request.to_ros2(request)))
            self._waiting[sent] = answered
            return sent

        sent = await self._participant.run(begin)
        client: Any = sent[0]
        until_s = loop.time() + _LONGEST_CALL_S
        try:
            while not (await asyncio.wait([answered], timeout=_LOOK_EVERY_S))[0]:
                if self._clients.get(service) is not client or not sent[0].service_is_ready():
                    raise Refused(f"{service}: the node of ROS 2 that provides it has ended")
                if loop.time() > until_s:
                    raise TimedOut(f"{service}: its node in ROS 2 did not answer within {_LONGEST_CALL_S:g} s")
            return conversion.response.from_ros2(answered.result())
        finally:
            self._waiting.pop(sent, None)

    def _answered(self, client: Any, number: int, response: Any) -> None:
        waiting = self._waiting.get((client, number))
        if waiting is not None and not waiting.done():
            waiting.set_result(response)

    def forget(self, services: set[str]) -> None:
        """End the clients of services that are provided no longer. Only in rclpy's thread."""
        for name in [name for name in self._clients if name not in services]:
            self._participant.end_client(self._node, self._clients.pop(name))
