"""Scenarios in degrees: converted once, kept in both forms, and refused where a flat frame is no longer honest."""

import json
from math import hypot
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from shapely import Point, Polygon

from skyfolio.api.common.validation import broken_rules
from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.geodesy import east_north_to_geodetic, points_to_geodetic
from skyfolio.planner.places import in_metres
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, Origin, PositionDeg, User, zone_holds

ZURICH = Origin(lat_deg=47.397742, lon_deg=8.545594)
Raw = dict[str, Any]


def deg(lat: float, lon: float) -> Raw:
    return {"lat": lat, "lon": lon}


def town(**changes: Any) -> Raw:
    """One UAV and one user in degrees, in a box of degrees."""
    return {
        "area_deg": [deg(47.39, 8.54), deg(47.40, 8.56)],
        "slots": 4,
        "slot_duration_s": 5.0,
        "altitude_m": 30.0,
        "min_separation_m": 4.0,
        "uavs": [{"id": "uav-1", "start_deg": deg(47.395, 8.55), "end_deg": deg(47.3951, 8.55)}],
        "users": [{"id": "user-1", "position_deg": deg(47.396, 8.551)}],
        **changes,
    }


def made(raw: Raw) -> Scenario:
    return Scenario.model_validate_json(json.dumps(raw))


def refusals(raw: Raw) -> list[str]:
    with pytest.raises(ValidationError) as raised:
        made(raw)
    return [f"{row['field']}: {row['message']}" for row in broken_rules(raised.value.errors(), ())]


def test_places_in_degrees_are_kept_and_converted_about_an_origin_amid_them() -> None:
    scenario = made(town())
    assert (scenario.origin.lat_deg, scenario.origin.lon_deg) == (47.395, 8.55)
    user, uav = scenario.users[0], scenario.uavs[0]
    assert user.position_deg == PositionDeg(lat=47.396, lon=8.551)
    assert east_north_to_geodetic(scenario.origin, *user.position_m) == pytest.approx((47.396, 8.551), abs=1e-11)
    assert uav.start_m == (0.0, 0.0)
    assert uav.end_m is not None
    assert uav.end_m[1] == pytest.approx(11.1, abs=0.05)
    assert made(json.loads(scenario.model_dump_json())) == scenario


def test_a_scenario_in_metres_is_written_as_before() -> None:
    """Ids of plans are digests of this text."""
    text = EXAMPLES["paper"]().model_dump_json()
    assert "_deg" not in text.replace("lat_deg", "").replace("lon_deg", "")


def test_an_area_in_degrees_holds_no_place_outside_of_it() -> None:
    scenario = made(town(origin={"lat_deg": 47.38, "lon_deg": 8.50}))
    (west, south), (east, north) = scenario.area_m
    for lat, lon in points_to_geodetic(scenario.origin, [(west, south), (west, north), (east, south), (east, north)]):
        assert 47.39 - 1e-10 <= lat <= 47.40 + 1e-10
        assert 8.54 - 1e-10 <= lon <= 8.56 + 1e-10


@given(st.floats(0.001, 0.999), st.floats(0.001, 0.999))
def test_in_an_area_with_corners_just_what_is_outside_is_closed_off(across: float, up: float) -> None:
    corners = [(47.390, 8.540), (47.392, 8.556), (47.397, 8.551), (47.400, 8.560), (47.401, 8.541)]
    scenario = made(town(area_deg=[deg(*corner) for corner in corners]))
    outline = Polygon(in_metres(scenario.origin, [PositionDeg(lat=lat, lon=lon) for lat, lon in corners], "x"))
    (west, south), (east, north) = scenario.area_m
    place = (west + across * (east - west), south + up * (north - south))
    if outline.exterior.distance(Point(place)) > 0.5:
        assert any(zone_holds(zone, place) for zone in scenario.no_fly) != outline.contains(Point(place))
    assert made(json.loads(scenario.model_dump_json())) == scenario


def test_zones_may_be_given_in_degrees() -> None:
    zones = [
        {"center_deg": deg(47.397, 8.55), "radius_m": 20.0, "kind": "disc"},
        {"vertices_deg": [deg(47.398, 8.55), deg(47.398, 8.5501), deg(47.3981, 8.55)], "kind": "polygon"},
    ]
    disc, polygon = made(town(no_fly=zones)).no_fly
    assert isinstance(disc, NoFlyDisc)
    assert isinstance(polygon, NoFlyPolygon)
    assert disc.center_m[1] == pytest.approx(222.4, abs=0.5)
    assert len(polygon.vertices_m) == 3


