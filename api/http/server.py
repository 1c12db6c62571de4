"""The server around the app: settings that are safe to bind, uvicorn, start and stop."""

from __future__ import annotations

import asyncio
import gc
import os
import socket
import sys
from typing import Any

import uvicorn
from fastapi import FastAPI

from skyfolio.api.access.api_keys import KeyRing
from skyfolio.api.common.configuration import bound, require_usable, settings_from
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.logs import configure_logging
from skyfolio.api.common.settings import Settings, default_database_url
from skyfolio.api.http.app import create_app
from skyfolio.api.http.banner import banner
from skyfolio.api.http.connections import HeaderTimeoutProtocol
from skyfolio.api.plans.solver import Lane
from skyfolio.api.store import Database

GRACE_S = 1
"""Seconds that open requests have to end when the service is stopped; streams end by themselves."""


class _Server(uvicorn.Server):
    """Says where it is when it listens, and ends the event streams when it is stopped: it would wait for them."""

    def __init__(self, config: uvicorn.Config, app: FastAPI, said: str) -> None:
        super().__init__(config)
        self._app, self._said = app, said

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the service, listen, and say so."""
        await super().startup(sockets)
        if self.started:
            sys.stderr.write(self._said)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop listening, let requests end, then the service."""
        self._app.state.service.events.end()
        await super().shutdown(sockets)


def serve(options: dict[str, Any], *, as_json: bool, ui: bool = True, flight: Lane | None = None) -> None:
    """Run until interrupted. Raises InvalidError for settings that cannot work, and an address that needs API keys.

    flight: the lane of replans in flight, whose worker loads while everything else does.
    """
    if "database_url" not in options and "SKYFOLIO_DATABASE_URL" not in os.environ:
        options = {**options, "database_url": default_database_url()}
    settings = settings_from(options)
    require_usable(settings)
    with bound(settings) as listener:
        require_safe(settings)
        configure_logging(as_json=as_json)
        app = create_app(settings, ui=ui, flight=flight)
        config = uvicorn.Config(
            app,
            http=HeaderTimeoutProtocol,
            log_config=None,
            access_log=False,
            proxy_headers=False,  # `api.http.proxies` reads them
            timeout_graceful_shutdown=GRACE_S,
        )
        said = "" if as_json else banner(settings, *listener.getsockname()[:2], ui=ui)
        server = _Server(config, app, said)
        _keep_for_good()
        server.run(sockets=[listener])
    if not server.started:
        sys.exit(3)


def _keep_for_good() -> None:
    """Exempt what was imported and built from garbage collection: a full one would block the loop for 0.1 s."""
    gc.collect()
    gc.freeze()
    gc.enable()  # `skyfolio serve` has switched it off for its imports


def require_safe(settings: Settings) -> None:
    """Refuse to let other machines in without keys.

    Raises InvalidError, and StoreError for a database that cannot be used.
    """

    async def keys_in_use() -> bool:
        database = await Database.open(settings.database_url)
        try:
            await database.claim()
            return await KeyRing(database).in_use()
        finally:
            await database.close()

    if not asyncio.run(keys_in_use()) and not settings.on_loopback:
        raise InvalidError(
            f"host: {settings.host} can be reached by other machines and there is no API key; make one with "
            "'skyfolio keys create NAME --role pilot', or bind to 127.0.0.1"
        )
