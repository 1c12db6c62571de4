"""Keeps the state of the fleet and the running operation current while somebody looks; one for all pages of a key."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from math import atan2, degrees, hypot

import structlog
from pydantic import ValidationError

from skyfolio.api.dashboard.event_text import describe
from skyfolio.api.dashboard.feed import Feed
from skyfolio.api.dashboard.rest import RestError
from skyfolio.api.dashboard.views import Operation, ServiceEvent, Vehicle
from skyfolio.mavlink_bridge import geodetic_to_east_north
from skyfolio.planner import Origin, Plan
from skyfolio.planner.geometry import Point

log = structlog.get_logger()
PERIOD_S = 0.2
OPERATION_EVERY = 3
"""The operation, with its table of rates, is read on every third poll."""
KEEP_EVENTS = 300
MOVED_M = 0.4


@dataclass
class TrackedVehicle:
    """One vehicle as the map needs it: metres east/north, course over ground in degrees, and its track."""

    vehicle: Vehicle
    east_m: float | None = None
    north_m: float | None = None
    course_deg: float = 0.0
    track: list[tuple[float, float, float]] = field(default_factory=list)
    """(elapsed_s, east_m, north_m) of the operation that is shown."""


class Watch:
    """The latest known state. `version` grows with every change; pages draw when it has grown."""

    def __init__(self, feed: Feed, time_scale: float = 1.0) -> None:
        self.feed = feed
        self.time_scale = time_scale
        self.version = 0
        self.error: str | None = None
        self.loaded = False
        self.vehicles: dict[str, TrackedVehicle] = {}
        self.operation: Operation | None = None
        self.plans: dict[str, Plan] = {}
        self.events: deque[ServiceEvent] = deque(maxlen=KEEP_EVENTS)
        self.event_count = 0
        """How many events there have been, including those that `events` no longer holds."""
        self._unstored_events: deque[ServiceEvent] = deque(maxlen=KEEP_EVENTS)
        """Events that were received while the service could not store them."""
        self._read_at = 0.0
        self._viewers = 0
        self._wanted = asyncio.Event()
        self._news = asyncio.Event()
        self._ticks = 0
        self._current: str | None = None
        self._tracked_operation: str | None = None
        self._last_event: int | None = None
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Start polling the service and following its events."""
        self._tasks = [asyncio.create_task(self._poll()), asyncio.create_task(self._follow())]

    async def stop(self) -> None:
        """Stop polling and following."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def join(self) -> None:
        """Count one more viewer; the service is polled only while there is one."""
        self._viewers += 1
        self._wanted.set()

    def leave(self) -> None:
        """Count one viewer less."""
        self._viewers = max(self._viewers - 1, 0)
        if not self._viewers:
            self._wanted.clear()

    async def changed(self) -> None:
        """Wait until something changes."""
        await self._news.wait()

    def show(self, operation_id: str) -> None:
        """Show this operation from now on."""
        if operation_id != self._current:
            self._current = operation_id
            self._ticks = 0

    def elapsed_s(self) -> float | None:
        """Return the fleet seconds since slot 0 of the shown operation, extrapolated to now; None before slot 0."""
        if self.operation is None or self.operation.elapsed_s is None:
            return None
        stands = self.operation.ended or self.operation.state == "paused"
        return self.operation.elapsed_s + (0 if stands else (time.monotonic() - self._read_at) * self.time_scale)

    def first_plan(self) -> Plan | None:
        """Return the plan of the whole fleet that the shown operation began with."""
        return self.plans.get(self.operation.plan_ids[0]) if self.operation and self.operation.plan_ids else None

    def plan_in_force(self) -> Plan | None:
        """Return the plan that the survivors fly now."""
        return self.plans.get(self.operation.plan_id) if self.operation else None

    # --- polling ---

    async def _poll(self) -> None:
        while True:
            await self._wanted.wait()
            began = time.monotonic()
            try:
                await self._read()
                self.error = None
            except (RestError, ValidationError) as error:
                self.error = str(error)
            except Exception as error:
                log.exception("dashboard could not read the service")
                self.error = f"{type(error).__name__}: {error}"
            self.loaded = True
            self._announce()
            await asyncio.sleep(max(PERIOD_S - (time.monotonic() - began), 0.02))

    async def _read(self) -> None:
        if self._current is None:
            newest = await self.feed.operations(1)
            if newest:
                self.show(newest[0].id)
        over = self.operation is not None and self.operation.ended and self.operation.id == self._current
        if self._current is not None and self._ticks % (OPERATION_EVERY * (5 if over else 1)) == 0:
            await self._read_operation(self._current)
        self._ticks += 1
        origin = self._origin()
        for vehicle in await self.feed.vehicles():
            tracked = self.vehicles.setdefault(vehicle.uav_id, TrackedVehicle(vehicle))
            tracked.vehicle = vehicle
            if vehicle.lat_deg is not None and vehicle.lon_deg is not None and origin is not None:
                self._move(tracked, geodetic_to_east_north(origin, vehicle.lat_deg, vehicle.lon_deg))

    async def _read_operation(self, operation_id: str) -> None:
        operation = await self.feed.operation(operation_id)
        wanted = {*operation.plan_ids, *(recovery.plan_id for recovery in operation.recoveries if recovery.plan_id)}
        for plan_id in wanted - set(self.plans):
            with suppress(RestError):  # one that is still being solved is read later
                self.plans[plan_id] = await self.feed.plan(plan_id)
        if self._tracked_operation != operation_id:
            await self._recall_track(operation_id)
        self.operation, self._read_at = operation, time.monotonic()

    async def _recall_track(self, operation_id: str) -> None:
        """Read the tracks flown before this watch began to poll."""
        self._tracked_operation = operation_id
        known = {vehicle.uav_id: vehicle for vehicle in await self.feed.vehicles()}
        self.vehicles = {uav: TrackedVehicle(vehicle) for uav, vehicle in known.items()}
        for point in await self.feed.track(operation_id):
            for uav, at in point.positions_m.items():
                if uav in self.vehicles:
                    self.vehicles[uav].track.append((point.elapsed_s, *at))

    def _origin(self) -> Origin | None:
        plan = self.first_plan()
        if plan is not None:
            return plan.scenario.origin
        for tracked in self.vehicles.values():
            if tracked.vehicle.lat_deg is not None and tracked.vehicle.lon_deg is not None:
                return Origin(lat_deg=tracked.vehicle.lat_deg, lon_deg=tracked.vehicle.lon_deg)
        return None

    def _move(self, tracked: TrackedVehicle, here: Point) -> None:
        if tracked.vehicle.heading_deg is not None:
            tracked.course_deg = tracked.vehicle.heading_deg
        elif tracked.east_m is not None and tracked.north_m is not None:
            de, dn = here[0] - tracked.east_m, here[1] - tracked.north_m
            if hypot(de, dn) > MOVED_M:
                tracked.course_deg = degrees(atan2(de, dn)) % 360
            else:
                here = tracked.east_m, tracked.north_m  # keep the older point, so that slow motion adds up to a course
        tracked.east_m, tracked.north_m = here
        elapsed = self.elapsed_s()
        if elapsed is not None and self.operation and not self.operation.ended:
            tracked.track.append((elapsed, *here))

    # --- following events ---

    async def _follow(self) -> None:
        while True:
            try:
                if self._last_event is None:
                    self._last_event = max(await self.feed.last_event_id() - KEEP_EVENTS, 0)
                async for event in self.feed.events(self._last_event):
                    if event.id is not None:
                        self._last_event = event.id
                    self._take_in(event)
            except RestError as error:
                self.error = str(error)
            except Exception:
                log.exception("dashboard lost the event stream")
            await asyncio.sleep(1.0)

    def _take_in(self, event: ServiceEvent) -> None:
        operation_id = event.data.get("operation_id")
        if operation_id and event.kind == "operation":
            self.show(str(operation_id))
        if operation_id == self._current:
            self._ticks = 0  # something happened to it: read it at the next poll
        unnumbered = event.model_copy(update={"id": None})
        if describe(event)[0] and unnumbered not in self._unstored_events:
            self.events.append(event)
            self.event_count += 1
        if event.id is None:
            self._unstored_events.append(unnumbered)  # it is sent again, with its id, once it is stored
        self._announce()

    def _announce(self) -> None:
        self.version += 1
        news, self._news = self._news, asyncio.Event()
        news.set()
