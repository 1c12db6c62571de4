"""The certificate: no feasible plan is better than its bound, and where a bound is known by hand it is met."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES
from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import best_tables, lifted_kbps, reachability_bound_kbps, slot_bounds_kbps, upper_bound_kbps
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.certificate import prove
from skyfolio.planner.fast import optimise, served_rates_bps
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.reach import squared_distance_range
from skyfolio.planner.repair import within_limits
from skyfolio.planner.scenario import NoFlyDisc
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.stopping import MaxIterations
from skyfolio.planner.utility import utility_kbps

pytestmark = pytest.mark.long

KINDS = ("sum", "per_user", "pooled")


def random_problem(seed: int, n_uavs: int) -> Problem:
    """Any utility, with a past, own altitudes, an end position, a UAV that leaves, and sampled fading."""
    rng = np.random.default_rng(seed)
    scenario = scattered(n_uavs, int(rng.integers(1, 6)), 4, seed=seed % 1000)
    first = scenario.uavs[0].model_copy(
        update={"end_m": tuple(np.add(scenario.uavs[0].start_m, rng.uniform(-20, 20, 2)).tolist()), "altitude_m": 30.0}
    )
    rest = [scenario.uavs[-1].model_copy(update={"leaves_at_slot": int(rng.integers(1, 5))})] if n_uavs > 1 else []
    scenario = scenario.with_changes(
        uavs=(first, *scenario.uavs[1:-1], *rest),
        channel=scenario.channel.model_copy(update={"fading": "sampled"}),
    )
    problem = problem_of(scenario)
    past = rng.uniform(0, 20, (problem.n_users, int(rng.integers(0, 3))))
    past[-1, : int(rng.integers(0, past.shape[1] + 1)) if problem.n_users > 1 else 0] = np.nan  # a user that came later
    mu = float(-(10 ** rng.uniform(-3, 1)) * rng.integers(0, 2))
    gain = problem.snr_gain * 10 ** rng.uniform(-2, 3)
    return replace(problem, kind=KINDS[seed % 3], mu=mu, past_kbps=past, snr_gain=gain)


def fleet_problem(seed: int, n_uavs: int, *, sampled: bool) -> Problem:
    """As `random_problem`; else with the mean channel, and powers, bandwidths and altitudes of their own."""
    problem = random_problem(seed, n_uavs)
    if sampled:
        return problem
    rng = np.random.default_rng(seed)
    own = problem.snr_gain.mean() * 10 ** rng.uniform(-1, 1, (n_uavs, 1)) * problem.flying
    alike = np.broadcast_to(own[:, None, :], problem.snr_gain.shape)
    altitude, bandwidth = rng.uniform(20.0, 100.0, n_uavs), rng.uniform(5e3, 2e4, n_uavs)
    return replace(problem, snr_gain=alike, altitude_m=altitude, bandwidth_hz=bandwidth)


def random_rates(problem: Problem, seed: int) -> tuple[Array, Array]:
    """Paths (U, N, 2) within speed, area and ends, and rates (K, N) of a random binary association."""
    rng = np.random.default_rng(seed)
    straight = problem.hover()
    fraction = np.linspace(0, 1, problem.n_slots)[:, None]
    ends = np.where(np.isnan(problem.end_m), problem.start_m + rng.normal(size=(problem.n_uavs, 2)) * 60, problem.end_m)
    paths = within_limits(problem, straight + fraction * (ends - problem.start_m)[:, None])
    shape = (problem.n_users, problem.n_slots)
    serving = np.argmax(rng.random((problem.n_uavs, *shape)) * problem.flying[:, None], axis=0)
    mine = np.moveaxis(np.eye(problem.n_uavs)[serving], 2, 0)
    share = mine * rng.exponential(size=shape) ** 4
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-9)
    rates = problem.bandwidth_hz[:, None, None] * share * spectral_efficiency(problem, paths) / 1e3
    return paths, rates.sum(axis=0)


def worth(problem: Problem, rates: Array) -> float:
    return utility_kbps(problem.counted_kbps(rates), problem.kind, problem.mu)


@given(st.integers(0, 2**31), st.integers(1, 4))
def test_no_feasible_plan_is_better_than_the_bound(seed: int, n_uavs: int) -> None:
    problem = random_problem(seed, n_uavs)
    bound = reachability_bound_kbps(problem)
    for attempt in range(3):
        paths, rates = random_rates(problem, seed + attempt)
        assert (rates.sum(axis=0) <= slot_bounds_kbps(problem) + 1e-9).all()
        assert worth(problem, rates) <= bound + 1e-9
        there_kbps = problem.bandwidth_hz[:, None, None] * spectral_efficiency(problem, paths) / 1e3
        best = best_tables(there_kbps)(np.ones(rates.shape))
        assert (best.sum(axis=0) <= slot_bounds_kbps(problem) + 1e-9).all()
        assert worth(problem, best) <= bound + 1e-9
        near2, far2 = squared_distance_range(problem)
        d2 = problem.distances2(paths)
        there = np.broadcast_to(problem.flying[:, None], d2.shape)
        assert ((near2 <= d2 * (1 + 1e-9)) & (d2 <= far2 * (1 + 1e-9)))[there].all()


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.integers(4, 8), st.booleans())
def test_no_feasible_plan_of_a_fleet_is_better_than_what_every_plan_is_told(
    seed: int, n_uavs: int, sampled: bool
) -> None:
    problem = fleet_problem(seed, n_uavs, sampled=sampled)
    for attempt in range(3):
        paths, rates = random_rates(problem, seed + attempt)
        bound = upper_bound_kbps(problem, rates if attempt else None)
        assert worth(problem, rates) <= bound + 1e-9
        there_kbps = problem.bandwidth_hz[:, None, None] * spectral_efficiency(problem, paths) / 1e3
        assert worth(problem, best_tables(there_kbps)(np.ones(rates.shape))) <= bound + 1e-9


@settings(max_examples=8)
@given(st.integers(0, 2**31), st.integers(4, 6), st.booleans())
def test_no_feasible_plan_of_a_fleet_is_better_than_what_is_proven_offline(
    seed: int, n_uavs: int, sampled: bool
) -> None:
    problem = fleet_problem(seed, n_uavs, sampled=sampled)
    _, rates = random_rates(problem, seed)
    asked, told = iter(range(10**6)), list[float]()
    proof = prove(problem, rates, stop=lambda: next(asked) > 6, told=told.append)
    assert proof.bound_kbps <= proof.root_kbps
    assert told == sorted(told, reverse=True)
    assert proof.bound_kbps <= told[-1] + 1e-9
    for attempt in range(3):
        paths, rates = random_rates(problem, seed + attempt)
        assert worth(problem, rates) <= proof.bound_kbps + 1e-9
        there_kbps = problem.bandwidth_hz[:, None, None] * spectral_efficiency(problem, paths) / 1e3
        assert worth(problem, best_tables(there_kbps)(np.ones(rates.shape))) <= proof.bound_kbps + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_more_time_never_proves_less(kind: str) -> None:
    problem = replace(problem_of(scattered(5, 8, 4, seed=2)), kind=kind, mu=-0.05)
    rates = np.full((8, 4), 5.0)

    def proven(patience: int) -> float:
        asked = iter(range(10**6))
        return prove(problem, rates, stop=lambda: next(asked) >= patience).bound_kbps

    bounds = [proven(patience) for patience in (0, 2, 5, 12, 40)]
    assert bounds == sorted(bounds, reverse=True)
    assert kind != "sum" or bounds[-1] < bounds[0] * 0.9995


SLOT_1 = np.arange(4) == 1
BEYOND_THE_LETTER: dict[str, dict[str, Any]] = {
    "weights": {"weight": np.array([0.5, 3.0] * 4)},
    "windows": {"absent": np.arange(4) < np.arange(8)[:, None] % 4},
    "nobody there in a slot": {"absent": np.repeat(SLOT_1[None], 8, axis=0)},
    "demands of some": {"demand_kbps": np.array([4.0, np.inf] * 4)},
    "windows, and demands of some": {
        "absent": np.arange(4) < np.arange(8)[:, None] % 4,
        "demand_kbps": np.array([4.0, np.inf] * 4),
    },
    "demands that are met": {"demand_kbps": np.full(8, 0.01)},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", BEYOND_THE_LETTER)
def test_what_is_proven_offline_holds_for_users_beyond_the_letter(name: str, kind: str) -> None:
    plain = replace(problem_of(scattered(5, 8, 4, seed=2)), kind=kind, mu=-0.05)
    problem = replace(plain, **BEYOND_THE_LETTER[name])
    made = optimise(problem, MaxIterations(20), n_starts=2)
    rates = served_rates_bps(problem, made) / 1e3
    asked = iter(range(10**6))
    proof = prove(problem, rates, stop=lambda: next(asked) > 12)
    assert problem.utility_kbps(rates) <= proof.bound_kbps * (1.0 + 1e-9)
    assert proof.bound_kbps <= proof.root_kbps


def test_the_interference_that_a_fleet_cannot_escape_lowers_its_bound_by_a_quarter() -> None:
    scenario = scattered(10, 100, 50, seed=1)
    problem = problem_of(scenario.with_changes(channel=scenario.channel.model_copy(update={"noise_dbm": -60.0})))
    assert upper_bound_kbps(problem) < 0.75 * reachability_bound_kbps(problem)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 3))
def test_no_feasible_plan_is_better_than_the_bound_after_branching(seed: int, n_uavs: int) -> None:
    problem = random_problem(seed, n_uavs)
    _, rates = random_rates(problem, seed)
    proof = certificate(problem, rates, max_nodes=3_000)
    assert proof.bound_kbps <= proof.root_kbps
    assert (proof.slot_best_kbps <= proof.slot_bounds_kbps + 1e-9).all()
    for attempt in range(3):
        paths, rates = random_rates(problem, seed + attempt)
        assert worth(problem, rates) <= proof.bound_kbps + 1e-9
        there_kbps = problem.bandwidth_hz[:, None, None] * spectral_efficiency(problem, paths) / 1e3
        assert worth(problem, best_tables(there_kbps)(np.ones(rates.shape))) <= proof.bound_kbps + 1e-9


def test_one_uav_and_one_user_are_bounded_by_flying_straight_towards_it() -> None:
    scenario = scattered(1, 1, 6, seed=0)
    scenario = scenario.with_changes(users=(scenario.users[0].model_copy(update={"position_m": (225.0, 125.0)}),))
    problem = problem_of(scenario)
    distance = np.maximum(100.0 - 25.0 * np.arange(6), 0.0)
    gain = 0.1 * 0.01 / 10**-8.5
    exact = 10 * np.log2(1 + gain / (distance**2 + 60.0**2))
    assert slot_bounds_kbps(problem) == pytest.approx(exact, rel=1e-12)
    assert reachability_bound_kbps(problem) == pytest.approx(exact.mean(), rel=1e-12)
    proof = certificate(problem, np.zeros((1, 6)), tolerance=1e-3)
    assert proof.finished
    assert proof.slot_best_kbps == pytest.approx(exact, rel=2e-3)


def test_uavs_that_cannot_move_are_bounded_by_what_they_reach(problem_by_hand: Callable[..., Problem]) -> None:
    for kind in KINDS:
        assert reachability_bound_kbps(problem_by_hand(kind=kind, mu=-0.2)) == pytest.approx(60.0, rel=1e-9)


def test_at_paper_scale_branch_and_bound_proves_sum_within_5_percent() -> None:
    problem = problem_of(EXAMPLES["paper"]())
    proof = certificate(problem, np.zeros((9, 20)), tolerance=0.03)
    best = lifted_kbps(problem, proof.slot_best_kbps)
    assert proof.finished
    assert proof.bound_kbps < proof.root_kbps < 1.25 * best
    assert proof.bound_kbps < 1.04 * best


def test_what_cannot_be_reached_before_an_end_position_or_inside_a_zone_lowers_the_bound() -> None:
    scenario = scattered(1, 1, 6, seed=0)
    scenario = scenario.with_changes(users=(scenario.users[0].model_copy(update={"position_m": (225.0, 125.0)}),))
    returning = (scenario.uavs[0].model_copy(update={"end_m": (125.0, 125.0)}),)
    homing = slot_bounds_kbps(problem_of(scenario.with_changes(uavs=returning)))
    free = slot_bounds_kbps(problem_of(scenario))
    assert homing[:3] == pytest.approx(free[:3])
    assert homing[3:] == pytest.approx(free[2::-1])
    fenced = scenario.with_changes(no_fly=(NoFlyDisc(center_m=(225.0, 125.0), radius_m=60.0),))
    proof = certificate(problem_of(fenced), np.zeros((1, 6)), tolerance=0.01)
    assert proof.slot_bounds_kbps[5] == pytest.approx(10 * np.log2(1 + 0.001 / 10**-8.5 / (2 * 60.0**2)), rel=0.03)


def test_branch_and_bound_stops_when_told_and_the_bound_holds_nevertheless() -> None:
    problem = problem_of(EXAMPLES["paper"]())
    proof = certificate(problem, np.zeros((9, 20)), stop=lambda: True)
    assert proof.nodes == 0
    assert not proof.finished
    assert proof.bound_kbps <= proof.root_kbps


def test_branch_and_bound_refuses_more_than_three_uavs() -> None:
    problem = problem_of(scattered(4, 2, 2, seed=0))
    with pytest.raises(ValueError, match="uavs: branch and bound takes at most 3 UAVs, not 4"):
        certificate(problem, np.zeros((2, 2)))
