"""The forward port: a place where other ground stations watch the same fleet."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from skyfolio.mavlink_bridge.endpoints import NETWORK, UdpOut
from skyfolio.mavlink_bridge.errors import ConnectionFailed
from skyfolio.mavlink_bridge.framing import Frame
from skyfolio.mavlink_bridge.links import Endpoint


class Watchers:
    """A port where QGroundControl, MAVProxy or any other ground station watches the fleet.

    Frames of all vehicles go to `url` (udpout://HOST:PORT). What it sends is handed to `on_frames`, or dropped.
    """

    def __init__(self, url: str, on_frames: Callable[[Iterable[Frame]], None] | None) -> None:
        network = NETWORK.fullmatch(url)
        if network is None or network["scheme"] != "udpout":
            raise ConnectionFailed(url, "a forward port must look like udpout://HOST:PORT")
        self.url = url
        self._on_frames = on_frames
        self._link = UdpOut(url, network["host"].strip("[]"), int(network["port"]), self._heard)

    async def open(self) -> None:
        """Open the socket. Raises ConnectionFailed for an unknown host."""
        await self._link.open()

    def send(self, data: bytes) -> None:
        """Send frames of vehicles, in a row, to the watching station."""
        self._link.send(data, 0)

    def close(self) -> None:
        """Close the socket."""
        self._link.close()

    def _heard(self, _endpoint: Endpoint, frames: Iterable[Frame]) -> None:
        if self._on_frames is not None:
            self._on_frames(frames)
