"""The event stream."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.errors import BusyError
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, requires
from skyfolio.api.service import Service
from skyfolio.api.store.event_log import Event

router = APIRouter(prefix="/v1", tags=["events"], dependencies=[*KNOWN, requires(Role.VIEWER)])
STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "A stream of server-sent events: `id` is the event's number, `event` its kind, `data` its JSON.",
        "content": {
            "text/event-stream": {
                "itemSchema": {
                    "type": "object",
                    "properties": {name: {"type": "string"} for name in ("data", "event", "id")},
                    "required": ["data", "event"],
                }
            }
        },
    }
}
LastEventId = Annotated[
    int, Header(ge=0, le=2**53, alias="Last-Event-ID", description="Continue after this event; browsers send it.")
]


class EventPage(BaseModel):
    """Events, the oldest first. `next` is the `after` of the next page, null at the end."""

    items: list[Event]
    next: int | None


@router.get("/events", responses=STREAM, response_class=StreamingResponse)
async def stream_events(
    request: Request,
    service: ServiceDep,
    last_event_id: LastEventId = 0,
    telemetry: Annotated[
        bool, Query(description="Also snapshots of all vehicles, ten per second, as `event: telemetry` without an id.")
    ] = False,
    follow: Annotated[bool, Query(description="False: end after what is stored now.")] = True,
) -> StreamingResponse:
    """Stream the events (SSE), from the first or from the one after `Last-Event-ID`; none is ever left out.

    The stream ends when the API key it was opened with is revoked.
    """
    if service.events.followers >= service.settings.max_subscribers:
        raise BusyError(f"events: {service.settings.max_subscribers} streams are open already")
    events = service.events.follow(
        last_event_id, telemetry=telemetry, forever=follow, allowed=request.state.still_admitted
    )
    stream = _counted(service, events)
    return StreamingResponse(stream, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})


@router.get("/events/log")
async def read_events(
    service: ServiceDep,
    after: Annotated[int, Query(ge=0, le=2**53, description="Events with a greater number.")] = 0,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> EventPage:
    """Return a page of the event log, for replay."""
    items = await service.events.after(after, limit)
    return EventPage(items=items, next=items[-1].id if len(items) == limit else None)


async def _counted(service: Service, stream: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    service.metrics.subscribers.inc()
    try:
        async for wire in stream:
            yield wire
    finally:
        service.metrics.subscribers.dec()
