"""Plans and replans as resources."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import BaseModel, ConfigDict, Field

from api import missions
from api.plan_book import ENDED, PlanRecord, UnfinishedPlan
from api.routes.deps import ServiceDep
from api.service import Service
from planner import Cause, Plan, Scenario, remaining

router = APIRouter(prefix="/v1", tags=["plans"])
WaitS = Annotated[float, Query(ge=0, le=60, description="Wait up to this many seconds for the result.")]
DeadlineS = Annotated[
    float | None, Query(gt=0, le=3600, description="Return the best plan found after this many seconds of solving.")
]
ANSWERS: dict[int | str, dict[str, object]] = {
    200: {"description": "The plan has ended within `wait_s`.", "model": Plan},
    202: {"description": "The plan is queued or running; poll `Location`.", "model": UnfinishedPlan},
}


class ReplanRequest(BaseModel):
    """What changed. Slots are on the operation's grid, positions in metres east/north, rates in bit/s."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    failed: Annotated[list[str], Field(description="UAVs that are gone.")]
    at_slot: Annotated[int, Field(ge=0, description="First slot to plan.")]
    positions_m: Annotated[
        dict[str, tuple[float, float]] | None,
        Field(description="Where survivors are when `at_slot` begins; default: where the plan has them."),
    ] = None
    achieved_rates_bps: Annotated[
        dict[str, list[float]] | None,
        Field(description="Rates each user got in every slot before `at_slot`; default: as planned."),
    ] = None
    cause: Cause = Cause()


@router.post("/plans", responses=ANSWERS, response_model=None)
async def create_plan(
    scenario: Scenario, service: ServiceDep, wait_s: WaitS = 0, deadline_s: DeadlineS = None
) -> JSONResponse:
    """Plan a scenario. Answers 200 with the plan when it is done within `wait_s`, else 202 and a `Location`."""
    record = service.plans.submit(scenario, deadline_s)
    return await _created(service, record, wait_s)


@router.post("/plans/{plan_id}/replans", responses=ANSWERS, response_model=None)
async def create_replan(
    plan_id: str, body: ReplanRequest, service: ServiceDep, wait_s: WaitS = 0, deadline_s: DeadlineS = None
) -> JSONResponse:
    """Plan the remaining slots for the survivors of a plan; the result is a new plan whose `parent` is this one."""
    request = body.model_dump(exclude={"cause"})
    remaining(service.plans.finished(plan_id), **request)  # refuse at the door what cannot be replanned
    cause = body.cause if body.cause.uav_ids else body.cause.model_copy(update={"uav_ids": tuple(body.failed)})
    record = service.plans.submit_replan(plan_id, request, cause, deadline_s)
    return await _created(service, record, wait_s)


@router.post("/plans/{plan_id}:cancel", status_code=202, response_model=None, responses=ANSWERS)
async def cancel_plan(plan_id: str, service: ServiceDep) -> JSONResponse:
    """Stop a plan; it ends as `cancelled` with the best feasible plan found so far. An ended plan stays as it is."""
    return _rendered(service.plans.cancel(plan_id))


@router.get("/plans/{plan_id}", responses=ANSWERS, response_model=None)
async def read_plan(plan_id: str, service: ServiceDep, wait_s: WaitS = 0) -> JSONResponse:
    """A plan, or how far it is."""
    record = service.plans.record(plan_id)
    await service.plans.wait(record, wait_s)
    return _rendered(record)


@router.get("/plans/{plan_id}/missions", response_model=None)
async def read_missions(
    plan_id: str,
    service: ServiceDep,
    format: Literal["plan", "waypoints", "json"] = "json",  # noqa: A002 - the name is part of the contract
    uav_id: str | None = None,
) -> Response:
    """The MAVLink missions of a plan: one per UAV as JSON, or one UAV's as a QGroundControl `.plan` or `.waypoints`."""
    plan = service.plans.finished(plan_id)
    if format == "plan":
        return JSONResponse(missions.qgc_plan(plan, uav_id))
    if format == "waypoints":
        return PlainTextResponse(missions.waypoints(plan, uav_id))
    return JSONResponse(missions.as_json(plan, uav_id))


async def _created(service: Service, record: PlanRecord, wait_s: float) -> JSONResponse:
    await service.plans.wait(record, wait_s)
    answer = _rendered(record)
    answer.headers["Location"] = f"/v1/plans/{record.id}"
    return answer


def _rendered(record: PlanRecord) -> JSONResponse:
    ended = record.status in ENDED
    headers = {} if ended else {"Retry-After": "1"}
    return JSONResponse(record.view().model_dump(mode="json"), status_code=200 if ended else 202, headers=headers)
