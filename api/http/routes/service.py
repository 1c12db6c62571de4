"""Health, readiness, metrics and the audit log."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import BaseModel
from sqlalchemy import select

from skyfolio import __version__
from skyfolio.api.access.api_keys import Role
from skyfolio.api.http.routes.deps import KNOWN, Limit, ServiceDep, requires
from skyfolio.api.store.tables import audit

router = APIRouter(tags=["service"])
known = [*KNOWN, requires(Role.VIEWER)]


class Health(BaseModel):
    """The service answers and its solver solves.

    `solve_ms`: time from submitting a tiny instance to its result, measured some seconds ago; null when clients'
    solves have left no time to measure it.
    """

    status: str
    version: str
    solve_ms: float | None


class Readiness(BaseModel):
    """Whether requests can be served now; `checks` says what is missing."""

    ready: bool
    checks: dict[str, str]


class AuditRow(BaseModel):
    """Who requested what. `at` is UTC seconds since 1970."""

    id: int
    at: float
    principal: str
    role: str
    client: str
    method: str
    path: str
    status: int
    request_id: str


class AuditPage(BaseModel):
    """Rows of the audit log, the newest first. `next` is the `cursor` of the page after this one."""

    items: list[AuditRow]
    next: int | None


@router.get("/health", responses={503: {"description": "The solver does not solve."}})
async def health(service: ServiceDep) -> Health:
    """Report that the service is alive and able to solve. Needs no key.

    A tiny instance is solved when none was in the last seconds.
    """
    return Health(status="ok", version=__version__, solve_ms=await service.pulse())


@router.get("/ready", response_model=Readiness, responses={503: {"description": "Not now.", "model": Readiness}})
async def ready(service: ServiceDep) -> Response:
    """Report whether the service can take work.

    The database answers, the workers are warm, and what was in the air is followed again.
    """
    checks = await service.readiness()
    well = all(state.partition(":")[0] == "ok" for state in checks.values())
    body = Readiness(ready=well, checks=checks).model_dump()
    return JSONResponse(body, status_code=200 if well else 503, headers={} if well else {"Retry-After": "1"})


@router.get("/metrics", dependencies=known, response_class=PlainTextResponse)
async def read_metrics(service: ServiceDep) -> Response:
    """Return the metrics in Prometheus exposition format."""
    return Response(service.measured(), media_type="text/plain; version=0.0.4; charset=utf-8")


@router.get("/v1/audit", dependencies=[*KNOWN, requires(Role.PILOT)])
async def read_audit(
    service: ServiceDep, limit: Limit = 50, cursor: Annotated[int | None, Query(ge=1, le=2**53)] = None
) -> AuditPage:
    """Return the requests that change something, and those that were refused, with who sent them."""
    query = select(audit).order_by(audit.c.id.desc()).limit(limit + 1)
    rows = await service.database.rows(query if cursor is None else query.where(audit.c.id < cursor))
    items = [AuditRow(**dict(row._mapping)) for row in rows[:limit]]
    return AuditPage(items=items, next=items[-1].id if len(rows) > limit else None)
