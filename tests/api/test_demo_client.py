"""What the drill asks of the service: a plan, however long a loaded machine takes for it."""

import httpx2
import pytest

from skyfolio.api.lab.demo.client import DemoError, planned
from skyfolio.planner import EXAMPLES


def service_of(*statuses: str) -> tuple[httpx2.AsyncClient, list[str]]:
    """A service whose plan has these statuses, one answer after the other, and what it is asked."""
    asked: list[str] = []
    left = iter(statuses)

    def answer(request: httpx2.Request) -> httpx2.Response:
        asked.append(f"{request.method} {request.url.path}")
        return httpx2.Response(200, json={"id": "plan-1", "status": next(left)})

    return httpx2.AsyncClient(transport=httpx2.MockTransport(answer), base_url="http://testserver"), asked


async def test_a_plan_that_takes_longer_than_one_request_waits_is_waited_for() -> None:
    client, asked = service_of("queued", "running", "succeeded")
    assert await planned(client, EXAMPLES["minimal"]()) == "plan-1"
    assert asked == ["POST /v1/plans", "GET /v1/plans/plan-1", "GET /v1/plans/plan-1"]


async def test_a_plan_that_is_refused_is_told_with_the_reason() -> None:
    def refuse(_: httpx2.Request) -> httpx2.Response:
        return httpx2.Response(429, json={"detail": "too many plans"})

    client = httpx2.AsyncClient(transport=httpx2.MockTransport(refuse), base_url="http://testserver")
    with pytest.raises(DemoError, match="429 too many plans"):
        await planned(client, EXAMPLES["minimal"]())
