"""Sends vehicles up by the rota, and lets each take over its station by an incident of cause `relief`.

A vehicle leaves its pad by itself (`sortie`) and hovers above it; the relief is then one verified change of plan. What
is under way is stored before it is sent, and a restart goes on from what vehicles report: one that hovers above its pad
is taken on by a relief, or comes down again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import structlog

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.endless.gauges import Gauges
from skyfolio.api.flights.endless.observing import dark_stations, observe
from skyfolio.api.flights.endless.pool import MOST_TRIES, Member, Pool
from skyfolio.api.flights.endless.relief_view import MemberView, ReliefView, StationView
from skyfolio.api.flights.endless.rota_keeper import RotaKeeper
from skyfolio.api.flights.endless.sortie import leave_pad, who_is_over
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.incidents import Incidents
from skyfolio.mavlink_bridge import BridgeError

log = structlog.get_logger()
LOOK_S = 0.5
"""Fleet seconds between two looks at the pool."""
REST_S = 30.0
"""Twice so many fleet seconds after which a vehicle that did not leave its pad is asked again; then twice as many."""


class Dispatcher:
    """Keeps the stations of one flight manned. tell: adds an event; save: begins to store the operation."""

    def __init__(
        self,
        flight: Flight,
        pool: Pool,
        incidents: Incidents,
        *,
        fleet: Fleet,
        clock: FleetClock,
        tell: Callable[..., object],
        save: Callable[[], object],
    ) -> None:
        self._flight, self._pool, self._incidents = flight, pool, incidents
        self._fleet, self._clock, self._tell, self._save = fleet, clock, tell, save
        self._gauges = Gauges(flight, pool)
        self._rota = RotaKeeper(flight, pool, self._gauges)
        self._launches: dict[str, asyncio.Task[None]] = {}
        self._looked_at_s = -LOOK_S
        self._dark: set[str] = set()

    async def tick(self, *, may_order: bool) -> None:
        """Look at the pool, and do what is due. may_order: whether vehicles may be sent up, and reliefs requested."""
        now_s = self._flight.now_s()
        if now_s - self._looked_at_s < LOOK_S:
            return
        self._looked_at_s = now_s
        self._end_launches(now_s)
        self._observe()
        if not may_order or self._flight.past_last_slot():
            return
        if self._rota.tick():
            self._save()
        await self._call_home(now_s)
        self._relieve(now_s)
        self._send_up(now_s)

    async def end(self) -> None:
        """Send no further vehicle up. Vehicles that hover above their pads are left as they are."""
        await self._rota.end()
        for task in self._launches.values():
            task.cancel()
        await asyncio.gather(*self._launches.values(), return_exceptions=True)

    def view(self) -> ReliefView:
        """Return what clients see."""
        flight, pool, members = self._flight, self._pool, {}
        for member in pool.members.values():
            telemetry = flight.telemetry(member.id)
            members[member.id] = MemberView(
                state=member.state,
                station=member.station,
                since_s=member.since_s,
                because=member.because,
                charge=None if telemetry is None else telemetry.battery,
            )
        stations = {
            one.id: StationView(place_m=one.place_m, manned_by=one.manned_by, dark_since_s=one.dark_since_s)
            for one in pool.stations.values()
        }
        made_at_s = round(self._rota.made_at_s, 3)
        return ReliefView(
            pool=members, stations=stations, reliefs=pool.reliefs, rota=self._rota.rota, made_at_s=made_at_s
        )

    def _observe(self) -> None:
        """Bring states and stations up to date, and tell what has changed."""
        for member in list(observe(self._pool, self._flight, self._launches)):
            self._told(member)
        self._gauges.look()
        dark = set(dark_stations(self._pool, self._flight))
        for station in sorted(dark ^ self._dark):
            one = self._pool.stations[station]
            self._tell("station", station=station, is_dark=station in dark, manned_by=one.manned_by)
        self._dark = dark

    # -- leaving pads ---------------------------------------------------------------------------------------------

    def _send_up(self, now_s: float) -> None:
        for shift in self._rota.due():
            member = self._pool.members[shift.vehicle]
            if member.state != "ready" or now_s < member.rests_until_s:
                continue
            pad_m = self._pool.uavs[member.id].start_m
            if who_is_over(pad_m, member.id, self._flight) is not None:
                continue
            self._pool.order(member.id, shift.station, now_s, f"ordered to {shift.station}")
            self._told(member)
            work = leave_pad(self._pool.uavs[member.id], self._flight, self._fleet, self._clock)
            self._launches[member.id] = asyncio.create_task(work, name=f"leave-pad-{member.id}")

    def _end_launches(self, now_s: float) -> None:
        for uav, task in list(self._launches.items()):
            if not task.done():
                continue
            del self._launches[uav]
            error = task.exception()
            if error is None:
                continue
            if not isinstance(error, BridgeError):
                log.error("a vehicle did not leave its pad", uav_id=uav, exc_info=error)
            self._refused(self._pool.members[uav], str(error), now_s)

    def _refused(self, member: Member, error: str, now_s: float) -> None:
        """Take the next one in the place of a vehicle that did not leave its pad; ask it again after a while."""
        member.refusals += 1
        if not self._flight.roster.is_down(member.id):
            self._pool.give_up(member.id, "inbound", error, now_s)  # it hovers, or lands: see `TakeOff.stand_down`
            self._launches[member.id] = asyncio.create_task(self._bring_down(member.id), name=f"down-{member.id}")
        else:
            again = member.refusals < MOST_TRIES
            self._pool.give_up(member.id, "ready" if again else "out_of_service", error, now_s)
        member.rests_until_s = now_s + REST_S * 2**member.refusals
        self._told(member)

    # -- energy that ends -----------------------------------------------------------------------------------------

    async def _call_home(self, now_s: float) -> None:
        """Send vehicles home whose energy ends before they are relieved; count them again when they have landed."""
        flight = self._flight
        for member in self._pool.members.values():
            if member.called_home and member.id in flight.lost:
                if member.state == "turnaround" and now_s >= flight.last_slot_s(member.id):
                    flight.roster.readmit(member.id)
                    member.called_home = False
                continue
            if now_s < member.rests_until_s or not self._gauges.is_spent(member):
                continue
            member.called_home = True
            self._save()
            used_wh, left_s = self._gauges.used_wh(member.id), self._gauges.stay_left_s(member)
            try:
                because = f"before its reserve is drawn on: {used_wh:.1f} Wh used, it can stay for {left_s:.0f} s more"
                await self._incidents.retire(member.id, because)
            except ConflictError as error:
                member.called_home = False
                member.rests_until_s = now_s + flight.slot_s
                flight.note("not_called_home", uav_id=member.id, level="warning", error=str(error))

    # -- taking over ----------------------------------------------------------------------------------------------

    def _relieve(self, now_s: float) -> None:
        """Request the relief by a vehicle that hovers above its pad; bring it down if that has failed too often."""
        flight = self._flight
        for member in self._pool.in_state("outbound"):
            uav = member.id
            is_up = uav not in self._launches and uav not in flight.lost and flight.hovers(uav)
            if not is_up or self._incidents.has_work or now_s < member.rests_until_s:
                continue
            if member.tries >= MOST_TRIES:
                self._launches[uav] = asyncio.create_task(self._bring_down(uav), name=f"bring-down-{uav}")
                self._pool.give_up(uav, "inbound", "no relief by it came about", now_s)
                self._told(member)
                continue
            member.tries += 1
            member.rests_until_s = now_s + flight.slot_s
            self._incidents.request_recovery("relief", detail=f"{uav} for {member.station}", reliever=uav)
            return

    async def _bring_down(self, uav: str) -> None:
        errors = await self._flight.bring_down([uav], home=True)
        if errors[uav] is not None:
            self._flight.note("brought_down", uav_id=uav, level="warning", action="return", error=errors[uav])

    def _told(self, member: Member) -> None:
        data: dict[str, Any] = {"uav_id": member.id, "state": member.state, "station": member.station}
        self._tell("pool", **data, because=member.because)
        self._rota.forget()
        self._save()
