"""The user of a TCP connection that comes from this machine.

Ports of loopback have no file permissions: every user of a machine reaches them. A server that has no other way to tell
its clients apart asks the kernel here who owns the other end. Linux only; elsewhere nothing can be told.
"""

from __future__ import annotations

import os
import socket
import struct
from ipaddress import IPv4Address, IPv6Address, ip_address

from slidectl.operating_system import LINUX

Address = tuple[str, int]
"""Host, as a number, and port."""


def can_be_told() -> bool:
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
    for name, size in (("tcp", 4), ("tcp6", 16)):
        wanted = [_written(_numbers(end), size) for end in (peer, here)]
        try:
            with open(f"/proc/net/{name}", encoding="ascii") as table:  # see proc_net(5)
                for line in table:
                    fields = line.split()
                    if fields[1:3] == wanted and int(fields[9]):
                        return int(fields[7])
        except OSError:  # a sandbox without these files
            return None
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


def _written(end: tuple[IPv4Address | IPv6Address, int], size: int) -> str | None:
    """An address and port as the tables have them: words of the machine's byte order. None: not in this table."""
    address = end[0]
    if size == 16 and isinstance(address, IPv4Address):
        address = IPv6Address(f"::ffff:{address}")
    if len(address.packed) != size:
        return None
    words = struct.unpack(f"={size // 4}I", address.packed)
    return f"{''.join(f'{word:08X}' for word in words)}:{end[1]:04X}"
