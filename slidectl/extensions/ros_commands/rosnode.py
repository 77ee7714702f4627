"""`rosnode`: the nodes of the simulation itself, and the clients that use topics or provide services.

A node answers when the daemon answers and lists it. An ended node leaves the list, so there is nothing to clean up.
"""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from time import monotonic
from typing import Any

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import PUBLISHERS, SUBSCRIBERS, block, users_of
from slidectl.errors import NoDaemon, TimedOut, listing
from slidectl.extensions.ros_commands.arguments import HOST, Failure, Parser, Tool, below, option, resolve

_RULE = "-" * 80
_CLIENT = re.compile(r"/slidectl_(?P<pid>\d+)_\d+\Z")
_PERIOD_S = 1.0
_TIMEOUT_S = 10.0
_LOOK_AGAIN_S = 0.05


def list_nodes(ctx: Context, argv: Sequence[str]) -> None:
    """Print the names of the nodes, or their URIs."""
    parser = Parser(
        "rosnode",
        "rosnode list",
        option("-u", "URIs instead of names", dest="uris"),
        option("-a --all", "URIs and names"),
    )
    given = parser.parse(argv, most=1, extra="invalid args: you may only specify one namespace")
    chosen = below(ctx, ctx.names("node"), given.words[0] if given.words else None, "rosnode")
    if given.all:
        chosen = [f"{ctx.uri} \t{node}" for node in chosen]
    elif given.uris:
        chosen = [ctx.uri for _ in chosen]
    output.write("\n".join(chosen))


def machine(ctx: Context, argv: Sequence[str]) -> None:
    """Print the only machine, or its nodes."""
    parser = Parser("rosnode", "rosnode machine [machine-name]")
    words = parser.parse(argv, most=1, extra="please enter only one machine name").words
    nodes = ctx.names("node")
    if words and words[0] not in (HOST, "127.0.0.1", "::1", os.uname().nodename):
        raise Failure(f"ERROR: cannot resolve machine name [{words[0]}] to address")
    output.write("\n".join(nodes) if words else HOST)


def cleanup(ctx: Context, argv: Sequence[str]) -> None:
    """Do nothing but call the daemon: an ended node is in no list."""
    Parser("rosnode", "rosnode cleanup").parse(argv)
    ctx.names("node")


def info(ctx: Context, argv: Sequence[str]) -> None:
    """Print topics, services and connections of nodes. Raises Failure when one of the nodes is unknown."""
    parser = Parser(
        "rosnode", "rosnode info [options] node1 [node2...]", option("-q --quiet", "without the connections")
    )
    given = parser.parse(argv, 1, missing="You must specify at least one node name")
    unknown = []
    for word in given.words:
        full = resolve(ctx, word, "rosnode")
        output.write(_RULE)
        details = ctx.call("/rosapi/node_details", {"node": full})
        output.write(_description(ctx, full, details))
        if not any(details.values()):
            unknown.append(full)
        elif not given.quiet:
            output.write(_connections(ctx, full, details))
    if unknown:
        raise Failure("\n".join(f"cannot contact [{full}]: unknown node" for full in unknown))


def _description(ctx: Context, full: str, details: dict[str, Any]) -> str:
    types = ctx.client.topics()
    published = users_of(ctx, details["subscribing"], PUBLISHERS)
    # In ROS the publishers give the type of a topic.
    known = {topic: types[topic] if published[topic] else "unknown type" for topic in details["subscribing"]}
    parts = [
        block("Publications", [f"{topic} [{types[topic]}]" for topic in details["publishing"]]),
        block("Subscriptions", [f"{topic} [{kind}]" for topic, kind in known.items()]),
        block("Services", details["services"]),
    ]
    return f"Node [{full}]\n" + "\n".join(parts) + "\n"


def _connections(ctx: Context, full: str, details: dict[str, Any]) -> str:
    client = _CLIENT.match(full)
    lines = ["", f"contacting node {ctx.uri} ...", f"Pid: {client['pid'] if client else ctx.client.daemon_pid}"]
    listed: list[str] = []
    for key, way, role in (("publishing", "outbound", SUBSCRIBERS), ("subscribing", "inbound", PUBLISHERS)):
        for topic, peers in users_of(ctx, details[key], role).items():
            for peer in peers:
                transport = "UNIX" if client or _CLIENT.match(peer) else "INTRAPROCESS"
                listed += [f" * topic: {topic}", f"    * to: {peer}"]
                listed += [f"    * direction: {way}", f"    * transport: {transport}"]
    return "\n".join([*lines, *(["Connections:"] if listed else []), *listed]) + "\n\n"


