"""Users that move, and users whose place is not quite known: where they are, and what plans make of it."""

from __future__ import annotations

from itertools import pairwise
from math import dist, log2
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from pydantic import ValidationError

from skyfolio.planner import (
    Changes,
    Channel,
    Disturbances,
    Losses,
    Plan,
    ReplanError,
    Scenario,
    Trial,
    User,
    Utility,
    assess,
    delivered_rates_bps,
    explain,
    plan,
    replan,
    violations,
)
from skyfolio.planner.arrays import Array
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.examples import minimal
from skyfolio.planner.fast.arena import Arena, Links, arena_of, links_of
from skyfolio.planner.fast.climb import climb
from skyfolio.planner.fast.rates import gradient, link_rates, value
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of

KINDS = ("sum", "per_user", "pooled")


def walking(seed: int, n_uavs: int, n_users: int, n_slots: int, kind: str = "sum", mu: float = -0.1) -> Scenario:
    """Return users of all sorts: on tracks, with a velocity and growing uncertainty, uncertain in place, and still."""
    rng = np.random.default_rng(seed)
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    still = scattered(n_uavs, n_users, n_slots, seed=seed % 1000, utility=utility)

    def moving(k: int, user: User) -> User:
        steps = rng.uniform(-20, 20, (n_slots - 1, 2)).cumsum(axis=0)
        track = [user.position_m, *((user.position_m[0] + e, user.position_m[1] + n) for e, n in steps.tolist())]
        sorts: list[dict[str, Any]] = [
            {"positions_m": tuple(track)},
            {"velocity_mps": (3.0, -2.0), "uncertainty_m": 5.0, "uncertainty_mps": 1.0},
            {"uncertainty_m": 40.0},
            {},
        ]
        return User(id=user.id, position_m=user.position_m, **sorts[k % 4])

    return still.with_changes(users=tuple(moving(k, user) for k, user in enumerate(still.users)))


def rates_by_hand(made: Plan) -> dict[str, list[float]]:
    """Return what eqs. (1)-(4) give each user, written out, from the emitted plan alone."""
    scenario, channel = made.scenario, made.scenario.channel
    assert isinstance(channel, Channel)
    assert channel.noise_dbm is not None
    noise_w = 10 ** (channel.noise_dbm / 10 - 3)
    gain = 10 ** (channel.reference_gain_db / 10)
    rates: dict[str, list[float]] = {}
    for user in scenario.users:
        rates[user.id] = []
        for n in range(scenario.slots):
            place, radius = user.place_m(n, scenario.slot_duration_s), user.radius_m(n, scenario.slot_duration_s)
            heard = {
                uav.id: uav.transmit_power_w
                * gain
                / noise_w
                / (dist(made.trajectories_m[uav.id][n], place) ** 2 + scenario.altitude_of(uav) ** 2 + radius**2 / 2)
                for uav in scenario.uavs
            }
            own = heard.pop(made.association[user.id][n])
            rates[user.id].append(made.bandwidth_hz[user.id][n] * log2(1 + own / (1 + sum(heard.values()))))
    return rates


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("n_uavs", "n_users"), [(2, 5), (3, 40)])
def test_rates_are_those_at_the_place_where_a_user_is_in_each_slot(kind: str, n_uavs: int, n_users: int) -> None:
    made = plan(walking(3, n_uavs, n_users, 6, kind), n_starts=2)
    assert violations(made) == []
    by_hand = rates_by_hand(made)
    for user, row in made.user_rates_bps.items():
        assert row == pytest.approx(by_hand[user], rel=1e-9)


def test_a_uav_keeps_over_the_user_that_it_follows() -> None:
    scenario = minimal()
    walker = User(id="walker", position_m=(50.0, 50.0), velocity_mps=(4.0, 0.0))
    made = plan(scenario.with_changes(users=(walker,), uavs=scenario.uavs[:1], slots=8))
    away = [dist(at, walker.place_m(n, 5.0)) for n, at in enumerate(made.trajectories_m["uav-1"])]
    assert max(away) < 0.5


def test_a_user_on_a_track_is_met_where_it_is_going_and_not_where_it_was() -> None:
    scenario = minimal().with_changes(slots=8)
    [uav] = scenario.uavs[:1]
    there = tuple((50.0 + 18.0 * min(n, 7), 50.0) for n in range(8))
    follows, stays = (
        plan(scenario.with_changes(users=(user,), uavs=(uav,)))
        for user in (User(id="u", position_m=there[0], positions_m=there), User(id="u", position_m=there[0]))
    )
    assert follows.trajectories_m["uav-1"][-1][0] > 150.0
    assert stays.trajectories_m["uav-1"][-1][0] == pytest.approx(50.0, abs=0.5)


