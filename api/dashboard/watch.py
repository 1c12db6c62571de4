"""Keeps the picture of the fleet and the running operation fresh while somebody looks; one for all pages of a key."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from math import atan2, degrees, hypot

import structlog
from pydantic import ValidationError

from skyfolio.api.dashboard.event_text import words
from skyfolio.api.dashboard.feed import Feed
from skyfolio.api.dashboard.rest import RestError
from skyfolio.api.dashboard.views import Happening, Operation, Vehicle
from skyfolio.mavlink_bridge import geodetic_to_east_north
from skyfolio.planner import Origin, Plan

log = structlog.get_logger()
PERIOD_S = 0.2
OPERATION_EVERY = 3
"""The operation, with its table of rates, is read on each third look."""
KEEP_EVENTS = 300
MOVED_M = 0.4
Point = tuple[float, float]


@dataclass
class Seen:
    """One vehicle as the map needs it: metres east/north, course over ground in degrees, and where it has been."""

    vehicle: Vehicle
    east_m: float | None = None
    north_m: float | None = None
    course_deg: float = 0.0
    track: list[tuple[float, float, float]] = field(default_factory=list)
    """(elapsed_s, east_m, north_m) of the operation that is shown."""


class Watch:
    """The latest that is known. `version` grows whenever something changed; pages draw when it has."""

    def __init__(self, feed: Feed, time_scale: float = 1.0) -> None:
        self.feed = feed
        self.time_scale = time_scale
        self.version = 0
        self.error: str | None = None
        self.loaded = False
        self.seen: dict[str, Seen] = {}
        self.operation: Operation | None = None
        self.plans: dict[str, Plan] = {}
        self.happenings: deque[Happening] = deque(maxlen=KEEP_EVENTS)
        self.told = 0
        """How many happenings there have been, those that `happenings` no longer holds included."""
        self._told_early: deque[Happening] = deque(maxlen=KEEP_EVENTS)
        """What came while the service could not store it."""
        self._read_at = 0.0
        self._viewers = 0
        self._wanted = asyncio.Event()
        self._news = asyncio.Event()
        self._ticks = 0
        self._current: str | None = None
        self._tracked: str | None = None
        self._last_event: int | None = None
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin to look and to listen."""
        self._tasks = [asyncio.create_task(self._look_on()), asyncio.create_task(self._listen())]

    async def stop(self) -> None:
        """End both."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def join(self) -> None:
        """Count one viewer more: the service is only asked while there is one."""
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
        """From now on this operation is the one that is shown."""
        if operation_id != self._current:
            self._current = operation_id
            self._ticks = 0

    def elapsed_s(self) -> float | None:
        """Fleet seconds of the shown operation since slot 0, by now; None before."""
        if self.operation is None or self.operation.elapsed_s is None:
            return None
        stands = self.operation.ended or self.operation.state == "paused"
        return self.operation.elapsed_s + (0 if stands else (time.monotonic() - self._read_at) * self.time_scale)

    def first_plan(self) -> Plan | None:
        """The plan of the whole fleet that the shown operation began with."""
        return self.plans.get(self.operation.plan_ids[0]) if self.operation and self.operation.plan_ids else None

    def plan_in_force(self) -> Plan | None:
        """The plan the survivors fly now."""
        return self.plans.get(self.operation.plan_id) if self.operation else None

    # --- looking ---

    async def _look_on(self) -> None:
        while True:
            await self._wanted.wait()
            began = time.monotonic()
            try:
                await self._look()
                self.error = None
            except (RestError, ValidationError) as error:
                self.error = str(error)
            except Exception as error:
                log.exception("dashboard could not read the service")
                self.error = f"{type(error).__name__}: {error}"
            self.loaded = True
            self._tell()
            await asyncio.sleep(max(PERIOD_S - (time.monotonic() - began), 0.02))

    async def _look(self) -> None:
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
            seen = self.seen.setdefault(vehicle.uav_id, Seen(vehicle))
            seen.vehicle = vehicle
            if vehicle.lat_deg is not None and vehicle.lon_deg is not None and origin is not None:
                self._move(seen, geodetic_to_east_north(origin, vehicle.lat_deg, vehicle.lon_deg))

    async def _read_operation(self, operation_id: str) -> None:
        operation = await self.feed.operation(operation_id)
        wanted = {*operation.plan_ids, *(one.plan_id for one in operation.recoveries if one.plan_id)}
        for plan_id in wanted - set(self.plans):
            with suppress(RestError):  # one that is still being solved is read later
                self.plans[plan_id] = await self.feed.plan(plan_id)
        if self._tracked != operation_id:
            await self._recall_track(operation_id)
        self.operation, self._read_at = operation, time.monotonic()

    async def _recall_track(self, operation_id: str) -> None:
        """Where everyone was before this watch began to look."""
        self._tracked = operation_id
        known = {vehicle.uav_id: vehicle for vehicle in await self.feed.vehicles()}
        self.seen = {uav: Seen(vehicle) for uav, vehicle in known.items()}
        for point in await self.feed.track(operation_id):
            for uav, at in point.positions_m.items():
                if uav in self.seen:
                    self.seen[uav].track.append((point.elapsed_s, *at))

    def _origin(self) -> Origin | None:
        plan = self.first_plan()
        if plan is not None:
            return plan.scenario.origin
        for seen in self.seen.values():
            if seen.vehicle.lat_deg is not None and seen.vehicle.lon_deg is not None:
                return Origin(lat_deg=seen.vehicle.lat_deg, lon_deg=seen.vehicle.lon_deg)
        return None

    def _move(self, seen: Seen, here: Point) -> None:
        if seen.vehicle.heading_deg is not None:
            seen.course_deg = seen.vehicle.heading_deg
        elif seen.east_m is not None and seen.north_m is not None:
            de, dn = here[0] - seen.east_m, here[1] - seen.north_m
            if hypot(de, dn) > MOVED_M:
                seen.course_deg = degrees(atan2(de, dn)) % 360
            else:
                here = seen.east_m, seen.north_m  # keep the older point, so that slow motion adds up to a course
        seen.east_m, seen.north_m = here
        elapsed = self.elapsed_s()
        if elapsed is not None and self.operation and not self.operation.ended:
            seen.track.append((elapsed, *here))

    # --- listening ---

    async def _listen(self) -> None:
        while True:
            try:
                if self._last_event is None:
                    self._last_event = max(await self.feed.last_event_id() - KEEP_EVENTS, 0)
                async for happening in self.feed.happenings(self._last_event):
                    if happening.id is not None:
                        self._last_event = happening.id
                    self._take_in(happening)
            except RestError as error:
                self.error = str(error)
            except Exception:
                log.exception("dashboard lost the event stream")
            await asyncio.sleep(1.0)

    def _take_in(self, happening: Happening) -> None:
        operation_id = happening.data.get("operation_id")
        if operation_id and happening.kind == "operation":
            self.show(str(operation_id))
        if operation_id == self._current:
            self._ticks = 0  # something happened to it: read it on the next look
        told = happening.model_copy(update={"id": None})
        if words(happening)[0] and told not in self._told_early:
            self.happenings.append(happening)
            self.told += 1
        if happening.id is None:
            self._told_early.append(told)  # it comes again, with its number, when it is stored
        self._tell()

    def _tell(self) -> None:
        self.version += 1
        news, self._news = self._news, asyncio.Event()
        news.set()
