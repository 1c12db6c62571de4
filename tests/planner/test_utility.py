"""The three utilities: limits, expansions, evaluation at any mu, gradients."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skyfolio.planner import EXAMPLES, MaxIterations, Utility
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import optimise, served_rates_bps
from skyfolio.planner.fast.arena import arena_of
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.reference.objective import concave_utility
from skyfolio.planner.utilities import UTILITIES
from skyfolio.planner.utility import jain_index, mean_variance_kbps, soft_mean, utility_kbps

KINDS = ("sum", "per_user", "pooled")
tables = arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 6)), elements=st.floats(0, 200, width=32))
kinds = st.sampled_from(KINDS)
mus = st.floats(-50, 0, allow_subnormal=False)


def paper(kind: str, mu: float, past: int = 0) -> Problem:
    problem = problem_of(EXAMPLES["paper"]())
    rng = np.random.default_rng(1)
    return replace(problem, kind=kind, mu=mu, past_kbps=rng.uniform(0, 30, (problem.n_users, past)))


@given(tables, kinds)
def test_mu_zero_is_the_mean_sum_rate_and_small_mu_approaches_it(rates: Array, kind: str) -> None:
    mean = rates.sum(axis=0).mean()
    assert utility_kbps(rates, kind, 0.0) == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert utility_kbps(rates, kind, -1e-7) == pytest.approx(mean, rel=2e-2, abs=1e-2)


@given(tables, kinds, mus, mus)
def test_a_more_negative_mu_never_gives_more(rates: Array, kind: str, one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert utility_kbps(rates, kind, low) <= utility_kbps(rates, kind, high) + 1e-6


@given(tables, kinds, mus)
def test_the_utility_lies_between_the_worst_case_and_the_mean(rates: Array, kind: str, mu: float) -> None:
    worst = {
        "sum": rates.sum(axis=0).min(),
        "per_user": rates.min(axis=1).sum(),
        "pooled": len(rates) * rates.min(),
    }[kind]
    value = utility_kbps(rates, kind, mu)
    assert worst - 1e-6 <= value <= rates.sum(axis=0).mean() + 1e-6


def test_large_mu_is_the_worst_slot_without_overflow() -> None:
    rates = np.array([[40.0, 60.0, 90.0], [70.0, 40.0, 60.0]])
    assert utility_kbps(rates, "sum", -1e6) == pytest.approx(100.0, abs=1e-4)
    assert utility_kbps(rates, "per_user", -1e6) == pytest.approx(80.0, abs=1e-4)
    assert utility_kbps(rates, "pooled", -1e6) == pytest.approx(80.0, abs=1e-4)
    assert soft_mean(np.array([1e6, 2e6]), -1.0) == pytest.approx(1e6 + np.log(2))


@pytest.mark.parametrize("mu", [-1e-3, -1e-4])
def test_the_expansions_hold_to_second_order(mu: float) -> None:
    rates = np.random.default_rng(3).uniform(0, 40, (4, 8))
    sums = rates.sum(axis=0)
    expansion = {
        "sum": sums.mean() + mu / 2 * sums.var(),
        "per_user": mean_variance_kbps(rates, mu),
        "pooled": len(rates) * (rates.mean() + mu / 2 * rates.var()),
    }
    for kind, value in expansion.items():
        spread = float(sums.std() if kind == "sum" else rates.std())
        assert abs(utility_kbps(rates, kind, mu) - value) <= 4 * len(rates) * mu**2 * spread**3


def test_eq_5_is_not_monotone_in_the_rates_but_the_utilities_are() -> None:
    low, high = np.array([[10.0, 10.0]]), np.array([[10.0, 40.0]])
    assert mean_variance_kbps(high, -0.2) < mean_variance_kbps(low, -0.2)
    for kind in KINDS:
        assert utility_kbps(high, kind, -0.2) > utility_kbps(low, kind, -0.2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mu", [0.0, -0.05, -2.0])
@pytest.mark.parametrize("past", [0, 3])
def test_weights_are_the_gradient(kind: str, mu: float, past: int) -> None:
    problem = paper(kind, mu, past)
    rng = np.random.default_rng(7)
    rates, direction = rng.uniform(5, 9, (9, 20)), rng.normal(size=(9, 20))

    def value(step: float) -> float:
        return utility_kbps(problem.counted_kbps(rates + step * direction), kind, mu)

    slope = (value(1e-5) - value(-1e-5)) / 2e-5
    assert (rate_weights(problem, rates) * direction).sum() == pytest.approx(slope, rel=1e-5, abs=1e-7)


@given(kinds, mus, st.integers(0, 99))
def test_the_utility_lies_below_each_of_its_tangent_planes(kind: str, mu: float, seed: int) -> None:
    problem = paper(kind, mu, 2)
    rng = np.random.default_rng(seed)
    here, there = rng.uniform(0, 20, (2, 9, 20))
    plane = utility_kbps(problem.counted_kbps(here), kind, mu) + (rate_weights(problem, here) * (there - here)).sum()
    assert utility_kbps(problem.counted_kbps(there), kind, mu) <= plane + 1e-6


def test_slots_that_do_not_count_have_no_weight() -> None:
    problem = replace(paper("per_user", -0.1), counted_from=1)
    weights = rate_weights(problem, np.ones((9, 20)))
    assert (weights[:, 0] == 0).all()
    assert weights[:, 1:].sum() == pytest.approx(9.0)


def test_jain_is_one_for_equal_rates_and_one_over_k_for_one_user() -> None:
    assert jain_index(np.ones((5, 3))) == pytest.approx(1.0)
    assert jain_index(np.eye(5)[:, :1]) == pytest.approx(0.2)
    assert jain_index(np.eye(3)) == pytest.approx(1.0), "of time-averaged rates, not per slot"
    assert jain_index(np.zeros((2, 2))) == 1.0


def test_an_unknown_kind_is_an_error_everywhere_and_never_another_utility() -> None:
    problem = paper("harmonic", -0.1)
    rates = np.ones((problem.n_users, problem.n_slots))
    for asks in (
        lambda: utility_kbps(rates, "harmonic", -0.1),
        lambda: rate_weights(problem, rates),
        lambda: arena_of(problem),
        lambda: concave_utility(problem, cp.Constant(rates)),
    ):
        with pytest.raises(ValueError, match="'harmonic' must be one of sum, per_user, pooled"):
            asks()


def test_the_scenario_takes_the_kinds_of_the_table_and_no_others() -> None:
    assert Utility.model_json_schema()["properties"]["kind"]["enum"] == list(UTILITIES)


def test_one_file_and_one_row_make_a_new_utility(monkeypatch: pytest.MonkeyPatch) -> None:
    average = replace(UTILITIES["pooled"], scale=lambda weights: np.ones(1))  # noqa: ARG005
    monkeypatch.setitem(UTILITIES, "average_user", average)
    problem, pooled = paper("average_user", -0.1), paper("pooled", -0.1)
    mine, theirs = (optimise(one, MaxIterations(2), n_starts=1) for one in (problem, pooled))
    np.testing.assert_array_equal(mine.paths_m, theirs.paths_m)
    rates = served_rates_bps(problem, mine) / 1e3
    assert problem.n_users * utility_kbps(rates, "average_user", -0.1) == pytest.approx(
        utility_kbps(rates, "pooled", -0.1)
    )
    assert problem.n_users * rate_weights(problem, rates) == pytest.approx(rate_weights(pooled, rates))
