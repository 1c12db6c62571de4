"""The event stream, and whether the service is well."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel

from api import __version__
from api.routes.deps import ServiceDep

router = APIRouter()


class Health(BaseModel):
    """The service answers, and its solver has solved."""

    status: str = "ok"
    version: str


@router.get("/v1/events", response_class=EventSourceResponse, tags=["events"])
async def stream_events(
    service: ServiceDep, last_event_id: Annotated[int, Header(ge=0)] = 0
) -> AsyncIterator[ServerSentEvent]:
    """Server-sent events from the first kept one, or from the one after `Last-Event-ID`."""
    async for event in service.events.follow(last_event_id):
        yield ServerSentEvent(data=event.model_dump(mode="json"), event=event.kind, id=str(event.id))


@router.get("/health", tags=["service"])
async def health() -> Health:
    """Alive; the solver was warmed up before the service began to listen."""
    return Health(version=__version__)
