"""Where survivors will be, and transitions that are refused."""

import pytest

from skyfolio.api.flights.transition import (
    Present,
    begun_at,
    expected_altitude,
    expected_position,
    require_in_reach,
    require_over_ground,
    require_separated,
    way_into,
)
from skyfolio.mavlink_bridge.ghosts import Airspace, Ghost, Way
from skyfolio.mavlink_bridge.route import Route
from skyfolio.planner import EXAMPLES, Plan, ReplanError, plan
from skyfolio.planner.terrain import Terrain


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


def climbing(made: Plan, *, terrain: Terrain | None = None) -> Plan:
    """The plan with uav-1 climbing 6 m in each 5 s slot; it can do 7.5 m."""
    limits = {"altitude_min_m": 30.0, "altitude_max_m": 90.0, "terrain": terrain}
    altitudes = {uav: [40.0, 46.0, 52.0, 58.0] for uav in made.trajectories_m}
    scenario = made.scenario.model_copy(update=limits)
    return made.model_copy(update={"scenario": scenario, "altitudes_m": altitudes})


@pytest.mark.parametrize(
    ("live_m", "now_s", "expected_m"),
    [
        (42.4, 2.0, 52.0),  # on plan
        (41.6, 2.0, 52.0),  # a little late: it catches up
        (30.0, 2.0, 42.0),  # it climbs as fast as it can, 12 m in 8 s
        (39.4, 2.0, 52.0),  # short of it by less than a metre
        (80.0, 2.0, 68.0),  # it comes down as fast as it can
        (41.0, 10.0, 41.0),
    ],
)
def test_a_uav_is_expected_as_high_as_it_can_climb(
    eastward: Plan, live_m: float, now_s: float, expected_m: float
) -> None:
    assert expected_altitude(climbing(eastward), "uav-1", live_m, now_s, 2) == pytest.approx(expected_m)


def test_a_plan_that_a_survivor_is_too_low_for_is_refused(eastward: Plan) -> None:
    made, live = climbing(eastward), {uav: path[0] for uav, path in eastward.trajectories_m.items()}
    require_in_reach(made, live, 5.0)
    require_in_reach(made, live, 5.0, {"uav-1": 37.0, "uav-2": 80.0})
    with pytest.raises(ReplanError, match=r"transition: 'uav-1' is 11.0 m too low with 5.0 s to go"):
        require_in_reach(made, live, 5.0, {"uav-1": 35.0})
    require_in_reach(eastward, live, 5.0, {"uav-1": 0.0})  # a plan without altitudes


def test_a_mission_begins_where_the_uav_really_is(eastward: Plan) -> None:
    assert begun_at(eastward, "uav-1", (51.0, 52.0)).trajectories_m["uav-1"][0] == (51.0, 52.0)
    assert eastward.trajectories_m["uav-1"][0] == (50.0, 50.0)


def moved(made: Plan, first_slot: int = 0, **paths: list[tuple[float, float]]) -> Plan:
    """The plan with other paths, in 5 s slots from `first_slot` of the operation on; 4 m apart is asked for."""
    slots = len(next(iter(paths.values())))
    scenario = made.scenario.model_copy(update={"slots": slots})
    named = {uav.replace("_", "-"): path for uav, path in paths.items()}
    return made.model_copy(update={"trajectories_m": named, "scenario": scenario, "first_slot": first_slot})


def test_the_way_into_a_plan_is_straight_and_even_and_then_the_plan(eastward: Plan) -> None:
    later = moved(eastward, 1, uav_1=[(0.0, 0.0), (30.0, 0.0), (50.0, 0.0)])
    way = way_into(later, "uav-1", (0.0, 0.0), 4.0, first_slot=1, slots=4)
    assert way == [pytest.approx((5.0, 0.0)), (30.0, 0.0), (50.0, 0.0), (50.0, 0.0)]


