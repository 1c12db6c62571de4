"""The radio half of an operation: what base stations must serve, and what they measure."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.flights.allocations import Acknowledgement, AllocationsView
from skyfolio.api.flights.measured_rates import Measurement
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, requires

router = APIRouter(prefix="/v1", tags=["radio"], dependencies=[*KNOWN, requires(Role.VIEWER)])
station_only = [requires(Role.PLANNER)]
MOST_AT_ONCE = 10_000


class AcknowledgeRequest(BaseModel):
    """The revision that the base station of a UAV has taken over."""

    model_config = ConfigDict(extra="forbid")

    uav_id: Annotated[str, Field(max_length=64)]
    revision: Annotated[int, Field(ge=0, le=2**53)]


class MeasurementBatch(BaseModel):
    """What users got, of any UAVs and moments of the operation."""

    model_config = ConfigDict(extra="forbid")

    measurements: Annotated[list[Measurement], Field(min_length=1, max_length=MOST_AT_ONCE)]


class MeasurementsTaken(BaseModel):
    """How many measurements were new; the others were sent before."""

    new: int


@router.get("/operations/{operation_id}/allocations")
async def read_allocations(operation_id: str, service: ServiceDep) -> AllocationsView:
    """Return what the base station of each UAV must serve now and next; the `allocations` event says the same."""
    return (await service.operations.commanded(operation_id)).radio.allocations.view()


@router.post("/operations/{operation_id}/allocations:acknowledge", dependencies=station_only)
async def acknowledge_allocation(operation_id: str, body: AcknowledgeRequest, service: ServiceDep) -> Acknowledgement:
    """Note that the base station of a UAV serves the newest revision from now on; refused with 409 if it is stale."""
    operation = await service.operations.commanded(operation_id)
    return operation.radio.allocations.acknowledge(body.uav_id, body.revision)


@router.post("/operations/{operation_id}/measurements", dependencies=station_only)
async def add_measurements(operation_id: str, body: MeasurementBatch, service: ServiceDep) -> MeasurementsTaken:
    """Take in what users were measured to get: rates, or SINR, which correct the channel of later plans.

    A measurement of the same UAV, user and moment as an earlier one is that one, sent again: batches may be repeated.
    """
    operation = await service.operations.commanded(operation_id)
    return MeasurementsTaken(new=operation.radio.measure(body.measurements))
