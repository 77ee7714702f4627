"""The client of the daemon, for scripts and for the command line. Standard library only."""

from slidectl.client.client import Client
from slidectl.client.connection import Subscription
from slidectl.client.manager import Manager

__all__ = ["Client", "Manager", "Subscription"]
