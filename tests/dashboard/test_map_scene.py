"""What the map and the table show."""

import json

import pytest
from nicegui import json as page_json

from skyfolio.api.dashboard import map_scene
from skyfolio.api.dashboard.map_scene import Spot
from skyfolio.api.dashboard.schedule import Slip
from skyfolio.api.dashboard.views import Operation, Vehicle
from skyfolio.planner import EXAMPLES, Changes, Plan, Scenario, User, replan
from skyfolio.planner.plans import Summary


def vehicle(**changes: object) -> Vehicle:
    told = {"uav_id": "uav-1", "system_id": 1, "armed": True, "mode": "mission", "silent_for_s": 0.4, **changes}
    return Vehicle.model_validate(told)


@pytest.mark.parametrize(
    ("said", "lost", "state", "level"),
    [
        (vehicle(), False, "MISSION", "ok"),
        (vehicle(mode="hold"), False, "HOLD", "warn"),
        (vehicle(link="stale", silent_for_s=3.4), False, "STALE", "warn"),
        (vehicle(link="lost", silent_for_s=9.0), False, "LOST", "alarm"),
        (vehicle(), True, "LOST", "alarm"),
        (vehicle(armed=False, mode="hold"), False, "ON GROUND", "idle"),
        (vehicle(mode=None, armed=None), False, "NOT HEARD", "warn"),
        (None, False, "NOT HEARD", "warn"),
    ],
)
def test_states_are_named_as_ground_stations_do(said: Vehicle | None, lost: bool, state: str, level: str) -> None:
    found, _, worth = map_scene.state_of(said, lost=lost, flying=True)
    assert (found, worth) == (state, level)


def test_one_that_is_lost_and_heard_says_what_was_seen_and_a_silent_one_for_how_long() -> None:
    seen = "in mode 'return', system status 5"
    assert map_scene.state_of(vehicle(condition_cause=seen), lost=True, flying=True)[1] == seen
    silent = vehicle(link="lost", silent_for_s=7.2, condition_cause="stale")
    assert map_scene.state_of(silent, lost=True, flying=True)[1] == "silent for 7.2 s"


def test_the_table_puts_what_is_urgent_first(flying: Operation) -> None:
    spots = [Spot(uav_id="uav-1", at_m=(1.0, 2.0), vehicle=vehicle()), Spot(uav_id="uav-2", at_m=None, lost=True)]
    rows = map_scene.rows(spots, flying)
    assert [row["id"] for row in rows] == ["uav-2", "uav-1"]
    assert rows[1]["cause"] == ""
    assert map_scene.rows([Spot(uav_id="uav-1", at_m=None, vehicle=vehicle(mode="hold"))], flying)[0]["cause"]


@pytest.mark.parametrize("slip", [None, Slip(1.5, None), Slip(2.5, -0.5)])
def test_rows_can_be_sent_to_the_page(slip: Slip | None, flying: Operation) -> None:
    spot = Spot(uav_id="uav-1", at_m=(1.0, 2.0), vehicle=vehicle(), slip=slip)
    rows = [*map_scene.rows([spot], flying), map_scene.recorded_row(0, "uav-1", lost=False, slip=slip)]
    sent = json.loads(page_json.dumps(rows))
    assert [row["slip"] for row in sent] == [None if slip is None else list(slip)] * 2


def test_links_carry_all_bandwidth_of_the_slot(small_plan: Plan) -> None:
    for slot in range(4):
        links = map_scene.links(small_plan, slot)
        for uav in small_plan.scenario.uavs:
            used = sum(hz for _, served_by, hz in links if served_by == uav.id)
            assert used <= uav.bandwidth_hz * (1 + 1e-9)
        assert {user for user, _, _ in links} == set(small_plan.scenario.user_ids)


def test_a_user_that_gets_nothing_of_what_was_promised_is_cut_off(small_plan: Plan) -> None:
    promised = {user: row[1] for user, row in small_plan.user_rates_bps.items()}
    served = [user for user, rate in promised.items() if rate > map_scene.WORTH_BPS]
    assert served
    assert map_scene.cut_off(small_plan, 1, promised) == []
    assert map_scene.cut_off(small_plan, 1, dict.fromkeys(promised, 0.0)) == served
    assert map_scene.cut_off(small_plan, 1, dict.fromkeys(promised)) == []


def test_a_plan_of_fewer_users_draws_its_links_and_rates_to_its_own_users(small_plan: Plan) -> None:
    fewer = replan(small_plan, changes=Changes(users_left=("user-1",)), at_slot=1)
    frame = map_scene.planned_frame(fewer, 2)
    assert {user for user, _, _ in frame["links"]} == set(frame["rates"]) == {"user-2", "user-3", "user-4"}
    assert frame["rates"] == {user: row[1] for user, row in fewer.user_rates_bps.items()}
    beside_all = map_scene.frame([], fewer, 2, dict.fromkeys(fewer.user_rates_bps, 0.0), promise=small_plan)
    assert "user-1" not in beside_all["cut"]


