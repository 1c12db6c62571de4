"""The forward port: a place where other ground stations watch the same fleet."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable
from typing import cast

from mavlink_bridge.endpoints import NETWORK, Address, Datagrams
from mavlink_bridge.errors import ConnectionFailed
from mavlink_bridge.framing import Frame, Framer


class Watchers:
    """A port where QGroundControl, MAVProxy or any other ground station watches the fleet.

    Frames of all vehicles go to `url` (udpout://HOST:PORT). What it sends is handed to `on_frames`, or dropped.
    """

    def __init__(self, url: str, on_frames: Callable[[Iterable[Frame]], None] | None) -> None:
        network = NETWORK.fullmatch(url)
        if network is None or network["scheme"] != "udpout":
            raise ConnectionFailed(url, "a forward port must look like udpout://HOST:PORT")
        self.url = url
        self._at = (network["host"].strip("[]"), int(network["port"]))
        self._on_frames = on_frames
        self._framer = Framer()
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> None:
        """Open the socket; raises ConnectionFailed for an unknown host."""
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(*self._at, type=socket.SOCK_DGRAM)
            transport, _ = await loop.create_datagram_endpoint(
                lambda: Datagrams(self._received), remote_addr=cast("tuple[str, int]", found[0][4][:2])
            )
        except OSError as error:
            raise ConnectionFailed(self.url, str(error)) from error
        self._transport = transport

    def send(self, data: bytes) -> None:
        """What vehicles said, frames in a row."""
        if self._transport is not None:
            self._transport.sendto(data)

    def close(self) -> None:
        """Close the socket."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _received(self, data: bytes, _address: Address) -> None:
        frames = self._framer.feed(data)
        if frames and self._on_frames is not None:
            self._on_frames(frames)
