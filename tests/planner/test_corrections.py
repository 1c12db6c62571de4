"""A channel with corrections: every part of the planner that knows the channel knows them too."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from skyfolio.planner import Scenario, delivered_rates_bps, plan, replan
from skyfolio.planner.corrections import correction_db
from skyfolio.planner.problem import problem_of
from skyfolio.planner.robustness.flown import flown_as_planned, planned_gains
from skyfolio.planner.sinr import spectral_efficiency

Make = Callable[..., Scenario]


def corrected(make: Make, by_uav: dict[str, dict[str, float]], **channel: object) -> Scenario:
    plain = make()
    changed = {**plain.channel.model_dump(), "corrections_db": by_uav, **channel}
    return Scenario.model_validate({**plain.model_dump(), "channel": changed})


def test_a_corrected_link_has_the_sinr_worked_by_hand(two_uavs_four_users: Make) -> None:
    problem = problem_of(corrected(two_uavs_four_users, {"uav-1": {"user-1": 10.0}}))
    efficiency = spectral_efficiency(problem, problem.hover())
    # own SNR 70/3, ten times that by the correction; the other UAV's is 7/3
    assert efficiency[0, 0, 0] == pytest.approx(np.log2(1 + (700 / 3) / (7 / 3 + 1)))
    assert efficiency[1, 0, 0] == pytest.approx(np.log2(1 + (7 / 3) / (700 / 3 + 1)))
    assert efficiency[0, 1, 0] == pytest.approx(3.0)


def test_a_plan_serves_whom_it_reaches_well(two_uavs_four_users: Make) -> None:
    made = plan(corrected(two_uavs_four_users, {"uav-1": {"user-1": -20.0}}))
    assert set(made.bandwidth_hz["user-1"]) == {0.0}
    assert set(made.bandwidth_hz["user-2"]) == {10_000.0}


@pytest.mark.parametrize("fading", ["mean", "sampled", "held", "expected"])
def test_delivered_and_planned_rates_are_the_same(two_uavs_four_users: Make, fading: str) -> None:
    given = {"uav-1": {"user-1": 5.0, "user-3": -4.0}, "uav-2": {"user-4": -3.0}}
    made = plan(corrected(two_uavs_four_users, given, fading=fading))
    paths_m = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids]).transpose(1, 0, 2)
    delivered = delivered_rates_bps(made, np.arange(3), paths_m, np.ones((3, 2), dtype=bool)).T
    np.testing.assert_allclose(delivered, [made.user_rates_bps[user] for user in made.scenario.user_ids], rtol=1e-9)
    if fading != "expected":
        np.testing.assert_allclose(flown_as_planned(made).rates_bps(planned_gains(made)), delivered, rtol=1e-9)


def test_links_that_are_not_of_the_scenario_are_refused_by_name(two_uavs_four_users: Make) -> None:
    with pytest.raises(ValidationError, match=r"channel\.corrections_db: 'uav-7' is not a UAV"):
        corrected(two_uavs_four_users, {"uav-7": {"user-1": 1.0}})
    with pytest.raises(ValidationError, match=r"channel\.corrections_db\.uav-1: 'user-7' is not a user"):
        corrected(two_uavs_four_users, {"uav-1": {"user-7": 1.0}})


def test_what_is_not_corrected_is_not_written(two_uavs_four_users: Make) -> None:
    assert "corrections_db" not in two_uavs_four_users().channel.model_dump(mode="json")


def test_a_replan_takes_new_corrections_and_drops_those_of_lost_uavs(two_uavs_four_users: Make) -> None:
    made = plan(two_uavs_four_users())
    given = {"uav-1": {"user-1": -5.0}, "uav-2": {"user-1": 3.0}}
    again = replan(made, failed=["uav-2"], at_slot=1, corrections_db=given)
    assert again.scenario.channel.corrections_db == {"uav-1": {"user-1": -5.0}}
    later = replan(again, at_slot=2)
    assert later.scenario.channel.corrections_db == {"uav-1": {"user-1": -5.0}}


def test_a_star_stands_for_all_users_that_a_row_does_not_name(two_uavs_four_users: Make) -> None:
    plain = two_uavs_four_users()
    starred = corrected(two_uavs_four_users, {"uav-1": {"*": -6.0, "user-3": 2.0}, "uav-2": {"*": 1.0}})
    named = {
        "uav-1": {**dict.fromkeys(plain.user_ids, -6.0), "user-3": 2.0},
        "uav-2": dict.fromkeys(plain.user_ids, 1.0),
    }
    spelled = corrected(two_uavs_four_users, named)
    assert problem_of(starred).snr_gain == pytest.approx(problem_of(spelled).snr_gain, rel=1e-12)
    assert Scenario.model_validate_json(starred.model_dump_json()) == starred
    assert correction_db(starred.channel.corrections_db, "uav-1", "user-1") == -6.0
    assert correction_db(starred.channel.corrections_db, "uav-1", "user-3") == 2.0
    fewer = starred.with_changes(users=plain.users[:2])
    assert fewer.channel.corrections_db == {"uav-1": {"*": -6.0}, "uav-2": {"*": 1.0}}


def test_corrections_of_uavs_alone_leave_all_users_with_one_row_of_gains(two_uavs_four_users: Make) -> None:
    problem = problem_of(corrected(two_uavs_four_users, {"uav-1": {"*": 10.0}}))
    assert problem.snr_gain.strides[1] == 0
    efficiency = spectral_efficiency(problem, problem.hover())
    assert efficiency[0, 0, 0] == pytest.approx(np.log2(1 + (700 / 3) / (7 / 3 + 1)))
    assert efficiency[1, 0, 0] == pytest.approx(np.log2(1 + (7 / 3) / (700 / 3 + 1)))


@pytest.mark.parametrize("fading", ["mean", "sampled", "held", "expected"])
def test_what_is_delivered_with_corrections_of_uavs_is_what_was_planned(two_uavs_four_users: Make, fading: str) -> None:
    made = plan(corrected(two_uavs_four_users, {"uav-1": {"*": 5.0}, "uav-2": {"*": -3.0}}, fading=fading))
    paths_m = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids]).transpose(1, 0, 2)
    delivered = delivered_rates_bps(made, np.arange(3), paths_m, np.ones((3, 2), dtype=bool)).T
    np.testing.assert_allclose(delivered, [made.user_rates_bps[user] for user in made.scenario.user_ids], rtol=1e-9)
