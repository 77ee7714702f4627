"""One topic between the daemon and nodes of ROS 2, both ways.

A message of the daemon is converted once, whatever the number of subscribers, and only while one is there. A message of
ROS 2 is converted in rclpy's thread and published in the daemon by the connection of the node that sent it.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
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
_MOST_KEPT = 100
_MOST_WAITING = 10_000
"""Messages of ROS 2 that wait for the event loop; beyond that the newest are dropped."""
_MOST_ECHOES = 2 * READ_AHEAD
"""More than the daemon queues for the gateway: an echo that comes is still expected."""
_MOST_SENT = 4 * _DEPTH
"""More than ROS 2 queues: a message that comes back is still known."""

Forward = Callable[["TopicBridge", str, Message], DaemonConnection | None]


class Wanted(NamedTuple):
    """What a topic needs in ROS 2 now."""

    publisher: str
    """The node of ours that publishes it there; empty when nobody does."""
    subscriber: str
    """The node of ours that subscribes it there; empty when nobody does."""
    is_latched: bool
    """The daemon keeps messages of it for late subscribers."""
    is_kept: bool
    """So does the publisher in ROS 2, also because a subscriber there asks for it."""
    is_best_effort: bool
    is_transient: bool


_SUBSCRIBED = Wanted._fields.index("is_best_effort")
"""From here on, the fields of `Wanted` are of the subscription."""
NOTHING = Wanted("", "", False, False, False, False)


class Echoes:
    """Keys of messages that will come back, each as often as it was sent. The oldest are given up."""

    def __init__(self) -> None:
        self._expected: Counter[int] = Counter()
        self._came: Counter[int] = Counter()
        self._order: deque[int] = deque()

    @property
    def are_expected(self) -> bool:
        return bool(self._expected)

    def expect(self, key: int) -> None:
        self._expected[key] += 1
        self._order.append(key)
        if len(self._order) > _MOST_ECHOES:
            oldest = self._order.popleft()
            _less(self._came if oldest in self._came else self._expected, oldest)

    def came(self, key: int) -> bool:
        """True for a message that was expected."""
        if key not in self._expected:
            return False
        _less(self._expected, key)
        self._came[key] += 1
        return True


def _less(counts: Counter[int], key: int) -> None:
    counts[key] -= 1
    if counts[key] <= 0:
        del counts[key]


class Sender:
    """A publisher in ROS 2, and what it has sent that comes back, since its topic is subscribed here too."""

    def __init__(self, publisher: Any) -> None:
        self.publisher = publisher
        self._number = 0
        self._sent: dict[int, int] = {}
        """Number -> key of a message that has not come back yet."""

    def send(self, message: Any, key: int | None) -> None:
        """Send a message; with its key when it comes back."""
        if key is not None:
            self._sent[self._number + 1] = key
            self._sent.pop(self._number - _MOST_SENT, None)
        self.publisher.publish(message)
        self._number += 1

    def has_sent(self, number: int | None, key: int) -> bool:
        """True, once, for a message that was sent. Some middlewares give no numbers."""
        if number is None:
            number = next((one for one, sent in list(self._sent.items()) if sent == key), 0)
        if self._sent.get(number) != key:
            return False
        self._sent.pop(number, None)
        return True


class TopicBridge:
    """A topic that the daemon knows, with the type that both sides have."""

    def __init__(self, name: str, conversion: Conversion, participant: Participant, forward: Forward) -> None:
        """`forward(bridge, node, message)` is called in the event loop for a message of a node of ROS 2.

        It publishes the message in the daemon, and returns the connection that it used.
        """
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
        self._seen: dict[tuple[int, int | None], None] = {}
        """Time and number of the last messages: a subscription that is made anew gets those again that are kept."""
        self._sender: Sender | None = None
        self._sender_before: Sender | None = None
        """Its last messages may still come back."""
        self._subscription: Any = None
        self._echoes = Echoes()
        """Messages of ROS 2 published in the daemon: it sends them back, and its subscribers have them."""
        self._waiting: deque[tuple[str, Message, int]] = deque()
        """Node, message and its key."""
        self._draining: asyncio.Task[None] | None = None
        self._problem = ""
        self._is_streaming = False
        self._began_with: Any = None
        """The publisher to which the stream of the daemon began."""

    # --- both -----------------------------------------------------------------------------------------------------

    def set_ends(self, wanted: Wanted, nodes: dict[str, Any]) -> None:
        """Make and end the publisher and the subscription. Only in rclpy's thread."""
        before, self.has, self._nodes = self.has, wanted, nodes
        if (before.publisher, before.is_kept) != (wanted.publisher, wanted.is_kept):
            self._end_publisher(before.publisher)
            if wanted.publisher:
                self._sender = Sender(self._made_publisher())
        if before[_SUBSCRIBED:] != wanted[_SUBSCRIBED:] or before.subscriber != wanted.subscriber:
            self._end_subscription(before.subscriber)
            if wanted.subscriber:
                self._subscription = self._made_subscription()

    def _made_publisher(self) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        is_kept = self.has.is_kept
        profile = QoSProfile(
            depth=_MOST_KEPT if is_kept else _DEPTH,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if is_kept else DurabilityPolicy.VOLATILE,
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
        if self._sender is not None:
            self._sender_before, self._sender = self._sender, None
            if node in self._nodes:
                self._nodes[node].destroy_publisher(self._sender_before.publisher)

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
        is_needed = self._sender is not None and (self.has.is_latched or bool(self.foreign.subscribers))
        goes_on = not self.has.is_kept or self._sender is self._began_with
        if is_needed == self._is_streaming and (goes_on or not is_needed):
            return
        if self._is_streaming:
            daemon.unsubscribe(self.name)
        self._is_streaming, self._began_with, self._echoes = False, self._sender, Echoes()
        if is_needed:
            await daemon.subscribe(self.name, self.conversion.name, READ_AHEAD, take=self._send)
            self._is_streaming = True

    def _send(self, published: Message) -> None:
        sender = self._sender
        if sender is None:
            return
        message = published["msg"]
        if self._echoes.are_expected and self._echoes.came(self._key(message)):
            return
        try:
            made = self.conversion.to_ros2(message)
            # What comes back has lost what ROS 2 does not have. What is kept comes back with a later subscription, too.
            comes_back = self._subscription is not None or self.has.is_kept
            sender.send(made, self._key(self.conversion.from_ros2(made)) if comes_back else None)
        except Exception as error:  # of rclpy, too: the publisher may just have been ended
            self._tell(f"a message cannot be sent to ROS 2: {error}")

    def _key(self, message: Message) -> int:
        return self._type.key(self._type.pack(message))

    # --- from ROS 2 -----------------------------------------------------------------------------------------------

    def _received(self, message: Any, info: dict[str, Any]) -> None:
        """Convert a message, in rclpy's thread, and hand it to the event loop."""
        identity, number = info.get("publisher_gid"), info.get("publication_sequence_number")
        moment = info["source_timestamp"], number
        if moment in self._seen and moment[0]:  # 0: a middleware that gives no times
            return
        self._seen[moment] = None
        if len(self._seen) > _DEPTH:
            del self._seen[next(iter(self._seen))]
        try:
            converted = self.conversion.from_ros2(message)
            key = self._key(converted)
        except Exception as error:  # a value that the type does not have here, such as a time before 1970
            self._tell(f"a message of ROS 2 is not taken: {error}")
            return
        if self._is_own(identity, number, key):
            return
        publishers = self.foreign.publishers
        source = self.foreign.sources.get(bytes(identity["data"]), "") if identity else ""
        if len(self._waiting) >= _MOST_WAITING:
            self.dropped += 1
            return
        self._waiting.append((source or (publishers[0] if publishers else ""), converted, key))
        if len(self._waiting) == 1:
            self._loop.call_soon_threadsafe(self._hand_over)

    def _is_own(self, identity: dict[str, Any] | None, number: int | None, key: int) -> bool:
        """True for a message that this process has sent.

        Not every rclpy says who the publisher is. Then the number and the content of the message decide.
        """
        if identity is not None and bytes(identity["data"]) in self.foreign.sources:
            return False
        senders = (self._sender, self._sender_before)
        return any(sender.has_sent(number, key) for sender in senders if sender is not None)

    def _hand_over(self) -> None:
        """Publish what waits in the daemon, as far as the connections take it."""
        while self._waiting and self._draining is None:
            source, message, key = self._waiting.popleft()
            if self._is_streaming:
                self._echoes.expect(key)
            try:
                daemon = self._forward(self, source, message)
            except Exception as error:  # one message must not stop the next
                self._tell(f"a message of ROS 2 cannot be published: {error}")
                continue
            if daemon is not None and not daemon.takes_more:
                self._draining = self._loop.create_task(self._drain(daemon))

    async def _drain(self, daemon: DaemonConnection) -> None:
        try:
            await daemon.drain()
        except SlidectlError:
            self._waiting.clear()  # the daemon has ended
        self._draining = None
        self._hand_over()

    def _tell(self, problem: str) -> None:
        if problem != self._problem:
            self._problem = problem
            _log.warning("%s: %s", self.name, problem)
