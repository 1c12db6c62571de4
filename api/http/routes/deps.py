"""Dependencies of the routes: the running service, roles, paging, idempotency and size limits."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from typing import Annotated, Any

from fastapi import Depends, Header, Query, Request, Security
from fastapi.security import HTTPBearer

from skyfolio.api.access.api_keys import Principal, Role
from skyfolio.api.common.errors import ForbiddenError, InvalidError
from skyfolio.api.common.idempotency import NewResource, fresh, keyed
from skyfolio.api.common.settings import Settings
from skyfolio.api.service import Service
from skyfolio.planner import Scenario

_bearer = HTTPBearer(
    auto_error=False,
    scheme_name="apiKey",
    description="A key made by `skyfolio keys create`. Not needed on loopback while there is no key.",
)
Limit = Annotated[int, Query(ge=1, le=200, description="At most this many.")]
Before = Annotated[
    int | None, Query(ge=1, le=2**53, alias="cursor", description="`next` of the previous page; default: the newest.")
]
WaitS = Annotated[float, Query(ge=0, le=60, description="Wait up to this many seconds for the result.")]


async def _service(request: Request) -> Service:  # a plain function would be called in a thread
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(_service)]


def principal_of(request: Request) -> Principal:
    """Return who asks, as the middleware has established it."""
    principal: Principal = request.state.principal
    return principal


def requires(role: Role) -> Any:
    """Return a dependency that lets only keys of this role or a higher one pass. Raises ForbiddenError."""

    async def check(request: Request) -> None:
        principal = principal_of(request)
        if not principal.role.covers(role):
            raise ForbiddenError(f"role: '{principal.name}' is a {principal.role.value}; this needs a {role.value}")

    return Depends(check)


KNOWN = [Security(_bearer)]
"""Dependency of every router: shows in the OpenAPI that a key may be needed. The middleware checks it."""

Key = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        description="A name you choose for this request. Sending it again creates nothing new and returns the "
        "resource as it is now; the same key with another request is refused with 422.",
        examples=["8e03978e-40d5-43dd-bc93-6894a57f9324"],
    ),
]


def creates(prefix: str) -> Callable[..., Awaitable[NewResource]]:
    """Return a dependency that gives the new resource its id, the same one for the same `Idempotency-Key`."""

    async def creation(request: Request, key: Key = None) -> NewResource:
        owner = principal_of(request).name
        if key is None:
            return fresh(prefix, owner)
        query = sorted((name, value) for name, value in request.query_params.multi_items() if name != "wait_s")
        return keyed(prefix, owner, key, request.url.path, json.dumps(query).encode() + await request.body())

    return creation


def require_within_limits(scenario: Scenario, settings: Settings) -> None:
    """Refuse what is too large for this service. Raises InvalidError naming field and limit."""
    n_uavs, n_users, slots = len(scenario.uavs), len(scenario.users), scenario.slots
    for field, what, size, limit in (
        ("uavs", "UAVs", n_uavs, settings.max_uavs),
        ("users", "users", n_users, settings.max_users),
        ("slots", "slots", slots, settings.max_slots),
        ("slots", "users x slots", n_users * slots, settings.max_plan_cells),
        ("slots", "UAVs x users x slots", n_uavs * n_users * slots, settings.max_cells),
    ):
        if size > limit:
            raise InvalidError(
                f"{field}: {size:,} {what} are more than the {limit:,} that this service plans at once; "
                "`skyfolio plan` has no limit"
            )