def test_a_change_that_keeps_apart_now_and_crosses_later_is_refused(eastward: Plan) -> None:
    live = {"uav-1": (0.0, 0.0), "uav-2": (0.0, 20.0)}
    now = Present(1.0, live, eastward, Airspace())
    along = moved(
        eastward, uav_1=[(0.0, 0.0), (20.0, 0.0), (40.0, 0.0)], uav_2=[(0.0, 20.0), (20.0, 20.0), (40.0, 20.0)]
    )
    require_separated(dict.fromkeys(live, along), now)
    across = moved(
        eastward, uav_1=[(0.0, 0.0), (20.0, 0.0), (40.0, 20.0)], uav_2=[(0.0, 20.0), (20.0, 20.0), (40.0, 0.0)]
    )
    with pytest.raises(ReplanError, match=r"'uav-1' and 'uav-2' would come within 0.00 m at 7.5 s"):
        require_separated(dict.fromkeys(live, across), now)
    with pytest.raises(ReplanError, match="'uav-1' and 'uav-2' would come within"):  # one keeps its old plan
        require_separated({"uav-1": along, "uav-2": moved(eastward, uav_2=[(0.0, 20.0), (20.0, 2.0)])}, now)


def test_nobody_is_sent_into_the_air_of_a_lost_uav_that_it_would_stay_out_of(eastward: Plan) -> None:
    air = Airspace()
    rests = Route([(20.0, 30.0), (20.0, 30.0)], 5.0)
    air.reserve(
        Ghost(
            uav_id="uav-2",
            lost_at_s=0.0,
            last_seen_m=(20.0, 30.0),
            ways=(Way(route=rests, began_s=0.0),),
            home_m=None,
            deadline_s=600.0,
        )
    )
    live = {"uav-1": (0.0, 0.0)}
    away = moved(eastward, uav_1=[(0.0, 0.0), (20.0, 0.0), (20.0, 30.0)])
    through = moved(eastward, uav_1=[(0.0, 0.0), (20.0, 30.0), (20.0, 30.0)])
    require_separated({"uav-1": away}, Present(1.0, live, away, air))  # later it flies above
    with pytest.raises(ReplanError, match=r"of 'uav-2' at"):
        require_separated({"uav-1": through}, Present(1.0, live, away, air))
    require_separated({"uav-1": through}, Present(1.0, live, through, air))  # no worse than flying on
    air.release("uav-2")
    require_separated({"uav-1": through}, Present(1.0, live, away, air))


def test_a_first_leg_that_comes_too_near_to_the_ground_is_refused() -> None:
    flat = plan(EXAMPLES["minimal"]())
    ridge = Terrain(  # 60 m high at 100 m east, level at 400 m from 150 m on and up to 50 m
        south_west_m=(0.0, 0.0), spacing_m=50.0, heights_m=((400.0, 400.0, 460.0, 400.0, 400.0, 400.0, 400.0),) * 7
    )
    scenario = flat.scenario.model_copy(update={"terrain": ridge, "clearance_m": 20.0, "slots": 2})
    paths = {"uav-1": [(50.0, 50.0), (150.0, 50.0)]}
    over = flat.model_copy(
        update={"scenario": scenario, "trajectories_m": paths, "altitudes_m": {"uav-1": [480.0] * 2}}
    )
    require_over_ground("uav-1", over, (50.0, 50.0), 480.0, 1.0)
    require_over_ground("uav-1", over, (50.0, 50.0), 479.5, 1.0)  # vehicles are not that exact
    require_over_ground("uav-1", over, (50.0, 50.0), None, 1.0)
    require_over_ground("uav-1", over, (100.0, 50.0), 475.0, 1.0)  # too low already, and it only gets better
    with pytest.raises(ReplanError, match=r"transition: 'uav-1' would come within 10\.0 m of the ground on its"):
        require_over_ground("uav-1", over, (50.0, 50.0), 470.0, 1.0)
    low = over.model_copy(update={"altitudes_m": {"uav-1": [480.0, 470.0]}})
    with pytest.raises(ReplanError, match=r"20 m are asked for"):
        require_over_ground("uav-1", low, (50.0, 50.0), 480.0, 1.0)
    require_over_ground("uav-1", flat, (50.0, 50.0), 1.0, 1.0)
