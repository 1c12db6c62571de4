"""Maps of gains from files that are made here: NumPy archives and GeoTIFFs, by the command and by the service."""

from __future__ import annotations

import json
from base64 import b64encode
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rasterio import MemoryFile
from rasterio.transform import from_origin

from skyfolio.api.http.routes.places import ImportFile
from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.gain_maps import NO_PATH_DB, gain_map_of
from skyfolio.api.places.importing import import_files
from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.gain_map import MAX_GAINS, GainMap
from skyfolio.planner.geodesy import east_north_to_geodetic, geodetic_to_east_north
from tests.api.test_cli import run

PAPER = EXAMPLES["paper"]()
USERS = SourceFile(name="users.csv", content=b"id,lat,lon\nanna,47.3985,8.547\nben,47.3990,8.549\n")
RECEIVERS_M = np.array([(100.0, 200.0), (400.0, 50.0)])


def rising(east_m: Any, north_m: Any, level_m: float) -> Array:
    """Gains that are linear in the place, so that every interpolation finds them: dB."""
    gains: Array = -80.0 - 0.01 * east_m + 0.02 * north_m - 0.1 * level_m
    return gains


def arrays(**changes: Any) -> dict[str, Any]:
    axis = np.arange(-100.0, 701.0, 50.0)
    east, north = np.meshgrid(axis, axis)
    gains = np.array([[rising(east, north, level) - shift for level in (50.0, 100.0)] for shift in (0.0, 7.0)])
    return {
        "gains_db": gains,
        "receivers_m": RECEIVERS_M,
        "levels_m": np.array([50.0, 100.0]),
        "south_west_m": np.array([-100.0, -100.0]),
        "spacing_m": np.array(50.0),
        **changes,
    }


def npz(leave_out: str = "", **changes: Any) -> SourceFile:
    written = BytesIO()
    np.savez_compressed(written, **{name: array for name, array in arrays(**changes).items() if name != leave_out})
    return SourceFile(name="city.npz", content=written.getvalue())


def tif(number: int = 0, spacing_deg: float = 0.0005, *, tags: dict[str, str] | None = None, unit: str = "dB") -> Any:
    """A GeoTIFF in degrees around the letter's area, the map of one receiver at 50 and 100 m."""
    lat, lon = PAPER.origin.lat_deg, PAPER.origin.lon_deg
    west, north, count = lon - 0.003, lat + 0.009, round(0.012 / spacing_deg)
    middle = (np.arange(count) + 0.5) * spacing_deg
    east_m = (west + middle - lon) * 75_450.0
    north_m = (north - middle - lat) * 111_180.0
    receiver = east_north_to_geodetic(PAPER.origin, *RECEIVERS_M[number])
    own = {"RECEIVER_DEG": f"{receiver[0]},{receiver[1]}", "LEVELS_M": "50,100"} if tags is None else tags
    profile = {"driver": "GTiff", "width": count, "height": count, "count": 2, "dtype": "float64", "crs": "EPSG:4326"}
    with MemoryFile() as memory:
        with memory.open(**profile, transform=from_origin(west, north, spacing_deg, spacing_deg)) as dataset:
            for band, level in enumerate((50.0, 100.0), start=1):
                dataset.write(rising(east_m[None, :], north_m[:, None], level), band)
            dataset.units = (unit, unit)
            dataset.update_tags(**own)
        return SourceFile(name=f"receiver-{number}.tif", content=memory.read(), is_map=True)


def at(channel: GainMap, east_m: float, north_m: float, receiver: int = 0, level: int = 0) -> float:
    """Return a gain of the map, dB, at a place of its grid."""
    column, row = (
        (east_m - channel.south_west_m[0]) / channel.spacing_m,
        (north_m - channel.south_west_m[1]) / channel.spacing_m,
    )
    assert (column, row) == (round(column), round(row))
    return channel.gains_db[receiver][level][round(row)][round(column)]


