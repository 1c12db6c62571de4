"""Ports that nobody uses, outside those that the system gives to outgoing connections.

One of those may be taken between the moment it is found free and the moment a process binds it, or while a service
that listened on it is killed and started again.
"""

import secrets
import socket
from pathlib import Path

FIRST = 20_000
RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")


def free_port(kind: socket.SocketKind) -> int:
    """A loopback port that is free now."""
    (port,) = free_ports(1, kind)
    return port


def free_ports(count: int, kind: socket.SocketKind = socket.SOCK_DGRAM) -> list[int]:
    """Loopback ports next to each other that are free now."""
    end = int(RANGE.read_text().split()[0])
    if end - FIRST < 1_000:  # a machine that gives nearly all of them away
        end = 61_000
    while True:
        first = FIRST + secrets.randbelow(end - FIRST - count)
        ports = list(range(first, first + count))
        if all(_is_free(port, kind) for port in ports):
            return ports


def _is_free(port: int, kind: socket.SocketKind) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
