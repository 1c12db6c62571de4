"""Maps of gains from files: what ray tracers and survey flights write, as a scenario's `channel` of the kind `map`.

An .npz has arrays by the names of the channel's fields: `gains_db` (receivers, levels, rows from south to north,
columns from west to east), `levels_m`, `spacing_m`, and places either in metres of the scenario's frame (`receivers_m`,
`south_west_m`) or in degrees (`receivers_deg`, `south_west_deg`: latitude, longitude). A GeoTIFF is the map of one
receiver, with a band for each level; tags say which: `RECEIVER_DEG=47.3771,8.5412` and `LEVELS_M=60,80`. Several
GeoTIFFs are several receivers. What lies outside of the flying area is left out, and gains are kept to a tenth of a dB.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from io import BytesIO
from math import ceil, floor
from typing import Any
from zipfile import BadZipFile

import numpy as np
from pydantic import ValidationError

from skyfolio.api.common.extras import require
from skyfolio.api.common.validation import broken_rules
from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.rasters import band_of, opened, sampled, spacing_of
from skyfolio.planner import Scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.gain_map import MAX_GAINS, GainMap
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.geodesy import geodetic_to_east_north, points_to_geodetic

NO_PATH_DB = -200.0
"""Of a place from which nothing arrives: ray tracers write minus infinity."""
DECIMALS_DB = 1
RECEIVER, LEVELS = "RECEIVER_DEG", "LEVELS_M"
_DECIBELS = {None, "", "dB", "db"}


def gain_map_of(files: Sequence[SourceFile], scenario: Scenario) -> GainMap:
    """Return the map in one .npz or in GeoTIFFs, over a scenario's flying area; all else as in its channel.

    Raises FaultyFilesError that names the file and the rule, and MissingExtraError for GeoTIFF without rasterio.
    """
    numpy_files = [file for file in files if file.suffix == ".npz"]
    if numpy_files and len(files) > 1:
        raise FaultyFilesError([files[1].fault("gain_map", "an .npz holds a whole map: give it alone")])
    read = _from_numpy(files[0], scenario) if numpy_files else _from_rasters(files, scenario)
    read["gains_db"] = np.round(np.maximum(read["gains_db"], NO_PATH_DB), DECIMALS_DB).tolist()
    kept = {name: value for name, value in scenario.channel if name in RadioChannel.model_fields and value is not None}
    try:
        return GainMap.model_validate({**kept, **read})
    except ValidationError as error:
        faults = [
            files[0].fault(row["rule"], row["message"], column=row["field"]) for row in broken_rules(error.errors(), ())
        ]
        raise FaultyFilesError(faults) from error


def lines_of(channel: GainMap) -> Iterator[str]:
    """Yield what an import says of the map it has read."""
    rows, columns = len(channel.gains_db[0][0]), len(channel.gains_db[0][0][0])
    levels = ", ".join(f"{level:g}" for level in channel.levels_m)
    yield (
        f"channel: map of {len(channel.receivers_m)} receivers, {columns} x {rows} places {channel.spacing_m:.3g} m "
        f"apart, at {levels} m"
    )


# --- NumPy ---


def _from_numpy(file: SourceFile, scenario: Scenario) -> dict[str, Any]:
    arrays = _arrays(file)
    gains = _array(file, arrays, "gains_db", 4)
    spacing_m = float(_array(file, arrays, "spacing_m", 0))
    if not spacing_m > 0.0:
        raise FaultyFilesError([file.fault("gain_map", f"{spacing_m:g} m must be greater than 0", column="spacing_m")])
    south_west = _places(file, arrays, "south_west", 1, scenario)[0]
    rows, columns = (
        _within(south_west[axis], spacing_m, gains.shape[3 - axis], scenario.area_m, axis) for axis in (1, 0)
    )
    cut = gains[:, :, rows, columns]
    if np.isnan(cut).any():
        receiver, level, row, column = (int(at[0]) for at in np.nonzero(np.isnan(cut)))
        place = f"receiver {receiver}, level {level}, row {row + rows.start}, column {column + columns.start}"
        raise FaultyFilesError([file.fault("coverage", f"has no gain at {place}", column="gains_db")])
    return {
        "receivers_m": _places(file, arrays, "receivers", 2, scenario),
        "levels_m": _array(file, arrays, "levels_m", 1).tolist(),
        "south_west_m": (south_west[0] + columns.start * spacing_m, south_west[1] + rows.start * spacing_m),
        "spacing_m": spacing_m,
        "gains_db": cut,
    }


def _arrays(file: SourceFile) -> Mapping[str, Array]:
    try:
        with np.load(BytesIO(file.content), allow_pickle=False) as opened_file:
            return {name: np.asarray(opened_file[name], dtype=float) for name in opened_file.files}
    except (BadZipFile, ValueError, OSError, EOFError, KeyError) as error:
        message = "is no .npz with arrays of numbers, as numpy.savez writes it"
        raise FaultyFilesError([file.fault("format", message)]) from error


def _array(file: SourceFile, arrays: Mapping[str, Array], name: str, dimensions: int) -> Array:
    if name not in arrays:
        known = ", ".join(sorted(arrays)) or "none"
        raise FaultyFilesError([file.fault("missing", f"it has no such array, only: {known}", column=name)])
    found = arrays[name]
    if found.ndim != dimensions or 0 in found.shape:
        message = f"has the shape {found.shape}, but must have {dimensions} dimensions, none of them 0"
        raise FaultyFilesError([file.fault("shape", message, column=name)])
    return found


def _places(
    file: SourceFile, arrays: Mapping[str, Array], name: str, dimensions: int, scenario: Scenario
) -> list[tuple[float, float]]:
    """Return places in metres, given as `NAME_m` or as `NAME_deg`."""
    given = f"{name}_deg" if f"{name}_deg" in arrays else f"{name}_m"
    found = np.atleast_2d(_array(file, arrays, given, dimensions))
    if found.shape[1] != 2:
        raise FaultyFilesError([file.fault("shape", f"has the shape {found.shape}, but places have 2", column=given)])
    places = [(float(one), float(other)) for one, other in found.tolist()]
    if given.endswith("_m"):
        return places
    return [_rounded(geodetic_to_east_north(scenario.origin, *place)) for place in places]


def _rounded(place_m: Sequence[float]) -> tuple[float, float]:
    return round(place_m[0], 3), round(place_m[1], 3)


def _within(first_m: float, spacing_m: float, count: int, area_m: Any, axis: int) -> slice:
    """Return the places of one axis that cover the flying area, where there are such."""
    begin = min(max(floor((area_m[0][axis] - first_m) / spacing_m), 0), max(count - 2, 0))
    end = max(min(ceil((area_m[1][axis] - first_m) / spacing_m), count - 1), begin + 1)
    return slice(begin, end + 1)


# --- GeoTIFF ---


def _from_rasters(files: Sequence[SourceFile], scenario: Scenario) -> dict[str, Any]:
    require("rasterio", "reading maps of gains")
    with ExitStack() as stack:
        datasets = [opened(file, stack, "is no GeoTIFF") for file in files]
        tags = [_tagged(file, dataset) for file, dataset in zip(files, datasets, strict=True)]
        levels = tags[0][1]
        for file, (_, others) in zip(files, tags, strict=True):
            if others != levels:
                message = f"has the levels {others}, but {files[0].name} has {levels}"
                raise FaultyFilesError([file.fault("gain_map", message, column=LEVELS)])
        corner, rows, columns, spacing_m = _grid(scenario, min(map(spacing_of, datasets)), len(files) * len(levels))
        places = [(corner[0] + c * spacing_m, corner[1] + r * spacing_m) for r in range(rows) for c in range(columns)]
        lat, lon = np.array(points_to_geodetic(scenario.origin, places)).T
        maps = [_sampled(file, dataset, lon, lat) for file, dataset in zip(files, datasets, strict=True)]
    return {
        "receivers_m": [_rounded(geodetic_to_east_north(scenario.origin, *receiver)) for receiver, _ in tags],
        "levels_m": levels,
        "south_west_m": corner,
        "spacing_m": spacing_m,
        "gains_db": np.array(maps).reshape(len(files), len(levels), rows, columns),
    }


def _tagged(file: SourceFile, dataset: Any) -> tuple[tuple[float, float], list[float]]:
    """Return where the receiver of a raster is, degrees, and its levels, as the tags say."""
    receiver, levels = (_numbers(file, dataset.tags(), name) for name in (RECEIVER, LEVELS))
    if len(receiver) != 2:
        raise FaultyFilesError([file.fault("gain_map", "must be latitude and longitude, degrees", column=RECEIVER)])
    if len(levels) != dataset.count:
        message = f"names {len(levels)} levels for {dataset.count} bands"
        raise FaultyFilesError([file.fault("gain_map", message, column=LEVELS)])
    strange = next((unit for unit in dataset.units if unit not in _DECIBELS), None)
    if strange is not None:
        raise FaultyFilesError([file.fault("unit", f"has gains in {strange!r}, but only dB are read")])
    return (receiver[0], receiver[1]), levels


def _numbers(file: SourceFile, tags: Mapping[str, str], name: str) -> list[float]:
    try:
        return [float(part) for part in tags[name].split(",")]
    except KeyError:
        message = "has no such tag; gdal_edit.py -mo RECEIVER_DEG=47.3771,8.5412 -mo LEVELS_M=60 sets them"
        raise FaultyFilesError([file.fault("missing", message, column=name)]) from None
    except ValueError:
        message = f"{tags[name]!r} must be numbers with commas between them"
        raise FaultyFilesError([file.fault("gain_map", message, column=name)]) from None


def _grid(scenario: Scenario, spacing_m: float, maps: int) -> tuple[tuple[float, float], int, int, float]:
    """Return corner, rows, columns and spacing of a grid over the flying area, wider where it would be too large."""
    (west, south), (east, north) = scenario.area_m
    wide_m = spacing_m
    while True:
        columns, rows = max(ceil((east - west) / wide_m), 1) + 1, max(ceil((north - south) / wide_m), 1) + 1
        if maps * rows * columns <= MAX_GAINS or rows * columns <= 4:
            return (west, south), rows, columns, wide_m
        wide_m *= 1.1


def _sampled(file: SourceFile, dataset: Any, lon: Array, lat: Array) -> list[Array]:
    bands = [
        sampled(dataset, np.maximum(band_of(dataset, number + 1), NO_PATH_DB), lon, lat)
        for number in range(dataset.count)
    ]
    for band in bands:
        if np.isnan(band).any():
            at = int(np.isnan(band).argmax())
            message = f"has no gain at {lat[at]:.6f}, {lon[at]:.6f} degrees, in the flying area or beside it"
            raise FaultyFilesError([file.fault("coverage", message)])
    return bands
