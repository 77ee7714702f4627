"""The slave API of the daemon's nodes. The path of the address selects the node, for example http://host:port/gazebo.

roscpp omits the path in its calls. That is harmless: it asks the gateway's own node for topics, which has all of them.
"""

from __future__ import annotations

import logging
import os
from typing import Any

from slidectl.errors import cut
from slidectl.extensions.gateways.ros1 import api_calls
from slidectl.extensions.gateways.ros1.api_calls import Answered, Api
from slidectl.extensions.gateways.ros1.data_plane import DataPlane
from slidectl.extensions.gateways.ros1.joined_master import JoinedMaster
from slidectl.extensions.gateways.ros1.native_graph import OWN_NODE, NativeGraph

_log = logging.getLogger(__name__)


class Slave:
    """The slave API of all nodes of the daemon. `joined` is their master if that is another program."""

    def __init__(self, natives: NativeGraph, data: DataPlane, master_uri: str, joined: JoinedMaster | None) -> None:
        self._natives = natives
        self._data = data
        self._master_uri = master_uri
        self._joined = joined
        self._api = Api()
        add = self._api.add
        add(self.getBusStats, [])
        add(self.getBusInfo, [])
        add(self.getMasterUri, "")
        add(self.getUri, "")
        add(self.getName, "")
        add(self.shutdown, 0, api_calls.anything)
        add(self.getPid, -1)
        add(self.getSubscriptions, [])
        add(self.getPublications, [])
        add(self.paramUpdate, -1, api_calls.key, api_calls.anything)
        add(self.publisherUpdate, -1, api_calls.name("topic"), api_calls.publishers)
        add(self.requestTopic, [], api_calls.name("topic"), api_calls.protocols)

    async def answer(self, path: str, method: str, arguments: list[Any]) -> Answered:
        """Answer a call at this path. Raises XmlRpcFault."""
        node = "" if path in ("/", "/RPC2") else "/" + path.strip("/")
        if node not in ("", OWN_NODE) and node not in self._natives.nodes:
            return -1, f"unknown node [{node}]", 0
        return await self._api.answer(method, arguments, node)

    def getBusStats(self, node: str, _: str) -> Answered:  # noqa: N802
        return 1, "", self._data.bus_stats(node)

    def getBusInfo(self, node: str, _: str) -> Answered:  # noqa: N802
        return 1, "bus info", self._data.bus_info(node)

    def getMasterUri(self, _node: str, _: str) -> Answered:  # noqa: N802
        return 1, self._master_uri, self._master_uri

    def getUri(self, node: str, _: str) -> Answered:  # noqa: N802
        return 1, "", self._natives.uri_of(node)

    def getName(self, node: str, _: str) -> Answered:  # noqa: N802
        return 1, "", node

    def shutdown(self, node: str, caller: str, reason: Any) -> Answered:
        """Refuse, except for the master that was joined: no ROS node may end the simulation or one of its clients."""
        if self._joined is not None and caller == "/master":
            self._joined.shut_down(str(reason))
            return 1, "shutdown", 0
        _log.info("%s asks %s to shut down: refused", cut(caller, 120), node or "a node")
        return -1, f"[{node}] is a node of slidectl; the simulation ends with: slidectl daemon stop", 0

    def getPid(self, _node: str, _: str) -> Answered:  # noqa: N802
        return 1, "", os.getpid()

    def getSubscriptions(self, node: str, _: str) -> Answered:  # noqa: N802
        return 1, "subscriptions", self._natives.subscribed_by(node)

    def getPublications(self, node: str, _: str) -> Answered:  # noqa: N802
        return 1, "publications", self._natives.published_by(node)

    def paramUpdate(self, _node: str, _: str, key: str, value: Any) -> Answered:  # noqa: N802
        if self._joined is None:
            return -1, "not subscribed", 0
        self._joined.param_update(key, value)
        return 1, "", 0

    def publisherUpdate(self, _node: str, _: str, topic: str, publishers: list[str]) -> Answered:  # noqa: N802
        if self._joined is not None:
            self._joined.publisher_update(topic, publishers)
        return 1, "", 0

    def requestTopic(self, _node: str, _: str, topic: str, protocols: list[Any]) -> Answered:  # noqa: N802
        return self._data.request_topic(topic, protocols)
