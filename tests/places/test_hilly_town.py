"""The example of a hilly town: its script makes the files that lie beside it, and GDAL reads what is exported of it."""

from __future__ import annotations

import json
import runpy
from functools import cache
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio

from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.importing import Imported, import_files
from skyfolio.api.places.writing import Format, write_plan, write_scenario
from skyfolio.planner import Plan, Scenario
from skyfolio.planner.energy.account import account_of
from skyfolio.planner.plans import Summary

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "hilly_town"
FILES = ("users.csv", "town.geojson", "ground.tif")
GOLDEN = Path(__file__).parent / "golden"
FORMATS: tuple[Format, ...] = ("geojson", "kml", "csv")


@cache
def imported() -> Imported:
    """Return the town as `skyfolio import` makes it of its files."""
    return import_files([SourceFile(name=name, content=(EXAMPLE / name).read_bytes()) for name in FILES])


def hilly_town() -> Scenario:
    return imported().scenario


def hovering() -> Plan:
    """Return a plan of the town made by hand: two slots, over the starts, one metre higher in the second."""
    town = hilly_town().with_changes(slots=2, users=hilly_town().users[1:4])
    air = town.air
    assert air is not None
    paths = np.repeat(np.array([[uav.start_m] for uav in town.uavs]), 2, axis=1)
    altitudes = (air.ground_m + 45.0)[:, None] + np.array([0.0, 1.0])
    account = account_of(air, paths, np.full(3, 2), altitudes)
    users = town.user_ids
    return Plan(
        id="town-by-hand",
        method="by hand",
        first_slot=0,
        scenario=town,
        trajectories_m={uav.id: [uav.start_m] * 2 for uav in town.uavs},
        altitudes_m=dict(zip(town.uav_ids, altitudes.tolist(), strict=True)),
        energy_wh=dict(zip(town.uav_ids, account.used_wh.tolist(), strict=True)),
        energy_margin_wh=dict(zip(town.uav_ids, account.margin_wh.tolist(), strict=True)),
        association={user: [uav] * 2 for user, uav in zip(users, town.uav_ids, strict=True)},
        bandwidth_hz={user: [10_000.0, 9_000.0] for user in users},
        user_rates_bps={user: [8_000.0, 7_000.0] for user in users},
        summary=Summary.steady(),
    )


def test_the_script_makes_the_files_that_lie_beside_it(tmp_path: Path) -> None:
    runpy.run_path(str(EXAMPLE / "make_town.py"))["write"](tmp_path)
    for name in ("users.csv", "town.geojson"):
        assert (tmp_path / name).read_text() == (EXAMPLE / name).read_text()
    with rasterio.open(tmp_path / "ground.tif") as made, rasterio.open(EXAMPLE / "ground.tif") as kept:
        assert np.array_equal(made.read(1), kept.read(1))
        assert (made.transform, made.crs, made.units) == (kept.transform, kept.crs, kept.units)
    assert sum((EXAMPLE / name).stat().st_size for name in FILES) < 200_000


def test_another_seed_makes_another_town(tmp_path: Path) -> None:
    runpy.run_path(str(EXAMPLE / "make_town.py"))["write"](tmp_path, seed=20)
    assert (tmp_path / "users.csv").read_text() != (EXAMPLE / "users.csv").read_text()


def test_everything_in_the_files_of_the_town_becomes_part_of_the_scenario() -> None:
    town = hilly_town()
    assert not [note for note in imported().notes if "not used" in note]
    assert (len(town.users), len(town.uavs), len(town.no_fly)) == (13, 3, 2)
    assert town.wind is not None
    assert (town.wind.east_mps, town.wind.north_mps, town.wind.gust_mps) == (3.0, -2.0, 2.4)
    old_pack = town.uav("uav-3")
    assert old_pack.battery is not None
    assert (old_pack.battery.usable_wh, old_pack.battery.reserve_share) == (74.0, 0.775)
    assert old_pack.rotors is not None
    assert (old_pack.rotors.induced_w, old_pack.rotors.descend_mps) == (135.7, 0.7)
    assert town.terrain is not None
    assert np.ptp(town.terrain.grid_m) > 100.0
    homes = [town.terrain.height_at(*uav.start_m) for uav in town.uavs]
    assert max(homes) - min(homes) > 5.0
    users = {user.id: user for user in town.users}
    assert (users["clinic-1"].weight, users["old-town-1"].arrives_at_slot) == (4.0, 6)
    assert users["bus"].velocity_mps == (2.0, 0.5)
    assert all(user.demand_bps for user in town.users)


@pytest.mark.parametrize("form", ["geojson", "kml"])
def test_wind_batteries_and_rotors_survive_the_way_out_and_in(form: Format) -> None:
    town = hilly_town()
    back = import_files([SourceFile(name=f"town.{form}", content=write_scenario(town, form).encode())]).scenario
    assert back.wind == town.wind
    assert [(uav.battery, uav.rotors) for uav in back.uavs] == [(uav.battery, uav.rotors) for uav in town.uavs]


def test_a_base_keeps_its_wind() -> None:
    users = SourceFile(name="users.csv", content=(EXAMPLE / "users.csv").read_bytes())
    assert import_files([users], base=hilly_town()).scenario.wind == hilly_town().wind


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_written_of_the_town_is_the_golden_file(form: Format) -> None:
    assert write_plan(hovering(), form) == (GOLDEN / f"hilly_town.{form}").read_bytes().decode()


def test_geopandas_reads_the_golden_map_of_the_town() -> None:
    table = geopandas.read_file(GOLDEN / "hilly_town.geojson")
    assert table.crs.to_epsg() == 4326
    kinds = table["kind"].value_counts().to_dict()
    assert kinds == {"position": 6, "user": 3, "uav": 3, "path": 3, "no_fly": 2, "area": 1}
    flown = table[table["kind"] == "position"]
    told = hovering().altitudes_m
    assert told is not None
    for _, row in flown.iterrows():
        assert row["altitude_m"] == pytest.approx(told[row["uav_id"]][int(row["slot"])], abs=1e-6)
    places = table[table["kind"] == "uav"].set_index("id").geometry
    asked = {
        one["properties"]["id"]: one["geometry"]["coordinates"]
        for one in json.loads((EXAMPLE / "town.geojson").read_text())["features"]
        if one["properties"]["kind"] == "uav"
    }
    assert {uav: [place.x, place.y] for uav, place in places.items()} == asked


def test_geopandas_reads_the_golden_kml_and_table_of_the_town() -> None:
    layers = geopandas.list_layers(GOLDEN / "hilly_town.kml")["name"].tolist()
    features = [len(geopandas.read_file(GOLDEN / "hilly_town.kml", layer=layer)) for layer in layers]
    assert sum(features) == 18
    table = geopandas.read_file(GOLDEN / "hilly_town.csv")
    assert len(table) == 6
    assert set(table["uav_id"]) == {"uav-1", "uav-2", "uav-3"}
