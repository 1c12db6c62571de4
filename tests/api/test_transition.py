"""Where survivors will be, and transitions that are refused."""

import pytest

from api.transition import begun_at, expected_position
from planner import EXAMPLES, Plan, plan


@pytest.fixture(scope="module")
def eastward() -> Plan:
    """uav-1 flies 20 m east in each 5 s slot; it can do 25 m."""
    made = plan(EXAMPLES["minimal"]())
    path = [(50.0, 50.0), (70.0, 50.0), (90.0, 50.0), (110.0, 50.0)]
    return made.model_copy(update={"trajectories_m": {**made.trajectories_m, "uav-1": path}})


def test_a_uav_on_schedule_is_expected_where_the_plan_has_it(eastward: Plan) -> None:
    assert expected_position(eastward, "uav-1", (58.0, 50.0), 2.0, 2) == pytest.approx((90.0, 50.0))


def test_a_late_uav_is_expected_only_as_far_as_it_can_fly(eastward: Plan) -> None:
    assert expected_position(eastward, "uav-1", (40.0, 50.0), 8.0, 2) == pytest.approx((50.0, 50.0))


def test_a_uav_off_its_line_first_returns_to_it(eastward: Plan) -> None:
    assert expected_position(eastward, "uav-1", (70.0, 53.0), 4.0, 2) == pytest.approx((90.0, 50.0))


def test_no_time_left_means_no_way_to_go(eastward: Plan) -> None:
    assert expected_position(eastward, "uav-1", (61.0, 49.0), 10.0, 2) == (61.0, 49.0)


def test_a_mission_begins_where_the_uav_really_is(eastward: Plan) -> None:
    assert begun_at(eastward, "uav-1", (51.0, 52.0)).trajectories_m["uav-1"][0] == (51.0, 52.0)
    assert eastward.trajectories_m["uav-1"][0] == (50.0, 50.0)