def test_the_air_of_a_lost_uav_is_its_rest_of_the_route_and_the_way_home(small_plan: Plan) -> None:
    air = map_scene.reserved(small_plan, ["uav-2", "uav-9"], from_slot=2)
    assert air == {"uav-2": [*small_plan.trajectories_m["uav-2"][2:], (150.0, 50.0)]}


def test_scene_and_frames_are_plain_json(small_plan: Plan) -> None:
    scene = map_scene.scene(small_plan.scenario, [("current", small_plan)])
    frame = map_scene.planned_frame(small_plan, 3, lost_at_m={"uav-7": (1.0, 2.0)})
    assert json.loads(json.dumps([scene, frame]))[1]["uavs"][-1]["lost"] is True
    assert [one["id"] for one in frame["uavs"]] == ["uav-1", "uav-2", "uav-7"]
    assert frame["rates"] == {user: row[3] for user, row in small_plan.user_rates_bps.items()}
    assert map_scene.scene(small_plan.scenario)["rate_max"] is None


def test_a_scenario_that_breaks_rules_is_sketched_all_the_same(small_plan: Plan) -> None:
    data = small_plan.scenario.model_dump(mode="json")
    data["uavs"][0]["start_m"] = [-900.0, 0.0]
    scene, frame = map_scene.sketch(data)
    assert frame["uavs"][0]["e"] == -900.0
    assert scene["users"][0] == ("user-1", 20.0, 50.0)


def test_where_users_of_a_draft_will_go_is_sketched(minimal: Scenario) -> None:
    data = minimal.model_dump(mode="json")
    data["slots"], data["slot_duration_s"] = 5, 2.0
    data["users"] = [
        {"id": "stays", "position_m": [1.0, 2.0]},
        {"id": "drives", "position_m": [1.0, 2.0], "velocity_mps": [1.0, -0.5]},
        {"id": "walks", "position_m": [1.0, 2.0], "positions_m": [[1.0, 2.0], [3.0, 4.0]]},
    ]
    scene, _ = map_scene.sketch(data)
    assert scene["user_tracks"] == {"drives": [(1.0, 2.0), (9.0, -2.0)], "walks": [[1.0, 2.0], [3.0, 4.0]]}


def test_slip_is_only_told_while_the_plan_is_flown(small_plan: Plan) -> None:
    at = small_plan.trajectories_m["uav-1"][1]
    slip = map_scene.slip_of(small_plan, "uav-1", 5.0, at)
    assert slip is not None
    assert slip.off_m == pytest.approx(0.0, abs=0.5)
    assert map_scene.slip_of(small_plan, "uav-1", 21.0, at) is None
    assert map_scene.slip_of(small_plan, "uav-9", 5.0, at) is None
    assert map_scene.slip_of(small_plan, "uav-1", None, at) is None


def test_users_that_move_are_drawn_where_they_are_in_the_slot(two_slot_plan_of_walkers: Plan) -> None:
    plan = two_slot_plan_of_walkers
    assert map_scene.scene(plan.scenario)["user_tracks"] == {"walks": [(10.0, 10.0), (15.0, 10.0)]}
    for slot, there in ((4, {"walks": (10.0, 10.0, 1.0)}), (5, {"walks": (15.0, 10.0, 3.5)})):
        assert map_scene.planned_frame(plan, slot)["users"] == there


def test_who_is_not_there_is_pale_and_what_users_ask_for_is_told(two_slot_plan_of_walkers: Plan) -> None:
    plan = two_slot_plan_of_walkers
    walks, stays = plan.scenario.users
    late = stays.model_copy(update={"arrives_at_slot": 1, "demand_bps": 500.0})
    plan = plan.model_copy(update={"scenario": plan.scenario.with_changes(users=(walks, late))})
    assert [map_scene.planned_frame(plan, slot)["absent"] for slot in (4, 5)] == [["stays"], []]
    assert map_scene.planned_frame(plan, 5)["asked"] == {"stays": 500.0}


@pytest.fixture
def two_slot_plan_of_walkers() -> Plan:
    """A plan by hand that begins in slot 4 of its operation: one UAV, a user that moves and one that does not."""
    walks = User(id="walks", position_m=(10.0, 10.0), velocity_mps=(1.0, 0.0), uncertainty_m=1.0, uncertainty_mps=0.5)
    scenario = EXAMPLES["minimal"]()
    stays = scenario.users[0].model_copy(update={"id": "stays"})
    scenario = scenario.with_changes(uavs=scenario.uavs[:1], users=(walks, stays), slots=2)
    rows = {"walks": [5.0, 5.0], "stays": [0.0, 0.0]}
    return Plan(
        id="by-hand",
        method="by hand",
        first_slot=4,
        scenario=scenario,
        trajectories_m={"uav-1": [(50.0, 50.0), (50.0, 50.0)]},
        association={"walks": ["uav-1"] * 2, "stays": ["uav-1"] * 2},
        bandwidth_hz=rows,
        user_rates_bps=rows,
        achieved_rates_bps={},
        summary=Summary.steady(5.0),
    )
