"""Who may use what this machine serves to browsers: addresses, names of this machine, tokens. Knows no library.

Names matter since a foreign site may make a name of its own lead to this machine, and its pages then count as ours.
"""

from __future__ import annotations

import hmac
import re
import socket
from ipaddress import ip_address
from urllib.parse import urlsplit

from slidectl.errors import UsageError

LOOPBACK = ("localhost", "127.0.0.1", "::1")
"""Names of this machine that no foreign site can have."""
_TOKEN = re.compile(r"[A-Za-z0-9_.~-]{8,}\Z")


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens there. Raises OSError: no such host."""
    return all(ip_address(found[4][0]).is_loopback for found in socket.getaddrinfo(host, None))


def host_of(netloc: str) -> str:
    """The host of `host:port`, in small letters and without brackets; empty when it is none."""
    try:
        return urlsplit(f"//{netloc}").hostname or ""
    except ValueError:
        return ""


def in_uri(host: str) -> str:
    """The host as it stands in a URI: IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


def shown_host(host: str) -> str:
    """The host as an address to click on has it."""
    return {"0.0.0.0": "localhost", "127.0.0.1": "localhost"}.get(host, in_uri(host))


def check_token(token: str) -> str:
    """The token itself. Raises UsageError unless it is long enough, and can stand in an address."""
    if not _TOKEN.match(token):
        raise UsageError("a token has 8 or more letters, digits and -._~")
    return token


def is_secret(given: str, secret: str) -> bool:
    """Whether what was given is the secret; it takes as long whatever part of it is right."""
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), secret.encode())
