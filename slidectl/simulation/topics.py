"""The topic bus: publishers and subscribers by topic, with types and latching; and topics published periodically.

Delivery is a plain call, in the order of subscription, before `publish` returns. There are no queues here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from slidectl import msgs, names
from slidectl.control.node_handle import Message, MessageCallback
from slidectl.errors import Refused, SlidectlError, UnknownName

if TYPE_CHECKING:
    from slidectl.simulation.clock import Timer
    from slidectl.simulation.graph import Graph


class TypeConflict(Refused):
    """A topic exists with another type."""

    def __init__(self, topic: str, known: str, asked: str, users: list[str]) -> None:
        super().__init__(f"{topic} has the type {known}, not {asked}", f"it is used by: {', '.join(users)}")


def hand_on(message: Message, callbacks: Sequence[MessageCallback]) -> None:
    """Call all callbacks, and then raise the error of the first one that refused the message."""
    refusal: SlidectlError | None = None
    for callback in callbacks:
        try:
            callback(message)
        except SlidectlError as error:
            refusal = refusal or error
    if refusal is not None:
        raise refusal


class TopicPublisher:
    """One publisher of one topic. Check `wanted` before building a message: there may be no subscriber.

    `sequence` is `header.seq` of the next message; messages without a subscriber count too.
    """

    first: ClassVar[int] = 1
    """`header.seq` of the first message, as in rospy (rostopic pub)."""
    __slots__ = ("_on_close", "last", "latch", "node", "sequence", "topic", "wanted")

    def __init__(self, topic: Topic, node: str, latch: bool, on_close: Callable[[TopicPublisher], None]) -> None:
        self.topic = topic
        self._on_close = on_close
        self.node = node
        self.latch = latch
        self.sequence = self.first
        self.last: Message | None = None
        self.wanted = False

    def publish(self, message: Message) -> None:
        """Deliver a complete message and number its header. The dict must not be changed afterwards.

        Raises SlidectlError: the error of the first subscriber that refused it; all of them have been called.
        """
        if self.topic.has_header:
            message["header"]["seq"] = self.sequence
            self.sequence += 1
        if self.latch:
            self.last = message
        hand_on(message, self.topic.callbacks)

    def first_message(self) -> Message | None:
        """The message that a new subscriber gets at once: the latched one."""
        return self.last

    def close(self) -> None:
        """Stop publishing; a latched message is dropped."""
        self._on_close(self)


class NodePublisher(TopicPublisher):
    """A publisher inside the simulation. As in ROS it gets no error from a subscriber; the subscriber logs it."""

    first = 0  # as in roscpp
    __slots__ = ()

    def publish(self, message: Message) -> None:
        """Deliver a complete message and number its header. The dict must not be changed afterwards."""
        with suppress(SlidectlError):
            super().publish(message)


class _DemandPublisher(NodePublisher):
    """Calls `on_demand` when `wanted` changes."""

    __slots__ = ("_build_first", "_is_wanted", "_on_demand")

    def __init__(
        self, on_demand: Callable[[bool], None], build_first: Callable[[], Message | None], *arguments: Any
    ) -> None:
        self._on_demand = on_demand
        self._build_first = build_first
        self._is_wanted = False
        super().__init__(*arguments)

    @property
    def wanted(self) -> bool:
        return self._is_wanted

    @wanted.setter
    def wanted(self, value: bool) -> None:
        if value != self._is_wanted:
            self._is_wanted = value
            self._on_demand(value)

    def first_message(self) -> Message | None:
        return self._build_first()


class PeriodicTopic:
    """Publishes the result of `build`, every `period_ns` of simulated time, until `close`; only with subscribers.

    When the message comes later, `build` returns None and the message is passed to `publish`.

    Times are multiples of the period, independent of subscribers. While `is_still` returns True (no cycle will come
    without a request), a new subscriber gets the present message at once, as do present ones of a new publisher.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = ("_publisher",)

    def __init__(
        self,
        graph: Graph,
        topic: str,
        type_name: str,
        node: str,
        period_ns: int,
        build: Callable[[], Message | None],
        is_still: Callable[[], bool] = lambda: False,
    ) -> None:
        self._graph = graph
        self._period_ns = period_ns
        self._build = build
        self._timer: Timer | None = None
        kind = partial(_DemandPublisher, self._demand, lambda: build() if is_still() else None)
        self._publisher = graph.topics.advertise(topic, type_name, node, kind=kind)
        if self._publisher.wanted and is_still():
            self._publish()

    def close(self) -> None:
        """Stop publishing."""
        self._demand(False)
        self._publisher.close()

    @property
    def wanted(self) -> bool:
        """True while the topic has subscribers."""
        return self._publisher.wanted

    def _demand(self, wanted: bool) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._graph.timers.every(self._period_ns, self._publish) if wanted else None

    def publish(self, message: Message) -> None:
        """Publish a message that was built later."""
        self._publisher.publish(message)

    def _publish(self) -> None:
        message = self._build()
        if message is not None:
            self.publish(message)


