"""One topic between the daemon and nodes of ROS 2, both ways.

A message of the daemon is converted once, whatever the number of subscribers, and only while one is there. A message of
ROS 2 is converted in rclpy's thread and published in the daemon by the connection of the node that sent it.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from slidectl.errors import SlidectlError
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.gateways.ros2.conversion import Conversion
from slidectl.extensions.gateways.ros2.participant import Participant
from slidectl.extensions.gateways.ros2.ros2_graph import UNUSED
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

READ_AHEAD = 10_000
"""Messages that the daemon queues for the gateway: ten seconds at 1 kHz, in case the CPU is busy."""
_DEPTH = 1000
"""Messages of a topic that ROS 2 queues for a slow reader, either way."""
_MOST_LATCHED = 100
_MOST_WAITING = 10_000
"""Messages of ROS 2 that wait for the event loop; beyond that the newest are dropped."""
_MOST_ECHOES = 1000

Forward = Callable[["TopicBridge", str, Message], None]


class Wanted(NamedTuple):
    """What a topic needs in ROS 2 now."""

    publisher: str
    """The node of ours that publishes it there; empty when nobody does."""
    subscriber: str
    """The node of ours that subscribes it there; empty when nobody does."""
    is_latched: bool
    is_best_effort: bool
    is_transient: bool


NOTHING = Wanted("", "", False, False, False)


class TopicBridge:
    """A topic that the daemon knows, with the type that both sides have."""

    def __init__(self, name: str, conversion: Conversion, participant: Participant, forward: Forward) -> None:
        """`forward(bridge, node, message)` is called in the event loop for a message of a node of ROS 2."""
        self.name = name
        self.conversion = conversion
        self.has = NOTHING
        self.foreign = UNUSED
        self.dropped = 0
        self._type = ros1_type(conversion.name)
        self._participant = participant
        self._forward = forward
        self._loop = asyncio.get_running_loop()
        self._nodes: dict[str, Any] = {}
        self._publisher: Any = None
        self._subscription: Any = None
        self._sent: deque[int] = deque(maxlen=_MOST_ECHOES)
        """Keys of messages sent to ROS 2 while it is subscribed here too: they come back by that subscription."""
        self._echoes: deque[int] = deque(maxlen=_MOST_ECHOES)
        """Keys of messages of ROS 2 published in the daemon: it sends them back, and its subscribers have them."""
        self._waiting: deque[tuple[str, Message]] = deque()
        self._problem = ""
        self._is_streaming = False
        self._began_with: Any = None
        """The publisher to which the stream of the daemon began."""

    # --- both -----------------------------------------------------------------------------------------------------

    def set_ends(self, wanted: Wanted, nodes: dict[str, Any]) -> None:
        """Make and end the publisher and the subscription. Only in rclpy's thread."""
        before, self.has, self._nodes = self.has, wanted, nodes
        if (before.publisher, before.is_latched) != (wanted.publisher, wanted.is_latched):
            self._end_publisher(before.publisher)
            if wanted.publisher:
                self._publisher = self._made_publisher()
        if before._replace(publisher="", is_latched=False) != wanted._replace(publisher="", is_latched=False):
            self._end_subscription(before.subscriber)
            if wanted.subscriber:
                self._subscription = self._made_subscription()

    def _made_publisher(self) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        is_latched = self.has.is_latched
        profile = QoSProfile(
            depth=_MOST_LATCHED if is_latched else _DEPTH,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
        )
        return self._nodes[self.has.publisher].create_publisher(self.conversion.ros2_class, self.name, profile)

    def _made_subscription(self) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        profile = QoSProfile(
            depth=_DEPTH,
            reliability=ReliabilityPolicy.BEST_EFFORT if self.has.is_best_effort else ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self.has.is_transient else DurabilityPolicy.VOLATILE,
        )

        node = self._nodes[self.has.subscriber]
        return self._participant.subscribe(node, self.conversion.ros2_class, self.name, profile, self._received)

    def _end_publisher(self, node: str) -> None:
        if self._publisher is not None:
            publisher, self._publisher = self._publisher, None
            if node in self._nodes:
                self._nodes[node].destroy_publisher(publisher)

    def _end_subscription(self, node: str) -> None:
        if self._subscription is not None:
            subscription, self._subscription = self._subscription, None
            if node in self._nodes:
                self._participant.unsubscribe(self._nodes[node], subscription)

    # --- to ROS 2 -------------------------------------------------------------------------------------------------

    async def set_stream(self, daemon: DaemonConnection) -> None:
        """Follow the topic in the daemon while somebody in ROS 2 needs it. Raises Refused, NoDaemon.

        A new publisher of latched messages gets those that the daemon has.
        """
        is_needed = bool(self.has.publisher) and (self.has.is_latched or bool(self.foreign.subscribers))
        goes_on = not self.has.is_latched or self._publisher is self._began_with
        if is_needed == self._is_streaming and (goes_on or not is_needed):
            return
        if self._is_streaming:
            daemon.unsubscribe(self.name)
        self._is_streaming, self._began_with = is_needed, self._publisher
        if is_needed:
            await daemon.subscribe(self.name, self.conversion.name, READ_AHEAD, take=self._send)

    def _send(self, published: Message) -> None:
        publisher = self._publisher
        if publisher is None:
            return
        message = published["msg"]
        if self._echoes and (key := self._key(message)) in self._echoes:
            self._echoes.remove(key)
            return
        try:
            if self._subscription is not None:
                self._sent.append(self._key(message))
            publisher.publish(self.conversion.to_ros2(message))
        except Exception as error:  # of rclpy, too: the publisher may just have been ended
            self._tell(f"a message cannot be sent to ROS 2: {error}")

    def _key(self, message: Message) -> int:
        return self._type.key(self._type.pack(message))

    # --- from ROS 2 -----------------------------------------------------------------------------------------------

    def _received(self, message: Any, info: dict[str, Any]) -> None:
        """Convert a message, in rclpy's thread, and hand it to the event loop."""
        identity = info.get("publisher_gid")
        try:
            converted = self.conversion.from_ros2(message)
            if self._is_own(identity, converted):
                return
        except Exception as error:  # a value that the type does not have here, such as a time before 1970
            self._tell(f"a message of ROS 2 is not taken: {error}")
            return
        publishers = self.foreign.publishers
        source = self.foreign.sources.get(bytes(identity["data"]), "") if identity else ""
        if len(self._waiting) >= _MOST_WAITING:
            self.dropped += 1
            return
        self._waiting.append((source or (publishers[0] if publishers else ""), converted))
        if len(self._waiting) == 1:
            self._loop.call_soon_threadsafe(self._hand_over)

    def _is_own(self, identity: dict[str, Any] | None, message: Message) -> bool:
        """True for a message that this process has sent."""
        if self._publisher is None or not self._sent:
            return False
        if identity is not None and bytes(identity["data"]) in self.foreign.sources:
            return False
        key = self._key(message)
        if key in self._sent:
            self._sent.remove(key)
            return True
        return False

    def _hand_over(self) -> None:
        while self._waiting:
            source, message = self._waiting.popleft()
            if self._is_streaming:
                self._echoes.append(self._key(message))
            try:
                self._forward(self, source, message)
            except SlidectlError as error:
                self._tell(str(error))

    def _tell(self, problem: str) -> None:
        if problem != self._problem:
            self._problem = problem
            _log.warning("%s: %s", self.name, problem)
