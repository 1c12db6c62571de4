"""Fields: whatever their sources, nothing that a fleet can do in the slot is better than their answer."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import plan
from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import best_tables
from skyfolio.planner.crowding import bound
from skyfolio.planner.crowding.bound import crowded_slot_bounds_kbps, first_field, stretches_of
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import sharpened
from skyfolio.planner.crowding.repulsion import Repulsion
from skyfolio.planner.crowding.slots import Ground, Slot, everywhere, ground_of, slot_of
from skyfolio.planner.crowding.standard import far_apart, standard_repulsion
from skyfolio.planner.layouts import laid_out, scattered
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.reach import squared_distance_range
from skyfolio.planner.remainder import remaining
from skyfolio.planner.sinr import spectral_efficiency


def problem_with(seed: int, n_uavs: int, n_users: int, *, sampled: bool) -> Problem:
    scenario = scattered(n_uavs, n_users, 5, seed=seed)
    first = scenario.uavs[0].model_copy(update={"altitude_m": 35.0, "transmit_power_w": 0.3, "bandwidth_hz": 15_000.0})
    fading = "sampled" if sampled else "mean"
    channel = scenario.channel.model_copy(update={"fading": fading, "noise_dbm": -62.0})
    return problem_of(scenario.with_changes(uavs=(first, *scenario.uavs[1:]), channel=channel))


def slot_at(problem: Problem, n: int, weights: Array | None = None) -> tuple[Ground, Slot]:
    near2, far2 = squared_distance_range(problem)
    ground = ground_of(problem)
    return ground, slot_of(problem, ground, n, near2[:, :, n], far2[:, :, n], weights)


def standard(ground: Ground, slot: Slot) -> Repulsion:
    apart = far_apart(ground.user, min(slot.n_uavs, len(ground.user)))
    return standard_repulsion(ground, float(np.median(slot.links.power)), apart)


def best_kbps(problem: Problem, n: int, at_m: Array, weights: Array) -> float:
    """The greatest weighted sum rate in slot n with the UAVs at (U, 2), in metres."""
    paths = np.repeat(at_m[:, None], problem.n_slots, axis=1)
    pair = problem.bandwidth_hz[:, None] * spectral_efficiency(problem, paths)[:, :, n] / 1e3
    rates = best_tables(pair[:, :, None])(weights[:, None])[:, 0]
    return float(weights @ rates)


def places(problem: Problem, n: int, rng: np.random.Generator) -> Array:
    """Random positions (U, 2) within reach of slot n; often as near to a user as it goes."""
    wanted = rng.uniform(problem.low_m, problem.high_m, (problem.n_uavs, 2))
    over = problem.mean_user_m[rng.integers(0, problem.n_users, problem.n_uavs)]
    wanted = np.where(rng.random((problem.n_uavs, 1)) < 0.7, over, wanted) - problem.start_m
    away = np.linalg.norm(wanted, axis=1, keepdims=True)
    reached: Array = problem.start_m + wanted * np.minimum(1.0, problem.step_m[:, None] * n / np.maximum(away, 1e-9))
    return reached


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(2, 7), st.integers(2, 20), st.booleans(), st.booleans())
def test_any_field_bounds_what_any_fleet_can_do(
    seed: int, n_uavs: int, n_users: int, sampled: bool, weighted: bool
) -> None:
    rng = np.random.default_rng(seed)
    problem, n = problem_with(seed % 1000, n_uavs, n_users, sampled=sampled), int(rng.integers(0, 5))
    weights = rng.exponential(size=n_users) if weighted else np.ones(n_users)
    ground, slot = slot_at(problem, n, weights)
    mass = rng.exponential(size=n_users) * rng.integers(0, 2, n_users) * 10 ** rng.uniform(-1, 1)
    field = Field(ground, standard(ground, slot), mass)
    proven = field.answer(slot).bound
    if not weighted:
        proven = min(proven, field.answer(everywhere(problem, ground, n)).bound)
    for _ in range(4):
        assert best_kbps(problem, n, places(problem, n, rng), weights) <= proven + 1e-9


@settings(max_examples=10)
@given(st.integers(0, 2**31), st.integers(2, 6), st.booleans())
def test_steps_and_other_kappas_prove_more_and_nothing_wrong(seed: int, n_uavs: int, sampled: bool) -> None:
    rng = np.random.default_rng(seed)
    problem = problem_with(seed % 1000, n_uavs, 12, sampled=sampled)
    ground, slot = slot_at(problem, 3)
    field = first_field(ground, slot, None)
    at_once = field.answer(slot).bound
    least, best = sharpened(field, slot, 3, 10)
    assert least <= at_once
    assert best.answer(slot).bound >= least * 0.9
    for _ in range(10):
        assert best_kbps(problem, 3, places(problem, 3, rng), np.ones(12)) <= least + 1e-9


def test_every_placement_on_a_grid_is_below_the_bound_of_a_small_fleet() -> None:
    scenario = scattered(4, 5, 3, seed=8)
    problem = problem_of(scenario.with_changes(channel=scenario.channel.model_copy(update={"noise_dbm": -65.0})))
    ground, slot = slot_at(problem, 2)
    least, _ = sharpened(first_field(ground, slot, None), slot, 6, 20)
    steps = [np.array(one) * 50.0 / 2**0.5 for one in product((-1, 0, 1), repeat=2)]
    best = max(
        best_kbps(problem, 2, problem.start_m + np.array(moves), np.ones(5)) for moves in product(steps, repeat=4)
    )
    assert best <= least
    assert least < 1.35 * best


def test_what_a_uav_can_reach_by_then_lowers_the_bound() -> None:
    problem = problem_of(scattered(9, 60, 40, seed=3))
    ground, late = slot_at(problem, 39)
    _, early = slot_at(problem, 2)
    free = first_field(ground, late, None).improve(everywhere(problem, ground, 39), 20)
    assert first_field(ground, late, None).improve(late, 20) <= free * 1.002
    assert first_field(ground, early, None).improve(early, 20) < 0.9 * free


@pytest.mark.parametrize(("layout", "gap"), [("corridor", 0.29), ("stadium", 0.20), ("clustered", 0.16)])
def test_fleets_over_users_along_a_line_or_in_groups_are_bounded_closely_too(layout: str, gap: float) -> None:
    summary = plan(laid_out(layout, 10, 100, 50, seed=1)).summary
    assert 1.0 < summary.upper_bound_bps / summary.utility_bps < 1.0 + gap


def test_slots_are_bounded_in_stretches_of_the_same_uavs() -> None:
    scenario = scattered(5, 9, 8, seed=1)
    leaving = scenario.uavs[0].model_copy(update={"leaves_at_slot": 3})
    problem = problem_of(scenario.with_changes(uavs=(leaving, *scenario.uavs[1:])))
    assert [(one.first, one.end) for one in stretches_of(problem, ground_of(problem))] == [(0, 3), (3, 8)]
    bounds = crowded_slot_bounds_kbps(problem)
    assert (np.diff(bounds[:3]) >= 0).all()
    assert (np.diff(bounds[3:]) >= 0).all()
    assert np.isfinite(bounds).all()


@pytest.mark.parametrize("n_uavs", [1, 2])
def test_who_is_alone_in_the_air_is_left_to_the_reachability_bound(n_uavs: int) -> None:
    problem = problem_of(scattered(2, 4, 3, seed=0))
    gone = replace(problem, n_flying=np.array([3, 1 if n_uavs == 1 else 3]))
    assert np.isfinite(crowded_slot_bounds_kbps(gone)[1:]).all() == (n_uavs == 2)


def test_a_replan_is_bounded_with_fewer_looks_and_as_truly(monkeypatch: pytest.MonkeyPatch) -> None:
    made = plan(scattered(6, 20, 12, seed=4))
    rest, past = remaining(made, [made.scenario.uav_ids[-1]], 4)
    problem = problem_of(rest, past)
    quick = crowded_slot_bounds_kbps(problem)
    monkeypatch.setattr(bound, "OF_A_REPLAN", bound.OF_A_PLAN)
    thorough = crowded_slot_bounds_kbps(problem)
    assert len(np.unique(quick)) == 1 < len(np.unique(thorough))
    rng = np.random.default_rng(1)
    for n in range(problem.n_slots):
        found = max(best_kbps(problem, n, places(problem, n, rng), np.ones(problem.n_users)) for _ in range(50))
        assert found <= min(quick[n], thorough[n])
