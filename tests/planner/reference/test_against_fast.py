"""The reference path and the fast path agree wherever both are exact."""

import numpy as np
import pytest

from skyfolio.planner import AnyOf, MaxIterations, RelativeGain, Scenario
from skyfolio.planner.fast import linked, optimise, served_rates_bps
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Past, Problem, problem_of
from skyfolio.planner.reference import algorithm_1
from skyfolio.planner.scenario import Utility
from skyfolio.planner.solution import Solution
from skyfolio.planner.utility import utility_kbps


def still(scenario: Scenario) -> Scenario:
    """The same, where no UAV can move."""
    return scenario.with_changes(uavs=tuple(uav.model_copy(update={"max_speed_mps": 0.0}) for uav in scenario.uavs))


def worth(problem: Problem, solution: Solution) -> float:
    rates = served_rates_bps(problem, solution) / 1e3
    return utility_kbps(problem.counted_kbps(rates), problem.kind, problem.mu)


def reference(problem: Problem) -> Solution:
    return algorithm_1(problem, AnyOf(MaxIterations(12), RelativeGain(1e-7)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mu", [0.0, -0.1])
def test_sum_without_flight_is_the_same_assignment(seed: int, mu: float) -> None:
    utility = Utility(kind="sum", mu_per_kbps=mu)
    problem = problem_of(still(scattered(3, 6, 2, seed=seed, utility=utility)))
    fast = linked(problem, problem.hover())
    assert worth(problem, reference(problem)) == pytest.approx(worth(problem, fast), rel=1e-5)


@pytest.mark.parametrize("kind", ["per_user", "pooled"])
@pytest.mark.parametrize("past", [0, 4])
def test_one_uav_shares_its_band_the_same_way(kind: str, past: int) -> None:
    """With one UAV the association is given and bandwidth is a concave problem: both must find its optimum."""
    scenario = still(scattered(1, 5, 3, seed=8, utility=Utility(kind=kind, mu_per_kbps=-0.4)))
    rates = np.random.default_rng(0).uniform(0, 9e3, (5, past))
    problem = problem_of(scenario, Past(first_slot=past, rates_bps=rates) if past else None)
    fast, slow = linked(problem, problem.hover()), reference(problem)
    assert worth(problem, fast) == pytest.approx(worth(problem, slow), rel=1e-5)
    assert served_rates_bps(problem, fast) == pytest.approx(served_rates_bps(problem, slow), abs=60.0)


def test_one_uav_flies_straight_to_its_one_user() -> None:
    scenario = scattered(1, 1, 6, seed=0)
    scenario = scenario.with_changes(users=(scenario.users[0].model_copy(update={"position_m": (200.0, 125.0)}),))
    problem = problem_of(scenario)
    expected = np.minimum(125.0 + 25.0 * np.arange(6), 200.0)
    for solution in (optimise(problem, AnyOf(MaxIterations(50)), n_starts=1), reference(problem)):
        assert solution.paths_m[0, :, 0] == pytest.approx(expected, abs=1.5)
        assert solution.paths_m[0, :, 1] == pytest.approx(np.full(6, 125.0), abs=1.5)
        best = 10 * np.log2(1 + 0.001 / 10**-8.5 / ((200.0 - expected) ** 2 + 60.0**2)).mean()
        assert worth(problem, solution) == pytest.approx(best, rel=1e-4)
