"""The user of a TCP connection that comes from this machine.

Ports of loopback have no file permissions: every user of a machine reaches them. A server that has no other way to tell
its clients apart asks the kernel here who owns the other end. Linux only; elsewhere nothing can be told.
"""

from __future__ import annotations

import os
import socket
import struct
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address

from slidectl.operating_system import tells_owners_of_connections

Address = tuple[str, int]
"""Host, as a number, and port."""

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


def can_be_told() -> bool:
    """True where the user of a connection can be found: this process asks about a connection of its own."""
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as own:
        return owner(own.getsockname(), listener.getsockname()) == os.geteuid()


def owner(peer: Address, here: Address) -> int | None:
    """The user id of the process at `peer`, the other end of a TCP connection to `here`.

    None when it is no connection of this machine, or when its process has closed it already: the kernel then shows it
    as one of root.
    """
    if not tells_owners_of_connections():
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
        return f"this belongs to the user {own}, and the connection comes from the user {uid}"
    address = _numbers(peer)[0]
    if address.is_loopback or address == _numbers(here)[0]:
        return "the user of the connection cannot be told"
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
