"""What the gauges of a pool say: what each vehicle has used, and how much more than the power model it takes."""

from __future__ import annotations

from skyfolio.api.flights.endless.pool import Member, Pool
from skyfolio.api.flights.flight import Flight
from skyfolio.planner.rota.stays import stay_left_s

BELIEVED_AFTER_S = 60.0
"""Fleet seconds on station after which a gauge, which counts in whole per cent, says what staying there takes."""
RETURN_S = 15.0
"""Fleet seconds of hovering that a return by the autopilot takes beyond the straight way at full speed and the landing
that are reckoned: it brakes, climbs, flies at its own speed, and comes down slowly near the ground."""
MOST_DEARER = 2.0
"""A vehicle that takes more than so many times what the model says is ill: the others are not judged by it."""


class Gauges:
    """Compares what vehicles use on station with what hovering is proven to take."""

    def __init__(self, flight: Flight, pool: Pool) -> None:
        self._flight, self._pool = flight, pool
        self._begun: dict[str, tuple[float, float]] = {}
        self._dearer: dict[str, float] = {}

    def look(self) -> None:
        """Take in what the vehicles on station report now."""
        now_s = self._flight.now_s()
        for member in self._pool.members.values():
            used_wh = self.used_wh(member.id)
            if member.state != "on_station" or used_wh is None:
                self._begun.pop(member.id, None)
                continue
            begun_s, begun_wh = self._begun.setdefault(member.id, (now_s, used_wh))
            hover_w = self._hover_w(member.id)
            if now_s - begun_s >= BELIEVED_AFTER_S and hover_w > 0.0:
                modelled_wh = hover_w * (now_s - begun_s) / 3600.0
                self._dearer[member.id] = max(1.0, (used_wh - begun_wh) / modelled_wh)

    def dearer(self, uav: str) -> float:
        """Return how many times what the model says a vehicle takes, at least 1: by its own gauge, else by the worst.

        A vehicle that has not been on station for long is taken for as dear as the worst of the others.
        """
        others = [found for found in self._dearer.values() if found <= MOST_DEARER]
        return self._dearer.get(uav, max(others, default=1.0))

    def used_wh(self, uav: str) -> float | None:
        """Return what a vehicle has used since its battery was full, Wh; None where that is not known."""
        battery, telemetry = self._pool.uavs[uav].battery, self._flight.telemetry(uav)
        if battery is None or telemetry is None or telemetry.battery is None:
            return None
        return battery.usable_wh * (1.0 - telemetry.battery)

    def stay_left_s(self, member: Member) -> float:
        """Return for how many fleet seconds a vehicle can still stay at its station, by what its battery reports.

        It is 0 for one that does not report its charge.
        """
        uav, place_m = self._pool.uavs[member.id], self._pool.stations[member.station or ""].place_m
        used_wh, budget_wh = self.used_wh(member.id), 0.0 if uav.battery is None else uav.battery.budget_wh
        return stay_left_s(
            self._flight.plan.scenario,
            uav,
            place_m,
            budget_wh if used_wh is None else used_wh,
            dearer=self.dearer(member.id),
        )

    def is_spent(self, member: Member) -> bool:
        """Return whether a vehicle on station has to leave now, and would not do so by itself.

        By itself it leaves where a relief, or its plan, has it leave with the next slot.
        """
        flight = self._flight
        if member.state != "on_station" or member.id in flight.lost or self.used_wh(member.id) is None:
            return False
        leaves_at, flown = flight.last_slot_of(member.id) + 1, {entry.plan.id for entry in flight.timeline}
        for crossing in self._pool.crossings:
            if crossing.relieved == member.id and crossing.plan_id in flown:
                leaves_at = min(leaves_at, crossing.hand_over_at)
        soon_s = (leaves_at - 1) * flight.slot_s
        return flight.now_s() < soon_s and self.stay_left_s(member) <= flight.slot_s + RETURN_S

    def _hover_w(self, uav: str) -> float:
        """Return what hovering is proven to take, W; 0 for a vehicle without a battery."""
        scenario = self._flight.plan.scenario
        air = scenario.air_for([self._pool.uavs[uav]])
        return 0.0 if air is None else float(air.hover_wh()[0]) * 3600.0 / scenario.slot_duration_s
