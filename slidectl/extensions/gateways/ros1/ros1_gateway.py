"""The ROS 1 gateway: a master for this machine (or registration at an existing one), and the daemon's nodes in it."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import socket
import uuid
from dataclasses import dataclass
from typing import Any

from slidectl.effects import Effect
from slidectl.errors import NoDaemon, Refused, SlidectlError, UsageError, cut
from slidectl.extensions.gateways.daemon_connection import (
    GRAPH_CHANGES,
    PARAMETER_CHANGES,
    DaemonConnection,
    connect_as,
)
from slidectl.extensions.gateways.gateway import Gateway, GatewayOptions, is_offered
from slidectl.extensions.gateways.ros1 import xmlrpc
from slidectl.extensions.gateways.ros1.api_calls import Answered, Api
from slidectl.extensions.gateways.ros1.data_plane import DataPlane
from slidectl.extensions.gateways.ros1.joined_master import JoinedMaster
from slidectl.extensions.gateways.ros1.master import Master, NodeCalls
from slidectl.extensions.gateways.ros1.native_graph import OWN_NODE, NativeGraph
from slidectl.extensions.gateways.ros1.parameter_server import DaemonParameters, ParameterServer
from slidectl.extensions.gateways.ros1.slave import Slave
from slidectl.paths import InstancePaths
from slidectl.web_access import check_effects, check_users_can_be_told, in_uri

_log = logging.getLogger(__name__)

_LOOPBACK = "127.0.0.1"
_ASK_AGAIN_S = 1.0
_GATHER_S = 0.01
"""Seconds; graph changes within this time are handled together: a spawn makes many."""
_ROSDISTRO, _ROSVERSION = "noetic\n", "1.16.0\n"
"""The values that roscore of the last ROS 1 release sets."""
_ROSOUT = "/rosout"
"""roscore's node, which republishes /rosout on /rosout_agg."""


@dataclass(frozen=True)
class Ros1Options(GatewayOptions):
    """The address to listen on, and the master to join."""

    port: int = 11311
    host: str = "localhost"
    """With localhost, ROS_IP and ROS_HOSTNAME apply."""
    master: str = ""
    """URI of a master to join; by default the gateway is a master itself."""


