"""The client of the daemon, for scripts and for the command line. Standard library only.

`Client` is the door; `lines` is shared with the daemon, which reads and writes the same lines.
"""

from slidectl.client.client import Client
from slidectl.client.subscription import Subscription

__all__ = ["Client", "Subscription"]
