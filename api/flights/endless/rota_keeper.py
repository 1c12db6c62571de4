"""Who relieves whom and when, reckoned anew as the pool changes: the state of the pool, and the rota made of it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from math import dist

import structlog

from skyfolio.api.flights.endless.gauges import Gauges
from skyfolio.api.flights.endless.pool import Member, Pool
from skyfolio.api.flights.flight import Flight
from skyfolio.planner.rota.shifts import PoolVehicle, Rota, Shift, Sortie, Turnaround
from skyfolio.planner.rota.solver import rota_of
from skyfolio.planner.rota.stays import sortie_of

log = structlog.get_logger()
LEAVES_S = 20.0
"""Fleet seconds that a vehicle needs beside climb and way: it is prepared, and waits for slots to begin."""
SPARE_S = 45.0
"""Fleet seconds for which a vehicle could stay longer when it is to be relieved: the first reliever may not come up,
and it is called home `RETURN_S` and a slot before that ends."""
OVERLAP_SLOTS = 3
"""For about so many slots both are at the station when one relieves another."""
AGAIN_S = 60.0
"""So often the rota is made anew, in fleet seconds, for what vehicles have really used."""
CYCLES, LONGEST_S = 2.0, 7200.0
"""How far ahead it reaches: about so many cycles of the slowest vehicle, at most so many seconds."""
LANDS_MPS = 1.0


class RotaKeeper:
    """The rota of one flight. `rota` counts seconds from `made_at_s`, fleet seconds since slot 0."""

    def __init__(self, flight: Flight, pool: Pool, gauges: Gauges) -> None:
        self._flight, self._pool, self._gauges = flight, pool, gauges
        self.rota: Rota | None = None
        self.made_at_s = 0.0
        self._is_stale = True
        self._task: asyncio.Task[Rota | None] | None = None

    def forget(self) -> None:
        """Make another one as soon as possible: something has changed."""
        self._is_stale = True

    def tick(self) -> bool:
        """Begin to make another rota if that is due; return whether there is a new one."""
        now_s = self._flight.now_s()
        if self._task is not None and self._task.done():
            task, self._task = self._task, None
            made = task.result()
            if made is not None:
                self.rota = made
                return True
        elif self._task is None and (self._is_stale or now_s - self.made_at_s >= AGAIN_S):
            self._is_stale, self.made_at_s = False, now_s
            self._task = asyncio.create_task(self._make(), name="rota")
        return False

    async def end(self) -> None:
        """Make no further rota."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    def due(self) -> list[Shift]:
        """Return the shifts that begin now, those that should have begun earliest first."""
        if self.rota is None or self._is_stale or self._task is not None:
            return []
        ago_s = self._flight.now_s() - self.made_at_s
        shifts = [shift for shift in self.rota.shifts if not shift.under_way and shift.leaves_pad_s <= ago_s]
        return sorted(shifts, key=lambda shift: shift.leaves_pad_s)

    async def _make(self) -> Rota | None:
        vehicles, horizon_s = list(self._vehicles()), self._horizon_s()
        slot_s, terms = self._flight.slot_s, self._pool.terms
        if horizon_s < slot_s:
            return None
        turnaround = Turnaround(
            seconds=terms.turnaround_s + LANDS_MPS, at_once=terms.at_once, overlap_s=OVERLAP_SLOTS * slot_s
        )
        try:
            return await asyncio.to_thread(
                rota_of,
                vehicles,
                list(self._pool.stations),
                turnaround,
                horizon_s=horizon_s,
                step_s=slot_s,
            )
        except ValueError as error:
            log.warning("no rota was made", reason=str(error))
            return None

    def _horizon_s(self) -> float:
        """Return how far ahead the rota reaches, fleet seconds."""
        flight, horizon = self._flight, self._flight.horizon
        cycles = [
            one.out_s + one.stay_s + one.back_s + self._pool.terms.turnaround_s
            for uav in self._pool.uavs
            for one in self._sorties(uav).values()
        ]
        reach_s = min(CYCLES * max(cycles, default=LONGEST_S), LONGEST_S)
        end = None if horizon is None else horizon.end_slot()
        return reach_s if end is None else min(reach_s, end * flight.slot_s - flight.now_s())

    # -- the pool as the solver sees it ---------------------------------------------------------------------------

    def _vehicles(self) -> Iterator[PoolVehicle]:
        now_s = self._flight.now_s()
        for member in self._pool.members.values():
            sorties = self._sorties(member.id)
            if member.state == "out_of_service" or (member.station is not None and member.station not in sorties):
                continue
            in_state_s = now_s - member.since_s
            yield self._vehicle(member, sorties, in_state_s)

    def _vehicle(self, member: Member, sorties: dict[str, Sortie], in_state_s: float) -> PoolVehicle:
        state, station = member.state, member.station
        if state == "inbound":
            return PoolVehicle(id=member.id, sorties=sorties, state="inbound", lands_s=self._lands_s(member))
        if state == "turnaround":
            ready_s = max(self._pool.terms.turnaround_s - in_state_s, self._flight.slot_s)
            return PoolVehicle(id=member.id, sorties=sorties, state="turnaround", ready_s=ready_s)
        if station is None:
            rests_s = member.rests_until_s - self._flight.now_s()
            if rests_s > 0.0:  # it did not leave its pad: another one is asked
                return PoolVehicle(id=member.id, sorties=sorties, state="turnaround", ready_s=rests_s)
            return PoolVehicle(id=member.id, sorties=sorties)
        if state == "outbound":
            from_s = max(sorties[station].out_s - in_state_s, self._flight.slot_s)
            until_s = from_s + sorties[station].stay_s
        else:
            from_s, until_s = -in_state_s, max(self._gauges.stay_left_s(member) - SPARE_S, 0.0)
        flying = "outbound" if state == "outbound" else "on_station"
        return PoolVehicle(id=member.id, sorties=sorties, state=flying, station=station, from_s=from_s, until_s=until_s)

    def _sorties(self, uav: str) -> dict[str, Sortie]:
        """Return what flights of a vehicle to the stations take, those that it can reach."""
        found = {}
        for station in self._pool.stations.values():
            one = sortie_of(
                self._flight.plan.scenario, self._pool.uavs[uav], station.place_m, dearer=self._gauges.dearer(uav)
            )
            if one is not None:
                found[station.id] = one.model_copy(update={"out_s": one.out_s + LEAVES_S})
        return found

    def _lands_s(self, member: Member) -> float:
        """Return about when a vehicle that flies home has landed, seconds from now."""
        uav = self._pool.uavs[member.id]
        at_m = self._flight.positions_m().get(member.id, uav.start_m)
        up_m = self._flight.plan.scenario.altitude_of(uav)
        return dist(at_m, uav.start_m) / max(uav.max_speed_mps, 0.1) + up_m / LANDS_MPS
