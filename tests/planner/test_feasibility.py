"""The independent check finds each kind of violation, and says where."""

from typing import Any

import pytest

from skyfolio.planner import EXAMPLES, InfeasiblePlanError, Plan, Scenario, Summary, violations
from skyfolio.planner.feasibility import require_feasible
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon

NOTHING = Summary.steady()


def hovering(scenario: Scenario, **changes: Any) -> Plan:
    """Everybody hovers; user k is served by UAV k mod U with a thousandth of its band."""
    n = scenario.slots
    fields: dict[str, Any] = {
        "id": "by-hand",
        "method": "by hand",
        "scenario": scenario,
        "trajectories_m": {uav.id: [uav.start_m] * n for uav in scenario.uavs},
        "association": {u.id: [scenario.uav_ids[k % len(scenario.uavs)]] * n for k, u in enumerate(scenario.users)},
        "bandwidth_hz": {user.id: [10.0] * n for user in scenario.users},
        "user_rates_bps": {user.id: [20.0] * n for user in scenario.users},
        "summary": NOTHING,
    }
    return Plan(**{**fields, **changes})


def found(plan: Plan) -> list[tuple[str, str]]:
    return [(one.constraint, one.where) for one in violations(plan)]


def moved(scenario: Scenario, uav: str, *path: tuple[float, float]) -> Plan:
    return hovering(scenario, trajectories_m={**hovering(scenario).trajectories_m, uav: list(path)})


MINIMAL = EXAMPLES["minimal"]()
UAVS = MINIMAL.uavs


def test_a_hovering_plan_is_feasible() -> None:
    assert violations(hovering(MINIMAL)) == []
    assert require_feasible(hovering(MINIMAL)).id == "by-hand"


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"association": {}}, "association"),
        ({"bandwidth_hz": {"user-1": [1.0]}}, "bandwidth_hz"),
        ({"trajectories_m": {"uav-1": [(50.0, 50.0)], "uav-2": [(150.0, 50.0)] * 4}}, "trajectories_m.uav-1"),
    ],
)
def test_tables_of_the_wrong_shape_are_found_before_anything_else(changes: dict[str, Any], where: str) -> None:
    assert ("shape", where) in found(hovering(MINIMAL, **changes))
    assert {constraint for constraint, _ in found(hovering(MINIMAL, **changes))} == {"shape"}


def test_numbers_must_be_finite() -> None:
    rates = {**hovering(MINIMAL).user_rates_bps, "user-1": [1.0, 2.0, 3.0, 4.0]}
    broken = hovering(MINIMAL, user_rates_bps=rates)
    broken.user_rates_bps["user-1"][2] = float("nan")
    assert found(broken) == [("shape", "plan")]


def test_an_unknown_server_breaks_6a() -> None:
    association = {**hovering(MINIMAL).association, "user-2": ["uav-2", "uav-9", "uav-2", "uav-2"]}
    assert found(hovering(MINIMAL, association=association)) == [("6a", "user-2 slot 1")]


def test_a_server_that_has_left_breaks_6a() -> None:
    leaving = MINIMAL.with_changes(uavs=(UAVS[0].model_copy(update={"leaves_at_slot": 3}), UAVS[1]))
    assert found(hovering(leaving)) == [("6a", "user-1 slot 3"), ("6a", "user-3 slot 3")]


def test_too_much_or_negative_bandwidth_breaks_6c() -> None:
    bandwidth = {**hovering(MINIMAL).bandwidth_hz, "user-1": [9_990.1, 9_990.0, -1.0, 0.0]}
    assert found(hovering(MINIMAL, bandwidth_hz=bandwidth)) == [("6c", "user-1 slot 2"), ("6c", "uav-1 slot 0")]


def test_a_step_beyond_d_max_breaks_6d() -> None:
    at = (50.0, 50.0)
    assert found(moved(MINIMAL, "uav-1", at, (75.0, 50.0), (75.0, 75.1), (75.0, 75.1))) == [("6d", "uav-1 slot 1")]


def test_coming_too_close_breaks_6e_at_a_slot_and_between_slots() -> None:
    quick = MINIMAL.with_changes(
        uavs=tuple(
            uav.model_copy(update={"max_speed_mps": 40.0, "start_m": (x, 50.0)})
            for uav, x in zip(UAVS, (50.0, 150.0), strict=True)
        )
    )
    meeting = moved(quick, "uav-1", (50.0, 50.0), (146.1, 50.0), (50.0, 50.0), (50.0, 50.0))
    assert found(meeting) == [("6e", "uav-1 and uav-2 in slot 0"), ("6e", "uav-1 and uav-2 in slot 1")]
    passing = moved(quick, "uav-1", (50.0, 50.0), (199.0, 50.0), (199.0, 99.0), (199.0, 99.0))
    assert found(passing) == [("6e", "uav-1 and uav-2 in slot 0")]
    touching = moved(quick, "uav-1", (50.0, 50.0), (146.0, 50.0), (50.0, 50.0), (50.0, 50.0))
    assert found(touching) == []


