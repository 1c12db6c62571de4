"""Tables (CSV): one row for each user, UAV or zone, with its place in columns of degrees or as WKT."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from io import StringIO
from typing import Any

import shapely
from shapely.errors import GEOSException
from shapely.geometry import Point
from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import Holding, SourceFile
from skyfolio.api.places.properties import Reading, named_like

WKT = ("wkt", "wkt_geom", "geometry", "geom")
DELIMITERS = ",;\t"


def read(file: SourceFile) -> Holding:
    """Return the features of a table. Raises FaultyFilesError if it is none, or lacks the columns of a place."""
    rows = _rows(file)
    reading = Reading(file)
    table = _Table(file, rows[0] if rows else [])
    for index, cells in enumerate(rows[1:], start=2):
        if any(cell.strip() for cell in cells):
            table.take(reading, f"row {index}", cells)
    return reading.holding()


class _Table:
    """The columns of one table: which of them hold the place."""

    def __init__(self, file: SourceFile, header: Sequence[str]) -> None:
        self._names = [name.strip() for name in header]
        twice = [name for name, times in Counter(self._names).items() if times > 1 and name]
        if twice:
            raise FaultyFilesError([file.fault("columns", "several columns have this name", "row 1", twice[0])])
        self._lat, self._lon = named_like(self._names, "lat_deg"), named_like(self._names, "lon_deg")
        self._wkt = next((name for name in self._names if name.lower() in WKT), None)
        if (self._lat is None or self._lon is None) and self._wkt is None:
            message = "it must have columns lat_deg and lon_deg, degrees, or a column wkt"
            raise FaultyFilesError([file.fault("columns", message, "row 1")])
        self._used = frozenset(name for name in (self._lat, self._lon, self._wkt) if name)
        self._columns = {"lat": self._lat or self._wkt or "", "lon": self._lon or self._wkt or ""}

    def take(self, reading: Reading, row: str, cells: Sequence[str]) -> None:
        if len(cells) > len(self._names):
            message = f"it has {len(cells)} cells, but there are {len(self._names)} columns: is there a decimal comma?"
            reading.refuse("cells", message, row)
            return
        given = dict(zip(self._names, [*cells, *[""] * len(self._names)], strict=False))
        before = len(reading.faults)
        geometry = self._geometry(reading, row, given)
        if len(reading.faults) == before:
            reading.take(row, geometry, given, columns=self._columns, used=self._used)

    def _geometry(self, reading: Reading, row: str, given: dict[str, Any]) -> BaseGeometry | None:
        if self._wkt and given[self._wkt].strip():
            try:
                return shapely.from_wkt(given[self._wkt])
            except GEOSException as error:
                reading.refuse("wkt", f"it cannot be read: {error}", row, self._wkt)
                return None
        if self._lat is None or self._lon is None:
            return None
        lat, lon = (reading.number(row, name, given[name]) for name in (self._lat, self._lon))
        return None if lat is None or lon is None else Point(lon, lat)


def _rows(file: SourceFile) -> list[list[str]]:
    text = file.text()
    header = text.lstrip().split("\n", 1)[0]
    delimiter = max(DELIMITERS, key=header.count)
    try:
        return list(csv.reader(StringIO(text, newline=""), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise FaultyFilesError([file.fault("csv", f"it is not a table: {error}")]) from error
