"""The vehicles that can be flown."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field

from api.creation import Creation
from api.errors import ConflictError
from api.routes.deps import KNOWN, ServiceDep, creates, requires
from api.routes.examples import VEHICLE_EXAMPLES
from api.security import Role
from api.vehicle_view import VehicleView

router = APIRouter(prefix="/v1", tags=["fleet"], dependencies=[*KNOWN, requires(Role.VIEWER)])


class VehicleRequest(BaseModel):
    """Ties a UAV id, as plans use it, to a MAVLink system id."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    system_id: Annotated[int, Field(ge=1, le=254, strict=True)]


@router.post("/fleet/vehicles", status_code=201, dependencies=[requires(Role.PILOT)], openapi_extra=VEHICLE_EXAMPLES)
async def register_vehicle(
    body: VehicleRequest, service: ServiceDep, creation: Annotated[Creation, Depends(creates("vehicle"))]
) -> VehicleView:
    """Register a vehicle; the first one opens the fleet link. Registering the same pair again changes nothing."""
    del creation  # a pair is its own key: the header is taken, and has nothing to add
    return await service.fleet.register(body.uav_id, body.system_id)


@router.get("/fleet/vehicles")
async def list_vehicles(service: ServiceDep) -> list[VehicleView]:
    """All registered vehicles, as they were last heard."""
    return service.fleet.views()


@router.get("/fleet/vehicles/{uav_id}")
async def read_vehicle(uav_id: str, service: ServiceDep) -> VehicleView:
    """One vehicle, as it was last heard."""
    return service.fleet.find(uav_id)


@router.delete("/fleet/vehicles/{uav_id}", status_code=204, dependencies=[requires(Role.PILOT)])
async def remove_vehicle(uav_id: str, service: ServiceDep) -> None:
    """Forget a vehicle that flies no operation."""
    for operation in service.operations.in_the_air:
        if uav_id in operation.flight.systems:
            raise ConflictError(f"uav_id: {uav_id!r} flies operation {operation.id}")
    await service.fleet.remove(uav_id)
