"""Ground heights from tiles that are made here: GeoTIFF in degrees and in metres, and an SRTM tile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio import MemoryFile
from rasterio.transform import from_bounds, from_origin
from rasterio.warp import transform

from skyfolio.api.cli.main import main
from skyfolio.api.common.extras import MissingExtraError
from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.elevation import terrain_of
from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.importing import import_files
from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.geodesy import east_north_to_geodetic
from skyfolio.planner.terrain import MAX_HEIGHTS

PAPER = EXAMPLES["paper"]()
LAT, LON = PAPER.origin.lat_deg, PAPER.origin.lon_deg
USERS = b"id,lat,lon\nanna,47.3985,8.547\nben,47.3990,8.549\n"


def rolling(lat: Array, lon: Array) -> Array:
    """Heights that rise to the north-east, with hills: metres."""
    north, east = (lat - LAT) * 111_180.0, (lon - LON) * 75_450.0
    heights: Array = 450.0 + 0.1 * north + 0.05 * east + 40.0 * np.sin(east / 150.0) * np.cos(north / 200.0)
    return heights


def tif(*, spacing_deg: float = 0.0003, nodata_at: bool = False, unit: str | None = None, **options: Any) -> SourceFile:
    """A GeoTIFF in degrees around the letter's area, heights in float32 at the middles of its cells."""
    west, north, count = LON - 0.006, LAT + 0.012, round(0.024 / spacing_deg)
    middle = (np.arange(count) + 0.5) * spacing_deg
    lon, lat = np.meshgrid(west + middle, north - middle)
    heights = rolling(lat, lon).astype(np.float32)
    if nodata_at:
        heights[count // 3, count // 3] = -9999.0
    profile = {"driver": "GTiff", "width": count, "height": count, "count": 1, "dtype": "float32", "nodata": -9999.0}
    place = {"crs": "EPSG:4326", "transform": from_origin(west, north, spacing_deg, spacing_deg)}
    with MemoryFile() as memory:
        with memory.open(**{**profile, **place, **options}) as dataset:
            dataset.write(heights, 1)
            if unit is not None:
                dataset.units = (unit,)
        return SourceFile(name="hills.tif", content=memory.read())


def utm() -> SourceFile:
    """The same heights on a grid of 20 m in UTM zone 32."""
    xs, ys = transform("EPSG:4326", "EPSG:32632", [LON - 0.003, LON + 0.012], [LAT - 0.003, LAT + 0.012])
    columns, rows = int((xs[1] - xs[0]) / 20), int((ys[1] - ys[0]) / 20)
    place = from_bounds(xs[0], ys[0], xs[0] + 20 * columns, ys[0] + 20 * rows, columns, rows)
    x, y = np.meshgrid(xs[0] + 20 * (np.arange(columns) + 0.5), ys[0] + 20 * (rows - np.arange(rows) - 0.5))
    lon, lat = transform("EPSG:32632", "EPSG:4326", x.ravel().tolist(), y.ravel().tolist())
    heights = rolling(np.array(lat), np.array(lon)).reshape(rows, columns).astype(np.float32)
    with MemoryFile() as memory:
        options = {"driver": "GTiff", "width": columns, "height": rows, "count": 1, "dtype": "float32"}
        with memory.open(**options, crs="EPSG:32632", transform=place) as dataset:
            dataset.write(heights, 1)
        return SourceFile(name="hills-utm.tiff", content=memory.read())


def hgt(name: str = "N47E008.hgt") -> SourceFile:
    """An SRTM tile of 3": 1201 x 1201 whole metres, big-endian, from the north-western corner on."""
    steps = np.arange(1201) / 1200.0
    lon, lat = np.meshgrid(8.0 + steps, 48.0 - steps)
    return SourceFile(name=name, content=np.clip(rolling(lat, lon), 0, 4000).round().astype(">i2").tobytes())


def expected(scenario: Scenario, east_m: float, north_m: float) -> float:
    lat, lon = east_north_to_geodetic(scenario.origin, east_m, north_m)
    return float(rolling(np.array(lat), np.array(lon)))


@pytest.mark.parametrize(("file", "within_m"), [(tif(), 0.3), (utm(), 0.3), (hgt(), 4.0)], ids=["tif", "utm", "hgt"])
def test_heights_are_those_of_the_tile_at_each_place(file: SourceFile, within_m: float) -> None:
    terrain = terrain_of([file], PAPER)
    assert PAPER.with_changes(terrain=terrain).terrain is terrain  # it covers the area
    rng = np.random.default_rng(1)
    for east, north in rng.uniform(0.0, 500.0, size=(50, 2)).tolist():
        assert terrain.height_at(east, north) == pytest.approx(expected(PAPER, east, north), abs=within_m)


def test_the_grid_is_half_as_wide_as_that_of_the_tile_and_never_too_large() -> None:
    fine = terrain_of([tif(spacing_deg=0.0003)], PAPER)
    assert fine.spacing_m == pytest.approx(0.0003 / 2 * 111_320 * np.cos(np.radians(LAT)), rel=0.01)
    small = tif(spacing_deg=0.00002)
    finest = terrain_of([small], PAPER)
    assert finest.grid_m.size <= MAX_HEIGHTS
    assert finest.spacing_m > 2.0


def test_where_the_grid_is_wider_than_the_tile_no_hill_between_its_places_is_lost() -> None:
    terrain = terrain_of([tif(spacing_deg=0.00002)], PAPER)
    rng = np.random.default_rng(2)
    below = [
        expected(PAPER, east, north) - terrain.height_at(east, north)
        for east, north in rng.uniform(0.0, 500.0, size=(300, 2)).tolist()
    ]
    assert max(below) < 0.05


@pytest.mark.parametrize(
    ("file", "why"),
    [
        (tif(nodata_at=True), "hills.tif: has no height at 47.4"),
        (tif(transform=from_origin(LON - 1.0, LAT + 0.012, 0.0003, 0.0003)), "in the flying area or beside it"),
        (tif(unit="ft"), "has heights in 'ft', but only metres are read"),
        (tif(crs=None), "does not say where it lies"),
        (SourceFile(name="hills.tif", content=b"no tile"), "is no GeoTIFF, and no SRTM tile named by its corner"),
        (SourceFile(name="N47E008.hgt", content=b"\x00" * 100), "is no GeoTIFF, and no SRTM tile named by its corner"),
        (hgt("N46E008.hgt"), "has no height at"),
    ],
)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_tile_that_does_not_serve_is_named_with_what_is_wrong(file: SourceFile, why: str) -> None:
    with pytest.raises(FaultyFilesError, match=why):
        terrain_of([file], PAPER)


def test_a_second_tile_fills_the_gaps_of_the_first() -> None:
    terrain = terrain_of([tif(nodata_at=True), hgt()], PAPER)
    assert terrain.height_at(250.0, 250.0) == pytest.approx(expected(PAPER, 250.0, 250.0), abs=1.0)


def test_files_and_a_tile_together_are_a_scenario_over_the_ground() -> None:
    files = [SourceFile(name="users.csv", content=USERS, kind="user"), tif()]
    settings = ScenarioSettings(clearance_m=35.0, altitude_min_m=40.0, altitude_max_m=110.0)
    imported = import_files(files, PAPER, settings)
    scenario = imported.scenario
    assert scenario.terrain is not None
    assert (scenario.clearance_m, scenario.altitude_min_m, scenario.altitude_max_m) == (35.0, 40.0, 110.0)
    assert any(note.startswith("terrain: ") and "m above sea level" in note for note in imported.notes)
    again = import_files(files[:1], scenario)
    assert again.scenario.terrain == scenario.terrain
    assert again.scenario.clearance_m == 35.0


def test_a_clearance_without_any_ground_is_refused() -> None:
    users = SourceFile(name="users.csv", content=USERS, kind="user")
    with pytest.raises(FaultyFilesError, match="clearance_m: it is kept over terrain, and there is none"):
        import_files([users], PAPER, ScenarioSettings(clearance_m=35.0))


def test_the_command_reads_a_tile_beside_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "users.csv").write_bytes(USERS)
    (tmp_path / "N47E008.hgt").write_bytes(hgt().content)
    asked = ["import", "--users", str(tmp_path / "users.csv"), "--terrain", str(tmp_path / "N47E008.hgt")]
    monkeypatch.setattr("sys.argv", ["skyfolio", *asked, "--example", "paper", "--clearance-m", "40"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    scenario = Scenario.model_validate(json.loads(capsys.readouterr().out))
    assert scenario.terrain is not None
    assert scenario.clearance_m == 40.0


def test_rasterio_is_what_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the error names the extra that installs it."""
    assert rasterio.__version__
    monkeypatch.setattr("skyfolio.api.common.extras.installed", lambda _module: False)
    with pytest.raises(MissingExtraError, match=r"pip install 'skyfolio\[terrain\]'"):
        terrain_of([tif()], PAPER)
