"""Connections that say nothing, or never finish saying it, are closed.

uvicorn bounds the time between two requests of a connection, but neither the time until the first nor that of a
request's headers, nor their size; and any byte in between sets its clock back. While a request is being answered,
however long (event streams) and after the upgrade to a websocket, nothing of this applies: how long a body may take is
the gate's business.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEADERS_WITHIN_S = 15.0
"""Wall seconds from the beginning of a connection, or the end of an answer, until the next request's headers are in."""
MOST_HEADER_BYTES = 65_536


class PatientProtocol(HttpToolsProtocol):
    """uvicorn's HTTP/1.1, whose patience ends."""

    headers_within_s = HEADERS_WITHIN_S

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._patience: asyncio.TimerHandle | None = None
        self._header_bytes, self._in_body = 0, False
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nobody is waited for any more."""
        self._heard()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """End a request whose headers are endless."""
        if self._header_bytes > MOST_HEADER_BYTES:
            self.transport.close()
            return
        if not self._in_body:
            self._header_bytes += len(data)
        super().data_received(data)

    def on_headers_complete(self) -> None:
        """A request is there."""
        self._heard()
        self._in_body = True
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Headers come next."""
        self._in_body = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        if not self.pipeline and not self.transport.is_closing():
            self._wait()

    def _wait(self) -> None:
        self._heard()
        self._patience = self.loop.call_later(self.headers_within_s, self.timeout_keep_alive_handler)

    def _heard(self) -> None:
        self._header_bytes = 0
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None
