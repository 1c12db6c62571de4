"""The vehicles that can be flown."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from api.fleet import VehicleView
from api.routes.deps import ServiceDep

router = APIRouter(prefix="/v1", tags=["fleet"])


class VehicleRequest(BaseModel):
    """Ties a UAV id, as plans use it, to a MAVLink system id."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    system_id: Annotated[int, Field(ge=1, le=254, strict=True)]


@router.post("/fleet/vehicles", status_code=201)
async def register_vehicle(body: VehicleRequest, service: ServiceDep) -> VehicleView:
    """Register a vehicle; the first one opens the fleet link. Registering the same pair again changes nothing."""
    return await service.fleet.register(body.uav_id, body.system_id)


@router.get("/fleet/vehicles")
async def list_vehicles(service: ServiceDep) -> list[VehicleView]:
    """All registered vehicles, as they were last heard."""
    return service.fleet.views()
