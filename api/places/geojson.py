"""GeoJSON (RFC 7946): features with points and polygons, and a scenario's settings as the member `skyfolio`."""

from __future__ import annotations

import json
from typing import Any

import shapely
from pydantic_core import from_json
from shapely.errors import GEOSException
from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import Holding, SourceFile
from skyfolio.api.places.properties import Reading

SETTINGS = "skyfolio"
"""The member that holds what is no place: slots, altitude, channel, utility."""
COLUMNS = dict.fromkeys(("lat", "lon"), "coordinates")
_WGS_84 = ("CRS84", "EPSG::4326", "EPSG:4326")


def read(file: SourceFile) -> Holding:
    """Return the features of a GeoJSON file. Raises FaultyFilesError if it is not one."""
    document = _document(file)
    features = [document] if document.get("type") == "Feature" else document.get("features")
    if document.get("type") not in {"Feature", "FeatureCollection"} or not isinstance(features, list):
        message = "it must be a FeatureCollection or a Feature; a scenario in JSON is planned as it is"
        raise FaultyFilesError([file.fault("type", message, column="type")])
    reading = Reading(file)
    for index, feature in enumerate(features, start=1):
        _take(reading, f"feature {index}", feature)
    settings = document.get(SETTINGS)
    if settings is not None and not isinstance(settings, dict):
        reading.refuse("type", "it must be an object", column=SETTINGS)
    return reading.holding(settings if isinstance(settings, dict) else {})


def _document(file: SourceFile) -> dict[str, Any]:
    try:
        document = from_json(file.text(), allow_inf_nan=False)
    except ValueError as error:
        raise FaultyFilesError([file.fault("json", f"it is not JSON: {error}")]) from error
    if not isinstance(document, dict):
        raise FaultyFilesError([file.fault("type", "it must hold one JSON object")])
    crs = document.get("crs")
    if crs is not None and not json.dumps(crs).rstrip('"} ').endswith(_WGS_84):
        message = f"{json.dumps(crs)[:120]} is not WGS-84; save the layer in EPSG:4326"
        raise FaultyFilesError([file.fault("crs", message, column="crs")])
    return document


def _take(reading: Reading, row: str, feature: Any) -> None:
    if not isinstance(feature, dict) or not isinstance(feature.get("properties") or {}, dict):
        reading.refuse("type", "it must be an object of type Feature, with an object as its properties", row)
        return
    given = dict(feature.get("properties") or {})
    if "id" not in given and isinstance(feature.get("id"), str | int):
        given["id"] = feature["id"]
    try:
        geometry = _geometry(feature.get("geometry"))
    except (GEOSException, ValueError) as error:
        reading.refuse("geometry", f"it cannot be read: {error}", row, "geometry")
        return
    reading.take(row, geometry, given, columns=COLUMNS)


def _geometry(raw: Any) -> BaseGeometry | None:
    return None if raw is None else shapely.from_geojson(json.dumps(raw))
