"""Links anew at given paths, from nothing and from rates that are near to the best."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from skyfolio.planner import Utility
from skyfolio.planner.fast import linked, served_rates_bps
from skyfolio.planner.gradient import log_weights
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of


@pytest.mark.parametrize("kind", ["per_user", "pooled"])
def test_links_that_begin_near_the_best_come_to_what_others_do_in_fewer_passes(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = sys.modules["skyfolio.planner.fast.optimise"]
    passes, climb_on = [0], module.climb_on

    def counted(*given: object) -> object:
        passes[0] += 1
        return climb_on(*given)

    problem = problem_of(
        scattered(5, 40, 10, seed=2, utility=Utility.model_validate({"kind": kind, "mu_per_kbps": -0.3}))
    )
    cold = linked(problem, problem.hover())
    near_kbps = served_rates_bps(problem, cold) / 1e3
    monkeypatch.setattr(module, "climb_on", counted)
    linked(problem, problem.hover())
    from_nothing, passes[0] = passes[0], 0
    warm = linked(problem, problem.hover(), near_kbps=near_kbps)
    assert passes[0] < from_nothing if kind == "per_user" else passes[0] <= from_nothing  # pooled users weigh alike
    reached = problem.utility_kbps(served_rates_bps(problem, warm) / 1e3)
    assert reached >= problem.utility_kbps(near_kbps) * (1.0 - 1e-6)


def test_the_weights_of_users_are_those_that_water_filling_would_find() -> None:
    """Under `per_user` exp(mu rate) of a user weighs as much as its mean is small; of the sated one, least."""
    problem = problem_of(scattered(2, 3, 4, seed=1, utility=Utility(kind="per_user", mu_per_kbps=-0.5)))
    rates = np.array([[1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 1.0, 1.0], [9.0, 9.0, 9.0, 9.0]])
    expected = -np.log(np.exp(-0.5 * rates).mean(axis=1))
    assert log_weights(problem, rates) == pytest.approx(expected - expected.max())
    asked = replace(problem, demand_kbps=np.array([np.inf, np.inf, 9.0]))
    told = log_weights(asked, rates)
    assert told[:2] == pytest.approx(expected[:2] - expected[:2].max())
    assert told[2] == told[:2].min()
