"""api.lab.radio: what users truly get, drawn anew"""

from __future__ import annotations

import numpy as np
import pytest

from skyfolio.api.flights.rates import InForce, Sample, rates_by_slot
from skyfolio.api.lab.radio import RadioTruth, in_unseen_air
from skyfolio.mavlink_bridge import east_north_to_geodetic
from skyfolio.planner import EXAMPLES, Plan, plan
from skyfolio.sim import Fleet, VehicleSpec, VirtualClock


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(EXAMPLES["minimal"]().with_changes(slots=4))


def test_the_air_draws_what_the_planner_has_not_seen_and_the_same_for_the_same_seed(made: Plan) -> None:
    samples = [
        Sample(
            made.scenario.slot_duration_s * (slot + 0.5),
            {uav: made.trajectories_m[uav][slot] for uav in made.scenario.uav_ids},
            frozenset(made.scenario.uav_ids),
        )
        for slot in range(made.scenario.slots)
    ]
    planned, *drawn = (
        rates_by_slot([InForce(0.0, seen)], samples, made.scenario.slots)
        for seen in (made, in_unseen_air(made, 1), in_unseen_air(made, 1), in_unseen_air(made, 2))
    )
    assert np.array_equal(drawn[0], drawn[1])
    assert not np.allclose(drawn[0], drawn[2])
    assert not np.allclose(drawn[0], planned)
    assert drawn[0].mean() == pytest.approx(planned.mean(), rel=0.5)


def test_each_slot_that_is_over_is_told_once_and_standing_vehicles_serve_nobody(made: Plan) -> None:
    scenario = made.scenario
    specs = [
        VehicleSpec(n, *east_north_to_geodetic(scenario.origin, *uav.start_m))
        for n, uav in enumerate(scenario.uavs, start=1)
    ]
    fleet = Fleet(specs, clock=VirtualClock())
    radio = RadioTruth(made, dict(enumerate(scenario.uav_ids, start=1)), seed=3)
    assert radio.rows(fleet) == []
    fleet.start_slots(scenario.slot_duration_s)
    fleet.step_to(scenario.slot_duration_s + 0.1)
    (row,) = radio.rows(fleet)
    assert set(row["user_rates_bps"].values()) == {0.0}
    for vehicle in fleet.vehicles.values():
        vehicle.autopilot.arm()
        vehicle.autopilot.takeoff(scenario.altitude_m)
    fleet.step_to(3 * scenario.slot_duration_s + 0.1)
    assert [row["slot"] for row in radio.rows(fleet)] == [1, 2]
    fleet.step_to(100 * scenario.slot_duration_s)
    assert [row["slot"] for row in radio.rows(fleet)] == [3]
    assert radio.rows(fleet) == []
