"""Commands to an operation: what its pilot may order, and decide, from take-off to the end."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.fleet.commander import Action
from skyfolio.api.flights.endless.terms import End
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, requires
from skyfolio.api.http.routes.ends import Duration, Until, end_of
from skyfolio.api.http.routes.etags import IfMatch, tagged, version_of

router = APIRouter(prefix="/v1", tags=["operations"], dependencies=[*KNOWN, requires(Role.PILOT)])
IN_THE_AIR = (State.FLYING, State.PAUSED)


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


class ExtendRequest(BaseModel):
    """When an operation without a fixed end is to end, later or sooner than was asked before; one of the two."""

    model_config = ConfigDict(extra="forbid")

    duration_s: Duration = None
    until: Until = None


@router.post("/operations/{operation_id}:start")
async def launch_operation(
    operation_id: str, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Take off, in an operation with `launch: manual` whose missions are on board."""
    version = version_of(if_match)
    operation = await service.operations.commanded(operation_id, State.READY, version=version)
    await operation.launch(version)
    return tagged(response, operation.view())


@router.post("/operations/{operation_id}:pause")
async def pause_operation(
    operation_id: str, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Make every vehicle hover where it is, and stop the slot clock."""
    version = version_of(if_match)
    operation = await service.operations.commanded(operation_id, State.FLYING, version=version)
    await operation.pause(version)
    return tagged(response, operation.view())


@router.post("/operations/{operation_id}:resume")
async def resume_operation(
    operation_id: str, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Fly on with the missions on board; the service recovers now from a loss during the pause."""
    version = version_of(if_match)
    operation = await service.operations.commanded(operation_id, State.PAUSED, version=version)
    await operation.resume(version)
    return tagged(response, operation.view())


@router.post("/operations/{operation_id}:abort")
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
    return tagged(response, await service.operations.abort(operation_id, action, version_of(if_match)))


@router.post("/operations/{operation_id}:readmit")
async def readmit_uav(
    operation_id: str, body: ReadmitRequest, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Plan again with a UAV that was lost and is back: it is offered as `returned`, and commanded only then."""
    version = version_of(if_match)
    operation = await service.operations.commanded(operation_id, State.FLYING, version=version)
    await operation.readmit(body.uav_id, version)
    return tagged(response, operation.view())


@router.post("/operations/{operation_id}:retire")
async def retire_uav(
    operation_id: str, body: RetireRequest, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Send a UAV home and plan without it; meant for those offered as `low_on_battery`.

    The service retires no UAV by itself.
    """
    version = version_of(if_match)
    operation = await service.operations.commanded(operation_id, State.FLYING, version=version)
    await operation.retire(body.uav_id, version)
    return tagged(response, operation.view())


@router.post("/operations/{operation_id}:extend")
async def extend_operation(
    operation_id: str, body: ExtendRequest, service: ServiceDep, response: Response, if_match: IfMatch = None
) -> OperationView:
    """Move the end of an operation without a fixed end; slots that are planned already are flown in any case."""
    end = end_of(body.duration_s, body.until)
    if end == End():
        raise InvalidError("duration_s, until: one of them must be given")
    version = version_of(if_match)
    operation = await service.operations.commanded(operation_id, State.READY, *IN_THE_AIR, version=version)
    await operation.extend(end, version)
    return tagged(response, operation.view())


@router.post("/operations/{operation_id}/incidents/{incident}:approve")
async def approve_proposal(operation_id: str, incident: int, service: ServiceDep, response: Response) -> OperationView:
    """Fly the proposed plan. When it has become stale meanwhile, one for a later slot is made and flown at once."""
    return await _decided(service, operation_id, incident, response, agreed=True)


@router.post("/operations/{operation_id}/incidents/{incident}:decline")
async def decline_proposal(operation_id: str, incident: int, service: ServiceDep, response: Response) -> OperationView:
    """Keep the plan in force; the survivors fly on as they do."""
    return await _decided(service, operation_id, incident, response, agreed=False)


async def _decided(
    service: ServiceDep, operation_id: str, incident: int, response: Response, *, agreed: bool
) -> OperationView:
    operation = await service.operations.commanded(operation_id, *IN_THE_AIR)
    operation.incidents.decide(incident, agreed=agreed)
    return tagged(response, operation.view())
