"""The one link of the service to all of its vehicles: opened when the first is registered, closed with the service."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.fleet.vehicle_news import FleetNews
from skyfolio.mavlink_bridge import FleetLink, HeartbeatMonitor, LinkOptions, Signing
from skyfolio.mavlink_bridge.ports import LinkPorts

MOVE_MARGIN_S = 1.0
"""Wall seconds after a loss would be declared, from when on a vehicle may be heard from another address."""


class FleetConnection:
    """Opens and closes the link, and lets `news` follow it.

    monitor: judges the heartbeats. healthy: returns whether vehicles may rely on us; our HEARTBEAT is only sent while
    it does. ports: what the link is made of. may_send: whether a frame may leave for a system id now
    (`LinkOptions.may_send`).
    """

    def __init__(
        self,
        settings: Settings,
        clock: FleetClock,
        news: FleetNews,
        background: Supervisor,
        healthy: Callable[[], bool],
        ports: LinkPorts,
        may_send: Callable[[int], bool] | None = None,
    ) -> None:
        self.monitor = HeartbeatMonitor(
            stale_after_s=settings.heartbeat_stale_s,
            lost_after_s=settings.heartbeat_lost_s,
            recovered_after_s=settings.timing.recovered_after_s,
        )
        self._settings, self._clock, self._news = settings, clock, news
        self._background, self._healthy, self._ports = background, healthy, ports
        self._may_send = may_send
        self._link: FleetLink | None = None
        self._followers: list[asyncio.Task[None]] = []
        self._opening = asyncio.Lock()

    @property
    def link(self) -> FleetLink:
        """Return the open link. Raises ConflictError before any vehicle is registered."""
        if self._link is None:
            raise ConflictError("fleet: no vehicle is registered, so no link is open")
        return self._link

    @property
    def urls(self) -> tuple[str, ...]:
        """Return the URLs of the link's endpoints, the preferred one first."""
        return tuple(url.strip() for url in self._settings.fleet_url.split(","))

    async def open(self, patience_s: float = 0.0) -> None:
        """Open the link unless it is open. Raises ConnectionFailed.

        patience_s: wall seconds for which a port may still be taken, as by the guard of a process that was killed.
        """
        async with self._opening:
            if self._link is None:
                async with AsyncExitStack() as opening:
                    link = await opening.enter_async_context(
                        FleetLink(
                            clock=self._clock,
                            monitor=self.monitor,
                            options=self._options(),
                            timing=self._settings.timing,
                            ports=self._ports,
                        )
                    )
                    for url in self.urls:
                        await link.connect(url, patience_s=patience_s)
                    opening.pop_all()  # it stays open: `close` ends it
                self._link = link
                self._followers = self._news.start(link, self._background)

    async def close(self) -> None:
        """Close the link; the vehicles keep what they have on board."""
        for task in self._followers:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        if self._link is not None:
            await self._link.close()
            self._link = None

    def _options(self) -> LinkOptions:
        """Return signing and forwarding as the settings have them, and the dead man's switch."""
        settings = self._settings
        key = settings.signing_key_file
        return LinkOptions(
            signing=Signing.from_file(key) if key is not None else None,
            forward=settings.forward_url,
            forward_commands=settings.forward_commands,
            healthy=self._healthy,
            may_send=self._may_send,
            on_sender=self._news.note_sender,
            moves_after_s=settings.heartbeat_lost_s / self._clock.scale + MOVE_MARGIN_S,
        )
