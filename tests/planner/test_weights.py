"""Users that count more than others: as so many users who get the same rate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.optimize import linear_sum_assignment

from skyfolio.planner import Scenario, User, Utility, plan, replan, violations
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.examples import minimal
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.utility import utility_kbps

KINDS = ("sum", "per_user", "pooled")


def weighted(seed: int, n_uavs: int, n_users: int, n_slots: int, kind: str = "sum", mu: float = -0.1) -> Scenario:
    """Return users with weights from 0.2 to 5."""
    rng = np.random.default_rng(seed)
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    plain = scattered(n_uavs, n_users, n_slots, seed=seed % 1000, utility=utility)
    weights = 5.0 ** rng.uniform(-1, 1, n_users)
    return plain.with_changes(
        users=tuple(
            user.model_copy(update={"weight": weight})
            for user, weight in zip(plain.users, weights.tolist(), strict=True)
        )
    )


@given(st.integers(0, 2**31), st.sampled_from(KINDS), st.sampled_from([0.0, -1e-3, -0.1, -3.0]))
def test_a_user_of_weight_three_is_three_users_who_get_its_rate(seed: int, kind: str, mu: float) -> None:
    rng = np.random.default_rng(seed)
    rates = rng.uniform(0, 50, (3, 5))
    rates[rng.random(rates.shape) < 0.2] = np.nan
    rates[:, 0] = 1.0  # everybody is there at least once
    times = np.array([1, 3, 2])
    assert utility_kbps(rates, kind, mu, times.astype(float)) == pytest.approx(
        utility_kbps(np.repeat(rates, times, axis=0), kind, mu), rel=1e-9
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("n_uavs", "n_users"), [(2, 5), (3, 2), (3, 40)])
def test_what_the_kernels_count_is_what_is_reported(kind: str, n_uavs: int, n_users: int) -> None:
    made = plan(weighted(7, n_uavs, n_users, 6, kind), n_starts=2)
    assert violations(made) == []
    weights = np.array([user.weight for user in made.scenario.users])
    rates = np.array(list(made.user_rates_bps.values())) / 1e3
    assert made.summary.utility_bps == pytest.approx(utility_kbps(rates, kind, -0.1, weights) * 1e3, rel=1e-9)
    assert made.history[-1].utility_bps == pytest.approx(made.summary.utility_bps, rel=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 4), st.integers(1, 6))
def test_sum_gives_each_slot_the_best_weighted_assignment(seed: int, n_uavs: int, n_users: int) -> None:
    made = plan(weighted(seed, n_uavs, n_users, 3), method="static")
    problem = problem_of(made.scenario)
    paths = np.array(list(made.trajectories_m.values()))
    worth = spectral_efficiency(problem, paths) * problem.bandwidth_hz[:, None, None] * problem.weight[:, None]
    rates = np.array(list(made.user_rates_bps.values()))
    for n in range(3):
        best = worth[:, :, n][linear_sum_assignment(worth[:, :, n], maximize=True)].sum()
        assert problem.weight @ rates[:, n] == pytest.approx(best, rel=1e-9)


def test_weights_of_one_change_no_bit_of_a_plan() -> None:
    scenario = minimal()
    ones = scenario.with_changes(users=tuple(user.model_copy(update={"weight": 1.0}) for user in scenario.users))
    assert plan(ones).trajectories_m == plan(scenario).trajectories_m
    assert plan(ones).summary == plan(scenario).summary


@pytest.mark.parametrize("kind", KINDS)
def test_who_counts_more_gets_more(kind: str) -> None:
    scenario = minimal().with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": -0.1}))
    heavy = scenario.users[0].model_copy(update={"weight": 10.0})
    with_weight, without = plan(scenario.with_changes(users=(heavy, *scenario.users[1:]))), plan(scenario)
    assert np.mean(with_weight.user_rates_bps["user-1"]) > 1.02 * np.mean(without.user_rates_bps["user-1"])


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from(KINDS), st.integers(1, 6))
def test_no_plan_is_better_than_its_bound(seed: int, kind: str, n_uavs: int) -> None:
    made = plan(weighted(seed, n_uavs, 6, 4, kind), n_starts=2)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_branch_and_bound_proves_at_least_what_is_planned(kind: str) -> None:
    made = plan(weighted(5, 2, 4, 4, kind))
    rates = np.array(list(made.user_rates_bps.values())) / 1e3
    proof = certificate(problem_of(made.scenario), rates, tolerance=0.01, max_nodes=100_000)
    assert made.summary.utility_bps / 1e3 <= proof.bound_kbps * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("price", [0.0, 3.0])
def test_replans_keep_the_weights(kind: str, price: float) -> None:
    first = plan(weighted(7, 3, 5, 8, kind))
    second = replan(first, failed=["uav-3"], at_slot=3, disruption_weight=price)
    before = np.array([row[:3] for row in first.user_rates_bps.values()])
    rates = np.hstack([before, np.array(list(second.user_rates_bps.values()))]) / 1e3
    weights = np.array([user.weight for user in second.scenario.users])
    assert second.summary.utility_bps == pytest.approx(utility_kbps(rates, kind, -0.1, weights) * 1e3, rel=1e-9)


@pytest.mark.parametrize("weight", [0.0, -1.0, float("inf")])
def test_a_weight_is_a_positive_number(weight: Any) -> None:
    with pytest.raises(ValidationError, match="weight"):
        User(id="u", position_m=(0.0, 0.0), weight=weight)
