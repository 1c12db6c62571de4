"""`kill -9` with aircraft in the air: at every step of the journal in virtual time, and for real."""

import asyncio
import os
import signal
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.journal import Entry
from skyfolio.planner import EXAMPLES
from tests.api.field import ENDED, Case, Field, died, events_of
from tests.api.sky import Sky, flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=12, altitude_m=8.0)
STARTING_AT_ONCE = 2
"""Services start and answer two at a time, which is what loads a machine; fleets that fly on disturb nobody."""
LOST = "uav-3"
WEIGHT = 0.5
"""What a change must be worth to these operations, kbit/s, before the restart and after."""
MATRIX = [
    Case("detected", "before"),
    Case("detected"),
    Case("classified"),
    Case("replanned"),
    Case("checked"),
    Case("uploading", "after", 2),
    Case("verified", "before"),
    Case("verified"),
    Case("flying"),
    Case("closed"),
]


async def killed_at(case: Case, folder: Path, gate: asyncio.Semaphore) -> None:
    """Fly, lose a UAV, kill the service at that step, start another one, and see the flight through."""
    field = Field(folder)
    async with field, AsyncExitStack() as stack:
        async with gate:
            async with field.service(dies=case) as first:
                path = await field.take_off(disruption_weight=WEIGHT)
                field.fleet.inject(sim.Kill(3))
                await died(first)
            await stack.enter_async_context(field.service())
            await field.answered(path)
        ended = await field.until(path, *ENDED)
        journal = await field.get(f"{path}/journal")
        plans = (await field.get("/v1/plans"))["items"]
        events = await events_of(field)
    assert_seen_through(case, field.fleet, ended, journal, plans, events)


def assert_seen_through(
    case: Case,
    fleet: sim.Fleet,
    ended: dict[str, Any],
    journal: list[dict[str, Any]],
    plans: list[dict[str, Any]],
    events: list[dict[str, Any]],
) -> None:
    """By ground truth and by the books."""
    assert_flown_on(fleet, ended)
    assert_books_closed(case, ended, journal, plans, events)
    assert ended["disruption_weight"] == WEIGHT
    assert ended["recoveries"][-1]["disruption"]["weight_kbps"] == WEIGHT, "whichever service recovered"
    resumed = guidance_resumed(events)
    assert set(resumed.values()) <= {"ok"}, "what is on board of a survivor is known"
    if case.step in {"flying", "closed"}:  # else they may have been given new missions before it was read back
        assert set(resumed) == {"uav-1", "uav-2"}


def guidance_resumed(events: list[dict[str, Any]]) -> dict[str, str]:
    """Whether the mission on board of each survivor was recognised after a restart."""
    told = [event["data"] for event in events if event["kind"] == "guidance_resumed"]
    return {said["uav_id"]: said["level"] for said in told if said["uav_id"] != LOST}


async def killed_before_the_loss(folder: Path, gate: asyncio.Semaphore) -> None:
    """A stream ends in missions without the service; a UAV that fell meanwhile is found lost by the next one."""
    field = Field(folder)
    async with field, AsyncExitStack() as stack:
        async with gate:
            async with field.service() as first:
                path = await field.take_off(guidance="stream", stream_fallback="mission")
                os.kill(first.pid, signal.SIGKILL)
                await first.wait()
            vehicles = [vehicle.autopilot for vehicle in field.fleet.vehicles.values()]
            async with asyncio.timeout(60):
                while {one.mode for one in vehicles} != {sim.Mode.MISSION}:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            field.fleet.inject(sim.Kill(3))
            await stack.enter_async_context(field.service())
            await field.answered(path)
        ended = await field.until(path, *ENDED)
        events = await events_of(field)
    assert_flown_on(field.fleet, ended)
    assert guidance_resumed(events) == {"uav-1": "ok", "uav-2": "ok"}


