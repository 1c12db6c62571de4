"""The example of a hilly town, from its files to the ground again: flown in wind, one UAV lost, judged by the truth."""

from __future__ import annotations

import math
from functools import cache

import pytest

from skyfolio import sim
from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.bench.hilly import judged
from skyfolio.planner import Plan, Scenario, violations
from tests.api.sky import Sky, flight
from tests.places.test_hilly_town import hilly_town

pytestmark = pytest.mark.long

FLEET = ("px4", "ardupilot", "ardupilot")
"""One of each flies on when the second is lost."""
LOST_AT_SLOT = 7
TRACKING_M = 2.0
"""By so much a simulated vehicle may be lower than its plan has it."""
HOME_M = 12.0
"""Nearer to its home a vehicle may come down to land."""


@cache
def town() -> Scenario:
    return hilly_town()


def feasible(plan: Plan) -> None:
    """The independent checks of the planner, and a coarser judge of clearances, find nothing."""
    assert violations(plan) == []
    assert judged(plan) == []


def samples(made: Sky, system_id: int, from_s: float) -> list[sim.Sample]:
    return [one for one in made.fleet.truth.of(system_id) if one.t_s >= from_s]


def least_clearance_m(made: Sky, system_id: int, from_s: float) -> float:
    """The least height over the ground from then until the vehicle begins to come down over its home."""
    home = made.fleet.vehicles[system_id].autopilot.spec
    away = [one for one in samples(made, system_id, from_s) if away_m(one, home) > HOME_M]
    assert len(away) > 100
    return min(one.over_ground_m for one in away)


def away_m(one: sim.Sample, home: sim.VehicleSpec) -> float:
    """How far from its home it is over ground."""
    north = (one.lat_deg - home.home_lat_deg) * 111_195.0
    east = (one.lon_deg - home.home_lon_deg) * 111_195.0 * math.cos(math.radians(home.home_lat_deg))
    return math.hypot(east, north)


def test_the_town_is_flown_in_wind_loses_a_uav_heals_and_comes_home_with_its_reserve() -> None:
    with flight(town(), autopilots=FLEET) as made:
        feasible(made.plan)
        air = made.fleet.vehicles[1].autopilot.air
        assert (air.weather.wind_east_mps, air.weather.wind_north_mps) == (3.0, -2.0)
        assert air.weather.gust_mps == pytest.approx(0.8)
        operation_id = made.take_off(at_end="return")
        began_s = made.now_s
        made.fleet.inject(sim.Kill(2), at_s=began_s + LOST_AT_SLOT * 5.0)
        view = made.ended(operation_id)
        assert (view.state, view.lost, view.error) == (State.COMPLETED, ["uav-2"], None)
        assert [report.outcome for report in view.recoveries] == ["flying"]
        healed = made.client.read_plan(view.plan_id)
        assert isinstance(healed, Plan)
        feasible(healed)
        goes_on_where_it_was(made.plan, healed)
        made.let_pass(200.0)
        for system_id in (1, 3):
            assert made.fleet.truth.happened("landed", system_id)
            assert not made.fleet.truth.happened("crashed", system_id)
            assert least_clearance_m(made, system_id, began_s) >= 25.0 - TRACKING_M
            last = samples(made, system_id, began_s)[-1]
            assert away_m(last, made.fleet.vehicles[system_id].autopilot.spec) < HOME_M
            battery = town().uavs[system_id - 1].battery
            assert battery is not None
            assert last.battery >= battery.reserve_share


def goes_on_where_it_was(before: Plan, after: Plan) -> None:
    """A replan keeps altitude, home, used energy, wind and the windows of users, each moved on to its first slot."""
    passed = after.first_slot - before.first_slot
    assert passed > 0
    assert after.scenario.wind == before.scenario.wind
    assert before.altitudes_m is not None
    for uav in after.scenario.uavs:
        was = before.scenario.uav(uav.id)
        assert uav.home_m == was.start_m
        assert uav.start_altitude_m == before.altitudes_m[uav.id][passed]
        assert uav.battery is not None
        assert uav.battery.used_wh is not None
        assert before.energy_wh[uav.id][passed - 1] <= uav.battery.used_wh < before.energy_wh[uav.id][passed - 1] + 2.0
    for user, then in zip(after.scenario.users, before.scenario.users, strict=True):
        assert (user.id, user.demand_bps, user.weight) == (then.id, then.demand_bps, then.weight)
        for slot in range(after.scenario.slots):
            assert user.is_there(slot) == then.is_there(slot + passed)
