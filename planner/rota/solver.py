"""Who relieves whom and when: the best rota that is found among many orders, each with its best times.

First of all stations are manned for as long as possible, then with as few reliefs as possible, then with stays that end
long before the energy does. What is under way keeps its beginning. `orders.py` makes the orders by rules, `timing.py`
solves for the times; where a rota has as much manned time as `bound.py` allows, the search is over. No clock and no
chance are in it: the same state of the pool gives the same rota.
"""

from __future__ import annotations

from collections.abc import Sequence

from skyfolio.planner.rota.bound import fleet_bound, most_manned_s
from skyfolio.planner.rota.orders import Flight, Order, Steps, order_by, rules
from skyfolio.planner.rota.shifts import Dark, Grounded, PoolVehicle, Rota, Shift, Turnaround, gaps
from skyfolio.planner.rota.timing import Timed, timed


def rota_of(
    pool: Sequence[PoolVehicle],
    stations: Sequence[str],
    turnaround: Turnaround,
    *,
    horizon_s: float,
    step_s: float = 5.0,
) -> Rota:
    """Return a rota from now until `horizon_s`, which should be about two cycles of a vehicle, or more.

    step_s: the grid of all times, such as a slot. Raises ValueError for a horizon below one step, a pool with twice the
    same vehicle, and a vehicle bound for a station that is not to be manned.
    """
    _require_sound(pool, stations, horizon_s, step_s)
    steps = Steps.of(turnaround, horizon_s, step_s)
    horizon = steps.horizon * step_s
    least_dark_s = horizon * len(stations) - most_manned_s(pool, stations, turnaround, horizon)
    best = _best(pool, stations, steps, least_dark_s)
    shifts = _shifts(best, pool, stations, steps)
    dark = tuple(
        Dark(station=station, from_s=begin, until_s=end)
        for station in stations
        for begin, end in gaps([(s.from_s, s.until_s) for s in shifts if s.station == station], horizon)
    )
    dark_s = sum(one.until_s - one.from_s for one in dark)
    return Rota(
        horizon_s=horizon,
        stations=tuple(stations),
        shifts=shifts,
        grounded=tuple(
            Grounded(vehicle=vehicle, turned_s=turned * step_s, ready_s=(turned + steps.turn) * step_s)
            for vehicle, turned in best.grounded.items()
        ),
        dark=dark,
        manned_share=1.0 - dark_s / (horizon * len(stations)) if stations else 1.0,
        optimal=_is_least(dark_s, least_dark_s, steps, len(stations)),
        least_fleet=fleet_bound(pool, stations, turnaround).least_fleet,
    )


def _require_sound(pool: Sequence[PoolVehicle], stations: Sequence[str], horizon_s: float, step_s: float) -> None:
    if not 0.0 < step_s <= horizon_s:
        raise ValueError(f"horizon_s: {horizon_s} must be at least one step, {step_s} s")
    if len(set(stations)) != len(stations):
        raise ValueError("stations: ids must be unique")
    ids = [vehicle.id for vehicle in pool]
    for vehicle in pool:
        if ids.count(vehicle.id) > 1:
            raise ValueError(f"pool: {vehicle.id!r} occurs more than once")
        if vehicle.station is not None and vehicle.station not in stations:
            raise ValueError(f"pool.{vehicle.id}.station: {vehicle.station!r} is not a station to be manned")


def _is_least(dark_s: float, least_s: float, steps: Steps, n_stations: int) -> bool:
    """Return whether no rota on this grid has less dark time; a first arrival is rounded up to a step."""
    return dark_s < least_s + steps.step_s * max(1, n_stations)


def _best(pool: Sequence[PoolVehicle], stations: Sequence[str], steps: Steps, least_dark_s: float) -> Timed:
    """Return the best of all orders; of those as good, the one that comes first."""
    best: Timed | None = None
    seen: set[Order] = set()
    for rule in rules():
        order = order_by(rule, pool, stations, steps)
        if order in seen:
            continue
        seen.add(order)
        found = timed(order, pool, stations, steps)
        if found is not None and (best is None or found.rank < best.rank):
            best = found
        if best is not None and _is_least(best.dark * steps.step_s, least_dark_s, steps, len(stations)):
            break
    if best is None:
        raise RuntimeError("no order of the pool could be timed, not even that of what is under way")
    return best


def _shifts(best: Timed, pool: Sequence[PoolVehicle], stations: Sequence[str], steps: Steps) -> tuple[Shift, ...]:
    """Return the shifts that begin before the horizon, by station in order of time, in seconds."""
    known = {vehicle.id: vehicle for vehicle in pool}
    shifts = []
    for station in stations:
        row = [k for k, flight in enumerate(best.order.flights) if flight.station == station]
        for k, after in zip(row, [*row[1:], None], strict=False):
            flight, end = best.order.flights[k], best.ends[k]
            if flight.begins is None and best.begins[k] >= steps.horizon:
                continue
            if after is not None and end - steps.overlap < best.begins[after] < end:
                end = best.begins[after]  # its successor comes too late for the whole overlap
            shifts.append(_shift(flight, best.begins[k], end, best.turned[k], steps, known[flight.vehicle]))
    return tuple(shifts)


def _shift(flight: Flight, begin: int, end: int, turned: int, steps: Steps, vehicle: PoolVehicle) -> Shift:
    step = steps.step_s
    from_s, until_s, fixed = begin * step, end * step, flight.begins is not None
    if fixed:  # its beginning is a fact, off the grid
        from_s = vehicle.from_s or 0.0
        until_s = min(max(until_s, from_s, 0.0), max(vehicle.until_s or 0.0, from_s, 0.0))
    lands_s = until_s + flight.back * step
    turned_s = max(turned * step, lands_s)
    return Shift(
        vehicle=flight.vehicle,
        station=flight.station,
        leaves_pad_s=from_s - (vehicle.sorties[flight.station].out_s if fixed else flight.out * step),
        from_s=from_s,
        until_s=until_s,
        lands_s=lands_s,
        turned_s=turned_s,
        ready_s=turned_s + steps.turn * step,
        under_way=fixed,
        cut=until_s > steps.horizon * step,
    )