class Ros1Gateway(Gateway):
    """Two XML-RPC servers, for the master and for the daemon's nodes, and the data plane."""

    Options = Ros1Options

    def __init__(self, options: Ros1Options) -> None:
        super().__init__()
        self._options = options
        self._permitted = check_effects(False, options.allow)
        self._paths: InstancePaths | None = None
        self._proxies: dict[str, DaemonConnection | None] = {}
        """Node names of connections that represent foreign nodes; None while connecting."""
        self._following: asyncio.Task[None] | None = None
        self._graph_changed = asyncio.Event()
        self._main: DaemonConnection | None = None
        self._rosout: DaemonConnection | None = None
        self._servers: list[xmlrpc.XmlRpcServer] = []
        self._master: Master | None = None
        self._joined: JoinedMaster | None = None

    # --- Gateway ------------------------------------------------------------------------------------------------

    async def open(self) -> str:
        """Listen, and return the address to show. Raises as Gateway.open, and UsageError: invalid URI of the master."""
        if master := self._options.master:
            try:
                xmlrpc.host_port_path(master)
            except Refused:
                hint = "write it as http://HOST:11311"
                raise UsageError(f"--master {cut(master, 120)!r} is not the URI of a ROS master", hint) from None
        check_users_can_be_told(self._options.any_user)
        bound, shown = await self._host()
        self._parameters = DaemonParameters()
        self._calls = NodeCalls()
        self._natives = NativeGraph(self._node_uri)
        self._data = DataPlane(OWN_NODE, shown, bound, self._options.any_user)
        try:
            if self._options.master:
                joined = self._joined = JoinedMaster(self._options.master, self._natives, self._data, self._parameters)
                await joined.check()
                await self._open_nodes(Slave(self._natives, self._data, joined.uri, joined), bound, shown)
                return joined.uri
            return await self._open_master(bound, shown)
        except BaseException:
            await self.close()
            raise

    async def attach(self, paths: InstancePaths) -> None:
        self._paths = paths
        self._main = main = await self._connect(OWN_NODE)
        self._parameters.attach(main)
        await main.subscribe(GRAPH_CHANGES, "std_msgs/Empty", take=lambda _: self._graph_changed.set())
        await main.subscribe(PARAMETER_CHANGES, "slidectl/ParameterChanges", take=self._take_changes)
        await self._data.attach(self._connect_proxy, main)
        if self._master is not None:
            await self._set_own_parameters()
            await self._open_rosout()
        await self._take_graph()
        if self._joined is not None:
            self._joined.start(_joined_node(paths), self._node_uri("/"), self._data.service_uri())
        loop = asyncio.get_running_loop()
        self._following = loop.create_task(self._follow_graph())

    async def detach(self) -> None:
        if self._following is not None:
            self._following.cancel()
        self._parameters.detach()
        await self._data.detach()
        self._set_graph({"topics": [], "services": []})
        self._proxies.clear()
        for connection in (self._main, self._rosout):
            if connection is not None:
                connection.close()

    async def close(self) -> None:
        await self.detach()
        if self._joined is not None:
            await self._joined.leave()
        self._calls.close()
        for server in self._servers:
            await server.close()
        await self._data.close()

    def status(self) -> dict[str, Any]:
        counts: dict[str, Any] = {"connections": self._data.connections, "dropped": self._data.dropped}
        if self._master is not None:
            counts["nodes"] = len(self._master.registrations.addresses)
        counts["refused"] = self._data.strangers.refused + sum(server.strangers.refused for server in self._servers)
        return {**counts, "calls": sum(server.connections for server in self._servers)}

    # --- opening ------------------------------------------------------------------------------------------------

    async def _open_master(self, bound: str, shown: str) -> str:
        self._master = Master(self._natives, self._calls, self._data)
        self._parameter_server = ParameterServer(self._parameters, self._master, self._calls)
        api = Api()
        self._master.add_methods(api)
        self._parameter_server.add_methods(api)

        async def answer(path: str, method: str, arguments: list[Any]) -> Answered:
            if path not in ("/", "/RPC2"):
                raise xmlrpc.XmlRpcFault(1, f"the master is at /, nobody is at {path!r}")
            return await api.answer(method, arguments)

        port = await self._listen(answer, bound, self._options.port)
        self._master.uri = uri = f"http://{in_uri(shown)}:{port}/"
        if (set_uri := os.environ.get("ROS_MASTER_URI", "").rstrip("/")) and not set_uri.endswith(f":{port}"):
            _log.warning("ROS_MASTER_URI is %s here: nodes with that do not find this master, at %s", set_uri, uri)
        await self._open_nodes(Slave(self._natives, self._data, uri, None), bound, shown)
        return uri.rstrip("/")

    async def _open_nodes(self, slave: Slave, bound: str, shown: str) -> None:
        """Serve the slave API, and listen for TCPROS."""
        port = await self._listen(slave.answer, bound, 0)
        self._nodes_at = f"http://{in_uri(shown)}:{port}"
        await self._data.open()
        self._natives.service_uri = self._data.service_uri()

    async def _listen(self, answer: xmlrpc.Answer, bound: str, port: int) -> int:
        """Serve XML-RPC. Returns the port. Raises Refused: it is taken."""
        server = xmlrpc.XmlRpcServer(answer, self._options.any_user)
        try:
            port = await server.open(bound, port)
        except OSError as error:
            raise await self._not_opened(bound, error) from None
        self._servers.append(server)
        return port

    async def _not_opened(self, bound: str, error: OSError) -> Refused:
        port = self._options.port
        uri = f"http://{in_uri(bound if bound != '0.0.0.0' else _LOOPBACK)}:{port}"
        reason = f"cannot listen on {bound} port {port}: {os.strerror(error.errno) if error.errno else error}"
        try:
            answer = await xmlrpc.call(uri, "getPid", OWN_NODE, timeout_s=2.0)
            pid = answer[2] if isinstance(answer, list) and len(answer) == 3 else "unknown"
        except SlidectlError:
            return Refused(reason, "choose another port, or another address with --host")
        hint = f"join it with --master {uri}, or be a second one with --port"
        return Refused(f"{reason}\na ROS master is there already, process {pid}", hint)

    async def _host(self) -> tuple[str, str]:
        """The address to listen on, and the host name to advertise. Raises Refused: no such host.

        Without ROS_IP, ROS_HOSTNAME and --host that is loopback, or, for a master on another machine, the address by
        which this machine reaches it.
        """
        host = self._options.host
        override = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or ""
        if host != "localhost":
            await _check_host(host)
            everywhere = host in ("0.0.0.0", "::")
            return host, override or (socket.gethostname() if everywhere else host)
        if override:
            if "/" in override:
                raise Refused(
                    f"ROS_HOSTNAME or ROS_IP is {override!r}, which is not a host", "write it without http://"
                )
            await _check_host(override)
            is_loopback = override in ("localhost", "::1") or override.startswith("127.")
            return _LOOPBACK if is_loopback else "0.0.0.0", override
        if self._options.master:
            own = await _address_towards(self._options.master)
            return own, "localhost" if own.startswith("127.") else own
        return _LOOPBACK, "localhost"

    def _node_uri(self, node: str) -> str:
        """The address of the slave API of one of the daemon's nodes."""
        return f"{self._nodes_at}/" if self._joined is not None else f"{self._nodes_at}{node}"

    # --- the daemon ---------------------------------------------------------------------------------------------

    async def _connect(self, node: str) -> DaemonConnection:
        """Connect to the daemon under this node name. Raises Refused: the name is taken; NoDaemon."""
        assert self._paths is not None
        return await DaemonConnection.open(self._paths, self._permitted, node, self.lost.set)

    async def _connect_proxy(self, node: str) -> DaemonConnection:
        """Connect on behalf of a foreign node; under another name when the daemon has a node of this name."""
        return await connect_as(node, "ROS", f"{node}_ros1", self._proxy)

    async def _proxy(self, name: str) -> DaemonConnection:
        """Connect and register the connection in `_proxies`. Raises as `_connect`."""
        self._proxies[name] = None
        try:
            self._proxies[name] = connection = await self._connect(name)
        except BaseException:
            self._proxies.pop(name, None)  # `detach` may have come first
            raise
        return connection

    async def _set_own_parameters(self) -> None:
        """Set the parameters that roscore sets, if they are not set."""
        own = {"/rosdistro": _ROSDISTRO, "/rosversion": _ROSVERSION, "/run_id": str(uuid.uuid1())}
        for name, value in own.items():
            if not await self._parameters.has(name):
                await self._parameters.set(name, value)

    async def _open_rosout(self) -> None:
        """Provide roscore's /rosout node, as a connection to the daemon. Raises Refused, NoDaemon."""
        self._rosout = connection = await self._connect(_ROSOUT)
        connection.advertise("/rosout_agg", "rosgraph_msgs/Log")

        async def loggers(_: dict[str, Any]) -> dict[str, Any]:
            return {"loggers": [{"name": "ros", "level": "info"}]}

        async def set_level(_: dict[str, Any]) -> dict[str, Any]:
            return {}

        def take(published: dict[str, Any]) -> None:
            connection.publish("/rosout_agg", published["msg"])

        await connection.subscribe("/rosout", "rosgraph_msgs/Log", take=take)
        await connection.advertise_service(f"{_ROSOUT}/get_loggers", "roscpp/GetLoggers", loggers, Effect.READS)
        await connection.advertise_service(f"{_ROSOUT}/set_logger_level", "roscpp/SetLoggerLevel", set_level)

    async def _follow_graph(self) -> None:
        while True:
            await self._graph_changed.wait()
            await asyncio.sleep(_GATHER_S)
            try:
                await self._take_graph()
            except NoDaemon:
                return
            except SlidectlError as error:  # the daemon did not respond for a while
                _log.warning("the graph: %s; it is asked again", error)
                await asyncio.sleep(_ASK_AGAIN_S)
                self._graph_changed.set()
            except Exception:  # an internal error with one graph must not stop the next
                _log.exception("the graph")

    async def _take_graph(self) -> None:
        assert self._main is not None
        self._graph_changed.clear()
        closed = [node for node, connection in self._proxies.items() if connection and not connection.is_open]
        self._set_graph(await self._main.call("/slidectl/graph"))
        for node in closed:  # the graph just read no longer has them: another connection may use the name now
            if (connection := self._proxies.get(node)) and not connection.is_open:
                del self._proxies[node]

    def _set_graph(self, state: dict[str, Any]) -> None:
        natives = self._natives
        offered = [each for each in state["services"] if is_offered(each, self._permitted)]
        self._data.set_graph(natives.take({**state, "services": offered}, self._is_hidden))
        if self._master is not None:
            self._master.natives_changed()
        if self._joined is not None:
            self._joined.natives_changed()

    def _is_hidden(self, node: str) -> bool:
        """True for nodes hidden from ROS: the gateway's own, and those that represent foreign nodes."""
        return node == OWN_NODE or node in self._proxies or node.startswith(f"/slidectl_{os.getpid()}_")

    def _take_changes(self, published: dict[str, Any]) -> None:
        if self._joined is not None:
            self._joined.parameters_changed(published["msg"]["names"])
        else:
            self._parameter_server.changed(published["msg"]["names"])


def _joined_node(paths: InstancePaths) -> str:
    """The node name of a daemon at a master that is another program."""
    return "/slidectl_" + re.sub(r"\W", "_", paths.name, flags=re.ASCII)


async def _check_host(host: str) -> None:
    """Check that the host resolves. Raises Refused."""
    try:
        await asyncio.get_running_loop().getaddrinfo(host, None)
    except (OSError, UnicodeError) as error:
        raise Refused(f"host {host!r} does not resolve: {getattr(error, 'strerror', None) or error}") from None


async def _address_towards(uri: str) -> str:
    """The address of this machine on the route to the URI's host. Raises Refused: no such host, or no answer."""
    host, port, _ = xmlrpc.host_port_path(uri)
    await _check_host(host)
    try:
        _, writer = await asyncio.wait_for(asyncio.open_connection(host, port), xmlrpc.CALL_LIMIT_S)
    except (OSError, TimeoutError) as error:
        raise Refused(
            f"no ROS master answers at {uri}: {getattr(error, 'strerror', None) or 'it takes too long'}",
            "start it with: roscore; without --master this gateway is one",
        ) from None
    own: str = writer.get_extra_info("sockname")[0]
    writer.close()
    return own