def test_a_track_that_stays_changes_no_bit_of_a_plan() -> None:
    scenario = minimal()
    staying = tuple(
        User(id=user.id, position_m=user.position_m, positions_m=(user.position_m,) * scenario.slots)
        for user in scenario.users
    )
    for users in (staying, tuple(User(id=u.id, position_m=u.position_m, uncertainty_m=0.0) for u in scenario.users)):
        with_fields, without = plan(scenario.with_changes(users=users)), plan(scenario)
        assert with_fields.trajectories_m == without.trajectories_m
        assert with_fields.bandwidth_hz == without.bandwidth_hz
        assert with_fields.summary == without.summary


def test_a_scenario_without_these_fields_is_written_as_before() -> None:
    assert set(minimal().model_dump(mode="json")["users"][0]) == {"id", "position_m", "min_rate_bps"}


@given(st.floats(0, 300), st.floats(-200, 200), st.floats(-200, 200))
def test_what_is_added_to_squared_distances_is_the_mean_over_the_disc(radius: float, east: float, north: float) -> None:
    user = User(id="u", position_m=(0.0, 0.0), uncertainty_m=radius)
    problem = problem_of(minimal().with_changes(users=(user,)))
    rings, angles = np.sqrt((np.arange(200) + 0.5) / 200), 2 * np.pi * np.arange(24) / 24
    across = radius * rings[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    mean = ((across - (east, north)) ** 2).sum(axis=-1).mean()
    assert east**2 + north**2 + problem.spread_m2[0, 0] == pytest.approx(mean, rel=1e-9, abs=1e-9)


def _value_and_slope(arena: Arena, path: Array, links: Links, slope: Array) -> float:
    rate, weight = np.empty(links.khz.shape), np.empty(links.khz.shape)
    link_rates(arena, path, links, rate)
    worth = value(arena, links, rate, np.bool_(False), weight)
    gradient(arena, path, links, weight, slope)
    return worth


value_and_slope = njit(_value_and_slope)


@pytest.mark.parametrize(
    ("kind", "users", "fading"), [("sum", 5, "sampled"), ("pooled", 40, "mean"), ("per_user", 5, "expected")]
)
def test_the_slope_is_that_of_the_utility_where_users_move(kind: str, users: int, fading: str) -> None:
    scenario = walking(1, 3, users, 4, kind)
    channel = scenario.channel.model_copy(update={"fading": fading, "draws": 3})
    problem = problem_of(scenario.with_changes(channel=channel))
    arena = arena_of(problem)
    path, links = problem.hover().transpose(1, 2, 0).copy(), links_of(arena)
    path += np.random.default_rng(2).normal(0, 9, path.shape)
    climb(arena, path, links, 0, 0.0)
    slope, nothing, h = np.empty(path.shape), np.empty(path.shape), 1e-4
    value_and_slope(arena, path, links, slope)
    for n, axis, u in [(1, 0, 0), (2, 1, 1), (3, 0, 2)]:
        there, back = path.copy(), path.copy()
        there[n, axis, u] += h
        back[n, axis, u] -= h
        by_difference = (
            value_and_slope(arena, there, links, nothing) - value_and_slope(arena, back, links, nothing)
        ) / (2 * h)
        assert slope[n, axis, u] == pytest.approx(by_difference, rel=1e-4, abs=1e-6)


def _flown(problem: Problem, rng: np.random.Generator) -> Array:
    steps = rng.normal(size=(problem.n_uavs, problem.n_slots, 2))
    steps *= (problem.step_m[:, None] * rng.random((problem.n_uavs, problem.n_slots)) / np.linalg.norm(steps, axis=2))[
        ..., None
    ]
    steps[:, 0] = 0.0
    flown: Array = np.clip(problem.start_m[:, None] + steps.cumsum(axis=1), problem.low_m, problem.high_m)
    return flown


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from(KINDS), st.integers(1, 5))
def test_no_plan_is_better_than_its_bound(seed: int, kind: str, n_uavs: int) -> None:
    made = plan(walking(seed, n_uavs, 4, 4, kind), n_starts=2)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps * (1 + 1e-9)


@settings(max_examples=25)
@given(st.integers(0, 2**31))
def test_distances_lie_within_what_reach_allows(seed: int) -> None:
    from skyfolio.planner.reach import squared_distance_range  # noqa: PLC0415

    problem = problem_of(walking(seed, 2, 5, 5))
    near2, far2 = squared_distance_range(problem)
    flown2 = problem.distances2(_flown(problem, np.random.default_rng(seed)))
    assert (near2 <= flown2 * (1 + 1e-9)).all()
    assert (flown2 <= far2 * (1 + 1e-9)).all()
    some = np.array([3, 1])
    assert np.array_equal(squared_distance_range(problem, some)[0], near2[:, :, some])


