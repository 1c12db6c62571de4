"""Energy where altitudes are part of a plan: climbs, the first ascent and landings are priced as high as they are."""

from math import hypot
from typing import Any

import numpy as np
import pytest

from skyfolio.planner import MaxIterations, Plan, Scenario, plan, replan, violations
from skyfolio.planner.energy.account import account_of
from skyfolio.planner.scenario import Battery, RallyPoint, Rotors, Wind
from tests.planner.hills import hill, over_the_hill

QUICK: dict[str, Any] = {"n_starts": 2, "stop": MaxIterations(3)}
ROTORS = Rotors(climb_mps=2.0, descend_mps=1.0)


def with_batteries(usable_wh: float, **changes: Any) -> Scenario:
    scenario = over_the_hill(clearance_m=25.0, wind=Wind(east_mps=2.0, gust_mps=1.0), **changes)
    more: dict[str, Any] = {
        "battery": Battery(usable_wh=usable_wh), "rotors": ROTORS, "max_airspeed_mps": 14.0, "max_climb_mps": 3.0
    }  # fmt: skip
    return scenario.with_changes(uavs=tuple(uav.model_copy(update=more) for uav in scenario.uavs))


def least_margin_wh(made: Plan) -> float:
    return min(min(row) for row in made.energy_margin_wh.values())


def power_w(airspeed: float) -> float:
    swirl = airspeed**2 / (2.0 * ROTORS.induced_mps**2)
    induced = ROTORS.induced_w * np.sqrt(np.sqrt(1.0 + swirl**2) - swirl)
    blade = ROTORS.blade_w * (1.0 + 3.0 * (airspeed / ROTORS.tip_mps) ** 2)
    return float(blade + induced + ROTORS.parasite_w_per_mps3 * airspeed**3)


def test_the_account_of_a_climb_over_home_is_worked_by_hand() -> None:
    scenario = with_batteries(100.0)
    air = scenario.air
    assert air is not None
    paths = np.repeat(np.array([[uav.start_m] for uav in scenario.uavs], dtype=float), 12, axis=1)
    level = air.ground_m[:, None] + air.height_m[:, None] + np.zeros((2, 12))
    same, flat = account_of(air, paths, np.full(2, 12), level), account_of(air, paths, np.full(2, 12))
    np.testing.assert_allclose(same.used_wh, flat.used_wh, rtol=1e-12)
    np.testing.assert_allclose(same.margin_wh, flat.margin_wh, rtol=1e-12)
    higher = level.copy()
    higher[0, 3:] += 36.0
    climbed = account_of(air, paths, np.full(2, 12), higher)
    lift_wh = 36.0 * 19.62 / 3600.0
    assert climbed.used_wh[0] - flat.used_wh[0] == pytest.approx([0.0, 0.0] + [lift_wh] * 10)
    landing_wh = float(air.law.worst_w(np.full(2, 2.0), 1.0)[0]) * 36.0 / 3600.0
    lower = flat.margin_wh[0] - climbed.margin_wh[0]
    assert lower == pytest.approx([0.0, 0.0] + [lift_wh + landing_wh] * 10)
    assert climbed.margin_wh[1] == pytest.approx(flat.margin_wh[1])


def test_a_plan_over_a_hill_tells_what_its_altitudes_cost() -> None:
    made = plan(with_batteries(100.0), **QUICK)
    assert violations(made) == []
    scenario, altitudes = made.scenario, made.altitudes_m
    assert altitudes is not None
    assert scenario.terrain is not None
    rose = 0.0
    for uav in scenario.uavs:
        up, path = altitudes[uav.id], made.trajectories_m[uav.id]
        height = up[0] - scenario.terrain.height_at(*uav.start_m)
        used = (power_w(2.0) * height / 2.0 + 19.62 * height) / 3600.0
        for n in range(scenario.slots):
            last = min(n + 1, scenario.slots - 1)
            (e0, n0), (e1, n1) = path[n], path[last]
            airspeed = hypot((e1 - e0) / 5.0 - 2.0, (n1 - n0) / 5.0)
            used += (power_w(airspeed) * 5.0 + 19.62 * max(0.0, up[last] - up[n])) / 3600.0
            assert made.energy_wh[uav.id][n] == pytest.approx(used)
        rose = max(rose, max(up) - scenario.terrain.height_at(*uav.start_m) - 40.0)
    assert rose > 5.0  # or the test would say little