@dataclass(slots=True, eq=False)
class TopicSubscription:
    """One subscriber of one topic."""

    topic: Topic | _ComingTopic
    node: str
    callback: MessageCallback
    _on_close: Callable[[TopicSubscription], None]

    def redirect(self, callback: MessageCallback) -> None:
        """Replace the callback."""
        self.callback = callback
        self.topic.update()

    def close(self) -> None:
        """End the subscription: no more messages are delivered."""
        self._on_close(self)


class Topic:
    """A name, its type, and its users. `callbacks` is a tuple: it may be replaced during a delivery."""

    __slots__ = ("callbacks", "has_header", "interceptors", "name", "publishers", "receivers", "subscriptions", "type")

    def __init__(self, name: str, type_name: str, interceptors: tuple[MessageCallback, ...] = ()) -> None:
        self.name = name
        self.type = type_name
        self.interceptors = interceptors
        """The first receives the messages in place of the receivers, and may hand them on to the next."""
        self.publishers: list[TopicPublisher] = []
        self.subscriptions: list[TopicSubscription] = []
        self.receivers: tuple[MessageCallback, ...] = ()
        self.callbacks: tuple[MessageCallback, ...] = ()
        first = msgs.fields(type_name)[:1]
        self.has_header = any((one.name, one.type) == ("header", "std_msgs/Header") for one in first)

    def nodes(self) -> list[str]:
        """Names of the nodes that publish or subscribe it."""
        return _nodes([*self.publishers, *self.subscriptions])

    def update(self) -> None:
        """Update the callbacks for the present users."""
        # A callback that several subscriptions share is called once for all of them.
        self.receivers = tuple(dict.fromkeys(subscription.callback for subscription in self.subscriptions))
        self.callbacks = self.receivers and (self.interceptors[:1] or self.receivers)
        for publisher in self.publishers:
            publisher.wanted = publisher.latch or bool(self.callbacks)


ANY_TYPE = "*"
"""As the type of a subscription: whatever type the topic has, or will have when it is advertised."""


@dataclass(slots=True, eq=False)
class _ComingTopic:
    """The subscriptions of a topic that does not exist yet and whose type is unknown."""

    name: str
    subscriptions: list[TopicSubscription] = field(default_factory=list)
    publishers: tuple[()] = ()

    def update(self) -> None:
        """Do nothing: there is nothing to deliver yet."""


