"""Time-outs of connections that send nothing, or never finish their headers (slow-loris).

uvicorn bounds the time between two requests of a connection, but neither the time until the first nor that of a
request's headers, nor their size; and any byte in between sets its clock back. While a response is being sent, however
long (event streams), and after the upgrade to a websocket, none of this applies; the middleware limits how long a body
may take.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEADERS_WITHIN_S = 15.0
"""Wall seconds from the start of a connection, or the end of a response, until the next request's headers are in."""
MOST_HEADER_BYTES = 65_536


class HeaderTimeoutProtocol(HttpToolsProtocol):
    """uvicorn's HTTP/1.1 with a time limit for the headers of each request."""

    headers_within_s = HEADERS_WITHIN_S

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for the first request."""
        super().connection_made(transport)
        self._patience: asyncio.TimerHandle | None = None
        self._header_bytes, self._in_body = 0, False
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._heard()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Close the connection when the headers of a request have no end."""
        if self._header_bytes > MOST_HEADER_BYTES:
            self.transport.close()
            return
        if not self._in_body:
            self._header_bytes += len(data)
        super().data_received(data)

    def on_headers_complete(self) -> None:
        """Stop the timer: a request has arrived."""
        self._heard()
        self._in_body = True
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Expect headers next."""
        self._in_body = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Start the timer for the next request."""
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
