"""A gateway's connection to the daemon: an `AsyncClient` that may do what the gateway permits, and no more."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Awaitable, Callable, Collection

from slidectl.client.async_client import AsyncClient
from slidectl.effects import Effect
from slidectl.errors import Refused, SlidectlError
from slidectl.paths import InstancePaths

_log = logging.getLogger(__name__)

GRAPH_CHANGES, PARAMETER_CHANGES = "/slidectl/graph_changes", "/slidectl/parameter_changes"
"""Topics that announce changes: std_msgs/Empty and slidectl/ParameterChanges."""


class DaemonConnection(AsyncClient):
    """A connection to the daemon, made by `open`. It runs on one event loop.

    `on_refused` takes the text of a refusal of something that was sent without waiting for an answer. When `on_line` is
    set, it takes every received line unchanged, and then only `send_line` is of use.
    """

    @classmethod
    async def open(
        cls,
        paths: InstancePaths,
        permitted: Collection[Effect],
        node: str = "",
        on_lost: Callable[[], None] | None = None,
    ) -> DaemonConnection:
        """Connect to the daemon of `paths`; `on_lost` is called when the daemon ends.

        The daemon refuses all but the `permitted` effects on this connection.

        Raises:
            NoDaemon: no daemon answers. Refused: the node's name is taken, or the daemon is another user's.
        """
        made = cls(socket=paths.socket_text)
        made.expects_subscribers = False
        made.on_refused = lambda _: None
        made.on_lost = on_lost or (lambda: None)
        await made.connect()
        try:
            if node:
                await made.set_node(node)
            await made.restrict(*sorted(permitted))
        except BaseException:
            made.close()
            raise
        return made

    @property
    def takes_more(self) -> bool:
        """False while the daemon has not read enough of what was sent: `drain` waits until it has."""
        return self._may_send.is_set()

    def failure_of(self, error: Exception) -> str:
        """The text of a SlidectlError; of any other error, which is the gateway's own, the log has more."""
        if isinstance(error, SlidectlError):
            return str(error)
        traceback.print_exception(error)
        return "internal error; the log of the gateway has more"


async def connect_as(
    node: str, system: str, other: str, connect: Callable[[str], Awaitable[DaemonConnection]]
) -> DaemonConnection:
    """Connect on behalf of a node of another system; under the `other` name when the daemon has a node of this name.

    Raises Refused: both names are taken; NoDaemon.
    """
    try:
        return await connect(node)
    except Refused as error:
        _log.warning("the node %s of %s is %s in slidectl: %s", node, system, other, error.message)
        return await connect(other)
