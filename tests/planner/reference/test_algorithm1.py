"""Algorithm 1 and its subproblems (a4), (a5) on instances with a known answer."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from skyfolio.planner import AnyOf, Iteration, MaxIterations, RelativeGain, Scenario, StopToken, violations
from skyfolio.planner.arrays import Array
from skyfolio.planner.emit import emit
from skyfolio.planner.layouts import scattered
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import Past, Problem, problem_of
from skyfolio.planner.reference.algorithm1 import algorithm_1
from skyfolio.planner.reference.association import nearest_binary, relaxed_association
from skyfolio.planner.reference.bandwidth import best_bandwidth, whole_shares
from skyfolio.planner.repair import within_limits
from skyfolio.planner.scenario import NoFlyDisc, Utility
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.utility import utility_kbps

ByHand = Callable[..., Scenario]
KINDS = ["sum", "per_user", "pooled"]


def planned(scenario: Scenario, start_m: Array | None = None, past: Past | None = None) -> Plan:
    """A whole plan by the letter's method."""
    problem = problem_of(scenario, past)
    solution = algorithm_1(problem, AnyOf(MaxIterations(8), RelativeGain(1e-4)), start_m)
    return emit(scenario, past or Past(), problem, solution, method="paper")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mu", [0.0, -0.2])
def test_two_uavs_four_users_get_the_60_kbps_worked_by_hand(two_uavs_four_users: ByHand, kind: str, mu: float) -> None:
    made = planned(two_uavs_four_users(kind=kind, mu=mu))
    assert made.summary.utility_bps == pytest.approx(60_000, rel=1e-5)
    assert made.summary.mean_sum_rate_bps == pytest.approx(60_000, rel=1e-5)


def test_pooled_gives_each_of_the_four_users_the_same_15_kbps(two_uavs_four_users: ByHand) -> None:
    made = planned(two_uavs_four_users(kind="pooled", mu=-0.5))
    for user, uav in zip(("user-1", "user-2", "user-3", "user-4"), ("uav-1", "uav-1", "uav-2", "uav-2"), strict=True):
        assert made.association[user] == [uav] * 3
        assert made.user_rates_bps[user] == pytest.approx([15_000] * 3, rel=1e-3)
    assert made.summary.jain == pytest.approx(1.0, abs=1e-6)


def test_per_user_keeps_each_user_at_what_it_had_before(two_uavs_four_users: ByHand) -> None:
    """A user's marginal is exp(mu R) / (exp(mu past) + exp(mu R)): equal where everybody's R - past is the same."""
    scenario = two_uavs_four_users(slots=1, kind="per_user", mu=-0.1)
    past = Past(first_slot=1, rates_bps=np.array([[30_000.0], [0.0], [15_000.0], [15_000.0]]))
    made = planned(scenario, past=past)
    assert made.user_rates_bps["user-1"] == pytest.approx([30_000], rel=1e-3)
    assert made.user_rates_bps["user-2"] == pytest.approx([0], abs=30)
    assert made.user_rates_bps["user-3"] == pytest.approx([15_000], rel=1e-2)


def test_the_relaxed_association_prefers_the_better_channel(problem_by_hand: Callable[..., Problem]) -> None:
    problem = problem_by_hand(slots=2)
    efficiency = spectral_efficiency(problem, problem.hover())
    equal = np.full(efficiency.shape, 5_000.0)
    relaxed = relaxed_association(problem, equal, efficiency)
    assert relaxed.sum(axis=0) == pytest.approx(np.ones((4, 2)), abs=1e-6)
    assert relaxed[0, :2] == pytest.approx(np.ones((2, 2)), abs=1e-5)
    assert (nearest_binary(problem, relaxed, equal, efficiency) == [[0, 0], [0, 0], [1, 1], [1, 1]]).all()


def test_no_uav_that_has_left_serves_anybody(two_uavs_four_users: ByHand) -> None:
    scenario = two_uavs_four_users()
    leaving = tuple(
        uav.model_copy(update={"leaves_at_slot": leaves}) for uav, leaves in zip(scenario.uavs, (2, None), strict=True)
    )
    made = planned(scenario.with_changes(uavs=leaving))
    assert violations(made) == []
    alone = 10 * np.log2(1 + 70 / 3)
    assert sum(row[2] for row in made.user_rates_bps.values()) == pytest.approx(alone * 1e3, rel=1e-4)


def test_bandwidth_leaves_no_residue_and_fills_each_band(problem_by_hand: Callable[..., Problem]) -> None:
    problem = problem_by_hand(slots=2)
    efficiency = spectral_efficiency(problem, problem.hover())
    bandwidth = best_bandwidth(problem, np.full(efficiency.shape, 0.5), efficiency * [[[1.0]], [[1.1]]]) * 0.5
    assert ((bandwidth == 0) | (bandwidth > 1e-5 * 10_000)).all()
    assert bandwidth.sum(axis=1) == pytest.approx(np.full((2, 2), 10_000.0), rel=1e-12)


