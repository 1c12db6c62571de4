"""The vehicles of this service: which UAV of a plan is which MAVLink system, and the one link to all of them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from typing import Any

from sqlalchemy import delete, insert, select

from skyfolio.api.common.errors import ConflictError, InvalidError, NotFoundError
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.fleet.commander import Commander
from skyfolio.api.fleet.own_link import Heard, OwnLink
from skyfolio.api.fleet.vehicle_news import FleetNews
from skyfolio.api.fleet.vehicle_view import VehicleView, view_of
from skyfolio.api.store import Database
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.tables import vehicles as table
from skyfolio.mavlink_bridge import (
    FleetLink,
    HeartbeatMonitor,
    LinkOptions,
    LinkState,
    Signing,
    VehiclesMissing,
)
from skyfolio.mavlink_bridge.conditions import Change
from skyfolio.mavlink_bridge.mission_messages import GROUND

HEARD_WITHIN_S = 5.0
"""Wall seconds a vehicle may take to be heard before an upload, or the watch of its heartbeats, goes on without it."""
LATER_S = 1.0
"""Wall seconds after a loss would be declared, from when on a vehicle may be heard from another address."""
LINKS_FREE_S = 20.0
"""Wall seconds that a restarted service waits for its links."""


class Fleet:
    """Registered vehicles, the link that reaches them, and news of lost and found ones.

    `healthy()`: whether vehicles may count on us; our HEARTBEAT is only sent while it says so.
    """

    def __init__(
        self,
        settings: Settings,
        clock: FleetClock,
        events: EventLog,
        database: Database,
        background: Supervisor,
        healthy: Callable[[], bool] = lambda: True,
    ) -> None:
        self._healthy = healthy
        self._background = background
        self._settings, self._clock, self._events = settings, clock, events
        self._database = database
        self._simulated: set[str] = set()
        self._systems: dict[str, int] = {}
        self.news = FleetNews(self._systems, events)
        """What is heard of them."""
        self._link: FleetLink | None = None
        self._monitor = HeartbeatMonitor(
            stale_after_s=settings.heartbeat_stale_s,
            lost_after_s=settings.heartbeat_lost_s,
            recovered_after_s=settings.timing.recovered_after_s,
        )
        self.commander = Commander(lambda: self.link)
        """Through whom vehicles are commanded."""
        self._watchers: list[asyncio.Task[None]] = []
        self._opening = asyncio.Lock()
        self._finding: asyncio.Task[None] | None = None

    @property
    def link(self) -> FleetLink:
        """The open link. Raises ConflictError before any vehicle is registered."""
        if self._link is None:
            raise ConflictError("fleet: no vehicle is registered, so no link is open")
        return self._link

    async def start(self) -> None:
        """Take over the registry of the last process. Simulated vehicles have ended with it."""
        await self._database.write(delete(table).where(table.c.simulated.is_(True)))
        for row in await self._database.rows(select(table)):
            await self._open(patience_s=LINKS_FREE_S)
            self._systems[row.uav_id] = row.system_id
            self.link.expect({row.system_id})
        if self._systems:
            self._finding = asyncio.create_task(self._find(), name="fleet-find")

    async def _find(self) -> None:
        """Hear everybody before anybody is suspected: discovery takes wall time, silence counts fleet time."""
        with suppress(VehiclesMissing):
            await self.link.wait_for(set(self._systems.values()), timeout_s=HEARD_WITHIN_S)
        for system_id in self._systems.values():
            self.link.classifier.watch(system_id, self._clock.now())

    async def register(self, uav_id: str, system_id: int, *, simulated: bool = False) -> VehicleView:
        """Tie a UAV id to a MAVLink system id and open the link.

        Raises ConflictError when either is taken, InvalidError for the id this ground station has itself.
        """
        if system_id == GROUND[0]:
            raise InvalidError(
                f"system_id: {system_id} is this ground station's own on the link; give the vehicle another"
            )
        self._require_free(uav_id, system_id)
        await self._open()
        self._require_free(uav_id, system_id)  # others have registered while the link opened
        if uav_id not in self._systems:
            self._systems[uav_id] = system_id
            self.link.expect({system_id})
            self.link.classifier.watch(system_id, self._clock.now())
            row = {"uav_id": uav_id, "system_id": system_id, "simulated": simulated, "registered_at": time.time()}
            await self._database.write((insert(table), row))
            self._events.add("vehicle_registered", uav_id=uav_id, system_id=system_id, simulated=simulated)
        if simulated:
            self._simulated.add(uav_id)
        return self.view(uav_id)

    def _require_free(self, uav_id: str, system_id: int) -> None:
        if self._systems.get(uav_id, system_id) != system_id:
            raise ConflictError(f"uav_id: {uav_id!r} is already system {self._systems[uav_id]}")
        taken = {system: uav for uav, system in self._systems.items()}
        if taken.get(system_id, uav_id) != uav_id:
            raise ConflictError(f"system_id: {system_id} is already {taken[system_id]!r}")

    async def remove(self, uav_id: str) -> None:
        """Forget a vehicle. Raises NotFoundError. The caller has seen to it that it flies nothing."""
        if uav_id not in self._systems:
            raise NotFoundError(f"vehicle {uav_id!r} does not exist")
        system_id = self._systems.pop(uav_id)
        self.link.classifier.unwatch(system_id)
        self.news.forget(system_id)
        self._simulated.discard(uav_id)
        await self._database.write(delete(table).where(table.c.uav_id == uav_id))
        self._events.add("vehicle_removed", uav_id=uav_id)

    def is_simulated(self, uav_id: str) -> bool:
        """Whether this service flies the vehicle in software itself."""
        return uav_id in self._simulated

    @property
    def enforces_preflight(self) -> bool:
        """Whether a blocker of the preflight audit ends an operation."""
        return self._settings.preflight == "enforce"

    @property
    def start_within_m(self) -> float:
        """How far from its first point a UAV may take off, metres."""
        return self._settings.start_within_m

    @property
    def links(self) -> tuple[str, ...]:
        """URLs of the links, the preferred first."""
        return tuple(url.strip() for url in self._settings.fleet_url.split(","))

    @property
    def signing_key_file(self) -> str | None:
        """Where the key of both ends is, when MAVLink is signed."""
        key = self._settings.signing_key_file
        return None if key is None else str(key)

    @property
    def empty(self) -> bool:
        """Whether there is no vehicle."""
        return not self._systems

    def system_of(self, uav_id: str) -> int:
        """MAVLink system id. Raises InvalidError for a UAV that is not registered."""
        try:
            return self._systems[uav_id]
        except KeyError:
            raise InvalidError(f"vehicles: {uav_id!r} is not registered with the fleet") from None

    def find(self, uav_id: str) -> VehicleView:
        """One vehicle. Raises NotFoundError."""
        if uav_id not in self._systems:
            raise NotFoundError(f"vehicle {uav_id!r} does not exist")
        return self.view(uav_id)

    def views(self) -> list[VehicleView]:
        """All vehicles, by UAV id."""
        return [self.view(uav_id) for uav_id in sorted(self._systems)]

    def view(self, uav_id: str) -> VehicleView:
        """One vehicle as it was last heard."""
        system_id = self.system_of(uav_id)
        change = self.news.changes.get(system_id)
        return view_of(
            self.link,
            uav_id,
            system_id,
            now_s=self._clock.now(),
            simulated=uav_id in self._simulated,
            condition_cause=None if change is None else change.cause,
        )

    @contextmanager
    def recorded(self, name: str) -> Iterator[None]:
        """Append all traffic to `NAME.tlog`, if the settings name a folder for it.

        A log that cannot be written is one event `telemetry_log`; the flight goes on without it.
        """
        folder = self._settings.telemetry_log_dir

        def failed(reason: str) -> None:
            self.note("telemetry_log", operation_id=name, level="warning", error=reason)

        log = None if folder is None else self.link.record(folder / f"{name}.tlog", failed)
        try:
            yield
        finally:
            if log is not None:
                self.link.stop_recording(log)

    def condition(self, system_id: int) -> Change | None:
        """What its autopilot was last seen to be in, and how that was seen; None while it has always been live."""
        return self.news.changes.get(system_id)

    def heard(self) -> dict[int, Heard]:
        """How each registered vehicle is heard, those of which nothing is expected yet left out."""
        monitor, now_s = self._monitor, self._clock.now()
        return {
            system_id: Heard(
                silent_for_s=monitor.silent_for_s(system_id, now_s), lost=monitor.state(system_id) is LinkState.LOST
            )
            for system_id in self._systems.values()
            if system_id in monitor.watched
        }

    def own_link(self) -> OwnLink:
        """A judgement for one flight of who is silent and what is our link, by this fleet's limits."""
        return OwnLink(stale_after_s=self._monitor.stale_after_s, lost_after_s=self._monitor.lost_after_s)

    @property
    def uav_ids(self) -> list[str]:
        """Every registered vehicle."""
        return sorted(self._systems)

    def taken(self, system_id: int) -> str | None:
        """Who else flies it at this moment, a human or a failsafe, in words; None if we may command it."""
        return self.link.classifier.taken(system_id, self._clock.now())

    def height_amsl_m(self, system_id: int, altitude_m: float) -> float | None:
        """Metres above sea level of an altitude above a vehicle's home; None before it has told of its home."""
        if system_id not in self.link.heard_systems:
            return None
        home_amsl_m = self.link.vehicle(system_id).state.home_amsl_m
        return None if home_amsl_m is None else home_amsl_m + altitude_m

    def is_heard(self, system_id: int) -> bool:
        """Whether it was heard, and its link is not lost."""
        monitor = self.link.monitor
        return (
            system_id in self.link.heard_systems
            and system_id in monitor.watched
            and monitor.state(system_id) is not LinkState.LOST
        )

    def is_down(self, system_id: int) -> bool:
        """Whether it last said that it is disarmed, and is not seen to be in the air all the same."""
        said = self.link.telemetry(system_id)
        return said is not None and not said.armed and not self.is_aloft(system_id)

    def now_s(self) -> float:
        """Fleet seconds."""
        return self._clock.now()

    def is_aloft(self, system_id: int) -> bool:
        """Whether it says that it is disarmed, and yet is not known to be down."""
        return self.link.classifier.is_aloft(system_id, self._clock.now())

    def warning(self, system_id: int) -> str | None:
        """What it tells of a failsafe that changes nothing."""
        return self.link.classifier.warning(system_id)

    def note(self, kind: str, **data: Any) -> None:
        """Add an event about a vehicle to the log."""
        self._events.add(kind, **data)

    async def close(self) -> None:
        """Close the link; the vehicles keep what they have on board."""
        for task in (self._finding, *self._watchers):
            if task is not None:
                task.cancel()
                with suppress(asyncio.CancelledError):
                    await task
        if self._link is not None:
            await self._link.close()
            self._link = None

    async def _open(self, patience_s: float = 0.0) -> None:
        """Open the link; after a restart a guard of the last process may have it for some seconds yet."""
        async with self._opening:
            if self._link is None:
                async with AsyncExitStack() as opening:
                    link = await opening.enter_async_context(
                        FleetLink(
                            clock=self._clock,
                            monitor=self._monitor,
                            options=self._options(),
                            timing=self._settings.timing,
                        )
                    )
                    for url in self.links:
                        await link.connect(url, patience_s=patience_s)
                    opening.pop_all()  # it stays open: `close` ends it
                self._link = link
                self._watchers = self.news.start(link, self._background)

    def _options(self) -> LinkOptions:
        """Signing and the forward port, as the settings have them, and the dead man's switch."""
        settings = self._settings
        key = settings.signing_key_file
        return LinkOptions(
            signing=Signing.from_file(key) if key is not None else None,
            forward=settings.forward_url,
            forward_commands=settings.forward_commands,
            healthy=self._healthy,
            on_sender=self.news.note_sender,
            moves_after_s=settings.heartbeat_lost_s / self._clock.scale + LATER_S,
        )
