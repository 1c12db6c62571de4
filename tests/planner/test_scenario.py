"""Every rule of a scenario: broken input is refused with a message that names the field and the rule."""

from typing import Any

import pytest
from pydantic import ValidationError

from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, zone_holds

SQUARE = [[90.0, 40.0], [110.0, 40.0], [110.0, 60.0], [90.0, 60.0]]


def changed(path: str, value: Any) -> dict[str, Any]:
    """The minimal scenario with one field replaced (or added)."""
    raw: dict[str, Any] = EXAMPLES["minimal"]().model_dump(mode="json")
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    place: Any = raw
    for part in parents:
        place = place[part]
    place[last] = value
    return raw


def message(raw: dict[str, Any]) -> str:
    with pytest.raises(ValidationError) as refused:
        Scenario.model_validate(raw)
    return " ".join(".".join(map(str, error["loc"])) + ": " + error["msg"] for error in refused.value.errors())


@pytest.mark.parametrize(
    ("field", "value", "rule"),
    [
        ("origin.lat_deg", 85.1, "less than or equal to 85"),
        ("origin.lon_deg", -180.5, "greater than or equal to -180"),
        ("slots", 0, "greater than or equal to 1"),
        ("slots", 100_001, "less than or equal to 100000"),
        ("slots", 2.5, "valid integer"),
        ("slot_duration_s", 0.0, "greater than 0"),
        ("slot_duration_s", 3601.0, "less than or equal to 3600"),
        ("altitude_m", 0.0, "greater than or equal to 0.1"),
        ("altitude_m", 1e-200, "greater than or equal to 0.1"),
        ("altitude_m", float("nan"), "finite number"),
        ("min_separation_m", -1.0, "greater than or equal to 0"),
        ("uavs", [], "at least 1 item"),
        ("users", [], "at least 1 item"),
        ("uavs.0.id", "no spaces", "match pattern"),
        ("uavs.0.start_m", [50.0], "Field required"),
        ("uavs.0.start_m", ["50", 50.0], "valid number"),
        ("uavs.0.max_speed_mps", -1.0, "greater than or equal to 0"),
        ("uavs.0.max_speed_mps", 101.0, "less than or equal to 100"),
        ("uavs.0.bandwidth_hz", 0.0, "greater than or equal to 1"),
        ("uavs.0.bandwidth_hz", 1e300, "less than or equal to 100000000000"),
        ("uavs.0.transmit_power_w", 1e300, "less than or equal to 1000000"),
        ("uavs.0.transmit_power_w", float("inf"), "finite number"),
        ("uavs.0.altitude_m", 20_001.0, "less than or equal to 20000"),
        ("uavs.0.leaves_at_slot", 0, "greater than or equal to 1"),
        ("uavs.0.colour", "red", "Extra inputs"),
        ("users.1.position_m", [0.0, 100_001.0], "less than or equal to 100000"),
        ("users.1.min_rate_bps", -1.0, "greater than or equal to 0"),
        ("channel.noise_dbm", 101.0, "less than or equal to 100"),
        ("channel.reference_gain_db", -201.0, "greater than or equal to -200"),
        ("channel.rician_k_db", 101.0, "less than or equal to 100"),
        ("channel.fading", "deep", "'held' or 'expected'"),
        ("channel.seed", -1, "greater than or equal to 0"),
        ("utility.kind", "max", "'sum', 'per_user' or 'pooled'"),
        ("utility.mu_per_kbps", 0.1, "less than or equal to 0"),
        ("no_fly", [{"kind": "disc", "center_m": [0.0, 0.0], "radius_m": 0.0}], "greater than 0"),
        ("no_fly", [{"kind": "polygon", "vertices_m": SQUARE[:2]}], "at least 3 items"),
        ("no_fly", [{"kind": "circle", "center_m": [0.0, 0.0]}], "'disc', 'polygon'"),
    ],
)
def test_a_value_out_of_its_range_is_refused_by_field_and_rule(field: str, value: Any, rule: str) -> None:
    said = message(changed(field, value))
    assert field in said
    assert rule in said


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"area_m": [[0.0, 0.0], [0.0, 100.0]]}, "area_m: .* west < east and south < north"),
        ({"uavs.1.id": "uav-1"}, "uavs: ids must be unique; 'uav-1' occurs more than once"),
        ({"users.3.id": "user-1"}, "users: ids must be unique; 'user-1'"),
        ({"uavs.0.start_m": [50.0, 101.0]}, "uavs.0.start_m: .* of 'uav-1' lies outside area_m"),
        ({"uavs.1.start_m": [52.0, 50.0]}, "start_m of 'uav-1' and 'uav-2' are 2 m apart, closer than min_sep"),
        ({"uavs.1.end_m": [150.0, -1.0]}, "uavs.1.end_m: .* of 'uav-2' lies outside area_m"),
        ({"uavs.0.end_m": [150.0, 50.0]}, "uavs.0.end_m: .* 100 m from its start, but it can fly only 75 m"),
        ({"uavs.0.end_m": [110.0, 50.0], "uavs.0.leaves_at_slot": 3}, "it can fly only 50 m until its last slot"),
        (
            {"uavs.0.end_m": [100.0, 50.0], "uavs.1.end_m": [101.0, 50.0]},
            "end_m of 'uav-1' and 'uav-2' are 1 m apart",
        ),
        ({"uavs.0.leaves_at_slot": 3, "uavs.1.leaves_at_slot": 2}, "leaves_at_slot takes every UAV away"),
        (
            {"no_fly": [{"kind": "disc", "center_m": [150.0, 50.0], "radius_m": 1.0}]},
            "uavs.1.start_m: .* of 'uav-2' lies inside no_fly.0",
        ),
        (
            {"no_fly": [{"kind": "polygon", "vertices_m": SQUARE}], "uavs.0.end_m": [100.0, 50.0]},
            "uavs.0.end_m: .* lies inside no_fly.0",
        ),
        (
            {"no_fly": [{"kind": "polygon", "vertices_m": [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]}]},
            "vertices_m: the outline must enclose an area and not cross itself",
        ),
    ],
)
def test_fields_that_contradict_each_other_are_refused(changes: dict[str, Any], said: str) -> None:
    raw: dict[str, Any] = EXAMPLES["minimal"]().model_dump(mode="json")
    for path, value in changes.items():
        *parents, last = path.split(".")
        place: Any = raw
        for part in parents:
            place = place[int(part) if part.isdigit() else part]
        place[last] = value
    with pytest.raises(ValidationError, match=said):
        Scenario.model_validate(raw)


