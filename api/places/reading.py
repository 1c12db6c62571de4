"""Files on disk as a scenario, in one call: what `skyfolio import` does, for Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.importing import import_files
from skyfolio.planner import Scenario


def read_scenario(*files: Path | str, base: Scenario | None = None, **settings: Any) -> Scenario:
    """Return the scenario in a JSON file, or that GeoJSON, CSV, KML files and elevation tiles describe together.

    base: a scenario from which what the files do not have is taken. settings: fields that are no place, such as
    `slots`; they count more than those in the files. Raises OSError, pydantic's error of fields for a scenario in JSON,
    and ServiceError that names file, row and column for the others.
    """
    paths = [Path(file) for file in files]
    if len(paths) == 1 and paths[0].suffix == ".json" and base is None:
        text = paths[0].read_text(encoding="utf-8-sig")
        if '"FeatureCollection"' not in text:
            return Scenario.model_validate_json(text).with_changes(**settings)
    sources = [SourceFile(name=path.name, content=path.read_bytes()) for path in paths]
    return import_files(sources, base, ScenarioSettings(**settings)).scenario
