"""Orders of reliefs, station and vehicle: candidates for a rota, whose times `timing.py` then finds.

An order is made by going through time: the station that will be left alone first is relieved next, by one of the
vehicles that can be there by then, or by the first that can. Rules differ in whom they choose, and in when they have
it come: early reliefs spread what otherwise ends all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, inf
from typing import Literal

from skyfolio.planner.rota.shifts import PoolVehicle, Turnaround

Choice = Literal["first_free", "latest", "longest", "nearest"]
CHOICES: tuple[Choice, ...] = ("first_free", "latest", "longest", "nearest")
SPREADS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Shares of its longest stay after which a vehicle is relieved."""
MOST_FLIGHTS = 2000


@dataclass(frozen=True)
class Steps:
    """All times in whole steps: ways and turnarounds rounded up, stays down. turn, overlap, lead: as `Turnaround`."""

    step_s: float
    horizon: int
    turn: int
    overlap: int
    lead: int
    at_once: int | None

    @classmethod
    def of(cls, turnaround: Turnaround, horizon_s: float, step_s: float) -> Steps:
        """Return those of a horizon, which is cut to whole steps."""
        bare = cls(step_s, floor(horizon_s / step_s + 1e-9), 0, 0, 0, turnaround.at_once)
        turn, overlap, lead = (bare.up(s) for s in (turnaround.seconds, turnaround.overlap_s, turnaround.lead_s))
        return replace(bare, turn=turn, overlap=overlap, lead=lead)

    def up(self, seconds: float) -> int:
        """Return so many seconds in steps, rounded up."""
        return ceil(seconds / self.step_s - 1e-9)

    def down(self, seconds: float) -> int:
        """Return so many seconds in steps, rounded down."""
        return floor(seconds / self.step_s + 1e-9)


@dataclass(frozen=True)
class Flight:
    """One stay of a vehicle at a station. out, back: its ways; stay: how long it may be there; begins: if under way."""

    vehicle: str
    station: str
    out: int
    back: int
    stay: int
    begins: int | None = None


@dataclass(frozen=True)
class Order:
    """Flights, at each station and of each vehicle one after the other as listed.

    landings: who is turned around after whom: indices of flights, and ids of vehicles that are inbound or turned around
    now.
    """

    flights: tuple[Flight, ...]
    landings: tuple[int | str, ...]


@dataclass(frozen=True)
class Rule:
    """Whom to choose among those that are there in time, and after which share of a stay they come."""

    choice: Choice
    spread: float


def rules() -> Iterator[Rule]:
    """Yield all rules, those with the fewest reliefs first."""
    for spread in SPREADS:
        for choice in CHOICES:
            yield Rule(choice, spread)


def order_by(rule: Rule, pool: Sequence[PoolVehicle], stations: Sequence[str], steps: Steps) -> Order:
    """Return the order that a rule makes from the state of the pool now, for somewhat longer than the horizon."""
    return _Going(rule, pool, stations, steps).order()


def flight_under_way(vehicle: PoolVehicle, steps: Steps) -> Flight:
    """Return the flight of a vehicle that is outbound or on station."""
    station = str(vehicle.station)
    begins, ends = max(0.0, vehicle.from_s or 0.0), max(0.0, vehicle.until_s or 0.0)
    begin = steps.up(begins)
    sortie = vehicle.sorties[station]
    stay = max(0, steps.down(ends) - begin)
    return Flight(vehicle.id, station, steps.up(sortie.out_s), steps.up(sortie.back_s), stay, begin)


def flights_possible(vehicle: PoolVehicle, stations: Sequence[str], steps: Steps) -> dict[str, Flight]:
    """Return by station the flight from a full battery; only those that stay for longer than a hand-over takes."""
    made = {
        station: Flight(vehicle.id, station, steps.up(one.out_s), steps.up(one.back_s), steps.down(one.stay_s))
        for station, one in vehicle.sorties.items()
        if station in stations
    }
    return {station: flight for station, flight in made.items() if flight.stay > 2 * steps.overlap}


