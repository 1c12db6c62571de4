"""Operations: flying a plan with the fleet."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict

from api.operations import OperationView
from api.routes.deps import ServiceDep

router = APIRouter(prefix="/v1", tags=["operations"])


class OperationRequest(BaseModel):
    """Which plan to fly, and whether a loss is answered with a replan."""

    model_config = ConfigDict(extra="forbid")

    plan_id: str
    replanning: Literal["auto", "off"] = "auto"


class AbortRequest(BaseModel):
    """What every vehicle that still answers does now."""

    model_config = ConfigDict(extra="forbid")

    action: Literal["hold", "land"] = "hold"


@router.post("/operations", status_code=202)
async def start_operation(body: OperationRequest, service: ServiceDep, response: Response) -> OperationView:
    """Upload the plan's missions, take off, and fly; poll `Location` or follow `/v1/events`."""
    operation = service.operations.start(body.plan_id, body.replanning)
    response.headers["Location"] = f"/v1/operations/{operation.id}"
    return operation.view()


@router.get("/operations/{operation_id}")
async def read_operation(operation_id: str, service: ServiceDep) -> OperationView:
    """Where an operation is: slot, losses, recoveries, and the rates users got."""
    return service.operations.get(operation_id).view()


@router.post("/operations/{operation_id}:abort")
async def abort_operation(operation_id: str, service: ServiceDep, body: AbortRequest | None = None) -> OperationView:
    """End the operation: every vehicle that still answers holds or lands where it is."""
    action = body.action if body else "hold"
    return (await service.operations.abort(operation_id, action)).view()
