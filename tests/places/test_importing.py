"""Files in, a scenario out, and what is refused: by file, row, column and rule."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.api.places import files as limits
from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.faults import Fault, FaultyFilesError
from skyfolio.api.places.files import Encoding, Kind, SourceFile
from skyfolio.api.places.importing import Imported, import_files
from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.places import in_metres
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon

BASE = EXAMPLES["minimal"]()
UAVS = SourceFile(name="uavs.csv", content=b"id,lat,lon,max_speed_mps\nu1,47.3980,8.5460,7.5\nu2,47.3990,8.5470,\n")
USERS = b"id,lat,lon\nu1,47.3980,8.5460\n"


def given_file(
    name: str, content: str | bytes, kind: Kind | None = None, encoding: Encoding | None = None
) -> SourceFile:
    data = content if isinstance(content, bytes) else content.encode()
    return SourceFile(name=name, content=data, kind=kind, encoding=encoding)


def read(*files: SourceFile, base: Scenario | None = BASE, **settings: Any) -> Imported:
    return import_files(files, base, ScenarioSettings(**settings))


def faults_of(*files: SourceFile, base: Scenario | None = BASE) -> tuple[Fault, ...]:
    with pytest.raises(FaultyFilesError) as raised:
        read(*files, base=base)
    assert raised.value.rows
    return raised.value.faults


def ends_of(*files: SourceFile) -> FaultyFilesError | None:
    try:
        read(*files)
    except FaultyFilesError as error:
        return error
    return None


def collection(*features: dict[str, Any], **members: Any) -> str:
    return json.dumps({"type": "FeatureCollection", "features": features, **members})


def feature(geometry: dict[str, Any] | None, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def point(lon: float, lat: float, **properties: Any) -> dict[str, Any]:
    return feature({"type": "Point", "coordinates": [lon, lat]}, **properties)


def polygon(*rings: list[list[float]], **properties: Any) -> dict[str, Any]:
    return feature({"type": "Polygon", "coordinates": list(rings)}, **properties)


def square(west: float, south: float, side: float) -> list[list[float]]:
    east, north = west + side, south + side
    return [[west, south], [east, south], [east, north], [west, north], [west, south]]


def test_a_table_of_users_and_one_of_uavs_make_a_scenario_with_an_origin_of_its_own() -> None:
    users = given_file(
        "users.csv", "name;Latitude;Longitude;min_rate_bps\nkiosk;47.3980;8.5460;2000\n;47.3970;8.5480;\n"
    )
    made = read(users, UAVS, base=None)
    scenario = made.scenario
    assert scenario.user_ids == ("kiosk", "user-1")
    assert [user.min_rate_bps for user in scenario.users] == [2000.0, 0.0]
    assert [uav.max_speed_mps for uav in scenario.uavs] == [7.5, 5.0]
    assert (scenario.origin.lat_deg, scenario.origin.lon_deg) == (47.398, 8.547)
    assert scenario.users[0].position_deg is not None
    assert scenario.users[0].position_deg.lat == 47.398
    east, north = in_metres(scenario.origin, [scenario.users[0].position_deg], "x")[0]
    assert scenario.users[0].position_m == (east, north)
    assert (scenario.slots, scenario.slot_duration_s, scenario.altitude_m) == (20, 5.0, 60.0)
    for said in ("origin: chosen amid all places, 47.398, 8.547", "slots 20", "area: no file has one"):
        assert any(said in note for note in made.notes), made.notes
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


def test_users_alone_keep_uavs_origin_area_and_settings_of_the_base() -> None:
    made = read(given_file("users.csv", USERS), slots=9).scenario
    assert made.origin == BASE.origin
    assert made.uavs == BASE.uavs
    assert (made.area_m, made.slots, made.utility) == (BASE.area_m, 9, BASE.utility)
    assert made.user_ids == ("u1",)


def test_rally_points_come_from_files_and_otherwise_stay_as_the_base_has_them() -> None:
    rally = given_file("rally_points.csv", "id,lat,lon\nfield,47.3985,8.5470\nfield,47.3975,8.5465\n")
    made = read(rally).scenario
    assert made.users == BASE.users
    assert [(at.lat, at.lon) for point in made.rally_points if (at := point.position_deg)] == [
        (47.3985, 8.5470), (47.3975, 8.5465),
    ]  # fmt: skip
    assert read(given_file("users.csv", USERS), base=made).scenario.rally_points == made.rally_points
    assert read(given_file("users.csv", USERS), UAVS, base=made).scenario.rally_points == ()
    both = read(given_file("users.csv", USERS), UAVS, rally, base=None)
    assert len(both.scenario.rally_points) == 2
    east = [corner[0] for corner in both.scenario.area_m]
    assert max(east) < 200.0  # they widen no area


def test_a_rally_point_that_is_none_is_refused_with_file_and_row() -> None:
    [fault] = faults_of(given_file("rally.geojson", collection(polygon(square(8.546, 47.398, 1e-3)))))
    assert (fault.file, fault.row, fault.rule) == ("rally.geojson", "feature 1", "geometry")
    assert "a rally_point must be a Point, not a Polygon" in fault.message
    far = faults_of(given_file("rally.csv", "lat,lon\n47.3985,8.5470\n52.0,8.5\n"))
    assert {(one.file, one.row) for one in far} == {("rally.csv", "row 3")}


def test_columns_that_mean_nothing_are_told_and_a_kind_column_sorts_rows() -> None:
    table = "kind,id,lat,lon,population,radius_m,\nuser,a,47.398,8.546,12,,\nno_fly,,47.3984,8.5462,,5,\n"
    made = read(given_file("town.csv", table))
    assert "town.csv: not used: population" in made.notes
    [zone] = made.scenario.no_fly
    assert isinstance(zone, NoFlyDisc)
    assert zone.radius_m == 5.0


def test_geojson_brings_a_channel_of_any_kind() -> None:
    channel = {
        "kind": "los_probability",
        "environment": "suburban",
        "noise_figure_db": 9.0,
        "antenna": {"kind": "beam"},
    }
    made = read(given_file("users.geojson", collection(point(8.546, 47.398), skyfolio={"channel": channel}))).scenario
    assert made.channel == channel_of(channel)
    bad = collection(point(8.546, 47.398), skyfolio={"channel": {**channel, "reference_gain_db": -20.0}})
    assert "not permitted" in str(faults_of(given_file("users.geojson", bad)))


def test_geojson_brings_zones_an_area_and_settings() -> None:
    hole = {"type": "MultiPolygon", "coordinates": [[square(8.5460, 47.3980, 1e-4)], [square(8.5465, 47.3985, 1e-4)]]}
    outline = [[8.545, 47.397], [8.549, 47.397], [8.547, 47.401], [8.545, 47.397]]
    text = collection(
        feature({"type": "Point", "coordinates": [8.5470, 47.3980, 412.0]}, kind="user", id=7),
        point(8.5470, 47.3975, kind="uav", name="alpha", end_lat_deg=47.3976, end_lon_deg=8.547),
        feature(hole, kind="no-fly"),
        polygon(outline, kind="area"),
        skyfolio={"slots": 6, "utility": {"kind": "pooled", "mu_per_kbps": -0.1}},
    )
    scenario = read(given_file("town.json", "\ufeff" + text), base=None).scenario
    assert (scenario.user_ids, scenario.uav_ids, scenario.slots, scenario.utility.kind) == (
        ("7",),
        ("alpha",),
        6,
        "pooled",
    )
    assert scenario.uavs[0].end_m is not None
    drawn = [zone for zone in scenario.no_fly if isinstance(zone, NoFlyPolygon) and zone.vertices_deg]
    assert len(drawn) == 2
    assert len(scenario.no_fly) == 4, "and two triangles beside the area, which has three corners"


def test_kml_folders_say_what_is_in_them() -> None:
    kml = """<?xml version="1.0" encoding="ISO-8859-1"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>
    <Folder><name>Users</name><Placemark><name>B\u00e4ckerei</name>
      <Point><coordinates> 8.5460,47.3980,0 </coordinates></Point></Placemark></Folder>
    <Folder><name>No fly zones</name><Placemark><name>school</name><Polygon><outerBoundaryIs><LinearRing><coordinates>
      8.5470,47.3985 8.5471,47.3985 8.5471,47.3986 8.5470,47.3985</coordinates></LinearRing></outerBoundaryIs></Polygon>
    </Placemark></Folder></Document></kml>"""
    scenario = read(given_file("town.kml", kml.encode("iso-8859-1"))).scenario
    assert scenario.user_ids == ("user-1",), "free text is no id"
    assert len(scenario.no_fly) == 1


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_marks_of_encodings_are_understood(encoding: str) -> None:
    content = "id,lat,lon\nkiosk,47.398,8.546\n".encode(encoding)
    assert read(given_file("users.csv", content)).scenario.user_ids == ("kiosk",)


def test_a_text_in_an_unknown_encoding_is_refused_and_read_when_it_is_named() -> None:
    content = "id,lat,lon,remark\nkiosk,47.398,8.546,Z\u00fcrich\n".encode("cp1252")
    [fault] = faults_of(given_file("users.csv", content))
    assert (fault.row, fault.rule) == ("line 2", "encoding")
    assert read(given_file("users.csv", content, encoding="windows-1252")).scenario.user_ids == ("kiosk",)


TABLES: dict[str, tuple[str, str, str, str]] = {
    "decimal comma": ("id;lat;lon\na;47,39;8.54\n", "row 2", "lat", "decimal comma; write 47.39"),
    "decimal commas between commas": ("id,lat,lon\na,47,39,8,54\n", "row 2", "", "5 cells, but there are 3 columns"),
    "word": ("id,lat,lon\na,north,8.54\n", "row 2", "lat", "not a number"),
    "infinite": ("id,lat,lon\na,1e999,8.54\n", "row 2", "lat", "not a number"),
    "digits in groups": ("id,lat,lon\na,4_7,8.54\n", "row 2", "lat", "not a number"),
    "swapped": ("id,lat,lon\na,147.3,-35.2\n", "row 2", "lat", "swapped"),
    "empty place": ("id,lat,lon\na,47.398,8.546\nb,,\n", "row 3", "geometry", "no place"),
    "beyond the antimeridian": ("id,lat,lon\na,47.398,188.5\n", "row 2", "lon", "-180..180"),
    "same id": ("id,lat,lon\na,47.398,8.546\n\na,47.398,8.547\n", "row 4", "id", "already the id of users.csv: row 2"),
    "no id": ("id,lat,lon\nmy place,47.398,8.546\n", "row 2", "id", "pattern"),
    "far away": ("id,lat,lon\na,37.398,8.546\n", "row 2", "lat", "1,112 km from the origin"),
    "other side": ("id,lat,lon\na,-47.39,-171.45\n", "row 2", "lat", "km from the origin"),
    "half an end": ("kind,id,lat,lon,end_lat_deg\nuav,a,47.398,8.546,47.4\n", "row 2", "end_lat_deg", "together"),
    "end nowhere": (
        "kind,id,lat,lon,end_lat_deg,end_lon_deg\nuav,a,47.398,8.546,97.4,8.5\n",
        "row 2",
        "end_lat_deg",
        "-90..90",
    ),
    "broken rule": ("id,lat,lon,min_rate_bps\na,47.398,8.546,-1\n", "row 2", "min_rate_bps", "greater than or equal"),
    "no columns": ("a,b\n1,2\n", "row 1", "", "lat_deg and lon_deg"),
    "same column": ("id,lat,lat,lon\n", "row 1", "lat", "this name"),
    "wkt": ("id,wkt\na,POINT (8.5\n", "row 2", "wkt", "cannot be read"),
    "line": ('id,wkt\na,"LINESTRING (8 47, 9 47)"\n', "row 2", "wkt", "has 2 places, but there are 4 slots"),
    "unknown kind": ("kind,id,lat,lon\nbalcony,a,47.398,8.546\n", "row 2", "kind", "what it is"),
    "quote": ('id,lat,lon\n"a"b,47.398,8.546\n', "", "", "not a table"),
}


@pytest.mark.parametrize("case", TABLES)
def test_what_is_wrong_in_a_table_is_told_by_row_and_column(case: str) -> None:
    text, row, column, message = TABLES[case]
    fault = faults_of(given_file("users.csv", text))[0]
    assert (fault.file, fault.row, fault.column) == ("users.csv", row, column), fault
    assert message in fault.message


def test_every_faulty_row_is_told_at_once_and_a_flood_is_counted() -> None:
    rows = "".join(f"a{n};47,39;8.54\n" for n in range(50))
    with pytest.raises(FaultyFilesError) as raised:
        read(given_file("users.csv", "id;lat;lon\n" + rows))
    assert len(raised.value.rows) == 20
    assert str(raised.value).splitlines()[-1] == "files: 30 more rows have faults"


BOW_TIE = [[8.546, 47.398], [8.547, 47.399], [8.547, 47.398], [8.546, 47.399], [8.546, 47.398]]
GEOJSON: dict[str, tuple[str, str, str]] = {
    "not JSON": ("{", "", "not JSON"),
    "nested": ("[" * 100_000, "", "not JSON"),
    "a scenario": (json.dumps({"origin": {}}), "", "planned as it is"),
    "another system": (collection(crs={"type": "name", "properties": {"name": "EPSG:2056"}}), "", "not WGS-84"),
    "no geometry": (collection(feature(None, id="a")), "feature 1", "no place"),
    "letters": (collection(feature({"type": "Point", "coordinates": ["a", 3]})), "feature 1", "cannot be read"),
    "a line": (
        collection(feature({"type": "LineString", "coordinates": [[8, 47], [9, 47]]}, kind="uav")),
        "feature 1",
        "Point",
    ),
    "settings": (collection(point(8.546, 47.398), skyfolio={"slots": 0}), "", "than or equal to 1"),
    "a hole": (
        collection(polygon(square(8.5, 47.3, 0.1), square(8.54, 47.34, 0.01), kind="area")),
        "feature 1",
        "holes",
    ),
    "two areas": (
        collection(*[polygon(square(8.5, 47.3, 0.1), kind="area")] * 2),
        "feature 2",
        "an area already, users.geojson: feature 1",
    ),
    "disc of no size": (collection(point(8.546, 47.398, kind="no_fly")), "feature 1", "radius_m"),
    "crossing outline": (collection(polygon(BOW_TIE, kind="no_fly")), "feature 1", "not cross itself"),
    "no object": (json.dumps({"type": "FeatureCollection", "features": [3]}), "feature 1", "type Feature"),
}


@pytest.mark.parametrize("case", GEOJSON)
def test_what_is_wrong_in_geojson_is_told_by_feature(case: str) -> None:
    text, row, message = GEOJSON[case]
    fault = faults_of(given_file("users.geojson", text))[-1]
    assert (fault.file, fault.row) == ("users.geojson", row), fault
    assert message in fault.message


FORBIDDEN = "no document type"


def placemark(inside: str) -> str:
    return f"<kml><Placemark>{inside}</Placemark></kml>"


KML: dict[str, tuple[str, str]] = {
    "entities": ('<!DOCTYPE a [<!ENTITY x "y"><!ENTITY z "&x;&x;">]><kml>&z;</kml>', FORBIDDEN),
    "a file of the machine": ('<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]><kml>&x;</kml>', FORBIDDEN),
    "a document type": ('<!DOCTYPE kml SYSTEM "http://example.org/kml.dtd"><kml/>', FORBIDDEN),
    "no XML": ("<kml>", "not plain XML"),
    "an unknown encoding": ('<?xml version="1.0" encoding="klingon"?><kml/>', "not plain XML"),
    "another root": ("<gpx/>", "must be <kml>"),
    "an archive": ("PK\x03\x04", "KMZ"),
    "numbers": (placemark("<Point><coordinates>8,54,47,39</coordinates></Point>"), "longitude,latitude"),
    "places": (placemark("<Point><coordinates>8,47 9,47</coordinates></Point>"), "must be 1 place"),
    "a ring": (
        placemark("<Polygon><outerBoundaryIs><coordinates>8,47 9,47</coordinates></outerBoundaryIs></Polygon>"),
        "cannot be read",
    ),
    "no place": (placemark("<name>a</name>"), "no place"),
}


@pytest.mark.parametrize("case", KML)
def test_what_is_wrong_in_kml_is_told(case: str) -> None:
    text, message = KML[case]
    fault = faults_of(given_file("users.kml", text))[0]
    assert fault.file == "users.kml"
    assert message in fault.message


def test_a_folder_inside_many_is_no_danger() -> None:
    deep = "<kml>" + "<Folder>" * 5000 + "</Folder>" * 5000 + "</kml>"
    assert read(given_file("users.kml", deep), given_file("users.csv", USERS)).scenario.user_ids == ("u1",)


def test_sizes_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyfolio.api.places.files.MAX_BYTES", 100)
    with pytest.raises(FaultyFilesError, match=r"users\.csv: it has 101 bytes; at most are 100"):
        given_file("users.csv", b"x" * 101)
    assert limits.MAX_BYTES == 100
    monkeypatch.setattr("skyfolio.api.places.files.MAX_BYTES", 10**7)
    monkeypatch.setattr("skyfolio.api.places.properties.MAX_FEATURES", 3)
    rows = "".join(f"a{n},47.398,8.546\n" for n in range(5))
    [fault] = faults_of(given_file("users.csv", "id,lat,lon\n" + rows))
    assert "more than 3 features" in fault.message


def test_a_region_that_is_too_wide_or_lies_across_the_antimeridian_is_refused_naming_both_rows() -> None:
    users = given_file("users.csv", "id,lat,lon\na,47.0,8.0\nb,48.0,8.0\n")
    [fault] = faults_of(users, UAVS, base=None)
    assert (fault.file, fault.row) == ("users.csv", "row 3")
    assert "111 km from users.csv: row 2; places may be at most 100 km apart" in fault.message
    fiji = given_file("users.csv", "id,lat,lon\na,-17.0,179.9\nb,-17.0,-179.9\n")
    uavs = given_file("uavs.csv", "id,lat,lon\nu,-17.0,179.91\n")
    [fault] = faults_of(fiji, uavs, base=None)
    assert "180th meridian" in fault.message


def test_files_without_uavs_and_without_a_base_are_refused() -> None:
    [fault] = faults_of(given_file("users.csv", USERS), base=None)
    assert "no file has a UAV" in fault.message
    [fault] = faults_of(given_file("users.xlsx", b"PK"))
    assert "its name must end in" in fault.message


@given(content=st.binary(max_size=300), name=st.sampled_from(["users.csv", "users.geojson", "users.kml"]))
def test_no_bytes_end_in_anything_but_a_scenario_or_faults(content: bytes, name: str) -> None:
    told = ends_of(given_file(name, content))
    assert told is None or told.faults


@given(raw=st.recursive(st.none() | st.floats() | st.text(max_size=4), lambda inner: st.lists(inner, max_size=4)))
def test_no_coordinates_end_in_anything_but_a_scenario_or_faults(raw: Any) -> None:
    for shape in ("Point", "Polygon", "MultiPolygon", "Nonsense"):
        text = json.dumps({"type": "Feature", "geometry": {"type": shape, "coordinates": raw}, "properties": {}})
        told = ends_of(given_file("users.geojson", text))
        assert told is None or told.faults
