"""The link in memory: an endpoint to the fleet, and a port that speaks MAVLink without MAVSDK.

`Wire` is the one way between a fleet and a service; it carries nothing while it is cut.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Hashable

from skyfolio import sim
from skyfolio.api.lab.virtual.codec import Decoded, decode, encode, number_of
from skyfolio.mavlink_bridge.errors import ConnectionFailed
from skyfolio.mavlink_bridge.framing import Framer
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT
from skyfolio.mavlink_bridge.links import OnFrames
from skyfolio.mavlink_bridge.message_port import NotSentError, Receive
from skyfolio.mavlink_bridge.mission_messages import GROUND, Message

HEARTBEAT, HEARTBEAT_EVERY_S = 0, 1.0
_GROUND_STATION = {
    "type": 6,
    "autopilot": 8,
    "base_mode": 0,
    "custom_mode": 0,
    "system_status": 4,
    "mavlink_version": 3,
}
"""HEARTBEAT of a ground station: MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE."""


class Port:
    """A port at which a fleet in this process is heard: it has one holder at a time, as a bound socket has.

    place: which of several ports it is; the fleet sends to all of them.
    """

    def __init__(self, fleet: sim.Fleet, place: int = 0) -> None:
        self.fleet, self.place = fleet, place
        self.holder: MemoryEndpoint | None = None
        self.heard_s: dict[int, float] = {}
        """When something of each vehicle arrived last at a living process, by its clock."""
        self.heartbeats_s: dict[int, list[float]] = {}
        """When HEARTBEATs of each vehicle's autopilot arrived at one."""

    @property
    def is_free(self) -> bool:
        """Return whether no living process listens here."""
        return self.holder is None or not self.holder.is_open


class MemoryEndpoint:
    """One end of a link to all vehicles of a fleet in this process; an `Endpoint` of the bridge.

    alive: returns whether the process at this end still runs; the port of one that is dead is free.
    """

    def __init__(self, port: Port, url: str, on_frames: OnFrames, *, alive: Callable[[], bool]) -> None:
        self.url = url
        self._port, self._fleet = port, port.fleet
        self._on_frames, self._alive = on_frames, alive
        self._framers: dict[int, Framer] = {}
        self._inbox: list[tuple[bytes, int]] = []
        self._send: Callable[[bytes, int], None] | None = None
        self._loop = asyncio.get_running_loop()

    @property
    def is_open(self) -> bool:
        """Return whether this end listens."""
        return self._send is not None and self._alive()

    async def open(self) -> None:
        """Begin to listen. Raises ConnectionFailed while another process does at this port."""
        if not self._port.is_free:
            raise ConnectionFailed(self.url, "address already in use")
        self._port.holder = self
        self._send = self._fleet.attach(self._arrived, ("gcs", self._port.place))

    def send(self, frame: bytes, system_id: int) -> None:
        """Send to one vehicle, or to all that were heard here (0)."""
        if self._send is None or not self._alive():
            return
        for known in [system_id] if system_id else list(self._framers):
            if known in self._fleet.vehicles:
                self._send(frame, known)

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Ignore it: a vehicle has one way only."""

    def close(self) -> None:
        """Stop listening and sending."""
        self._send = None

    def _arrived(self, data: bytes, system_id: int) -> None:
        if self._send is None or not self._alive():
            return
        self._inbox.append((data, system_id))
        if len(self._inbox) == 1:
            self._loop.call_soon(self._take_in)

    def _take_in(self) -> None:
        inbox, self._inbox = self._inbox, []
        for data, system_id in inbox:
            frames = self._framers.setdefault(system_id, Framer()).feed(data)
            self._port.heard_s[system_id] = now_s = self._loop.time()
            for frame in frames:
                if frame.message_id == HEARTBEAT and frame.component_id == AUTOPILOT:
                    self._port.heartbeats_s.setdefault(system_id, []).append(now_s)
            if frames and self._send is not None and self._alive():
                self._on_frames(self, frames)


class MemoryMessages:
    """A `MessagePort` of our own framing. alive: returns whether the service at this end still runs."""

    def __init__(
        self,
        now_s: Callable[[], float],
        to_vehicles: Callable[[bytes], object],
        on_new_system: Callable[[], None],
        *,
        alive: Callable[[], bool] = lambda: True,
    ) -> None:
        self._alive = alive
        self._now_s, self._to_vehicles, self._on_new_system = now_s, to_vehicles, on_new_system
        self._loop = asyncio.get_running_loop()
        self._seq = 0
        self._heard: dict[int, None] = {}
        self._listeners: dict[tuple[int, str], Receive] = {}
        self._beating: asyncio.TimerHandle | None = None
        self._closed = False

    def take_in(self, data: bytes) -> None:
        """Take in whole frames that vehicles have sent."""
        heard_s, wanted = self._now_s(), []
        for message in decode(data):
            if message.system_id not in self._heard:
                self._discover(message.system_id)
            receive = self._listeners.get((message.system_id, message.name))
            if receive is not None and message.component_id == AUTOPILOT:
                wanted.append((receive, message))
        if wanted:
            self._loop.call_soon(self._hand_over, wanted, heard_s)

    async def systems(self) -> Collection[int]:
        """Return the ids of the systems that were heard so far."""
        return list(self._heard)

    def listen(self, system_id: int, names: Collection[str], receive: Receive) -> None:
        """Hand over each of these messages that the system's autopilot sends."""
        for name in names:
            self._listeners[system_id, name] = receive

    def send(self, system_id: int, message: Message) -> None:
        """Send a message, which names its target itself, to a system. Raises NotSentError."""
        del system_id
        if self._closed:
            raise NotSentError("CONNECTION_ERROR")
        try:
            number_of(message.name)
            frame = encode(message.name, message.fields, sender=GROUND, seq=self._next_seq())
        except KeyError as error:
            raise NotSentError(f"INVALID_MESSAGE: {error}") from error
        self._to_vehicles(frame)

    async def close(self) -> None:
        """End it."""
        self._closed = True
        self._listeners.clear()
        if self._beating is not None:
            self._beating.cancel()

    def _hand_over(self, wanted: list[tuple[Receive, Decoded]], heard_s: float) -> None:
        for receive, message in wanted:
            if not self._closed:
                receive(message.name, message.fields, heard_s)

    def _discover(self, system_id: int) -> None:
        self._heard[system_id] = None
        self._loop.call_soon(self._on_new_system)
        if self._beating is None:
            self._beat()

    def _beat(self) -> None:
        if not self._alive():
            return
        self._to_vehicles(encode("HEARTBEAT", _GROUND_STATION, sender=GROUND, seq=self._next_seq()))
        self._beating = self._loop.call_later(HEARTBEAT_EVERY_S, self._beat)

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) % 256
        return self._seq
