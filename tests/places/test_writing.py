"""Plans and scenarios out, read back by ourselves and by GDAL, as QGIS does."""

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas
import pyogrio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod

from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.importing import import_files
from skyfolio.api.places.writing import Format, write_plan, write_scenario
from skyfolio.planner import EXAMPLES, Origin, Plan, Scenario, Uav, User, Utility
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.plans import Summary
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, NoFlyZone, PositionDeg, RallyPoint
from skyfolio.planner.terrain import Terrain

GOLDEN = Path(__file__).parent / "golden"
FORMATS: tuple[Format, ...] = ("geojson", "kml", "csv")
ORIGIN = Origin(lat_deg=47.397742, lon_deg=8.545594)


def town() -> Scenario:
    """Two UAVs, one of which leaves, two users, a disc and a polygon."""
    zones: tuple[NoFlyZone, ...] = (
        NoFlyDisc(center_m=(100.0, 80.0), radius_m=10.0),
        NoFlyPolygon(vertices_m=((10.0, 80.0), (30.0, 80.0), (30.0, 95.5))),
    )
    return EXAMPLES["minimal"]().with_changes(
        slots=3,
        uavs=(
            Uav(id="uav-1", start_m=(50.0, 50.0), end_m=(60.0, 50.0), altitude_m=45.0),
            Uav(id="uav-2", start_m=(150.0, 50.0), leaves_at_slot=2),
        ),
        users=(
            User(id="user-1", position_m=(20.0, 50.0), min_rate_bps=100.0),
            User(id="user-2", position_m=(140.0, 60.0)),
        ),
        no_fly=zones,
        utility=Utility(kind="pooled", mu_per_kbps=-0.1),
    )


def flown() -> Plan:
    """A plan of `town` made by hand; its first slot is slot 4 of the operation."""
    return Plan(
        id="plan-by-hand",
        method="by hand",
        first_slot=4,
        scenario=town(),
        trajectories_m={
            "uav-1": [(50.0, 50.0), (55.0, 50.0), (60.0, 50.0)],
            "uav-2": [(150.0, 50.0), (150.0, 60.5), (150.0, 60.5)],
        },
        association={"user-1": ["uav-1"] * 3, "user-2": ["uav-2", "uav-2", "uav-1"]},
        bandwidth_hz={"user-1": [10_000.0, 10_000.0, 4_000.0], "user-2": [10_000.0, 0.0, 6_000.0]},
        user_rates_bps={"user-1": [30_000.0, 31_000.0, 10_000.0], "user-2": [20_000.0, 0.0, 5_000.0]},
        summary=Summary.steady(),
    )


def read_back(text: str, form: Format, base: Scenario | None = None) -> Scenario:
    return import_files([SourceFile(name=f"town.{form}", content=text.encode())], base).scenario


def in_metres_only(scenario: Scenario) -> Scenario:
    """The scenario as if it had been given in metres."""
    return scenario.with_changes(
        area_m=scenario.area_m,
        no_fly=tuple(
            zone.model_copy(update={"center_m": zone.center_m})
            if isinstance(zone, NoFlyDisc)
            else zone.model_copy(update={"vertices_m": zone.vertices_m})
            for zone in scenario.no_fly
        ),
        users=tuple(user.model_copy(update={"position_m": user.position_m}) for user in scenario.users),
        uavs=tuple(uav.model_copy(update={"start_m": uav.start_m, "end_m": uav.end_m}) for uav in scenario.uavs),
    )


def turned(scenario: Scenario) -> Scenario:
    """The scenario with outlines that begin with their least vertex and run against the clock."""

    def same(zone: NoFlyZone) -> NoFlyZone:
        if isinstance(zone, NoFlyDisc):
            return zone
        points = list(zone.vertices_m)
        area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(points, points[1:] + points[:1], strict=True))
        points = points if area > 0 else points[::-1]
        first = points.index(min(points))
        return NoFlyPolygon(vertices_m=tuple(points[first:] + points[:first]))

    return scenario.with_changes(no_fly=tuple(same(zone) for zone in scenario.no_fly))


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_written_is_the_golden_file(form: Format) -> None:
    assert write_plan(flown(), form) == (GOLDEN / f"plan.{form}").read_bytes().decode()
    assert write_scenario(town(), form) == (GOLDEN / f"scenario.{form}").read_bytes().decode()


