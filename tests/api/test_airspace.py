"""Operations of one service keep out of each other's air, and know each other's ghosts."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skyfolio.api.client import ApiError
from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.airspace import SharedAirspace
from skyfolio.api.flights.flight import Flight as Flown
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.operation_views import State
from skyfolio.api.flights.traffic import Traffic
from skyfolio.api.flights.transition import Present, require_separated
from skyfolio.mavlink_bridge import OnEnd, Telemetry, east_north_to_geodetic
from skyfolio.mavlink_bridge.corridors import Corridor
from skyfolio.mavlink_bridge.ghosts import Airspace, Ghost
from skyfolio.mavlink_bridge.ghosts import Way as GhostWay
from skyfolio.mavlink_bridge.route import Route
from skyfolio.planner import EXAMPLES, Origin, Plan, ReplanError, Scenario, plan
from skyfolio.planner.scenario import RallyPoint
from tests.api.sky import flight

MINIMAL = EXAMPLES["minimal"]().with_changes(slots=30, altitude_m=8.0)
ORIGIN = MINIMAL.origin
NORTH = Origin(lat_deg=ORIGIN.lat_deg + 0.0009, lon_deg=ORIGIN.lon_deg)
"""About 100 m north of it."""


class Field:
    """A fleet whose vehicles are where they are told to be; heights of homes are known, times stand still."""

    def __init__(self, **systems: int) -> None:
        self.systems = {name.replace("_", "-"): system for name, system in systems.items()}
        self.at_deg: dict[int, tuple[float, float]] = {}
        self.down: set[int] = set(self.systems.values())
        self.link = SimpleNamespace(telemetry=self._telemetry, home_deg=lambda _system: None)
        self.time_s = 1000.0

    uav_ids = property(lambda self: sorted(self.systems))

    def system_of(self, uav: str) -> int:
        return self.systems[uav]

    def is_heard(self, _system: int) -> bool:
        return True

    def is_down(self, system: int) -> bool:
        return system in self.down

    def now_s(self) -> float:
        return self.time_s

    def height_amsl_m(self, _system: int, altitude_m: float) -> float:
        return 400.0 + altitude_m

    def _telemetry(self, system: int) -> Telemetry | None:
        place = self.at_deg.get(system)
        return None if place is None else cast("Telemetry", SimpleNamespace(place_deg=place))


def flight_of(made: Plan, field: Field, *, now_s: float | None = None, lost: tuple[str, ...] = ()) -> Any:
    """What a shared airspace asks a flight for."""
    return SimpleNamespace(
        systems={uav: field.systems[uav] for uav in made.scenario.uav_ids},
        first_plan=made,
        plan=made,
        lost=dict.fromkeys(lost, 0.0),
        elapsed_s=lambda: now_s,
        now_s=lambda: now_s or 0.0,
        positions_m=dict,
        home_m=lambda uav: made.scenario.uav(uav).start_m,
        landing_m=lambda uav: (made.scenario.uav(uav).start_m, *made.scenario.rally_m),
        guidance=SimpleNamespace(airspace=Airspace(), may_fly=lambda _uav: (), options=GuidanceOptions()),
        traffic=None,
    )


def along(made: Plan, *path: tuple[float, float], **changes: Any) -> Plan:
    """A plan of one UAV with this path."""
    uav = made.scenario.uav_ids[0]
    scenario = made.scenario.with_changes(slots=len(path), **changes)
    return made.model_copy(update={"trajectories_m": {uav: list(path)}, "scenario": scenario})


@pytest.fixture(scope="module")
def first() -> Plan:
    return plan(one(0))


@pytest.fixture(scope="module")
def second() -> Plan:
    return plan(one(1))


def one(number: int, *users: str, **changes: Any) -> Scenario:
    """One of the two UAVs, for these users only."""
    chosen = tuple(user for user in MINIMAL.users if not users or user.id in users)
    return MINIMAL.with_changes(uavs=(MINIMAL.uavs[number],), users=chosen, **changes)


def refusal(airspace: SharedAirspace, plan: Plan, field: Field) -> str | None:
    systems = {uav: field.systems[uav] for uav in plan.scenario.uav_ids}
    try:
        asyncio.run(airspace.require_clear(plan, systems, GuidanceOptions()))
    except ConflictError as error:
        return str(error)
    return None


def test_a_plan_that_crosses_the_sweep_of_another_operation_is_refused_by_name(first: Plan, second: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    airspace = SharedAirspace(cast("Fleet", field))
    airspace.enter("op-1", cast("Flown", flight_of(along(first, (0.0, 0.0), (100.0, 0.0)), field)))
    crosses = along(second, (50.0, -50.0), (50.0, 50.0))
    reason = refusal(airspace, crosses, field)
    assert reason == "separation: 'uav-2' could come within 0.0 m of 'uav-1' of operation 'op-1'; 4 m are asked for"
    assert refusal(airspace, along(second, (50.0, -50.0), (50.0, 50.0), altitude_m=20.0), field) is None
    assert "20 m" in (refusal(airspace, along(second, (0.0, 15.0), (90.0, 15.0), min_separation_m=20.0), field) or "")
    airspace.leave("op-1")
    assert refusal(airspace, crosses, field) is None


def test_what_was_flown_already_is_free_again_and_other_origins_are_reckoned_with(first: Plan, second: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    field.down.clear()
    airspace = SharedAirspace(cast("Fleet", field))
    sweep = along(first, (0.0, 0.0), (50.0, 0.0), (100.0, 0.0), (150.0, 0.0))
    airspace.enter("op-1", cast("Flown", flight_of(sweep, field, now_s=11.0)))
    assert refusal(airspace, along(second, (20.0, -30.0), (20.0, 30.0)), field) is None
    assert refusal(airspace, along(second, (120.0, -30.0), (120.0, 30.0)), field)
    assert refusal(airspace, along(second, (120.0, -130.0), (120.0, -70.0), origin=NORTH), field)
    assert refusal(airspace, along(second, (120.0, -30.0), (120.0, 30.0), origin=NORTH), field) is None


def test_one_that_hovers_for_no_operation_keeps_its_place(first: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    airspace = SharedAirspace(cast("Fleet", field))
    field.at_deg[2] = east_north_to_geodetic(ORIGIN, 50.0, 1.0)
    crosses = along(first, (0.0, 0.0), (100.0, 0.0))
    assert refusal(airspace, crosses, field) is None  # on the ground
    field.down = {1}
    assert "of 'uav-2' of no operation" in (refusal(airspace, crosses, field) or "")


def ghost(uav: str) -> Ghost:
    route = Route([(0.0, 0.0), (50.0, 0.0)], 5.0)
    return Ghost(
        uav_id=uav,
        lost_at_s=10.0,
        last_seen_m=(50.0, 0.0),
        ways=(GhostWay(route=route, began_s=0.0),),
        home_m=(0.0, 0.0),
        deadline_s=600.0,
    )


def test_the_ways_to_rally_points_of_a_ghost_are_closed_to_other_operations(first: Plan, second: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    field.down.clear()
    airspace = SharedAirspace(cast("Fleet", field))
    one = flight_of(first, field, now_s=20.0)
    airspace.enter("op-1", cast("Flown", one))
    one.guidance.airspace.reserve(ghost("uav-1"))
    crosses = along(second, (120.0, -30.0), (120.0, 30.0))
    assert refusal(airspace, crosses, field) is None
    one.guidance.airspace.release("uav-1")
    one.guidance.airspace.reserve(replace(ghost("uav-1"), rally_m=((200.0, 0.0),)))
    assert refusal(airspace, crosses, field)
    airspace.leave("op-1")  # the ghost stays
    assert refusal(airspace, crosses, field)


def test_a_plan_that_returns_reserves_the_ways_to_rally_points(first: Plan, second: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    field.down.clear()
    airspace = SharedAirspace(cast("Fleet", field))
    airspace.enter("op-1", cast("Flown", flight_of(along(first, (0.0, 0.0), (100.0, 0.0)), field)))
    rally = (RallyPoint(position_m=(50.0, -60.0)),)
    returns = along(second, (20.0, 40.0), (50.0, 40.0), rally_points=rally)
    systems = {"uav-2": 2}
    asyncio.run(airspace.require_clear(returns, systems, GuidanceOptions(at_end=OnEnd.LAND)))
    with pytest.raises(ConflictError, match="'uav-2' could come within"):
        asyncio.run(airspace.require_clear(returns, systems, GuidanceOptions(at_end=OnEnd.RETURN)))


def test_a_ghost_of_one_operation_is_a_ghost_to_all_in_their_time_and_place(first: Plan, second: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    field.down.clear()
    airspace = SharedAirspace(cast("Fleet", field))
    one, other = flight_of(first, field, now_s=20.0), flight_of(second, field, now_s=5.0)
    other.first_plan = along(second, (0.0, 0.0), (1.0, 0.0), origin=NORTH)
    airspace.enter("op-1", cast("Flown", one))
    airspace.enter("op-2", cast("Flown", other))
    one.guidance.airspace.reserve(ghost("uav-1"))
    (seen,) = other.guidance.airspace.elsewhere()
    assert (seen.lost_at_s, seen.ways[0].began_s, seen.deadline_s) == (-5.0, -15.0, 585.0)
    assert seen.last_seen_m == pytest.approx((50.0, -100.0), abs=0.5)
    below = {"uav-2": [(50.0, -110.0), (50.0, -90.0)]}
    assert other.guidance.airspace.conflicts(below, [5.0, 10.0], 4.0)
    assert not one.guidance.airspace.elsewhere()
    assert dict(other.guidance.airspace.ghosts) == {}  # it is not its own to release


def test_a_ghost_outlives_its_operation_until_it_is_seen_on_the_ground(first: Plan, second: Plan) -> None:
    field = Field(uav_1=1, uav_2=2)
    field.down.clear()
    airspace = SharedAirspace(cast("Fleet", field))
    one, other = flight_of(first, field, now_s=20.0), flight_of(second, field, now_s=5.0)
    airspace.enter("op-1", cast("Flown", one))
    one.guidance.airspace.reserve(ghost("uav-1"))
    airspace.leave("op-1")
    airspace.enter("op-2", cast("Flown", other))
    (seen,) = other.guidance.airspace.elsewhere()
    assert seen.lost_at_s == -5.0
    same_uav = along(first, (0.0, 0.0), (1.0, 0.0))
    assert refusal(airspace, same_uav, field) is None  # its own ghost does not keep it on the ground
    field.down = {1}
    assert not other.guidance.airspace.elsewhere()


def test_a_change_in_flight_keeps_out_of_the_air_of_others_unless_the_plan_in_force_is_there_too(first: Plan) -> None:
    wall = Corridor(uav_id="x", owner="operation 'op-9'", required_m=4.0, level_m=[(60.0, -90.0), (60.0, 90.0)])

    def corridor(uav: str, level_m: Any, altitude_m: float) -> Corridor:
        return Corridor(uav_id=uav, owner="us", required_m=4.0, level_m=level_m, height_m=altitude_m)

    traffic = cast("Traffic", SimpleNamespace(others=lambda: [wall], corridor=corridor))
    stays, enters = along(first, (0.0, 0.0), (40.0, 0.0), (40.0, 0.0)), along(first, (0.0, 0.0), (40.0, 0.0), (70.0, 0))
    live = {"uav-1": (0.0, 0.0)}
    require_separated({"uav-1": stays}, Present(1.0, live, stays, Airspace(), traffic))
    with pytest.raises(ReplanError, match=r"transition: 'uav-1' could come within 0\.0 m of 'x' of operation 'op-9'"):
        require_separated({"uav-1": enters}, Present(1.0, live, stays, Airspace(), traffic))
    require_separated({"uav-1": enters}, Present(1.0, live, enters, Airspace(), traffic))


def test_an_operation_into_the_air_of_another_or_of_a_hovering_one_is_refused() -> None:
    with flight(MINIMAL) as flown:
        mine = flown.client.plan(one(0))
        into = flown.client.plan(one(1, "user-1", "user-2"))
        beside = flown.client.plan(one(1, "user-3", "user-4"))
        operation_id = flown.client.fly(mine.id).id
        with pytest.raises(ApiError, match=f"409 separation: 'uav-2' .* of 'uav-1' of operation '{operation_id}'"):
            flown.client.fly(into.id)
        flown.until(operation_id, lambda view: view.state == State.FLYING)
        with pytest.raises(ApiError, match=f"of 'uav-1' of operation '{operation_id}'"):
            flown.client.fly(into.id)
        second = flown.client.fly(beside.id).id
        flown.until(second, lambda view: view.state == State.FLYING)
        flown.client.order("land", ["uav-2"])
        flown.client.order("hold", ["uav-1"])
        flown.wait(lambda: not flown.client.vehicles()[1].armed)
        with pytest.raises(ApiError, match="of 'uav-1' of no operation"):
            flown.client.fly(into.id)
        flown.client.order("land")
