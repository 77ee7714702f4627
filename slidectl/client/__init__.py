"""The client of the daemon, for scripts and for the command line. Standard library only."""

from slidectl.client.client import Client, Manager, Subscription

__all__ = ["Client", "Manager", "Subscription"]
