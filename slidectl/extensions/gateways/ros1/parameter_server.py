"""ROS's Parameter Server API on the daemon's parameters. It stores no values, only the subscribers of changes.

A refusal of the daemon becomes the answer -1 with its reason. Without a daemon, calls wait for one for a limited time.
"""

from __future__ import annotations

import asyncio
import json
import logging
from typing import Any

from slidectl import names
from slidectl.errors import NoDaemon, Refused, SlidectlError
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros1 import api_calls
from slidectl.extensions.gateways.ros1.api_calls import Answered, Api
from slidectl.extensions.gateways.ros1.master import PARAMETERS, Master, NodeCalls

_log = logging.getLogger(__name__)

_DAEMON_LIMIT_S = 10.0
"""Seconds for which calls wait for a daemon, counted from its end: a starting node makes several calls."""
_UNSET = "\0 no such parameter"
"""The default sent with a query; it marks a parameter that is not set."""


class DaemonParameters:
    """The daemon's parameters as Python values."""

    def __init__(self) -> None:
        self._wait_for_daemon()

    def _wait_for_daemon(self) -> None:
        loop = asyncio.get_running_loop()
        self._connected: asyncio.Future[DaemonConnection] = loop.create_future()
        self._wait_until = loop.time() + _DAEMON_LIMIT_S

    def attach(self, connection: DaemonConnection) -> None:
        self._connected.set_result(connection)

    def detach(self) -> None:
        if self._connected.done():
            self._wait_for_daemon()

    async def get(self, key: str) -> Any:
        """The value. Raises KeyError: not set; Refused, NoDaemon."""
        text = (await self._call("get_param", {"name": key, "default": json.dumps(_UNSET)}))["value"]
        if (value := json.loads(text)) == _UNSET:
            raise KeyError(key)
        return value

    async def set(self, key: str, value: Any) -> None:
        """Set a parameter. Raises Refused, with the reason; NoDaemon."""
        try:
            text = json.dumps(value)
        except TypeError:  # bytes; a dateTime is a str
            hint = "slidectl's parameters hold no bytes"
            raise Refused(f"parameter {key}: binary data is not a value", hint) from None
        await self._call("set_param", {"name": key, "value": text})

    async def has(self, key: str) -> bool:
        return bool((await self._call("has_param", {"name": key}))["exists"])

    async def delete(self, key: str) -> None:
        """Delete a parameter. Raises Refused: it is not set, or is in use; NoDaemon."""
        await self._call("delete_param", {"name": key})

    async def names(self) -> list[str]:
        """All names, sorted."""
        return list((await self._call("get_param_names", {}))["names"])

    async def _call(self, service: str, request: dict[str, Any]) -> dict[str, Any]:
        try:
            left_s = max(0.0, self._wait_until - asyncio.get_running_loop().time())
            connection = await asyncio.wait_for(asyncio.shield(self._connected), left_s)
        except TimeoutError:
            raise NoDaemon("slidectl's daemon is not there") from None
        return await connection.call(f"/rosapi/{service}", request)


