"""Files in, a scenario out: what is not in the files is taken from the settings, from a base scenario, or is chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pydantic import BaseModel, ValidationError

from skyfolio.api.common.validation import broken_rules
from skyfolio.api.places import geojson, kml, tables
from skyfolio.api.places.assembling import OVER_GROUND, Assembly, ScenarioSettings
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

    Tiles are the ground under it, and maps of gains its channel.
    Without users or without UAVs in the files, those of `base` are kept, and so are its origin, area and no-fly zones
    where the files have none. Files with both stand alone: of `base` only what is no place is used. `settings` count
    more than those in a file, and these more than the base's. Raises FaultyFilesError that names file, row and column.
    """
    if not files:
        raise FaultyFilesError([Fault(file="files", rule="missing", message="there must be at least one")])
    tiles, maps = [file for file in files if file.is_tile], [file for file in files if file.is_gain_map]
    files = [file for file in files if not (file.is_tile or file.is_gain_map)]
    holdings = [_holding(file) for file in files]
    faults = [fault for holding in holdings for fault in holding.faults]
    said = _settings(files, holdings, faults)
    assembly = Assembly([feature for one in holdings for feature in one.features], base)
    faults += assembly.faults
    if faults:
        raise FaultyFilesError(faults)
    asked = _given(settings)
    said = {**said, **asked}
    above_ground = {name: said.pop(name) for name in OVER_GROUND if name in said}
    scenario = assembly.scenario(said)
    scenario, told = _over_ground(scenario, tiles, base, above_ground, is_asked="clearance_m" in asked)
    scenario, said_of_map = _with_map(scenario, maps)
    ignored = [
        f"{file.name}: not used: {', '.join(sorted(holding.ignored))}"
        for file, holding in zip(files, holdings, strict=True)
        if holding.ignored
    ]
    return Imported(scenario=scenario, notes=[*assembly.notes, *told, *said_of_map, *ignored])


def _with_map(scenario: Scenario, maps: Sequence[SourceFile]) -> tuple[Scenario, list[str]]:
    """Return the scenario with the channel of these maps of gains, its own without any; and notes."""
    if not maps:
        return scenario, []
    from skyfolio.api.places.gain_maps import gain_map_of, lines_of  # noqa: PLC0415 - most imports have none

    channel = gain_map_of(maps, scenario)
    return _changed(scenario, {"channel": channel}, maps[0].name), [*lines_of(channel)]


def _over_ground(
    scenario: Scenario,
    tiles: Sequence[SourceFile],
    base: Scenario | None,
    given: Mapping[str, object],
    *,
    is_asked: bool,
) -> tuple[Scenario, list[str]]:
    """Return the scenario on the ground of these tiles, or of the base where that is the same region; and notes.

    is_asked: whether the request itself, not a file, names a clearance: then there must be ground to keep it from.
    """
    kept = {name: getattr(base, name) for name in OVER_GROUND} if base is not None else {}
    changes: dict[str, object] = {name: value for name, value in {**kept, **given}.items() if value is not None}
    notes: list[str] = []
    if tiles:
        from skyfolio.api.places.elevation import lines_of, terrain_of  # noqa: PLC0415 - most imports have no tiles

        terrain = terrain_of(tiles, scenario)
        changes["terrain"] = terrain
        notes += lines_of(terrain)
    elif base is not None and base.terrain is not None and base.origin == scenario.origin:
        changes["terrain"] = base.terrain
        notes.append("terrain: kept that of the base scenario")
    elif not is_asked and changes.pop("clearance_m", None) is not None and "clearance_m" in given:
        notes.append("clearance_m: not used: it is kept over terrain, and no tile is given")
    if not changes:
        return scenario, notes
    return _changed(scenario, changes, "files"), notes


def _changed(scenario: Scenario, changes: Mapping[str, object], file: str) -> Scenario:
    """Return the scenario with other fields, which came from a file. Raises FaultyFilesError."""
    try:
        return scenario.with_changes(**changes)
    except ValidationError as error:
        raise FaultyFilesError(
            [
                Fault(file=file, rule=row["rule"], message=row["message"], column=row["field"])
                for row in broken_rules(error.errors(), ())
            ]
        ) from error


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
