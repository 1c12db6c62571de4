"""Makes the files of a hilly town, the same ones from the same seed: users, UAVs, zones, settings and the ground.

    python examples/hilly_town/make_town.py [--seed 19] [--out examples/hilly_town]

It needs numpy and rasterio, and nothing of skyfolio. The town does not exist: a river valley between two hills, with
its old town on one slope, a station in the valley and a clinic on the other side. `README.md` flies it.
"""

from __future__ import annotations

import argparse
import csv
import json
from io import StringIO
from math import cos, radians
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import from_origin

HERE = Path(__file__).parent
LAT_DEG, LON_DEG = 47.05, 7.62
"""The south-western corner of the area."""
WIDTH_M, HEIGHT_M = 900.0, 700.0
DEGREE_M = 111_195.0
SEED = 19
TILE_STEP_DEG = 0.00025
"""About 28 m to the north: as fine as a global tile."""
TILE_MARGIN_DEG = 0.0015
DECIMALS_DEG = 7
HILLS = ((160.0, 560.0, 95.0, 150.0), (720.0, 210.0, 120.0, 170.0), (430.0, 640.0, 50.0, 120.0))
"""East, north, height and width of each, metres."""
QUARTERS = (("old-town", 230.0, 470.0, 5), ("station", 470.0, 330.0, 4), ("clinic", 760.0, 330.0, 3))
"""Name, east, north, and how many users live there."""
STARTS = (("uav-1", 120.0, 330.0), ("uav-2", 420.0, 120.0), ("uav-3", 800.0, 520.0))
ROTORS = {
    "rotors_blade_w": 61.5,
    "rotors_tip_mps": 90.0,
    "rotors_induced_w": 135.7,
    "rotors_induced_mps": 6.29,
    "rotors_parasite_w_per_mps3": 0.018,
    "rotors_climb_w_per_mps": 19.62,
    "rotors_climb_mps": 1.2,
    "rotors_descend_mps": 0.7,
}
"""A 2 kg quadrotor of 500 mm on a battery of 74 Wh."""


def degrees(east_m: float, north_m: float) -> tuple[float, float]:
    """Return latitude and longitude of a place, metres from the south-western corner."""
    lat = LAT_DEG + north_m / DEGREE_M
    lon = LON_DEG + east_m / (DEGREE_M * cos(radians(LAT_DEG)))
    return round(lat, DECIMALS_DEG), round(lon, DECIMALS_DEG)


def heights_m(lat: np.ndarray[Any, Any], lon: np.ndarray[Any, Any], seed: int) -> np.ndarray[Any, Any]:
    """Return the ground above mean sea level, rough by half a metre, at tenths of a metre."""
    north = (lat - LAT_DEG) * DEGREE_M
    east = (lon - LON_DEG) * DEGREE_M * cos(radians(LAT_DEG))
    ground = 530.0 + 0.02 * north + np.random.default_rng(seed).random(lat.shape) * 0.5
    for hill_east, hill_north, height, width in HILLS:
        ground += height * np.exp(-((east - hill_east) ** 2 + (north - hill_north) ** 2) / (2.0 * width**2))
    return np.round(ground, 1)


def tile(seed: int) -> tuple[np.ndarray[Any, Any], Any]:
    """Return the heights of the tile, rows from north to south, and where its cells lie."""
    north_deg, east_deg = degrees(WIDTH_M, HEIGHT_M)
    top, left = north_deg + TILE_MARGIN_DEG, LON_DEG - TILE_MARGIN_DEG
    rows = round((top - LAT_DEG + TILE_MARGIN_DEG) / TILE_STEP_DEG)
    columns = round((east_deg + TILE_MARGIN_DEG - left) / TILE_STEP_DEG)
    middle_lat = top - (np.arange(rows) + 0.5) * TILE_STEP_DEG
    middle_lon = left + (np.arange(columns) + 0.5) * TILE_STEP_DEG
    lon, lat = np.meshgrid(middle_lon, middle_lat)
    return heights_m(lat, lon, seed).astype(np.float32), from_origin(left, top, TILE_STEP_DEG, TILE_STEP_DEG)