@pytest.mark.parametrize("form", FORMATS)
def test_a_golden_file_is_read_as_the_scenario_that_it_was_written_from(form: Format) -> None:
    content = (GOLDEN / f"scenario.{form}").read_bytes()
    settings = town().model_dump(mode="json", include={"origin", "slots", "altitude_m", "channel", "utility"})
    text = json.dumps({"type": "FeatureCollection", "features": [], "skyfolio": settings})
    files = [SourceFile(name=f"town.{form}", content=content)]
    if form == "csv":  # a table has no settings
        files.append(SourceFile(name="settings.json", content=text.encode()))
    assert turned(in_metres_only(import_files(files).scenario).with_changes(slots=3)) == turned(
        town().with_changes(slot_duration_s=5.0, min_separation_m=4.0)
    )


@pytest.mark.parametrize("form", ["geojson", "kml"])
def test_the_scenario_of_an_exported_plan_is_read_back_to_the_bit(form: Format) -> None:
    assert turned(in_metres_only(read_back(write_plan(flown(), form), form))) == turned(town())


@pytest.mark.parametrize("form", ["geojson", "kml"])
def test_a_channel_of_another_kind_is_written_and_read_back(form: Format) -> None:
    channel = channel_of({"kind": "3gpp_uav", "environment": "RMa-AV", "noise_figure_db": 7.0})
    city = town().with_changes(channel=channel)
    assert read_back(write_scenario(city, form), form).channel == channel


metres = st.integers(0, 400_000_000).map(lambda micrometres: micrometres / 1e6)
points = st.tuples(metres, metres)
small = st.floats(1.0, 20.0)


@st.composite
def scenarios(draw: Callable[..., Any]) -> Scenario:
    """Scenarios anywhere on Earth that keep clear of their own limits; metres of at most six decimals."""
    origin = Origin(lat_deg=draw(st.floats(-80, 80)), lon_deg=draw(st.floats(-179.9, 179.9)))
    starts = [(450.0 + 10 * n, draw(st.integers(0, 400))) for n in range(draw(st.integers(1, 3)))]
    corners = [draw(points) for _ in range(draw(st.integers(0, 2)))]
    zones: list[NoFlyZone] = [NoFlyDisc(center_m=at, radius_m=draw(small)) for at in corners]
    zones += [
        NoFlyPolygon(vertices_m=((e, n), (e + draw(small), n), (e, n + draw(small))))
        for e, n in (draw(points) for _ in range(draw(st.integers(0, 2))))
    ]
    return Scenario(
        origin=origin,
        area_m=((-draw(small), -draw(small)), (500.0, 500.0)),
        slots=draw(st.integers(1, 50)),
        slot_duration_s=draw(st.floats(0.5, 10)),
        altitude_m=draw(st.floats(5, 100)),
        min_separation_m=4.0,
        uavs=tuple(
            Uav(id=f"uav-{n}", start_m=(e, float(north)), max_speed_mps=draw(st.floats(0, 20)))
            for n, (e, north) in enumerate(starts)
        ),
        users=tuple(User(id=f"u{n}", position_m=draw(points)) for n in range(draw(st.integers(1, 4)))),
        utility=Utility(kind=draw(st.sampled_from(["sum", "per_user"])), mu_per_kbps=draw(st.floats(-1, 0))),
        no_fly=tuple(zones),
    )


