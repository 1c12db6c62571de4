"""Drills: faults for simulated vehicles."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.flights.drills import DrillOptions, DrillView, new_drill
from skyfolio.api.http.routes.deps import KNOWN, Before, Limit, ServiceDep, creates, requires
from skyfolio.api.http.routes.examples import DRILL_EXAMPLES
from skyfolio.sim import FAULTS

router = APIRouter(prefix="/v1", tags=["drills"], dependencies=[*KNOWN, requires(Role.VIEWER)])


class DrillRequest(BaseModel):
    """Which fault is injected into which simulated UAV of an operation, and when. Slots count from 0."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    operation_id: Annotated[str, Field(max_length=64)]
    uav_id: Annotated[str, Field(max_length=64)]
    fault: Annotated[str, Field(max_length=64, description=f"One of: {', '.join(sorted(FAULTS))}.")] = "kill"
    at_slot: Annotated[
        int | None, Field(ge=0, le=1_000_000, strict=True, description="When this slot begins; null: at once.")
    ] = None
    options: Annotated[DrillOptions, Field(max_length=16, description="Options of the fault, by name.")] = {}


class DrillPage(BaseModel):
    """Drills, the newest first. `next` is the `cursor` of the page after this one."""

    items: list[DrillView]
    next: int | None


@router.post("/drills", status_code=202, dependencies=[requires(Role.PILOT)], openapi_extra=DRILL_EXAMPLES)
async def start_drill(
    body: DrillRequest,
    service: ServiceDep,
    response: Response,
    creation: Annotated[NewResource, Depends(creates("drill"))],
) -> DrillView:
    """Inject a fault into a vehicle that this service simulates (`serve --simulate`); any other is refused."""
    drill = await service.drills.schedule(creation, new_drill(creation, **body.model_dump()))
    response.headers["Location"] = f"/v1/drills/{drill.id}"
    return drill


@router.get("/drills")
async def list_drills(service: ServiceDep, limit: Limit = 50, cursor: Before = None) -> DrillPage:
    """List drills, the newest first."""
    items, following = await service.drills.page(limit, cursor)
    return DrillPage(items=items, next=following)


@router.get("/drills/{drill_id}")
async def read_drill(drill_id: str, service: ServiceDep) -> DrillView:
    """Return one drill."""
    return await service.drills.get(drill_id)
