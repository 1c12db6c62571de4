"""One case: settings put into a scenario, planned and replanned."""

from typing import Any

import numpy as np
import pytest

from skyfolio.api.lab.sweep.case import row_of
from skyfolio.api.lab.sweep.settings import case_of, scenario_of
from skyfolio.api.lab.sweep.spec import Base, Layout, SpecError
from skyfolio.planner import EXAMPLES, letter, plan, replan
from skyfolio.planner.layouts import laid_out, scattered

MINIMAL = Base(example="minimal")


def test_settings_reach_every_element_of_a_list_or_one_by_number_or_id() -> None:
    scenario = scenario_of(
        MINIMAL,
        {
            "uavs.*.bandwidth_hz": 5000,
            "uavs.uav-2.bandwidth_hz": 7000.0,
            "users.0.min_rate_bps": 10.0,
            "channel.noise_dbm": -70.0,
            "origin": {"lat_deg": 1.0, "lon_deg": 2.0},
        },
    )
    assert [uav.bandwidth_hz for uav in scenario.uavs] == [5000.0, 7000.0]
    assert [user.min_rate_bps for user in scenario.users] == [10.0, 0.0, 0.0, 0.0]
    assert scenario.channel.noise_dbm == -70.0
    assert (scenario.origin.lat_deg, scenario.origin.lon_deg) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("layout", "expected"),
    [
        (Layout(kind="letter"), letter(layout_seed=5, fading_seed=5)),
        (Layout(kind="scattered", uavs=4, users=11, slots=6), scattered(4, 11, 6, seed=5)),
        (Layout(kind="clustered", uavs=4, users=11, slots=6), laid_out("clustered", 4, 11, 6, seed=5)),
    ],
)
def test_layouts_are_those_of_the_planner(layout: Layout, expected: Any) -> None:
    assert scenario_of(Base(layout=layout), {"layout.seed": 5}) == expected


def test_a_broken_rule_of_the_scenario_names_its_field() -> None:
    with pytest.raises(SpecError, match=r"uavs: start_m of 'uav-1' and 'uav-2' are 100 m apart"):
        scenario_of(MINIMAL, {"min_separation_m": 500.0})


def test_a_row_holds_what_the_planner_says() -> None:
    row = row_of(MINIMAL, {"method": "fast", "starts": 4, "seed": 3, "utility.mu_per_kbps": -0.2})
    scenario = scenario_of(MINIMAL, {"utility.mu_per_kbps": -0.2})
    made = plan(scenario, n_starts=4, seed=3)
    assert (row["status"], row["error"], row["replan_ms"]) == ("succeeded", None, None)
    assert row["utility_bps"] == made.summary.utility_bps
    assert row["mean_sum_rate_bps"] == pytest.approx(made.summary.mean_sum_rate_bps)
    assert row["sum_rate_variance_kbps2"] == pytest.approx(made.summary.sum_rate_variance_kbps2)
    assert row["jain"] == pytest.approx(made.summary.jain)
    assert row["user_rates_bps"] == pytest.approx([np.mean(made.user_rates_bps[u]) for u in scenario.user_ids])
    assert row["solve_ms"] > 0


@pytest.mark.parametrize("method", ["fast", "baseline1"])
def test_after_a_loss_the_rates_are_those_of_the_plan_and_then_of_the_replan(method: str) -> None:
    row = row_of(MINIMAL, {"method": method, "starts": 4, "failed": ["uav-2"], "at_slot": 3})
    first = plan(EXAMPLES["minimal"](), method=method, n_starts=4)
    second = replan(first, failed=["uav-2"], at_slot=3, n_starts=4)
    rates = [[*first.user_rates_bps[u][:3], *second.user_rates_bps[u]] for u in first.scenario.user_ids]
    assert row["mean_sum_rate_bps"] == pytest.approx(np.sum(rates, axis=0).mean())
    assert row["utility_bps"] == second.summary.utility_bps
    assert row["replan_ms"] > 0


def test_a_loss_is_half_way_unless_its_slot_is_given() -> None:
    half = row_of(MINIMAL, {"starts": 1, "failed": ["uav-1"]})
    assert half["utility_bps"] == row_of(MINIMAL, {"starts": 1, "failed": ["uav-1"], "at_slot": 2})["utility_bps"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"failed": ["uav-1", "uav-2"]}, "no UAV would be left"),
        ({"failed": ["uav-9"]}, "'uav-9' is not a UAV"),
        ({"failed": ["uav-1"], "at_slot": 9}, "at_slot: 9 must lie in 0..3"),
        ({"min_separation_m": 500.0}, "min_separation_m"),
    ],
)
def test_a_case_that_has_no_plan_says_why(settings: dict[str, Any], message: str) -> None:
    row = row_of(MINIMAL, {"starts": 1, **settings})
    assert row["status"] == "refused"
    assert message in row["error"]


def test_the_way_to_plan_is_read_from_the_settings() -> None:
    case = case_of(MINIMAL, {"method": "static", "starts": 2, "seed": 9, "failed": ["uav-1"], "at_slot": 1})
    assert (case.method, case.starts, case.seed, case.failed, case.at_slot) == ("static", 2, 9, ("uav-1",), 1)
