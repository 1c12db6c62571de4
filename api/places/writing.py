"""Features as GeoJSON, KML or CSV, and a plan's positions as a table."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from itertools import groupby
from typing import Any, Literal
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from shapely import to_wkt
from shapely.geometry import LineString, Point, Polygon, mapping
from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.geojson import SETTINGS
from skyfolio.api.places.outlining import (
    DECIMALS_DEG,
    Outlined,
    features_of,
    features_of_plan,
    positions,
    settings_of,
)
from skyfolio.planner import Plan, Scenario

Format = Literal["geojson", "kml", "csv"]
MEDIA_TYPES: Mapping[Format, str] = {
    "geojson": "application/geo+json",
    "kml": "application/vnd.google-earth.kml+xml",
    "csv": "text/csv; charset=utf-8",
}
KML = "http://www.opengis.net/kml/2.2"
_FOLDERS = {
    "area": "Area", "no_fly": "No-fly zones", "user": "Users", "uav": "UAVs", "rally_point": "Rally points",
    "path": "Paths",
}  # fmt: skip
_POSITIONS = "Slots"


def write_plan(plan: Plan, form: Format) -> str:
    """Return a plan with its scenario as features; as CSV its positions, a row for each slot and UAV."""
    if form == "csv":
        return _table(list(positions(plan)))
    return _features(features_of_plan(plan), plan.scenario, form, plan.id)


def write_scenario(scenario: Scenario, form: Format) -> str:
    """Return a scenario as features; as CSV a row for each, with its place as WKT. An import reads it back."""
    if form == "csv":
        rows = [
            {"kind": one.kind, "id": one.name, "wkt": _wkt(one.geometry), **one.properties}
            for one in features_of(scenario)
        ]
        return _table(rows)
    return _features(features_of(scenario), scenario, form, "scenario")


def _features(features: Sequence[Outlined], scenario: Scenario, form: Format, name: str) -> str:
    return _geojson(features, scenario) if form == "geojson" else _kml(features, scenario, name)


def _geojson(features: Iterable[Outlined], scenario: Scenario) -> str:
    collection = {
        "type": "FeatureCollection",
        SETTINGS: settings_of(scenario),
        "features": [
            {
                "type": "Feature",
                "id": one.name,
                "geometry": mapping(one.geometry),
                "properties": {"kind": one.kind, "id": one.name, **one.properties},
            }
            for one in features
        ],
    }
    return json.dumps(collection, indent=1) + "\n"


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = StringIO(newline="")
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _kml(features: Sequence[Outlined], scenario: Scenario, name: str) -> str:
    root = Element("kml", xmlns=KML)
    document = SubElement(root, "Document")
    SubElement(document, "name").text = name
    _extended(document, {SETTINGS: json.dumps(settings_of(scenario))})
    for kind, group in groupby(features, key=lambda one: one.kind):
        folder = SubElement(document, "Folder")
        SubElement(folder, "name").text = _FOLDERS.get(kind, _POSITIONS)
        for one in group:
            _placemark(folder, one)
    indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def _placemark(folder: Element, one: Outlined) -> None:
    placemark = SubElement(folder, "Placemark")
    SubElement(placemark, "name").text = one.name
    _extended(placemark, {"kind": one.kind, "id": one.name, **one.properties})
    shape = one.geometry
    if isinstance(shape, Polygon):
        ring = SubElement(SubElement(SubElement(placemark, "Polygon"), "outerBoundaryIs"), "LinearRing")
        _coordinates(ring, shape.exterior.coords, None)
    elif isinstance(shape, Point | LineString):
        element = SubElement(placemark, shape.geom_type)
        if one.height_m is not None:
            SubElement(element, "altitudeMode").text = "absolute" if one.above_sea else "relativeToGround"
        _coordinates(element, shape.coords, one.height_m)


def _extended(element: Element, data: Mapping[str, Any]) -> None:
    extended = SubElement(element, "ExtendedData")
    for name, value in data.items():
        SubElement(SubElement(extended, "Data", name=name), "value").text = str(value)


def _coordinates(element: Element, places: Iterable[tuple[float, ...]], heights_m: Sequence[float] | None) -> None:
    flat = [f"{_deg(lon)},{_deg(lat)}" for lon, lat, *_ in places]
    shown = flat if heights_m is None else [f"{at},{up:.12g}" for at, up in zip(flat, heights_m, strict=True)]
    SubElement(element, "coordinates").text = " ".join(shown)


def _deg(value: float) -> str:
    return f"{value:.{DECIMALS_DEG}f}".rstrip("0").rstrip(".")


def _wkt(shape: BaseGeometry) -> str:
    return str(to_wkt(shape, rounding_precision=DECIMALS_DEG, trim=True))