def test_a_numpy_file_is_read_and_cut_to_the_flying_area() -> None:
    channel = gain_map_of([npz()], PAPER)
    assert channel.south_west_m == (0.0, 0.0)
    assert len(channel.gains_db[0][0]) == len(channel.gains_db[0][0][0]) == 11
    assert at(channel, 150.0, 300.0) == pytest.approx(-80.0 - 1.5 + 6.0 - 5.0, abs=0.05)
    assert at(channel, 500.0, 0.0, receiver=1, level=1) == pytest.approx(-80.0 - 5.0 - 10.0 - 7.0, abs=0.05)
    assert channel.receivers_m == tuple(map(tuple, RECEIVERS_M.tolist()))
    assert (channel.noise_dbm, channel.rician_k_db) == (PAPER.channel.noise_dbm, PAPER.channel.rician_k_db)


def test_places_may_be_in_degrees() -> None:
    degrees = [east_north_to_geodetic(PAPER.origin, *place) for place in RECEIVERS_M]
    corner = east_north_to_geodetic(PAPER.origin, -100.0, -100.0)
    changes: dict[str, Any] = {"receivers_deg": np.array(degrees), "south_west_deg": np.array(corner)}
    channel = gain_map_of([npz(leave_out="receivers_m", **changes)], PAPER)
    assert np.array(channel.receivers_m) == pytest.approx(RECEIVERS_M, abs=0.01)


def test_where_nothing_arrives_is_a_gain_that_serves_nobody() -> None:
    gains = arrays()["gains_db"]
    gains[0, 0, 4, 4] = -np.inf
    assert at(gain_map_of([npz(gains_db=gains)], PAPER), 100.0, 100.0) == NO_PATH_DB


def missing_gain() -> Array:
    gains: Array = arrays()["gains_db"]
    gains[1, 0, 4, 6] = np.nan
    return gains


@pytest.mark.parametrize(
    ("file", "column", "rule"),
    [
        (SourceFile(name="city.npz", content=b"PK"), "", "is no .npz with arrays of numbers"),
        (npz(leave_out="levels_m"), "levels_m", "it has no such array, only: gains_db, receivers_m, south_west_m"),
        (npz(gains_db=np.zeros((2, 5, 5))), "gains_db", "shape (2, 5, 5), but must have 4 dimensions"),
        (npz(receivers_m=np.zeros((2, 3))), "receivers_m", "places have 2"),
        (npz(spacing_m=np.array(-1.0)), "spacing_m", "must be greater than 0"),
        (npz(gains_db=missing_gain()), "gains_db", "no gain at receiver 1, level 0, row 4, column 6"),
        (npz(receivers_m=RECEIVERS_M[:1]), "gains_db", "it has 2 maps for 1 receivers_m"),
        (npz(gains_db=arrays()["gains_db"] + 300.0), "gains_db.0.0.0.0", "less than or equal to 100"),
    ],
)
def test_a_bad_numpy_file_is_refused_by_its_name_and_the_rule(file: SourceFile, column: str, rule: str) -> None:
    with pytest.raises(FaultyFilesError) as refused:
        gain_map_of([file], PAPER)
    fault = refused.value.faults[0]
    assert fault.file == "city.npz"
    assert fault.column == column
    assert rule in fault.message


def test_a_map_that_does_not_cover_the_area_is_refused_by_its_name() -> None:
    with pytest.raises(FaultyFilesError, match=r"city\.npz.*must cover area_m"):
        import_files([npz(south_west_m=np.array([300.0, 0.0]))], base=PAPER)


def test_too_many_gains_are_refused_by_what_would_help() -> None:
    many = np.full((20, 2, 121, 121), -90.0)
    changes: dict[str, Any] = {"spacing_m": np.array(5.0), "receivers_m": np.zeros((20, 2)), "gains_db": many}
    with pytest.raises(FaultyFilesError, match=f"at most are {MAX_GAINS}: use fewer receivers"):
        gain_map_of([npz(**changes)], PAPER)


def test_a_geotiff_is_the_map_of_one_receiver() -> None:
    channel = gain_map_of([tif(0), tif(1)], PAPER)
    assert np.array(channel.receivers_m) == pytest.approx(RECEIVERS_M, abs=0.01)
    assert channel.levels_m == (50.0, 100.0)
    grid, spacing_m = np.array(channel.gains_db), channel.spacing_m
    columns, rows = np.meshgrid(np.arange(grid.shape[3]), np.arange(grid.shape[2]))
    for level, height_m in enumerate((50.0, 100.0)):
        expected = rising(columns * spacing_m, rows * spacing_m, height_m)
        assert grid[0, level] == pytest.approx(expected, abs=0.1)
    assert Scenario.model_validate_json(PAPER.with_changes(channel=channel).model_dump_json()).channel == channel


