"""Plans and replans as resources."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import BaseModel, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.common.settings import MOST_WEIGHT
from skyfolio.api.http.routes.deps import (
    KNOWN,
    Before,
    Limit,
    ServiceDep,
    WaitS,
    creates,
    require_within_limits,
    requires,
)
from skyfolio.api.http.routes.examples import PLAN_EXAMPLES, REPLAN_EXAMPLES
from skyfolio.api.plans.mission_files import Missions
from skyfolio.api.plans.plan_records import Asked, PlanRecord, PlanRow, UnfinishedPlan
from skyfolio.api.service import Service
from skyfolio.mavlink_bridge import DEFAULT_AUTOPILOT, Autopilot
from skyfolio.planner import (
    Cause,
    Changes,
    Pins,
    Plan,
    PlanStatus,
    Scenario,
    Uav,
    User,
    Utility,
    cause_of,
    pinned,
    remaining,
    rest_of_paths_m,
)
from skyfolio.planner.scenario import Hertz, Identifier

router = APIRouter(prefix="/v1", tags=["plans"], dependencies=[*KNOWN, requires(Role.VIEWER)])
planner_only = [requires(Role.PLANNER)]
DeadlineS = Annotated[
    float | None, Query(gt=0, le=3600, description="Return the best plan found after this many seconds of solving.")
]
Starts = Annotated[
    int | None,
    Query(
        ge=1,
        le=64,
        description="Starts of the optimiser: fewer is faster. Default: by size, at most the setting `plan_starts`.",
    ),
]
NewPlan = Annotated[NewResource, Depends(creates("plan"))]
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "The plan has ended.", "model": Plan | UnfinishedPlan},
    202: {
        "description": "The plan is queued or running; poll `Location` after `Retry-After`.",
        "model": UnfinishedPlan,
    },
}
MISSION_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The mission, in the format asked for.",
        "content": {"application/json": {"schema": {"type": "object"}}, "text/plain": {"schema": {"type": "string"}}},
    }
}


class PlanRequest(Scenario):
    """A scenario to plan, and parts of the plan that are fixed beforehand."""

    pins: Annotated[Pins, Field(description="Paths, UAVs (they hover) and associations that the plan keeps.")] = Pins()

    def scenario(self) -> Scenario:
        """Return the scenario alone."""
        return Scenario.model_construct(**{name: getattr(self, name) for name in Scenario.model_fields})


class ReplanRequest(Changes):
    """What is different from `at_slot` on, all of it at once.

    Slots are on the operation's grid, positions in metres east/north, rates in bit/s.
    """

    failed: Annotated[tuple[Identifier, ...], Field(max_length=1000, description="UAVs that are lost.")] = ()
    returned: Annotated[
        tuple[Uav, ...],
        Field(max_length=1000, description="Complete UAVs that join or come back; `start_m`: where they are then."),
    ] = ()
    users_joined: Annotated[
        tuple[User, ...], Field(description="New users; slots before `at_slot` do not count for them.")
    ] = ()
    users_left: Annotated[
        tuple[Identifier, ...], Field(description="Users that no longer count; nor do their past rates.")
    ] = ()
    utility: Annotated[Utility | None, Field(description="Another utility, or another mu; default: unchanged.")] = None
    bandwidth_hz: Annotated[
        dict[Identifier, Hertz], Field(default_factory=dict, description="New bandwidths of some UAVs, by id.")
    ]
    at_slot: Annotated[int, Field(ge=0, le=1_000_000, strict=True, description="First slot to plan.")]
    positions_m: Annotated[
        dict[str, tuple[float, float]] | None,
        Field(description="Where survivors are when `at_slot` begins; default: where the plan has them."),
    ] = None
    altitudes_m: Annotated[
        dict[str, float] | None,
        Field(description="How high survivors are then, in the datum of the plan's altitudes; default: as planned."),
    ] = None
    used_wh: Annotated[
        dict[str, float] | None,
        Field(
            description="What survivors have used of their batteries by then, Wh; the least, and the default, is what "
            "the plan has proven."
        ),
    ] = None
    achieved_rates_bps: Annotated[
        dict[str, list[float]] | None,
        Field(description="Rates each user received in every slot before `at_slot`; default: as planned."),
    ] = None
    cause: Annotated[Cause | None, Field(description="Why; default: derived from the changes.")] = None
    pins: Annotated[
        Pins, Field(description="What the new plan keeps, by its own slots; pinned UAVs keep the rest of their paths.")
    ] = Pins()
    keep_pins: Annotated[
        bool,
        Field(
            description="Keep the pins of the plan before too, as far as they hold; `dropped_pins` of the result says "
            "which do not, and why."
        ),
    ] = False
    disruption_weight: Annotated[
        float,
        Field(
            ge=0,
            le=MOST_WEIGHT,
            allow_inf_nan=False,
            description="kbit/s of utility that a change must be worth: for each user that another UAV would serve "
            "throughout, and for each 100 m off the old paths. 0: changes are free.",
        ),
    ] = 0.0

    def arguments(self) -> dict[str, Any]:
        """Return the request as the arguments of `planner.replan`."""
        return {**self.remainder(), **{name: getattr(self, name) for name in Asked.model_fields}}

    def remainder(self) -> dict[str, Any]:
        """Return what is different as the arguments of `planner.remaining`."""
        return {
            "failed": (),
            "at_slot": self.at_slot,
            "positions_m": self.positions_m,
            "altitudes_m": self.altitudes_m,
            "used_wh": self.used_wh,
            "achieved_rates_bps": self.achieved_rates_bps,
            "changes": Changes(**{name: getattr(self, name) for name in Changes.model_fields}),
        }

    def reason(self) -> Cause:
        """Return the given cause, with the UAVs that it is about."""
        derived = cause_of(self)
        if self.cause is None or self.cause.uav_ids:
            return self.cause or derived
        return self.cause.model_copy(update={"uav_ids": derived.uav_ids})


class PlanPage(BaseModel):
    """Plans, the newest first. `next` is the `cursor` of the page after this one, null at the end."""

    items: list[PlanRow]
    next: int | None


@router.post("/plans", responses=ANSWERS, response_model=None, dependencies=planner_only, openapi_extra=PLAN_EXAMPLES)
async def create_plan(
    body: PlanRequest,
    service: ServiceDep,
    creation: NewPlan,
    wait_s: WaitS = 0,
    deadline_s: DeadlineS = None,
    starts: Starts = None,
) -> Response:
    """Plan a scenario. Answers 200 with the plan when it is done within `wait_s`, else 202 and a `Location`."""
    scenario = body.scenario()
    require_within_limits(scenario, service.settings)
    await asyncio.to_thread(pinned, scenario, body.pins)  # refuse now what cannot be kept
    record = await service.plans.submit(scenario, creation, deadline_s, starts, pins=body.pins)
    return await _created(service, record, wait_s)


@router.get("/plans")
async def list_plans(
    service: ServiceDep, limit: Limit = 50, cursor: Before = None, status: PlanStatus | None = None
) -> PlanPage:
    """List plans without their results, the newest first."""
    rows = await service.plans.store.rows(limit + 1, cursor, status)
    return PlanPage(
        items=[
            PlanRow(
                id=row.id,
                status=row.status,
                revision=row.revision,
                parent=row.parent,
                cause=json.loads(row.cause),
                created_at=row.created_at,
                ended_at=row.ended_at,
                summary=json.loads(row.summary) if row.summary else None,
                error=row.error,
            )
            for row in rows[:limit]
        ],
        next=rows[limit - 1].number if len(rows) > limit else None,
    )


@router.post(
    "/plans/{plan_id}/replans",
    responses=ANSWERS,
    response_model=None,
    dependencies=planner_only,
    openapi_extra=REPLAN_EXAMPLES,
)
async def create_replan(
    plan_id: str,
    body: ReplanRequest,
    service: ServiceDep,
    creation: NewPlan,
    wait_s: WaitS = 0,
    deadline_s: DeadlineS = None,
) -> Response:
    """Plan the remaining slots of a plan after a change of UAVs, users, utility or bandwidth.

    The result is a new plan whose `parent` is this one.
    """
    previous = await service.plans.finished(plan_id)
    scenario, _ = remaining(previous, **body.remainder())  # refuse now what cannot be replanned
    require_within_limits(scenario, service.settings)
    await asyncio.to_thread(pinned, scenario, body.pins, rest_of_paths_m(previous, body.at_slot, body))
    record = await service.plans.submit_replan(
        previous, body.arguments(), body.reason(), creation, deadline_s=deadline_s
    )
    return await _created(service, record, wait_s)


@router.post(
    "/plans/{plan_id}:cancel", status_code=202, response_model=None, responses=ANSWERS, dependencies=planner_only
)
async def cancel_plan(plan_id: str, service: ServiceDep, wait_s: WaitS = 0) -> Response:
    """Stop a plan; it ends as `cancelled` with the best feasible plan found so far. An ended plan stays as it is."""
    record = await service.plans.cancel(plan_id)
    await service.plans.wait(record, wait_s)
    return await _rendered(service, record)


@router.get("/plans/{plan_id}", responses=ANSWERS, response_model=None)
async def read_plan(plan_id: str, service: ServiceDep, wait_s: WaitS = 0) -> Response:
    """Return a plan, or how far it is: while it runs, `progress` and its `best` plan so far."""
    record = await service.plans.record(plan_id)
    await service.plans.wait(record, wait_s)
    return await _rendered(service, record)


@router.get("/plans/{plan_id}/missions", response_model=None, responses=MISSION_ANSWERS)
async def read_missions(
    plan_id: str,
    service: ServiceDep,
    format: Literal["plan", "waypoints", "json"] = "json",  # noqa: A002 - the name is part of the contract
    autopilot: Annotated[Autopilot, Query(description="Which autopilot will fly them.")] = DEFAULT_AUTOPILOT,
    uav_id: str | None = None,
) -> Response:
    """Return the MAVLink missions of a plan: all as JSON, or one UAV's as a `.plan` or `.waypoints` file.

    Both formats are QGroundControl's.
    """
    missions = Missions(await service.plans.finished(plan_id), autopilot)
    return await asyncio.to_thread(_mission_answer, missions, format, uav_id)


def _mission_answer(missions: Missions, format: str, uav_id: str | None) -> Response:  # noqa: A002 - as in the contract
    """Compile and encode; for a large fleet this takes a while and runs in a thread."""
    if format == "plan":
        return JSONResponse(missions.qgc_plan(uav_id))
    if format == "waypoints":
        return PlainTextResponse(missions.waypoints(uav_id))
    return JSONResponse(missions.as_json(uav_id))


async def _created(service: Service, record: PlanRecord, wait_s: float) -> Response:
    await record.stored
    await service.plans.wait(record, wait_s)
    answer = await _rendered(service, record)
    answer.headers["Location"] = f"/v1/plans/{record.id}"
    return answer


async def _rendered(service: Service, record: PlanRecord) -> Response:
    text = await service.plans.text(record)
    headers = {} if record.ended else {"Retry-After": "1"}
    return Response(text, status_code=200 if record.ended else 202, headers=headers, media_type="application/json")
