"""Demands over ground: nobody gets more at the altitudes of a plan than it asks for."""

import pytest

from skyfolio.planner import MaxIterations, Utility, plan, violations
from skyfolio.planner.emit import emit
from skyfolio.planner.fast import linked
from skyfolio.planner.ground.aloft import raised
from skyfolio.planner.ground.ground import ground_of
from skyfolio.planner.problem import Past, problem_of
from tests.planner.hills import hill, over_the_hill


@pytest.mark.parametrize("demand_bps", [1_000.0, 5_000.0, 12_000.0])
def test_a_solution_that_is_raised_without_new_links_gives_nobody_more_than_it_asks_for(demand_bps: float) -> None:
    scenario = over_the_hill(terrain=hill(height_m=0.0), altitude_m=300.0)
    users = tuple(user.model_copy(update={"demand_bps": demand_bps}) for user in scenario.users)
    scenario = scenario.with_changes(
        users=users,
        clearance_m=30.0,
        altitude_min_m=35.0,
        altitude_max_m=300.0,
        utility=Utility(kind="pooled", mu_per_kbps=-0.2),
    )
    problem, ground = problem_of(scenario), ground_of(scenario)
    assert ground is not None
    level = linked(problem, problem.hover())
    low = raised(problem, ground, level)  # 265 m lower than the links were made for
    assert emit(scenario, Past(), problem, low, ground=ground, method="by hand").user_rates_bps
    assert violations(plan(scenario, n_starts=2, stop=MaxIterations(3))) == []
