"""Why a plan is as it is, what a change would bring, and what the plan stands up to."""

from __future__ import annotations

from typing import Annotated, Any, Self

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, ConfigDict, Field, model_validator

from skyfolio.api.access.api_keys import Role
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, require_within_limits, requires
from skyfolio.api.http.routes.examples import PREVIEW_EXAMPLES, ROBUSTNESS_EXAMPLES
from skyfolio.api.http.routes.plans import ReplanRequest
from skyfolio.api.plans.explanations import UnfinishedExplanation
from skyfolio.planner import Comparison, Explanation, Robustness, Scenario, Trial, remaining, require_possible
from skyfolio.planner.scenario import Identifier

router = APIRouter(prefix="/v1", tags=["plans"], dependencies=[*KNOWN, requires(Role.PLANNER)])
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "The explanation.", "model": Explanation},
    202: {"description": "It is being made; try again after `Retry-After`.", "model": UnfinishedExplanation},
}
ASSESSED: dict[int | str, dict[str, Any]] = {200: {"description": "The robustness.", "model": Robustness}}
PREVIEW_ANSWERS: dict[int | str, dict[str, Any]] = {200: {"description": "The comparison.", "model": Comparison}}


class PreviewRequest(BaseModel):
    """What to compare with the plan: a whole `scenario`, or `changes` from a slot on; one of the two."""

    model_config = ConfigDict(extra="forbid")

    plan_id: Identifier
    scenario: Annotated[
        Scenario | None, Field(description="Instead of the plan's scenario, from the plan's slot 0 on.")
    ] = None
    changes: Annotated[ReplanRequest | None, Field(description="As in a replan; `cause` is ignored.")] = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.scenario is None) == (self.changes is None):
            raise ValueError("changes: give scenario or changes, one of them")
        return self


@router.get("/plans/{plan_id}/explanation", responses=ANSWERS, response_model=None)
async def read_explanation(
    plan_id: str,
    service: ServiceDep,
    resolves: Annotated[
        int, Query(ge=0, le=200, description="Changed scenarios to solve at most; 0: bounds and derivatives only.")
    ] = 32,
    wait_s: Annotated[float, Query(ge=0, le=60, description="Wait up to this many seconds for the result.")] = 10,
) -> Response:
    """Explain a plan: why users get little, what one thing more would be worth, which constraint binds at which price.

    Each number says how it was obtained: `bound`, `resolve` or `derivative`. Resolves hold the pins of the plan. Large
    fleets get no resolves.
    """
    found = await service.explanations.of(plan_id, await service.plans.result(plan_id), resolves, wait_s)
    if found is None:
        waiting = UnfinishedExplanation(plan_id=plan_id).model_dump_json()
        return Response(waiting, status_code=202, headers={"Retry-After": "1"}, media_type="application/json")
    return Response(found, media_type="application/json")


@router.post("/plans:preview", responses=PREVIEW_ANSWERS, response_model=None, openapi_extra=PREVIEW_EXAMPLES)
async def preview_change(
    body: PreviewRequest,
    service: ServiceDep,
    deadline_s: Annotated[
        float | None, Query(gt=0, le=60, description="Compare the best plan found after this many seconds of solving.")
    ] = None,
) -> Response:
    """Compare a changed scenario with a plan: utility, rates, users that gain and lose, how UAVs move.

    A `scenario` is planned with the pins of the plan as far as they hold (`dropped_pins` says which do not), `changes`
    with those that they name or keep. Nothing is stored.
    """
    scenario, changes = body.scenario, body.changes
    if changes is not None:  # refuse now what has no plan
        changed, _ = remaining(await service.plans.finished(body.plan_id), **changes.remainder())
    elif scenario is not None:
        changed = scenario
    require_within_limits(changed, service.settings)
    seen = await service.explanations.preview(
        await service.plans.result(body.plan_id),
        scenario=None if scenario is None else scenario.model_dump_json(),
        request={} if changes is None else changes.arguments(),
        deadline_s=deadline_s,
    )
    return Response(seen, media_type="application/json")


@router.post("/plans/{plan_id}/robustness", responses=ASSESSED, response_model=None, openapi_extra=ROBUSTNESS_EXAMPLES)
async def assess_plan(
    plan_id: str,
    body: Trial,
    service: ServiceDep,
    deadline_s: Annotated[
        float | None, Query(gt=0, le=60, description="Leave out what is not computed after this many seconds.")
    ] = None,
) -> Response:
    """Assess a plan under fading, wind and errors of position, and after every single and double loss with a replan.

    Percentiles of each user's rate, probabilities of an outage, and the worst cases by name. The same request gives
    the same numbers; `complete` is false when there was no time for all of it. Nothing is stored.
    """
    require_possible(await service.plans.finished(plan_id), body)  # refuse now what makes no sense
    plan = await service.plans.result(plan_id)
    found = await service.explanations.assess(plan, body.model_dump(mode="json"), deadline_s)
    return Response(found, media_type="application/json")