def ping(ctx: Context, argv: Sequence[str]) -> None:
    """Measure round trips, one a second, until Ctrl-C or -c."""
    parser = Parser(
        "rosnode",
        "rosnode ping [options] <node>",
        option("-a --all", "all nodes, once"),
        option("-c", "number of pings; not with -a", "COUNT", dest="count"),
    )
    given = parser.parse(argv, most=1, extra="you may only specify one input node")
    count = parser.number(int, given.count, 0, f"option -c: invalid integer value: '{given.count}'")
    if given.all and given.count is not None:
        parser.error("-c may not be used with --all")
    if given.all:
        nodes = ctx.names("node")
        output.write("Will ping the following nodes: \n" + "".join(f" * {node}\n" for node in nodes) + "\n")
        for node in nodes:
            _ping(ctx, node, is_first=True)
        return
    if not given.words:
        known = "\n".join(ctx.names("node"))
        parser.error(f"Please enter a node to ping. Available nodes are:\n{known}")
    full = resolve(ctx, given.words[0], "rosnode")
    output.write(f"rosnode: node is [{full}]")
    if full not in ctx.names("node"):
        raise Failure(f"cannot ping [{full}]: unknown node")
    times: list[float] = []
    try:
        while not count or len(times) < count:
            if times:
                ctx.pause(_PERIOD_S)
            times.append(_ping(ctx, full, is_first=not times))
    finally:
        if len(times) > 1:
            output.write(f"ping average: {sum(times) / len(times):f}ms")


def _ping(ctx: Context, full: str, is_first: bool) -> float:
    """The milliseconds until the daemon answers for the node. Raises Failure when the node has ended."""
    if is_first:
        output.write(f"pinging {full} with a timeout of 3.0s")
    began = monotonic()
    details = ctx.call("/rosapi/node_details", {"node": full}, timeout=3.0)
    milliseconds = (monotonic() - began) * 1000
    if not any(details.values()):
        raise Failure(f"ERROR: [{full}] has ended")
    output.write(f"xmlrpc reply from {ctx.uri}\ttime={milliseconds:f}ms")
    return milliseconds


def kill(ctx: Context, argv: Sequence[str]) -> None:
    """End nodes: a client by SIGINT, as Ctrl-C would; a state publisher by its parameter; others with the daemon."""
    given = Parser("rosnode", "rosnode kill [node]...", option("-a --all", "all nodes")).parse(argv)
    known = ctx.names("node")
    if given.all:
        chosen = known
    elif given.words:
        chosen = [resolve(ctx, word, "rosnode") for word in given.words]
    else:
        chosen = [_chosen(known)]
    unknown = [node for node in chosen if node not in known]
    if unknown:
        there = f"nodes: {listing(known)}"
        raise Failure("\n".join(["ERROR: Unknown node(s):", *(f" * {node}" for node in unknown), there]))
    _check_reach(ctx, chosen)
    # Clients first; the nodes that end the daemon last, since no call is answered after that.
    for node in sorted(chosen, key=lambda node: 0 if _CLIENT.match(node) else 1 if _is_state_publisher(node) else 2):
        output.write(f"killing {node}")
        _end(ctx, node)
    output.write("killed")


def _is_state_publisher(node: str) -> bool:
    return node.endswith("/robot_state_publisher")


def _chosen(known: Sequence[str]) -> str:
    """Ask for the number of a node. Raises Failure for a wrong answer."""
    lines = [f"{number}. {node}" for number, node in enumerate(known, start=1)]
    sys.stdout.write("\n".join([*lines, "", "Please enter the number of the node you wish to kill.", "> "]))
    sys.stdout.flush()
    answer = sys.stdin.readline().strip()
    if not answer.isdigit() or not 0 < int(answer) <= len(known):
        raise Failure("\nERROR: please enter a number from the list" if answer else "\nERROR: no number on stdin")
    return known[int(answer) - 1]


def _check_reach(ctx: Context, nodes: Sequence[str]) -> None:
    """Raise Failure when clients or the daemon run in another container, where process ids mean other processes."""
    clients = {node: int(match["pid"]) for node in nodes if (match := _CLIENT.match(node))}
    # The pid is 0 when the daemon cannot see the process; a signal to 0 would go to our own process group.
    if 0 in clients.values() or (clients and ctx.call("/slidectl/status")["pid"] != ctx.client.daemon_pid):
        listed = "\n".join(f" * {node}" for node in clients)
        raise Failure(f"ERROR: these nodes, or the daemon, run in another container; kill them there:\n{listed}")


def _end(ctx: Context, node: str) -> None:
    match = _CLIENT.match(node)
    if match is None and _is_state_publisher(node):
        ctx.call("/rosapi/set_param", {"name": f"{node}/enabled", "value": "false"})
        return
    if match is None:
        with suppress(NoDaemon):
            ctx.call("/slidectl/shutdown")
        return
    try:
        with suppress(ProcessLookupError):
            os.kill(int(match["pid"]), signal.SIGINT)
    except PermissionError:
        raise Failure(f"ERROR: the process of {node} belongs to another user") from None
    deadline = ctx.client.monotonic() + _TIMEOUT_S
    while any(ctx.call("/rosapi/node_details", {"node": node}).values()):
        if ctx.client.monotonic() > deadline:
            raise TimedOut(f"{node} is still there after {_TIMEOUT_S:g} s", f"kill -KILL {match['pid']}")
        ctx.pause(_LOOK_AGAIN_S)


rosnode = Tool(
    "rosnode",
    "rosnode shows, tests and ends nodes.",
    {
        "ping": (ping, "test whether a node answers"),
        "list": (list_nodes, "list nodes"),
        "info": (info, "show topics, services and connections of nodes"),
        "machine": (machine, "list the machines, or the nodes of one"),
        "kill": (kill, "end nodes"),
        "cleanup": (cleanup, "forget nodes that do not answer (there are none here)"),
    },
    help_options=("--help",),
)
