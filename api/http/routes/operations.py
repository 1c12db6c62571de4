"""Operations: flying a plan with the fleet."""

from __future__ import annotations

import asyncio
import re
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import InvalidError, NotFoundError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.fleet.commander import Action
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import OperationRow, OperationView, Policy, State
from skyfolio.api.flights.restart import Record
from skyfolio.api.http.routes.deps import KNOWN, Before, Limit, ServiceDep, creates, requires
from skyfolio.api.http.routes.examples import OPERATION_EXAMPLES
from skyfolio.mavlink_bridge import OnEnd
from skyfolio.mavlink_bridge.guidance import FallBack

router = APIRouter(prefix="/v1", tags=["operations"], dependencies=[*KNOWN, requires(Role.VIEWER)])
pilot_only = [requires(Role.PILOT)]
IN_THE_AIR = (State.FLYING, State.PAUSED)
IfMatch = Annotated[
    str | None,
    Header(alias="If-Match", max_length=200, description="Only if the operation still has this ETag; else 412."),
]


class OperationRequest(BaseModel):
    """Which plan to fly, what happens after a loss, and whether it takes off by itself."""

    model_config = ConfigDict(extra="forbid")

    plan_id: Annotated[str, Field(max_length=64)]
    replanning: Policy = "auto"
    guidance: Annotated[
        Literal["mission", "stream"],
        Field(description="stream: guided by setpoints, for tight synchrony; the missions on board are the fallback."),
    ] = "mission"
    stream_fallback: Annotated[
        FallBack,
        Field(
            description="What vehicles do when the stream of setpoints ends, for example because the service is killed."
        ),
    ] = FallBack.MISSION
    force_stream: Annotated[
        bool,
        Field(
            description="Stream even to a PX4 whose `COM_OBL_RC_ACT` is not 5 (hold): it flies home when "
            "setpoints pause, even for a second. Refused without this, whatever the preflight setting is."
        ),
    ] = False
    at_end: Annotated[
        Literal["land", "return"],
        Field(
            description="After the last slot: land where it is, or return to the start; refused if return paths meet."
        ),
    ] = "land"
    launch: Annotated[
        Literal["auto", "manual"], Field(description="manual: upload, then wait for `operations/{id}:start`.")
    ] = "auto"


class AbortRequest(BaseModel):
    """What every vehicle that still responds does now: hover, land where it is, or return home."""

    model_config = ConfigDict(extra="forbid")

    action: Action = "hold"


class ReadmitRequest(BaseModel):
    """A UAV that was lost, is heard again, and is to fly with the others."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(max_length=64)]


class RetireRequest(BaseModel):
    """A UAV that is to fly home now, while the others fly on without it."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(max_length=64)]


class OperationPage(BaseModel):
    """Operations, the newest first. `next` is the `cursor` of the page after this one."""

    items: list[OperationRow]
    next: int | None


class TrackPoint(BaseModel):
    """Where each UAV was heard, metres east/north of the origin, fleet seconds after slot 0 began."""

    elapsed_s: float
    positions_m: dict[str, tuple[float, float]]


@router.post("/operations", status_code=202, dependencies=pilot_only, openapi_extra=OPERATION_EXAMPLES)
async def start_operation(
    body: OperationRequest,
    service: ServiceDep,
    response: Response,
    creation: Annotated[NewResource, Depends(creates("op"))],
) -> OperationView:
    """Upload the plan's missions, take off, and fly; poll `Location` or follow `/v1/events`."""
    operation = await service.operations.start(
        body.plan_id,
        body.replanning,
        creation,
        launch_itself=body.launch == "auto",
        options=GuidanceOptions(
            body.guidance, body.stream_fallback, OnEnd(body.at_end), force_stream=body.force_stream
        ),
    )
    view = operation.view() if isinstance(operation, Operation) else operation
    response.headers["Location"] = f"/v1/operations/{view.id}"
    return _tagged(response, view)


@router.get("/operations")
async def list_operations(service: ServiceDep, limit: Limit = 50, cursor: Before = None) -> OperationPage:
    """List operations, the newest first."""
    rows = await service.operations.rows(limit + 1, cursor)
    items = [
        OperationRow(
            id=row.id,
            state=row.state,
            version=row.version,
            plan_id=row.plan_id,
            replanning=row.policy,
            created_at=row.created_at,
            ended_at=row.ended_at,
        )
        for row in rows[:limit]
    ]
    return OperationPage(items=items, next=rows[limit - 1].number if len(rows) > limit else None)


@router.get(
    "/operations/{operation_id}",
    response_model=OperationView,
    responses={304: {"description": "`If-None-Match` names the present ETag: nothing that can be commanded changed."}},
)
async def read_operation(operation_id: str, service: ServiceDep, request: Request, response: Response) -> Any:
    """Return the state of an operation: slot, losses, recoveries, and the rates users received."""
    view = await service.operations.view(operation_id)
    if request.headers.get("if-none-match") == _tag(view):
        return Response(status_code=304, headers={"ETag": _tag(view)})
    return _tagged(response, view)


@router.get("/operations/{operation_id}/journal")
async def read_journal(operation_id: str, service: ServiceDep) -> list[Entry]:
    """Return every step of every incident, as it was stored before it was carried out."""
    await _require(service, operation_id)
    return await service.journal.of(operation_id)


