"""`kill -9` at every step of the journal, with aircraft in the air: real processes, real sockets, ground truth."""

import asyncio
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest

import sim
from api.demo.client import free_port
from api.settings import Settings
from api.simulate import specs_at_starts
from planner import EXAMPLES

pytestmark = pytest.mark.e2e
SPEEDUP = 4.0
AT_ONCE = 5
SCENARIO = EXAMPLES["paper"]().with_changes(slots=32, altitude_m=10.0)
LOST = "uav-3"
DYING = Path(__file__).parent / "dying_service.py"
ENDED = {"completed", "failed", "aborted", "interrupted"}


@dataclass(frozen=True)
class Case:
    """When the service dies: before or after the count-th entry of a step is stored."""

    step: str
    when: str = "after"
    count: int = 1

    def __str__(self) -> str:
        return f"{self.when} {self.step} {self.count}"


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


class Field:
    """One fleet, one database, and services that come and go."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self.endpoint = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        self.fleet = sim.Fleet(
            specs_at_starts(SCENARIO), clock=sim.ScaledClock(SPEEDUP), endpoint=f"udpout://{self.endpoint}"
        )
        self.settings = Settings(
            port=free_port(socket.SOCK_STREAM),
            database_url=f"sqlite+aiosqlite:///{folder}/service.db",
            fleet_url=f"udpin://{self.endpoint}",
            time_scale=SPEEDUP,
            plan_ahead=False,
        )
        self.log = folder / "service.log"
        self.client = httpx2.AsyncClient(base_url=f"http://127.0.0.1:{self.settings.port}", timeout=70.0)

    @asynccontextmanager
    async def service(self, dies: Case | None = None) -> AsyncIterator[asyncio.subprocess.Process]:
        """A service process that is ready; it dies by itself in a case, and is ended otherwise."""
        command = [str(DYING), self.settings.model_dump_json(), "never", "after", "1"]
        if dies is not None:
            command = [str(DYING), self.settings.model_dump_json(), dies.step, dies.when, str(dies.count)]
        with self.log.open("ab") as sink:
            process = await asyncio.create_subprocess_exec(sys.executable, *command, stdout=sink, stderr=sink)
            try:
                async with asyncio.timeout(60):
                    await self._ready(process)
                yield process
            finally:
                if process.returncode is None:
                    process.terminate()
                    await process.wait()

    async def _ready(self, process: asyncio.subprocess.Process) -> None:
        while process.returncode is None:
            with suppress(httpx2.TransportError):
                if (await self.client.get("/ready")).status_code == 200:
                    return
            await asyncio.sleep(0.1)
        raise AssertionError(f"the service ended with {process.returncode}: {self.log.read_text()[-2000:]}")

    async def get(self, path: str, **params: Any) -> Any:
        answer = await self.client.get(path, params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def take_off(self, until: str = "flying") -> str:
        """Plan, register, fly; the operation's path once it is in that state."""
        scenario = SCENARIO.model_dump(mode="json")
        made = (await self.client.post("/v1/plans", params={"wait_s": 60}, json=scenario)).json()
        for number, uav in enumerate(SCENARIO.uav_ids, start=1):
            body = {"uav_id": uav, "system_id": number}
            assert (await self.client.post("/v1/fleet/vehicles", json=body)).status_code == 201
        started = await self.client.post("/v1/operations", json={"plan_id": made["id"]})
        assert started.status_code == 202, started.text
        await self.until(started.headers["Location"], until, "failed")
        return str(started.headers["Location"])

    async def until(self, path: str, *states: str, limit_s: float = 90) -> dict[str, Any]:
        async with asyncio.timeout(limit_s):
            while True:
                operation: dict[str, Any] = await self.get(path)
                if operation["state"] in states:
                    return operation
                await asyncio.sleep(0.05)


async def died(process: asyncio.subprocess.Process) -> None:
    """Wait until the service has killed itself."""
    async with asyncio.timeout(60):
        assert await process.wait() == -signal.SIGKILL


async def events_of(field: Field) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    while True:
        page = await field.get("/v1/events/log", after=len(found), limit=500)
        found += page["items"]
        if page["next"] is None:
            return found


async def killed_at(case: Case, folder: Path) -> None:
    """Fly, lose a UAV, kill the service at that step, start another one, and see the flight through."""
    field = Field(folder)
    async with field.fleet:
        async with field.service(dies=case) as first:
            path = await field.take_off()
            field.fleet.inject(sim.Kill(3))
            await died(first)
        async with field.service():
            ended = await field.until(path, *ENDED)
            journal = await field.get(f"{path}/journal")
            plans = (await field.get("/v1/plans"))["items"]
            events = await events_of(field)
    await field.client.aclose()
    assert_flown_on(field, ended)
    assert_books_closed(case, ended, journal, plans, events)


def assert_flown_on(field: Field, ended: dict[str, Any]) -> None:
    """Ground truth: the survivors were given each mission once, the last is a new one, and they landed."""
    assert ended["state"] == "completed", ended["error"]
    assert ended["lost"] == [LOST]
    for system_id in (1, 2):
        taken = [event.detail["mission_id"] for event in field.fleet.truth.happened("mission_accepted", system_id)]
        assert len(taken) == len(set(taken)), "no mission is sent twice"
        assert len(taken) >= 2, "the survivors fly a new plan"
        assert field.fleet.truth.happened("landed", system_id)


def assert_books_closed(
    case: Case,
    ended: dict[str, Any],
    journal: list[dict[str, Any]],
    plans: list[dict[str, Any]],
    events: list[dict[str, Any]],
) -> None:
    """The database tells the whole story, and nothing in it is left open."""
    assert [report["outcome"] for report in ended["recoveries"]][-1] == "flying", ended["recoveries"]
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


async def test_wherever_the_service_is_killed_the_next_one_sees_the_flight_through(tmp_path: Path) -> None:
    gate = asyncio.Semaphore(AT_ONCE)

    async def one(number: int, case: Case) -> str | None:
        async with gate:
            try:
                await killed_at(case, tmp_path / str(number))
            except (AssertionError, TimeoutError) as error:
                return f"{case}: {type(error).__name__} {error}"
        return None

    said = await asyncio.gather(*(one(number, case) for number, case in enumerate(MATRIX)))
    assert [each for each in said if each] == []


async def test_a_uav_that_fell_while_no_service_ran_is_found_lost_by_the_next_one(tmp_path: Path) -> None:
    field = Field(tmp_path / "field")
    async with field.fleet:
        async with field.service() as first:
            path = await field.take_off()
            os.kill(first.pid, signal.SIGKILL)
            await first.wait()
        field.fleet.inject(sim.Kill(3))
        async with field.service():
            ended = await field.until(path, *ENDED)
    await field.client.aclose()
    assert_flown_on(field, ended)


async def test_commands_in_doubt_before_the_flight_are_left_to_the_operator(tmp_path: Path) -> None:
    field = Field(tmp_path / "field")
    async with field.fleet:
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
    await field.client.aclose()


def test_the_matrix_has_every_step_of_an_answer() -> None:
    answered = {"detected", "classified", "replanned", "checked", "uploading", "verified", "flying", "closed"}
    assert {case.step for case in MATRIX} == answered
    assert json.dumps([str(case) for case in MATRIX])