class Topics:
    """All topics. A topic exists as long as it has a publisher or a subscriber."""

    def __init__(self) -> None:
        self._topics: dict[str, Topic] = {}
        # By node: closing a node must not search all topics, since a client may have created many.
        self._users: dict[str, dict[TopicPublisher | TopicSubscription, None]] = {}
        self._interceptors: dict[str, tuple[MessageCallback, ...]] = {}
        self._coming: dict[str, _ComingTopic] = {}
        self.changes = 0
        """The number of added or removed publishers and subscribers. While it is the same, so is every `wanted`."""
        self.on_change: list[Callable[[], None]] = []
        """Called after each such change."""

    def advertise(
        self,
        topic: str,
        type_name: str,
        node: str,
        latch: bool = False,
        kind: Callable[..., TopicPublisher] = TopicPublisher,
    ) -> TopicPublisher:
        """Create a publisher of `topic`. Raises BadName, TypeConflict. UnknownName: no such message type."""
        entry = self._entry(topic, type_name)
        publisher = kind(entry, node, latch, self._forget)
        entry.publishers.append(publisher)
        self._users.setdefault(node, {})[publisher] = None
        self._update(entry)
        return publisher

    def subscribe(
        self,
        topic: str,
        type_name: str | None,
        node: str,
        callback: MessageCallback,
        latched: MessageCallback | None = None,
    ) -> TopicSubscription:
        """Call back for each message; latched ones at once. Without a type the topic must exist already.

        With ANY_TYPE it need not: the subscription begins with the topic, before its first message.

        Subscriptions may share a callback, which is called once for each message. Then `latched` receives the messages
        that were latched before, for this subscription alone.

        Raises BadName, TypeConflict. UnknownName: no such topic or message type.
        """
        if type_name == ANY_TYPE and topic not in self._topics:
            coming = self._coming.setdefault(names.check_absolute(topic, "topic"), _ComingTopic(topic))
            awaiting = TopicSubscription(coming, node, callback, self._forget)
            coming.subscriptions.append(awaiting)
            self._users.setdefault(node, {})[awaiting] = None
            return awaiting
        known = type_name if type_name not in (None, ANY_TYPE) else self.type_of(topic)
        entry = self._entry(topic, known)
        subscription = TopicSubscription(entry, node, callback, self._forget)
        entry.subscriptions.append(subscription)
        self._users.setdefault(node, {})[subscription] = None
        self._update(entry)
        for publisher in tuple(entry.publishers):
            message = publisher.first_message()
            if message is not None:
                with suppress(SlidectlError):  # the publisher cannot receive an error any more
                    (latched or callback)(message)
        return subscription

    def publish(self, topic: str, type_name: str | None, message: Any, node: str) -> None:
        """Publish for a client: the message is completed and checked. `node` is a publisher until `close_node`.

        Raises:
            BadName, BadMessage, TypeConflict. UnknownName: no such topic (when no type is given) or message type.
            SlidectlError: a subscriber refused it.
        """
        kind = type_name or self.type_of(topic)
        self._agrees(topic, kind)
        checked = msgs.check(kind, message)
        known = self._topics[topic].publishers if topic in self._topics else []
        own = next((publisher for publisher in known if publisher.node == node), None)
        (own or self.advertise(topic, kind, node)).publish(checked)

    def intercept(self, topic: str, interceptor: MessageCallback, begins: bool = True) -> None:
        """Let `interceptor` receive the messages of the topic, except latched ones for later subscribers, and pass them
        on by `hand_on`. Of several the earlier one is first. Not `begins`: it ends."""
        present = self._interceptors.pop(topic, ())
        if not begins:
            present = tuple(one for one in present if one != interceptor)
        elif interceptor not in present:
            present = (*present, interceptor)
        if present:
            self._interceptors[topic] = present
        if topic in self._topics:
            self._topics[topic].interceptors = present
            self._update(self._topics[topic])

    def hand_on(self, topic: str, message: Message, behind: MessageCallback | None = None) -> None:
        """Deliver a message to the present subscribers; with `behind`, one that this interceptor has received, to the
        next interceptor if there is one. Raises the error of a subscriber."""
        if (entry := self._topics.get(topic)) is not None:
            chain = entry.interceptors
            later = chain[chain.index(behind) + 1 :] if behind in chain else ()
            hand_on(message, later[:1] or entry.receivers)

    def names(self) -> list[str]:
        """All topics, sorted."""
        return sorted(self._topics)

    def types(self) -> dict[str, str]:
        """Type of each topic, in the order of the names."""
        return {name: self._topics[name].type for name in self.names()}

    def exists(self, topic: str) -> bool:
        """True when the topic has a publisher or a subscriber."""
        return topic in self._topics

    def type_of(self, topic: str) -> str:
        """The type of a topic. Raises UnknownName when it has no user."""
        return self._known(topic).type

    def publishers(self, topic: str) -> list[str]:
        """Names of the nodes that publish it; none when there is no such topic."""
        return _nodes(self._topics[topic].publishers) if topic in self._topics else []

    def subscribers(self, topic: str) -> list[str]:
        """Names of the nodes that subscribe it; none when there is no such topic."""
        entry = self._topics.get(topic) or self._coming.get(topic)
        return _nodes(entry.subscriptions) if entry is not None else []

    def nodes(self) -> set[str]:
        """Names of all nodes that publish or subscribe something."""
        return set(self._users)

    def published_by(self, node: str) -> list[str]:
        """Names of the topics that the node publishes, sorted."""
        return sorted({user.topic.name for user in self._users.get(node, ()) if isinstance(user, TopicPublisher)})

    def subscribed_by(self, node: str) -> list[str]:
        """Names of the topics that the node subscribes, sorted."""
        return sorted({user.topic.name for user in self._users.get(node, ()) if isinstance(user, TopicSubscription)})

    def close_node(self, node: str) -> None:
        """Close all publishers and subscriptions of a node."""
        for user in list(self._users.get(node, ())):
            user.close()

    def _known(self, topic: str) -> Topic:
        if topic not in self._topics:
            raise UnknownName("topic", topic, self.names())
        return self._topics[topic]

    def _agrees(self, topic: str, type_name: str) -> None:
        msgs.fields(type_name)  # raises UnknownName
        entry = self._topics.get(topic)
        if entry is not None and entry.type != type_name:
            raise TypeConflict(topic, entry.type, type_name, entry.nodes())

    def _entry(self, topic: str, type_name: str) -> Topic:
        self._agrees(topic, type_name)
        if topic not in self._topics:
            entry = Topic(names.check_absolute(topic, "topic"), type_name, self._interceptors.get(topic, ()))
            self._topics[topic] = entry
            coming = self._coming.pop(topic, None)
            for subscription in coming.subscriptions if coming else ():
                subscription.topic = entry
                entry.subscriptions.append(subscription)
        return self._topics[topic]

    def _forget(self, user: TopicPublisher | TopicSubscription) -> None:
        users = self._users.get(user.node, {})
        topic: Topic | _ComingTopic = user.topic
        if user not in users:  # it was removed before
            return
        del users[user]
        if not users:
            del self._users[user.node]
        if isinstance(user, TopicPublisher):
            user.topic.publishers.remove(user)
        else:
            topic.subscriptions.remove(user)
        if isinstance(topic, _ComingTopic):
            if not topic.subscriptions:
                del self._coming[topic.name]
            return
        if not topic.publishers and not topic.subscriptions:
            self._topics.pop(topic.name, None)
        self._update(topic)

    def _update(self, topic: Topic) -> None:
        self.changes += 1
        topic.update()
        for callback in self.on_change:
            callback()


def _nodes(users: Sequence[TopicPublisher | TopicSubscription]) -> list[str]:
    return list(dict.fromkeys(user.node for user in users))
