"""The FastAPI application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from skyfolio import __version__
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.plugins import load_plugins
from skyfolio.api.common.settings import Settings
from skyfolio.api.http import docs_page as reference
from skyfolio.api.http import problems
from skyfolio.api.http.middleware import AdmissionMiddleware
from skyfolio.api.http.proxies import ForwardedHeadersMiddleware
from skyfolio.api.http.routes import (
    allocations,
    contingencies,
    drills,
    events,
    explanations,
    fleet,
    login,
    operation_commands,
    operations,
    places,
    plans,
    scenarios,
    service,
    webhooks,
)
from skyfolio.api.plans.solver import Lane
from skyfolio.api.plans.solver_choice import solver_for
from skyfolio.api.service import Ports, Service

DESCRIPTION = """
Plans where a fleet of flying base stations goes and which users each one serves, flies that plan over MAVLink, and
replans for the survivors when an aircraft is lost.

**Units** are in names: `_m` metres, `_s` seconds, `_hz`, `_bps` bit/s, `_w` watts, `_deg` degrees WGS-84. Positions are
metres east and north of the scenario's `origin`; altitude is metres above each vehicle's own home, over terrain above
mean sea level. Slots count from 0.

**Conventions.** Requests that take time return `202` with `Location` and `Retry-After`; `wait_s` waits for the result.
`Idempotency-Key` makes every creating POST safe to repeat. Operations have an `ETag`; commands take `If-Match`. Lists
are paged by `cursor`. Errors are RFC 9457 `application/problem+json` and name the field and the rule. Bodies are
`application/json`.
"""


def create_app(
    settings: Settings | None = None,
    *,
    ui: bool = False,
    flight: Lane | None = None,
    clock: FleetClock | None = None,
) -> FastAPI:
    """Return the service as an ASGI app; its parts live from startup to shutdown.

    ui: also serve the dashboard at `/ui`; its framework allows one app per process, so create only one with it.
    flight: the lane of replans in flight, when it has already been started (`api.plans.solver.flight_lane`).
    clock: the fleet's time, when it is not the wall's times `settings.time_scale`: a simulated fleet's own.
    """
    settings = settings or Settings()
    load_plugins()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        begun = Ports(solver=lambda chosen: solver_for(chosen, flight))
        app.state.service = await Service.open(settings, clock, begun)
        try:
            yield
        finally:
            await app.state.service.close()

    app = FastAPI(
        title="skyfolio",
        version=__version__,
        summary="Plan, fly and heal multi-UAV communication networks.",
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=problems.DESCRIBED,
        generate_unique_id_function=lambda route: route.name,
        docs_url=None,
        redoc_url=None,
    )
    for routes in (
        plans,
        contingencies,
        explanations,
        scenarios,
        places,
        fleet,
        operations,
        operation_commands,
        allocations,
        drills,
        events,
        webhooks,
        service,
        login,
    ):
        app.include_router(routes.router)
    reference.install(app)
    problems.install(app)
    app.add_middleware(AdmissionMiddleware, owner=app)
    app.add_middleware(ForwardedHeadersMiddleware, settings=settings)
    if ui:
        from skyfolio.api.dashboard.mount import mount  # noqa: PLC0415 - importing it makes the process-wide app

        mount(app, time_scale=settings.time_scale, tile_url=settings.tile_url)
    return app
