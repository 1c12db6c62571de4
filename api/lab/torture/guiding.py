"""What must hold of guidance: slips are reported as they are, no item is flown again, and orders are obeyed."""

from __future__ import annotations

from collections.abc import Iterator
from math import dist

from skyfolio.api.flights.journal import Step
from skyfolio.api.lab.torture.checks import at_end, meanwhile
from skyfolio.api.lab.torture.missions import assigned_mission
from skyfolio.api.lab.torture.sightings import Slipped
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.sim import Mode
from skyfolio.sim.station import Vehicle

SOON_S = 0.7
"""A slip is reported at most so long after its slot began, if it is to be compared with where the vehicle is."""
EARLY_S = 0.5
"""A slot begins for the service at most so long before it does for the drill."""
SLIP_M = 6.0
"""How far a reported slip may be from what it is: telemetry comes at 5 Hz, and GPS is off."""
AT_ITEM_M = 2.0
"""So near a vehicle is at a waypoint: ArduCopter's acceptance radius."""
OBEYS_S = 5.0
"""Seconds after an order in which a vehicle is seen to obey."""
NAV_LAST = 95
"""MAV_CMD_NAV_LAST: items with greater commands are done on the way."""
AFTER = {
    "hold": frozenset({Mode.HOLD, Mode.GUIDED, Mode.BRAKE}),
    "land": frozenset({Mode.LAND}),
    "return": frozenset({Mode.RTL, Mode.LAND}),
}
"""Modes in which a vehicle may be after an order."""


@meanwhile
def _slips_are_told_as_they_are(seen: Seen) -> Iterator[str]:
    """Tell how far a UAV is from the place that its mission has for it: its keeper, and the operator, go by that.

    It is compared with the truth where that is still what it was: soon, with the same mission on board, and none being
    sent. A UAV that a blow has hit may report what is not so.
    """
    told, seen.new_slips[:] = list(seen.new_slips), []
    for slip in told:
        vehicle = seen.ground.fleet.vehicles[slip.system_id]
        late_s = slip.elapsed_s - slip.slot * seen.ground.scenario.slot_duration_s
        if late_s < -EARLY_S:
            yield f"vehicle {slip.system_id}: that of slot {slip.slot} {-late_s:.1f} s before the slot began"
            continue
        same = vehicle.mission.mission_id == slip.mission_id and slip.system_id not in seen.harmed
        same = same and not _was_being_sent(seen, slip)
        assigned = assigned_mission(seen, vehicle) if same and late_s <= SOON_S else None
        place = -1 if assigned is None else slip.slot - assigned.first_slot
        if assigned is None or not 0 <= place < len(assigned.path_m):
            continue
        truly_m = dist(slip.at_m, assigned.path_m[place])
        if abs(truly_m - slip.distance_m) > SLIP_M:
            yield f"vehicle {slip.system_id} in slot {slip.slot}: {slip.distance_m:.1f} m, and truly {truly_m:.1f} m"


def _was_being_sent(seen: Seen, slip: Slipped) -> bool:
    """Return whether a mission was being sent to the vehicle then: its keeper follows once that is verified."""
    uav = seen.uav_of(slip.system_id)
    sent = seen.last_taken(Step.UPLOADING, uav, until_s=slip.at_s)
    verified = seen.last_taken(Step.VERIFIED, uav, until_s=slip.at_s)
    return sent is not None and (verified is None or verified.at_s < sent.at_s)


@at_end
def _the_slip_of_a_slot_is_told_once(seen: Seen) -> Iterator[str]:
    """Keep a UAV by one keeper: two give it two orders, and tell each slip twice."""
    told: set[tuple[int, int, int]] = set()
    for slip in seen.slips:
        key = (slip.system_id, slip.slot, slip.start)
        if key in told:
            yield f"vehicle {slip.system_id}: that of slot {slip.slot} is told again at {slip.elapsed_s:.1f} s"
        told.add(key)


def _is_at_its_item(seen: Seen, vehicle: Vehicle) -> bool:
    if vehicle.item >= len(vehicle.mission.items):
        return False
    item = vehicle.mission.items[vehicle.item]
    return item.param1 > 0.0 and dist(seen.place_m(vehicle)[:2], seen.place_of(item.x / 1e7, item.y / 1e7)) <= AT_ITEM_M


@meanwhile
def _nobody_flies_an_item_again(seen: Seen) -> Iterator[str]:
    """Fly each item of a mission once: one who begins again is where others do not expect it.

    A hold may be restarted as it ends (`mavlink_bridge.keeper`): the vehicle is at that item still. A speed that is
    set again on the way to the same place is nothing that is flown.
    """
    for vehicle in seen.vehicles():
        system_id = vehicle.system_id
        if vehicle.mode is not Mode.MISSION or not vehicle.armed or not vehicle.alive:
            continue
        item = _flown_item(vehicle, vehicle.item)
        before, seen.cursors[system_id] = seen.cursors.get(system_id), (vehicle.mission.mission_id, item)
        if before is None or before[0] != vehicle.mission.mission_id or system_id in seen.harmed:
            continue
        is_next = _flown_item(vehicle, vehicle.item + 1) == before[1]
        if item < before[1] and not (is_next and item == vehicle.item and _is_at_its_item(seen, vehicle)):
            yield f"vehicle {system_id} goes back from item {before[1]} to {item}"


def _flown_item(vehicle: Vehicle, item: int) -> int:
    """Return the number of the item that a vehicle flies once this one is current: it, or the next that is flown."""
    items = vehicle.mission.items
    return next((seq for seq in range(item, len(items)) if items[seq].command <= NAV_LAST), item)


@meanwhile
def _who_is_ordered_away_obeys(seen: Seen) -> Iterator[str]:
    """Let an order of the operator be the last word: what was being sent to the vehicle must not undo it.

    A later order replaces it, a service that was started meanwhile has sent neither, and a vehicle that a blow has hit
    may be unable to obey.
    """
    for uav, (at_s, action) in list(seen.sent_away.items()):
        if seen.ground.now_s < at_s + OBEYS_S:
            continue
        del seen.sent_away[uav]
        vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
        left_alone = seen.ordered.get(vehicle.system_id, 0.0) <= at_s and seen.starts_s[-1] <= at_s
        if not left_alone or vehicle.system_id in seen.harmed or not seen.is_aloft(vehicle):
            continue
        if vehicle.mode not in AFTER[action]:
            yield f"{uav} was ordered to {action} at {at_s:.1f} s, and is in mode {vehicle.mode.name}"