@router.get("/operations/{operation_id}/track", response_model=list[TrackPoint])
async def read_track(
    operation_id: str,
    service: ServiceDep,
    after_s: Annotated[
        float | None, Query(allow_inf_nan=False, description="Only what was heard after this fleet second.")
    ] = None,
    limit: Annotated[int | None, Query(ge=1, le=10_000, description="At most this many points; default: all.")] = None,
) -> Response:
    """Return where every UAV was heard, twice per fleet second, for replay; `after_s` and `limit` page through."""
    await _require(service, operation_id)
    record = await service.operations.track(operation_id, after_s, limit)
    return Response(await asyncio.to_thread(track_json, record), media_type="application/json")


@router.post("/operations/{operation_id}:start", dependencies=pilot_only)
async def launch_operation(
    operation_id: str, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Take off, in an operation with `launch: manual` whose missions are on board."""
    version = _version(if_match)
    operation = await service.operations.commanded(operation_id, State.READY, version=version)
    await operation.launch(version)
    return _tagged(response, operation.view())


@router.post("/operations/{operation_id}:pause", dependencies=pilot_only)
async def pause_operation(
    operation_id: str, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Make every vehicle hover where it is, and stop the slot clock."""
    version = _version(if_match)
    operation = await service.operations.commanded(operation_id, State.FLYING, version=version)
    await operation.pause(version)
    return _tagged(response, operation.view())


@router.post("/operations/{operation_id}:resume", dependencies=pilot_only)
async def resume_operation(
    operation_id: str, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Fly on with the missions on board; the service recovers now from a loss during the pause."""
    version = _version(if_match)
    operation = await service.operations.commanded(operation_id, State.PAUSED, version=version)
    await operation.resume(version)
    return _tagged(response, operation.view())


@router.post("/operations/{operation_id}:abort", dependencies=pilot_only)
async def abort_operation(
    operation_id: str,
    service: ServiceDep,
    response: Response,
    body: AbortRequest | None = None,
    if_match: IfMatch = None,
) -> OperationView:
    """End the operation: every vehicle that still responds holds, lands where it is, or returns home.

    An abort takes precedence over whatever is being done, and may be repeated: the same action is tried again only
    where it failed; another one (land after hold) is carried out for vehicles that still fly and have no other
    operation, also after the end.
    """
    action = body.action if body else "hold"
    return _tagged(response, await service.operations.abort(operation_id, action, _version(if_match)))


@router.post("/operations/{operation_id}:readmit", dependencies=pilot_only)
async def readmit_uav(
    operation_id: str, body: ReadmitRequest, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Plan again with a UAV that was lost and is back: it is offered as `returned`, and commanded only then."""
    version = _version(if_match)
    operation = await service.operations.commanded(operation_id, State.FLYING, version=version)
    await operation.readmit(body.uav_id, version)
    return _tagged(response, operation.view())


@router.post("/operations/{operation_id}:retire", dependencies=pilot_only)
async def retire_uav(
    operation_id: str, body: RetireRequest, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Send a UAV home and plan without it; meant for those offered as `low_on_battery`.

    The service retires no UAV by itself.
    """
    version = _version(if_match)
    operation = await service.operations.commanded(operation_id, State.FLYING, version=version)
    await operation.retire(body.uav_id, version)
    return _tagged(response, operation.view())


@router.post("/operations/{operation_id}/incidents/{incident}:approve", dependencies=pilot_only)
async def approve_proposal(operation_id: str, incident: int, service: ServiceDep, response: Response) -> OperationView:
    """Fly the proposed plan. When it has become stale meanwhile, one for a later slot is made and flown at once."""
    return await _decided(service, operation_id, incident, response, agreed=True)


@router.post("/operations/{operation_id}/incidents/{incident}:decline", dependencies=pilot_only)
async def decline_proposal(operation_id: str, incident: int, service: ServiceDep, response: Response) -> OperationView:
    """Keep the plan in force; the survivors fly on as they do."""
    return await _decided(service, operation_id, incident, response, agreed=False)


async def _decided(
    service: ServiceDep, operation_id: str, incident: int, response: Response, *, agreed: bool
) -> OperationView:
    operation = await service.operations.commanded(operation_id, *IN_THE_AIR)
    operation.incidents.decide(incident, agreed=agreed)
    return _tagged(response, operation.view())


def track_json(record: Record) -> bytes:
    """Return the track as JSON. A long one takes a while and is encoded in a thread."""
    points = (TrackPoint(elapsed_s=at, positions_m=where).model_dump_json() for at, where in record)
    return f"[{','.join(points)}]".encode()


async def _require(service: ServiceDep, operation_id: str) -> None:
    if not await service.operations.exists(operation_id):
        raise NotFoundError(f"operation {operation_id!r} does not exist")


def _tag(view: OperationView) -> str:
    return f'"{view.id}.{view.version}"'


def _tagged(response: Response, view: OperationView) -> OperationView:
    response.headers["ETag"] = _tag(view)
    return view


def _version(if_match: str | None) -> int | None:
    """Return the version that an ETag names; None for `*` and without an ETag."""
    if if_match is None or if_match.strip() == "*":
        return None
    etag = re.fullmatch(r'\s*"?[A-Za-z0-9-]+\.([0-9]{1,9})"?\s*', if_match)
    if etag is None:
        raise InvalidError(f"If-Match: {if_match!r} is not an ETag of this service")
    return int(etag.group(1))
