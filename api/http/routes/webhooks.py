"""Webhooks: where news is sent of losses, approvals and completions. Only pilots see or change them."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.access.api_keys import Role
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.http.routes.deps import KNOWN, ServiceDep, creates, requires
from skyfolio.api.webhooks.delivery import WebhookTrial
from skyfolio.api.webhooks.hooks import WebhookView
from skyfolio.api.webhooks.topics import Topic

router = APIRouter(prefix="/v1", tags=["webhooks"], dependencies=[*KNOWN, requires(Role.PILOT)])


class WebhookRequest(BaseModel):
    """Where to send what, and the secret with which deliveries are signed; it is never returned."""

    model_config = ConfigDict(extra="forbid")

    url: Annotated[str, Field(max_length=2000, pattern=r"^https?://[!-~]+$", description="https:// or http://")]
    topics: Annotated[list[Literal["loss", "approval", "completion"]], Field(min_length=1, max_length=3)]
    secret: Annotated[
        str, Field(min_length=16, max_length=200, pattern=r"^[ -~]+$", json_schema_extra={"writeOnly": True})
    ]


@router.post("/webhooks", status_code=201)
async def register_webhook(
    body: WebhookRequest,
    service: ServiceDep,
    response: Response,
    creation: Annotated[NewResource, Depends(creates("hook"))],
) -> WebhookView:
    """Register a webhook: it is sent what happens from now on, at least once and in order."""
    topics = [Topic(topic) for topic in body.topics]
    after = service.events.last_id
    hook = await service.webhooks.register(creation, url=body.url, topics=topics, secret=body.secret, after=after)
    service.deliveries.wake()
    response.headers["Location"] = f"/v1/webhooks/{hook.id}"
    return hook


@router.get("/webhooks")
async def list_webhooks(service: ServiceDep) -> list[WebhookView]:
    """List webhooks, the oldest first, with how far their deliveries are."""
    return [hook.view for hook in await service.webhooks.all()]


@router.get("/webhooks/{webhook_id}")
async def read_webhook(webhook_id: str, service: ServiceDep) -> WebhookView:
    """Return one webhook."""
    return (await service.webhooks.get(webhook_id)).view


@router.delete("/webhooks/{webhook_id}", status_code=204)
async def delete_webhook(webhook_id: str, service: ServiceDep) -> None:
    """Delete a webhook; what has not been sent yet, is not sent."""
    await service.webhooks.delete(webhook_id)


@router.post("/webhooks/{webhook_id}:test")
async def test_webhook(webhook_id: str, service: ServiceDep) -> WebhookTrial:
    """Send the topic `test` to a webhook now, and return how that went."""
    return await service.deliveries.test(webhook_id)
