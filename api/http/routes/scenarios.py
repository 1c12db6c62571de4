"""Example scenarios, and a check of one's own."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import NotFoundError
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, require_within_limits, requires
from skyfolio.api.http.routes.examples import PLAN_EXAMPLES
from skyfolio.planner import EXAMPLES, Scenario

router = APIRouter(prefix="/v1", tags=["scenarios"], dependencies=[*KNOWN, requires(Role.VIEWER)])


class ExampleList(BaseModel):
    """Names of the ready scenarios."""

    examples: list[str]


class Verdict(BaseModel):
    """A scenario that breaks no rule; one that does is answered with 422 and the rules."""

    valid: bool = True
    uavs: int
    users: int
    slots: int


@router.get("/scenarios/examples")
async def list_examples() -> ExampleList:
    """List the names of the ready scenarios."""
    return ExampleList(examples=sorted(EXAMPLES))


@router.get("/scenarios/examples/{name}")
async def read_example(name: str) -> Scenario:
    """Return one ready scenario, to plan or to edit."""
    if name not in EXAMPLES:
        raise NotFoundError(f"example {name!r} does not exist; there are {', '.join(sorted(EXAMPLES))}")
    return EXAMPLES[name]()


@router.post("/scenarios:validate", openapi_extra=PLAN_EXAMPLES)
async def validate_scenario(scenario: Scenario, service: ServiceDep) -> Verdict:
    """Check a scenario without planning it."""
    require_within_limits(scenario, service.settings)
    return Verdict(uavs=len(scenario.uavs), users=len(scenario.users), slots=scenario.slots)
