"""The vehicles that can be flown."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.fleet.rotor_fit import RotorFit
from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.flights.orders import OrderResult
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, creates, requires
from skyfolio.api.http.routes.examples import VEHICLE_EXAMPLES
from skyfolio.planner.scenario import Wind

router = APIRouter(prefix="/v1", tags=["fleet"], dependencies=[*KNOWN, requires(Role.VIEWER)])


class VehicleRequest(BaseModel):
    """A UAV id, as plans use it, and the MAVLink system id of its vehicle."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    system_id: Annotated[int, Field(ge=1, le=254, strict=True)]


Force = Annotated[
    bool,
    Field(description="Also a vehicle that a human or a failsafe flies: it is taken from them."),
]
UavIds = Annotated[
    list[Annotated[str, Field(max_length=64)]] | None,
    Field(max_length=254, description="Only these vehicles; default: all registered ones."),
]


class HoldRequest(BaseModel):
    """Which vehicles hover."""

    model_config = ConfigDict(extra="forbid")

    uav_ids: UavIds = None


class OrderRequest(HoldRequest):
    """Which vehicles come down."""

    force: Force = False


class ForceRequest(BaseModel):
    """Whether the vehicle is taken from the human or the failsafe that flies it."""

    model_config = ConfigDict(extra="forbid")

    force: Force = False


@router.post("/fleet/vehicles", status_code=201, dependencies=[requires(Role.PILOT)], openapi_extra=VEHICLE_EXAMPLES)
async def register_vehicle(
    body: VehicleRequest, service: ServiceDep, creation: Annotated[NewResource, Depends(creates("vehicle"))]
) -> VehicleView:
    """Register a vehicle; the first one opens the fleet link. Registering the same pair again changes nothing."""
    del creation  # a pair is its own key: the header is taken, and has nothing to add
    return await service.fleet.register(body.uav_id, body.system_id)


@router.get("/fleet/vehicles")
async def list_vehicles(service: ServiceDep) -> list[VehicleView]:
    """List all registered vehicles, as they were last heard."""
    return service.fleet.views()


@router.get("/fleet/vehicles/{uav_id}")
async def read_vehicle(uav_id: str, service: ServiceDep) -> VehicleView:
    """Return one vehicle, as it was last heard."""
    return service.fleet.find(uav_id)


WindMps = Annotated[float, Query(ge=-100, le=100, allow_inf_nan=False)]


@router.get("/fleet/vehicles/{uav_id}/rotors")
async def fit_rotors_of_vehicle(
    uav_id: str, service: ServiceDep, wind_east_mps: WindMps = 0.0, wind_north_mps: WindMps = 0.0
) -> RotorFit:
    """Return rotors for a scenario, fitted to the power that this vehicle has reported in flight through this wind."""
    wind = Wind(east_mps=wind_east_mps, north_mps=wind_north_mps)
    return service.fleet.rotors_of(uav_id, wind)


@router.post("/fleet:hold", dependencies=[requires(Role.PILOT)])
async def hold_fleet(service: ServiceDep, body: HoldRequest | None = None) -> list[OrderResult]:
    """Make every vehicle that is heard and in the air stop and hover, in every state of every operation.

    Returns one result for each. Operations leave these vehicles alone, and end as `aborted` with the last one. A
    vehicle flown by a human or a failsafe is never made to hold.
    """
    return await service.orders.give("hold", body.uav_ids if body else None)


@router.post("/fleet:return", dependencies=[requires(Role.PILOT)])
async def return_fleet(service: ServiceDep, body: OrderRequest | None = None) -> list[OrderResult]:
    """Make every vehicle that is heard and in the air return home, in every state of every operation."""
    order = body or OrderRequest()
    return await service.orders.give("return", order.uav_ids, force=order.force)


@router.post("/fleet:land", dependencies=[requires(Role.PILOT)])
async def land_fleet(service: ServiceDep, body: OrderRequest | None = None) -> list[OrderResult]:
    """Make every vehicle that is heard and in the air land where it is, in every state of every operation."""
    order = body or OrderRequest()
    return await service.orders.give("land", order.uav_ids, force=order.force)


@router.post("/fleet/vehicles/{uav_id}:hold", dependencies=[requires(Role.PILOT)])
async def hold_vehicle(uav_id: str, service: ServiceDep) -> OrderResult:
    """Make one vehicle stop and hover; its operation goes on without it."""
    (result,) = await service.orders.give("hold", [uav_id])
    return result


@router.post("/fleet/vehicles/{uav_id}:return", dependencies=[requires(Role.PILOT)])
async def return_vehicle(uav_id: str, service: ServiceDep, body: ForceRequest | None = None) -> OrderResult:
    """Make one vehicle return home; its operation goes on without it."""
    (result,) = await service.orders.give("return", [uav_id], force=bool(body and body.force))
    return result


@router.post("/fleet/vehicles/{uav_id}:land", dependencies=[requires(Role.PILOT)])
async def land_vehicle(uav_id: str, service: ServiceDep, body: ForceRequest | None = None) -> OrderResult:
    """Make one vehicle land where it is; its operation goes on without it."""
    (result,) = await service.orders.give("land", [uav_id], force=bool(body and body.force))
    return result


@router.delete("/fleet/vehicles/{uav_id}", status_code=204, dependencies=[requires(Role.PILOT)])
async def remove_vehicle(uav_id: str, service: ServiceDep) -> None:
    """Forget a vehicle that flies no operation."""
    owner = service.fleet.rights.owner(service.fleet.find(uav_id).system_id)
    if owner is not None:
        raise ConflictError(f"uav_id: {uav_id!r}: {owner}")
    for operation in service.operations.in_the_air:
        if uav_id in operation.flight.systems:
            raise ConflictError(f"uav_id: {uav_id!r} flies operation {operation.id}")
    await service.fleet.remove(uav_id)
