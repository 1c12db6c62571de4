"""`skyfolio import`: a scenario from the files of spreadsheets and GIS, without a service."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from skyfolio.api.cli.files import Json, Out, UsageError, read_scenario, write
from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.files import MAX_TILE_BYTES, Encoding, Kind, SourceFile
from skyfolio.api.places.importing import import_files
from skyfolio.planner import Scenario

Given = Annotated[list[Path] | None, typer.Option(help="Files of which all features are of this kind.")]


def import_command(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="GeoJSON, CSV or KML, whose `kind` properties, folders or names say what is in them, and tiles."
        ),
    ] = None,
    users: Given = None,
    uavs: Given = None,
    no_fly: Given = None,
    area: Given = None,
    rally_points: Given = None,
    terrain: Annotated[
        list[Path] | None, typer.Option(help="GeoTIFF or SRTM tile (N47E008.hgt) with the heights of the ground.")
    ] = None,
    gain_map: Annotated[
        list[Path] | None,
        typer.Option(help="Gains from places of UAVs to users, .npz or GeoTIFF: becomes the channel `map`."),
    ] = None,
    base: Annotated[
        Path | None, typer.Option(help="Scenario as JSON, from which what the files do not have is taken.")
    ] = None,
    example: Annotated[str | None, typer.Option(help="A ready scenario as the base.")] = None,
    slots: Annotated[int | None, typer.Option(min=1, help="How many slots to plan.")] = None,
    slot_duration_s: Annotated[float | None, typer.Option(help="How long a slot lasts, seconds.")] = None,
    altitude_m: Annotated[float | None, typer.Option(help="Altitude above home, or above terrain, metres.")] = None,
    clearance_m: Annotated[float | None, typer.Option(help="Kept over terrain everywhere, metres.")] = None,
    altitude_min_m: Annotated[float | None, typer.Option(help="Least altitude to choose from, metres.")] = None,
    altitude_max_m: Annotated[float | None, typer.Option(help="Greatest altitude to choose from, metres.")] = None,
    min_separation_m: Annotated[float | None, typer.Option(help="Least distance between UAVs, metres.")] = None,
    encoding: Annotated[
        Encoding | None, typer.Option(help="Of the files' text; default: UTF-8, or by its mark.")
    ] = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Make a scenario of users, UAVs, no-fly zones, areas and rally points in GeoJSON, CSV or KML files.

    Tiles are the ground under it, and maps of gains its channel.
    """
    given: dict[Kind | None, list[Path]] = {
        None: [*(files or []), *(terrain or [])],
        "user": users or [], "uav": uavs or [], "no_fly": no_fly or [], "area": area or [],
        "rally_point": rally_points or [],
    }  # fmt: skip
    sources = [_source(path, kind, encoding) for kind, paths in given.items() for path in paths]
    sources += [replace(_source(path, None, None), is_map=True) for path in gain_map or []]
    settings = {
        "slots": slots,
        "slot_duration_s": slot_duration_s,
        "altitude_m": altitude_m,
        "clearance_m": clearance_m,
        "altitude_min_m": altitude_min_m,
        "altitude_max_m": altitude_max_m,
        "min_separation_m": min_separation_m,
    }
    imported = import_files(sources, _base(base, example), _settings(settings))
    if as_json:
        write(imported.model_dump_json(indent=2), out)
        return
    write(imported.scenario.model_dump_json(indent=2), out)
    for note in imported.notes:
        typer.echo(note, err=True)


def _settings(given: dict[str, Any]) -> ScenarioSettings:
    return ScenarioSettings(**{name: value for name, value in given.items() if value is not None})


def _base(file: Path | None, example: str | None) -> Scenario | None:
    return None if file is None and example is None else read_scenario(file, example)


def _source(path: Path, kind: Kind | None, encoding: Encoding | None) -> SourceFile:
    try:
        with path.open("rb") as opened:
            content = opened.read(MAX_TILE_BYTES + 1)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from error
    return SourceFile(name=str(path), content=content, kind=kind, encoding=encoding)
