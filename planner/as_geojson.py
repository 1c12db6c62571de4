"""A scenario out of a GeoJSON document (RFC 7946), as `skyfolio export --format geojson` writes it. No files.

Each feature says with its property `kind` what it is (user, uav, no_fly, area, rally_point); its other properties are
the fields of that part, and its geometry is its place. The member `skyfolio` of the collection holds what is no place.
Other ways of writing things, and CSV and KML, are read at the edge (`api/places`), which also chooses what is missing.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

LISTS = {"user": "users", "uav": "uavs", "no_fly": "no_fly", "rally_point": "rally_points"}
PLACES = {"user": "position_deg", "uav": "start_deg", "no_fly": "center_deg", "rally_point": "position_deg"}
_GEOMETRIES = {"user": ("Point", "LineString"), "uav": ("Point",), "no_fly": ("Point", "Polygon"), "area": ("Polygon",)}


def raw_scenario(document: Mapping[str, Any] | str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of the scenario that a document describes; `settings` count more than those in it.

    Raises ValueError, the message naming the feature by its number from 0 and the rule.
    """
    collection = json.loads(document) if isinstance(document, str) else document
    if not isinstance(collection, Mapping) or collection.get("type") != "FeatureCollection":
        raise ValueError("type: a scenario is a FeatureCollection")
    raw: dict[str, Any] = {**(collection.get("skyfolio") or {}), **{name: [] for name in LISTS.values()}}
    for number, feature in enumerate(collection.get("features") or ()):
        _take(raw, f"features.{number}", feature)
    return {**raw, **settings}


def _take(raw: dict[str, Any], where: str, feature: Any) -> None:
    properties, geometry = dict(feature.get("properties") or {}), feature.get("geometry") or {}
    kind, form = properties.pop("kind", None), geometry.get("type")
    if kind not in {*LISTS, "area"}:
        raise ValueError(f"{where}.properties.kind: {kind!r} must be one of {', '.join((*LISTS, 'area'))}")
    if form not in _GEOMETRIES.get(kind, ("Point",)):
        known = " or ".join(_GEOMETRIES.get(kind, ("Point",)))
        raise ValueError(f"{where}.geometry.type: of kind {kind} it must be {known}, not {form!r}")
    coordinates = geometry["coordinates"]
    if kind == "area":
        raw["area_deg"] = _ring(where, coordinates)
        return
    fields = {"id": feature["id"]} if "id" in feature else {}
    fields |= {name: value for name, value in properties.items() if value is not None}
    if kind == "no_fly":
        fields = {name: value for name, value in fields.items() if name != "id"}
        fields["kind"] = "disc" if form == "Point" else "polygon"
    if form == "Polygon":
        fields["vertices_deg"] = _ring(where, coordinates)
    elif form == "LineString":
        fields["positions_deg"] = [_place(place) for place in coordinates]
    else:
        fields[PLACES[kind]] = _place(coordinates)
    raw[LISTS[kind]].append(fields)


def _ring(where: str, rings: Sequence[Sequence[Sequence[float]]]) -> list[dict[str, float]]:
    """Return the corners of a polygon: the last one, which repeats the first, is left out."""
    if len(rings) != 1:
        raise ValueError(f"{where}.geometry.coordinates: a polygon with holes is none of a scenario")
    return [_place(place) for place in rings[0][:-1]]


def _place(place: Sequence[float]) -> dict[str, float]:
    return {"lat": place[1], "lon": place[0]}
