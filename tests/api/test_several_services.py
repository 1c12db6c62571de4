"""Two services, one PostgreSQL, one fleet: killed, stopped and slowed down. Real processes, ground truth."""

import asyncio
import itertools
import signal
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.api.services_field import SPEEDUP, Service, SharedField

pytestmark = pytest.mark.e2e
TAKEN_OVER_WITHIN_S = 5.0
LONG_S = 8.0
"""A term that is long beside the moments for which a loaded machine lets a process wait: no lease runs out by that."""
LANDED = ("completed", "completed_partly", "failed", "aborted", "interrupted")


@pytest.fixture
async def field(new_database: str, tmp_path: Path, request: pytest.FixtureRequest) -> AsyncIterator[SharedField]:
    made = SharedField(tmp_path, new_database, **getattr(request, "param", {}))
    async with made, AsyncExitStack() as stack:
        await asyncio.gather(*(stack.enter_async_context(one.running()) for one in (made.first, made.second)))
        yield made


async def told(by: Service, kind: str) -> dict[str, Any]:
    """The first event of this kind, once a service sends it."""
    async with asyncio.timeout(60):
        while not (events := await by.events(kind)):  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    return events[0]


async def taken_over(by: Service) -> dict[str, Any]:
    """The event of the take-over, once it is there."""
    return await told(by, "operation_taken_over")


def assert_flown(field: SharedField, ended: dict[str, Any]) -> None:
    assert ended["state"] == "completed", ended["error"]
    assert ended["lost"] == []
    for number in (1, 2, 3):
        assert len(field.fleet.truth.happened("takeoff", number)) == 1
        assert field.fleet.truth.happened("landed", number)


@pytest.mark.long
@pytest.mark.parametrize("field", [{"slots": 10}], indirect=True)
async def test_a_second_service_takes_over_within_five_seconds_when_the_first_is_killed(field: SharedField) -> None:
    path = await field.take_off()
    assert field.received(field.second, field.claimed_s()) == [], "not even a heartbeat to what another flies"
    killed, late_s = time.monotonic(), field.late_s
    field.first.signal(signal.SIGKILL)
    await taken_over(field.second)
    took_s = time.monotonic() - killed
    flying = await field.second.until(path, "flying", owner="second")
    assert took_s < TAKEN_OVER_WITHIN_S + field.late_s - late_s
    assert flying["lost"] == []
    ended = await field.second.until(path, *LANDED)
    assert_flown(field, ended)
    assert field.received(field.second, heartbeats=False), "it asked the vehicles what they fly"


@pytest.mark.long
@pytest.mark.parametrize("field", [{"lease_s": LONG_S}], indirect=True)
async def test_a_slow_database_moves_no_operation_and_a_service_that_was_stopped_wakes_knowing_that_it_lost(
    field: SharedField,
) -> None:
    path = await field.take_off()
    await slow_for(field, path, 2 * LONG_S)
    field.first.signal(signal.SIGSTOP)
    await taken_over(field.second)
    await asyncio.sleep(1.0)
    woken_s = field.now_s()
    field.first.signal(signal.SIGCONT)
    lost = await field.first.until(path, "flying", owner="second")
    assert lost["owner"] == "second"
    refused = await field.first.client.post(f"{path}:pause")
    assert refused.status_code == 409, refused.text
    assert "'second'" in refused.json()["detail"]
    assert (await told(field.first, "operation_left"))["data"]["service"] == "first"
    assert_flown(field, await field.second.until(path, *LANDED))
    meant_for_others = [one for one in field.received(field.first, woken_s) if one.t_s < landed_s(field)]
    assert meant_for_others == [], "not even a heartbeat"


async def slow_for(field: SharedField, path: str, seconds: float) -> None:
    """Make the first service's database slow: it flies on, and nobody takes over."""
    late_s = field.late_s
    field.first.line.delay_s = 0.12 * LONG_S  # there, and back: a quarter of the term for each renewal
    await asyncio.sleep(seconds)
    field.first.line.delay_s = 0.0
    assert (await field.second.get(path))["owner"] == "first"
    assert await field.second.events("operation_taken_over") == []
    assert field.received(field.second, field.claimed_s()) == []
    beats = [one.t_s for one in field.received(field.first) if one.name == "HEARTBEAT" and one.system_id == 1]
    gaps = [later - earlier for earlier, later in itertools.pairwise(beats)]
    assert max(gaps) < (3.0 + field.late_s - late_s) * SPEEDUP, "vehicles hear it all the time"


def landed_s(field: SharedField) -> float:
    """When the first vehicle was down; from the end of the operation on, vehicles are anybody's again."""
    return min(event.t_s for event in field.fleet.truth.happened("landed"))
