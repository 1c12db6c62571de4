"""What a flight tells of its slip: a UAV that hovers in its place is on schedule."""

from math import dist

from skyfolio.api.dashboard.event_text import describe
from skyfolio.api.dashboard.views import ServiceEvent
from skyfolio.planner import EXAMPLES
from tests.api.sky import flight

HOVERS = EXAMPLES["paper"]().with_changes(slots=36, altitude_m=10.0)
"""Flies to its users in the first slots, and hovers there, creeping a little, for three minutes."""


def test_a_fleet_that_hovers_records_metres_in_every_slot_and_is_never_said_to_be_late() -> None:
    with flight(HOVERS) as flown:
        flown.ended(flown.client.fly(flown.plan.id).id)
        slips = flown.events("slip")
    data = [event["data"] for event in slips]
    assert len(data) == 3 * 35
    assert max(slip["distance_m"] for slip in data) < 3.0
    paths, slot_s = flown.plan.trajectories_m, HOVERS.slot_duration_s
    moved = {
        (uav, slot): dist(path[slot - 1], path[slot]) / slot_s >= 1.0
        for uav, path in paths.items()
        for slot in range(1, HOVERS.slots)
    }
    assert 3 <= sum(moved.values()) <= 15
    assert all((slip["late_s"] is not None) == moved[slip["uav_id"], slip["slot"]] for slip in data)
    assert not any(slip["off_schedule"] for slip in data)
    assert [describe(ServiceEvent.model_validate(event))[0] for event in slips] == [""] * len(data)
