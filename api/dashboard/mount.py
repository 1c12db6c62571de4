"""Joins the dashboard to the service's app. There is one NiceGUI app per process, so this is done once per process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import RedirectResponse
from nicegui import Client, ui
from starlette.types import ASGIApp, Receive, Scope, Send

from skyfolio.api.dashboard.feed import Feed
from skyfolio.api.dashboard.pages.drill import DrillPage
from skyfolio.api.dashboard.pages.fly import FlyPage
from skyfolio.api.dashboard.pages.plan import PlanPage
from skyfolio.api.dashboard.pages.replay import ReplayPage
from skyfolio.api.dashboard.port import COOKIE, INSIDE, PATH
from skyfolio.api.dashboard.rest import Rest
from skyfolio.api.dashboard.watch import Watch

HERE = Path(__file__).parent
MOST_KEYS = 64


class Watches:
    """One watch for each key that operators use (None while no key is needed), created on first use.

    A page may do what its key may do: every call passes the service's own access control with that key.
    """

    def __init__(self, service_app: FastAPI, time_scale: float) -> None:
        self._app, self._time_scale = _from_inside(service_app), time_scale
        self._watches: dict[str | None, Watch] = {}

    def of(self, key: str | None) -> Watch:
        """Return the watch of this key."""
        if key not in self._watches:
            headers = {"authorization": f"Bearer {key}"} if key else {}
            watch = self._watches[key] = Watch(Feed(Rest(self._app, headers)), self._time_scale)
            watch.start()
            if len(self._watches) > MOST_KEYS:
                oldest = next(iter(self._watches))
                self._ending = asyncio.create_task(self._watches.pop(oldest).stop())
        return self._watches[key]

    async def stop(self) -> None:
        """Stop all watches."""
        await asyncio.gather(*(watch.stop() for watch in self._watches.values()))


def mount(service_app: FastAPI, *, time_scale: float = 1.0, tile_url: str | None = None) -> None:
    """Serve the dashboard at `/ui` of the app.

    Args:
        service_app: The service's app, which the dashboard calls in process.
        time_scale: How many fleet seconds pass in one wall second.
        tile_url: URL of a map server with {z}, {x} and {y}; None draws a grid and sends no requests.
    """
    watches = Watches(service_app, time_scale)
    ui.add_css(HERE / "style.css", shared=True)
    pages: dict[str, Callable[[Watch], object]] = {
        "/": lambda watch: FlyPage(watch, tile_url),
        "/plan": PlanPage,
        "/drill": DrillPage,
        "/replay": lambda watch: ReplayPage(watch, tile_url),
    }
    for path, build in pages.items():
        _page(path, build, watches)
    ui.run_with(service_app, mount_path=PATH, title="skyfolio", dark=None, tailwind=False, show_welcome_message=False)
    service_app.add_api_route("/", _front_door, include_in_schema=False)
    _end_with(service_app, watches)


def _from_inside(app: FastAPI) -> ASGIApp:
    """Return the app as the dashboard calls it: on behalf of a client that was allowed to open the page."""

    async def call(scope: Scope, receive: Receive, send: Send) -> None:
        await app({**scope, INSIDE: True}, receive, send)

    return call


def _front_door() -> RedirectResponse:
    """Redirect a request for the service's root to the dashboard."""
    return RedirectResponse(f"{PATH}/")


def _page(path: str, build: Callable[[Watch], object], watches: Watches) -> None:
    @ui.page(path)
    def page(client: Client, request: Request) -> None:
        watch = watches.of(request.cookies.get(COOKIE))
        client.on_connect(watch.join)
        client.on_disconnect(watch.leave)
        build(watch)


def _end_with(service_app: FastAPI, watches: Watches) -> None:
    """Stop the watches before the service's own parts stop."""
    inner = service_app.router.lifespan_context

    @asynccontextmanager
    async def lifespan(app_: FastAPI) -> AsyncIterator[None]:
        async with inner(app_):
            try:
                yield
            finally:
                await watches.stop()

    service_app.router.lifespan_context = lifespan
