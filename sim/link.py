"""How messages travel: one link for each vehicle, over a UDP socket or in memory, impaired in each direction.

`Link` keeps its peers (one parser each) and the datagrams under way; `DatagramLink` has a socket in the running event
loop, `MemoryLink` passes bytes to functions, for tests in virtual time. The fleet calls `pump` to deliver datagrams
that have been delayed.
"""

import asyncio
import re
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, cast

from skyfolio.sim.impairments import Channel, Impairments
from skyfolio.sim.wire import Decoder

Address = tuple[Any, ...]
OnMessage = Callable[[Any, Address], None]

MAX_PEERS = 8
_ENDPOINT = re.compile(r"udpout://(?P<host>\[[0-9a-fA-F:]+\]|[^:/\s]+):(?P<first>\d+)(-(?P<last>\d+))?")


def endpoints_of(urls: str, count: int) -> list[list[tuple[str, int]]]:
    """Return for each of `count` vehicles every (host, port) it sends to; the URLs are separated by commas.

    `udpout://HOST:PORT` sends all of them to one port; `udpout://HOST:FIRST-LAST` gives each its own, in order.
    ValueError for anything else, and for a range with too few ports.
    """
    ends = [_endpoints_of(url.strip(), count) for url in urls.split(",")]
    if len(ends) > MAX_PEERS // 2:
        raise ValueError(f"endpoint: a vehicle sends to at most {MAX_PEERS // 2}, got {len(ends)}")
    return [list(each) for each in zip(*ends, strict=True)]


def _endpoints_of(url: str, count: int) -> list[tuple[str, int]]:
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


class Radio:
    """The two directions of one vehicle's link; they outlive its sockets. `down` is from the vehicle, `up` to it."""

    def __init__(self, seed: str, clock: Callable[[], float], new_decoder: Callable[[], Decoder] = Decoder) -> None:
        self.clock = clock
        self.new_decoder = new_decoder
        self.down: Channel[tuple[bytes, Address]] = Channel(f"{seed}/down")
        self.up: Channel[tuple[bytes, Address]] = Channel(f"{seed}/up")

    def impair(self, *, up: Impairments | None = None, down: Impairments | None = None) -> None:
        """Set the impairments of a direction from now on; None leaves them as they are."""
        self.up.impairments = self.up.impairments if up is None else up
        self.down.impairments = self.down.impairments if down is None else down


class Link(ABC):
    """Sends datagrams, and passes each incoming message on as `on_message(message, sender)`.

    remotes: the endpoints, to which it sends whether they are there or not.
    """

    def __init__(self, remotes: Sequence[Address], radio: Radio, on_message: OnMessage) -> None:
        self.remotes = tuple(remotes)
        self._radio = radio
        self._on_message = on_message
        self._decoders: dict[Address, Decoder] = {}

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """Whether the link can still send and receive."""

    @abstractmethod
    def close(self) -> None:
        """Stop sending and receiving for good; queued datagrams are dropped."""

    @abstractmethod
    def _emit(self, data: bytes, address: Address) -> None:
        """Send a datagram that has passed the link."""

    def receive(self, data: bytes, sender: Address) -> None:
        """Take a datagram from outside; it arrives when the link delivers it."""
        self._radio.up.push((data, sender), len(data), self._radio.clock())
        self._arrive()

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram, if the link is still open."""
        if self.is_open:
            self._radio.down.push((data, address), len(data), self._radio.clock())
            self._leave()

    def broadcast(self, data: bytes) -> None:
        """Send one datagram to the endpoints and to every other known peer."""
        for address in (*self.remotes, *(peer for peer in self._decoders if peer not in self.remotes)):
            self.send(data, address)

    def pump(self) -> None:
        """Deliver the datagrams that were delayed until now."""
        if self.is_open and (self._radio.down or self._radio.up):
            self._leave()
            self._arrive()

    def _leave(self) -> None:
        for data, address in self._radio.down.pop(self._radio.clock()):
            if self.is_open:
                self._emit(data, address)

    def _arrive(self) -> None:
        for data, sender in self._radio.up.pop(self._radio.clock()):
            self._parse(data, sender)

    def _parse(self, data: bytes, sender: Address) -> None:
        """Parse a datagram with its sender's own parser."""
        decoder = self._decoders.get(sender) or self._radio.new_decoder()
        for message in decoder.decode(data):
            if sender not in self._decoders:
                self._remember(sender, decoder)
            if self.is_open:
                self._on_message(message, sender)

    def _remember(self, address: Address, decoder: Decoder) -> None:
        if len(self._decoders) >= MAX_PEERS:
            oldest = next(peer for peer in self._decoders if peer not in self.remotes)
            del self._decoders[oldest]
        self._decoders[address] = decoder


class DatagramLink(Link, asyncio.DatagramProtocol):
    """A link over a UDP socket; `open_link` opens one."""

    def __init__(self, remotes: Sequence[Address], radio: Radio, on_message: OnMessage) -> None:
        super().__init__(remotes, radio, on_message)
        self._transport: asyncio.DatagramTransport | None = None

    @property
    def is_open(self) -> bool:
        """Whether the link can still send and receive."""
        return self._transport is not None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport (asyncio calls this)."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Take a datagram (asyncio calls this)."""
        self.receive(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Ignore ICMP errors: the vehicle sends even while there is no receiver."""

    def close(self) -> None:
        """Stop sending and receiving for good; queued datagrams are dropped."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.abort()

    def _emit(self, data: bytes, address: Address) -> None:
        if self._transport is not None:
            self._transport.sendto(data, address)


class MemoryLink(Link):
    """A link to functions in this process: `stations[address](data, system_id)` takes the vehicle's datagrams."""

    def __init__(
        self,
        remote: Address,
        radio: Radio,
        on_message: OnMessage,
        *,
        system_id: int,
        stations: dict[Address, Callable[[bytes, int], None]],
    ) -> None:
        super().__init__([remote], radio, on_message)
        self._system_id = system_id
        self._stations = stations
        self._open = True

    def add(self, remote: Address) -> None:
        """Send to this endpoint, too."""
        if remote not in self.remotes:
            self.remotes = (*self.remotes, remote)

    @property
    def is_open(self) -> bool:
        """Whether the link can still send and receive."""
        return self._open

    def close(self) -> None:
        """Stop sending and receiving for good."""
        self._open = False

    def _emit(self, data: bytes, address: Address) -> None:
        if address in self._stations:
            self._stations[address](data, self._system_id)


async def open_link(ends: Sequence[tuple[str, int]], radio: Radio, on_message: OnMessage) -> DatagramLink:
    """Open a socket on a free port that talks to these (host, port), all of one family; OSError for an unknown host."""
    loop = asyncio.get_running_loop()
    found = [(await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))[0] for host, port in ends]
    families, remotes = {entry[0] for entry in found}, [entry[4] for entry in found]
    if len(families) > 1:
        raise OSError(f"endpoints of one vehicle are all IPv4 or all IPv6, got {remotes}")
    (family,) = families
    any_host = "::" if family == socket.AF_INET6 else "0.0.0.0"  # noqa: S104
    near = [remote[0] for remote in remotes if remote[0] in ("127.0.0.1", "::1")]
    local = near[0] if len(near) == len(remotes) else any_host
    _, link = await loop.create_datagram_endpoint(
        lambda: DatagramLink(remotes, radio, on_message), local_addr=(local, 0), family=family
    )
    return link