class _Going:
    """Going through time. free: from when on a vehicle can leave its pad. at: who is at each station, since when."""

    def __init__(self, rule: Rule, pool: Sequence[PoolVehicle], stations: Sequence[str], steps: Steps) -> None:
        self._rule, self._steps, self._stations = rule, steps, stations
        self._possible = {vehicle.id: flights_possible(vehicle, stations, steps) for vehicle in pool}
        self._rank = {vehicle.id: rank for rank, vehicle in enumerate(pool)}
        self._free: dict[str, int] = {}
        self._flights: list[Flight] = []
        self._landed: list[tuple[int, int, int | str]] = []
        self._at: dict[str, tuple[int, int] | None] = dict.fromkeys(stations)  # index of the flight, its begin
        self._alone: dict[str, int] = dict.fromkeys(stations, 0)
        for vehicle in pool:
            self._begin_with(vehicle)
        for vehicle in sorted(
            (v for v in pool if v.state in {"outbound", "on_station"}), key=lambda v: v.from_s or 0.0
        ):
            flight = flight_under_way(vehicle, steps)
            self._relieve(flight, int(flight.begins or 0))

    def order(self) -> Order:
        """Return the order, up to where all stations are manned beyond the horizon."""
        while len(self._flights) < MOST_FLIGHTS:
            station = min(self._stations, key=lambda name: (self._due(name), self._stations.index(name)), default=None)
            if station is None or self._due(station) > self._steps.horizon + self._beyond():
                break
            if not self._next(station):
                break
        for station in self._stations:
            if self._at[station] is not None:
                self._leave(station, self._due(station))
        landed = sorted(self._landed, key=lambda one: one[:2])
        return Order(tuple(self._flights), tuple(one[2] for one in landed))

    def _begin_with(self, vehicle: PoolVehicle) -> None:
        steps = self._steps
        if vehicle.state == "ready":
            self._free[vehicle.id] = steps.lead
        elif vehicle.state == "turnaround":
            self._free[vehicle.id] = max(steps.lead, steps.up(vehicle.ready_s or 0.0))
            self._landed.append((-1, self._rank[vehicle.id], vehicle.id))
        elif vehicle.state == "inbound":
            lands = steps.up(vehicle.lands_s or 0.0)
            self._free[vehicle.id] = max(steps.lead, lands + steps.turn)
            self._landed.append((lands, self._rank[vehicle.id], vehicle.id))

    def _beyond(self) -> int:
        stays = [flight.stay for row in self._possible.values() for flight in row.values()]
        return min(max(stays, default=0), self._steps.horizon)

    def _due(self, station: str) -> int:
        """Return when a station is left alone if no vehicle comes."""
        now = self._at[station]
        return self._alone[station] if now is None else now[1] + self._flights[now[0]].stay

    def _next(self, station: str) -> bool:
        """Have a station relieved, or left alone where no vehicle can come yet; return whether anything was done."""
        now, wanted = self._at[station], self._due(station)
        if now is not None:
            wanted = max(now[1], wanted - self._steps.overlap)
        arrivals = {
            vehicle: max(free + self._possible[vehicle][station].out, 0)
            for vehicle, free in self._free.items()
            if station in self._possible[vehicle]
        }
        if not arrivals:
            if now is None:
                self._alone[station] = self._later(station)
                return self._alone[station] < inf and self._alone[station] <= 4 * self._steps.horizon
            self._leave(station, self._due(station))
            return True
        vehicle = self._chosen(station, arrivals, wanted)
        flight = self._possible[vehicle][station]
        begin = max(arrivals[vehicle], wanted)
        if now is not None:
            spread = now[1] + int(self._rule.spread * (wanted - now[1]))
            begin = max(arrivals[vehicle], spread)
        del self._free[vehicle]
        self._relieve(flight, begin)
        return True

    def _later(self, station: str) -> int:
        """Return when to look at a station again that no vehicle can come to now: when another has been left."""
        others = [self._due(name) for name in self._stations if name != station and self._at[name] is not None]
        return max(min(others, default=5 * self._steps.horizon), self._alone[station]) + 1

    def _chosen(self, station: str, arrivals: Mapping[str, int], wanted: int) -> str:
        in_time = {vehicle: at for vehicle, at in arrivals.items() if at <= wanted}
        if not in_time:
            return min(arrivals, key=lambda vehicle: (arrivals[vehicle], self._rank[vehicle]))
        flights = {vehicle: self._possible[vehicle][station] for vehicle in in_time}
        keys: dict[Choice, Callable[[str], int]] = {
            "first_free": lambda vehicle: self._free[vehicle],
            "latest": lambda vehicle: -in_time[vehicle],
            "longest": lambda vehicle: -flights[vehicle].stay,
            "nearest": lambda vehicle: flights[vehicle].out + flights[vehicle].back,
        }
        key = keys[self._rule.choice]
        return min(in_time, key=lambda vehicle: (key(vehicle), self._free[vehicle], self._rank[vehicle]))

    def _relieve(self, flight: Flight, begin: int) -> None:
        if self._at[flight.station] is not None:
            self._leave(flight.station, min(self._due(flight.station), begin + self._steps.overlap))
        self._flights.append(flight)
        self._at[flight.station] = len(self._flights) - 1, begin

    def _leave(self, station: str, end: int) -> None:
        now = self._at[station]
        assert now is not None  # noqa: S101 - the caller has looked
        flight = self._flights[now[0]]
        lands = max(end, now[1]) + flight.back
        self._landed.append((lands, self._rank[flight.vehicle], now[0]))
        self._free[flight.vehicle] = max(self._steps.lead, lands + self._steps.turn)
        self._at[station], self._alone[station] = None, end