def test_what_the_residue_held_goes_to_the_others() -> None:
    shares = np.array([[[0.5], [0.4], [1e-7], [-1e-9]]])
    assert whole_shares(shares, np.ones_like(shares))[0, :, 0] == pytest.approx([5 / 9, 4 / 9, 0, 0], rel=1e-12)
    assert (whole_shares(np.zeros((1, 2, 1)), np.ones((1, 2, 1))) == 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_objective_never_decreases_and_every_plan_is_feasible(kind: str) -> None:
    scenario = scattered(2, 4, 5, seed=4, utility=Utility(kind=kind, mu_per_kbps=-0.3))
    seen: list[Iteration] = []
    problem = problem_of(scenario)
    solution = algorithm_1(problem, MaxIterations(4), observer=lambda iteration, _: seen.append(iteration))
    assert seen == solution.history
    utilities = [one.utility_bps for one in seen]
    assert utilities == sorted(utilities)
    hover = (
        problem.bandwidth_hz.sum() / problem.n_users * spectral_efficiency(problem, problem.hover()).mean(axis=0) / 1e3
    )
    assert utilities[0] / 1e3 > utility_kbps(hover / 2, kind, -0.3)
    assert violations(emit(scenario, Past(), problem, solution, method="paper")) == []


def test_the_best_a_and_b_of_sum_do_not_depend_on_mu() -> None:
    """`sum` grows with each slot's sum rate, and (6a)-(6c) separate per slot: the sum-rate maximisers are best."""
    problem = problem_of(scattered(2, 4, 3, seed=5))
    efficiency = spectral_efficiency(problem, problem.hover())
    best = []
    for n in range(3):
        rates = problem.bandwidth_hz[:, None] * efficiency[:, :, n] / 1e3
        best.append(rates[linear_sum_assignment(rates, maximize=True)].sum())
    for mu in (0.0, -0.02, -0.2):
        at_mu = replace(problem, mu=mu, past_kbps=np.full((4, 2), 3.0))
        everyone = np.full(efficiency.shape, 0.5)
        per_slot = (everyone * best_bandwidth(at_mu, everyone, efficiency) * efficiency).sum(axis=(0, 1)) / 1e3
        assert per_slot == pytest.approx(best, rel=1e-5)


def test_minimum_rates_are_met_where_they_can_be_and_the_rest_is_reported(two_uavs_four_users: ByHand) -> None:
    scenario = two_uavs_four_users()

    def wanting(*rates: float) -> Scenario:
        return scenario.with_changes(
            users=tuple(
                user.model_copy(update={"min_rate_bps": rate}) for user, rate in zip(scenario.users, rates, strict=True)
            )
        )

    met = planned(wanting(9_000.0, 20_000.0, 1_000.0, 0.0))
    assert met.status == "succeeded"
    assert min(met.user_rates_bps["user-1"]) >= 9_000 * (1 - 1e-9)
    assert min(met.user_rates_bps["user-2"]) >= 20_000 * (1 - 1e-9)
    assert met.summary.utility_bps == pytest.approx(60_000, rel=1e-4), "minimum rates cost nothing here"
    assert min(met.user_rates_bps["user-3"]) >= 1_000
    unmet = planned(wanting(20_000.0, 0.0, 40_000.0, 0.0))
    assert unmet.status == "infeasible"
    assert unmet.unmet_min_rate_slots == {"user-3": [0, 1, 2]}
    assert min(unmet.user_rates_bps["user-1"]) >= 20_000 * (1 - 1e-9)


def test_ends_zones_and_altitudes_are_respected_from_a_feasible_start() -> None:
    scenario = scattered(2, 4, 6, seed=6)
    first, second = scenario.uavs
    east, north = first.start_m
    scenario = scenario.with_changes(
        uavs=(
            first.model_copy(update={"end_m": (east + 30.0, north + 10.0), "altitude_m": 40.0}),
            second.model_copy(update={"leaves_at_slot": 4}),
        ),
        no_fly=(NoFlyDisc(center_m=(east + 20.0, north - 20.0), radius_m=15.0),),
    )
    problem = problem_of(scenario)
    straight = problem.hover()
    straight[0] += np.minimum(np.arange(6) / 5, 1.0)[:, None] * [30.0, 10.0]
    made = planned(scenario, within_limits(problem, straight))
    assert violations(made) == []
    utilities = [one.utility_bps for one in made.history]
    assert utilities == sorted(utilities)


def test_it_stops_when_it_is_told_to_and_still_returns_a_plan(two_uavs_four_users: ByHand) -> None:
    scenario = two_uavs_four_users()
    problem = problem_of(scenario)
    solution = algorithm_1(problem, StopToken(lambda: True))
    assert solution.history == []
    assert violations(emit(scenario, Past(), problem, solution, method="paper")) == []


def test_a_solver_that_loses_its_footing_is_tried_again() -> None:
    """On this instance Clarabel's default steps end in a numerical error in (a5)."""
    scenario = scattered(3, 9, 20, seed=2, utility=Utility(kind="sum", mu_per_kbps=-0.1))
    made = planned(scenario)
    assert made.summary.utility_bps == pytest.approx(made.history[-1].utility_bps, rel=1e-3)