class ParameterServer:
    """The methods of the API. Subscribers of parameters are registered at the master."""

    def __init__(self, parameters: DaemonParameters, master: Master, calls: NodeCalls) -> None:
        self._parameters = parameters
        self._master = master
        self._registrations = master.registrations
        self._subscribers = master.registrations.kinds[PARAMETERS]
        self._calls = calls
        self._being_set: dict[str, str] = {}
        """Parameter -> node that sets it right now: a node is not notified of its own change."""
        self._changed: dict[str, str | None] = {}
        """Changed parameters whose subscribers are not notified yet -> node that set them."""
        self._telling: asyncio.Task[None] | None = None

    def add_methods(self, api: Api) -> None:
        api.add(self.deleteParam, 0, api_calls.key)
        api.add(self.setParam, 0, api_calls.key, api_calls.not_none("value"))
        api.add(self.getParam, 0, api_calls.key)
        api.add(self.searchParam, 0, api_calls.search_key)
        api.add(self.subscribeParam, 0, api_calls.uri("caller_api"), api_calls.key)
        api.add(self.unsubscribeParam, 0, api_calls.uri("caller_api"), api_calls.key)
        api.add(self.hasParam, False, api_calls.key)
        api.add(self.getParamNames, 0)

    async def deleteParam(self, _: str, key: str) -> Answered:  # noqa: N802
        if key == "/" or not await self._parameters.has(key):
            return -1, f"parameter [{key}] is not set", 0
        try:
            await self._parameters.delete(key)
        except Refused as error:
            return -1, str(error), 0
        return 1, f"parameter {key} deleted", 0

    async def setParam(self, caller: str, key: str, value: Any) -> Answered:  # noqa: N802
        self._being_set[key] = caller
        try:
            await self._parameters.set(key, value)
        except Refused as error:
            return -1, str(error), 0
        finally:
            self._being_set.pop(key, None)
        return 1, f"parameter {key} set", 0

    async def getParam(self, _: str, key: str) -> Answered:  # noqa: N802
        try:
            return 1, f"Parameter [{key}]", await self._parameters.get(key)
        except KeyError:
            return -1, f"Parameter [{key}] is not set", 0

    async def searchParam(self, caller: str, key: str) -> Answered:  # noqa: N802
        """Search the caller's namespace, then those above, for the first part of the name."""
        if key.startswith("~"):
            return 0, "Internal failure: invalid key", 0
        if not caller.startswith("/"):
            return 0, "Internal failure: namespace must be global", 0
        first = key.strip("/").partition("/")[0]
        space = caller
        while True:
            full, sought = names.join(space, key), names.join(space, key if key.startswith("/") else first)
            if await self._parameters.has(sought):
                return 1, f"Found [{full}]", full
            if space == "/" or key.startswith("/"):
                return -1, f"Cannot find parameter [{key}] in an upwards search", ""
            space = names.parent(space)

    async def subscribeParam(self, caller: str, caller_api: str, key: str) -> Answered:  # noqa: N802
        self._master.admit(caller, caller_api)
        self._registrations.add(PARAMETERS, key, caller, caller_api)
        try:
            value = await self._parameters.get(key)
        except KeyError:
            value = {}
        return 1, f"Subscribed to parameter [{key}]", value

    async def unsubscribeParam(self, caller: str, caller_api: str, key: str) -> Answered:  # noqa: N802
        if self._subscribers.get(key, {}).get(caller) == caller_api:
            self._registrations.remove(PARAMETERS, key, caller)
        return 1, f"Unsubscribe to parameter [{key}]", 1

    async def hasParam(self, _: str, key: str) -> Answered:  # noqa: N802
        return 1, key, await self._parameters.has(key)

    async def getParamNames(self, _: str) -> Answered:  # noqa: N802
        return 1, "Parameter names", await self._parameters.names()

    def changed(self, changed: list[str]) -> None:
        """Notify the subscribers of changed parameters, of namespaces above them and of names below them."""
        self._changed.update({name: self._being_set.get(name) for name in changed})
        if self._telling is None or self._telling.done():
            self._telling = asyncio.get_running_loop().create_task(self._tell())

    async def _tell(self) -> None:
        while self._changed:
            name = next(iter(self._changed))
            setter = self._changed.pop(name)
            near = [key for key in self._subscribers if names.is_under(name, key) or names.is_under(key, name)]
            for told in {name if names.is_under(name, key) else key: None for key in near}:
                try:
                    value = await self._parameters.get(told)
                except KeyError:
                    value = {}
                except SlidectlError as error:
                    _log.warning("%s", error)
                    continue
                for key in near:
                    if names.is_under(told, key):
                        self._send(told, key, value, setter)

    def _send(self, told: str, key: str, value: Any, setter: str | None) -> None:
        for node, address in list(self._subscribers.get(key, {}).items()):
            if node == setter:
                continue

            def take(answer: Any, node: str = node) -> None:
                if isinstance(answer, list) and answer[:1] == [-1]:  # the node no longer subscribes it
                    self._registrations.remove(PARAMETERS, key, node)

            self._calls.send(address, "paramUpdate", told if told == "/" else f"{told}/", value, take=take)