def users_csv(seed: int) -> str:
    """Return the users: who they are, what they ask for, how much they count, and when they are there."""
    rng = np.random.default_rng(seed + 1)
    rows: list[dict[str, object]] = []
    for quarter, east, north, count in QUARTERS:
        for number in range(1, count + 1):
            aside = (rng.random(2) - 0.5) * 140.0
            lat, lon = degrees(east + float(aside[0]), north + float(aside[1]))
            asks = {"demand_bps": int(rng.integers(6, 25)) * 1000, "weight": 1}
            rows.append({"id": f"{quarter}-{number}", "lat_deg": lat, "lon_deg": lon, **asks})
    rows[9]["weight"] = 4  # the emergency room
    rows[0]["arrives_at_slot"] = 6  # a market that opens
    rows[5]["leaves_at_slot"] = 14  # a train that departs
    lat, lon = degrees(330.0, 260.0)
    bus = {"velocity_east_mps": 2.0, "velocity_north_mps": 0.5, "uncertainty_m": 5, "uncertainty_mps": 0.2}
    rows.append({"id": "bus", "lat_deg": lat, "lon_deg": lon, "demand_bps": 20000, "weight": 2, **bus})
    names = ["id", "lat_deg", "lon_deg", "demand_bps", "weight", "arrives_at_slot", "leaves_at_slot", *bus]
    text = StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def town_geojson() -> str:
    """Return the area, the zones, the UAVs with what they are able to, and the settings of the scenario."""
    features = [
        _feature("area", "area", "Polygon", [_ring([(0, 0), (WIDTH_M, 0), (WIDTH_M, HEIGHT_M), (0, HEIGHT_M)])])
    ]
    helipad = {"radius_m": 45.0}
    features.append(_feature("helipad", "no_fly", "Point", _lon_lat(640.0, 420.0), helipad))
    church = [(300, 300), (350, 290), (360, 350), (310, 360)]
    features.append(_feature("church", "no_fly", "Polygon", [_ring(church)]))
    for name, east, north in STARTS:
        # the pack of uav-3 is old: more of it is kept back
        battery = {"battery_usable_wh": 74.0, "battery_reserve_share": 0.775 if name == "uav-3" else 0.25}
        able = {"max_speed_mps": 8.0, "max_airspeed_mps": 14.0, "max_climb_mps": 1.5}
        features.append(_feature(name, "uav", "Point", _lon_lat(east, north), {**able, **battery, **ROTORS}))
    settings = {
        "slots": 24,
        "slot_duration_s": 5.0,
        "altitude_m": 40.0,
        "altitude_min_m": 40.0,
        "altitude_max_m": 90.0,
        "clearance_m": 25.0,
        "min_separation_m": 10.0,
        "wind": {"east_mps": 3.0, "north_mps": -2.0, "gust_mps": 2.4},
        "utility": {"kind": "pooled", "mu_per_kbps": -0.2},
    }
    return json.dumps({"type": "FeatureCollection", "skyfolio": settings, "features": features}, indent=1) + "\n"


def _feature(
    name: str, kind: str, shape: str, coordinates: object, properties: dict[str, float] | None = None
) -> dict[str, object]:
    told = {"kind": kind, "id": name, **(properties or {})}
    return {"type": "Feature", "properties": told, "geometry": {"type": shape, "coordinates": coordinates}}


def _lon_lat(east_m: float, north_m: float) -> list[float]:
    lat, lon = degrees(east_m, north_m)
    return [lon, lat]


def _ring(corners: list[tuple[float, float]]) -> list[list[float]]:
    return [_lon_lat(*corner) for corner in [*corners, corners[0]]]


def main() -> None:
    """Write the three files."""
    parser = argparse.ArgumentParser(description="Make the files of a hilly town.")
    parser.add_argument("--seed", type=int, default=SEED, help="of roughness, places and demands")
    parser.add_argument("--out", type=Path, default=HERE, help="folder to write to")
    given = parser.parse_args()
    write(given.out, given.seed)


def write(folder: Path, seed: int = SEED) -> None:
    """Write users.csv, town.geojson and ground.tif."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "users.csv").write_text(users_csv(seed))
    (folder / "town.geojson").write_text(town_geojson())
    heights, place = tile(seed)
    rows, columns = heights.shape
    shape = {"width": columns, "height": rows, "count": 1, "dtype": "float32", "compress": "deflate", "predictor": 3}
    with rasterio.open(folder / "ground.tif", "w", driver="GTiff", crs="EPSG:4326", transform=place, **shape) as made:
        made.write(heights, 1)
        made.units = ("m",)


if __name__ == "__main__":
    main()
