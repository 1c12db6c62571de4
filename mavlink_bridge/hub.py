"""Between MAVSDK and the world: all links, signing, the forward port, the telemetry log, and our own heartbeat.

    vehicles <--endpoints--> Hub <--raw bytes--> MAVSDK
                              |--> watchers (QGroundControl, MAVProxy)
                              '--> .tlog

MAVSDK has one connection, `raw://`, and knows nothing of any of this. Lives on the event loop; `to_vehicles` may be
called from MAVSDK's threads. Our heartbeat is a dead man's switch: MAVSDK makes it, but it passes through the event
loop and only while `healthy()`; vehicles whose failsafe watches ground stations notice when we are not.

Here is also the one place where frames leave for vehicles. Where several services command one fleet, each frame is
checked here as it leaves (`LinkOptions.may_send`), whatever made it: no queue before it can outlive the permission.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from skyfolio.mavlink_bridge.endpoints import endpoint_of
from skyfolio.mavlink_bridge.framing import Frame, Framer
from skyfolio.mavlink_bridge.links import Endpoint, MakeEndpoint, OneEnd
from skyfolio.mavlink_bridge.routing import Routes
from skyfolio.mavlink_bridge.senders import SenderNotice, Senders
from skyfolio.mavlink_bridge.signing import Signing
from skyfolio.mavlink_bridge.tlog import TelemetryLog
from skyfolio.mavlink_bridge.watchers import Watchers

_HEARTBEAT = 0
_EVERYBODY = 0
_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class LinkOptions:
    """How the links work. `forward`: udpout:// URL of a watcher; `forward_commands`: whether it may command too.

    `signing`: keys on both ends; then MAVLink 1, unsigned and forged frames are dropped. `healthy`: whether vehicles
    may count on this service; our heartbeat is only sent while it returns true. `may_send`: whether a frame may leave
    for this system id now, 0: for any at all; None where no other service commands the fleet. What addresses all
    vehicles is then sent to each one that may be sent to. `on_sender`: called on the loop when a
    vehicle is heard from another address, from two places, or on a second link; `moves_after_s`: wall seconds of
    silence before it may be heard from another address, longer than a loss takes to be declared.
    """

    signing: Signing | None = None
    forward: str | None = None
    forward_commands: bool = False
    healthy: Callable[[], bool] = lambda: True
    may_send: Callable[[int], bool] | None = None
    on_sender: Callable[[SenderNotice], None] = lambda _notice: None
    moves_after_s: float = 6.0


class Hub:
    """Carries frames. `to_mavsdk(data)` gets what vehicles send; `on_heard(frame)` each frame of it, unsigned.

    is_wanted: which systems are heard at all. Each costs MAVSDK threads and memory for good, so the frames of others
    are dropped.
    """

    def __init__(
        self,
        options: LinkOptions,
        *,
        to_mavsdk: Callable[[bytes], None],
        on_heard: Callable[[Frame], None],
        is_wanted: Callable[[int], bool] = lambda _system_id: True,
        endpoint: MakeEndpoint = endpoint_of,
    ) -> None:
        self._options = options
        self._to_mavsdk, self._on_heard, self._is_wanted = to_mavsdk, on_heard, is_wanted
        self._make_endpoint = endpoint
        self._senders = Senders(moves_after_s=options.moves_after_s)
        self._loop = asyncio.get_running_loop()
        self._endpoints: dict[str, Endpoint] = {}
        self._framer = Framer()
        self._routes = Routes()
        self._watchers: Watchers | None = None
        self._logs: set[TelemetryLog] = set()
        self._closed = False

    async def connect(self, url: str) -> None:
        """Open a further link; the earlier ones are preferred. Raises ConnectionFailed."""
        if self._options.forward is not None and self._watchers is None:
            self._watchers = Watchers(
                self._options.forward, self._from_watcher if self._options.forward_commands else None
            )
            await self._watchers.open()
        endpoint = self._make_endpoint(url, self._received)
        await endpoint.open()
        self._endpoints[url] = endpoint
        self._routes.add(url)

    def links_of(self, system_id: int) -> list[str]:
        """Return the URL a vehicle is reached on now."""
        return self._routes.links_of(system_id, self._loop.time())

    def record(self, log: TelemetryLog) -> None:
        """Write all frames, both ways, into this log too, until it is passed to `stop_recording`."""
        self._logs.add(log)

    def stop_recording(self, log: TelemetryLog) -> None:
        """Close the log."""
        self._logs.discard(log)
        log.close()

    def to_vehicles(self, data: bytes) -> None:
        """Send what MAVSDK sends to the vehicles; may be called from any thread."""
        if not self._closed:
            self._loop.call_soon_threadsafe(self._send, data)

    def close(self) -> None:
        """Close everything."""
        self._closed = True
        for endpoint in self._endpoints.values():
            endpoint.close()
        if self._watchers is not None:
            self._watchers.close()
        for log in list(self._logs):
            self.stop_recording(log)

    def _received(self, endpoint: Endpoint, frames: list[Frame]) -> None:
        """Take in what a link received: genuine frames, each from where its sender is known to be, each once."""
        heard = []
        for frame in frames:
            data = self._accepted(endpoint, frame)
            if data is not None:
                heard.append(data)
                self._on_heard(frame)
        for notice in self._senders.notices():
            self._options.on_sender(notice)
        if not heard or self._closed:
            return
        self._log(heard)
        together = b"".join(heard)
        self._to_mavsdk(together)
        if self._watchers is not None:
            self._watchers.send(together)

    def _accepted(self, endpoint: Endpoint, frame: Frame) -> bytes | None:
        """Return the frame without its signature, None if it must be dropped. Checks come first, then claims."""
        if not self._is_wanted(frame.system_id):
            return None
        now = self._loop.time()
        data = frame.data if self._options.signing is None else self._options.signing.accept(frame)
        if data is None or not self._senders.accepts(endpoint.url, frame, now):
            return None
        if frame.source is not None:
            endpoint.place(frame.system_id, frame.component_id, frame.source)
        return data if self._routes.heard(endpoint.url, frame, now) else None

    def _send(self, data: bytes) -> None:
        if not self._closed:
            for frame in self._framer.feed(data):
                if frame.message_id != _HEARTBEAT or self._options.healthy():
                    self._send_frame(frame)

    def _send_frame(self, frame: Frame) -> None:
        ways = self._ways_of(frame.target)
        if not ways:
            return
        self._log([frame.data])
        data = frame.data
        if self._options.signing is not None:
            try:
                data = self._options.signing.sign(data)
            except ValueError as error:
                _LOGGER.warning("not sent: %s", error)
                return
        for url, system_id in ways:
            self._endpoints[url].send(data, system_id)

    def _ways_of(self, target: int) -> list[tuple[str, int]]:
        """Return the links on which a frame leaves, and the system id it leaves for on each; none if it may not."""
        now_s, may_send = self._loop.time(), self._options.may_send
        if may_send is None or (target != _EVERYBODY and may_send(target)):
            return [(url, target) for url in self._routes.links_of(target, now_s)]
        if target != _EVERYBODY or not may_send(_EVERYBODY):
            return []
        ours = [system_id for system_id in self._routes.heard_systems if may_send(system_id)]
        ways = [(url, system_id) for system_id in ours for url in self._routes.links_of(system_id, now_s)]
        ways += [(url, _EVERYBODY) for url in self._routes.unheard_links]  # whoever is there learns where we are
        one_end = {url: _EVERYBODY for url, _ in ways if isinstance(self._endpoints[url], OneEnd)}
        return [way for way in ways if way[0] not in one_end] + list(one_end.items())

    def _from_watcher(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            self._send_frame(frame)

    def _log(self, frames: Iterable[bytes]) -> None:
        for log in self._logs:
            for frame in frames:
                log.write(frame)
