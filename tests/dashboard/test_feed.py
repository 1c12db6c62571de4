"""The facade on the real service, in process: what the pages can do without a browser."""

import asyncio
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from skyfolio.api.common.settings import Settings
from skyfolio.api.dashboard.feed import Feed
from skyfolio.api.dashboard.rest import Rest, RestError
from skyfolio.api.dashboard.watch import Watch
from skyfolio.api.http.app import create_app
from skyfolio.planner import Pins, Scenario

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def feed() -> AsyncIterator[Feed]:
    app = create_app(Settings())
    async with app.router.lifespan_context(app):
        yield Feed(Rest(app))


async def test_plans_what_ifs_and_missions_come_through_the_facade(feed: Feed, minimal: Scenario) -> None:
    assert "paper" in await feed.examples()
    assert "kill" in await feed.faults()
    assert (await feed.example("minimal")).uav_ids == minimal.uav_ids
    plan = await feed.make_plan(minimal)
    assert plan.scenario == minimal
    assert await feed.plan(plan.id) == plan
    without = await feed.what_if(plan.id, "uav-2", 2)
    assert without.scenario.uav_ids == ("uav-1",)
    assert without.parent == plan.id
    held = await feed.make_plan(minimal, pins=Pins(uavs=("uav-1",)))
    assert list(held.pins.paths_m) == ["uav-1"]
    again = await feed.what_if(held.id, "uav-2", 2, disruption_weight=3.0)
    assert list(again.pins.paths_m) == ["uav-1"]
    assert again.disruption is not None
    assert again.disruption.weight_kbps == 3.0
    why = await feed.explanation(held.id)
    assert (why.plan_id, why.complete) == (held.id, True)
    document = await feed.mission_file(plan.id, "uav-1")
    assert document["fileType"] == "Plan"
    assert await feed.vehicles() == []


async def test_refusals_carry_the_services_own_words(feed: Feed, minimal: Scenario) -> None:
    with pytest.raises(RestError, match="'plan-0' does not exist") as caught:
        await feed.plan("plan-0")
    assert caught.value.status == 404
    plan = await feed.make_plan(minimal)
    with pytest.raises(RestError, match="at_slot"):
        await feed.what_if(plan.id, "uav-2", 99)


async def test_events_stream_in_process_and_can_be_resumed(feed: Feed, minimal: Scenario) -> None:
    plans = {(await feed.make_plan(minimal)).id for _ in range(2)}
    heard = []
    async with asyncio.timeout(20):
        async for event in feed.events(0):
            heard.append(event)
            if {each.data.get("plan_id") for each in heard} >= plans:
                break
        async for event in feed.events(heard[0].id or 0):
            assert event.id == heard[1].id
            break


def complaint(watch: Watch) -> str:
    return watch.error or ""


async def test_the_watch_keeps_what_happens_and_tells_when_the_service_refuses(feed: Feed, minimal: Scenario) -> None:
    watch = Watch(feed)
    watch.start()
    watch.join()
    try:
        await feed.make_plan(minimal)
        async with asyncio.timeout(20):
            while not (watch.events and watch.loaded):
                await watch.changed()
            assert complaint(watch) == ""
            watch.show("op-0")
            while not complaint(watch):
                await watch.changed()
        assert "op-0" in complaint(watch)
    finally:
        await watch.stop()
