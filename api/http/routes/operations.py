"""Operations: flying a plan with the fleet."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import InvalidError, NotFoundError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.common.settings import MOST_WEIGHT
from skyfolio.api.flights.endless.relief_terms import ReliefTerms
from skyfolio.api.flights.endless.terms import End, Terms, terms_of
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import OperationRow, OperationView, Policy
from skyfolio.api.flights.restart import Record
from skyfolio.api.http.routes.deps import (
    KNOWN,
    Before,
    Limit,
    ServiceDep,
    creates,
    require_within_limits,
    requires,
)
from skyfolio.api.http.routes.ends import Duration, Until, end_of
from skyfolio.api.http.routes.etags import tag_of, tagged
from skyfolio.api.http.routes.examples import OPERATION_EXAMPLES
from skyfolio.mavlink_bridge import OnEnd
from skyfolio.mavlink_bridge.guidance import FallBack
from skyfolio.planner import Plan, Scenario

router = APIRouter(prefix="/v1", tags=["operations"], dependencies=[*KNOWN, requires(Role.VIEWER)])
pilot_only = [requires(Role.PILOT)]


class OperationRequest(BaseModel):
    """Which plan to fly, what happens after a loss, whether it takes off by itself, and until when it is extended."""

    model_config = ConfigDict(extra="forbid")

    plan_id: Annotated[str | None, Field(max_length=64, description="A finished plan; or give a `scenario`.")] = None
    scenario: Annotated[Scenario | None, Field(description="What is planned first, and then flown.")] = None
    replanning: Policy = "auto"
    guidance: Annotated[
        Literal["mission", "stream"],
        Field(description="stream: guided by setpoints, for tight synchrony; the missions on board are the fallback."),
    ] = "mission"
    stream_fallback: Annotated[
        FallBack,
        Field(
            description="What vehicles do when the stream of setpoints ends, for example because the service is killed."
        ),
    ] = FallBack.MISSION
    force_stream: Annotated[
        bool,
        Field(
            description="Stream even to a PX4 whose `COM_OBL_RC_ACT` is not 5 (hold): it flies home when "
            "setpoints pause, even for a second. Refused without this, whatever the preflight setting is."
        ),
    ] = False
    at_end: Annotated[
        Literal["land", "return"] | None,
        Field(
            description="After the last slot: land where it is, or return to the start; refused if return paths meet. "
            "Default: land; return in an operation without a fixed end."
        ),
    ] = None
    disruption_weight: Annotated[
        float | None,
        Field(
            ge=0,
            le=MOST_WEIGHT,
            allow_inf_nan=False,
            description="kbit/s of utility that a recovery's change of the plan must be worth: for each user that "
            "another UAV would serve throughout, and for each 100 m off the old paths. 0: changes are free. Default: "
            "the setting of that name.",
        ),
    ] = None
    launch: Annotated[
        Literal["auto", "manual"], Field(description="manual: upload, then wait for `operations/{id}:start`.")
    ] = "auto"
    horizon_slots: Annotated[
        int | None,
        Field(
            ge=4,
            le=10_000,
            strict=True,
            description="Extend the plan in flight, again and again: how many slots each new plan has. Default where "
            "`duration_s`, `until` or `replan_every_slots` is given: as many as the first plan.",
        ),
    ] = None
    replan_every_slots: Annotated[
        int | None,
        Field(
            ge=1,
            le=10_000,
            strict=True,
            description="After how many slots a plan is extended: at most `horizon_slots` - 3. Default: a quarter.",
        ),
    ] = None
    duration_s: Duration = None
    until: Until = None
    relief: Annotated[
        ReliefTerms | None,
        Field(description="Vehicles that relieve those of the plan, and each other, in an operation that is extended."),
    ] = None

    def end(self) -> End:
        """Return when no further extension is made. Raises InvalidError."""
        return end_of(self.duration_s, self.until)

    def extended(self) -> Callable[[Plan], Terms] | None:
        """Return what says how a plan is extended; None if it is flown once. Raises InvalidError."""
        end, asked = self.end(), (self.horizon_slots, self.replan_every_slots)
        if end == End() and asked == (None, None) and self.relief is None:
            return None
        return partial(terms_of, horizon_slots=self.horizon_slots, replan_every_slots=self.replan_every_slots, end=end)


class SlotRates(BaseModel):
    """What each user got in one slot of an operation, bit/s; null where it is not known."""

    slot: int
    rates_bps: dict[str, float | None]


class OperationPage(BaseModel):
    """Operations, the newest first. `next` is the `cursor` of the page after this one."""

    items: list[OperationRow]
    next: int | None


class TrackPoint(BaseModel):
    """Where each UAV was heard, metres east/north of the origin, fleet seconds after slot 0 began."""

    elapsed_s: float
    positions_m: dict[str, tuple[float, float]]


@router.post("/operations", status_code=202, dependencies=pilot_only, openapi_extra=OPERATION_EXAMPLES)
async def start_operation(
    body: OperationRequest,
    service: ServiceDep,
    response: Response,
    creation: Annotated[NewResource, Depends(creates("op"))],
) -> OperationView:
    """Upload the plan's missions, take off, and fly; poll `Location` or follow `/v1/events`.

    Recoveries keep the pins of the plan as far as they hold; their reports say which, and what they changed.

    With `horizon_slots`, `replan_every_slots`, `duration_s`, `until` or `relief` it has no fixed end: its plan is
    extended in flight, by incidents of cause `extended`, until then, or until `operations/{id}:extend` moves that.
    """
    extended = body.extended()
    at_end = body.at_end or ("land" if extended is None else "return")
    operation = await service.operations.start(
        await _plan_id(body, service, creation),
        body.replanning,
        creation,
        launch_itself=body.launch == "auto",
        disruption_weight=body.disruption_weight,
        options=GuidanceOptions(body.guidance, body.stream_fallback, OnEnd(at_end), force_stream=body.force_stream),
        extended=extended,
        relief=_relief_of(body),
    )
    view = operation.view() if isinstance(operation, Operation) else operation
    response.headers["Location"] = f"/v1/operations/{view.id}"
    return tagged(response, view)


@router.get("/operations")
async def list_operations(service: ServiceDep, limit: Limit = 50, cursor: Before = None) -> OperationPage:
    """List operations, the newest first."""
    rows = await service.operations.rows(limit + 1, cursor)
    items = [
        OperationRow(
            id=row.id,
            state=row.state,
            owner=service.operations.ownership.owner(row.id),
            version=row.version,
            plan_id=row.plan_id,
            replanning=row.policy,
            created_at=row.created_at,
            ended_at=row.ended_at,
        )
        for row in rows[:limit]
    ]
    return OperationPage(items=items, next=rows[limit - 1].number if len(rows) > limit else None)


@router.get(
    "/operations/{operation_id}",
    response_model=OperationView,
    responses={304: {"description": "`If-None-Match` names the present ETag: nothing that can be commanded changed."}},
)
async def read_operation(operation_id: str, service: ServiceDep, request: Request, response: Response) -> Any:
    """Return the state of an operation: slot, losses, recoveries, and the rates users received."""
    view = await service.operations.view(operation_id)
    if request.headers.get("if-none-match") == tag_of(view):
        return Response(status_code=304, headers={"ETag": tag_of(view)})
    return tagged(response, view)


@router.get("/operations/{operation_id}/journal")
async def read_journal(operation_id: str, service: ServiceDep) -> list[Entry]:
    """Return every step of every incident, as it was stored before it was carried out."""
    await _require(service, operation_id)
    return await service.journal.of(operation_id)


@router.get("/operations/{operation_id}/rates")
async def read_rates(
    operation_id: str,
    service: ServiceDep,
    from_slot: Annotated[int, Query(ge=0, le=2_000_000, description="The first slot.")] = 0,
    limit: Annotated[int, Query(ge=1, le=10_000, description="At most so many slots.")] = 1000,
) -> list[SlotRates]:
    """Return what each user got in each slot, also in those that are no longer part of the operation itself."""
    found = await service.operations.rates(operation_id, from_slot, limit)
    return [SlotRates(slot=slot, rates_bps=dict(rates)) for slot, rates in found]


@router.get("/operations/{operation_id}/track", response_model=list[TrackPoint])
async def read_track(
    operation_id: str,
    service: ServiceDep,
    after_s: Annotated[
        float | None, Query(allow_inf_nan=False, description="Only what was heard after this fleet second.")
    ] = None,
    limit: Annotated[int | None, Query(ge=1, le=10_000, description="At most this many points; default: all.")] = None,
) -> Response:
    """Return where every UAV was heard, twice per fleet second, for replay; `after_s` and `limit` page through.

    Of an operation without a fixed end only the newest part is that fine; before, there is a point every 5 s.
    """
    await _require(service, operation_id)
    record = await service.operations.track(operation_id, after_s, limit)
    return Response(await asyncio.to_thread(track_json, record), media_type="application/json")


def track_json(record: Record) -> bytes:
    """Return the track as JSON. A long one takes a while and is encoded in a thread."""
    points = (TrackPoint(elapsed_s=at, positions_m=where).model_dump_json() for at, where in record)
    return f"[{','.join(points)}]".encode()


def _relief_of(body: OperationRequest) -> ReliefTerms | None:
    """Return what was asked of relief. Raises InvalidError for guidance by which no vehicle is relieved."""
    if body.relief is not None and body.guidance == "stream":
        raise InvalidError("relief: vehicles that are guided by setpoints are not relieved; guidance must be mission")
    return body.relief


async def _plan_id(body: OperationRequest, service: ServiceDep, creation: NewResource) -> str:
    """Return the id of the plan that is flown first, made now from the scenario if that is given.

    A request that is repeated with its key finds the plan that was made the first time. Raises InvalidError.
    """
    if (body.plan_id is None) == (body.scenario is None):
        raise InvalidError("plan_id, scenario: one of them must be given")
    if body.scenario is None:
        return str(body.plan_id)
    scenario = body.scenario
    if body.horizon_slots is not None:
        scenario = scenario.with_changes(slots=body.horizon_slots)
    require_within_limits(scenario, service.settings)
    made = NewResource(id=f"plan-of-{creation.id}", owner=creation.owner, fingerprint=creation.fingerprint)
    record = await service.plans.submit(scenario, made)
    await record.done.wait()
    return record.id


async def _require(service: ServiceDep, operation_id: str) -> None:
    if not await service.operations.exists(operation_id):
        raise NotFoundError(f"operation {operation_id!r} does not exist")
