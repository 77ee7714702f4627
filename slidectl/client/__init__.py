"""The clients of the daemon, for scripts and for the command line. Standard library only.

`AsyncClient` is imported on first use, because it takes asyncio.
"""

from typing import TYPE_CHECKING, Any

from slidectl.client.client import Client
from slidectl.client.connection import Subscription
from slidectl.client.manager import Manager

if TYPE_CHECKING:
    from slidectl.client.async_client import AsyncClient

__all__ = ["AsyncClient", "Client", "Manager", "Subscription"]


def __getattr__(name: str) -> Any:
    if name == "AsyncClient":
        from slidectl.client.async_client import AsyncClient

        return AsyncClient
    raise AttributeError(f"module 'slidectl.client' has no attribute {name!r}")
