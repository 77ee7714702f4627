"""Access control for what this machine serves to browsers: addresses, names of this machine, tokens. No web library.

Host names are checked, because a foreign site can let one of its names lead to this machine (DNS rebinding).
"""

from __future__ import annotations

import hmac
import re
import socket
from collections.abc import Collection
from ipaddress import ip_address
from urllib.parse import urlsplit

from slidectl import local_peers
from slidectl.effects import Effect
from slidectl.errors import UsageError

LOOPBACK = ("localhost", "127.0.0.1", "::1")
"""Names of this machine that a foreign site cannot use."""
_TOKEN = re.compile(r"[A-Za-z0-9_.~-]{8,}\Z")


def is_loopback(host: str) -> bool:
    """True when only this machine can reach the host. Raises OSError: no such host."""
    return all(ip_address(found[4][0]).is_loopback for found in socket.getaddrinfo(host, None))


def host_of(netloc: str) -> str:
    """The host of `host:port`, in lower case and without brackets; empty when it is not valid."""
    try:
        return urlsplit(f"//{netloc}").hostname or ""
    except ValueError:
        return ""


def in_uri(host: str) -> str:
    """The host as written in a URI: IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


def shown_host(host: str) -> str:
    """The host as written in a link for the user."""
    return {"0.0.0.0": "localhost", "127.0.0.1": "localhost"}.get(host, in_uri(host))


def check_token(token: str) -> str:
    """Return the token. Raises UsageError unless it is long enough and legal in a URL."""
    if not _TOKEN.match(token):
        raise UsageError("a token needs 8 or more letters, digits and -._~")
    return token


def check_effects(is_read_only: bool, allow: Collection[str]) -> frozenset[Effect]:
    """What the clients of a door may do, by its options --read-only and --allow. Raises UsageError."""
    if is_read_only and allow:
        raise UsageError("--read-only and --allow exclude each other", "leave one of them out")
    return frozenset({Effect.READS} if is_read_only else {Effect.READS, Effect.WRITES, *map(Effect, allow)})


def check_users_can_be_told(any_user: bool) -> None:
    """Raise UsageError where connections of other users cannot be told from those of this process's user."""
    if not any_user and not local_peers.can_be_told():
        raise UsageError(
            "this system does not report the user of a connection: every user of this machine could connect",
            "use --token TOKEN where the gateway has tokens, or --any-user",
        )


def is_secret(given: str, secret: str) -> bool:
    """True when `given` is the secret. The comparison takes the same time wherever they differ."""
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), secret.encode())
