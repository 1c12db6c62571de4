"""KML 2.2 (OGC 07-147r2): placemarks with points and polygons. Read without entities, document types or fetching."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring
from shapely.errors import GEOSException
from shapely.geometry import LineString, MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import Holding, SourceFile
from skyfolio.api.places.geojson import SETTINGS
from skyfolio.api.places.properties import Reading, WrongValueError, number

COLUMNS = dict.fromkeys(("lat", "lon"), "coordinates")
_READ = frozenset({"Point", "LineString", "Polygon", "MultiGeometry"})


def read(file: SourceFile) -> Holding:
    """Return the placemarks of a KML file. Raises FaultyFilesError if it is none."""
    root = _root(file)
    reading = Reading(file)
    for index, (placemark, folders) in enumerate(_placemarks(root), start=1):
        name = _text(placemark, "name")
        row = f"Placemark {index}" + (f" {name!r}" if name else "")
        given = {"name": name, **_data(placemark)}
        try:
            geometry = _geometry(placemark)
        except WrongValueError as error:
            reading.refuse(error.rule, str(error), row, "coordinates")
            continue
        reading.take(row, geometry, given, folders=folders, columns=COLUMNS)
    return reading.holding(_settings(reading, root))


def _root(file: SourceFile) -> Element:
    if file.content[:2] == b"PK":
        raise FaultyFilesError([file.fault("kmz", "it is a KMZ archive; unpack it and import the KML file inside")])
    try:
        root: Element = fromstring(file.text() if file.encoding else file.content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise FaultyFilesError([file.fault("xml", "it must declare no document type and no entities")]) from error
    except (ParseError, ValueError, LookupError) as error:
        raise FaultyFilesError([file.fault("xml", f"it is not plain XML: {error}")]) from error
    if _local(root) != "kml":
        raise FaultyFilesError([file.fault("xml", f"its root must be <kml>, not <{_local(root)[:40]}>")])
    return root


def _placemarks(root: Element) -> Iterator[tuple[Element, tuple[str, ...]]]:
    """Yield each placemark and the names of the folders that it is in, innermost first; in the order of the file."""
    waiting: list[tuple[Element, tuple[str, ...]]] = [(root, ())]
    while waiting:
        element, folders = waiting.pop()
        if _local(element) == "Placemark":
            yield element, folders
            continue
        name = _text(element, "name") if _local(element) == "Folder" else ""
        inside = (name, *folders) if name else folders
        waiting.extend((child, inside) for child in reversed(element))


def _geometry(placemark: Element) -> BaseGeometry | None:
    shapes = [child for child in placemark if _local(child) in _READ]
    if not shapes:
        return None
    if _local(shapes[0]) == "Point":
        [where] = _coordinates(shapes[0], exactly=1)
        return Point(where)
    if _local(shapes[0]) == "LineString":
        places = _coordinates(shapes[0])
        if len(places) < 2:
            raise WrongValueError("coordinates", f"a line must have two places or more, not {len(places)}")
        return LineString(places)
    polygons = [element for element in shapes[0].iter() if _local(element) == "Polygon"]
    if not polygons:
        raise WrongValueError("geometry", f"a {_local(shapes[0])} must hold polygons")
    made = [_polygon(element) for element in polygons]
    return made[0] if len(made) == 1 else MultiPolygon(made)


def _polygon(element: Element) -> Polygon:
    rings: dict[str, list[Any]] = {"outerBoundaryIs": [], "innerBoundaryIs": []}
    for child in element:
        if _local(child) in rings:
            rings[_local(child)].append(_coordinates(child))
    if len(rings["outerBoundaryIs"]) != 1:
        raise WrongValueError("geometry", "a polygon must have one outer boundary")
    try:
        return Polygon(rings["outerBoundaryIs"][0], rings["innerBoundaryIs"])
    except (GEOSException, ValueError) as error:
        raise WrongValueError("geometry", f"it cannot be read: {error}") from error


def _coordinates(element: Element, exactly: int | None = None) -> list[tuple[float, float]]:
    """Return longitude and latitude of each tuple. Raises WrongValueError."""
    text = next((child.text or "" for child in element.iter() if _local(child) == "coordinates"), "")
    places = []
    for entry in text.split():
        parts = entry.split(",")
        if len(parts) not in {2, 3}:
            raise WrongValueError("coordinates", f"{entry[:60]!r} must be longitude,latitude[,height]")
        lon, lat = (number(part) for part in parts[:2])
        if lon is None or lat is None:
            raise WrongValueError("coordinates", f"{entry[:60]!r} lacks a number")
        places.append((lon, lat))
    if exactly is not None and len(places) != exactly:
        raise WrongValueError("coordinates", f"there must be {exactly} place, not {len(places)}")
    return places


def _data(element: Element) -> dict[str, Any]:
    """Return the extended data of an element: `Data` and `SimpleData` by name."""
    found: dict[str, Any] = {}
    for extended in (child for child in element if _local(child) == "ExtendedData"):
        for entry in extended.iter():
            if _local(entry) == "Data" and entry.get("name"):
                found[str(entry.get("name"))] = _text(entry, "value")
            elif _local(entry) == "SimpleData" and entry.get("name"):
                found[str(entry.get("name"))] = (entry.text or "").strip()
    return found


def _settings(reading: Reading, root: Element) -> dict[str, Any]:
    for document in (child for child in root if _local(child) == "Document"):
        text = _data(document).get(SETTINGS)
        if text:
            try:
                settings = json.loads(text)
            except (ValueError, RecursionError) as error:
                reading.refuse("json", f"it is not JSON: {error}", column=SETTINGS)
                return {}
            if isinstance(settings, dict):
                return settings
            reading.refuse("type", "it must be an object", column=SETTINGS)
    return {}


def _text(element: Element, name: str) -> str:
    return next(((child.text or "").strip() for child in element if _local(child) == name), "")


def _local(element: Element) -> str:
    """Return the name without its namespace; comments and instructions have none."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
