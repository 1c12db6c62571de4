"""One radio, socket or cable to vehicles, by URL. Each carries whole frames both ways, without looking inside.

udpin://HOST:PORT       listen; vehicles send here, and are answered where they sent from
udpout://HOST:PORT      send there first (a vehicle or router that listens)
tcpout://HOST:PORT      connect, and again whenever the connection breaks (tcp:// means the same)
serial://DEVICE:BAUD    a telemetry radio or cable, opened again whenever it is unplugged
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any

from skyfolio.mavlink_bridge.errors import ConnectionFailed
from skyfolio.mavlink_bridge.framing import Framer
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT
from skyfolio.mavlink_bridge.links import MOST_WAITING_BYTES, READ_BYTES, RETRY_S, Endpoint, OneEnd, OnFrames
from skyfolio.mavlink_bridge.serial_line import SerialLine

Address = tuple[Any, ...]
MAX_PEERS = 256
NETWORK = re.compile(r"(?P<scheme>udpin|udpout|tcpout|tcp)://(?P<host>\[[0-9a-fA-F:]+\]|[^:/\s]+):(?P<port>\d{1,5})")
_SERIAL = re.compile(r"serial://(?P<device>[^:]+):(?P<baud>\d+)")


class Datagrams(asyncio.DatagramProtocol):
    """Hands each UDP datagram and its sender to `receive`."""

    def __init__(self, receive: Callable[[bytes, Address], None]) -> None:
        self._receive = receive

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Hand one datagram on."""
        self._receive(data, addr)


class UdpIn:
    """Many vehicles on one port: each sender has a parser; a vehicle is answered at the address of its autopilot."""

    def __init__(self, url: str, host: str, port: int, on_frames: OnFrames) -> None:
        self.url = url
        self._at = (host, port)
        self._on_frames = on_frames
        self._framers: dict[Address, Framer] = {}
        self._places: dict[int, dict[int, Address]] = {}
        self._transport: asyncio.DatagramTransport | None = None
        self._loop = asyncio.get_running_loop()

    async def open(self) -> None:
        """Bind the port."""
        try:
            transport, _ = await self._loop.create_datagram_endpoint(
                lambda: Datagrams(self._received), local_addr=self._at
            )
        except OSError as error:
            raise ConnectionFailed(self.url, str(error)) from error
        self._transport = transport

    def send(self, frame: bytes, system_id: int) -> None:
        """Send to the address the vehicle is heard from: its autopilot's, or else any component's; to all for 0."""
        if self._transport is None:
            return
        components = self._places.get(system_id)
        if components is not None:
            places = {components[AUTOPILOT]} if AUTOPILOT in components else set(components.values())
        else:
            places = {address for places in self._places.values() for address in places.values()}
        for address in places:
            self._transport.sendto(frame, address)

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Send answers for this component to this address from now on."""
        if isinstance(source, tuple):
            self._places.setdefault(system_id, {})[component_id] = source

    def close(self) -> None:
        """Free the port."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _received(self, data: bytes, address: Address) -> None:
        framer = self._framers.get(address)
        if framer is None:
            if len(self._framers) >= MAX_PEERS:
                self._framers.pop(next(iter(self._framers)))
            framer = self._framers[address] = Framer(address)
        frames = framer.feed(data)
        if frames:
            self._on_frames(self, frames)


class UdpOut(OneEnd):
    """One remote address, which learns ours from our heartbeats."""

    def __init__(self, url: str, host: str, port: int, on_frames: OnFrames) -> None:
        self.url = url
        self._at = (host, port)
        self._on_frames = on_frames
        self._framer = Framer()
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> None:
        """Resolve the address; the other end may begin to listen later."""
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: Datagrams(self._received), remote_addr=self._at
            )
        except OSError as error:
            raise ConnectionFailed(self.url, str(error)) from error
        self._transport = transport

    def send(self, frame: bytes, system_id: int) -> None:
        """Send to the one address there is."""
        del system_id
        if self._transport is not None:
            self._transport.sendto(frame)

    def close(self) -> None:
        """Close the socket."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _received(self, data: bytes, _address: Address) -> None:
        frames = self._framer.feed(data)
        if frames:
            self._on_frames(self, frames)


class TcpOut(OneEnd):
    """A connection that is opened again whenever it breaks."""

    def __init__(self, url: str, host: str, port: int, on_frames: OnFrames) -> None:
        self.url = url
        self._at = (host, port)
        self._on_frames = on_frames
        self.dropped = 0
        """The number of frames that were not sent because the other end did not take those before."""
        self._writer: asyncio.StreamWriter | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Connect once, so that a wrong address is reported at once. Raises ConnectionFailed."""
        try:
            reader, writer = await asyncio.open_connection(*self._at)
        except OSError as error:
            raise ConnectionFailed(self.url, str(error)) from error
        self._task = asyncio.create_task(self._keep(reader, writer), name=f"link {self.url}")

    def send(self, frame: bytes, system_id: int) -> None:
        """Write the frame into the stream, if the connection is up."""
        del system_id
        writer = self._writer
        if writer is None or writer.is_closing():
            return
        if writer.transport.get_write_buffer_size() + len(frame) > MOST_WAITING_BYTES:
            self.dropped += 1
            return
        writer.write(frame)

    def close(self) -> None:
        """Close the connection."""
        if self._task is not None:
            self._task.cancel()
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    async def _keep(self, reader: asyncio.StreamReader | None, writer: asyncio.StreamWriter | None) -> None:
        while True:
            if reader is None or writer is None:
                await asyncio.sleep(RETRY_S)
                with suppress(OSError):
                    reader, writer = await asyncio.open_connection(*self._at)
                continue
            self._writer = writer
            await self._read(reader)
            self._writer = None
            writer.close()
            reader = writer = None

    async def _read(self, reader: asyncio.StreamReader) -> None:
        framer = Framer()
        with suppress(OSError):
            while data := await reader.read(READ_BYTES):
                frames = framer.feed(data)
                if frames:
                    self._on_frames(self, frames)


def endpoint_of(url: str, on_frames: OnFrames) -> Endpoint:
    """Return the endpoint a URL names, not opened yet. Raises ConnectionFailed naming the rule."""
    network, line = NETWORK.fullmatch(url), _SERIAL.fullmatch(url)
    if network is not None and 1 <= int(network["port"]) <= 65535:
        kinds: dict[str, Callable[..., Endpoint]] = {
            "udpin": UdpIn,
            "udpout": UdpOut,
            "tcpout": TcpOut,
            "tcp": TcpOut,
        }
        return kinds[network["scheme"]](url, network["host"].strip("[]"), int(network["port"]), on_frames)
    if line is not None:
        return SerialLine(url, line["device"], int(line["baud"]), on_frames)
    raise ConnectionFailed(
        url, "must look like udpin://HOST:PORT, udpout://HOST:PORT, tcpout://HOST:PORT or serial://DEVICE:BAUD"
    )
