"""Registration of slidectl as one node at a ROS master that is another program.

Everything in the daemon is registered under one node name. The master's state is read once a second, so that a
restarted master gets all registrations again. The daemon's parameters are set at the master, and changes of them there
are set in the daemon; the master's other parameters are not copied.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from typing import Any

from slidectl import names
from slidectl.errors import Refused, SlidectlError, cut
from slidectl.extensions.gateways.ros1 import xmlrpc
from slidectl.extensions.gateways.ros1.api_calls import ANY_TYPE
from slidectl.extensions.gateways.ros1.data_plane import DataPlane
from slidectl.extensions.gateways.ros1.master import MOST_NODES
from slidectl.extensions.gateways.ros1.native_graph import OWN_NODE, NativeGraph
from slidectl.extensions.gateways.ros1.parameter_server import DaemonParameters
from slidectl.extensions.gateways.tasks import Tasks

_log = logging.getLogger(__name__)

_ASK_EVERY_S = 1.0
_LOOK_UP_EVERY = 10
"""In one of this many rounds all addresses are looked up again: a restarted node may have another address."""
_LEAVE_LIMIT_S = 5.0
_CALLS_AT_ONCE = 16
"""Simultaneous calls to the master: a world has more than a hundred registrations."""
_NOT_MIRRORED = ("run_id", "rosversion", "rosdistro", "roslaunch", "use_sim_time")
"""Parameters that belong to the master itself."""


class _Denied(Refused):
    """The master has answered with a refusal."""


class JoinedMaster:
    """The master at `uri`."""

    def __init__(self, uri: str, natives: NativeGraph, data: DataPlane, parameters: DaemonParameters) -> None:
        self.uri = uri
        self._node = OWN_NODE
        self._address = self._service_uri = ""
        self._natives = natives
        self._data = data
        self._parameters = parameters
        self._wake = asyncio.Event()
        self._rounds = 0
        self._failure = ""
        self._is_crowded = self._is_synchronizing = False
        self._pid: Any = None
        self._addresses: dict[str, str] = {}
        self._providers: dict[str, tuple[str, str]] = {}
        self._told: dict[str, tuple[str, dict[str, str], set[str]]] = {}
        """Topic -> what was passed to the data plane last: type, publishers with their addresses, subscribers."""
        self._mirrored: set[str] = set()
        """Top-level parameter names that are subscribed at the master."""
        self._changed: dict[str, None] = {}
        """Parameters whose change has not been sent to the master."""
        self._taken: set[str] = set()
        """Parameters being set in the daemon because of a change at the master; they are not sent back."""
        self._tasks = Tasks()

    # --- for the gateway ----------------------------------------------------------------------------------------

    async def check(self) -> None:
        """Check that a ROS master answers at the URI. Raises Refused."""
        try:
            await self._call("getPid")
        except SlidectlError as error:
            hint = "start it with: roscore; without --master this gateway is one"
            raise Refused(f"no ROS master answers at {self.uri}: {error.message}", hint) from None

    def start(self, node: str, address: str, service_uri: str) -> None:
        """Begin or continue synchronizing, with this node name and the addresses of its slave API and its services."""
        self._node, self._address, self._service_uri = node, address, service_uri
        self._told.clear()
        self._pid = None  # a restarted daemon may have other parameters
        self._wake.set()
        if not self._is_synchronizing:
            self._is_synchronizing = True
            self._tasks.begin(self._synchronize_for_ever())

    def natives_changed(self) -> None:
        self._wake.set()

    def parameters_changed(self, changed: list[str]) -> None:
        """Queue parameters or namespaces of the daemon that were set or deleted, to be sent to the master."""
        self._changed.update(dict.fromkeys(name for name in changed if name not in self._taken))
        self._wake.set()

    async def leave(self) -> None:
        """Unregister everything."""
        self._tasks.cancel()
        self._natives.take({"topics": [], "services": []}, lambda _: True)
        try:
            async with asyncio.timeout(_LEAVE_LIMIT_S):
                await self._register(_state(await self._call("getSystemState")))
        except (SlidectlError, TimeoutError) as error:
            _log.info("the master at %s was not told that we leave: %s", self.uri, error)

    # --- what the master tells us -------------------------------------------------------------------------------

    def publisher_update(self, _topic: str, publishers: list[str]) -> None:
        if not set(publishers) <= set(self._addresses.values()):
            self._rounds = 0
        self._wake.set()

    def param_update(self, key: str, value: Any) -> None:
        self._tasks.begin(self._take_parameter(key, value))

    def shut_down(self, reason: str) -> None:
        """End the gateway: another node has taken its name, and ROS nodes end in that case."""
        _log.warning("the master at %s shuts us down: %s", self.uri, reason)
        os.kill(os.getpid(), signal.SIGTERM)

    # --- registrations ------------------------------------------------------------------------------------------

    async def _synchronize_for_ever(self) -> None:
        while True:
            try:
                await self._synchronize()
                if self._failure:
                    _log.warning("the master at %s answers again", self.uri)
                self._failure = ""
            except SlidectlError as error:
                if not self._failure:
                    _log.warning("%s; trying again", error)
                self._failure = str(error)
                self._pid = None
            except Exception:  # an internal error in one round must not stop the next
                _log.exception("a round with the master at %s", self.uri)
            try:
                async with asyncio.timeout(_ASK_EVERY_S):
                    await self._wake.wait()
            except TimeoutError:
                pass
            self._wake.clear()

    async def _synchronize(self) -> None:
        state = _state(await self._call("getSystemState"))
        await self._register(state)
        types = dict(_pairs(await self._call("getTopicTypes"), str))
        await self._tell(state, types)
        pid = await self._call("getPid")
        if pid != self._pid:
            self._mirrored.clear()
            for name in await self._parameters.names():  # one by one: other nodes may use the same namespaces
                await self._set_there(name)
            if not await self._call("hasParam", "/use_sim_time"):
                await self._call("setParam", "/use_sim_time", True)  # as Gazebo does
            self._pid = pid
        while self._changed:
            await self._set_there(next(iter(self._changed)))

    async def _register(self, state: list[dict[str, list[str]]]) -> None:
        """Register what the master lacks, and unregister what no longer exists."""
        natives, address, service_uri = self._natives, self._address, self._service_uri
        there = [{key for key, nodes in kind.items() if self._node in nodes} for kind in state]
        calls: list[tuple[str, ...]] = []
        for kind, known, wanted in (
            ("Publisher", there[0], natives.publishers),
            ("Subscriber", there[1], natives.subscribers),
        ):
            calls += [(f"register{kind}", topic, natives.types[topic], address) for topic in wanted.keys() - known]
            calls += [(f"unregister{kind}", topic, address) for topic in known - wanted.keys()]
        # A service that another node provides stays that node's.
        new = [service for service in natives.services.keys() - there[2] if not state[2].get(service)]
        calls += [("registerService", service, service_uri, address) for service in new]
        calls += [("unregisterService", service, service_uri) for service in there[2] - natives.services.keys()]
        for begin in range(0, len(calls), _CALLS_AT_ONCE):
            await asyncio.gather(*(self._call(*call) for call in calls[begin : begin + _CALLS_AT_ONCE]))

    async def _tell(self, state: list[dict[str, list[str]]], types: dict[str, str]) -> None:
        """Pass the foreign nodes' topics and services to the data plane."""
        present = {node for kind in state for nodes in kind.values() for node in nodes} - {self._node}
        if len(present) > MOST_NODES:
            if not self._is_crowded:
                _log.warning("the master has %d nodes: slidectl knows %d of them", len(present), MOST_NODES)
            present = set(sorted(present)[:MOST_NODES])
        self._is_crowded = len(present) == MOST_NODES
        publishers, subscribers, services = (
            {key: known for key, nodes in kind.items() if (known := [node for node in nodes if node in present])}
            for kind in state
        )
        self._rounds += 1
        if self._rounds % _LOOK_UP_EVERY == 1:
            self._providers.clear()
            for node in list(self._addresses):
                self._addresses[node] = await self._lookup("lookupNode", node)
        for node in self._addresses.keys() - present:
            del self._addresses[node]
            self._data.node_gone(node)
        for node in present - self._addresses.keys():
            self._addresses[node] = await self._lookup("lookupNode", node)
        for topic in {*publishers, *subscribers, *self._told}:
            addresses = {node: uri for node in publishers.get(topic, ()) if (uri := self._addresses[node])}
            told = (types.get(topic, ANY_TYPE), addresses, set(subscribers.get(topic, ())))
            if told != self._told.get(topic):
                self._data.set_foreign_topic(topic, *told)
            self._told[topic] = told
            if topic not in publishers and topic not in subscribers:
                del self._told[topic]
        self._providers = {service: known for service, known in self._providers.items() if service in services}
        for service in services.keys() - self._providers.keys():
            self._providers[service] = (services[service][0], await self._lookup("lookupService", service))
        self._data.set_foreign_services({service: known for service, known in self._providers.items() if known[1]})

    # --- parameters ---------------------------------------------------------------------------------------------

    async def _set_there(self, name: str) -> None:
        """Set the parameter at the master, or delete it if the daemon has none, and subscribe changes of it."""
        self._changed.pop(name, None)
        top = name.split("/")[1]
        if top in _NOT_MIRRORED or not top:
            return
        try:
            await self._call("setParam", name, await self._parameters.get(name))
        except KeyError:
            if await self._call("hasParam", name):
                await self._call("deleteParam", name)
        if top not in self._mirrored:
            self._mirrored.add(top)
            await self._call("subscribeParam", self._address, f"/{top}")

    async def _take_parameter(self, key: str, value: Any) -> None:
        """Set a parameter of the master in the daemon; an empty value deletes it. A refusal is undone at the master."""
        key = "/" + key.strip("/")
        if names.is_under("/use_sim_time", key):
            return
        self._taken.add(key)
        refused = False
        try:
            if value == {} and await self._parameters.has(key):
                await self._parameters.delete(key)
            elif value != {}:
                await self._parameters.set(key, value)
        except Refused as error:
            _log.warning("parameter %s was set at the master, and is refused: %s", key, error)
            refused = True
        except SlidectlError as error:
            _log.warning("parameter %s was set at the master: %s", key, error)
        finally:
            self._taken.discard(key)
        if refused:
            self.parameters_changed([key])

    # --- inside -------------------------------------------------------------------------------------------------

    async def _call(self, method: str, *arguments: Any) -> Any:
        """Call the master and return its value. Raises _Denied: it refuses; Refused: no or invalid answer; TimedOut."""
        answer = await xmlrpc.call(self.uri, method, self._node, *arguments)
        if not isinstance(answer, list) or len(answer) != 3 or not isinstance(answer[0], int):
            raise Refused(f"{self.uri} answers {method} with nonsense: {cut(repr(answer), 120)}")
        if answer[0] != 1:
            raise _Denied(f"the master at {self.uri} answers {method}: {cut(str(answer[1]))}")
        return answer[2]

    async def _lookup(self, method: str, name: str) -> str:
        """The address of a node or a service; empty when it no longer exists."""
        try:
            address = await self._call(method, name)
        except _Denied:
            return ""
        if not isinstance(address, str):
            raise Refused(f"{self.uri} answers {method} with nonsense: {cut(repr(address), 120)}")
        return address


def _state(answer: Any) -> list[dict[str, list[str]]]:
    """Parse getSystemState: publishers, subscribers and providers by name. Raises Refused."""
    if not isinstance(answer, list) or len(answer) != 3:
        raise Refused("the master answers getSystemState with nonsense")
    return [
        {key: [node for node in nodes if isinstance(node, str)] for key, nodes in _pairs(kind, list)} for kind in answer
    ]


def _pairs(answer: Any, kind: type) -> list[tuple[str, Any]]:
    """Check that the answer is a list of names, each with a value of type `kind`. Raises Refused."""
    if not isinstance(answer, list) or not all(
        isinstance(each, list) and len(each) == 2 and isinstance(each[0], str) and isinstance(each[1], kind)
        for each in answer
    ):
        raise Refused("the master answers with nonsense", "is that a ROS 1 master?")
    return [(name, value) for name, value in answer]