@pytest.mark.parametrize("form", FORMATS)
def test_rally_points_survive_the_way_out_and_in_and_stand_in_exported_plans(form: Format) -> None:
    points = (RallyPoint(position_m=(70.0, 20.0)), RallyPoint(position_m=(300.0, -12.5)))
    scenario = town().with_changes(rally_points=points)
    base = None if form != "csv" else town()  # a table has no settings
    back = read_back(write_scenario(scenario, form), form, base)
    assert [point.position_deg is not None for point in back.rally_points] == [True, True]
    if form != "csv":
        assert [point.position_m for point in back.rally_points] == [point.position_m for point in points]
    again = read_back(write_scenario(back, form), form, base)
    assert again.rally_points == back.rally_points
    if form != "csv":
        plan = flown().model_copy(update={"scenario": scenario})
        assert write_plan(plan, form).count("rally_point-") >= 2


@given(scenario=scenarios(), form=st.sampled_from(["geojson", "kml"]))
@settings(deadline=None)
def test_any_scenario_survives_the_way_out_and_in(scenario: Scenario, form: Format) -> None:
    back = read_back(write_scenario(scenario, form), form)
    same = turned(scenario)
    found = turned(in_metres_only(back))
    assert found.model_dump(exclude={"area_m", "no_fly"}) == same.model_dump(exclude={"area_m", "no_fly"})
    assert [_flat(zone) for zone in found.no_fly] == [pytest.approx(_flat(zone), abs=1e-5) for zone in same.no_fly]
    assert _flat_area(found) == pytest.approx(_flat_area(same), abs=1e-5)
    again = read_back(write_scenario(back, form), form)
    for before, after in zip(back.users, again.users, strict=True):
        assert before.position_deg is not None
        assert after.position_deg is not None
        assert after.position_deg.lat == pytest.approx(before.position_deg.lat, abs=1e-7)
        assert after.position_deg.lon == pytest.approx(before.position_deg.lon, abs=1e-7)


def _flat(zone: NoFlyZone) -> list[float]:
    places = [(*zone.center_m, zone.radius_m)] if isinstance(zone, NoFlyDisc) else list(zone.vertices_m)
    return [number for place in places for number in place]


def _flat_area(scenario: Scenario) -> list[float]:
    return [number for corner in scenario.area_m for number in corner]


def test_degrees_as_given_are_written_as_given() -> None:
    given_deg = PositionDeg(lat=47.398123456, lon=8.546)
    text = EXAMPLES["minimal"]().model_dump(mode="json")
    text["users"][0] = {"id": "user-1", "position_deg": given_deg.model_dump()}
    scenario = Scenario.model_validate(text)
    features = json.loads(write_scenario(scenario, "geojson"))["features"]
    [user] = [one for one in features if one["id"] == "user-1"]
    assert user["geometry"] == {"type": "Point", "coordinates": [8.546, 47.398123456]}


def test_closed_off_corners_of_an_area_are_not_written_as_zones() -> None:
    outline = [(47.397, 8.545), (47.397, 8.549), (47.401, 8.547)]
    raw = town().model_dump(mode="json", exclude={"area_m", "no_fly"})
    raw["area_deg"] = [{"lat": lat, "lon": lon} for lat, lon in outline]
    raw["uavs"] = [{"id": "uav-1", "start_deg": {"lat": 47.3975, "lon": 8.547}}]
    scenario = Scenario.model_validate(raw)
    assert len(scenario.no_fly) == 2
    kinds = [one["properties"]["kind"] for one in json.loads(write_scenario(scenario, "geojson"))["features"]]
    assert kinds == ["area", "user", "user", "uav"]
    back = read_back(write_scenario(scenario, "geojson"), "geojson")
    assert back.area_deg is not None
    assert turned(in_metres_only(back)) == turned(in_metres_only(scenario))


# --- as others read it ---


@pytest.fixture
def written(tmp_path: Path) -> Callable[[Format], Path]:
    def write(form: Format) -> Path:
        path = tmp_path / f"plan.{form}"
        path.write_bytes(write_plan(flown(), form).encode())
        return path

    return write


