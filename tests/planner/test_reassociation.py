"""Serving the users of a lost UAV at once: nobody moves, links are the best there are, and nobody is left behind."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest

from skyfolio.planner import EXAMPLES, Plan, ReplanError, Scenario, Utility, plan, reassociate, violations
from skyfolio.planner.problem import problem_of
from skyfolio.planner.reassociation import LEAST_BPS
from skyfolio.planner.scenario import Battery
from skyfolio.planner.sinr import spectral_efficiency
from tests.planner.hills import over_the_hill


@pytest.fixture(scope="module")
def pooled() -> Plan:
    return plan(EXAMPLES["paper"]().with_changes(utility=Utility(kind="pooled", mu_per_kbps=-0.1)))


def test_survivors_stay_on_their_paths_and_everything_else_holds(pooled: Plan) -> None:
    again = reassociate(pooled, failed=["uav-3"], at_slot=10)
    assert again.trajectories_m == {uav: pooled.trajectories_m[uav][10:] for uav in ("uav-1", "uav-2")}
    assert (again.first_slot, again.parent, again.revision) == (10, pooled.id, 2)
    assert violations(again) == []


@pytest.mark.parametrize("limits", [{}, {"altitude_min_m": 35.0, "altitude_max_m": 90.0}])
def test_over_hills_survivors_keep_their_altitudes_and_batteries(limits: dict[str, float]) -> None:
    scenario = over_the_hill(clearance_m=25.0, utility=Utility(kind="pooled", mu_per_kbps=-0.1), **limits)
    with_battery = tuple(uav.model_copy(update={"battery": Battery(usable_wh=40.0)}) for uav in scenario.uavs)
    made = plan(scenario.with_changes(uavs=with_battery), n_starts=2)
    left_behind = [user for user in made.association if made.association[user][4] == "south"]
    again = reassociate(made, failed=["south"], at_slot=4)
    assert violations(again) == []
    assert made.altitudes_m is not None
    assert again.altitudes_m == {"west": made.altitudes_m["west"][4:]}
    assert left_behind
    for user in left_behind:
        assert min(again.user_rates_bps[user]) >= LEAST_BPS * 0.999


def test_every_user_of_the_lost_uav_is_served_again(pooled: Plan) -> None:
    left_behind = [user for user in pooled.association if pooled.association[user][10] == "uav-3"]
    assert len(left_behind) == 3
    again = reassociate(pooled, failed=["uav-3"], at_slot=10)
    for user in left_behind:
        assert min(again.user_rates_bps[user]) >= LEAST_BPS * 0.999


def test_under_sum_the_links_are_the_best_assignment_of_whole_bands(
    two_uavs_four_users: Callable[..., Scenario],
) -> None:
    made = plan(two_uavs_four_users())
    again = reassociate(made, at_slot=1)  # nobody is lost: nobody is left behind
    problem = problem_of(again.scenario)
    rates = 10.0 * spectral_efficiency(problem, problem.hover())[:, :, 0]
    best = max(rates[0, a] + rates[1, b] for a, b in permutations(range(4), 2))
    assert again.summary.mean_sum_rate_bps / 1e3 == pytest.approx(best)


def test_a_uav_that_is_far_off_its_path_serves_whom_it_reaches_from_there() -> None:
    made = plan(EXAMPLES["paper"]())
    here = reassociate(made, failed=["uav-3"], at_slot=5)
    away = reassociate(made, failed=["uav-3"], at_slot=5, positions_m={"uav-1": made.scenario.uav("uav-3").start_m})
    served = [{user for user, row in one.association.items() if row[0] == "uav-1" and one.bandwidth_hz[user][0] > 5e3}
              for one in (here, away)]  # fmt: skip
    near_uav_3 = {"user-7", "user-8", "user-9"}
    assert served[1] & near_uav_3
    assert not served[0] & near_uav_3 or served[0] != served[1]


def test_users_ask_for_no_more_on_the_path_than_where_a_uav_is_now() -> None:
    """Whom a UAV serves is decided by where it is; on its path, nearer to a user, this band would be too much."""
    paper = EXAMPLES["paper"]()
    asking = tuple(user.model_copy(update={"demand_bps": 6_000.0}) for user in paper.users)
    made = plan(paper.with_changes(users=asking, utility=Utility(kind="pooled", mu_per_kbps=-0.1)))
    away = reassociate(made, failed=["uav-3"], at_slot=5, positions_m={"uav-1": paper.uav("uav-2").start_m})
    assert violations(away) == []


def test_corrections_count(pooled: Plan) -> None:
    bad = {"uav-1": dict.fromkeys(pooled.scenario.user_ids, -30.0)}
    again = reassociate(pooled, failed=["uav-3"], at_slot=10, corrections_db=bad)
    plain = reassociate(pooled, failed=["uav-3"], at_slot=10)
    assert again.summary.mean_sum_rate_bps != plain.summary.mean_sum_rate_bps
    assert again.scenario.channel.corrections_db == bad


def test_it_is_the_same_whenever_it_is_asked_for(pooled: Plan) -> None:
    first, second = (reassociate(pooled, failed=["uav-2"], at_slot=7) for _ in range(2))
    assert first == second
    assert np.isfinite(first.summary.utility_bps)


def test_nobody_left_is_refused(pooled: Plan) -> None:
    with pytest.raises(ReplanError, match="failed: no UAV would be left"):
        reassociate(pooled, failed=["uav-1", "uav-2", "uav-3"], at_slot=3)
