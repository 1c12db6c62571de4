"""Chart options."""

import json

import pytest

from skyfolio.api.dashboard import charts, plan_metrics
from skyfolio.planner import Plan


def test_a_sum_is_unknown_where_any_user_is() -> None:
    assert charts.total({"a": [1.0, 2.0, None], "b": [3.0, None]}, 4) == [4.0, None, None, None]
    assert charts.total({}, 2) == [None, None]


def test_sums_before_a_plan_are_in_the_slots_just_before_it_where_only_the_last_count(small_plan: Plan) -> None:
    past = {user: [1.0, 2.0] for user in small_plan.scenario.user_ids}
    later = small_plan.model_copy(update={"first_slot": 5, "achieved_rates_bps": past})
    users = len(past)
    assert plan_metrics.sums(later, 12)[:5] == [None, None, None, 1.0 * users, 2.0 * users]
    assert plan_metrics.sums(small_plan, 12)[0] == pytest.approx(
        sum(row[0] for row in small_plan.user_rates_bps.values())
    )


def test_the_timeline_shows_sums_users_losses_and_the_slot() -> None:
    made = charts.timeline(
        3,
        {"planned": [3e3, 3e3, 3e3], "achieved": [3e3, 1e3, None]},
        {"user-1": [3e3, 1e3, None]},
        cursor=1,
        lost={"uav-3": 1.4},
    )
    planned, achieved, users = made["series"]
    assert planned["data"] == [3.0, 3.0, 3.0]
    assert achieved["data"] == [3.0, 1.0, None]
    assert users["data"] == ((0, 0, 3.0), (1, 0, 1.0))  # tuples: NiceGUI wraps every list to watch it
    marks = planned["markLine"]["data"]
    assert [mark["xAxis"] for mark in marks] == [1, 1]
    assert "uav-3 lost" in marks[0]["label"]["formatter"]
    json.dumps(made)


def test_a_loss_after_the_last_slot_is_marked_at_its_end() -> None:
    made = charts.timeline(3, {"planned": [1.0] * 3}, {}, lost={"uav-1": 7.0})
    assert made["series"][0]["markLine"]["data"][0]["xAxis"] == 2


def test_plans_that_are_alike_share_one_label_on_the_trade_off() -> None:
    made = charts.trade_off([(-1.0, 0.0, 90.0), (-0.1, 3.0, 110.0), (0.0, 3.0, 110.0)], chosen=0.0)
    dots = made["series"][0]["data"]
    assert [dot["label"]["show"] for dot in dots] == [True, True, False]
    assert dots[1]["label"]["formatter"] == "-0.1 … 0"
    assert dots[2]["symbolSize"] > dots[1]["symbolSize"]


@pytest.mark.parametrize("n", [1, 3])
def test_compared_sums_have_one_line_each(n: int) -> None:
    made = charts.sums({"this": [1e3] * n, "other": [2e3] * n}, n)
    assert [one["name"] for one in made["series"]] == ["this", "other"]
    assert "visualMap" not in made


@pytest.mark.parametrize(("users", "every"), [(9, 1), (13, 2), (40, 5)])
def test_no_more_names_of_users_are_written_than_can_be_read(users: int, every: int) -> None:
    made = charts.timeline(2, {}, {f"old-town-{n}": [1e3, 2e3] for n in range(users)})
    label = made["yAxis"][1]["axisLabel"]
    assert label["interval"] == every - 1
    assert label["overflow"] == "truncate"
