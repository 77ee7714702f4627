"""The daemon's graph as advertised to apps: channels, services, and which nodes use them.

It is made from the answers of /slidectl/graph. A topic or service that is removed and returns gets another id.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl import msgs
from slidectl.extensions.gateways.foxglove.foxglove_frames import text_frame
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type, ros1_type

if TYPE_CHECKING:
    from slidectl.extensions.gateways.foxglove.app_connection import AppConnection

Message = dict[str, Any]
Users = dict[str, list[str]]
"""Topic or service -> names of its nodes."""


class AppChannel:
    """A topic as advertised to apps."""

    def __init__(self, channel_id: int, topic: str, kind: str) -> None:
        self.id = channel_id
        self.topic = topic
        self.kind = kind
        """The name of the topic's type."""
        self.apps: dict[AppConnection, int] = {}
        """App -> the id that the app gave to its subscription of this channel."""
        self.new: set[AppConnection] = set()
        """The apps that have received no message yet."""
        self.has_failed = False
        """True after a message that ROS 1 cannot hold."""

    @property
    def type(self) -> Ros1Type:
        """The message type. Built on use: most topics are never subscribed."""
        return ros1_type(self.kind)

    def advertisement(self) -> Message:
        """The channel as the protocol describes it."""
        return {"id": self.id, "topic": self.topic, "encoding": "ros1", **_schema(self.kind)}


class AdvertisedService(NamedTuple):
    """A service as advertised to apps."""

    id: int
    name: str
    type: str

    @property
    def request(self) -> str:
        """The type name of the request."""
        return msgs.request_type(self.type)

    @property
    def response(self) -> str:
        """The type name of the response."""
        return msgs.response_type(self.type)

    def advertisement(self) -> Message:
        """The service as the protocol describes it."""
        sides = {"request": self.request, "response": self.response}
        schemas = {side: {"encoding": "ros1", **_schema(kind)} for side, kind in sides.items()}
        return {"id": self.id, "name": self.name, "type": self.type, **schemas}


def _schema(kind: str) -> Message:
    return {"schemaName": kind, "schemaEncoding": "ros1msg", "schema": msgs.full_definition(kind)}


class AdvertisedGraph:
    """The channels and services that apps know. Empty until the first `update`, and after `update({})`."""

    def __init__(self, own_node: str, is_offered: Callable[[Message], bool]) -> None:
        """`is_offered` takes a service of /slidectl/graph and returns whether apps may call it."""
        self._own_node = own_node
        self._is_offered = is_offered
        self.channels: dict[int, AppChannel] = {}
        self.services: dict[int, AdvertisedService] = {}
        self._published: Users = {}
        self._subscribed: Users = {}
        self._provided: Users = {}
        self._channel_ids, self._service_ids = count(1), count(1)

    def types(self) -> dict[str, str]:
        """Topic -> type name."""
        return {channel.topic: channel.kind for channel in self.channels.values()}

    def frames(self) -> list[str]:
        """The frames for a new app."""
        return _advertised(list(self.channels.values()), list(self.services.values()))

    def update(self, state: Message) -> tuple[list[str], list[AppChannel], str]:
        """Replace the graph by `state`. Returns frames for all apps, the removed channels, and a frame with the changed
        connections for the apps that subscribe to the graph, empty without a change.

        A topic without publishers whose only subscriber is the gateway exists only for apps: it counts as removed.
        """
        topics = [
            each for each in state.get("topics", ()) if each["publishers"] or each["subscribers"] != [self._own_node]
        ]
        types = {each["name"]: each["type"] for each in topics}
        provided = {each["name"]: each["type"] for each in state.get("services", ()) if self._is_offered(each)}
        gone = [channel for channel in self.channels.values() if types.get(channel.topic) != channel.kind]
        ended = [each for each in self.services.values() if provided.get(each.name) != each.type]
        for channel in gone:
            del self.channels[channel.id]
        for service in ended:
            del self.services[service.id]
        known, offered = self.types(), {each.name for each in self.services.values()}
        new = [AppChannel(next(self._channel_ids), name, kind) for name, kind in types.items() if name not in known]
        more = [
            AdvertisedService(next(self._service_ids), *each) for each in provided.items() if each[0] not in offered
        ]
        self.channels |= {channel.id: channel for channel in new}
        self.services |= {service.id: service for service in more}
        frames = [text_frame("unadvertise", channelIds=[channel.id for channel in gone])] if gone else []
        frames += [text_frame("unadvertiseServices", serviceIds=[each.id for each in ended])] if ended else []
        return [*frames, *_advertised(new, more)], gone, self._connect(state, topics)

    def connections(self) -> str:
        """The frame with all publishers, subscribers and providers."""
        return _connections(self._published, self._subscribed, self._provided, [], [])

    def _connect(self, state: Message, topics: list[Message]) -> str:
        before = self._published, self._subscribed, self._provided
        self._published = {each["name"]: each["publishers"] for each in topics}
        self._subscribed = {each["name"]: each["subscribers"] for each in topics}
        self._provided = {each["name"]: [each["node"]] for each in state.get("services", ())}
        now = self._published, self._subscribed, self._provided
        if before == now:
            return ""
        published, subscribed, provided = (_changed(one, other) for one, other in zip(before, now, strict=True))
        topics_gone, services_gone = (sorted(before[index].keys() - now[index].keys()) for index in (0, 2))
        return _connections(published, subscribed, provided, topics_gone, services_gone)


def _advertised(channels: list[AppChannel], services: list[AdvertisedService]) -> list[str]:
    frames = [text_frame("advertise", channels=[channel.advertisement() for channel in channels])] if channels else []
    if services:
        frames.append(text_frame("advertiseServices", services=[service.advertisement() for service in services]))
    return frames


def _changed(before: Users, now: Users) -> Users:
    return {name: nodes for name, nodes in now.items() if before.get(name) != nodes}


def _connections(published: Users, subscribed: Users, provided: Users, topics: list[str], services: list[str]) -> str:
    return text_frame(
        "connectionGraphUpdate",
        publishedTopics=[{"name": name, "publisherIds": nodes} for name, nodes in published.items()],
        subscribedTopics=[{"name": name, "subscriberIds": nodes} for name, nodes in subscribed.items()],
        advertisedServices=[{"name": name, "providerIds": nodes} for name, nodes in provided.items()],
        removedTopics=topics,
        removedServices=services,
    )
