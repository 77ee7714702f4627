"""Access control for what this machine serves on TCP: the users of connections, addresses, tokens. No web library.

Host names are checked, because a foreign site can let one of its names lead to this machine (DNS rebinding). Ports of
loopback have no file permissions: every user of a machine reaches them. A server that has no other way to tell its
clients apart asks the kernel who owns the other end. Linux only; elsewhere nothing can be told.
"""

from __future__ import annotations

import hmac
import os
import re
import socket
import struct
from collections.abc import Collection
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from urllib.parse import urlsplit

from slidectl.effects import Effect
from slidectl.errors import UsageError
from slidectl.operating_system import LINUX

LOOPBACK = ("localhost", "127.0.0.1", "::1")
"""Names of this machine that a foreign site cannot use."""
Address = tuple[str, int]
"""Host, as a number, and port."""
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
    if not any_user and not users_can_be_told():
        raise UsageError(
            "this system does not report the user of a connection: every user of this machine could connect",
            "use --token TOKEN where the gateway has tokens, or --any-user",
        )


def is_secret(given: str, secret: str) -> bool:
    """True when `given` is the secret. The comparison takes the same time wherever they differ."""
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), secret.encode())


# --- the user of a connection -----------------------------------------------------------------------------------------

_NETLINK_SOCK_DIAG = 4
_SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST = 20, 1
_HEADER = struct.Struct("=IHHII")
"""nlmsghdr: length, type, flags, sequence number, port."""
_REQUEST = struct.Struct("=BBBxI")
"""The beginning of inet_diag_req_v2: family, protocol, extensions, states. The connection's id follows."""
_ID = struct.Struct("!HH16s16s")
"""The beginning of inet_diag_sockid: ports and addresses of both ends."""
_ANY_INTERFACE_AND_COOKIE = struct.pack("=III", 0, 0xFFFFFFFF, 0xFFFFFFFF)
_ANSWER = struct.Struct("=BBBB48s5I")
"""inet_diag_msg: family, state, timer, retransmissions, id, expiry, two queues, uid, inode."""
_ALL_STATES = 0xFFFFFFFF
_ANSWER_LIMIT_S = 1.0


def users_can_be_told() -> bool:
    """True where the user of a connection can be found: this process asks about a connection of its own."""
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as own:
        return owner(own.getsockname(), listener.getsockname()) == os.geteuid()


def owner(peer: Address, here: Address) -> int | None:
    """The user id of the process at `peer`, the other end of a TCP connection to `here`.

    None when it is no connection of this machine, or when its process has closed it already: the kernel then shows it
    as one of root.
    """
    if not LINUX:
        return None
    ends = _numbers(peer), _numbers(here)
    with suppress(OSError):  # a sandbox without this kind of socket
        return _by_netlink(*ends)
    with suppress(OSError):
        return _by_table(*ends)
    return None


def stranger(peer: Address, here: Address) -> str:
    """Why a connection is not one of this process's user; empty when it is, or comes from another machine."""
    uid, own = owner(peer, here), os.geteuid()
    if uid == own:
        return ""
    if uid is not None:
        return f"this belongs to user {own}, the connection comes from user {uid}"
    address = _numbers(peer)[0]
    if address.is_loopback or address == _numbers(here)[0]:
        return "the user of the connection cannot be determined"
    return ""


def _numbers(end: Address) -> tuple[IPv4Address | IPv6Address, int]:
    """Address and port. IPv4 written as IPv6 is IPv4: the kernel finds it by both."""
    address = ip_address(end[0].partition("%")[0])
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address, end[1]


def _as_ipv6(address: IPv4Address | IPv6Address) -> IPv6Address:
    return IPv6Address(f"::ffff:{address}") if isinstance(address, IPv4Address) else address


def _by_netlink(peer: tuple[IPv4Address | IPv6Address, int], here: tuple[IPv4Address | IPv6Address, int]) -> int | None:
    """Ask the kernel about one connection (sock_diag(7)). A table of all of them takes it 10 ms. Raises OSError."""
    family = socket.AF_INET if peer[0].version == 4 else socket.AF_INET6
    wanted = _ID.pack(peer[1], here[1], peer[0].packed.ljust(16, b"\0"), here[0].packed.ljust(16, b"\0"))
    mapped = _ID.pack(peer[1], here[1], *(_as_ipv6(end[0]).packed for end in (peer, here)))
    body = _REQUEST.pack(family, socket.IPPROTO_TCP, 0, _ALL_STATES) + wanted + _ANY_INTERFACE_AND_COOKIE
    header = _HEADER.pack(_HEADER.size + len(body), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG) as kernel:
        kernel.settimeout(_ANSWER_LIMIT_S)
        kernel.sendto(header + body, (0, 0))
        answer = kernel.recv(4096)
    kind = _HEADER.unpack_from(answer)[1]
    if kind != _SOCK_DIAG_BY_FAMILY or len(answer) < _HEADER.size + _ANSWER.size:
        return None  # an error: no such connection
    *_, found, _, _, _, uid, inode = _ANSWER.unpack_from(answer, _HEADER.size)
    # The kernel may answer with a listener on that port, or with a connection that no process has any more.
    return int(uid) if inode and found[: _ID.size] in (wanted, mapped) else None


def _by_table(peer: tuple[IPv4Address | IPv6Address, int], here: tuple[IPv4Address | IPv6Address, int]) -> int | None:
    """Look the connection up in /proc/net/tcp and /proc/net/tcp6 (proc_net(5)). Raises OSError."""
    for name, size in (("tcp", 4), ("tcp6", 16)):
        wanted = [_written(end, size) for end in (peer, here)]
        if None in wanted:
            continue
        with open(f"/proc/net/{name}", encoding="ascii") as table:
            for line in table:
                fields = line.split()
                if fields[1:3] == wanted and int(fields[9]):
                    return int(fields[7])
    return None


def _written(end: tuple[IPv4Address | IPv6Address, int], size: int) -> str | None:
    """An address and port as the tables have them: words of the machine's byte order. None: not in this table."""
    address = end[0] if size == 4 else _as_ipv6(end[0])
    if len(address.packed) != size:
        return None
    words = struct.unpack(f"={size // 4}I", address.packed)
    return f"{''.join(f'{word:08X}' for word in words)}:{end[1]:04X}"