def assert_flown_on(fleet: sim.Fleet, ended: dict[str, Any]) -> None:
    """Ground truth: the survivors were given each mission once, the last is a new one, and they landed."""
    assert ended["state"] == "completed", ended["error"]
    assert ended["lost"] == [LOST]
    for system_id in (1, 2):
        taken = [event.detail["mission_id"] for event in fleet.truth.happened("mission_accepted", system_id)]
        assert len(taken) == len(set(taken)), "no mission is sent twice"
        assert len(taken) >= 2, "the survivors fly a new plan"
        assert fleet.truth.happened("landed", system_id)


def assert_books_closed(
    case: Case,
    ended: dict[str, Any],
    journal: list[dict[str, Any]],
    plans: list[dict[str, Any]],
    events: list[dict[str, Any]],
) -> None:
    """The database tells the whole story, and nothing in it is left open."""
    assert ended["recoveries"], "the loss was answered"
    assert ended["recoveries"][-1]["outcome"] == "flying", ended["recoveries"]
    incidents = {entry["incident"] for entry in journal}
    for incident in incidents:
        steps = [entry["step"] for entry in journal if entry["incident"] == incident]
        assert steps[0] == "detected"
        assert steps.count("closed") == 1
        assert steps[-1] == "closed"
    assert {plan["status"] for plan in plans} <= {"succeeded", "interrupted", "cancelled"}
    assert [event["id"] for event in events] == list(range(1, len(events) + 1))
    kinds = [event["kind"] for event in events]
    assert kinds.count("uav_lost") == 1 or case == Case("detected", "before")
    assert kinds.count("service_started") == 2


@pytest.mark.parametrize("case", MATRIX, ids=str)
def test_wherever_the_service_is_killed_the_next_one_sees_the_flight_through(case: Case) -> None:
    with flight(SCENARIO) as flown:
        operation_id = flown.take_off(disruption_weight=WEIGHT)
        kill_at(case, flown)
        flown.inject(sim.Kill(3))
        flown.wait(lambda: flown.ground.service is None, f"never came to {case}")
        flown.let_pass(2.0)
        flown.start()
        flown.ended(operation_id)
        path = f"/v1/operations/{operation_id}"
        ended, journal = flown.http.get(path).json(), flown.http.get(f"{path}/journal").json()
        assert_seen_through(
            case, flown.fleet, ended, journal, flown.http.get("/v1/plans").json()["items"], flown.events()
        )


def kill_at(case: Case, flown: Sky) -> None:
    """Kill the service when it comes there."""
    seen = 0

    def die(entry: Entry, stored: bool) -> None:
        nonlocal seen
        if entry.step == case.step and stored == (case.when == "after"):
            seen += 1
            if seen == case.count:
                flown.ground.kill()

    flown.service.journal.listeners.append(die)


@pytest.mark.long
@pytest.mark.e2e
async def test_a_process_that_is_killed_with_uavs_in_the_air_is_followed_by_one_that_sees_the_flight_through(
    tmp_path: Path,
) -> None:
    gate = asyncio.Semaphore(STARTING_AT_ONCE)
    await asyncio.gather(
        killed_at(Case("uploading", "after", 2), tmp_path / "uploading", gate),
        killed_before_the_loss(tmp_path / "streaming", gate),
    )


@pytest.mark.e2e
async def test_commands_in_doubt_before_the_flight_are_left_to_the_operator(tmp_path: Path) -> None:
    field = Field(tmp_path / "field")
    async with field:
        async with field.service() as first:
            path = await field.take_off(until="launching")
            os.kill(first.pid, signal.SIGKILL)
            await first.wait()
        async with field.service():
            found = await field.until(path, "interrupted")
            assert "stopped while launching" in found["error"]
            before = {number: len(field.fleet.truth.happened("takeoff", number)) for number in (1, 2, 3)}
            answer = await field.client.post(f"{path}:abort", json={"action": "land"})
            assert answer.status_code == 200, answer.text
            assert answer.json()["state"] == "aborted"
            assert {number: len(field.fleet.truth.happened("takeoff", number)) for number in (1, 2, 3)} == before


def test_the_matrix_has_every_step_of_a_recovery() -> None:
    recovery = {"detected", "classified", "replanned", "checked", "uploading", "verified", "flying", "closed"}
    assert {case.step for case in MATRIX} == recovery