BAD: dict[str, tuple[Raw, str]] = {
    "latitude": (
        town(users=[{"id": "a", "position_deg": deg(97, 8.5)}]),
        "users.0.position_deg.lat: Input should be less",
    ),
    "letters": (town(area_deg="here"), "area_deg: Input should be a valid array"),
    "nothing": (town(users=[{"id": "a"}]), "users.0.position_m: Field required"),
    "two places": (
        town(origin=ZURICH.model_dump(), users=[{"id": "a", "position_m": [9, 9], "position_deg": deg(47.4, 8.55)}]),
        "users.0.position_m: it is 404 m from users.0.position_deg",
    ),
    "metres without an origin": (town(users=[{"id": "a", "position_m": [9, 9]}]), "origin: it must be given"),
    "too wide": (town(users=[{"id": "a", "position_deg": deg(48.4, 8.55)}]), "users.0.position_deg: it is 112 km"),
    "far from the origin": (town(origin={"lat_deg": 46.0, "lon_deg": 8.55}), "km from the origin; at most"),
    "on the other side of the Earth": (town(origin={"lat_deg": -47.395, "lon_deg": -171.0}), "km from the origin"),
    "across the antimeridian": (
        town(area_deg=[deg(-17, 179.9), deg(-16.9, -179.9)], users=[{"id": "a", "position_deg": deg(-17, -179.9)}]),
        "180th meridian",
    ),
    "corners": (town(area_deg=[deg(47.40, 8.54), deg(47.39, 8.56)]), "area_deg: two corners must be"),
    "crossing": (
        town(area_deg=[deg(47.39, 8.54), deg(47.40, 8.56), deg(47.40, 8.54), deg(47.39, 8.56)]),
        "area_deg: the outline must enclose an area",
    ),
    "another area": (town(origin=ZURICH.model_dump(), area_m=[[0, 0], [500, 500]]), "area_m: "),
    "a start outside": (town(uavs=[{"id": "u", "start_deg": deg(47.41, 8.55)}]), "uavs.0.start_m: "),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_with_degrees_is_one_error_that_names_its_field(case: str) -> None:
    raw, message = BAD[case]
    rows = refusals(raw)
    assert len(rows) == 1, rows
    assert message in rows[0]


def test_an_area_whose_outside_is_not_closed_off_is_refused() -> None:
    raw = made(town(area_deg=[deg(47.39, 8.54), deg(47.39, 8.56), deg(47.40, 8.55)])).model_dump(mode="json")
    raw["no_fly"].pop()
    [told] = refusals(raw)
    assert told.startswith("no_fly: it must close off")


def test_what_is_moved_in_metres_loses_its_degrees() -> None:
    scenario = made(town())
    uav = scenario.uavs[0].model_copy(update={"start_m": (1.0, 2.0)})
    assert uav.start_deg is None
    assert uav.end_deg is not None
    moved = scenario.with_changes(uavs=(uav,), no_fly=(), area_m=((-50.0, -50.0), (50.0, 50.0)))
    assert (moved.area_deg, moved.uavs[0].start_m) == (None, (1.0, 2.0))
    assert User(id="a", position_m=(0.0, 0.0)).model_dump().keys() == {"id", "position_m", "min_rate_bps"}


def test_the_schema_asks_for_metres_or_degrees() -> None:
    schema = Scenario.model_json_schema()
    assert not {"area_m", "origin"} & set(schema["required"])
    assert {"required": ["area_deg"]} in schema["anyOf"]
    user = schema["$defs"]["User"]
    ways = ("position_m", "position_deg", "positions_m", "positions_deg")
    assert (user["required"], user["anyOf"]) == (["id"], [{"required": [way]} for way in ways])


@given(
    lat=st.floats(-80, 80),
    lon=st.floats(-179, 179),
    east=st.integers(-90_000_000_000, 90_000_000_000),
    north=st.integers(-90_000_000_000, 90_000_000_000),
)
def test_micrometres_survive_a_way_through_degrees(lat: float, lon: float, east: int, north: int) -> None:
    origin, metres = Origin(lat_deg=lat, lon_deg=lon), (east / 1e6, north / 1e6)
    there = east_north_to_geodetic(origin, *metres)
    if abs(there[1] - lon) < 180:
        back = in_metres(origin, [PositionDeg(lat=there[0], lon=there[1])], "x")[0]
        assert hypot(back[0] - metres[0], back[1] - metres[1]) < 1.5e-6
