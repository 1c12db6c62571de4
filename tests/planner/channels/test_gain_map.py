"""Maps of gains: what they say at places, what is refused, bounds, and plans that fly to where gains are good."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from skyfolio.planner import Scenario, delivered_rates_bps, plan, violations
from skyfolio.planner.channels.gain_map import MAX_GAINS, GainMap
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.ground.bounding import bound_over_kbps
from skyfolio.planner.ground.ground import ground_of
from skyfolio.planner.layouts import scattered, shadow_map
from skyfolio.planner.learning import Observation, learned_corrections_db
from skyfolio.planner.optimistic import optimistic_rates_kbps
from skyfolio.planner.problem import problem_of
from skyfolio.planner.reach import reachable_boxes
from skyfolio.planner.repair import within_limits
from skyfolio.planner.sinr import spectral_efficiency
from tests.planner.channels.any_kind import shadowed
from tests.planner.hills import hill

SMALL: dict[str, Any] = {
    "kind": "map",
    "receivers_m": [(0.0, 0.0), (100.0, 0.0)],
    "levels_m": [30.0, 60.0],
    "south_west_m": (0.0, 0.0),
    "spacing_m": 40.0,
    "gains_db": [
        [[[-60.0, -70.0], [-62.0, -64.0]], [[-66.0, -68.0], [-65.0, -90.0]]],
        [[[-80.0, -81.0], [-82.0, -83.0]], [[-84.0, -85.0], [-86.0, -87.0]]],
    ],
}


def gain_db(channel: Any, user: tuple[float, float], uav: tuple[float, float], height_m: float) -> float:
    gain = channel.gain_at(math.dist(user, uav), height_m, places_m=(np.array(user), np.array(uav)))
    return 10.0 * math.log10(gain)


def test_at_its_places_and_levels_a_map_says_what_was_measured() -> None:
    small = channel_of(SMALL)
    assert gain_db(small, (0.0, 0.0), (40.0, 0.0), 30.0) == pytest.approx(-70.0, abs=1e-9)
    assert gain_db(small, (0.0, 0.0), (40.0, 40.0), 60.0) == pytest.approx(-90.0, abs=1e-9)
    assert gain_db(small, (100.0, 0.0), (0.0, 40.0), 60.0) == pytest.approx(-86.0, abs=1e-9)


def loss_db(*ends_m: float) -> float:
    return 10.0 * math.log10(sum(end * end for end in ends_m))


def test_between_its_places_decibels_over_free_space_are_bilinear() -> None:
    over_space = [
        -60.0 + loss_db(30.0),
        -70.0 + loss_db(40.0, 30.0),
        -62.0 + loss_db(40.0, 30.0),
        -64.0 + loss_db(40.0, 40.0, 30.0),
    ]
    at_a_quarter = 0.75 * (0.5 * over_space[0] + 0.5 * over_space[1]) + 0.25 * (
        0.5 * over_space[2] + 0.5 * over_space[3]
    )
    assert gain_db(channel_of(SMALL), (0.0, 0.0), (20.0, 10.0), 30.0) == pytest.approx(
        at_a_quarter - loss_db(20.0, 10.0, 30.0), abs=1e-9
    )


def test_between_its_levels_decibels_over_free_space_are_linear_and_beyond_them_they_stay() -> None:
    low, high = -60.0 + loss_db(30.0), -66.0 + loss_db(60.0)
    small = channel_of(SMALL)
    at_40 = gain_db(small, (0.0, 0.0), (0.0, 0.0), 40.0)
    assert at_40 == pytest.approx(low + (high - low) / 3.0 - loss_db(40.0), abs=1e-9)
    assert gain_db(small, (0.0, 0.0), (0.0, 0.0), 90.0) == pytest.approx(high - loss_db(90.0), abs=1e-9)


def test_a_user_beside_a_receiver_has_its_map_and_a_distance_of_its_own() -> None:
    excess = -84.0 + loss_db(100.0, 60.0)
    assert gain_db(channel_of(SMALL), (70.0, 10.0), (0.0, 0.0), 60.0) == pytest.approx(
        excess - loss_db(70.0, 10.0, 60.0), abs=1e-9
    )


def test_beyond_the_grid_it_goes_on_as_at_the_edge() -> None:
    excess = -70.0 + loss_db(40.0, 30.0)
    assert gain_db(channel_of(SMALL), (0.0, 0.0), (90.0, -10.0), 30.0) == pytest.approx(
        excess - loss_db(90.0, 10.0, 30.0), abs=1e-9
    )


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"levels_m": [60.0, 30.0]}, "levels_m: .* must rise"),
        ({"levels_m": [30.0]}, r"gains_db\.0: it has 2 grids for 1 levels_m"),
        ({"receivers_m": [(0.0, 0.0)]}, "gains_db: it has 2 maps for 1 receivers_m"),
        ({"gains_db": [SMALL["gains_db"][0], [[[-1.0, -1.0]] * 3] * 2]}, r"gains_db\.1\.0: it must have 2 x 2"),
        ({"gains_db": [[[[0.0, 101.0], [0.0, 0.0]]]]}, "less than or equal to 100"),
        ({"reference_gain_db": -20.0}, "not permitted"),
    ],
)
def test_a_map_that_does_not_fit_together_is_refused(changes: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        channel_of({**SMALL, **changes})


def test_a_map_of_too_many_gains_is_refused_with_what_would_help() -> None:
    row = [-90.0] * 501
    with pytest.raises(ValidationError, match=rf"are 251001 gains; at most are {MAX_GAINS}: use fewer receivers"):
        channel_of({**SMALL, "receivers_m": [(0.0, 0.0)], "levels_m": [60.0], "gains_db": [[[row] * 501]]})


def test_a_map_has_to_cover_area_and_altitudes() -> None:
    scenario = scattered(2, 2, 3, seed=1)
    with pytest.raises(ValidationError, match=r"channel\.gains_db: places from \(0.0, 0.0\) to \(40.0, 40.0\) m must"):
        scenario.with_changes(channel=channel_of(SMALL))
    with pytest.raises(ValidationError, match=r"channel\.kind: .* 70 to 80 m, not for 60 to 60 m of uavs\.0"):
        scenario.with_changes(channel=channel_of(shadowed(70.0, 80.0)))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31))
def test_no_place_within_reach_has_a_gain_outside_of_its_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plain = scattered(3, 5, 6, seed=seed % 97)
    spacing_m = float(rng.choice([9.0, 25.0, 140.0]))
    problem = problem_of(plain.with_changes(channel=shadow_map(plain, spacing_m=spacing_m, seed=seed)))
    assert problem.excess is not None
    slots = np.arange(problem.n_slots)
    low, high = reachable_boxes(problem, slots)
    most, least = problem.excess.range_in(low, high, slots)
    for share in rng.random((20, *low.shape)):
        factors = problem.excess.on_paths(low + share * (high - low))
        assert (factors <= most).all()
        assert (factors >= least).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_no_pair_has_more_than_its_optimistic_rate(seed: int) -> None:
    plain = scattered(3, 5, 6, seed=seed % 97)
    problem = problem_of(plain.with_changes(channel=shadow_map(plain, seed=seed, noise_dbm=-55.0)))
    rng = np.random.default_rng(seed)
    steps = np.linspace(0, 1, problem.n_slots)[:, None] * rng.normal(size=(3, 1, 2)) * 120
    paths = within_limits(problem, problem.hover() + steps)
    rates = problem.bandwidth_hz[:, None, None] / 1e3 * spectral_efficiency(problem, paths)
    assert (rates <= optimistic_rates_kbps(problem) * (1 + 1e-9)).all()


def with_a_window(at: tuple[int, int]) -> GainMap:
    """Return a map of one receiver at (250, 250) that is 25 dB better at one place of a grid of 50 m."""
    gains = [[-20.0 - loss_db(50.0 * c - 250.0, 50.0 * r - 250.0, 60.0) for c in range(11)] for r in range(11)]
    gains[at[1]][at[0]] += 25.0
    made = channel_of({
        "kind": "map", "receivers_m": [(250.0, 250.0)], "levels_m": [60.0], "south_west_m": (0.0, 0.0),
        "spacing_m": 50.0, "gains_db": [[gains]], "noise_dbm": -55.0,
    })  # fmt: skip
    assert isinstance(made, GainMap)
    return made


def test_a_uav_hovers_where_the_map_is_best_and_not_over_its_user() -> None:
    plain = scattered(4, 1, 30, seed=2)
    user = plain.users[0].model_copy(update={"position_m": (250.0, 250.0)})
    alone = plain.with_changes(uavs=plain.uavs[:1], users=(user,), channel=with_a_window((6, 4)))
    made = plan(alone)
    assert math.dist(made.trajectories_m[alone.uavs[0].id][-1], (300.0, 200.0)) < 5.0


def over_ground(**changes: Any) -> Scenario:
    plain = scattered(4, 5, 6, seed=4)
    return plain.with_changes(**{"channel": channel_of(shadowed(40.0, 70.0, 160.0, noise_dbm=-55.0)), **changes})


@pytest.mark.parametrize("terrain", [False, True])
def test_altitudes_are_planned_with_what_the_map_says_up_there(terrain: bool) -> None:
    ground = {"terrain": hill(40.0)} if terrain else {}
    made = plan(over_ground(altitude_min_m=45.0, altitude_max_m=70.0, **ground), n_starts=2)
    assert violations(made) == []
    assert made.summary.utility_bps <= made.summary.upper_bound_bps
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    slots = np.arange(made.scenario.slots)
    got = delivered_rates_bps(made, slots, paths.transpose(1, 0, 2), np.ones((len(slots), len(paths)), dtype=bool))
    planned = np.array([made.user_rates_bps[user] for user in made.scenario.user_ids])
    assert planned == pytest.approx(got.T, rel=1e-6, abs=1e-3)


def test_a_bound_over_ground_counts_the_best_that_the_map_says() -> None:
    scenario = over_ground(altitude_min_m=45.0, altitude_max_m=70.0)
    ground = ground_of(scenario)
    assert ground is not None
    assert bound_over_kbps(problem_of(scenario), ground) * 1e3 >= plan(scenario, n_starts=4).summary.utility_bps


def test_what_is_learned_in_flight_is_by_how_much_a_link_differs_from_the_map() -> None:
    scenario = over_ground(users=scattered(4, 5, 6, seed=4).users[:1])
    uav, user = scenario.uavs[0], scenario.users[0]
    at_m = uav.start_m
    snr = uav.transmit_power_w * 10 ** (gain_db(scenario.channel, user.position_m, at_m, 60.0) / 10.0) / 10**-8.5
    seen = [
        Observation(
            user_id=user.id, uav_id=uav.id, sinr_db=10.0 * math.log10(snr) - 7.0, slot=n, positions_m={uav.id: at_m}
        )
        for n in range(8)
    ]
    learned = learned_corrections_db(scenario, seen)
    assert learned[uav.id][user.id] == pytest.approx(-7.0, abs=1.0)
