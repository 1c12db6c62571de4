"""Brings the states of a pool up to date, from what vehicles report and from the plans that were flown."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from skyfolio.api.flights.endless.pool import MOST_TRIES, Member, MemberState, Pool
from skyfolio.api.flights.flight import Flight

HEARD_S = 3.0
"""A vehicle that was heard within so many fleet seconds can be talked to."""
New = tuple[MemberState, str]
"""The state that a vehicle has come into, and because of what."""


def observe(pool: Pool, flight: Flight, launching: Collection[str]) -> Iterator[Member]:
    """Bring the states up to date; yield each member that came into another one. launching: who is taking off."""
    now_s, slot = flight.now_s(), int(flight.now_s() // flight.slot_s)
    flown = {entry.plan.id for entry in flight.timeline}
    for member in pool.members.values():
        seen = None if member.id in launching else _seen(pool, member, flight, slot, flown)
        if seen is not None:
            pool.enter(member, *seen, now_s)
            yield member
    _watch_stations(pool, flight, now_s)
    pool.crossings = [one for one in pool.crossings if slot <= one.ends_at]


def _seen(pool: Pool, member: Member, flight: Flight, slot: int, flown: Collection[str]) -> New | None:
    """Return the state in which a member is now, and why, if that is another one."""
    uav = member.id
    if uav in flight.lost and (member.state == "on_station" or not _comes_home(member, flight)):
        state: MemberState = "inbound" if _comes_home(member, flight) else "out_of_service"
        return (state, str(flight.roster.losses.get(uav))) if member.state != "out_of_service" else None
    down = flight.roster.is_down(uav)
    if member.state == "on_station":
        return _off_station(pool, uav, flight, slot, flown, down=down)
    if member.state == "outbound":
        arrived = any(c.reliever == uav and c.plan_id in flown and slot >= c.on_station_at for c in pool.crossings)
        if arrived:
            return "on_station", "it has taken over"
        return ("turnaround", "it has come down") if down else None
    if member.state == "inbound":
        return ("turnaround", "it has landed") if down else None
    if member.state == "out_of_service" and down and member.refusals < MOST_TRIES:
        return "turnaround", "it counts again, and has landed"
    if member.state == "turnaround" and down and uav not in flight.lost and _is_turned(pool, member, flight):
        return "ready", "it is charged"
    return None


def _comes_home(member: Member, flight: Flight) -> bool:
    """Return whether a member no longer counts because it was called home, and nothing worse has happened to it."""
    loss = flight.roster.losses.get(member.id)
    return member.called_home and loss is not None and loss.kind in {"battery", "landed"}


def _off_station(pool: Pool, uav: str, flight: Flight, slot: int, flown: Collection[str], *, down: bool) -> New | None:
    if any(c.relieved == uav and c.plan_id in flown and slot >= c.hand_over_at for c in pool.crossings):
        return "inbound", "it was relieved"
    if flight.elapsed_s() is None or slot <= flight.last_slot_of(uav):
        return None
    return ("turnaround" if down else "inbound"), "its slots are over"


def _is_turned(pool: Pool, member: Member, flight: Flight) -> bool:
    """Return whether a vehicle that has landed may fly again: charged, heard, and knowing where it is."""
    telemetry = flight.telemetry(member.id)
    if telemetry is None or telemetry.place_deg is None or flight.silent_s(member.id) > HEARD_S:
        return False
    if telemetry.battery is None:
        return flight.now_s() - member.since_s >= pool.terms.turnaround_s
    return telemetry.battery >= pool.terms.ready_charge


def _watch_stations(pool: Pool, flight: Flight, now_s: float) -> None:
    manned = {member.station: member.id for member in pool.in_state("on_station")}
    for station in pool.stations.values():
        station.manned_by = manned.get(station.id)
        if station.manned_by is None:
            station.dark_since_s = round(now_s, 3) if station.dark_since_s is None else station.dark_since_s
            continue
        station.dark_since_s = None
        path = flight.plan.trajectories_m.get(station.manned_by)
        leaves = any(crossing.relieved == station.manned_by for crossing in pool.crossings)
        if path is not None and not leaves:
            station.place_m = path[-1]


def dark_stations(pool: Pool, flight: Flight) -> Iterator[str]:
    """Yield the stations that no vehicle mans, nor has just been handed over to, while the operation goes on."""
    if flight.past_last_slot():
        return
    slot, flown = int(flight.now_s() // flight.slot_s), {entry.plan.id for entry in flight.timeline}
    handed_over = {
        one.station
        for one in pool.crossings
        if one.plan_id in flown and slot >= one.hand_over_at and one.reliever not in flight.lost
    }
    for station in pool.stations.values():
        if station.manned_by is None and station.id not in handed_over:
            yield station.id
