"""Finding mu for given limits."""

import pytest

from skyfolio.api.lab.reproduce.tuning import Limits, closest, tune
from skyfolio.planner import EXAMPLES

MUS = (0.0, -0.1, -1.0)


def test_of_the_mu_that_meet_every_limit_the_one_with_the_highest_sum_rate_is_chosen() -> None:
    scenario = EXAMPLES["minimal"]()
    free = tune(scenario, "pooled", Limits(), losses=["uav-2"], at_slot=2, mus=MUS)
    assert free.chosen_mu_per_kbps == max(free.rows, key=lambda row: row.mean_sum_rate_kbps).mu_per_kbps
    fairest = max(free.rows, key=lambda row: row.jain)
    bound = tune(scenario, "pooled", Limits(min_jain=fairest.jain - 1e-9), losses=["uav-2"], at_slot=2, mus=MUS)
    assert bound.chosen_mu_per_kbps is not None
    chosen = next(row for row in bound.rows if row.mu_per_kbps == bound.chosen_mu_per_kbps)
    assert chosen.missed == []
    assert chosen.jain >= fairest.jain - 1e-9
    assert fairest.mu_per_kbps < 0, "fairness costs sum rate here"


def test_when_no_mu_meets_the_limits_it_says_which_is_missed() -> None:
    limits = Limits(min_sum_rate_kbps=1e6, min_jain=0.1)
    found = tune(EXAMPLES["minimal"](), "sum", limits, losses=[], at_slot=2, mus=MUS)
    assert found.chosen_mu_per_kbps is None
    assert closest(found).missed == ["min_sum_rate"]


def test_a_loss_that_cannot_be_is_refused() -> None:
    scenario = EXAMPLES["minimal"]()
    with pytest.raises(ValueError, match=r"failed: 'uav-9' must be one of uav-1, uav-2"):
        tune(scenario, "sum", Limits(), losses=["uav-9"], at_slot=2)
    with pytest.raises(ValueError, match=r"at_slot: 4 must lie in 1\.\.3"):
        tune(scenario, "sum", Limits(), losses=["uav-1"], at_slot=4)
