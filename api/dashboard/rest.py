"""The service's own REST interface, called in process: the dashboard can do only what any client can."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from typing import Any

import httpx2
from starlette.types import ASGIApp, Message

BASE = "http://127.0.0.1"


class RestError(Exception):
    """The service refused a request; `title` and `detail` are from its problem document, `rules` name the fields."""

    def __init__(self, status: int, title: str, detail: str, rules: list[dict[str, str]] | None = None) -> None:
        super().__init__(f"{title}: {detail}")
        self.status, self.title, self.detail, self.rules = status, title, detail, rules or []


class Rest:
    """A client that calls an ASGI app without a socket; `headers`, such as a key, go with every call."""

    def __init__(self, app: ASGIApp, headers: Mapping[str, str] | None = None) -> None:
        self._app = app
        self._headers = dict(headers or {})
        transport = httpx2.ASGITransport(app=app, raise_app_exceptions=False)
        self._client = httpx2.AsyncClient(transport=transport, base_url=BASE, headers=self._headers, timeout=None)

    async def call(self, method: str, path: str, *, json: Any = None, **params: Any) -> Any:
        """Send a request and return its JSON, or the text of other types; `None` parameters are left out.

        Raises RestError.
        """
        response = await self._request(method, path, json, params)
        return response.json() if "json" in response.headers.get("content-type", "") else response.text

    async def text(self, method: str, path: str, *, json: Any = None, **params: Any) -> str:
        """Do as `call`, but return the text as received: large JSON is best validated while it is parsed."""
        return (await self._request(method, path, json, params)).text

    async def _request(self, method: str, path: str, body: Any, params: Mapping[str, Any]) -> httpx2.Response:
        query = {name: value for name, value in params.items() if value is not None}
        response = await self._client.request(method, path, json=body, params=query)
        if response.status_code >= 400:
            raise _refusal(response)
        return response

    async def stream(self, path: str, last_event_id: int) -> AsyncIterator[dict[str, Any]]:
        """Yield the data of each server-sent event after `last_event_id`, until the caller or the service stops."""
        queue: asyncio.Queue[bytes | None] = asyncio.Queue(maxsize=1000)
        gone = asyncio.Event()

        async def receive() -> Message:
            if not asked:
                asked.append(True)
                return {"type": "http.request", "body": b"", "more_body": False}
            await gone.wait()
            return {"type": "http.disconnect"}

        async def send(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] >= 400:
                status.append(int(message["status"]))
            if message["type"] == "http.response.body":
                await queue.put(message.get("body", b""))
                if not message.get("more_body"):
                    await queue.put(None)

        asked: list[bool] = []
        status: list[int] = []
        headers = {**self._headers, "last-event-id": str(last_event_id)}
        task = asyncio.ensure_future(self._app(_scope(path, headers), receive, send))
        task.add_done_callback(lambda _: queue.put_nowait(None) if not queue.full() else None)
        try:
            async for event in _events(queue):
                if status:
                    raise RestError(status[0], "Request refused", f"{path} returned status {status[0]}")
                yield event
            if status:
                raise RestError(status[0], "Request refused", f"{path} returned status {status[0]}")
        finally:
            gone.set()
            task.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await task


async def _events(queue: asyncio.Queue[bytes | None]) -> AsyncIterator[dict[str, Any]]:
    """Parse the `data:` lines of an event stream; comments and other fields add nothing to the data."""
    buffer = b""
    while (chunk := await queue.get()) is not None:
        buffer += chunk.replace(b"\r\n", b"\n")
        while b"\n\n" in buffer:
            block, buffer = buffer.split(b"\n\n", 1)
            data = b"\n".join(line[5:].strip() for line in block.split(b"\n") if line.startswith(b"data:"))
            if data:
                yield json.loads(data)


def _scope(path: str, headers: Mapping[str, str]) -> dict[str, Any]:
    return {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "GET",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": b"",
        "headers": [(b"host", b"127.0.0.1"), *((k.lower().encode(), v.encode()) for k, v in headers.items())],
        "client": ("127.0.0.1", 0),
        "server": ("127.0.0.1", 80),
    }


def _refusal(response: httpx2.Response) -> RestError:
    try:
        body = response.json()
        return RestError(response.status_code, str(body["title"]), str(body["detail"]), body.get("errors"))
    except (ValueError, KeyError, TypeError):
        return RestError(
            response.status_code, "Request refused", response.text[:300] or f"status {response.status_code}"
        )
