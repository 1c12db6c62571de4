"""Joins the dashboard to the service's app. NiceGUI's app is one a process, so this is done once a process."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import FastAPI
from nicegui import Client, ui

from api.dashboard.feed import Feed
from api.dashboard.pages.fly import FlyPage
from api.dashboard.pages.plan import PlanPage
from api.dashboard.rest import Rest
from api.dashboard.watch import Watch

HERE = Path(__file__).parent
PATH = "/ui"


def mount(service_app: FastAPI, *, time_scale: float = 1.0, tile_url: str | None = None) -> None:
    """Serve the dashboard at `/ui` of the app.

    tile_url: of a map server, with {z}, {x} and {y}; None draws a grid and asks nobody.
    """
    watch = Watch(Feed(Rest(service_app)), time_scale)
    ui.add_css(HERE / "style.css", shared=True)

    @ui.page("/")
    def fly(client: Client) -> None:
        _count(client, watch)
        FlyPage(watch, tile_url)

    @ui.page("/plan")
    def plan(client: Client) -> None:
        _count(client, watch)
        PlanPage(watch)

    ui.run_with(service_app, mount_path=PATH, title="skyfolio", dark=None, tailwind=False, show_welcome_message=False)
    _live_with(service_app, watch)


def _count(client: Client, watch: Watch) -> None:
    client.on_connect(watch.join)
    client.on_disconnect(watch.leave)


def _live_with(service_app: FastAPI, watch: Watch) -> None:
    """The watch begins after the service's own parts, and ends before them."""
    inner = service_app.router.lifespan_context

    @asynccontextmanager
    async def lifespan(app_: FastAPI) -> AsyncIterator[None]:
        async with inner(app_):
            watch.start()
            try:
                yield
            finally:
                await watch.stop()

    service_app.router.lifespan_context = lifespan
