"""Scenarios from the files of spreadsheets and GIS, and plans as such files."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Response
from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, model_validator

from skyfolio.api.access.api_keys import Role
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, require_within_limits, requires
from skyfolio.api.http.routes.examples import IMPORT_EXAMPLES
from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.files import Encoding, Kind, SourceFile
from skyfolio.api.places.importing import Imported, import_files
from skyfolio.api.places.writing import MEDIA_TYPES, Format, write_plan
from skyfolio.planner import Scenario

router = APIRouter(prefix="/v1", dependencies=[*KNOWN, requires(Role.VIEWER)])
EXPORT_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The plan as a file, in the format asked for.",
        "content": {
            kind.partition(";")[0]: {"schema": {"type": "object" if "json" in kind else "string"}}
            for kind in MEDIA_TYPES.values()
        },
    }
}


class ImportFile(BaseModel):
    """A file: its `content` as text, or its bytes as `content_base64` when the text is in another encoding."""

    model_config = ConfigDict(extra="forbid")

    name: Annotated[
        str,
        Field(
            min_length=1,
            max_length=255,
            description="Its end says the format: .geojson, .json, .csv, .tsv, .kml, .tif, .hgt or .npz.",
        ),
    ]
    content: str | None = None
    content_base64: Base64Bytes | None = None
    kind: Annotated[
        Kind | Literal["gain_map"] | None,
        Field(
            description="What is in it; default: its `kind` properties, its folders, or its name. `gain_map`: gains of "
            "the channel `map` in a GeoTIFF (an .npz is always one)."
        ),
    ] = None
    encoding: Annotated[Encoding | None, Field(description="Default: by its byte order mark, otherwise UTF-8.")] = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.content is None) == (self.content_base64 is None):
            raise ValueError("content: give content or content_base64, one of them")
        if self.content is not None and self.encoding is not None:
            raise ValueError("encoding: it belongs to content_base64; content is text already")
        return self

    def source(self) -> SourceFile:
        """Return the file for the import."""
        content = self.content_base64 if self.content is None else self.content.encode()
        if self.kind == "gain_map":
            return SourceFile(name=self.name, content=content or b"", is_map=True)
        return SourceFile(name=self.name, content=content or b"", kind=self.kind, encoding=self.encoding)


class ImportRequest(BaseModel):
    """Files that together describe a scenario, and where to take the rest from."""

    model_config = ConfigDict(extra="forbid")

    files: Annotated[tuple[ImportFile, ...], Field(min_length=1, max_length=20)]
    base: Annotated[
        Scenario | None,
        Field(
            description="Its users or UAVs stay if the files have none; its settings stay unless given here or "
            "in a file."
        ),
    ] = None
    settings: Annotated[ScenarioSettings, Field(description="What is no place.")] = ScenarioSettings()


@router.post("/scenarios:import", tags=["scenarios"], openapi_extra=IMPORT_EXAMPLES)
async def import_scenario(body: ImportRequest, service: ServiceDep) -> Imported:
    """Make a scenario of GeoJSON, CSV and KML files. Nothing is stored; plan what is returned.

    An error names `file`, `row` and `column` beside the rule. `notes` say what was chosen, the origin for
    instance, and what in the files was not used.
    """
    sources = [file.source() for file in body.files]
    imported = await asyncio.to_thread(import_files, sources, body.base, body.settings)
    require_within_limits(imported.scenario, service.settings)
    return imported


@router.get("/plans/{plan_id}/export", tags=["plans"], response_model=None, responses=EXPORT_ANSWERS)
async def export_plan(plan_id: str, service: ServiceDep, format: Format = "geojson") -> Response:  # noqa: A002 - as for missions
    """Return a plan for maps and spreadsheets.

    GeoJSON and KML hold its area, zones, users, UAVs, paths and the position of each UAV in each slot; CSV holds these
    positions. `scenarios:import` reads the scenario back from GeoJSON and KML.
    """
    plan = await service.plans.finished(plan_id)
    text = await asyncio.to_thread(write_plan, plan, format)
    return Response(text, media_type=MEDIA_TYPES[format])
