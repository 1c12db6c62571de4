"""The N-1 table of a plan: what users would receive after each single loss."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.settings import MOST_WEIGHT
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, requires
from skyfolio.api.plans.contingencies import ContingencyTable

router = APIRouter(prefix="/v1", tags=["plans"], dependencies=[*KNOWN, requires(Role.PLANNER)])


ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "Every row.", "model": ContingencyTable},
    202: {"description": "Some rows are still being made; try again after `Retry-After`.", "model": ContingencyTable},
}


@router.get("/plans/{plan_id}/contingencies", responses=ANSWERS, response_model=None)
async def read_contingencies(
    plan_id: str,
    service: ServiceDep,
    at_slot: Annotated[
        int | None, Query(ge=0, le=1_000_000, description="The slot at which the UAV is lost; default: the second.")
    ] = None,
    disruption_weight: Annotated[
        float | None,
        Query(
            ge=0,
            le=MOST_WEIGHT,
            allow_inf_nan=False,
            description="What a change must be worth, kbit/s, as in an operation. Default: the setting of that name.",
        ),
    ] = None,
    wait_s: Annotated[float, Query(ge=0, le=60, description="Wait up to this many seconds for all rows.")] = 10,
) -> Response:
    """Return, for each UAV lost at a slot (N-1), the rates with and without a plan for the survivors.

    Each plan is made once, kept, and flown when that loss really happens in an operation of the same
    `disruption_weight`. It keeps the pins of the plan as far as they hold.
    """
    plan = await service.plans.finished(plan_id)
    slot = plan.first_slot + 1 if at_slot is None else at_slot
    last = plan.first_slot + plan.scenario.slots - 1
    if not plan.first_slot <= slot <= last:
        raise InvalidError(f"at_slot: {slot} must lie in {plan.first_slot}..{last}")
    weight = service.settings.disruption_weight if disruption_weight is None else disruption_weight
    rows = await service.contingencies.table_of(plan, slot, wait_s, weight)
    complete = len(rows) == len(plan.scenario.uavs)
    begin = slot - plan.first_slot
    planned = sum(sum(rates[begin:]) for rates in plan.user_rates_bps.values()) / (plan.scenario.slots - begin)
    table = ContingencyTable(
        plan_id=plan.id,
        at_slot=slot,
        mean_sum_rate_bps=planned,
        disruption_weight=weight,
        complete=complete,
        rows=rows,
    )
    headers = {} if complete else {"Retry-After": "1"}
    return JSONResponse(table.model_dump(mode="json"), status_code=200 if complete else 202, headers=headers)
