"""Plans over a hill: clear of it everywhere, with the rates of the heights that are flown."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.api.lab.bench.checked import REFUSED, broken_over_hills
from skyfolio.api.lab.bench.hilly import judged
from skyfolio.planner import (
    EXAMPLES,
    MaxIterations,
    Pins,
    Plan,
    ReplanError,
    UnreachableEndError,
    delivered_rates_bps,
    plan,
    remaining,
    replan,
    violations,
)
from skyfolio.planner.robustness.flown import flown_as_planned, planned_gains
from tests.planner.hills import over_the_hill


def planned(**changes: object) -> Plan:
    return plan(over_the_hill(**changes), n_starts=4, stop=MaxIterations(6))


def test_without_terrain_and_limits_a_plan_has_no_altitudes_and_its_document_does_not_speak_of_them() -> None:
    document = plan(EXAMPLES["paper"](), n_starts=1, stop=MaxIterations(1)).model_dump_json()
    assert not any(word in document for word in ("altitudes_m", "terrain", "clearance_m", "home_m", "altitude_min_m"))


def test_every_leg_and_way_home_keeps_the_clearance() -> None:
    made = planned()
    assert made.altitudes_m is not None
    assert (violations(made), judged(made)) == ([], [])
    assert min(made.altitudes_m["west"]) > 440.0  # above sea level: over the flat land it is 40 m up


def test_a_uav_that_flies_around_the_hill_is_high_enough_to_come_home_over_it() -> None:
    alone = over_the_hill(users=over_the_hill().users[:1], uavs=over_the_hill().uavs[:1])  # straight behind the hill
    made = plan(alone, n_starts=4, stop=MaxIterations(6))
    assert made.altitudes_m is not None
    beyond = [
        up for (east, _), up in zip(made.trajectories_m["west"], made.altitudes_m["west"], strict=True) if east > 350
    ]
    assert beyond
    assert min(beyond) >= 520.0 + 30.0 - 1.0


def test_climbs_are_no_steeper_than_a_uav_climbs() -> None:
    slow = tuple(uav.model_copy(update={"max_climb_mps": 0.8}) for uav in over_the_hill().uavs)
    made = planned(uavs=slow)
    assert made.altitudes_m is not None
    steps = [abs(b - a) for row in made.altitudes_m.values() for a, b in pairwise(row)]
    assert max(steps) <= 0.8 * 5.0 + 1e-9
    assert violations(made) == []


def test_rates_are_those_of_the_heights_over_each_user() -> None:
    made = planned()
    assert made.altitudes_m is not None
    scenario, paths = made.scenario, np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    assert scenario.terrain is not None
    users = np.array([user.position_m for user in scenario.users])
    up = (
        np.array([made.altitudes_m[uav] for uav in scenario.uav_ids])[:, None, :]
        - scenario.terrain.height_m(users)[None, :, None]
    )
    distance2 = ((paths[:, None] - users[None, :, None]) ** 2).sum(axis=-1) + up**2
    snr = 0.1 * 10**-2.0 / 10**-11.0 / distance2
    index = {uav: u for u, uav in enumerate(scenario.uav_ids)}
    for k, user in enumerate(scenario.user_ids):
        for n in range(scenario.slots):
            u = index[made.association[user][n]]
            sinr = snr[u, k, n] / (1.0 + snr[:, k, n].sum() - snr[u, k, n])
            assert made.user_rates_bps[user][n] == pytest.approx(
                made.bandwidth_hz[user][n] * np.log2(1 + sinr), rel=1e-9
            )
    assert made.summary.utility_bps <= made.summary.upper_bound_bps


def test_what_users_get_in_flight_and_under_disturbances_counts_the_heights_too() -> None:
    made = planned()
    everybody = np.ones((made.scenario.slots, len(made.scenario.uavs)), dtype=bool)
    there = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids]).transpose(1, 0, 2)
    delivered = delivered_rates_bps(made, np.arange(made.scenario.slots), there, everybody)
    promised = np.array([made.user_rates_bps[user] for user in made.scenario.user_ids])
    assert pytest.approx(promised, rel=1e-9) == delivered.T
    assert flown_as_planned(made).rates_bps(planned_gains(made)) == pytest.approx(promised, rel=1e-9)


def test_an_altitude_that_may_be_chosen_is_never_worse_than_the_least_one() -> None:
    fixed = planned(altitude_min_m=40.0, altitude_max_m=40.0)
    free = planned(altitude_min_m=40.0, altitude_max_m=150.0)
    assert violations(free) == []
    assert free.summary.utility_bps >= fixed.summary.utility_bps * (1 - 1e-9)


def test_an_idle_uav_climbs_out_of_the_way_of_others() -> None:
    """One user, two UAVs: the one that serves nobody interferes less from high up."""
    pair = over_the_hill(terrain=None, users=over_the_hill().users[2:3], altitude_min_m=30.0, altitude_max_m=300.0)
    near = tuple(uav.model_copy(update={"max_speed_mps": 0.0}) for uav in pair.uavs)
    made = plan(pair.with_changes(uavs=near), n_starts=1, stop=MaxIterations(3))
    assert made.altitudes_m is not None
    serving = made.association["user-2"][-1]
    [idle] = {"west", "south"} - {serving}
    assert made.altitudes_m[idle][-1] == pytest.approx(300.0, abs=0.01)
    assert made.altitudes_m[serving][-1] == pytest.approx(30.0, abs=0.01)
    assert violations(made) == []


def test_a_replan_goes_on_from_the_altitude_and_home_of_the_plan_before() -> None:
    made = planned()
    assert made.altitudes_m is not None
    rest = replan(made, failed=["south"], at_slot=5, stop=MaxIterations(4))
    assert rest.altitudes_m is not None
    assert rest.altitudes_m["west"][0] == pytest.approx(made.altitudes_m["west"][5], abs=1e-5)
    assert rest.scenario.uavs[0].home_m == (60.0, 250.0)
    assert (violations(rest), judged(rest)) == ([], [])


def test_a_replan_goes_on_from_the_altitude_that_is_flown_where_that_is_not_the_planned_one() -> None:
    made = planned()
    assert made.altitudes_m is not None
    late_m = made.altitudes_m["west"][5] - 20.0
    rest = replan(made, failed=["south"], at_slot=5, altitudes_m={"west": late_m}, stop=MaxIterations(4))
    assert rest.altitudes_m is not None
    assert rest.scenario.uavs[0].start_altitude_m == late_m
    high_m = made.altitudes_m["west"][5] + 40.0
    down = replan(made, failed=["south"], at_slot=5, altitudes_m={"west": high_m}, stop=MaxIterations(4))
    assert down.altitudes_m is not None
    assert down.altitudes_m["west"][0] == pytest.approx(high_m, abs=1e-5)
    assert down.altitudes_m["west"][-1] < high_m - 20.0
    for again in (rest, down):
        assert (violations(again), judged(again)) == ([], [])


def test_a_uav_that_is_too_low_for_the_hill_ahead_climbs_first_and_then_flies_over_it() -> None:
    alone = over_the_hill(users=over_the_hill().users[:1], uavs=over_the_hill().uavs[:1], slots=30)
    [west] = alone.uavs
    low = west.model_copy(update={"start_altitude_m": 441.0, "home_m": west.start_m, "max_climb_mps": 1.0})
    made = plan(alone.with_changes(uavs=(low,)), n_starts=1, stop=MaxIterations(4))
    assert (violations(made), judged(made)) == ([], [])
    assert made.trajectories_m["west"][-1][0] > 350.0  # behind the hill, where its user is


@pytest.mark.parametrize(
    ("live", "message"),
    [
        ({"altitudes_m": {"nobody": 500.0}}, "altitudes_m: 'nobody' is not a UAV"),
        ({"altitudes_m": {"west": float("nan")}}, "altitudes_m.west: nan must be a number from -500"),
        ({"used_wh": {"nobody": 1.0}}, "used_wh: 'nobody' is not a UAV"),
        ({"used_wh": {"west": -1.0}}, "used_wh.west: -1.0 must be a number from 0"),
    ],
)
def test_an_altitude_or_an_energy_that_is_none_is_refused_by_name(live: dict[str, Any], message: str) -> None:
    with pytest.raises(ReplanError, match=message):
        remaining(planned(), ["south"], 5, **live)


def test_a_uav_that_cannot_climb_in_time_flies_less_far() -> None:
    low = tuple(
        uav.model_copy(update={"start_altitude_m": 441.0, "home_m": uav.start_m, "max_climb_mps": 0.2})
        for uav in over_the_hill().uavs
    )
    made = planned(uavs=low)
    assert violations(made) == []
    assert made.altitudes_m is not None
    assert made.altitudes_m["west"][-1] <= made.altitudes_m["west"][0] + 0.2 * 5.0 * 11 + 1e-6
    assert made.altitudes_m["west"][0] < 444.0
    assert made.trajectories_m["west"][-1][0] < 250.0  # not over the hill


def test_an_end_that_cannot_be_reached_over_the_hill_is_refused_by_name() -> None:
    behind = tuple(
        uav.model_copy(
            update={"start_altitude_m": 441.0, "home_m": uav.start_m, "max_climb_mps": 0.2, "end_m": (440.0, 250.0)}
        )
        if uav.id == "west"
        else uav
        for uav in over_the_hill().uavs
    )
    with pytest.raises(
        UnreachableEndError, match=r"terrain: no path was found on which 'west' keeps clear of the ground"
    ):
        planned(uavs=behind)


def test_a_pinned_path_into_the_hill_is_refused() -> None:
    low = tuple(
        uav.model_copy(update={"start_altitude_m": 441.0, "max_climb_mps": 0.1}) for uav in over_the_hill().uavs
    )
    scenario = over_the_hill(uavs=low)
    over = tuple((60.0 + 35.0 * n, 250.0) for n in range(scenario.slots))
    with pytest.raises(UnreachableEndError, match="or keeps its pinned path"):
        plan(scenario, pins=Pins(paths_m={"west": over}), n_starts=1, stop=MaxIterations(2))


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10_000_000))
def test_no_plan_or_replan_over_random_hills_breaks_a_rule(seed: int) -> None:
    assert [found for found in broken_over_hills(seed) if not found.startswith(REFUSED)] == []
