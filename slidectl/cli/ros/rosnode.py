"""`rosnode`: the nodes that there are here: the simulation's own, and the clients that use topics or offer services.

A node answers when the daemon does and still has it; nobody dead stays in the list, so there is nothing to clean up.
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

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.arguments import Option, Parser
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import HOST, pause, resolve
from slidectl.cli.ros.verbs import Tool, Verb
from slidectl.cli.topics import PUBLISHERS, SUBSCRIBERS, users_of
from slidectl.errors import NoDaemon, TimedOut

TOOL = Tool(
    "rosnode",
    "rosnode shows, tests and ends nodes.",
    {
        "ping": Verb("rosnode:ping", "test whether a node answers"),
        "list": Verb("rosnode:list_nodes", "list nodes"),
        "info": Verb("rosnode:info", "show topics, services and connections of nodes"),
        "machine": Verb("rosnode:machine", "list the machines, or the nodes of one"),
        "kill": Verb("rosnode:kill", "end nodes"),
        "cleanup": Verb("rosnode:cleanup", "forget nodes that do not answer (there are none here)"),
    },
    help_options=("--help",),
)
_RULE = "-" * 80
_STATE_PUBLISHER = "/robot_state_publisher"
_CLIENT = re.compile(r"/slidectl_(?P<pid>\d+)_\d+\Z")
_PERIOD_S = 1.0
_PATIENCE_S = 10.0
_LOOK_AGAIN_S = 0.05


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb."""
    TOOL.run(ctx, argv)


# --- list, machine, cleanup -------------------------------------------------------------------------------------------


def list_nodes(ctx: Context, argv: Sequence[str]) -> None:
    """Names, or where they answer."""
    options = [
        Option(("-u",), "uris", "where they answer, instead of their names"),
        Option(("-a", "--all"), "everything", "where they answer, and their names"),
    ]
    parser = Parser("rosnode", "rosnode list", options)
    given = parser.parse(argv)
    (namespace,) = parser.at_most(given, 1, "invalid args: you may only specify one namespace")
    inside = resolve(ctx, namespace, "rosnode").rstrip("/") or "/" if namespace else "/"
    chosen = [node for node in ctx.names("node") if names.is_under(node, inside)]
    if given.everything:
        chosen = [f"{ctx.uri} \t{node}" for node in chosen]
    elif given.uris:
        chosen = [ctx.uri for _ in chosen]
    output.write("\n".join(chosen))


def machine(ctx: Context, argv: Sequence[str]) -> None:
    """The one machine that there is."""
    parser = Parser("rosnode", "rosnode machine [machine-name]")
    given = parser.parse(argv)
    (host,) = parser.at_most(given, 1, "please enter only one machine name")
    nodes = ctx.names("node")
    if host is None:
        return output.write(HOST)
    if host not in (HOST, "127.0.0.1", "::1", os.uname().nodename):
        raise Failure(f"ERROR: cannot resolve machine name [{host}] to address")
    return output.write("\n".join(nodes))


def cleanup(ctx: Context, argv: Sequence[str]) -> None:
    """Nothing to do: a node that has gone is in no list."""
    Parser("rosnode", "rosnode cleanup").parse(argv)
    ctx.names("node")


# --- info -------------------------------------------------------------------------------------------------------------


def info(ctx: Context, argv: Sequence[str]) -> None:
    """Topics, services, connections. Raises Failure when one of the nodes is unknown."""
    option = Option(("-q", "--quiet"), "quiet", "without the connections")
    parser = Parser("rosnode", "rosnode info [options] node1 [node2...]", [option])
    given = parser.parse(argv)
    if not given.words:
        parser.error("You must specify at least one node name")
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
    # There the type of a topic is what its publishers say.
    known = {topic: types[topic] if published[topic] else "unknown type" for topic in details["subscribing"]}
    parts = [
        _block("Publications", [f"{topic} [{types[topic]}]" for topic in details["publishing"]]),
        _block("Subscriptions", [f"{topic} [{kind}]" for topic, kind in known.items()]),
        _block("Services", details["services"]),
    ]
    return f"Node [{full}]\n" + "\n".join(parts) + "\n"


def _block(title: str, items: Sequence[str]) -> str:
    return f"{title}: \n" + "".join(f" * {item}\n" for item in items) if items else f"{title}: None\n"


def _connections(ctx: Context, full: str, details: dict[str, Any]) -> str:
    lines = ["", f"contacting node {ctx.uri} ...", f"Pid: {_pid(ctx, full)}"]
    listed: list[tuple[str, str, str]] = []
    for key, way, role in (("publishing", "outbound", SUBSCRIBERS), ("subscribing", "inbound", PUBLISHERS)):
        peers = users_of(ctx, details[key], role)
        listed += [(topic, peer, way) for topic in details[key] for peer in peers[topic]]
    if listed:
        lines.append("Connections:")
    for topic, peer, way in listed:
        transport = "UNIX" if _CLIENT.match(peer) or _CLIENT.match(full) else "INTRAPROCESS"
        lines += [f" * topic: {topic}", f"    * to: {peer}", f"    * direction: {way}", f"    * transport: {transport}"]
    return "\n".join(lines) + "\n\n"


def _pid(ctx: Context, full: str) -> int:
    match = _CLIENT.match(full)
    return int(match["pid"]) if match else ctx.client.daemon_pid


# --- ping -------------------------------------------------------------------------------------------------------------


