"""Ground heights from GeoTIFF and SRTM tiles (.hgt): a scenario's terrain, on a square grid of its own frame.

Tiles hold heights above mean sea level, metres (SRTM: above the geoid EGM96). The grid is half as wide as the tile's
own, as long as that fits; where it is wider, each place has the greatest height around it, so that no hill is lost
between two places. Needs rasterio (GDAL), which the extra `terrain` installs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from math import ceil, floor
from typing import Any

import numpy as np

from skyfolio.api.common.extras import require
from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.rasters import band_of, opened, sampled, spacing_of
from skyfolio.planner import Scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.geodesy import points_to_geodetic
from skyfolio.planner.terrain import MAX_HEIGHTS, Terrain

MARGIN_M = 50.0
"""The grid reaches this far beyond the flying area."""
DECIMALS_M = 2
_METRES = {None, "", "m", "metre", "metres", "meter", "meters"}
NO_TILE = "is no GeoTIFF, and no SRTM tile named by its corner, as N47E008.hgt"


def terrain_of(files: Sequence[SourceFile], scenario: Scenario) -> Terrain:
    """Return the ground under a scenario's flying area; where tiles overlap, the first one counts.

    Raises FaultyFilesError for a file that is no such tile, has no place or not metres, and for places without a
    height, and MissingExtraError without rasterio.
    """
    require("rasterio", "reading elevation tiles")
    with ExitStack() as stack:
        tiles = [_Tile(file, opened(file, stack, NO_TILE)) for file in files]
        spacing_m = min(tile.spacing_m for tile in tiles) / 2
        corner, rows, columns, spacing_m, finer = _grid(scenario, spacing_m)
        fine_m = spacing_m / finer
        reach = finer if finer > 1 else 0  # so many finer places on each side of a place count for it
        north = np.arange(-reach, (rows - 1) * finer + reach + 1) * fine_m + corner[1]
        east = np.arange(-reach, (columns - 1) * finer + reach + 1) * fine_m + corner[0]
        heights = _heights(tiles, scenario, east.tolist(), north.tolist())
    grid = _greatest(heights, rows, columns, finer, reach)
    return Terrain(
        south_west_m=corner,
        spacing_m=spacing_m,
        heights_m=tuple(map(tuple, (np.ceil(grid * 10**DECIMALS_M) / 10**DECIMALS_M).tolist())),
    )


def _grid(scenario: Scenario, spacing_m: float) -> tuple[tuple[float, float], int, int, float, int]:
    """Return corner, rows, columns, spacing and how many finer steps one spacing has: a grid that is not too large."""
    (west, south), (east, north) = scenario.area_m
    width, height = east - west + 2 * MARGIN_M, north - south + 2 * MARGIN_M
    finer = 1
    while (ceil(width / (spacing_m * finer)) + 1) * (ceil(height / (spacing_m * finer)) + 1) > MAX_HEIGHTS:
        finer += 1
    wide_m = spacing_m * finer
    columns, rows = ceil(width / wide_m) + 1, ceil(height / wide_m) + 1
    return (float(floor(west - MARGIN_M)), float(floor(south - MARGIN_M))), rows, columns, wide_m, finer


def _greatest(heights: Array, rows: int, columns: int, finer: int, reach: int) -> Array:
    """Return the greatest of the finer heights around each place of the grid: (rows, columns)."""
    shifted = [
        heights[up : up + (rows - 1) * finer + 1 : finer, right : right + (columns - 1) * finer + 1 : finer]
        for up in range(2 * reach + 1)
        for right in range(2 * reach + 1)
    ]
    greatest: Array = np.max(shifted, axis=0)
    return greatest


def _heights(tiles: Sequence[_Tile], scenario: Scenario, east: list[float], north: list[float]) -> Array:
    """Return the heights at all places of a grid, (len(north), len(east)) metres. Raises FaultyFilesError for gaps."""
    places = [(e, n) for n in north for e in east]
    lat, lon = np.array(points_to_geodetic(scenario.origin, places)).T
    heights = np.full(len(places), np.nan)
    for tile in tiles:
        missing = np.isnan(heights)
        if missing.any():
            heights[missing] = tile.sampled(lon[missing], lat[missing])
    if np.isnan(heights).any():
        where = int(np.isnan(heights).argmax())
        message = f"has no height at {lat[where]:.6f}, {lon[where]:.6f} degrees, in the flying area or beside it"
        raise FaultyFilesError([tile.file.fault("coverage", message) for tile in tiles])
    return heights.reshape(len(north), len(east))


class _Tile:
    """One open file: its heights, where its cells are, and what no height is written as."""

    def __init__(self, file: SourceFile, dataset: Any) -> None:
        self.file = file
        self._dataset = dataset
        unit = dataset.units[0]
        if unit not in _METRES:
            raise FaultyFilesError([file.fault("unit", f"has heights in {unit!r}, but only metres are read")])
        self._heights = band_of(dataset, 1)

    @property
    def spacing_m(self) -> float:
        """How far its heights are apart: the lesser of both directions, metres."""
        return spacing_of(self._dataset)

    def sampled(self, lon: Array, lat: Array) -> Array:
        """Return the heights at places in degrees, bilinear between the middles of cells; NaN where there are none."""
        return sampled(self._dataset, self._heights, lon, lat)


def lines_of(terrain: Terrain) -> Iterator[str]:
    """Yield what an import says of the ground it has read."""
    grid = terrain.grid_m
    yield (
        f"terrain: {grid.shape[1]} x {grid.shape[0]} heights, {terrain.spacing_m:.3g} m apart, from "
        f"{grid.min():.0f} to {grid.max():.0f} m above sea level"
    )
