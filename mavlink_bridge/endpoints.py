"""One radio, socket or cable to vehicles, by URL. Each hands on whole frames and sends frames; none looks inside.

udpin://HOST:PORT       listen; vehicles send here, and are answered where they sent from
udpout://HOST:PORT      send there first (a vehicle or router that listens)
tcpout://HOST:PORT      connect, and again whenever the connection breaks (tcp:// means the same)
serial://DEVICE:BAUD    a telemetry radio or cable, opened again whenever it is unplugged
"""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any, Protocol

import serial

from mavlink_bridge.errors import ConnectionFailed
from mavlink_bridge.framing import Frame, Framer
from mavlink_bridge.heartbeat import AUTOPILOT

OnFrames = Callable[["Endpoint", list[Frame]], None]
Address = tuple[Any, ...]

RETRY_S = 1.0
"""Before a broken connection is tried again."""
MOST_WAITING_BYTES = 16_384
"""Bytes that may wait for a slow line; whole frames beyond are dropped: an old setpoint is worse than none."""
MAX_PEERS = 256
_READ_BYTES = 65536
NETWORK = re.compile(r"(?P<scheme>udpin|udpout|tcpout|tcp)://(?P<host>\[[0-9a-fA-F:]+\]|[^:/\s]+):(?P<port>\d{1,5})")
_SERIAL = re.compile(r"serial://(?P<device>[^:]+):(?P<baud>\d+)")


class Endpoint(Protocol):
    """What the hub needs of a connection."""

    url: str

    async def open(self) -> None:
        """Begin; raises ConnectionFailed. What may come later (a vehicle that is switched on) is no failure."""
        ...

    def send(self, frame: bytes, system_id: int) -> None:
        """Send one frame to a vehicle, or to all that were heard here (0); nothing while it is broken. Never waits."""
        ...

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Take in that a component is heard from this address, by a frame that passed every check."""
        ...

    def close(self) -> None:
        """End it for good."""
        ...


class Datagrams(asyncio.DatagramProtocol):
    def __init__(self, receive: Callable[[bytes, Address], None]) -> None:
        self._receive = receive

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._receive(data, addr)


class UdpIn:
    """Many vehicles on one port: a parser for each sender; a vehicle is answered where its autopilot is heard from."""

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
        """To where the vehicle is heard from: its autopilot, or else whatever of it is; to all of them for 0."""
        if self._transport is None:
            return
        components = self._places.get(system_id)
        if components is not None:
            places = {components[AUTOPILOT]} if AUTOPILOT in components else set(components.values())
        else:
            places = {address for one in self._places.values() for address in one.values()}
        for address in places:
            self._transport.sendto(frame, address)

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Answer this component there from now on."""
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


class _OneEnd:
    """A link with one other end: everybody is answered there."""

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Nothing to learn."""


class UdpOut(_OneEnd):
    """One remote address; it learns of us by our heartbeats."""

    def __init__(self, url: str, host: str, port: int, on_frames: OnFrames) -> None:
        self.url = url
        self._at = (host, port)
        self._on_frames = on_frames
        self._framer = Framer()
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> None:
        """Resolve the address; it need not listen yet."""
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: Datagrams(self._received), remote_addr=self._at
            )
        except OSError as error:
            raise ConnectionFailed(self.url, str(error)) from error
        self._transport = transport

    def send(self, frame: bytes, system_id: int) -> None:
        """To the one address there is."""
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


class TcpOut(_OneEnd):
    """A connection that is made again whenever it breaks."""

    def __init__(self, url: str, host: str, port: int, on_frames: OnFrames) -> None:
        self.url = url
        self._at = (host, port)
        self._on_frames = on_frames
        self.dropped = 0
        """Frames that were not sent because the other end did not take those before."""
        self._writer: asyncio.StreamWriter | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Connect once, so that a wrong address is told at once."""
        try:
            reader, writer = await asyncio.open_connection(*self._at)
        except OSError as error:
            raise ConnectionFailed(self.url, str(error)) from error
        self._task = asyncio.create_task(self._keep(reader, writer), name=f"link {self.url}")

    def send(self, frame: bytes, system_id: int) -> None:
        """Into the stream, if it is up."""
        del system_id
        writer = self._writer
        if writer is None or writer.is_closing():
            return
        if writer.transport.get_write_buffer_size() + len(frame) > MOST_WAITING_BYTES:
            self.dropped += 1
            return
        writer.write(frame)

    def close(self) -> None:
        """Hang up."""
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
            while data := await reader.read(_READ_BYTES):
                frames = framer.feed(data)
                if frames:
                    self._on_frames(self, frames)


class SerialLine(_OneEnd):
    """A telemetry radio or a cable; opened again whenever it was unplugged."""

    def __init__(self, url: str, device: str, baud: int, on_frames: OnFrames) -> None:
        self.url = url
        self._device, self._baud = device, baud
        self._on_frames = on_frames
        self._framer = Framer()
        self._loop = asyncio.get_running_loop()
        self.dropped = 0
        """Frames that were not sent because too much waited."""
        self._waiting = bytearray()
        self._port: serial.Serial | None = None
        self._again: asyncio.TimerHandle | None = None

    async def open(self) -> None:
        """Open the device."""
        try:
            self._begin()
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise ConnectionFailed(self.url, str(error)) from error

    def send(self, frame: bytes, system_id: int) -> None:
        """Into the line, if it is plugged in: whole, or not at all while too much waits for it."""
        del system_id
        if self._port is None:
            return
        if len(self._waiting) + len(frame) > MOST_WAITING_BYTES:
            self.dropped += 1
            return
        self._waiting += frame
        self._flush()

    def close(self) -> None:
        """Close the device."""
        if self._again is not None:
            self._again.cancel()
        self._end()

    def _begin(self) -> None:
        self._port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)
        os.set_blocking(self._port.fileno(), False)
        self._loop.add_reader(self._port.fileno(), self._read)

    def _flush(self) -> None:
        """Write what the line takes now; the rest when it takes more."""
        if self._port is None:
            return
        try:
            written = os.write(self._port.fileno(), self._waiting) if self._waiting else 0
        except BlockingIOError:
            written = 0
        except OSError:
            self._broken()
            return
        del self._waiting[:written]
        if self._waiting:
            self._loop.add_writer(self._port.fileno(), self._flush)
        else:
            self._loop.remove_writer(self._port.fileno())

    def _read(self) -> None:
        if self._port is None:
            return
        try:
            data = self._port.read(_READ_BYTES)
        except OSError:
            self._broken()
            return
        frames = self._framer.feed(data)
        if frames:
            self._on_frames(self, frames)

    def _end(self) -> None:
        port, self._port = self._port, None
        self._waiting.clear()
        if port is not None:
            self._loop.remove_reader(port.fileno())
            self._loop.remove_writer(port.fileno())
            port.close()

    def _broken(self) -> None:
        self._end()
        self._again = self._loop.call_later(RETRY_S, self._try_again)

    def _try_again(self) -> None:
        try:
            self._begin()
        except OSError:
            self._broken()


def endpoint_of(url: str, on_frames: OnFrames) -> Endpoint:
    """The endpoint a URL names, not opened yet. Raises ConnectionFailed naming the rule."""
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