def test_a_fine_geotiff_is_read_on_a_grid_that_a_scenario_may_have() -> None:
    channel = gain_map_of([tif(spacing_deg=0.00001)], PAPER)
    size = np.array(channel.gains_db).size
    assert 0.8 * MAX_GAINS < size <= MAX_GAINS
    assert channel.spacing_m == pytest.approx(500.0 / np.sqrt(MAX_GAINS / 2), rel=0.15)


@pytest.mark.parametrize(
    ("file", "column", "rule"),
    [
        (SourceFile(name="receiver-0.tif", content=b"no", is_map=True), "", "is no GeoTIFF"),
        (tif(tags={"LEVELS_M": "50,100"}), "RECEIVER_DEG", "has no such tag; gdal_edit.py -mo"),
        (tif(tags={"RECEIVER_DEG": "47", "LEVELS_M": "50,100"}), "RECEIVER_DEG", "latitude and longitude"),
        (tif(tags={"RECEIVER_DEG": "47,8", "LEVELS_M": "high"}), "LEVELS_M", "'high' must be numbers"),
        (tif(tags={"RECEIVER_DEG": "47,8", "LEVELS_M": "50"}), "LEVELS_M", "names 1 levels for 2 bands"),
        (tif(unit="W"), "", "has gains in 'W', but only dB are read"),
    ],
)
def test_a_bad_geotiff_is_refused_by_its_name_and_the_rule(file: SourceFile, column: str, rule: str) -> None:
    with pytest.raises(FaultyFilesError) as refused:
        gain_map_of([file], PAPER)
    fault = refused.value.faults[0]
    assert (fault.file, fault.column) == ("receiver-0.tif", column)
    assert rule in fault.message


def test_maps_of_different_levels_are_refused() -> None:
    other = tif(1, tags={"RECEIVER_DEG": "47.3985,8.547", "LEVELS_M": "60,100"})
    with pytest.raises(FaultyFilesError, match=r"receiver-1\.tif.*has the levels \[60\.0, 100\.0\], but receiver-0"):
        gain_map_of([tif(0), other], PAPER)
    with pytest.raises(FaultyFilesError, match="holds a whole map: give it alone"):
        gain_map_of([npz(), tif(0)], PAPER)


def test_the_command_makes_a_scenario_with_the_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for file in (npz(), replace(tif(0), is_map=False)):
        (tmp_path / file.name).write_bytes(file.content)
    for name, receivers in (("city.npz", 2), ("receiver-0.tif", 1)):
        out = tmp_path / "scenario.json"
        asked = ["import", "--gain-map", str(tmp_path / name), "--example", "paper", "--out", str(out)]
        assert run(monkeypatch, *asked) == 0
        made = Scenario.model_validate_json(out.read_text())
        assert isinstance(made.channel, GainMap)
        assert len(made.channel.receivers_m) == receivers
        assert f"channel: map of {receivers} receivers" in capsys.readouterr().err


def test_the_command_names_a_faulty_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "city.npz").write_bytes(b"none")
    assert run(monkeypatch, "import", "--gain-map", str(tmp_path / "city.npz"), "--example", "paper") != 0
    assert "city.npz" in capsys.readouterr().err


def test_the_service_takes_a_geotiff_as_a_map_if_it_says_so() -> None:
    given = {"name": "a.tif", "content_base64": b64encode(tif(0).content).decode(), "kind": "gain_map"}
    imported = import_files([ImportFile.model_validate_json(json.dumps(given)).source(), USERS], base=PAPER)
    assert isinstance(imported.scenario.channel, GainMap)
    assert any(note.startswith("channel: map of 1 receivers") for note in imported.notes)
    assert geodetic_to_east_north(PAPER.origin, 47.3985, 8.547)[0] > 0.0