def test_a_uav_that_could_not_come_home_from_behind_the_hill_flies_less_far() -> None:
    ample = plan(with_batteries(100.0), **QUICK)
    lacking = 80.0 - least_margin_wh(ample) - 0.4  # of what may be used, a little less than this plan asks for
    tight = plan(with_batteries(lacking / 0.8), **QUICK)
    assert violations(tight) == []
    assert least_margin_wh(tight) >= -1e-9
    assert tight.trajectories_m != ample.trajectories_m
    assert any(len(set(path)) > 1 for path in tight.trajectories_m.values())


def test_altitudes_are_chosen_no_higher_than_the_battery_allows() -> None:
    limits: dict[str, Any] = {"altitude_min_m": 30.0, "altitude_max_m": 200.0}
    for usable_wh in (9.0, 10.0, 12.0, 40.0):
        made = plan(with_batteries(usable_wh, **limits), **QUICK)
        assert violations(made) == []
        assert least_margin_wh(made) >= -1e-9


@pytest.mark.parametrize("seed", [*range(40), 310, 437])
def test_plans_and_replans_over_hills_keep_their_energy_and_survivors_stay_to_the_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    usable_wh, terrain = float(rng.uniform(7.3, 11.0)), hill(height_m=float(rng.uniform(20.0, 250.0)))
    limits = {"altitude_min_m": 30.0, "altitude_max_m": float(rng.uniform(50.0, 200.0))} if rng.random() < 0.5 else {}
    made = plan(with_batteries(usable_wh, terrain=terrain, **limits), **QUICK)
    assert violations(made) == []
    again = replan(made, failed=["south"], at_slot=int(rng.integers(1, 11)), **QUICK)
    assert violations(again) == []
    assert again.scenario.uavs[0].leaves_at_slot is None


def test_a_replan_goes_on_with_altitude_home_and_what_was_used_at_most() -> None:
    made = plan(with_batteries(30.0), **QUICK)
    again = replan(made, failed=["south"], at_slot=5, **QUICK)
    [west] = again.scenario.uavs
    assert made.altitudes_m is not None
    assert (west.home_m, west.start_altitude_m) == ((60.0, 250.0), made.altitudes_m["west"][5])
    assert west.battery is not None
    used_wh = west.battery.used_wh
    assert used_wh is not None
    assert made.energy_wh["west"][4] <= used_wh < made.energy_wh["west"][4] + 1.0
    assert violations(again) == []


def test_over_terrain_a_uav_is_proven_to_come_home_and_not_to_a_rally_point_behind_the_hill() -> None:
    """Only ways home are planned to be clear of the ground."""
    behind = (RallyPoint(position_m=(440.0, 250.0)),)
    without, with_rally = with_batteries(30.0), with_batteries(30.0, rally_points=behind)
    assert plan(with_rally, **QUICK).energy_margin_wh == plan(without, **QUICK).energy_margin_wh


@pytest.mark.parametrize("change_m", [15.0, -15.0])
def test_the_check_finds_energy_that_was_reckoned_for_other_altitudes(change_m: float) -> None:
    made = plan(with_batteries(30.0), **QUICK)
    assert made.altitudes_m is not None
    moved = {uav: [up + change_m for up in row] for uav, row in made.altitudes_m.items()}
    found = {one.constraint for one in violations(made.model_copy(update={"altitudes_m": moved}))}
    assert "energy" in found
