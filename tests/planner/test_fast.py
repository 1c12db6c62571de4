"""The fast path against the exact solver, brute force and the independent checker."""

from collections.abc import Callable

import numpy as np
import pytest

from skyfolio.planner import (
    EXAMPLES,
    Iteration,
    MaxIterations,
    Plan,
    Scenario,
    StopToken,
    Utility,
    plan,
    replan,
    violations,
)
from skyfolio.planner.fast import optimise
from skyfolio.planner.problem import problem_of


def scenario(kind: str = "sum", mu: float = -0.1) -> Scenario:
    return EXAMPLES["paper"]().with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}))


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
def test_the_utility_never_decreases_over_the_iterations(kind: str) -> None:
    seen: list[Iteration] = []
    made = plan(scenario(kind), n_starts=4, observer=seen.append)
    utilities = [one.utility_bps for one in made.history]
    assert seen == made.history
    assert utilities == sorted(utilities)
    assert made.summary.utility_bps == pytest.approx(utilities[-1], rel=1e-9)
    assert violations(made) == []


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
def test_the_same_inputs_and_seed_give_the_same_plan_bit_for_bit(kind: str) -> None:
    assert plan(scenario(kind), n_starts=5, seed=3) == plan(scenario(kind), n_starts=5, seed=3)


def test_a_plan_stopped_at_once_hovers_and_is_feasible() -> None:
    made = plan(scenario(), stop=StopToken(lambda: True))
    assert made.status == "cancelled"
    assert violations(made) == []
    assert all(len(set(path)) == 1 for path in made.trajectories_m.values())


def test_the_best_so_far_is_a_feasible_plan_whenever_it_is_asked_for() -> None:
    offers: list[Callable[[], Plan]] = []
    seen: list[Iteration] = []
    made = plan(scenario(), n_starts=4, observer=seen.append, offer=offers.append)
    sketches = [make() for make in offers]  # long after they were offered
    assert [sketch.summary.utility_bps for sketch in sketches] == pytest.approx([one.utility_bps for one in seen])
    assert [sketch.history for sketch in sketches] == [seen[: count + 1] for count in range(len(seen))]
    assert all(sketch.status == "running" and violations(sketch) == [] for sketch in sketches)
    assert sketches[-1].trajectories_m == made.trajectories_m


def test_more_starts_are_never_worse() -> None:
    problem = problem_of(scenario())
    few = optimise(problem, MaxIterations(5), n_starts=1).history[-1].utility_bps
    many = optimise(problem, MaxIterations(5), n_starts=8).history[-1].utility_bps
    assert many >= few


def test_a_replan_keeps_the_method_and_beats_hovering() -> None:
    made = plan(scenario(), n_starts=2)
    again = replan(made, failed=["uav-1"], at_slot=8, n_starts=2)
    assert again.method == made.method == "fast"
    hover = plan(again.scenario, stop=StopToken(lambda: True))
    assert again.summary.mean_sum_rate_bps > hover.summary.mean_sum_rate_bps
    assert violations(again) == []


def test_an_unknown_method_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(ValueError, match=r"method: 'fastest' must be one of fast, areas, paper"):
        plan(scenario(), method="fastest")


@pytest.mark.parametrize(("shape", "rule"), [((3, 9, 2), "shape"), ((3, 20, 2), "finite")])
def test_a_warm_start_that_does_not_fit_is_refused(shape: tuple[int, ...], rule: str) -> None:
    with pytest.raises(ValueError, match=rf"warm_start_m: .*{rule}"):
        plan(scenario(), warm_start_m=np.full(shape, np.nan))