def ping(ctx: Context, argv: Sequence[str]) -> None:
    """Round trips, one a second until Ctrl-C or -c."""
    options = [
        Option(("-a", "--all"), "everything", "all nodes, once"),
        Option(("-c",), "count", "so many times; not with -a", "COUNT"),
    ]
    parser = Parser("rosnode", "rosnode ping [options] <node>", options)
    given = parser.parse(argv)
    count = parser.integer(given.count, 0, f"option -c: invalid integer value: '{given.count}'")
    if given.everything:
        if given.count is not None:
            parser.error("-c may not be used with --all")
        return _ping_all(ctx)
    if not given.words:
        known = "\n".join(ctx.names("node"))
        parser.error(f"Please enter a node to ping. Available nodes are:\n{known}")
    if len(given.words) > 1:
        parser.error("you may only specify one input node")
    full = resolve(ctx, given.words[0], "rosnode")
    output.write(f"rosnode: node is [{full}]")
    if full not in ctx.names("node"):
        raise Failure(f"cannot ping [{full}]: unknown node")
    return _ping(ctx, full, count or float("inf"))


def _ping(ctx: Context, full: str, count: float) -> None:
    times: list[float] = []
    output.write(_start(full))
    try:
        while len(times) < count:
            if times:
                pause(ctx, _PERIOD_S)
            times.append(_round_trip(ctx, full))
    finally:
        if len(times) > 1:
            output.write(f"ping average: {sum(times) / len(times):f}ms")


def _ping_all(ctx: Context) -> None:
    nodes = ctx.names("node")
    output.write("Will ping the following nodes: \n" + "".join(f" * {node}\n" for node in nodes) + "\n")
    for node in nodes:
        output.write(_start(node))
        _round_trip(ctx, node)


def _start(node: str) -> str:
    return f"pinging {node} with a timeout of 3.0s"


def _round_trip(ctx: Context, full: str) -> float:
    """Milliseconds until the daemon has said that the node is there. Raises Failure when it is not any more."""
    began = monotonic()
    details = ctx.call("/rosapi/node_details", {"node": full}, 3.0)
    milliseconds = (monotonic() - began) * 1000
    if not any(details.values()):
        raise Failure(f"ERROR: [{full}] has gone")
    output.write(f"xmlrpc reply from {ctx.uri}\ttime={milliseconds:f}ms")
    return milliseconds


# --- kill -------------------------------------------------------------------------------------------------------------


def kill(ctx: Context, argv: Sequence[str]) -> None:
    """End nodes: a client by SIGINT, as Ctrl-C would; a state publisher by its parameter; others with the daemon."""
    option = Option(("-a", "--all"), "everything", "all nodes")
    given = Parser("rosnode", "rosnode kill [node]...", [option]).parse(argv)
    known = ctx.names("node")
    if given.everything:
        chosen = known
    elif given.words:
        chosen = [resolve(ctx, word, "rosnode") for word in given.words]
    else:
        chosen = [_asked(known)]
    unknown = [node for node in chosen if node not in known]
    if unknown:
        raise Failure("\n".join(["ERROR: Unknown node(s):", *(f" * {node}" for node in unknown)]))
    _check_reach(ctx, chosen)
    for node in sorted(chosen, key=_turn):
        output.write(f"killing {node}")
        _end(ctx, node)
    output.write("killed")


def _turn(node: str) -> int:
    """Clients first; what ends the daemon comes last, since nobody answers then."""
    return 0 if _CLIENT.match(node) else 1 if node.endswith(_STATE_PUBLISHER) else 2


def _asked(known: Sequence[str]) -> str:
    """The node whose number is typed. Raises Failure when none is."""
    lines = [f"{number}. {node}" for number, node in enumerate(known, start=1)]
    sys.stdout.write("\n".join([*lines, "", "Please enter the number of the node you wish to kill.", "> "]))
    sys.stdout.flush()
    answer = sys.stdin.readline().strip()
    if not answer.isdigit() or not 0 < int(answer) <= len(known):
        raise Failure("\nERROR: please enter a number of the list" if answer else "\nERROR: no number on stdin")
    return known[int(answer) - 1]


def _check_reach(ctx: Context, nodes: Sequence[str]) -> None:
    """Raise Failure when a client has no process id, or one that means another process here than to the daemon."""
    clients = {node: int(match["pid"]) for node in nodes if (match := _CLIENT.match(node))}
    if not clients:
        return
    # Who cannot see a process is told 0, and a signal to process 0 goes to all of one's own process group.
    unseen = [node for node, pid in clients.items() if pid == 0]
    if unseen:
        listed = "\n".join(f" * {node}" for node in unseen)
        raise Failure(f"ERROR: the daemon cannot see the process of these nodes (they run in a container?):\n{listed}")
    if ctx.call("/slidectl/status")["pid"] != ctx.client.daemon_pid:
        raise Failure("ERROR: the daemon runs in another container, where process ids mean other processes: kill there")


def _end(ctx: Context, node: str) -> None:
    match = _CLIENT.match(node)
    if match is None and node.endswith(_STATE_PUBLISHER):
        ctx.call("/rosapi/set_param", {"name": f"{node}/enabled", "value": "false"})
        return None
    if match is None:
        return _end_of_simulation(ctx)
    try:
        with suppress(ProcessLookupError):
            os.kill(int(match["pid"]), signal.SIGINT)
    except PermissionError:
        raise Failure(f"ERROR: the process of {node} belongs to another user") from None
    deadline = monotonic() + _PATIENCE_S
    while any(ctx.call("/rosapi/node_details", {"node": node}).values()):
        if monotonic() > deadline:
            raise TimedOut(f"{node} is still there after {_PATIENCE_S:g} s", f"kill -KILL {match['pid']}")
        pause(ctx, _LOOK_AGAIN_S)
    return None


def _end_of_simulation(ctx: Context) -> None:
    with suppress(NoDaemon):
        ctx.call("/slidectl/shutdown")
