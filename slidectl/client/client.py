"""`Client`, the blocking client: the public Python API for scripts. Standard library only.

connection.py calls, publishes and subscribes; world_client.py has what is done to the world; parameter_client.py and
manager.py have parameters and controllers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl import names
from slidectl.client.manager import Manager
from slidectl.client.parameter_client import Params
from slidectl.client.world_client import WorldClient
from slidectl.errors import UsageError, listing

if TYPE_CHECKING:
    from slidectl.client.action_client import Action


class Client(WorldClient):
    """A connection to a daemon. Use it as a context manager: leaving it waits until the daemon has taken what was
    published.

    Leaving it raises MessageRefused for a refused message, and for a topic none of whose messages reached a subscriber.
    A name without a leading slash is the unique end of a full name, as on the command line.

    Args:
        instance: the daemon's name; by default `SLIDECTL_SOCKET`, `SLIDECTL_INSTANCE` or `default` decide.
        socket: the path of the daemon's socket, instead of `instance`.
        timeout: default limit of each wait in wall seconds; `inf` for no limit.
        link: an existing connection to use instead of a new one.

    Use a client from one thread only: threads that share one take each other's answers. Give each thread its own.

    Raises:
        NoDaemon: no daemon answers. Refused: the socket's folder is not private, or the daemon is another user's.
    """

    def controllers(self, namespace: str | None = None) -> Manager:
        """The controller manager of a robot's namespace, by default the only one: load, start, stop, switch, list.

        Raises:
            UsageError: no namespace is given, and there is no controller manager, or more than one.
        """
        if namespace is None:
            found = self.managers()
            if len(found) != 1:
                known = listing([manager.namespace for manager in found])
                raise UsageError(f"which controller manager? there are: {known}", "name its namespace, as '/slider'")
            return found[0]
        return Manager(self, names.join("/", namespace).rstrip("/") or "/")

    def managers(self) -> list[Manager]:
        """All controller managers, by namespace."""
        request, name = {"type": "controller_manager_msgs/ListControllers"}, "/controller_manager/list_controllers"
        services = self.call("/rosapi/services_for_type", request)["services"]
        return [Manager(self, one.removesuffix(name) or "/") for one in sorted(services) if one.endswith(name)]

    def action(self, name: str) -> Action:
        """An action by its name, or by the name of a controller with one action: send goals, follow and cancel them.

        Raises:
            UnknownName, AmbiguousName.
        """
        from slidectl.client.action_client import Action

        return Action(self, name)

    @property
    def params(self) -> Params:
        """The parameters, as a mapping of names to values."""
        return Params(self)
