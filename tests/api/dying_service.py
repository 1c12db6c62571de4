"""A service that kills itself (SIGKILL) at one step of the journal: a program, run by the tests.

usage: python -c "from tests.api.dying_service import main; main()" SETTINGS_JSON STEP WHEN COUNT
WHEN: before or after the COUNT-th such entry is stored
"""

import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import uvicorn
from fastapi import FastAPI

from skyfolio.api.common.logs import configure_logging
from skyfolio.api.common.settings import Settings
from skyfolio.api.flights.journal import Entry
from skyfolio.api.http.app import create_app


def dying(settings: Settings, step: str, when: str, count: int) -> FastAPI:
    """The app, with a listener on its journal that ends the process."""
    app = create_app(settings)
    alive = app.router.lifespan_context
    seen = 0

    def die(entry: Entry, stored: bool) -> None:
        nonlocal seen
        if entry.step == step and stored == (when == "after"):
            seen += 1
            if seen == count:
                os.kill(os.getpid(), signal.SIGKILL)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[Any]:
        async with alive(app) as state:
            app.state.service.journal.listeners.append(die)
            yield state

    app.router.lifespan_context = lifespan
    return app


def main() -> None:
    """Serve until killed."""
    settings = Settings.model_validate_json(sys.argv[1])
    configure_logging(as_json=True)
    app = dying(settings, sys.argv[2], sys.argv[3], int(sys.argv[4]))
    uvicorn.run(app, host=settings.host, port=settings.port, log_config=None, access_log=False)