def test_geopandas_reads_the_geojson_with_its_places_and_properties(written: Callable[[Format], Path]) -> None:
    frame = geopandas.read_file(written("geojson"))
    assert frame.crs.to_epsg() == 4326
    assert frame.is_valid.all()
    assert frame["kind"].value_counts().to_dict() == {
        "area": 1, "no_fly": 2, "user": 2, "uav": 2, "path": 2, "position": 5,
    }  # fmt: skip
    local = frame.to_crs(_local_system())
    for user in town().users:
        [place] = local[local["id"] == user.id].geometry
        assert math.dist((place.x, place.y), user.position_m) < 0.001
    last = local[(local["uav_id"] == "uav-1") & (local["slot"] == 6)].iloc[0]
    assert math.dist((last.geometry.x, last.geometry.y), (60.0, 50.0)) < 0.001
    assert (last["users"], last["rate_bps"], last["starts_at_s"]) == ("user-1 user-2", 15_000.0, 30.0)


def test_gdal_reads_the_kml_folder_by_folder(written: Callable[[Format], Path]) -> None:
    path = written("kml")
    layers = {name for name, _ in pyogrio.list_layers(path)}
    assert layers == {"Area", "No-fly zones", "Users", "UAVs", "Paths", "Slots"}
    frame = geopandas.read_file(path, layer="Slots")
    assert len(frame) == 5
    assert {point.z for point in frame.geometry} == {45.0, 30.0}
    zones = geopandas.read_file(path, layer="No-fly zones").to_crs(_local_system())
    polygon = zones[zones.geometry.geom_type == "Polygon"].geometry.iloc[0]
    assert polygon.area == pytest.approx(20 * 15.5 / 2, rel=1e-4)


def test_the_table_has_a_row_for_each_slot_and_uav_that_still_flies(written: Callable[[Format], Path]) -> None:
    with written("csv").open(newline="", encoding="utf-8") as opened:
        rows = list(csv.DictReader(opened))
    assert [(row["slot"], row["uav_id"]) for row in rows] == [
        ("4", "uav-1"), ("4", "uav-2"), ("5", "uav-1"), ("5", "uav-2"), ("6", "uav-1"),
    ]  # fmt: skip
    assert [row["users"] for row in rows] == ["user-1", "user-2", "user-1", "", "user-1 user-2"]
    geod = Geod(ellps="WGS84")
    for row in rows:
        away = geod.inv(ORIGIN.lon_deg, ORIGIN.lat_deg, float(row["lon_deg"]), float(row["lat_deg"]))[2]
        assert away == pytest.approx(math.hypot(float(row["east_m"]), float(row["north_m"])), abs=0.001)


def _local_system() -> str:
    """East and north of the origin as PROJ computes them: near the origin the same as ours, and not our code."""
    return f"+proj=aeqd +lat_0={ORIGIN.lat_deg} +lon_0={ORIGIN.lon_deg} +datum=WGS84 +units=m"


def test_over_terrain_a_plan_is_written_above_sea_level_as_high_as_it_is_in_each_slot() -> None:
    row = (400.0, 410.0)
    ground = Terrain(south_west_m=(-50.0, -50.0), spacing_m=400.0, heights_m=(row, row))
    flat = EXAMPLES["minimal"]().with_changes(slots=2)
    path = {uav.id: [uav.start_m, uav.start_m] for uav in flat.uavs}
    users = flat.user_ids
    hilly = Plan(
        id="hilly",
        method="by hand",
        scenario=flat.with_changes(terrain=ground),
        trajectories_m=path,
        altitudes_m={uav: [470.0, 471.5] for uav in path},
        association={user: [next(iter(path))] * 2 for user in users},
        bandwidth_hz={user: [0.0, 0.0] for user in users},
        user_rates_bps={user: [0.0, 0.0] for user in users},
        summary=Summary.steady(),
    )
    rows = list(csv.DictReader(write_plan(hilly, "csv").splitlines()))
    assert [(row["slot"], row["altitude_m"]) for row in rows[: len(path)]] == [("0", "470.0")] * len(path)
    assert rows[-1]["altitude_m"] == "471.5"
    kml = write_plan(hilly, "kml")
    assert "<altitudeMode>absolute</altitudeMode>" in kml
    assert "relativeToGround" not in kml
    assert ",470 " in kml
    assert ",471.5</coordinates>" in kml
