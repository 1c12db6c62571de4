"""The base stations of an operation in a drill, and what must hold of whom they serve.

Only some drills have them (`Drill.stations`): base stations ask, acknowledge and measure as those of an integrator do,
and new plans are made when rates are off.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator
from itertools import pairwise

from skyfolio import sim
from skyfolio.api.flights.allocations import AllocationsView
from skyfolio.api.flights.base_stations import BaseStations, assumed_by, radio_truth
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.torture.checks import at_end, meanwhile
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment
from skyfolio.api.lab.torture.sightings import Orphans
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.api.lab.virtual.stations import GroundPort

EVERY = 20
"""One of so many drills has base stations: that of every seed which leaves the rest `EVERY - 1`."""
ASK_S = 0.25
ROUND_S = 1.0
"""What base stations need to receive word of a change, and to acknowledge it."""
SERVED_SLOTS = 2
"""A base station that receives nothing more serves the slot that it knows, and the next."""
_FAULTS = ("station_deaf", "station_late", "station_power", "station_jammed")
_KNOBS = {
    "station_late": ("seconds", (1.0, 4.0, 7.0)),
    "station_power": ("db", (-25.0, -6.0, 6.0)),
    "station_jammed": ("db", (10.0, 45.0)),
}


def has_stations(seed: int) -> bool:
    """Return whether the drill of a seed has base stations."""
    return seed % EVERY == EVERY - 1


def with_stations(drill: Drill) -> Drill:
    """Return a drill with base stations, another true channel at times, and one or two faults of the radio."""
    chance = random.Random(f"stations/{drill.seed}")  # noqa: S311
    blows = [_fault(chance, drill) for _ in range(chance.choice((1, 2)))]
    return drill.model_copy(
        update={"stations": True, "bias_db": chance.choice((0.0, 0.0, -6.0)), "blows": (*drill.blows, *blows)}
    )


def _fault(chance: random.Random, drill: Drill) -> Blow:
    kind, system_id = chance.choice(_FAULTS), chance.randint(1, len(drill.scenario().uavs))
    options = {"kind": kind, "system_id": system_id}
    if kind in _KNOBS:
        name, values = _KNOBS[kind]
        options[name] = chance.choice(values)
    if (for_s := chance.choice((8.0, 20.0, None))) is not None:
        options["for_s"] = for_s
    after_s = round(chance.uniform(0.0, drill.slots * 4.0), 2)
    return Blow(when=Moment(state=State.FLYING, after_s=after_s), kind="vehicle", options=options)


async def serve(seen: Seen) -> None:
    """Let the base stations of an operation serve and report until it has ended."""
    fleet, scenario = seen.ground.fleet, seen.ground.scenario
    systems = {uav: seen.system_of(uav) for uav in seen.uavs}
    flown = scenario.with_changes(uavs=[uav for uav in scenario.uavs if uav.id in systems])
    channel = assumed_by(flown, sim.TruthChannel(bias_db=seen.drill.bias_db, seed=seen.drill.seed))
    port = _NotingPort(seen)
    stations = BaseStations(fleet, radio_truth(fleet, flown, channel, systems), port, systems)
    while seen.end is None:
        await stations.step()
        await asyncio.sleep(ASK_S)


class _NotingPort(GroundPort):
    """Notes what is allocated in each revision that base stations receive, and what they acknowledge of that."""

    def __init__(self, seen: Seen) -> None:
        super().__init__(seen.ground, seen.operation_id)
        self._seen = seen

    async def allocations(self) -> AllocationsView | None:
        """Return what base stations must serve; None once the operation has ended, or while no service lives."""
        view = await super().allocations()
        if view is not None:
            for uav, slots in told_by(view).items():
                self._seen.allocated.setdefault((uav, view.revision), slots)
        return view

    async def acknowledge(self, uav_id: str, revision: int) -> bool:
        """Acknowledge a revision; return whether that was accepted."""
        accepted = await super().acknowledge(uav_id, revision)
        if accepted:
            bands = self._seen.allocated[uav_id, revision].values()
            self._seen.accepted.setdefault(uav_id, []).extend(bands)
        return accepted


def told_by(view: AllocationsView) -> dict[str, dict[int, dict[str, float]]]:
    """Return what a view allocates: by UAV and slot, Hz by user."""
    return {
        uav: {slot.slot: slot.bandwidth_hz for slot in (one.now, one.next) if slot is not None}
        for uav, one in view.uavs.items()
    }


# -- invariants -------------------------------------------------------------------------------------------------------


@meanwhile
def _a_base_station_serves_only_what_was_acknowledged(seen: Seen) -> Iterator[str]:
    """Let a base station serve what its service knows that it serves: others may have its users by now."""
    if not seen.drill.stations:
        return
    for uav in seen.uavs:
        station = seen.ground.fleet.vehicles[seen.system_of(uav)].base_station
        serves = station.serves(seen.ground.now_s)
        if serves and serves not in seen.accepted.get(uav, ()):
            yield f"{uav} serves {sorted(serves)}, and has acknowledged {seen.accepted.get(uav, ())}"


@meanwhile
def _a_revision_keeps_what_it_allocates(seen: Seen) -> Iterator[str]:
    """Give another revision to whatever changes: base stations have acknowledged what this one allocates."""
    view = _allocated(seen)
    if view is None:
        return
    for uav, slots in told_by(view).items():
        before = seen.allocated.setdefault((uav, view.revision), slots)
        if before != slots:
            yield f"revision {view.revision} allocates {slots} to {uav}, and before {before}"


@meanwhile
def _no_user_is_served_twice_for_long(seen: Seen) -> Iterator[str]:
    """Let two base stations serve one user only as long as one of them cannot know better: a slot, and the next."""
    operation = seen.operation()
    if not seen.drill.stations or seen.state == State.PAUSED or (operation is not None and operation.flight.paused):
        seen.served_twice_s.clear()
        return
    now_s = seen.ground.now_s
    serving: dict[str, list[str]] = {}
    for uav in seen.uavs:
        vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
        for user in vehicle.base_station.serves(now_s):
            serving.setdefault(user, []).append(uav)
    for user in set(seen.served_twice_s) | set(serving):
        if len(serving.get(user, ())) < 2:
            seen.served_twice_s.pop(user, None)
            continue
        since_s = seen.served_twice_s.setdefault(user, now_s)
        if now_s - since_s > SERVED_SLOTS * seen.ground.scenario.slot_duration_s + ROUND_S:
            yield f"{user} is served by {' and '.join(serving[user])} for {now_s - since_s:.1f} s"


@meanwhile
def _a_lost_uav_is_allocated_no_user(seen: Seen) -> Iterator[str]:
    """Withdraw what a lost UAV serves within a slot: its base station may still receive, and must stop."""
    operation, view = seen.operation(), _allocated(seen)
    if operation is None or view is None or operation.state is not State.FLYING:
        seen.allocated_lost.clear()
        return
    for uav in operation.flight.lost:
        allocation = view.uavs[uav]
        if not any(slot.bandwidth_hz for slot in (allocation.now, allocation.next) if slot is not None):
            seen.allocated_lost.pop(uav, None)
            continue
        since_s = seen.allocated_lost.setdefault(uav, _unexcused_s(seen))
        if _unexcused_s(seen) - since_s > seen.ground.scenario.slot_duration_s:
            yield f"{uav} is lost and still to serve {sorted((allocation.now or allocation.next).bandwidth_hz)}"  # type: ignore[union-attr]


@meanwhile
def _users_of_a_lost_uav_are_allocated_to_others(seen: Seen) -> Iterator[str]:
    """Let others serve the users of a lost UAV within a slot, or a new plan be in force by then, which chooses anew."""
    operation, view = seen.operation(), _allocated(seen)
    if operation is None or view is None or operation.state is not State.FLYING or seen.drill.policy == "off":
        seen.orphans, seen.allocation = None, None
        return
    _note_orphans(seen, operation)
    lost, plan_id, orphans = {*operation.flight.lost}, operation.flight.plan.id, seen.orphans
    seen.allocation, seen.plan_id = view, plan_id
    if orphans is None:
        return
    orphans.users -= _served(view, {*view.uavs} - lost)
    if not orphans.users or plan_id != orphans.plan_id or lost >= {*view.uavs} or operation.flight.slot() is None:
        seen.orphans = None
    elif _unexcused_s(seen) - orphans.since_s > seen.ground.scenario.slot_duration_s:
        yield f"{', '.join(sorted(orphans.users))} of a lost UAV are allocated to no other"


def _note_orphans(seen: Seen, operation: Operation) -> None:
    """Note whom UAVs served, as it was seen last, that have been lost since."""
    before = seen.allocation
    lost = {*operation.flight.lost} - seen.known_lost
    seen.known_lost |= lost
    if before is None or not lost:
        return
    users = _served(before, lost) | (seen.orphans.users if seen.orphans is not None else set())
    seen.orphans = Orphans(users=users, plan_id=seen.plan_id, since_s=_unexcused_s(seen))


@at_end
def _revisions_of_allocations_only_grow(seen: Seen) -> Iterator[str]:
    """Give no revision twice, over restarts too: a base station would take the older one for the newer."""
    told = [one.data["revision"] for one in filter(seen.is_own, seen.events) if one.kind == "allocations"]
    for before, after in pairwise(told):
        if after <= before:
            yield f"revision {after} follows {before}"


def _allocated(seen: Seen) -> AllocationsView | None:
    """Return what the service that lives allocates; None in a drill without base stations, or if it has ended."""
    operation = seen.operation() if seen.drill.stations else None
    return None if operation is None else operation.radio.allocations.view()


def _served(view: AllocationsView, uavs: set[str]) -> set[str]:
    """Return the users that these UAVs are to serve now."""
    return {user for uav in uavs if (now := view.uavs[uav].now) is not None for user in now.bandwidth_hz}


def _unexcused_s(seen: Seen) -> float:
    return seen.ground.now_s - seen.excused_s
