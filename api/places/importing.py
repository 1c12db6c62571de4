"""Files in, a scenario out: what is not in the files is taken from the settings, from a base scenario, or is chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pydantic import BaseModel, ValidationError

from skyfolio.api.common.validation import broken_rules
from skyfolio.api.places import geojson, kml, tables
from skyfolio.api.places.assembling import Assembly, ScenarioSettings
from skyfolio.api.places.faults import Fault, FaultyFilesError
from skyfolio.api.places.files import Holding, SourceFile
from skyfolio.planner import Scenario

READERS: Mapping[str, Callable[[SourceFile], Holding]] = {
    ".geojson": geojson.read,
    ".json": geojson.read,
    ".csv": tables.read,
    ".tsv": tables.read,
    ".kml": kml.read,
    ".kmz": kml.read,
}


class Imported(BaseModel):
    """A scenario made of files. notes: what was chosen because no file says it, and what in the files was not used."""

    scenario: Scenario
    notes: list[str]


def import_files(
    files: Sequence[SourceFile], base: Scenario | None = None, settings: ScenarioSettings | None = None
) -> Imported:
    """Return the scenario that these files describe, all of them together.

    Without users or without UAVs in the files, those of `base` are kept, and so are its origin, area and no-fly zones
    where the files have none. Files with both stand alone: of `base` only what is no place is used. `settings` count
    more than those in a file, and these more than the base's. Raises FaultyFilesError that names file, row and column.
    """
    if not files:
        raise FaultyFilesError([Fault(file="files", rule="missing", message="there must be at least one")])
    holdings = [_holding(file) for file in files]
    faults = [fault for holding in holdings for fault in holding.faults]
    said = _settings(files, holdings, faults)
    assembly = Assembly([feature for one in holdings for feature in one.features], base)
    faults += assembly.faults
    if faults:
        raise FaultyFilesError(faults)
    scenario = assembly.scenario({**said, **_given(settings)})
    ignored = [
        f"{file.name}: not used: {', '.join(sorted(holding.ignored))}"
        for file, holding in zip(files, holdings, strict=True)
        if holding.ignored
    ]
    return Imported(scenario=scenario, notes=[*assembly.notes, *ignored])


def _holding(file: SourceFile) -> Holding:
    reader = READERS.get(file.suffix)
    if reader is None:
        message = f"its name must end in one of {', '.join(READERS)}, which says what format it is"
        raise FaultyFilesError([file.fault("format", message)])
    return reader(file)


def _settings(files: Sequence[SourceFile], holdings: Sequence[Holding], faults: list[Fault]) -> Mapping[str, object]:
    """Return the settings that the files hold, those of a later file counting more; what is wrong goes to `faults`."""
    said: dict[str, object] = {}
    for file, holding in zip(files, holdings, strict=True):
        try:
            said |= _given(ScenarioSettings.model_validate(holding.settings))
        except ValidationError as error:
            faults += [
                file.fault(row["rule"], row["message"], column=f"{geojson.SETTINGS}.{row['field']}")
                for row in broken_rules(error.errors(), ())
            ]
    return said


def _given(settings: ScenarioSettings | None) -> dict[str, object]:
    if settings is None:
        return {}
    return {name: value for name in settings.model_fields_set if (value := getattr(settings, name)) is not None}