def test_branch_and_bound_proves_at_least_what_is_planned_for_users_that_move() -> None:
    made = plan(walking(5, 2, 4, 4))
    problem = problem_of(made.scenario)
    rates = np.array(list(made.user_rates_bps.values())) / 1e3
    proof = certificate(problem, rates, tolerance=0.01, max_nodes=200_000)
    assert made.summary.utility_bps / 1e3 <= proof.bound_kbps * (1 + 1e-9)
    assert proof.bound_kbps <= proof.root_kbps


def test_the_letters_algorithm_follows_users_too() -> None:
    scenario = walking(2, 2, 3, 4)
    printed, fast = plan(scenario, method="paper"), plan(scenario)
    assert printed.user_rates_bps["user-1"] == pytest.approx(rates_by_hand(printed)["user-1"], rel=1e-9)
    assert printed.summary.utility_bps == pytest.approx(fast.summary.utility_bps, rel=0.05)


def test_a_replan_takes_users_on_from_where_they_are_by_then() -> None:
    made = plan(walking(3, 2, 4, 6))
    on, drifting = made.scenario.users[:2]
    new = replan(made, failed=["uav-2"], at_slot=2)
    assert new.scenario.users[0].positions_m == (on.positions_m or ())[2:]
    assert new.scenario.users[0].position_m == (on.positions_m or ())[2]
    then = new.scenario.users[1]
    for n in range(4):
        assert then.place_m(n, 5.0) == pytest.approx(drifting.place_m(n + 2, 5.0))
        assert then.radius_m(n, 5.0) == pytest.approx(drifting.radius_m(n + 2, 5.0))
    assert violations(new) == []
    assert new.user_rates_bps["user-1"] == pytest.approx(rates_by_hand(new)["user-1"], rel=1e-9)


def test_who_joins_brings_a_track_for_the_slots_that_are_left() -> None:
    made = plan(walking(3, 2, 4, 6))
    track = ((10.0, 10.0),) * 6
    joins = User(id="late", position_m=(10.0, 10.0), positions_m=track)
    with pytest.raises(ReplanError, match=r"users_joined.*'late' has 6 places, but there are 4 slots"):
        replan(made, at_slot=2, changes=Changes(users_joined=(joins,)))
    fits = joins.model_copy(update={"positions_m": track[:4]})
    assert "late" in replan(made, at_slot=2, changes=Changes(users_joined=(fits,))).user_rates_bps


def test_where_the_fleet_flies_as_planned_users_get_what_was_planned() -> None:
    made = plan(walking(3, 2, 5, 6))
    slots = np.array([4, 0, 4])
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    got = delivered_rates_bps(made, slots, paths[:, slots].transpose(1, 0, 2), np.ones((3, 2), dtype=bool))
    assert got == pytest.approx(np.array(list(made.user_rates_bps.values())).T[slots], rel=1e-9)


def test_reasons_and_robustness_are_told_of_users_that_move() -> None:
    made = plan(walking(3, 2, 5, 6))
    found = explain(made)
    assert [row.user_id for row in found.users] == list(made.scenario.user_ids)
    for row in found.users:
        assert row.mean_rate_bps == pytest.approx(np.mean(made.user_rates_bps[row.user_id]))
    trial = Trial(disturbances=Disturbances(draws=3), losses=Losses(at_once=1))
    assert len(assess(made, trial).users) == 5


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"positions_m": [[0.0, 0.0]] * 3}, r"users\.0\.positions_m: 'u' has 3 places, but there are 4 slots"),
        ({"positions_m": [[0.0, 0.0]] * 4, "velocity_mps": [1.0, 0.0]}, "velocity_mps: .* not both"),
        (
            {"positions_m": [[1.0, 0.0]] * 4, "position_m": [0.0, 0.0]},
            "position_m: .* must be the first of positions_m",
        ),
        ({"position_m": [99_990.0, 0.0], "velocity_mps": [1.0, 0.0]}, r"users\.0\.velocity_mps: 'u' would be 100005 m"),
        ({"position_m": [0.0, 0.0], "uncertainty_m": -1.0}, "uncertainty_m"),
    ],
)
def test_what_is_wrong_with_a_track_is_said_by_field_and_rule(fields: dict[str, Any], message: str) -> None:
    raw = minimal().model_dump(mode="json")
    raw["users"] = [{"id": "u", **fields}]
    with pytest.raises(ValidationError, match=message):
        Scenario.model_validate(raw)


def test_a_track_in_degrees_is_the_same_track() -> None:
    raw = minimal().model_dump(mode="json")
    places = [{"lat": 47.3977 + n * 1e-4, "lon": 8.5456} for n in range(4)]
    raw["users"] = [{"id": "u", "positions_deg": places}]
    [user] = Scenario.model_validate(raw).users
    assert user.positions_m is not None
    assert user.position_m == user.positions_m[0]
    norths = [place[1] for place in user.positions_m]
    assert [b - a for a, b in pairwise(norths)] == pytest.approx([11.12] * 3, rel=1e-3)
