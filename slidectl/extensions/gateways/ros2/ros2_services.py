"""Services between the daemon and nodes of ROS 2, both ways."""

from __future__ import annotations

import asyncio
import logging
import math
from functools import partial
from typing import Any

from slidectl.errors import Refused
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros2.conversion import ServiceConversion
from slidectl.extensions.gateways.ros2.participant import Participant
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

_REASON = ("message", "status_message", "error_message")
"""Fields in which a response of ROS 2 can say why the call failed: its services have nothing else for it."""
_LOOK_EVERY_S = 1.0
"""Wall seconds between two looks whether the provider of a called service is still there."""


class OfferedService:
    """A service of the daemon that nodes of ROS 2 can call."""

    def __init__(
        self,
        name: str,
        node: str,
        conversion: ServiceConversion,
        participant: Participant,
        daemon: DaemonConnection,
    ) -> None:
        self.name = name
        self.node = node
        """The node of ours that offers it."""
        self.type = conversion.name
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
            answer = await self._daemon.call(self.name, given, timeout=math.inf)
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

    def close(self) -> None:
        """Only in rclpy's thread."""
        if self._made is not None:
            self._participant.withdraw(self._owner, self._made)
            self._made = None


class ForeignServices:
    """Calls of services that nodes of ROS 2 provide, by a node of ours."""

    def __init__(self, participant: Participant, node: Any) -> None:
        self._participant = participant
        self._node = node
        self._clients: dict[str, Any] = {}
        self._waiting: dict[tuple[str, int], asyncio.Future[Any]] = {}

    async def call(self, service: str, conversion: ServiceConversion, request: Message) -> Message:
        """Call a service and return its response; without a limit, as long as it is there. Raises Refused."""
        answered: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def begin() -> int:
            if service not in self._clients:
                self._clients[service] = self._participant.client(
                    self._node, conversion.ros2_class, service, partial(self._answered, service)
                )
            number = int(self._clients[service].handle.send_request(conversion.request.to_ros2(request)))
            self._waiting[service, number] = answered
            return number

        number = await self._participant.run(begin)
        try:
            while not (await asyncio.wait([answered], timeout=_LOOK_EVERY_S))[0]:
                client = self._clients.get(service)
                if client is None or not client.service_is_ready():
                    raise Refused(f"{service}: the node of ROS 2 that provides it has ended")
            return conversion.response.from_ros2(answered.result())
        finally:
            self._waiting.pop((service, number), None)

    def _answered(self, service: str, number: int, response: Any) -> None:
        waiting = self._waiting.get((service, number))
        if waiting is not None and not waiting.done():
            waiting.set_result(response)

    def forget(self, services: set[str]) -> None:
        """End the clients of services that are provided no longer. Only in rclpy's thread."""
        for name in [name for name in self._clients if name not in services]:
            self._participant.end_client(self._node, self._clients.pop(name))
