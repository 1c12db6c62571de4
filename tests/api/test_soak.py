"""A quarter of an hour of fleet time with random faults, sped up: no event is lost, none stays open, memory is flat."""

import asyncio
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx2
import pytest

from skyfolio import sim
from tests.api.field import Field, events_of

pytestmark = pytest.mark.e2e
FLEET_S = 900.0
SPEEDUP = 20.0
SEED = 5
SILENT_S = (3.0, 40.0)
"""About half of the silences are long enough to be a loss."""
CUT_AFTER_S = 4.5
FLAT_MB = 24.0
"""What memory may grow by after the first flights: caches have their limits, and what is over is let go."""


def random_fault(rng: random.Random, system_id: int) -> sim.Fault:
    """A fault that passes, so that the next flight has all its vehicles."""
    makers: list[Any] = [
        lambda: sim.Mute(system_id, for_s=rng.uniform(*SILENT_S)),
        lambda: sim.Freeze(system_id, for_s=rng.uniform(*SILENT_S)),
        lambda: sim.RejectMission(system_id, uploads=rng.randint(1, 3)),
        lambda: sim.CorruptUpload(system_id, uploads=rng.randint(1, 3)),
        lambda: sim.Impair(system_id, up=sim.Impairments(loss=0.2), for_s=rng.uniform(5, 40)),
        lambda: sim.Impair(system_id, down=sim.Impairments(loss=0.2), for_s=rng.uniform(5, 40)),
        lambda: sim.ClockJump(system_id, seconds=rng.uniform(-30, 30)),
    ]
    fault: sim.Fault = rng.choice(makers)()
    return fault


def resident_mb(pid: int) -> float:
    """Resident memory of a process, megabytes."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise AssertionError("no VmRSS")


async def listen(field: Field, heard: list[int]) -> None:
    """A subscriber that is cut off now and then and resumes."""
    while True:
        headers = {"Last-Event-ID": str(heard[-1] if heard else 0)}
        params = {"telemetry": True}
        with suppress(TimeoutError, httpx2.TransportError):
            async with (
                asyncio.timeout(CUT_AFTER_S),
                field.client.stream("GET", "/v1/events", headers=headers, params=params) as stream,
            ):
                async for line in stream.aiter_lines():
                    if line.startswith("id: "):
                        heard.append(int(line[4:]))  # noqa: PERF401 - kept when it is cut off


async def fly_once(field: Field, plan_id: str, rng: random.Random, until_s: float) -> dict[str, Any]:
    """One operation with faults on the way, until it has ended or is aborted at the end of the soak."""
    await settled(field)
    path = await begun(field, plan_id)
    next_fault_s: float | None = None  # none before slot 0: that would end the launch, and leave nothing to be answered
    while True:
        operation: dict[str, Any] = await field.get(path)
        if operation["state"] in {"completed", "completed_partly", "failed", "aborted"}:
            return operation
        now_s = field.fleet.clock.now()
        for uav in operation["returned"]:
            await field.client.post(f"{path}:readmit", json={"uav_id": uav})
        if next_fault_s is None:
            if operation["state"] == "flying":
                field.fleet.inject(sim.Mute(rng.randint(1, 3), for_s=SILENT_S[1]))  # a loss to be answered, for certain
                next_fault_s = now_s + rng.uniform(5, 40)
        elif now_s > next_fault_s:
            number = rng.randint(1, 3)
            fault = random_fault(rng, number)
            sinking = field.fleet.vehicles[number].autopilot.body.up_mps < 0
            if not (sinking and isinstance(fault, sim.Freeze)):  # a frozen vehicle sinks on, and that does not pass
                field.fleet.inject(fault)
            next_fault_s = now_s + rng.uniform(5, 40)
        if now_s > until_s:
            answer = await field.client.post(f"{path}:abort", json={"action": "land"})
            assert answer.status_code in {200, 409}, answer.text
        await asyncio.sleep(0.1)


async def begun(field: Field, plan_id: str) -> str:
    """The path of a new operation; vehicles are free a moment after the last one says that it is over."""
    for _ in range(50):
        started = await field.client.post("/v1/operations", json={"plan_id": plan_id})
        if started.status_code != 409:
            break
        await asyncio.sleep(0.1)
    assert started.status_code == 202, started.text
    return str(started.headers["Location"])


async def settled(field: Field) -> None:
    """Everybody is on the ground and heard again; who still flies after an operation is landed by a human."""
    links: dict[str, str] = {}
    for _ in range(600):
        for number, vehicle in field.fleet.vehicles.items():
            if vehicle.armed and vehicle.mode is not sim.Mode.LAND:
                field.fleet.inject(sim.ModeChange(number, mode="LAND"))
        links = {vehicle["uav_id"]: vehicle["link"] for vehicle in await field.get("/v1/fleet/vehicles")}
        if set(links.values()) == {"live"} and not any(vehicle.armed for vehicle in field.fleet.vehicles.values()):
            return
        await asyncio.sleep(0.1)
    modes = {number: (vehicle.mode, vehicle.armed) for number, vehicle in field.fleet.vehicles.items()}
    raise AssertionError(f"not settled: {links}, {modes}")


@pytest.mark.long
async def test_a_quarter_of_an_hour_of_random_faults_loses_no_event_and_no_memory(tmp_path: Path) -> None:
    rng = random.Random(SEED)
    field = Field(tmp_path / "field", SPEEDUP)
    heard: list[int] = []
    memory, outcomes = [], []
    async with field, field.service() as process:
        plan_id = await field.planned_and_registered()
        listening = asyncio.create_task(listen(field, heard))
        until_s = field.fleet.clock.now() + FLEET_S
        while field.fleet.clock.now() < until_s:
            outcomes.append((await fly_once(field, plan_id, rng, until_s))["state"])
            memory.append(resident_mb(process.pid))
        events = await events_of(field)
        async with asyncio.timeout(30):
            while not heard or heard[-1] < events[-1]["id"]:  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        listening.cancel()
        operations = (await field.get("/v1/operations", limit=200))["items"]
        journals = [await field.get(f"/v1/operations/{row['id']}/journal") for row in operations]
    assert len(outcomes) >= 3
    assert heard == list(range(1, heard[-1] + 1)), "every event once, in order"
    assert all(row["ended_at"] for row in operations)
    for journal in journals:
        assert_closed(journal, outcomes)
    steps = [entry["step"] for journal in journals for entry in journal]
    assert {"detected", "replanned", "closed"} <= set(steps), "faults were answered"
    settled_at = len(memory) // 2
    assert memory[-1] - memory[settled_at] < FLAT_MB, memory


def assert_closed(journal: list[dict[str, Any]], outcomes: list[str]) -> None:
    """Every incident but the last of an operation that ended meanwhile is closed."""
    numbers = sorted({entry["incident"] for entry in journal})
    still_open = [
        number
        for number in numbers
        if not any(entry["incident"] == number and entry["step"] == "closed" for entry in journal)
    ]
    assert still_open in ([], numbers[-1:]), (still_open, outcomes)
