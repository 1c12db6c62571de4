"""A vehicle's radio: one UDP socket of its own, one MAVLink parser for each peer address.

Telemetry goes to the endpoint and to every peer that has spoken valid MAVLink 2 to this socket; answers go to whoever
asked.
"""

import asyncio
import re
import socket
from collections.abc import Callable
from typing import Any, cast

from sim.wire import Decoder

Address = tuple[Any, ...]
OnMessage = Callable[[Any, Address], None]

MAX_PEERS = 8
_ENDPOINT = re.compile(r"udpout://(?P<host>\[[0-9a-fA-F:]+\]|[^:/\s]+):(?P<first>\d+)(-(?P<last>\d+))?")


def endpoints_of(url: str, count: int) -> list[tuple[str, int]]:
    """Return (host, port) for each of `count` vehicles.

    `udpout://HOST:PORT` sends all of them to one port; `udpout://HOST:FIRST-LAST` gives each its own, in order.
    ValueError for anything else, and for a range with too few ports.
    """
    match = _ENDPOINT.fullmatch(url)
    if match is None:
        raise ValueError(f"endpoint must look like udpout://HOST:PORT or udpout://HOST:FIRST-LAST, got {url!r}")
    host, first = match["host"].strip("[]"), int(match["first"])
    last = int(match["last"] or first)
    if not 1 <= first <= last <= 65535:
        raise ValueError(f"endpoint ports must be between 1 and 65535 and ascending, got {url!r}")
    if match["last"] is None:
        return [(host, first)] * count
    if last - first + 1 < count:
        raise ValueError(f"endpoint {url!r} has {last - first + 1} ports for {count} vehicles")
    return [(host, port) for port in range(first, first + count)]


class DatagramLink(asyncio.DatagramProtocol):
    """Sends datagrams and hands each incoming message on as `on_message(message, sender)`. Made by `open_link`."""

    def __init__(self, remote: Address, on_message: OnMessage) -> None:
        self.remote = remote
        self._on_message = on_message
        self._decoders: dict[Address, Decoder] = {}
        self._transport: asyncio.DatagramTransport | None = None

    @property
    def is_open(self) -> bool:
        """Whether anything can still be sent or heard."""
        return self._transport is not None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport (asyncio calls this)."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Parse a datagram with its sender's own parser (asyncio calls this)."""
        decoder = self._decoders.get(addr) or Decoder()
        for message in decoder.decode(data):
            if addr not in self._decoders:
                self._remember(addr, decoder)
            if self._transport is not None:
                self._on_message(message, addr)

    def error_received(self, exc: Exception) -> None:
        """Ignore ICMP errors: nobody listening yet is no reason to stop talking."""

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram, if the link is still open."""
        if self._transport is not None:
            self._transport.sendto(data, address)

    def broadcast(self, data: bytes) -> None:
        """Send one datagram to the endpoint and to every other known peer."""
        self.send(data, self.remote)
        for address in self._decoders:
            if address != self.remote:
                self.send(data, address)

    def close(self) -> None:
        """Fall silent and deaf for good; what is still queued is dropped."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.abort()

    def _remember(self, address: Address, decoder: Decoder) -> None:
        if len(self._decoders) >= MAX_PEERS:
            stranger = next(known for known in self._decoders if known != self.remote)
            del self._decoders[stranger]
        self._decoders[address] = decoder


async def open_link(host: str, port: int, on_message: OnMessage) -> DatagramLink:
    """Open a socket on a free port that talks to (host, port); OSError if the host is unknown."""
    loop = asyncio.get_running_loop()
    family, _, _, _, remote = (await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))[0]
    any_host = "::" if family == socket.AF_INET6 else "0.0.0.0"  # noqa: S104
    local = remote[0] if remote[0] in ("127.0.0.1", "::1") else any_host
    _, link = await loop.create_datagram_endpoint(
        lambda: DatagramLink(remote, on_message), local_addr=(local, 0), family=family
    )
    return link