def test_uavs_that_have_left_are_no_longer_in_the_way() -> None:
    scenario = MINIMAL.with_changes(
        uavs=(UAVS[0], UAVS[1].model_copy(update={"leaves_at_slot": 1, "start_m": (75.0, 50.0)}))
    )
    served = {user: ["uav-1"] * 4 for user in scenario.user_ids}
    path = [(50.0, 50.0), (60.0, 50.0), (75.0, 50.0), (75.0, 50.0)]
    table = {"uav-1": path, "uav-2": [(75.0, 50.0)] * 4}
    assert found(hovering(scenario, association=served, trajectories_m=table)) == []


def test_leaving_the_area_breaks_6f() -> None:
    assert found(moved(MINIMAL, "uav-2", (150.0, 50.0), (170.0, 50.0), (190.0, 50.0), (200.1, 50.0))) == [
        ("6f", "uav-2 slot 3")
    ]


def test_another_start_breaks_6g() -> None:
    assert found(moved(MINIMAL, "uav-1", *[(50.0, 50.5)] * 4)) == [("6g", "uav-1")]


def test_missing_the_end_position_is_found_in_the_last_slot_of_the_uav() -> None:
    early = MINIMAL.with_changes(
        uavs=(UAVS[0].model_copy(update={"end_m": (60.0, 50.0), "leaves_at_slot": 3}), UAVS[1])
    )
    served = {user: ["uav-2"] * 4 for user in early.user_ids}
    right = [(50.0, 50.0), (55.0, 50.0), (60.0, 50.0), (60.0, 50.0)]
    late = [(50.0, 50.0), (50.0, 50.0), (55.0, 50.0), (60.0, 50.0)]
    for path, expected in ((right, []), (late, [("end", "uav-1")])):
        table = {**hovering(early).trajectories_m, "uav-1": path}
        assert found(hovering(early, association=served, trajectories_m=table)) == expected


def test_less_than_the_minimum_rate_is_found_unless_the_plan_admits_it() -> None:
    demanding = MINIMAL.with_changes(
        users=(*MINIMAL.users[:3], MINIMAL.users[3].model_copy(update={"min_rate_bps": 20.1}))
    )
    assert found(hovering(demanding)) == [("min_rate", f"user-4 slot {n}") for n in range(4)]
    admitted = hovering(demanding, unmet_min_rate_slots={"user-4": [0, 1, 3]})
    assert found(admitted) == [("min_rate", "user-4 slot 2")]


def test_legs_through_no_fly_zones_are_found() -> None:
    zones = MINIMAL.with_changes(
        no_fly=(
            NoFlyDisc(center_m=(60.0, 50.0), radius_m=2.0),
            NoFlyPolygon(vertices_m=((140.0, 60.0), (160.0, 60.0), (160.0, 70.0))),
        )
    )
    assert found(hovering(zones)) == []
    through_the_disc = moved(zones, "uav-1", (50.0, 50.0), (70.0, 51.9), (70.0, 51.9), (70.0, 51.9))
    assert found(through_the_disc) == [("no_fly", "uav-1 slot 0 no_fly.0")]
    past_the_disc = moved(zones, "uav-1", (50.0, 50.0), (52.0, 52.0), (70.0, 52.0), (70.0, 52.0))
    assert found(past_the_disc) == []
    into_the_polygon = moved(zones, "uav-2", (150.0, 50.0), (150.0, 60.0), (156.0, 62.0), (156.0, 62.0))
    assert found(into_the_polygon) == [("no_fly", f"uav-2 slot {n} no_fly.1") for n in (1, 2, 3)]
    along_its_edge = moved(zones, "uav-2", (150.0, 50.0), (145.0, 60.0), (160.0, 60.0), (160.0, 70.0))
    assert found(along_its_edge) == []


def test_an_infeasible_plan_is_refused_with_its_violations() -> None:
    with pytest.raises(InfeasiblePlanError, match=r"\(6g\) uav-1: starts at") as refused:
        require_feasible(moved(MINIMAL, "uav-1", *[(50.0, 50.5)] * 4))
    assert [one.constraint for one in refused.value.violations] == ["6g"]
