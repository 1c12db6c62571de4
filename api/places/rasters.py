"""GeoTIFFs and other rasters that GDAL reads: opened from memory, and sampled at places in degrees.

Needs rasterio (GDAL), which the extra `terrain` installs.
"""

from __future__ import annotations

from contextlib import ExitStack
from math import cos, radians
from typing import Any

import numpy as np

from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import SourceFile
from skyfolio.planner.arrays import Array

_DEGREE_M = 111_320.0


def opened(file: SourceFile, stack: ExitStack, otherwise: str) -> Any:
    """Return the raster of a file, open for as long as the stack is; otherwise: what the file is if it is none.

    Raises FaultyFilesError, also for a raster that does not say where it lies.
    """
    from rasterio import MemoryFile  # noqa: PLC0415 - an extra
    from rasterio.errors import RasterioIOError  # noqa: PLC0415

    try:
        memory = stack.enter_context(MemoryFile(file.content, filename=file.name.rpartition("/")[2]))
        dataset = stack.enter_context(memory.open())
    except RasterioIOError as error:
        raise FaultyFilesError([file.fault("format", otherwise)]) from error
    if dataset.crs is None:
        raise FaultyFilesError([file.fault("place", "does not say where it lies; use a GeoTIFF, or N47E008.hgt")])
    return dataset


def spacing_of(dataset: Any) -> float:
    """Return how far the cells of a raster are apart: the lesser of both directions, metres."""
    across, along = dataset.res
    if not dataset.crs.is_geographic:
        return float(min(across, along))
    middle = (dataset.bounds.bottom + dataset.bounds.top) / 2
    return float(min(across * cos(radians(middle)), along)) * _DEGREE_M


def band_of(dataset: Any, number: int) -> Array:
    """Return one band of a raster, counted from 1: (rows, columns), NaN where it has no data."""
    values: Array = dataset.read(number, masked=True).astype(float).filled(np.nan)
    return values


def sampled(dataset: Any, values: Array, lon: Array, lat: Array) -> Array:
    """Return a band's values at places in degrees, bilinear between the middles of cells; NaN where there are none."""
    from rasterio.warp import transform  # noqa: PLC0415 - an extra

    x, y = transform("EPSG:4326", dataset.crs, lon.tolist(), lat.tolist())
    column, row = ~dataset.transform * (np.array(x), np.array(y))
    rows, columns = values.shape
    column, row = column - 0.5, row - 0.5
    outside = (column < -0.5) | (row < -0.5) | (column > columns - 0.5) | (row > rows - 0.5)
    column, row = np.clip(column, 0.0, columns - 1.0), np.clip(row, 0.0, rows - 1.0)
    left, top = np.minimum(column.astype(int), columns - 2), np.minimum(row.astype(int), rows - 2)
    x_share, y_share = column - left, row - top
    upper = (1 - x_share) * values[top, left] + x_share * values[top, left + 1]
    lower = (1 - x_share) * values[top + 1, left] + x_share * values[top + 1, left + 1]
    found: Array = np.where(outside, np.nan, (1 - y_share) * upper + y_share * lower)
    return found
