"""An independent check that a rota can be flown by its pool, and that it is as good as it says.

It reads seconds, shares no code with the solver, and tolerates a microsecond of rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from skyfolio.planner.parts import Frozen
from skyfolio.planner.rota.shifts import PoolVehicle, Rota, Shift, Turnaround

ROUNDING_S = 1e-6


class RotaFault(Frozen):
    """What is wrong with a rota: the broken rule, where, and by how much."""

    rule: str
    where: str
    message: str


def rota_faults(
    rota: Rota, pool: Sequence[PoolVehicle], stations: Sequence[str], turnaround: Turnaround
) -> list[RotaFault]:
    """Return every broken rule; empty for a rota that can be flown."""
    known = {vehicle.id: vehicle for vehicle in pool}
    strange = [
        RotaFault(rule="ids", where=shift.vehicle, message=f"has no sortie to '{shift.station}'")
        for shift in rota.shifts
        if shift.vehicle not in known
        or shift.station not in known[shift.vehicle].sorties
        or shift.station not in stations
    ]
    if strange:
        return strange
    return [
        *(fault for shift in rota.shifts for fault in _shift_faults(shift, known[shift.vehicle], turnaround)),
        *(fault for vehicle in pool for fault in _vehicle_faults(rota, vehicle, turnaround)),
        *(fault for station in stations for fault in _station_faults(rota, station, turnaround)),
        *_crew_faults(rota, pool, turnaround),
        *_told_faults(rota, stations),
    ]


def _shift_faults(shift: Shift, vehicle: PoolVehicle, turnaround: Turnaround) -> Iterator[RotaFault]:
    """Check one shift alone: ways, stay and turnaround take the time that they take."""
    sortie, where = vehicle.sorties[shift.station], f"{shift.vehicle} at {shift.station} from {shift.from_s:g} s"
    rows = {
        "out": (shift.from_s - shift.leaves_pad_s, sortie.out_s),
        "back": (shift.lands_s - shift.until_s, sortie.back_s),
        "order": (shift.until_s - shift.from_s, 0.0),
        "crew": (shift.turned_s - shift.lands_s, 0.0),
        "turnaround": (shift.ready_s - shift.turned_s, turnaround.seconds),
    }
    for rule, (given, needed) in rows.items():
        if given < needed - ROUNDING_S:
            yield RotaFault(rule=rule, where=where, message=f"{given:g} s are fewer than {needed:g} s")
    last = max(vehicle.until_s or 0.0, 0.0) if shift.under_way else shift.from_s + sortie.stay_s
    if shift.until_s > last + ROUNDING_S:
        yield RotaFault(
            rule="energy", where=where, message=f"stays until {shift.until_s:g} s, but must leave at {last:g} s"
        )


def _vehicle_faults(rota: Rota, vehicle: PoolVehicle, turnaround: Turnaround) -> Iterator[RotaFault]:
    """Check that a vehicle flies one shift after the other, from where and what it is now."""
    row = sorted((shift for shift in rota.shifts if shift.vehicle == vehicle.id), key=lambda shift: shift.from_s)
    flying = vehicle.state in {"outbound", "on_station"}
    if flying:
        begun = [(shift.station, shift.from_s, shift.under_way) for shift in row[:1]]
        if begun != [(vehicle.station, vehicle.from_s, True)]:
            yield RotaFault(rule="under_way", where=vehicle.id, message="its shift that is under way was changed")
    if any(shift.under_way for shift in row[1 if flying else 0 :]):
        yield RotaFault(
            rule="under_way", where=vehicle.id, message="a shift that has not begun is said to be under way"
        )
    free_s = turnaround.lead_s
    if vehicle.state == "turnaround":
        free_s = max(free_s, vehicle.ready_s or 0.0)
    elif vehicle.state == "inbound":
        free_s = max(free_s, (vehicle.lands_s or 0.0) + turnaround.seconds)
        free_s = max([free_s, *(one.ready_s for one in rota.grounded if one.vehicle == vehicle.id)])
    for shift in row:
        if not shift.under_way and shift.leaves_pad_s < free_s - ROUNDING_S:
            message = f"leaves its pad at {shift.leaves_pad_s:g} s, but is ready at {free_s:g} s"
            yield RotaFault(rule="ready", where=f"{vehicle.id} to {shift.station}", message=message)
        free_s = max(turnaround.lead_s, shift.ready_s)


def _station_faults(rota: Rota, station: str, turnaround: Turnaround) -> Iterator[RotaFault]:
    """Check that relievers come the whole overlap before the relieved leave, or after, and never a third one."""
    row = sorted(
        (shift for shift in rota.shifts if shift.station == station), key=lambda shift: (shift.from_s, shift.until_s)
    )
    for before, after in pairwise(row):
        together_s = before.until_s - max(after.from_s, 0.0)
        if ROUNDING_S < together_s < turnaround.overlap_s - ROUNDING_S:
            message = f"{before.vehicle} leaves {together_s:g} s after {after.vehicle} has come"
            yield RotaFault(rule="overlap", where=f"{station} at {after.from_s:g} s", message=message)
    for first, _, third in zip(row, row[1:], row[2:], strict=False):
        if max(third.from_s, 0.0) < first.until_s - ROUNDING_S:
            message = f"{third.vehicle} comes before {first.vehicle} has left"
            yield RotaFault(rule="crowded", where=station, message=message)


def _crew_faults(rota: Rota, pool: Sequence[PoolVehicle], turnaround: Turnaround) -> Iterator[RotaFault]:
    """Check how many are turned around at once."""
    if turnaround.at_once is None:
        return
    begins = [*(shift.turned_s for shift in rota.shifts), *(one.turned_s for one in rota.grounded)]
    busy = [(begin, begin + turnaround.seconds) for begin in begins]
    busy += [(0.0, vehicle.ready_s or 0.0) for vehicle in pool if vehicle.state == "turnaround"]
    for begin in begins:
        at_once = sum(one[0] <= begin + ROUNDING_S < one[1] - ROUNDING_S for one in busy)
        if at_once > turnaround.at_once:
            yield RotaFault(rule="crew", where=f"at {begin:g} s", message=f"{at_once} are turned around at once")


def _told_faults(rota: Rota, stations: Sequence[str]) -> Iterator[RotaFault]:
    """Check what the rota says of dark times, second by second where anything changes."""
    dark_s = 0.0
    for station in stations:
        there = [(shift.from_s, shift.until_s) for shift in rota.shifts if shift.station == station]
        told = [(one.from_s, one.until_s) for one in rota.dark if one.station == station]
        moments = sorted(
            {0.0, rota.horizon_s, *(min(max(t, 0.0), rota.horizon_s) for pair in (*there, *told) for t in pair)}
        )
        for begin, end in pairwise(moments):
            middle = (begin + end) / 2.0
            manned, said = (any(one[0] <= middle <= one[1] for one in rows) for rows in (there, told))
            dark_s += 0.0 if manned else end - begin
            if manned == said and end - begin > ROUNDING_S:
                message = f"{'manned' if manned else 'dark'} from {begin:g} to {end:g} s, and said not to be"
                yield RotaFault(rule="dark", where=station, message=message)
    share = 1.0 - dark_s / (rota.horizon_s * len(stations)) if stations else 1.0
    if abs(share - rota.manned_share) > ROUNDING_S:
        yield RotaFault(rule="dark", where="manned_share", message=f"is {share:g}, not {rota.manned_share:g}")
