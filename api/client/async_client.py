"""The client for asyncio: the same methods as `Client`, awaited. Nothing blocks the loop, and no thread is used.

    async with AsyncClient("http://127.0.0.1:8080") as service:
        plan = await service.plan(EXAMPLES["paper"](), wait_s=5)
        async for event in service.events(last_id=0):
            print(event.kind, event.data)

Each method runs the one of `Client` in a greenlet, which waits where that would block: requests and answers are
described in one place.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from functools import partial, update_wrapper
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, cast

import httpx2
from sqlalchemy.util import await_only, greenlet_spawn

from skyfolio.api.client.event_lines import EventLines
from skyfolio.api.client.service_client import Client
from skyfolio.api.client.transport import raise_for
from skyfolio.api.store.event_log import Event

Options = ParamSpec("Options")
Result = TypeVar("Result")
_END = object()


class _Waiting:
    """The HTTP client of the sync methods: a request waits for the async one, and lets the loop run meanwhile."""

    def __init__(self, http: httpx2.AsyncClient) -> None:
        self._http = http

    def request(self, method: str, url: str, **options: Any) -> httpx2.Response:
        """Return the answer to a request."""
        answer: httpx2.Response = await_only(self._http.request(method, url, **options))
        return answer


def _awaited(
    method: Callable[Concatenate[Client, Options], Result],
) -> Callable[Concatenate[AsyncClient, Options], Coroutine[Any, Any, Result]]:
    async def call(client: AsyncClient, /, *args: Options.args, **named: Options.kwargs) -> Result:
        result: Result = await greenlet_spawn(partial(method, client._client, *args, **named))
        return result

    update_wrapper(call, method)
    return call


def _awaited_rows(
    method: Callable[Concatenate[Client, Options], Iterator[Result]],
) -> Callable[Concatenate[AsyncClient, Options], AsyncIterator[Result]]:
    async def rows(client: AsyncClient, /, *args: Options.args, **named: Options.kwargs) -> AsyncIterator[Result]:
        found = method(client._client, *args, **named)
        while (row := await greenlet_spawn(next, found, _END)) is not _END:
            yield cast("Result", row)

    update_wrapper(rows, method)
    return rows


class AsyncClient:
    """The client of one service, for asyncio. `key` is an API key; `http` replaces the HTTP client.

    Methods, their arguments, results and errors are those of `Client`; lists are asynchronous iterators.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8080",
        *,
        key: str | None = None,
        timeout_s: float = 70.0,
        http: httpx2.AsyncClient | None = None,
    ) -> None:
        self._http = http or httpx2.AsyncClient(base_url=base_url, timeout=timeout_s)
        self._client = Client(key=key, http=cast("httpx2.Client", _Waiting(self._http)))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def events(self, last_id: int = 0, *, follow: bool = True) -> AsyncIterator[Event]:
        """Yield events, as `Client.events` does."""
        headers = {**self._client.headers, "Last-Event-ID": str(last_id)}
        async with self._http.stream(
            "GET", "/v1/events", headers=headers, params={"follow": follow}, timeout=httpx2.Timeout(70.0)
        ) as stream:
            if stream.status_code >= 400:
                await stream.aread()
                raise_for(stream, "GET", "/v1/events")
            lines = EventLines()
            async for line in stream.aiter_lines():
                for event in lines.take(line):
                    yield event

    acknowledge = _awaited(Client.acknowledge)
    allocations = _awaited(Client.allocations)
    cancel = _awaited(Client.cancel)
    command = _awaited(Client.command)
    contingencies = _awaited(Client.contingencies)
    decide = _awaited(Client.decide)
    drill = _awaited(Client.drill)
    explanation = _awaited(Client.explanation)
    export = _awaited(Client.export)
    fly = _awaited(Client.fly)
    import_files = _awaited(Client.import_files)
    journal = _awaited(Client.journal)
    measure = _awaited(Client.measure)
    operation = _awaited(Client.operation)
    operations = _awaited_rows(Client.operations)
    order = _awaited(Client.order)
    plan = _awaited(Client.plan)
    plans = _awaited_rows(Client.plans)
    preview = _awaited(Client.preview)
    read_plan = _awaited(Client.read_plan)
    register = _awaited(Client.register)
    replan = _awaited(Client.replan)
    robustness = _awaited(Client.robustness)
    submit = _awaited(Client.submit)
    vehicles = _awaited(Client.vehicles)
    register_webhook = _awaited(Client.register_webhook)
    webhooks = _awaited(Client.webhooks)
    delete_webhook = _awaited(Client.delete_webhook)
    test_webhook = _awaited(Client.test_webhook)
