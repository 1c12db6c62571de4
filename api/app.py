"""The FastAPI application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from api import __version__, problems
from api.routes import events, fleet, operations, plans, scenarios
from api.service import Service
from api.settings import Settings


def create_app(settings: Settings | None = None, *, ui: bool = False) -> FastAPI:
    """The service as an ASGI app; its parts live from startup to shutdown.

    ui: also serve the dashboard at `/ui`; it lives in one app a process, so make only one app with it.
    """
    settings = settings or Settings()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        service = Service(settings)
        app.state.service = service
        try:
            await service.start()
            yield
        finally:
            await service.stop()

    app = FastAPI(
        title="skyfolio",
        version=__version__,
        summary="Plan, fly and heal multi-UAV communication networks.",
        lifespan=lifespan,
    )
    for routes in (plans, scenarios, fleet, operations, events):
        app.include_router(routes.router)
    problems.install(app)
    if ui:
        from api.dashboard.mount import mount  # noqa: PLC0415 - importing it makes the process-wide app

        mount(app, time_scale=settings.time_scale, tile_url=settings.tile_url)
    return app