def test_uavs_may_end_at_one_place_when_one_has_left_before() -> None:
    raw = changed("uavs.0.end_m", [98.0, 50.0])
    raw["uavs"][0]["leaves_at_slot"] = 3
    raw["uavs"][1]["end_m"] = [98.0, 50.0]
    assert Scenario.model_validate(raw).last_slot(Scenario.model_validate(raw).uavs[0]) == 2


def test_a_scenario_survives_json() -> None:
    for example in EXAMPLES.values():
        assert Scenario.model_validate_json(example().model_dump_json()) == example()


def test_a_scenario_cannot_be_changed_and_a_changed_copy_is_checked() -> None:
    scenario = EXAMPLES["minimal"]()
    with pytest.raises(ValidationError, match="frozen"):
        scenario.slots = 3  # type: ignore[misc]
    assert scenario.with_changes(slots=3).slots == 3
    with pytest.raises(ValidationError, match="slots"):
        scenario.with_changes(slots=-3)


def test_the_edge_of_a_zone_is_not_inside() -> None:
    disc = NoFlyDisc(center_m=(0.0, 0.0), radius_m=5.0)
    square = NoFlyPolygon(vertices_m=((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)))
    assert not zone_holds(disc, (3.0, 4.0))
    assert zone_holds(disc, (2.9, 4.0))
    assert not zone_holds(square, (10.0, 5.0))
    assert zone_holds(square, (9.9, 5.0))


def test_each_uav_has_its_own_altitude_or_the_fleets() -> None:
    scenario = Scenario.model_validate(changed("uavs.0.altitude_m", 45.0))
    assert [scenario.altitude_of(uav) for uav in scenario.uavs] == [45.0, 30.0]
    assert scenario.uav("uav-2").altitude_m is None
