"""The vehicles that can be flown."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.idempotency import Creation
from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.flights.orders import OrderResult
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, creates, requires
from skyfolio.api.http.routes.examples import VEHICLE_EXAMPLES

router = APIRouter(prefix="/v1", tags=["fleet"], dependencies=[*KNOWN, requires(Role.VIEWER)])


class VehicleRequest(BaseModel):
    """Ties a UAV id, as plans use it, to a MAVLink system id."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    system_id: Annotated[int, Field(ge=1, le=254, strict=True)]


Force = Annotated[
    bool,
    Field(description="Also a vehicle that a human or a failsafe flies: it is taken from them."),
]
UavIds = Annotated[
    list[Annotated[str, Field(max_length=64)]] | None,
    Field(max_length=254, description="Only these vehicles; none: all that are registered."),
]


class HoldRequest(BaseModel):
    """Who shall hover."""

    model_config = ConfigDict(extra="forbid")

    uav_ids: UavIds = None


class OrderRequest(HoldRequest):
    """Who shall come down."""

    force: Force = False


class ForceRequest(BaseModel):
    """Whether the vehicle is taken from whoever flies it."""

    model_config = ConfigDict(extra="forbid")

    force: Force = False


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


@router.post("/fleet:hold", dependencies=[requires(Role.PILOT)])
async def hold_fleet(service: ServiceDep, body: HoldRequest | None = None) -> list[OrderResult]:
    """Every vehicle that is heard and in the air stops and hovers, in every state of every operation.

    One result for each. Operations leave these vehicles alone, and end as `aborted` with the last one. Who is flown by
    a human or a failsafe is never made to hold.
    """
    return await service.orders.give("hold", body.uav_ids if body else None)


@router.post("/fleet:return", dependencies=[requires(Role.PILOT)])
async def return_fleet(service: ServiceDep, body: OrderRequest | None = None) -> list[OrderResult]:
    """Every vehicle that is heard and in the air returns home, in every state of every operation."""
    wanted = body or OrderRequest()
    return await service.orders.give("return", wanted.uav_ids, force=wanted.force)


@router.post("/fleet:land", dependencies=[requires(Role.PILOT)])
async def land_fleet(service: ServiceDep, body: OrderRequest | None = None) -> list[OrderResult]:
    """Every vehicle that is heard and in the air lands where it is, in every state of every operation."""
    wanted = body or OrderRequest()
    return await service.orders.give("land", wanted.uav_ids, force=wanted.force)


@router.post("/fleet/vehicles/{uav_id}:hold", dependencies=[requires(Role.PILOT)])
async def hold_vehicle(uav_id: str, service: ServiceDep) -> OrderResult:
    """One vehicle stops and hovers; its operation goes on without it."""
    (given,) = await service.orders.give("hold", [uav_id])
    return given


@router.post("/fleet/vehicles/{uav_id}:return", dependencies=[requires(Role.PILOT)])
async def return_vehicle(uav_id: str, service: ServiceDep, body: ForceRequest | None = None) -> OrderResult:
    """One vehicle returns home; its operation goes on without it."""
    (given,) = await service.orders.give("return", [uav_id], force=bool(body and body.force))
    return given


@router.post("/fleet/vehicles/{uav_id}:land", dependencies=[requires(Role.PILOT)])
async def land_vehicle(uav_id: str, service: ServiceDep, body: ForceRequest | None = None) -> OrderResult:
    """One vehicle lands where it is; its operation goes on without it."""
    (given,) = await service.orders.give("land", [uav_id], force=bool(body and body.force))
    return given


@router.delete("/fleet/vehicles/{uav_id}", status_code=204, dependencies=[requires(Role.PILOT)])
async def remove_vehicle(uav_id: str, service: ServiceDep) -> None:
    """Forget a vehicle that flies no operation."""
    for operation in service.operations.in_the_air:
        if uav_id in operation.flight.systems:
            raise ConflictError(f"uav_id: {uav_id!r} flies operation {operation.id}")
    await service.fleet.remove(uav_id)
