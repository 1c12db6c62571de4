"""How many vehicles a network needs at least, and how much manned time a pool can deliver at most.

Proof. Let a flight to a station take `out` to get there, `stay` there at most, `back` to land, and `turn` until the
vehicle may leave again, and let both be there for `overlap` when one relieves another. Count each moment at which a
station is manned for the vehicle that came last: where the station is never left alone, a flight counts for at most
T = stay - overlap, but for the last one, and its vehicle is busy with it for what it counts and for overlap + out +
back + turn beside. That is least for each second that counts if it counts for all of T: then C / T seconds, with
C = T + overlap + out + back + turn. So a station that is manned for M seconds keeps vehicles busy for at least
(C / T) M, up to one cycle of each vehicle at either end. N vehicles have N L seconds in L; letting L grow,
N >= sum over stations of C / T, each with the vehicle that serves it best. A station with vehicles of its own needs
that rounded up; vehicles that serve several are pooled, so that it is rounded up only once. This is the reasoning of
the homogeneous and partially homogeneous replacement rates of the literature on persistent service; it is a bound, and
a rota may need more. A ground crew that turns `at_once` vehicles around at a time ends at_once / turn cycles a second,
of which the stations need the sum of 1 / T: where that is more, no number of vehicles is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor

from skyfolio.planner.parts import Frozen
from skyfolio.planner.rota.shifts import PoolVehicle, Sortie, Turnaround
from skyfolio.planner.rota.stays import LONGEST_S

_ROUNDING = 1e-9


class FleetBound(Frozen):
    """The least number of vehicles with which stations can be manned for ever.

    vehicles_busy: by station, how many are busy with it on average; null where no vehicle of the pool can serve it.
    least_fleet: of all stations together, rounded up once; null where no number is enough. least_crew: how many have to
    be turned around at once. sustained_share: of all stations' time, which the pool as it is can man for ever at most.
    """

    vehicles_busy: dict[str, float | None]
    least_fleet: int | None
    least_crew: int
    sustained_share: float

    def least_at(self, station: str) -> int | None:
        """Return how many vehicles this station needs if it has its own."""
        busy = self.vehicles_busy[station]
        return None if busy is None else _up(busy)


def fleet_bound(pool: Sequence[PoolVehicle], stations: Sequence[str], turnaround: Turnaround) -> FleetBound:
    """Return the bound for vehicles such as those of the pool, whatever they are doing now."""
    busy = {station: _busy(_sorties(pool, station), turnaround) for station in stations}
    known = [share for share in busy.values() if share is not None]
    rate = sum(
        1.0 / max(_net_s(one, turnaround) for one in _sorties(pool, station)) for station in stations if busy[station]
    )
    crew = max(1, _up(turnaround.seconds * rate))
    enough = len(known) == len(stations) and (turnaround.at_once is None or crew <= turnaround.at_once)
    by_crew = (
        1.0 if turnaround.at_once is None or rate == 0.0 else turnaround.at_once / (turnaround.seconds * rate or 1.0)
    )
    return FleetBound(
        vehicles_busy=busy,
        least_fleet=_up(sum(known)) if enough else None,
        least_crew=crew,
        sustained_share=min(_share(known, len(stations), len(pool)), by_crew),
    )


def most_manned_s(
    pool: Sequence[PoolVehicle], stations: Sequence[str], turnaround: Turnaround, horizon_s: float
) -> float:
    """Return a bound on the manned time, seconds of all stations, that any rota of this pool has until the horizon.

    No vehicle has more time at stations than with its longest stays and shortest ways, and no station more than from
    the first arrival on. Hand-overs without any overlap are allowed for.
    """
    by_vehicles = sum(_delivered_s(vehicle, stations, turnaround, horizon_s) for vehicle in pool)
    by_stations = sum(max(0.0, horizon_s - _first_s(pool, station, turnaround)) for station in stations)
    return min(by_vehicles, by_stations)


def _up(number: float) -> int:
    return ceil(number * (1.0 - _ROUNDING))


def _share(busy: Sequence[float], n_stations: int, n_vehicles: int) -> float:
    """Return the share of the stations' time that so many vehicles man: those that take least of them first."""
    left, manned = float(n_vehicles), 0.0
    for share in sorted(busy):
        used = min(left, share)
        manned, left = manned + used / share, left - used
    return manned / n_stations if n_stations else 1.0


def _sorties(pool: Sequence[PoolVehicle], station: str) -> list[Sortie]:
    return [vehicle.sorties[station] for vehicle in pool if station in vehicle.sorties]


def _net_s(sortie: Sortie, turnaround: Turnaround) -> float:
    return sortie.stay_s - turnaround.overlap_s


def _busy(sorties: Sequence[Sortie], turnaround: Turnaround) -> float | None:
    """Return C / T of the vehicle that serves a station best; None where none can."""
    shares = []
    for one in sorties:
        net_s = _net_s(one, turnaround)
        fixed_s = one.out_s + one.back_s + turnaround.seconds + turnaround.overlap_s
        if one.stay_s >= LONGEST_S:
            shares.append(1.0)
        elif net_s > 0.0:
            shares.append((net_s + fixed_s) / net_s)
    return min(shares, default=None)


def _first_s(pool: Sequence[PoolVehicle], station: str, turnaround: Turnaround) -> float:
    """Return when a station can be manned at the earliest; infinite if never."""
    times = [
        max(0.0, one.from_s or 0.0) if one.station == station else _free_s(one, turnaround) + one.sorties[station].out_s
        for one in pool
        if station in one.sorties
    ]
    return min(times, default=float("inf"))


def _free_s(vehicle: PoolVehicle, turnaround: Turnaround) -> float:
    """Return when a vehicle can leave its pad at the earliest."""
    if vehicle.state in {"outbound", "on_station"}:
        back_s = vehicle.sorties[str(vehicle.station)].back_s
        free_s = max(0.0, vehicle.from_s or 0.0) + back_s + turnaround.seconds
    elif vehicle.state == "inbound":
        free_s = (vehicle.lands_s or 0.0) + turnaround.seconds
    else:
        free_s = vehicle.ready_s or 0.0
    return max(free_s, turnaround.lead_s)


def _delivered_s(vehicle: PoolVehicle, stations: Sequence[str], turnaround: Turnaround, horizon_s: float) -> float:
    sorties = [vehicle.sorties[station] for station in stations if station in vehicle.sorties]
    if not sorties:
        return 0.0
    out_s, stay_s = min(one.out_s for one in sorties), max(one.stay_s for one in sorties)
    away_s = out_s + min(one.back_s for one in sorties) + turnaround.seconds
    if vehicle.state not in {"outbound", "on_station"}:
        return _full_cycles_s(horizon_s - _free_s(vehicle, turnaround) - out_s, stay_s, away_s)
    begin, end = max(0.0, vehicle.from_s or 0.0), max(0.0, vehicle.until_s or 0.0)
    now_s = max(0.0, min(end, horizon_s) - begin)
    return now_s + _full_cycles_s(horizon_s - max(begin, end) - away_s, stay_s, away_s)


def _full_cycles_s(time_s: float, stay_s: float, away_s: float) -> float:
    """Return the time at stations that fits, if it begins with a stay."""
    if time_s <= 0.0:
        return 0.0
    cycles = floor(time_s / (stay_s + away_s))
    return cycles * stay_s + min(stay_s, time_s - cycles * (stay_s + away_s))
